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
_OF_HALVES = 15.0  # difference between a step and its halves, over the error of the halves


class SplitSteps(Steps):
    """
    Steps that are done as a whole and in halves; in more parts where the two differ too much.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]
    tolerance : float
        Largest difference at the tip between a step and its halves; the halves are kept [m].

    Attributes
    ----------
    largest_error : float
        Largest such difference of a step so far, its parts summed up [m].

    """

    least, keeps_states = 1, False

    def __init__(self, model, step, tolerance):
        super().__init__(model, step)
        self.tolerance, self.largest_error = tolerance, 0.0
        self._shift = np.ascontiguousarray(model.tip_shift())

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [self.model.packed, self._part.propagator(), self._part.propagator(1)]

    def warm_up(self, state, load):
        """Compile, or load from disk, the functions that `motion` does not call."""
        self._do(state, load, lambda *span: NO_LOADS, 0, 0, 0, 0, *self.samples(0, 0))

    def _do(self, state, load, tabulate, first, count, sample_every, sampled, motions, heat):
        loads, of_halves = tabulate(first, count, 1), tabulate(first, count, 2)
        done, errors, differences = 0, np.zeros(2), self.errors.rest[1]
        while True:
            done = self._advance_within(
                self.tolerance, 0, state, load, loads, of_halves, done, sample_every, sampled,
                motions, differences, errors)
            if done == count or not self._split(
                    state, load, first + done, tabulate, differences[done], errors):
                break
            load = loads[done, AFTER]
            done += 1
        self.largest_error = max(self.largest_error, errors[0])
        return done, loads[-1, AFTER] if count else load

    def _advance_within(self, tolerance, level, state, load, loads, of_halves, done, *rest):
        return self._by_sectors(
            state, load, loads, done, lambda part, first, load: etdrk4.advance_within(
                part.packed, part.propagator(level), part.propagator(level + 1), self._shift,
                tolerance, state, load, loads, of_halves, first, *rest))

    def _split(self, state, load, number, tabulate, difference, errors):
        """Do one step in parts; return False if its state is not finite."""
        level, none = 0, np.empty((0, self.model.size))
        while True:
            # Each of twice as many parts has 1/32 of the error, all together 1/16.
            excess = errors[1] / self.tolerance * 2**level
            level += max(1, math.ceil(math.log2(excess) / 4.0)) if math.isfinite(excess) else 1
            level = min(level, FINEST)
            parts, trial, of_parts = 2**level, state.copy(), np.zeros(2)
            differences = np.empty((parts, len(state)))
            tolerance = math.inf if level == FINEST else self.tolerance / parts
            done = self._advance_within(
                tolerance, level, trial, load, tabulate(number, 1, parts),
                tabulate(number, 1, 2 * parts), 0, 0, 0, none, differences, of_parts)
            errors[1] = of_parts[1]
            if done == parts:
                break
            if level == FINEST:
                return False
        state[:], difference[:] = trial, differences.sum(axis=0)
        self.splits += 1
        error = parts * of_parts[0]
        self.unresolved += int(error > _OF_HALVES * self.tolerance)
        errors[0] = max(errors[0], error)
        return True

    def follow_errors(self, error, states, rates, load, weight):
        """Follow the error by the differences between steps and halves, see `Steps`."""
        error.add(weight / _OF_HALVES * rates[:-1])
        return error.error[np.newaxis], [len(rates) - 1]
