# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equal time steps of a model."""

from functools import cached_property

import numpy as np

from timo_sim.model.layout import AFTER, LOADS, STEP_LOADS
from timo_sim.steps import etdrk4
from timo_sim.steps.etdrk4 import flow, propagator


def kept(method):
    """Make a property of a method without arguments, whose value goes to the object's `kept`."""
    def get(self):
        if name not in self.kept:
            self.kept[name] = method(self)
        return self.kept[name]
    name = method.__qualname__
    return property(get, doc=method.__doc__)


NO_LOADS = np.zeros((0, STEP_LOADS, LOADS))
CHUNK = 2048  # most steps at once, for which loads are tabulated


class LinearPart:
    """Packed constants of a model for one linear part, and the matrices of its steps."""

    def __init__(self, pack, packed, linear, step):
        self._pack, self.packed, self.linear = pack, packed, linear
        self._step = step

    @cached_property
    def propagator(self):
        """The matrices of a step, packed constants."""
        return self._pack(propagator(self.linear, self._step))


class Steps:
    """
    Equal steps of a model.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]

    Attributes
    ----------
    memory : ndarray
        What is kept from step to step besides the state; a caller may copy it and put it back.
    kept : dict
        What depends on model and step alone, see `kept`.

    """

    def __init__(self, model, step):
        self.model, self.step = model, step
        self.memory = np.zeros(0)
        self.kept = model.kept(step)
        self._no_samples = np.empty((0, model.size)), np.zeros(0)
        self._constant = np.empty((1, STEP_LOADS, LOADS))
        self._remainder = np.zeros(len(model.linear))

    @property
    def friction(self):
        """Dry friction on carrier x, y [N], shaft [N m] at the end of the last step, (3,)."""
        return np.zeros(3)

    @property
    def heat(self):
        """Heat of dry friction since the initial motion [J]."""
        return 0.0

    def acting(self, load):
        """Return a load plus the dry friction at the end of the last step, shape (LOADS,)."""
        return load

    def reset(self):
        """Forget friction and heat of earlier steps."""
        self.memory[:] = 0.0

    def continue_from(self, earlier):
        """Take over the memory from the steps of a model of the same size."""
        self.memory = earlier.memory

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [self.model.packed, self._part.propagator]

    def warm_up(self, state, load):
        """Compile, or load from disk, the functions that `motion` does not call."""

    def samples(self, count, sample_every):
        """
        Return arrays to be filled with samples of some steps.

        Returns
        -------
        motions : ndarray, shape (1 + count // sample_every, 2 (3 + N))
            For motions at the start and after each `sample_every` steps; if that is 0, empty.
        heat : ndarray, shape (1 + count // sample_every,)
            For the heat of dry friction so far [J].

        """
        if not sample_every:
            return self._no_samples
        size = 1 + count // sample_every
        return np.empty((size, self.model.size)), np.zeros(size)

    def advance(self, state, load, loads, sample_every, sampled, motions, heat):
        """
        Integrate over equal steps.

        Parameters
        ----------
        state : ndarray, shape (m,)
            Advanced in place.
        load : ndarray, shape (LOADS,)
            Load at the start.
        loads : ndarray, shape (count, 4, LOADS)
            Loads of the steps, see `model.layout`.
        sample_every : int
            Steps between samples; 0: none are taken.
        sampled : int
            Number of steps from the first sample to these steps.
        motions, heat : ndarray
            Receive the samples, see `samples`.

        Returns
        -------
        int
            Steps done; fewer than `count` if the state is no longer finite.

        """
        def integrate(part, first, load):
            return first + etdrk4.advance(
                part.packed, part.propagator, state, load, loads[first:], sample_every,
                sampled + first, motions, self._remainder)
        return self._by_sectors(state, load, loads, integrate)

    @kept
    def _part(self):
        return LinearPart(self.model.pack, self.model.packed, self.model.linear, self.step)

    @kept
    def _sectors(self):
        return {}

    def _by_sectors(self, state, load, loads, integrate):
        """
        Integrate, with the linear part of each sector through which the shaft turns.

        `integrate`, a function(LinearPart, int, ndarray) -> int, takes the number of steps done
        and the load there, and returns the new number; a call that does no step is the last.
        """
        done = 0
        while True:
            begun, done = done, integrate(self._part_for(state, load), done, load)
            if not self.model.sectors or done in (begun, len(loads)):
                return done
            load = loads[done - 1, AFTER]

    def _part_for(self, state, load):
        if not self.model.sectors:
            return self._part
        number = self.model.sector(state, load)
        if number not in self._sectors:
            tables, linear = self.model.in_sector(number)
            self._sectors[number] = LinearPart(
                self.model.pack, self.model.pack(tables), linear, self.step)
        return self._sectors[number]

    def rate(self, state, load):
        """Return the rate of a state under a load that acts, linear part included, shape (m,)."""
        part = self._part_for(state, load)
        self._constant[:] = load
        done = etdrk4.advance(part.packed, part.propagator, state.copy(), load, self._constant,
                              0, 0, self._no_samples[0], self._remainder)
        # n is a by-product of a step, so that nothing else is compiled unless the step diverges.
        return part.linear @ state + self._remainder if done else self.model.rate(state, load)

    def motion(self, state, load):
        """Return the motion of a state under a load, shape (2 (3 + N),)."""
        motions, heat = self.samples(0, 1)
        self.advance(state, load, NO_LOADS, 1, 0, motions, heat)
        return motions[0]

    def tip_acceleration(self, state, load):
        """
        Return the tip's acceleration in world axes under a load that acts, shape (2,) [m/s2].

        It is a central difference of the velocity along `flow`, to 1e-9 in ordinary motion.
        """
        before, after, shift = self.flow(state, load)
        model = self.model
        speeds = (model.velocities(side, model.tip_point)[0][0, 0] for side in (after, before))
        return np.subtract(*speeds) / (2.0 * shift[0])

    def flow(self, state, load):
        """Return what `flow` returns of a single state, with k = 1."""
        return flow(self.model, state[np.newaxis], self.rate(state, load)[np.newaxis],
                    load[np.newaxis], self._observe)

    def _observe(self, state, load):
        motions = np.empty((1, self.model.size))
        part = self._part_for(state[0], load[0])
        etdrk4.advance(part.packed, part.propagator, state[0], load[0], NO_LOADS, 1, 0, motions,
                       self._remainder)
        return motions
