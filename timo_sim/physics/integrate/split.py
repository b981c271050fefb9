# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Steps that are split until their estimated error is below a tolerance."""

import math

import numpy as np

from timo_sim.physics.integrate import etdrk4
from timo_sim.physics.integrate.steps import NO_LOADS, Steps
from timo_sim.physics.layout import AFTER

# A step is done in 2^(1 + FINEST) parts at most.
FINEST = 5


class SplitSteps(Steps):
    """
    Steps that are done as a whole and in halves; where these differ, in more parts.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]
    tolerance : float
        Largest estimated error of a step [m].

    """

    def __init__(self, model, step, tolerance):
        super().__init__(model, step)
        self.tolerance = tolerance

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [self.model.packed, self.propagator(), self.propagator(1)]

    def warm_up(self, state, load):
        """Compile, or load from disk, what is called besides `motion`."""
        self.advance(state, load, lambda *span: NO_LOADS, 0, 0)

    def advance(self, state, load, tabulate, first, count, sample_every=0):
        """Integrate, each step in as many parts as the tolerance asks for, see `Steps`."""
        loads, of_halves = tabulate(first, count, 1), tabulate(first, count, 2)
        end = loads[-1, AFTER] if count else load
        motions, heat = self.samples(count, sample_every)
        errors, done = np.zeros(2), 0
        while True:
            done = self._advance_within(
                self.tolerance, 0, state, load, loads, of_halves, done, sample_every, motions,
                errors)
            if done == count or not self._split(state, load, first + done, tabulate, errors):
                break
            load = loads[done, AFTER]
            done += 1
        self.largest_error = max(self.largest_error, errors[0])
        return done, end, motions, heat

    def _advance_within(self, tolerance, level, state, load, *rest):
        return etdrk4.advance_within(
            self.model.packed, self.propagator(level), self.propagator(level + 1),
            self.shift, tolerance, state, load, *rest)

    def _split(self, state, load, number, tabulate, errors):
        """Do one step in parts; return whether the state is still finite."""
        level, none = 0, np.empty((0, self.model.size))
        while True:
            # Of parts half as large each makes 1/32 of the error, all together 1/16.
            excess = errors[1] / self.tolerance * 2**level
            level += max(1, math.ceil(math.log2(excess) / 4.0)) if math.isfinite(excess) else 1
            level = min(level, FINEST)
            parts, trial, of_parts = 2**level, state.copy(), np.zeros(2)
            tolerance = math.inf if level == FINEST else self.tolerance / parts
            done = self._advance_within(
                tolerance, level, trial, load, tabulate(number, 1, parts),
                tabulate(number, 1, 2 * parts), 0, 0, none, of_parts)
            errors[1] = of_parts[1]
            if done == parts:
                break
            if level == FINEST:
                return False
        state[:] = trial
        self.splits += 1
        error = parts * of_parts[0]
        self.unresolved += int(error > self.tolerance)
        errors[0] = max(errors[0], error)
        return True
