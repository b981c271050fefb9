# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equal time steps of many models of one size, as lanes (see `compiled.lanes`)."""

from typing import NamedTuple

import numpy as np

from timo_sim.compiled.constants import local, pack, pack_lanes
from timo_sim.compiled.functions import entry_point, inlined, inner
from timo_sim.compiled.lanes import as_lanes, as_shared, magnitude, where, WIDTH
from timo_sim.model.functions import observe, tip
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, STAGES, START, STEP_LOADS
from timo_sim.steps.etdrk4 import copy, one_step, propagator, Propagator


class Own(NamedTuple):
    """What each lane has of its own besides the constants of its model and step."""

    base: np.ndarray    # the part of its load that does not vary within a call, (LOADS,)
    load: np.ndarray    # room for the loads of a step, (4, LOADS)
    reach: np.ndarray   # travel of the tip per modal coordinate, (N,)
    bent: np.ndarray    # deflection beyond which it diverges [m], (1,)
    motion: np.ndarray  # room for a motion, (2 (3 + N),)


@inner
def _vary(own, columns, varying, row):
    for j in range(len(columns)):
        own.load[row, columns[j]] = own.base[columns[j]] + varying[row, j]


@inlined
def _advance(tables, propagator, own, columns, varying, state, progress, end_motion, end_tip,
             sample_every, done, samples, tips):
    """Integrate some lanes over equal steps, see `advance_each`."""
    size = propagator.whole
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    motion, load = local((own.motion,)), own.load
    for row in range(STEP_LOADS):
        copy(own.base, load[row])
    modal, steps = len(state) // 2 - len(own.reach), len(varying) - 1
    alive, count = progress[0], progress[1]
    copy(state, now)
    for k in range(steps + 1):
        _vary(own, columns, varying[k], AFTER)
        sampled = sample_every > 0 and (done + k) % sample_every == 0
        if sampled or k == steps:
            observe(tables, now, load[AFTER], motion)
            if sampled:
                copy(motion, samples[(done + k) // sample_every])
        if k == steps:
            break
        for row in range(STAGES):
            _vary(own, columns, varying[k + 1], row)
        one_step(tables, propagator, now, load[START], load[MIDDLE], load[END], half, following,
                 combined, rate_0, rate_a, rate_b, rate_c, stage)
        if k < len(tips):
            for i in range(len(own.reach)):
                motion[3 + i] = now[modal + i]
            tip(tables, motion, end_tip)
            copy(end_tip, tips[k])
        spoilt = 0.0
        bend = 0.0
        for i in range(len(now)):
            spoilt += 0.0 * stage[i]
        for i in range(len(own.reach)):
            bend += own.reach[i] * magnitude(stage[modal + i])
        alive = where((spoilt == 0.0) & (bend <= own.bent[0]), alive, 0.0)
        count += alive
        for i in range(len(now)):
            now[i] = where(alive > 0.0, stage[i], now[i])
    copy(now, state)
    copy(motion, end_motion)
    tip(tables, motion, end_tip)
    progress[0], progress[1] = alive, count


@entry_point
def advance_alike(tables, propagator, own, columns, varying, state, progress, motion, place,
                  sample_every, done, samples, tips):
    """Do what `advance_each` does for lanes with the same packed constants."""
    for g in range(len(own)):
        _advance(as_shared(tables), as_shared(propagator), as_lanes(own[g]), columns,
                 as_lanes(varying[g]), as_lanes(state[g]), as_lanes(progress[g]),
                 as_lanes(motion[g]), as_lanes(place[g]), sample_every, done,
                 as_lanes(samples[g]), as_lanes(tips[g]))


@entry_point
def advance_each(tables, propagator, own, columns, varying, state, progress, motion, place,
                 sample_every, done, samples, tips):
    """
    Integrate groups of lanes over equal steps.

    A lane that diverges stays at its last good state, while the others go on.

    Parameters
    ----------
    tables, propagator, own : ndarray, shape (groups,)
        Packed constants of the models, the matrices of their steps, and an `Own`.
    columns : ndarray, shape (c,)
        Columns of the load that vary, see `model.layout`.
    varying : ndarray, shape (groups, 1 + steps, 4, c, WIDTH)
        What varies, as in `etdrk4.advance`; row 0 has only the load at the beginning.
    state : ndarray, shape (groups, m, WIDTH)
        Advanced in place.
    progress : ndarray, shape (groups, 2, WIDTH)
        Whether a lane is alive, 1 or 0, and how many steps it has done; updated.
    motion, place : ndarray, shapes (groups, 2 (3 + N), WIDTH), (groups, 3, WIDTH)
        Receive the motion at the end, and what `tip` returns for it.
    sample_every, done : int
        See `etdrk4.advance`.
    samples : ndarray, shape (groups, n, 2 (3 + N), WIDTH)
        Receives motions.
    tips : ndarray, shape (groups, rows, 3, WIDTH)
        Receives what `tip` returns at the start of each step; of as many steps as it has rows for.

    """
    for g in range(len(own)):
        _advance(as_lanes(tables[g]), as_lanes(propagator[g]), as_lanes(own[g]), columns,
                 as_lanes(varying[g]), as_lanes(state[g]), as_lanes(progress[g]),
                 as_lanes(motion[g]), as_lanes(place[g]), sample_every, done,
                 as_lanes(samples[g]), as_lanes(tips[g]))


def to_lanes(values, numbers=None):
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


def from_lanes(values, count):
    """Return lanes as rows of an array of its own, shape (count, ...)."""
    rows = np.moveaxis(values, -1, 1)
    if len(rows) == 1:  # else `reshape` copies
        rows = rows.copy()
    return rows.reshape(len(values) * WIDTH, *rows.shape[2:])[:count]


def _of_all(tuples):
    # NamedTuples as one, whose arrays have another first axis.
    return tuples[0]._make(np.array(arrays) for arrays in zip(*tuples))


def _turned(linear, step):
    # The matrices of a step, transposed: see `etdrk4.product`.
    return Propagator._make(np.swapaxes(matrix, -1, -2) for matrix in propagator(linear, step))


class LaneSteps:
    """
    Equal steps of n models of one size.

    Parameters
    ----------
    models : list of Formulation
        Of one class, with tables of the same shapes and the same free coordinates.
    step : float
        [s]
    bent : float
        Deflection beyond which a run counts as diverged, in arm lengths.

    Attributes
    ----------
    state : ndarray, shape (groups, m, WIDTH)
    progress : ndarray, shape (groups, 2, WIDTH)
    own : ndarray, shape (groups,)
    motion, tip : ndarray, shapes (groups, 2 (3 + N), WIDTH), (groups, 3, WIDTH)
        See `advance_each`; the motion and tip at the end of the last call.

    """

    def __init__(self, models, step, bent):
        self.count, self.models, self.step = len(models), models, step
        groups = -(-len(models) // WIDTH)
        padded = [models[min(row, len(models) - 1)] for row in range(groups * WIDTH)]
        lanes, size = len(padded), models[0].size
        if all(model is models[0] for model in models):
            self._advance = advance_alike
            self._constants = models[0].packed, pack(_turned(models[0].linear, step))
        else:
            self._advance = advance_each
            linear = np.array([model.linear for model in padded])
            self._constants = (pack_lanes(_of_all([model.tables for model in padded])),
                               pack_lanes(_turned(linear, step)))
        self.own = pack_lanes(Own(
            np.zeros((lanes, LOADS)), np.zeros((lanes, STEP_LOADS, LOADS)),
            np.array([model.reach[3:] for model in padded]),
            np.array([[bent * model.manipulator.arm.length] for model in padded]),
            np.zeros((lanes, size))))
        self.state = np.zeros((groups, len(models[0].linear), WIDTH))
        self.progress, self.motion = np.ones((groups, 2, WIDTH)), np.zeros((groups, size, WIDTH))
        self.tip, self.progress[:, 1] = np.zeros((groups, 3, WIDTH)), 0.0

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [*self._constants, self.own]

    def room(self, number, length):
        """Return an array for so many vectors of a length in each lane."""
        return np.empty((len(self.own), number, length, WIDTH))

    def advance(self, columns, varying, sample_every=0, done=0, samples=None, tips=None):
        """Advance all lanes, see `advance_each`."""
        none = self.room(0, 1)
        self._advance(*self._constants, self.own, columns, varying, self.state, self.progress,
                      self.motion, self.tip, sample_every, done,
                      none if samples is None else samples, none if tips is None else tips)
