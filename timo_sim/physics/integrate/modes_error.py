# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Estimated tip error by the modes that a model lacks, see doc/theory.md (T39), (T40)."""

import math

import numpy as np

from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.integrate.left_out import LeftOut

_GROWTH = 1.25  # factor by which the strain of the last modes must grow for new `shifts`
_PAUSE = 8192  # steps after which `shifts` are computed without such growth


class ModesError:
    """
    Estimate of what the modes of a model lack, by forces and moments along the arm.

    Strains that are not in the modes shift the tip, and vibrations run ahead, see `LeftOut`.

    Parameters
    ----------
    steps : Steps

    Attributes
    ----------
    tip : float
        Largest estimated distance of the tip from that of a model with more modes, so far [m].
    stretch : float
        Largest shift of the tip so far that the axial force would cause, if the model does not
        stretch [m].

    """

    def __init__(self, steps):
        self._steps, self._model, self.kept = steps, steps.model, steps.kept
        self._left_out = LeftOut([steps.model], steps.kept)
        self.reset()

    def reset(self):
        """Set all errors to zero."""
        self.tip, self._shift, self._strain, self._pause, self._ahead = 0.0, 0.0, 0.0, 0, 0.0
        self.stretch = 0.0

    def go_on(self, earlier):
        """Take over the errors from the estimate for an earlier model of the same size."""
        self.tip, self._shift, self._ahead = earlier.tip, earlier._shift, earlier._ahead

    def look(self, state, load, rate, count):
        """
        Update the estimate by one state.

        Parameters
        ----------
        state : ndarray, shape (m,)
        load : ndarray, shape (14,)
            Load that acts, friction included.
        rate : ndarray, shape (m,)
            Rate of the state, or of the state a step before.
        count : int
            Steps since the last call.

        """
        if not len(self._model.modes):
            return  # without modes the arm is rigid on purpose
        self._pause += count
        self._look_at_shape(self._strains(state), state, load)
        # Amplitudes follow from the rate, to which a constant deflection does not contribute.
        left, ahead = self._vibrations
        self._ahead += count * float(np.abs(left @ rate) @ ahead)
        tip = self._shift + self._ahead
        self.tip = max(self.tip, tip if math.isfinite(tip) else math.inf)

    def look_for_peak(self, states, loads):
        """Update by the most strained of some states, (n, m), under their loads, (n, 14)."""
        if len(self._model.modes):
            strains = self._strains(states)
            peak = np.argmax(strains)
            self._look_at_shape(strains[peak], states[peak], loads[peak])

    def _strains(self, states):
        half = states.shape[-1] // 2
        return self._left_out.strains(states[..., half - len(self._model.modes):half])

    def _look_at_shape(self, strain, state, load):
        if strain > _GROWTH * self._strain or self._pause > _PAUSE:
            self._strain, self._pause = max(strain, self._strain), 0
            bent, stretched = self.shifts(state, load)
            self._shift = max(self._shift, math.hypot(*bent))
            self.stretch = max(self.stretch, math.hypot(*stretched))

    def shifts(self, state, load):
        """
        Return the shifts of the tip along and across the shaft, shape (2, 2) [m].

        The first is that by the strains of bending and shear that are not in the modes; the second
        that by the axial force, if the model does not stretch.
        """
        before, after, half_time = self._steps.flow(state, load)
        return np.concatenate(self._left_out.shifts(before, after, half_time, load[np.newaxis]))

    @kept
    def _vibrations(self):
        errors = self._steps.errors
        return self._left_out.vibrations(self._steps.step, errors.motions, errors.tip_shift)
