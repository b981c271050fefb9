# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The loads of coming steps as a table: those of the scene and what the actuators make."""

from timo_sim.physics.integrate.steps import NO_LOADS

_CHUNK, _FEW = 512, 256  # steps whose loads are worked out at once: enough to make that cheap


class LoadTable:
    """
    Loads of steps, counted from the start of the scene's own loads.

    Parameters
    ----------
    scene : Scene

    """

    def __init__(self, scene):
        self._load, self._step = scene.load, scene.step
        self._begin, self._block = 0, NO_LOADS

    def at_start(self):
        """Return the scene's own load at its beginning, shape (14,)."""
        return self._load.stages(0, 1, self._step)[0, 0]

    def stages(self, first, count, parts=1, actuators=None):
        """
        Return what acts in parts of steps.

        Parameters
        ----------
        first, count : int
            Steps.
        parts : int
            Of each step.
        actuators : Actuators, optional
            What acts of the commands.

        Returns
        -------
        ndarray, shape (parts count, 4, 14)

        """
        loads = self._own(first, count) if parts == 1 else self._load.stages(
            parts * first, parts * count, self._step / parts)
        return loads if actuators is None else loads + actuators.loads(first, count, parts)

    def _own(self, first, count):
        begin, block = self._begin, self._block
        if not begin <= first <= first + count <= begin + len(block):
            # A node asks for few at a time.
            ahead = count if count >= _FEW else _CHUNK
            begin, block = first, self._load.stages(first, ahead, self._step)
            self._begin, self._block = begin, block
        return block[first - begin:first - begin + count]
