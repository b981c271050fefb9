# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A table of the loads of coming steps: the scene's own, plus those of the actuators."""

import numpy as np

from timo_sim.physics.integrate.steps import CHUNK, NO_LOADS
from timo_sim.physics.layout import LOADS, STEP_LOADS

_FEW = 256  # least number of steps tabulated by themselves; fewer as part of a block of CHUNK


class LoadTable:
    """
    Loads of steps; the steps are counted from the start of the scene's own loads.

    Parameters
    ----------
    scene : Scene

    """

    def __init__(self, scene):
        self._load, self._step = scene.load, scene.step
        self._begin, self._block = 0, NO_LOADS
        self._room = NO_LOADS

    def at_start(self):
        """Return the scene's own load at its beginning, shape (14,)."""
        return self._load.stages(0, 1, self._step)[0, 0]

    def stages(self, first, count, actuators=None):
        """
        Return the loads of steps.

        Parameters
        ----------
        first, count : int
            Number of the first step, and number of steps.
        actuators : Actuators, optional
            Their loads are added.

        Returns
        -------
        ndarray, shape (count, 4, 14)

        """
        begin, block = self._begin, self._block
        if not begin <= first <= first + count <= begin + len(block):
            # A node asks for a few steps at a time, so more are tabulated ahead.
            ahead = count if count >= _FEW else CHUNK
            if len(self._room) < ahead:
                self._room = np.zeros((ahead, STEP_LOADS, LOADS))
            begin, block = first, self._load.stages(first, ahead, self._step, self._room)
            self._begin, self._block = begin, block
        loads = block[first - begin:first - begin + count]
        return loads if actuators is None else loads + actuators.loads(first, count)
