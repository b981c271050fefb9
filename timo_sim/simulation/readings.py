# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is read off a simulator: time, motion, sensors, efforts."""

from typing import Any

import numpy as np

from timo_sim.physics.layout import Motion
from timo_sim.simulation.sensors import Sensors
from timo_sim.simulation.snapshot import Snapshot


class Readings:
    """A part of `Simulator`, which sets the attributes."""

    scene: Any
    model: Any
    integration: Any
    steps: int
    load: np.ndarray
    _state: np.ndarray

    @property
    def t(self):
        """Sim time [s]."""
        return self.steps * self.scene.step

    @property
    def nanoseconds(self):
        """Sim time [ns]."""
        return round(self.steps * self.scene.step * 1e9)

    @property
    def motion(self):
        """The motion now, see `Motion`."""
        return Motion(self.integration.motion(self._state, self.load))

    @property
    def sensors(self):
        """What the sensors read now: encoder, root_strain, tip_acceleration, gyro."""
        return Sensors(self.snapshot(state=self._state.copy()))

    @property
    def deflection(self):
        """Deflection of the tip in the arm frame, axial and transverse, shape (2,) [m]."""
        return self.model.tip(self.motion.values)[:2] - [self.model.manipulator.arm.length, 0.0]

    @property
    def effort(self):
        """Efforts of carrier x, y [N] and shaft [N m], shape (3,), see `Snapshot.effort`."""
        return np.array(self.snapshot().effort)

    def snapshot(self, load=None, state=None):
        """Return a Snapshot of now: valid until the next step, or longer with a kept state."""
        load = self.load.tolist() if load is None else load
        acts = (self.integration, self._state if state is None else state,
                self.integration.acting(self.load))
        return Snapshot(self.scene, self.model, self.steps, self.nanoseconds, self.motion.values,
                        load, acts)

    def tip_acceleration(self):
        """Return the tip's acceleration in world axes at the last step's end, (2,) [m/s2]."""
        return self.integration.tip_acceleration(self._state, self.integration.acting(self.load))

    def _bend(self):
        # Deflection by all modes together [m].
        modes, half = self.model.reach[3:], len(self._state) // 2
        return np.abs(self._state[half - len(modes):half]) @ modes
