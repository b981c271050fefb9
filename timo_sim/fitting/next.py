# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Which record to take next: the input that would narrow the widest interval of a fit most."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import Problem
from timo_sim.fitting.record import Channel, DRIVE, Record
from timo_sim.model.layout import INPUTS
from timo_sim.runs.modes import frequencies_in_motion
from timo_sim.scene.parameters import Parameter, ParameterError
from timo_sim.scene.scene import Scene

_LIMIT = Parameter('limit', 1.0, '', '', low=0.0, open_low=True)
_MOST_SAMPLES = 10**7  # of an input
_WEAKEST = 1e-6  # information on each coordinate, so that unidentified ones have an interval
_BAND = 0.2, 1.3  # ends of a band of frequencies, relative to the first and second of the scene


class NextInput(NamedTuple):
    """
    An input for the next record, and what a fit to it and the records so far would gain.

    `ratios` has, by parameter, its interval with the new record over that without it; `widest` is
    the parameter with the widest interval so far, relative to its value if it is positive.
    """

    kind: str           # step, chirp, multisine, or `again`: as in the first record
    quantity: str
    t: np.ndarray       # (n,) [s]
    values: np.ndarray  # (n,)
    widest: str
    ratios: dict[str, float]


def next_inputs(objective: Objective, x: np.ndarray, information: np.ndarray, scene: Scene,
                limit: float | None, duration: float | None) -> list[NextInput]:
    """Return inputs after a fit that ended at x, the most useful first, see `Fit.next_input`."""
    first, size = objective.problems[0], len(objective.free)
    quantity = next((name for name in first.record.inputs if name != DRIVE), None)
    if quantity is None:
        raise ParameterError('the next input needs a first record with an input other than drive')
    channel = first.record.inputs[quantity]
    limit = np.abs(channel.values).max() if limit is None else _LIMIT.check(limit)
    name = next(each.limit for each in INPUTS if each.name == quantity)
    limit = min(limit, scene.values[name] if name else limit)
    period = first.record.period
    rule = Parameter('duration', 1.0, 's', '', low=0.0, high=_MOST_SAMPLES * period, open_low=True)
    duration = first.record.duration if duration is None else rule.check(duration)
    t = period * np.arange(round(duration / period) + 1)
    before = _deviations(information)
    shared = [k for k, free in enumerate(objective.free) if not free.is_own]
    widest = objective.free[max(shared or range(size), key=before.__getitem__)].name
    again, found = np.clip(np.interp(t, channel.t, channel.values), -limit, limit), []
    for kind, signal in {**_signals(t, limit, scene), 'again': again}.items():
        record = Record.of({quantity: Channel(t, signal, hold=channel.hold)}, {
            name: (t, np.zeros(len(t))) for name in first.record.outputs})
        new = Objective([Problem(scene, record, [free.name for free in first.free], {},
                                 record.duration)])
        new.deviations = objective.deviations[:1]
        jacobian = new.jacobian(x[objective.places[0]])
        # Biases and the initial state of the new record are its own: they come behind.
        places = [size + k if free.is_own else place
                  for k, (free, place) in enumerate(zip(new.free, objective.places[0]))]
        both = np.pad(information, (0, len(new.free)))
        both[np.ix_(places, places)] += jacobian.T @ jacobian
        found.append(NextInput(
            kind=kind, quantity=quantity, t=t, values=signal, widest=widest,
            ratios=dict(zip([free.name for free in objective.free],
                            _deviations(both)[:size] / before))))
    return sorted(found, key=lambda each: each.ratios[widest])


def _deviations(information):
    return np.sqrt(np.diag(np.linalg.inv(information + _WEAKEST * np.eye(len(information)))))


def _signals(t, limit, scene):
    """Return signals within a limit, (n,), by kind."""
    duration, frequencies = t[-1], [*frequencies_in_motion(scene)[:2]] or [5.0 / t[-1]]
    high = min(_BAND[1] * frequencies[-1], 0.25 / (t[1] - t[0]))
    low = min(max(_BAND[0] * frequencies[0], 1.0 / duration), high)
    lines = np.arange(round(low * duration), round(high * duration) + 1) / duration
    k = np.arange(len(lines))
    phases = -np.pi * k * (k + 1) / len(k)  # Schroeder's, for low peaks
    many = np.sin(2.0 * np.pi * np.outer(t, lines) + phases).sum(axis=1)
    return {'step': limit * np.select([t < 0.25 * duration, t < 0.5 * duration], [1.0, -1.0]),
            'chirp': limit * np.sin(2.0 * np.pi * (low + 0.5 * (high - low) / duration * t) * t),
            'multisine': limit * many / np.abs(many).max()}
