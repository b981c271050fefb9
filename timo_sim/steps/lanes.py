# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""
Equal time steps of many models of one size, as lanes (see `compiled.lanes`).

The step is that of `etdrk4`, compiled for vectors of WIDTH floats. Lanes take no branch of their
own: a lane that diverges is computed on and its result thrown away.
"""

from typing import Any, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local, pack, pack_lanes
from timo_sim.compiled.functions import entry_point, inlined, inner
from timo_sim.compiled.lanes import as_lanes, as_shared, magnitude, where, WIDTH
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import observe, tip
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, STAGES, START, STEP_LOADS
from timo_sim.steps.etdrk4 import copy, one_step, propagator, Propagator, work_arrays


class LaneConstants(NamedTuple):
    """What each lane has of its own besides the constants of its model and step."""

    constant_load: np.ndarray  # the part of its load that does not vary within a call, (LOADS,)
    load: np.ndarray           # room for the loads of a step, (4, LOADS)
    tip_travel: np.ndarray     # travel of the tip per modal coordinate, (N,)
    bend_limit: np.ndarray     # deflection beyond which it diverges [m], (1,)
    motion: np.ndarray         # room for a motion, (2 (3 + N),)


class LaneSteps:
    """
    Equal steps of n models of one size.

    Parameters
    ----------
    models : list of Formulation
        Of one class, with tables of the same shapes and the same free coordinates.
    step : float
        [s]
    bend_limit : float
        Deflection beyond which a run counts as diverged, in arm lengths.

    Attributes
    ----------
    state : ndarray, shape (groups, m, WIDTH)
    progress : ndarray, shape (groups, 2, WIDTH)
    lane_constants : ndarray, shape (groups,)
        Of `LaneConstants`.
    motion, tip : ndarray, shapes (groups, 2 (3 + N), WIDTH), (groups, 3, WIDTH)
        See `advance_each`; the motion and tip at the end of the last call.

    """

    def __init__(self, models: list[Formulation], step: float, bend_limit: float) -> None:
        self.count, self.models, self.step = len(models), models, step
        groups = -(-len(models) // WIDTH)
        padded = [models[min(row, len(models) - 1)] for row in range(groups * WIDTH)]
        lanes, size = len(padded), models[0].size
        self._constants: tuple[Any, Any]
        if all(model is models[0] for model in models):
            self._advance = advance_alike
            self._constants = (models[0].packed,
                               pack(_transposed_propagator(models[0].linear, step)))
        else:
            self._advance = advance_each
            tables, linear = ([model.tables for model in padded],
                              np.array([model.linear for model in padded]))
            self._constants = (
                pack_lanes(tables[0]._make(np.array(fields) for fields in zip(*tables))),
                pack_lanes(_transposed_propagator(linear, step)))
        self.lane_constants = pack_lanes(LaneConstants(
            np.zeros((lanes, LOADS)), np.zeros((lanes, STEP_LOADS, LOADS)),
            np.array([model.tip_travel[3:] for model in padded]),
            np.array([[bend_limit * model.manipulator.arm.length] for model in padded]),
            np.zeros((lanes, size))))
        self.state = np.zeros((groups, len(models[0].linear), WIDTH))
        self.progress, self.motion = np.ones((groups, 2, WIDTH)), np.zeros((groups, size, WIDTH))
        self.tip, self.progress[:, 1] = np.zeros((groups, 3, WIDTH)), 0.0

    @property
    def constants(self) -> list[Any]:
        """The packed constants for whose sizes machine code is needed."""
        return [*self._constants, self.lane_constants]

    def room(self, number: int, length: int) -> np.ndarray:
        """Return an array for so many vectors of a length in each lane."""
        return np.empty((len(self.lane_constants), number, length, WIDTH))

    def advance(self, columns: np.ndarray, varying: np.ndarray, sample_every: int = 0,
                since: int = 0, samples: np.ndarray | None = None,
                tips: np.ndarray | None = None) -> None:
        """Advance all lanes, see `advance_each`."""
        none = self.room(0, 1)
        self._advance(*self._constants, self.lane_constants, columns, varying, self.state,
                      self.progress, self.motion, self.tip, sample_every, since,
                      none if samples is None else samples, none if tips is None else tips)


def _transposed_propagator(linear, step):
    # Lanes multiply by columns, see `etdrk4.product`.
    return Propagator._make(np.swapaxes(matrix, -1, -2) for matrix in propagator(linear, step))


def to_lanes(values: np.ndarray, numbers: np.ndarray | None = None) -> np.ndarray:
    """
    Return rows as lanes, (groups, ..., WIDTH); the last row fills the rest.

    Parameters
    ----------
    values : ndarray, shape (rows, ...)
    numbers : ndarray of int, shape (n,), optional
        Numbers of the rows, by default all in order.

    """
    numbers = np.arange(len(values)) if numbers is None else numbers
    count = -(-len(numbers) // WIDTH)
    rows = numbers[np.minimum(np.arange(count * WIDTH), len(numbers) - 1)]
    if len(rows) != len(values) or np.any(rows != np.arange(len(rows))):
        values = values[rows]
    return np.ascontiguousarray(np.moveaxis(
        values.reshape(count, WIDTH, *values.shape[1:]), 1, -1))


def from_lanes(values: np.ndarray, count: int) -> np.ndarray:
    """Return lanes as rows of an array of its own, shape (count, ...)."""
    rows = np.moveaxis(values, -1, 1)
    if len(rows) == 1:  # else `reshape` copies
        rows = rows.copy()
    return rows.reshape(len(values) * WIDTH, *rows.shape[2:])[:count]


@inner
def _set_load(lane, columns, varying, row):
    for j in range(len(columns)):
        lane.load[row, columns[j]] = lane.constant_load[columns[j]] + varying[row, j]


@inlined
def _advance(tables, propagator, lane, columns, varying, state, progress, end_motion, end_tip,
             sample_every, since, samples, tips):
    """Integrate some lanes over equal steps, see `advance_each`."""
    size, work = propagator.whole, work_arrays(propagator)
    now, following = local((size,)), local((size,))
    motion, load = local((lane.motion,)), lane.load
    for row in range(STEP_LOADS):
        copy(lane.constant_load, load[row])
    modal, steps = len(state) // 2 - len(lane.tip_travel), len(varying) - 1
    alive, count = progress[0], progress[1]
    copy(state, now)
    for k in range(steps + 1):
        _set_load(lane, columns, varying[k], AFTER)
        sampled = sample_every > 0 and (since + k) % sample_every == 0
        if sampled or k == steps:
            observe(tables, now, load[AFTER], motion)
            if sampled:
                copy(motion, samples[(since + k) // sample_every])
        if k == steps:
            break
        for row in range(STAGES):
            _set_load(lane, columns, varying[k + 1], row)
        one_step(tables, propagator, now, load[START], load[MIDDLE], load[END], work, following)
        if k < len(tips):
            for i in range(len(lane.tip_travel)):
                motion[3 + i] = now[modal + i]
            tip(tables, motion, end_tip)
            copy(end_tip, tips[k])
        # 0 if all numbers are finite, else NaN: no branch is needed to find out.
        not_finite = 0.0
        bend = 0.0
        for i in range(len(now)):
            not_finite += 0.0 * following[i]
        for i in range(len(lane.tip_travel)):
            bend += lane.tip_travel[i] * magnitude(following[modal + i])
        alive = where((not_finite == 0.0) & (bend <= lane.bend_limit[0]), alive, 0.0)
        count += alive
        for i in range(len(now)):
            now[i] = where(alive > 0.0, following[i], now[i])
    copy(now, state)
    copy(motion, end_motion)
    tip(tables, motion, end_tip)
    progress[0], progress[1] = alive, count


@entry_point
def advance_alike(tables, propagator, lane_constants, columns, varying, state, progress, motion,
                  tip, sample_every, since, samples, tips):
    """Do what `advance_each` does for lanes with the same packed constants."""
    for g in range(len(lane_constants)):
        _advance(as_shared(tables), as_shared(propagator), as_lanes(lane_constants[g]), columns,
                 as_lanes(varying[g]), as_lanes(state[g]), as_lanes(progress[g]),
                 as_lanes(motion[g]), as_lanes(tip[g]), sample_every, since,
                 as_lanes(samples[g]), as_lanes(tips[g]))


@entry_point
def advance_each(tables, propagator, lane_constants, columns, varying, state, progress, motion,
                 tip, sample_every, since, samples, tips):
    """
    Integrate groups of lanes over equal steps.

    A lane that diverges stays at its last good state, while the others go on.

    Parameters
    ----------
    tables, propagator, lane_constants : ndarray, shape (groups,)
        Packed constants of the models, the matrices of their steps, and `LaneConstants`.
    columns : ndarray, shape (c,)
        Columns of the load that vary, see `model.layout`.
    varying : ndarray, shape (groups, 1 + steps, 4, c, WIDTH)
        What varies, as in `etdrk4.advance`; row 0 has only the load at the beginning.
    state : ndarray, shape (groups, m, WIDTH)
        Advanced in place.
    progress : ndarray, shape (groups, 2, WIDTH)
        Whether a lane is alive, 1 or 0, and how many steps it has done; updated.
    motion, tip : ndarray, shapes (groups, 2 (3 + N), WIDTH), (groups, 3, WIDTH)
        Receive the motion at the end, and what `model.functions.tip` returns for it.
    sample_every, since : int
        See `etdrk4.advance`.
    samples : ndarray, shape (groups, n, 2 (3 + N), WIDTH)
        Receives motions.
    tips : ndarray, shape (groups, rows, 3, WIDTH)
        Receives what `tip` returns at the start of each step; of as many steps as it has rows for.

    """
    for g in range(len(lane_constants)):
        _advance(as_lanes(tables[g]), as_lanes(propagator[g]), as_lanes(lane_constants[g]),
                 columns, as_lanes(varying[g]), as_lanes(state[g]), as_lanes(progress[g]),
                 as_lanes(motion[g]), as_lanes(tip[g]), sample_every, since,
                 as_lanes(samples[g]), as_lanes(tips[g]))
