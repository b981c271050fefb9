# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Feed-forward within limits, from a linear model; see doc/theory.md, section 12."""

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.optimize import linprog

from timo_sim.runs.linear import LinearModel
from timo_sim.scene.parameters import (
    checked, NUMBER, Parameter, ParameterError, short, warn, whole_ratio)

_GOAL = Parameter('goal', (), '', '')
_DURATION = Parameter('duration', 1.0, 's', '', low=0.0, open_low=True)
_LIMITS = Parameter('limit and rate_limit', (), '', '', low=0.0, open_low=True, finite=False,
                    alone=True)
_LONGEST = 2**14    # periods of a plan
_ROUND_OFF = 1e-13  # relative, of what should vanish
# Deflection of the tip over the length; the arm is then shorter by 0.6 of its square, 2 %.
_MOST_BENT = 0.2
_DEPENDENT = 1e-10  # relative singular value of constraints that depend on each other


@dataclass(frozen=True)
class Plan:
    """Times t [s], states x, inputs u that are held from then on, outputs y; shapes (k, ...)."""

    t: np.ndarray
    x: np.ndarray
    u: np.ndarray
    y: np.ndarray

    def __repr__(self):
        with np.printoptions(threshold=20, edgeitems=1):
            return f'Plan(t={self.t}, x={self.x}, u={self.u}, y={self.y})'

    @checked(t=NUMBER)
    def at(self, t: float) -> 'Plan':
        """Return the period nearest to a time [s], of those there are, without the first axis."""
        place = min(max(round(t / self.t[1]), 0), len(self.t) - 1)
        return Plan(self.t[place], self.x[place], self.u[place], self.y[place])


def feedforward(model: LinearModel, goal: Mapping[str, float], duration: float | None = None,
                limit: ArrayLike = np.inf, rate_limit: ArrayLike = np.inf) -> Plan:
    """
    Return the Plan of a linear model in discrete time from rest to rest at a goal (T55).

    The goal has values at the end by name of output, `{'shaft_rad': 0.8}`; other outputs are free.
    The duration [s] is a whole multiple of `model.dt`; None is the shortest that the limits allow.
    `limit` is the largest magnitude of the inputs, `rate_limit` that of their rates [1/s], shape
    () or (inputs,). The plan has the least squared changes of the inputs, with which a rigid arm
    moves with least jerk, or the least largest change if those would exceed a limit. Raises
    ParameterError if the duration is too short, with the shortest, or if none is long enough.
    Gives a ModelWarning if the plan bends the arm by more than a fifth of its length.

    Examples
    --------
    >>> import timo_sim
    >>> model = timo_sim.linearize('paper', inputs=['torque_N_m']).to_discrete(0.01)
    >>> plan = timo_sim.feedforward(model, {'shaft_rad': 1.0}, 2.0, limit=15.0)
    >>> abs(plan.u.round(3)).max(axis=0)
    array([15.])

    """
    if not isinstance(model, LinearModel) or model.dt is None:
        raise ParameterError('model must be a LinearModel of discrete time: use model.to_discrete'
                             f'(dt); got {short(model)}')
    if not isinstance(goal, Mapping) or not goal:
        raise ParameterError("goal must have values by name of output, such as {'shaft_rad': 0.8},"
                             f' got {short(goal)}')
    values = _GOAL.check([*goal.values()])
    given = [_LIMITS.check(each) for each in (limit, rate_limit)]
    if {*map(len, given)} - {1, len(model.inputs)}:
        raise ParameterError('limit and rate_limit must be a number, or one for each of '
                             f'{len(model.inputs)} inputs, got {short(limit)} and '
                             f'{short(rate_limit)}')
    limits = np.stack([np.broadcast_to(each, len(model.inputs)) * unit
                       for each, unit in zip(given, (1.0, model.dt))])
    if duration is None and not np.isfinite(limits).any():
        raise ParameterError('duration must be given if nothing is limited, got None')
    low, high = (0, len(model.A)) if duration is None else 2 * [whole_ratio(
        'duration', _DURATION.check(duration), 'dt', model.dt)]
    if low > _LONGEST:
        raise ParameterError(f'duration must be at most {_LONGEST} periods, '
                             f'{_LONGEST * model.dt:g} s, got {duration:g} s')
    inputs = partial(_inputs, model.select(outputs=[*goal]), values, limits)
    while inputs(high) is None:
        low, high = high, 2 * high
        if high > _LONGEST:
            raise ParameterError('goal must be reachable within the limits of the inputs, got '
                                 f'one that takes more than {low * model.dt:g} s: raise the '
                                 'limits')
    if high > low:  # all durations from the shortest on are possible, because a plan may wait
        high = bisect_left(range(high), True, low + 1, key=lambda k: inputs(k) is not None)
        if duration is not None:
            raise ParameterError(f'duration must be at least {high * model.dt:.6g} s to reach the '
                                 f'goal within the limits, got {duration:g} s')
    u = np.vstack([np.zeros(len(model.inputs)), inputs(high)])
    x = np.zeros((len(u), len(model.A)))
    for k in range(len(u) - 1):
        x[k + 1] = model.A @ x[k] + model.B @ u[k]
    bent = 0.0 if model.bend is None else np.abs(x @ model.bend).max()
    if bent > _MOST_BENT:
        warn(f'the plan bends the arm by {bent:.2g} of its length, more than {_MOST_BENT:g}, '
             'where a linear model does not hold: take a longer duration or a lower limit')
    return Plan(model.dt * np.arange(len(u)), x, u, x @ model.C.T + u @ model.D.T)


def _inputs(model, values, limits, steps):
    """Return the inputs from the second period on, (steps, m), or None if there are none."""
    # At the end states change no more, and the outputs are those of the goal.
    of_state = np.vstack([model.A - np.eye(len(model.A)), model.C])
    columns, end = [np.vstack([model.B, model.D])], np.append(np.zeros(len(model.A)), values)
    for _ in range(steps - 1):
        columns.append(of_state @ model.B)
        of_state = of_state @ model.A
    rows = np.hstack(columns[::-1])
    # As orthonormal rows, without those that vanish or depend on others: rows @ u = end.
    scale = np.linalg.norm(rows, axis=1)
    kept = scale > _ROUND_OFF * scale.max()
    impossible, end = end[~kept].any(), end[kept] / scale[kept]
    left, size, rows = np.linalg.svd(rows[kept] / scale[kept, np.newaxis], full_matrices=False)
    kept = size > _DEPENDENT * size[0]
    missed = end - left[:, kept] @ (left[:, kept].T @ end)
    if impossible or np.linalg.norm(missed) > _DEPENDENT * np.linalg.norm(end):
        return None
    rows, end = rows[kept], left[:, kept].T @ end / size[kept]

    of_change = rows.reshape(len(rows), steps, -1)[:, ::-1].cumsum(axis=1)[:, ::-1]
    changes = np.linalg.lstsq(of_change.reshape(rows.shape), end, rcond=None)[0]
    u = changes.reshape(steps, -1).cumsum(axis=0)
    if (np.abs([u, changes.reshape(u.shape)]) <= limits[:, np.newaxis]).all():
        return u

    # The unknowns are u and the largest change, in units in which the norm of `end` is 1.
    unit, zero, one = np.linalg.norm(end), np.zeros(u.size), np.ones((u.size, 1))
    bound, rate = (np.tile(each / unit, steps) for each in limits)
    change = sparse.eye(u.size) - sparse.eye(u.size, k=-u.shape[1])
    rates = sparse.bmat([[change, -one], [-change, -one], [change, None], [-change, None]])
    most = np.concatenate([zero, zero, rate, rate])
    found = linprog(np.append(zero, 1.0), rates.tocsr()[np.isfinite(most)],
                    most[np.isfinite(most)], np.pad(rows, [(0, 0), (0, 1)]), end / unit,
                    [*zip(-bound, bound), (0.0, None)], method='highs-ipm')
    return None if found.status else unit * found.x[:-1].reshape(steps, -1)
