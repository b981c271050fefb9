# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Equal time steps of a model, as they are, and an estimate of their error."""

import math

import numpy as np

from timo_sim.jit.constants import pack
from timo_sim.physics.integrate import etdrk4
from timo_sim.physics.integrate.propagator import propagators
from timo_sim.physics.layout import ACCELERATION, ANGLE, LOADS, SPEED, STAGES

NO_LOADS = np.zeros((0, STAGES, LOADS))
# Error per second of sim time that needs a warning, in arm lengths.
_ALARMING = 1e-3
# From a load at start, middle and end of a step to the same of its halves: a parabola.
_HALVES = np.array([[1.0, 0.0, 0.0], [0.375, 0.75, -0.125], [0.0, 1.0, 0.0],
                    [0.0, 1.0, 0.0], [-0.125, 0.75, 0.375], [0.0, 0.0, 1.0]])
# Half-width of the central difference of velocities, as the turn of the fastest section [rad];
# truncation (its square) balances round-off.
_TURN = 1e-5


class Steps:
    """
    Equal steps of a model, each done once.

    Errors of steps are shifts of the tip (`Formulation.tip_shift`).

    Parameters
    ----------
    model : Formulation
    step : float
        [s]

    Attributes
    ----------
    memory : ndarray
        What is kept from step to step besides the state; a caller may copy it and put it back.
    largest_error : float
        Largest estimated error of a step so far [m].
    splits : int
        Steps that were split.
    unresolved : int
        Steps whose error was above the tolerance in the smallest parts, too.

    """

    tolerance = 0.0

    def __init__(self, model, step):
        self.model, self.step = model, step
        self.memory = np.zeros(0)
        self.largest_error, self.splits, self.unresolved = 0.0, 0, 0
        self.shift = np.ascontiguousarray(model.tip_shift())
        self._propagators = {}
        self._no_samples = np.empty((0, model.size)), np.zeros(0)
        self._alarming = _ALARMING * model.manipulator.arm.length * step

    @property
    def friction(self):
        """Friction on carrier x, y [N], shaft [N m] at the end of the last step, shape (3,)."""
        return np.zeros(3)

    @property
    def heat(self):
        """What Coulomb friction has made of work since the initial motion [J]."""
        return 0.0

    @property
    def friction_drift(self):
        """How far joints drifted in steps with events of friction, summed up, at the tip [m]."""
        return 0.0

    def acting(self, load):
        """Return a load with what friction adds to it, shape (14,)."""
        return load

    def follow(self, earlier):
        """Go on counting where the steps of an earlier model of the same size have ended."""
        self.memory, self.largest_error = earlier.memory, earlier.largest_error
        self.splits, self.unresolved = earlier.splits, earlier.unresolved

    def propagator(self, level=0):
        """Return the matrices of a step divided by 2^level, packed constants."""
        if level not in self._propagators:
            pair = propagators(self.model.linear, self.step / 2**level)
            for number, matrices in enumerate(pair, start=level):
                self._propagators[number] = pack(matrices)
        return self._propagators[level]

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [self.model.packed, self.propagator()]

    def warm_up(self, state, load):
        """Compile, or load from disk, what is called besides `motion`."""

    def advance(self, state, load, tabulate, first, count, sample_every=0):
        """
        Integrate over equal steps.

        Parameters
        ----------
        state : ndarray, shape (m,)
            Advanced in place.
        load : ndarray, shape (14,)
            Load at the start.
        tabulate : function(int, int, int) -> ndarray
            Returns the loads of parts of steps: from the number of the first step, the number of
            steps and the parts of each, shape (parts count, 3, 14).
        first, count : int
        sample_every : int
            Steps between samples; 0: none are taken.

        Returns
        -------
        done : int
            Steps done; fewer than `count` if the state is no longer finite.
        load : ndarray, shape (14,)
            Load at the end of the last of all steps.
        motions : ndarray, shape (1 + count // sample_every, 2 (3 + N))
            At the start and after each `sample_every` steps; with sample_every = 0 empty.
        heat : ndarray, shape (1 + count // sample_every,)
            What Coulomb friction has made of work so far, at the samples [J].

        """
        loads = tabulate(first, count, 1)
        motions, heat = self.samples(count, sample_every)
        done = self._integrate(state, load, loads, sample_every, motions, heat)
        return done, loads[-1, -1] if count else load, motions, heat

    def samples(self, count, sample_every):
        """Return room for motions and heat at the samples of some steps."""
        if not sample_every:
            return self._no_samples
        size = 1 + count // sample_every
        return np.empty((size, self.model.size)), np.zeros(size)

    def _integrate(self, state, load, loads, sample_every, motions, heat):
        return etdrk4.advance(self.model.packed, self.propagator(), state, load, loads,
                              sample_every, motions)

    def motion(self, state, load):
        """Return the motion of a state under a load, shape (2 (3 + N),)."""
        motions, heat = self.samples(0, 1)
        self._integrate(state, load, NO_LOADS, 1, motions, heat)
        return motions[0]

    def estimate_error(self, state, loads):
        """
        Estimate the error of a step: it is done as a whole and in halves, on copies.

        Parameters
        ----------
        state : ndarray, shape (m,)
            At its start.
        loads : ndarray, shape (1, 3, 14)
            Of the step; those of its halves are interpolated.

        Returns
        -------
        error : float
            [m]; inf if the step diverges.
        alarming : bool
            Whether after a second of such steps the tip would be off by `_ALARMING` arm lengths.

        """
        ends, none = [], np.empty((0, self.model.size))
        for level, parts in enumerate((loads, (_HALVES @ loads[0]).reshape(2, *loads.shape[1:]))):
            end = state.copy()
            done = etdrk4.advance(self.model.packed, self.propagator(level), end, parts[0, 0],
                                  parts, 0, none)
            if done < len(parts):
                return math.inf, True
            ends.append(end)
        error = float(np.abs(self.shift @ (ends[0] - ends[1])).sum())
        self.largest_error = max(self.largest_error, error)
        return error, not error <= self._alarming

    def tip_acceleration(self, state, load):
        """
        Return the tip's acceleration in world axes under what is acting, shape (2,) [m/s2].

        The difference of its velocity along the flow, good to 1e-9 in ordinary motion.
        """
        motions, shift = self.flow(state, load)
        before, after = self.model.velocities(motions, self.model.tip_point)[0][:, 0]
        return (after - before) / (2.0 * shift)

    def flow(self, state, load):
        """Return motions just before and after a state, (2, 2 (3 + N)), half their time [s]."""
        model, drift = self.model, np.zeros(LOADS)
        drift[ANGLE], drift[SPEED] = load[SPEED], load[ACCELERATION]
        rate, half = model.rate(state, load), model.size // 2
        speed = self._observe(state, load)[half + 2:]
        turning = np.abs(speed[0] + speed[1:] @ model.points.rotation).max()
        shift = _TURN / (_TURN + turning)
        return np.array([self._observe(state + side * rate, load + side * drift)
                         for side in (-shift, shift)]), shift

    def _observe(self, state, load):
        motions = np.empty((1, self.model.size))
        etdrk4.advance(self.model.packed, self.propagator(), state, load, NO_LOADS, 1, motions)
        return motions[0]
