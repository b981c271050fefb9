# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Equal time steps of many models of one size, as lanes (see `compiled.lanes`).

The step is that of `etdrk4`, compiled for vectors of WIDTH floats. Lanes take no branch of their
own: a lane that diverges is computed on and its result thrown away.
"""

from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays, pack, pack_lanes
from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.functions import (
    Array, Constants, inner, local, magnitude, where, WIDTH)
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import copy, observe, tip
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, STAGES, START, STEP_LOADS
from timo_sim.steps.bristles import Bent, Bristles, bristles_of, MEMORY, start_bristles
from timo_sim.steps.etdrk4 import one_step, Work
from timo_sim.steps.steps import matrices_of


class Lane(NamedTuple):
    """What a run has of its own besides the constants of its model and step."""

    tip_travel: Annotated[np.ndarray, 'modes']  # travel of the tip per modal coordinate
    bend_limit: Annotated[np.ndarray, 1]        # deflection beyond which it diverges [m]
    # The part of its load that does not vary within a call, and room for the loads of a step.
    constant_load: Annotated[np.ndarray, LOADS]
    load: Annotated[np.ndarray, STEP_LOADS, LOADS]
    state: Annotated[np.ndarray, 'state']
    friction: Annotated[np.ndarray, MEMORY]     # what steps hand on
    progress: Annotated[np.ndarray, 2]          # whether it is alive, 1 or 0; steps done
    motion: Annotated[np.ndarray, 'motion']     # at the end of the last call
    tip: Annotated[np.ndarray, 3]               # what `model.functions.tip` returns of it


class Plan(NamedTuple):
    """What a call does with all lanes."""

    groups: int
    columns: int  # number of columns of loads that vary
    steps: int
    every: int    # steps between samples; 0: none are taken
    since: int    # steps done since the first sample
    samples: int  # of each group
    tips: int


_TABLES, _MATRICES, _BRISTLES, _LANE, _PLAN = range(5)  # parts of the constants of a call


class LaneSteps:
    """
    Equal steps of n models of one size, in groups of WIDTH.

    The models are of one class, with tables of the same shapes and the same free coordinates. A
    run whose arm is bent by more than `bend_limit` arm lengths counts as diverged. `bristles`,
    (n, 4, 5), are `Scene.bristles` of each. `alike` says that lanes with the same model may share
    its constants, so that none can be changed.

    `constant_load`, `state`, `friction`, `progress`, `motion` and `tip` are fields of `Lane`,
    arrays of shape (groups, ..., WIDTH). `xp` is the library of these arrays.
    """

    width, xp = WIDTH, np
    most_numbers = 2**22  # that the loads of a call to compiled code take

    def __init__(self, models: list[Formulation], step: float, bend_limit: float,
                 bristles: np.ndarray, alike: bool) -> None:
        self.step, self._bristles, self.groups = step, bristles, -(-len(models) // self.width)
        self._models = self._padded(models)
        self._sectors: Any = np.full(len(self._models), -1) if models[0].sectors else None
        self._parts: dict[tuple[Formulation, int | None], Any] = {}
        self._alike = alike and not models[0].sectors and all(
            model is models[0] for model in models)
        self._constants = self._pack(self._models, bend_limit, self._padded(bristles))
        self._name_fields()

    def _padded(self, rows):
        # As many as lanes; the last one fills the rest.
        return [rows[min(lane, len(rows) - 1)]
                for lane in range(-(-len(rows) // self.width) * self.width)]

    def _pack(self, models, bend_limit, bristles):
        lanes, size, step = len(models), models[0].size, self.step
        pack_all = partial(pack_lanes, lanes=self.width)
        if self._alike:
            tables = models[0].pack(models[0].tables, pad=False)
            matrices = pack(matrices_of(models[0].linear, step), pad=False)
        else:
            fields, linear = ([model.tables for model in models],
                              np.array([model.linear for model in models]))
            tables = pack_all(fields[0]._make(np.array(each) for each in zip(*fields)),
                              motion=size, state=linear.shape[-1])
            matrices = pack_all(matrices_of(linear, step))
        lane = pack_all(Lane(
            tip_travel=np.array([model.tip_travel[3:] for model in models]),
            bend_limit=np.array([[bend_limit * model.manipulator.arm.length] for model in models]),
            constant_load=np.zeros((lanes, LOADS)), load=np.zeros((lanes, STEP_LOADS, LOADS)),
            state=np.zeros((lanes, len(models[0].linear))), friction=np.zeros((lanes, MEMORY)),
            progress=np.tile([1.0, 0.0], (lanes, 1)), motion=np.zeros((lanes, size)),
            tip=np.zeros((lanes, 3))))
        packed = pack_all(Bristles._make(bristles_of(models, step, np.array(bristles))))
        return tables, matrices, packed, lane, pack(Plan(*7 * [0]))

    def _fields(self, part):
        # Arrays of all groups, by name, of a part of the constants in which lanes differ.
        return {name: view for name, view in self._constants[part].views.items()
                if view.dtype == float}  # whole numbers are those of all lanes

    def _name_fields(self):
        lane = self._fields(_LANE)
        self.constant_load, self.state = lane['constant_load'], lane['state']
        self.friction, self.progress = lane['friction'], lane['progress']
        self.motion, self.tip = lane['motion'], lane['tip']
        if self._sectors is not None:
            self._bands = self._fields(_TABLES)['bands_per_speed']

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._name_fields()  # the arrays of a copy are parts of its own constants

    @cached_property
    def _advance(self):
        return (advance_alike if self._alike else advance_each).of(*self._constants)

    def host(self, array: Any) -> np.ndarray:
        """Return one of these arrays as one of NumPy."""
        return array

    def make_room(self, number: int) -> None:
        """Raise an error if there is no room for so many numbers in each lane."""

    def room(self, number: int, length: int) -> np.ndarray:
        """Return an array for so many vectors of a length in each lane."""
        return self.xp.empty((self.groups, number, length, self.width))

    def advance(self, columns: np.ndarray, varying: np.ndarray, sample_every: int = 0,
                since: int = 0, samples: np.ndarray | None = None,
                tips: np.ndarray | None = None) -> None:
        """
        Advance all lanes; one that diverges stays at its last good state.

        `columns`, (c,), are those of the load that vary, and `varying`, (groups, 1 + steps, 4, c,
        WIDTH), are these loads as in `etdrk4.advance`; row 0 has only the load at the beginning.
        `samples`, (groups, n, 2 (3 + N), WIDTH), receive motions, see `etdrk4.advance`, and
        `tips`, (groups, rows, 3, WIDTH), what `tip` returns at the start of each of so many steps.
        """
        samples = self.room(0, self.motion.shape[1]) if samples is None else samples
        tips = self.room(0, 3) if tips is None else tips
        if self._sectors is None:
            self._call(columns, varying, sample_every, since, samples, tips)
            return
        # Only between two calls can a lane get the linear part of another sector.
        for k in range(max(1, varying.shape[1] - 1)):
            self._enter_sectors(columns, varying[:, k, AFTER])
            here = self.room(min(1, tips.shape[1]), 3)
            self._call(columns, self.xp.ascontiguousarray(varying[:, k:k + 2]), sample_every,
                       since + k, samples, here)
            tips[:, k:k + 1] = here

    def _enter_sectors(self, columns, varying):
        # Give lanes whose shafts have turned on the linear part of their sector.
        load, states, bands = (self.host(each) for each in (
            self.constant_load.copy(), self.state, self._bands))
        load[:, columns] += self.host(varying)
        load, states = (from_lanes(each, len(self._models)) for each in (load, states))
        now = self._models[0].sector(states, load, bands.ravel())
        lanes = np.flatnonzero(now != self._sectors)
        self._sectors[lanes] = now[lanes]
        self._use(lanes)

    def change_model(self, lane: int, model: Formulation) -> None:
        """Give a lane another model of the same size, such as with another load at the tip."""
        own = range(lane, lane + 1) if lane < len(self._bristles) - 1 else (
            range(lane, len(self._models)))  # the last one fills the rest
        for each in own:
            self._models[each] = model
        self._use(np.array(own))
        bristles = Bristles._make(
            each[0] for each in bristles_of([model], self.step, self._bristles[[lane]]))
        self._write(_BRISTLES, np.array(own), [bristles for _ in own])

    def _use(self, lanes):
        # Write tables and matrices of the present models and sectors of some lanes.
        parts = [self._part(self._models[lane], None if self._sectors is None or
                            self._sectors[lane] < 0 else int(self._sectors[lane]))
                 for lane in lanes]
        for part, fields in zip((_TABLES, _MATRICES), zip(*parts)):
            self._write(part, lanes, fields)

    def _part(self, model, sector):
        key = model, sector
        if key not in self._parts:
            tables, linear = model.in_sector(sector)
            self._parts[key] = tables, matrices_of(linear, self.step)
        return self._parts[key]

    def _write(self, part, lanes, fields):
        for name, array in self._fields(part).items():
            array[lanes // self.width, ..., lanes % self.width] = self.xp.asarray(
                np.array([getattr(each, name) for each in fields]))

    def _plan_call(self, columns, varying, sample_every, since, samples, tips):
        for view, number in zip(self._constants[_PLAN].views.values(), (
                self.groups, len(columns), varying.shape[1] - 1, sample_every, since,
                samples.shape[1], tips.shape[1])):
            view[...] = number

    def _call(self, columns, varying, sample_every, since, samples, tips):
        self._plan_call(columns, varying, sample_every, since, samples, tips)
        self._advance(columns, varying.reshape(-1, WIDTH),
                      samples.reshape(-1, *samples.shape[2:]), tips.reshape(-1, *tips.shape[2:]))


def to_lanes(values: np.ndarray, width: int = WIDTH) -> np.ndarray:
    """Transpose rows (n, ...) to lanes (groups, ..., width), the last one repeated as padding."""
    count = -(-len(values) // width)
    if len(values) % width:
        values = values[np.minimum(np.arange(count * width), len(values) - 1)]
    values = values.reshape(count, width, *values.shape[1:])
    return values.transpose(0, *range(2, values.ndim), 1).copy()


def from_lanes(values: np.ndarray, count: int) -> np.ndarray:
    """Return lanes as rows of an array of its own, shape (count, ...)."""
    rows = values.transpose(0, -1, *range(1, values.ndim - 1))
    if len(rows) == 1:  # else `reshape` copies
        rows = rows.copy()
    return rows.reshape(len(values) * values.shape[-1], *rows.shape[2:])[:count]


@inner
def _set_load(lane, columns, count, varying, place, row):
    for j in range(count):
        lane.load[row, columns[j]] = lane.constant_load[columns[j]] + varying[place + j]


@inner
def _advance(tables, propagator, bristles, lane, plan, columns, varying, samples, tips, group):
    """Integrate one group of lanes over equal steps, see `advance`."""
    work, bent = local_arrays(Work, propagator), local_arrays(Bent, bristles)
    now, following, motion, load = work.now, work.following, local((lane.motion,)), lane.load
    state, travel, count = lane.state, lane.tip_travel, plan.columns
    for row in range(STEP_LOADS):
        copy(lane.constant_load, load[row])
    modal = len(state) // 2 - len(travel)
    alive, done = lane.progress[0], lane.progress[1]
    copy(state, now)
    k = 0
    while True:
        place = (group * (1 + plan.steps) + k) * STEP_LOADS * count
        _set_load(lane, columns, count, varying, place + AFTER * count, AFTER)
        sampled = plan.every > 0 and (plan.since + k) % plan.every == 0
        if sampled or k == plan.steps or len(bristles.reach):
            observe(tables, now, load[AFTER], motion)
            start_bristles(tables, bristles, now, load[AFTER], motion, k > 0, bent, lane.friction)
            if sampled:
                copy(motion, samples[group * plan.samples + (plan.since + k) // plan.every])
        if k == plan.steps:
            break
        for row in range(STAGES):
            _set_load(lane, columns, count, varying, place + (STEP_LOADS + row) * count, row)
        one_step(propagator, tables, bristles, bent, load[START], load[MIDDLE], load[END], work)
        if k < plan.tips:
            for i in range(len(travel)):
                motion[3 + i] = now[modal + i]
            tip(tables, motion, lane.tip)
            copy(lane.tip, tips[group * plan.tips + k])
        # 0 if all numbers are finite, else NaN: no branch is needed to find out.
        not_finite = 0.0
        bend = 0.0
        for i in range(len(now)):
            not_finite += 0.0 * following[i]
        for i in range(len(travel)):
            bend += travel[i] * magnitude(following[modal + i])
        alive = where((not_finite == 0.0) & (bend <= lane.bend_limit[0]), alive, 0.0)
        done += alive
        for i in range(len(now)):
            now[i] = where(alive > 0.0, following[i], now[i])
        k += 1
    copy(now, state)
    copy(motion, lane.motion)
    tip(tables, motion, lane.tip)
    lane.progress[0], lane.progress[1] = alive, done


def advance(tables, propagator, bristles, lane, plan, columns, varying, samples, tips):
    """
    Integrate groups of lanes over equal steps, see `LaneSteps.advance`.

    First axes of arrays are those of groups, merged with the next one where there is one, last
    axes those of lanes.
    """
    for g in range(plan.groups):
        _advance(tables[g], propagator[g], bristles[g], lane[g], plan, columns, varying, samples,
                 tips, g)


def advance_group(tables, propagator, bristles, lane, plan, columns, varying, samples, tips,
                  group):
    """Integrate one group of lanes, see `advance`."""
    _advance(tables[group], propagator[group], bristles[group], lane[group], plan, columns,
             varying, samples, tips, group)


# For lanes with the same packed constants, and for lanes each with its own.
advance_alike, advance_each = (EntryPoint(advance, {
    'tables': Constants(form), 'propagator': Constants(form), 'bristles': Constants('lanes'),
    'lane': Constants('lanes'), 'plan': Constants(),
    'columns': Array((None,), whole=True, own=True), 'varying': Array((None,), lanes=True),
    'samples': Array((None, 'motion'), lanes=True), 'tips': Array((None, 3), lanes=True)}, name)
    for name, form in (('advance_alike', 'shared'), ('advance_each', 'lanes')))
