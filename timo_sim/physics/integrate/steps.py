# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equal time steps of a model, with an estimate of their error."""

import numpy as np

from timo_sim.physics.integrate import etdrk4
from timo_sim.physics.integrate.flow import flow
from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.integrate.propagator import propagators
from timo_sim.physics.integrate.run_error import RunError
from timo_sim.physics.layout import AFTER, LOADS, START, STEP_LOADS

NO_LOADS = np.zeros((0, STEP_LOADS, LOADS))
_LONG = 64  # least number of steps at once whose most strained state is worth a look


class LinearPart:
    """Packed constants of a model for one linear part, and the matrices of its steps."""

    def __init__(self, pack, packed, linear, step):
        self._pack, self.packed, self.linear = pack, packed, linear
        self._step, self._propagators = step, {}

    def propagator(self, level=0):
        """Return the matrices of a step divided by 2^level, packed constants."""
        if level not in self._propagators:
            pair = propagators(self.linear, self._step / 2**level)
            for number, matrices in enumerate(pair, start=level):
                self._propagators[number] = self._pack(matrices)
        return self._propagators[level]


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
    errors : RunError
        Estimated error of the steps so far.
    kept : dict
        What depends on model and step alone, see `kept`.

    """

    keeps_states = True  # whether y and n of (T38) at each step's start go to `errors.rest`

    def __init__(self, model, step):
        self.model, self.step = model, step
        self.memory = np.zeros(0)
        self.kept = model.kept(step)
        self._no_samples = np.empty((0, model.size)), np.zeros(0)
        self.errors, self._constant = RunError(self), np.empty((1, STEP_LOADS, LOADS))

    @property
    def friction(self):
        """Dry friction on carrier x, y [N], shaft [N m] at the end of the last step, (3,)."""
        return np.zeros(3)

    @property
    def heat(self):
        """Heat of dry friction since the initial motion [J]."""
        return 0.0

    @property
    def friction_drift(self):
        """Drift of joints in steps with events of friction, summed up, as at the tip [m]."""
        return 0.0

    def acting(self, load):
        """Return a load plus the dry friction at the end of the last step, shape (14,)."""
        return load

    def reset(self):
        """Forget friction, heat and errors of earlier steps."""
        self.memory[:] = 0.0
        self.errors.reset()

    def follow(self, earlier):
        """Take over memory and errors from the steps of a model of the same size."""
        self.memory = earlier.memory
        self.errors.go_on(earlier.errors)

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [self.model.packed, self._part.propagator()]

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

    def advance(self, state, load, tabulate, first, count, sample_every, sampled, motions, heat):
        """
        Integrate over equal steps, at most `errors.room`.

        Parameters
        ----------
        state : ndarray, shape (m,)
            Advanced in place.
        load : ndarray, shape (14,)
            Load at the start.
        tabulate : function(int, int, int) -> ndarray
            Takes the number of the first step, the number of steps and the parts of each; returns
            the loads of these parts, shape (parts count, 4, 14), see `physics.layout`.
        first, count : int
            Number of the first step, and number of steps.
        sample_every : int
            Steps between samples; 0: none are taken.
        sampled : int
            Number of steps from the first sample to the step `first`.
        motions, heat : ndarray
            Receive the samples, see `samples`.

        Returns
        -------
        done : int
            Steps done; fewer than `count` if the state is no longer finite.
        load : ndarray, shape (14,)
            Load at the end of step `first + count - 1`, done or not.

        """
        done, load = self._do(state, load, tabulate, first, count, sample_every, sampled, motions,
                              heat)
        self.errors.count(done, state, load)
        return done, load

    def _do(self, state, load, tabulate, first, count, *samples):
        loads = tabulate(first, count, 1)
        done = self._integrate(state, load, loads, *samples)
        if done >= _LONG and self.keeps_states:
            self.errors.modes.look_for_peak(self.errors.rest[0][:done], loads[:done, START])
        return done, loads[-1, AFTER].copy() if count else load

    def _integrate(self, state, load, loads, sample_every, sampled, motions, heat):
        return self._step(0, state, load, loads, sample_every, sampled, motions,
                          *self.errors.rest)

    def _step(self, level, state, load, loads, sample_every, sampled, motions, states, rates):
        def integrate(part, first, load):
            done = first + etdrk4.advance(
                part.packed, part.propagator(level), state, load, loads[first:], sample_every,
                sampled + first, motions, states[first:], rates[first:])
            if part is not self._part:  # n is kept for the linear part of the whole model
                rates[first:done] += states[first:done] @ (part.linear - self.model.linear).T
            return done
        return self._by_sectors(state, load, loads, 0, integrate)

    @kept
    def _part(self):
        return LinearPart(self.model.pack, self.model.packed, self.model.linear, self.step)

    @kept
    def _sectors(self):
        return {}

    def _by_sectors(self, state, load, loads, done, integrate):
        """
        Integrate, with the linear part of each sector through which the shaft turns.

        `integrate`, a function(LinearPart, int, ndarray) -> int, takes the number of steps done
        and the load there, and returns the new number; a call that does no step is the last.
        """
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

    def follow_errors(self, error, states, rates, load, weight):
        """
        Follow the error of the state over steps, from what `advance` has kept of them.

        Parameters
        ----------
        error : GlobalError
        states, rates : ndarray, shape (steps + 1, m)
            y and n of (T38) at the start of each step and at the end; the last n is not set yet.
        load : ndarray, shape (14,)
            Load at the end of these steps.
        weight : float
            See `GlobalError.follow`.

        Returns
        -------
        errors : ndarray, shape (k, m)
            At some boundaries between steps.
        numbers : list of int
            Numbers of these boundaries.

        """
        # n at the end, under the load of these steps, is a by-product of one step more.
        self._constant[:] = load
        self.step_once(0, states[-1].copy(), self._constant, states[-1:], rates[-1:])
        return error.follow(states, rates, weight)

    def step_once(self, level, state, loads, states=None, rates=None):
        """Advance a state in place by steps divided by 2^level under their loads."""
        if states is None:
            states, rates = np.empty((2, len(loads), len(state)))
        self._step(level, state, loads[0, START], loads, 0, 0, self._no_samples[0], states, rates)

    def rate(self, state, load):
        """Return the rate of a state under a load that acts, linear part included, shape (m,)."""
        part, (states, rates) = self._part_for(state, load), np.empty((2, 1, len(state)))
        self._constant[:] = load
        done = etdrk4.advance(part.packed, part.propagator(), state.copy(), load, self._constant,
                              0, 0, self._no_samples[0], states, rates)
        # n is a by-product of a step, so that nothing else is compiled unless the step diverges.
        return part.linear @ state + rates[0] if done else self.model.rate(state, load)

    def motion(self, state, load):
        """Return the motion of a state under a load, shape (2 (3 + N),)."""
        motions, heat = self.samples(0, 1)
        self._integrate(state, load, NO_LOADS, 1, 0, motions, heat)
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
        self._step(0, state[0], load[0], NO_LOADS, 1, 0, motions, *self.errors.rest)
        return motions
