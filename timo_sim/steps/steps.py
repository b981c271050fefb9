# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Equal time steps of one run: what calls the compiled step, and knows its linear parts."""

import functools
from typing import NamedTuple

import numpy as np

from timo_sim.compiled.constants import pack, Packed
from timo_sim.compiled.entry import Call
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import AFTER, LOADS, STEP_LOADS
from timo_sim.steps import etdrk4
from timo_sim.steps.bristles import (
    Bristles, BRISTLES, bristles_of, MEMORY, memory_at, REACH, SLOW, swing_of, UNITS)
from timo_sim.steps.etdrk4 import propagator

NO_LOADS = np.zeros((0, STEP_LOADS, LOADS))
CHUNK = 2048  # most steps at once, for which loads are tabulated


def matrices_of(linear: np.ndarray, step: float) -> NamedTuple:
    """Return the constants of `one_step`, transposed for `product`; their kind is the method."""
    return propagator(linear.swapaxes(-1, -2), step)


class Samples(NamedTuple):
    """Motions at equal distances in time, and what friction took until then; filled by steps."""

    every: int           # steps between samples; 0: none are taken
    motions: np.ndarray  # at the start and after each `every` steps, (n, 2 (3 + N))
    heat: np.ndarray     # energy that dry friction has taken since the initial motion [J], (n,)


@functools.cache
def _frictionless(gears):
    # Of these constants no code is left.
    none = np.zeros((0, 2))
    return pack(Bristles(step=0.0, joint=none[:, 0], stiffness=none, reach=none[:, 0],
                         stribeck=none, lead=0.0, gear=np.zeros(gears), place=0))


class Steps:
    """
    Equal steps of a model, of a length in seconds, with the dry friction of `Scene.bristles`.

    `memory` is what one step hands to the next besides the state; a caller may copy it and put it
    back.
    """

    def __init__(self, model: Formulation, step: float,
                 bristles: np.ndarray = np.zeros((BRISTLES, SLOW + 1))) -> None:
        self.model, self.step = model, step
        self.memory = np.zeros(MEMORY)
        self._friction = bristles if bristles[:, REACH].any() else None
        self.bristles = _frictionless(len(model.gear_row)) if self._friction is None else pack(
            Bristles._make(each[0] for each in bristles_of([model], step, bristles[np.newaxis])))
        self._swing = swing_of(model, bristles)
        # By the number of a sector, None without; all steps of this length share parts.
        self._parts, self._advance = model.linear_parts(step), dict[tuple, Call]()
        self._no_samples = Samples(0, np.empty((0, model.size)), np.zeros(0))
        self._now = Samples(1, np.empty((1, model.size)), np.zeros(1))  # room for `motion`

    def __getstate__(self):
        return {**vars(self), '_parts': None, '_advance': {}}

    def __setstate__(self, state):
        self.__dict__.update(state, _parts=state['model'].linear_parts(state['step']))

    def acting(self, load: np.ndarray) -> np.ndarray:
        """Return a load plus the dry friction at the end of the last step, shape (LOADS,)."""
        return load + self.memory[:BRISTLES] @ UNITS if self._friction is not None else load

    def reset(self, motion: np.ndarray) -> None:
        """Begin with a motion, (2 (3 + N),), without heat."""
        self.memory[:] = 0.0
        if self._friction is not None:
            self.memory[:] = memory_at(self._friction, self._swing, motion[
                len(motion) // 2:] @ self.model.joint_turns)

    def continue_from(self, earlier: 'Steps') -> None:
        """Take over the memory from the steps of a model of the same size."""
        self.memory = earlier.memory

    def samples(self, count: int, every: int) -> Samples:
        """Return room for samples of `count` steps, at the start and after each `every` steps."""
        if not every:
            return self._no_samples
        size = 1 + count // every
        return Samples(every, np.empty((size, self.model.size)), np.zeros(size))

    def advance(self, state: np.ndarray, load: np.ndarray, loads: np.ndarray, samples: Samples,
                since: int = 0) -> int:
        """
        Integrate over the steps of `loads`, (count, 4, LOADS), see `model.layout`.

        The state, (m,), is advanced in place, `load`, (LOADS,), is that at the start. `samples`
        receive those of these steps, which begin `since` steps after the first sample. Return the
        steps done; fewer than `count` if the state is no longer finite.
        """
        done = 0
        while True:
            following = loads[done:] if done else loads
            count = self._call(self.model.sector(state, load))(
                self.memory, state, load, following, len(following), samples.every, since + done,
                samples.motions, samples.heat)
            done += count
            if not self.model.sectors or not count or done == len(loads):
                return done
            load = loads[done - 1, AFTER]  # the shaft has turned into another sector

    def _call(self, sector, steps=True):
        # Each is called with the same arrays again, which is fast: `Call` knows them.
        key = sector, steps
        if key not in self._advance:
            self._advance[key] = etdrk4.advance.of(*self.part(sector), self.bristles)
        return self._advance[key]

    def part(self, sector: int | None) -> tuple[Packed, Packed]:
        """
        Return constants of the compiled functions: tables of a sector, matrices of its steps.

        They are made at their first use; None: those of the model.
        """
        if sector not in self._parts:
            tables, linear = self.model.in_sector(sector)
            packed = self.model.packed if sector is None else self.model.pack(tables)
            self._parts[sector] = packed, pack(matrices_of(linear, self.step))
        return self._parts[sector]

    def motion(self, state: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return the motion of a state under a load, shape (2 (3 + N),)."""
        _, motions, heat = self._now
        self._call(self.model.sector(state, load), steps=False)(
            self.memory, state, load, NO_LOADS, 0, 1, 0, motions, heat)
        return motions[0].copy()
