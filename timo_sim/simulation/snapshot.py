# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The motion at one step, and what messages need of it."""

from functools import cached_property
import math

import numpy as np

from timo_sim.messages.outputs import NANOSECONDS
from timo_sim.messages.sensors import SENSORS
from timo_sim.physics.layout import (
    FORCE_I, FORCE_II, FORCE_X, FORCE_Y, place, rotate, TORQUE)
from timo_sim.simulation.joints import joints_of_state
from timo_sim.simulation.sensors import reading, variance

_SENSORS = {sensor.name: (number, sensor) for number, sensor in enumerate(SENSORS)}


class Snapshot:
    """
    The motion at one step; costly quantities are computed on demand.

    Parameters
    ----------
    scene : Scene
    model : Formulation
    step, nanoseconds : int
        Number of the step, and sim time [ns].
    motion : ndarray, shape (2 (3 + N),)
        See `physics.layout`.
    load : list of float, length 14
        Load at the end of the last step, see `physics.layout`.
    acts : tuple of Steps, ndarray (m,) and ndarray (14,), optional
        The time steps, the state and the load that acts, friction included. Accelerations,
        strains and forces of constraints need it; without it `effort` is that of the load.

    Attributes
    ----------
    time : tuple of int
        Sim time in [s] and [ns].

    """

    def __init__(self, scene, model, step, nanoseconds, motion, load, acts=None):
        self._scene, self._model, self._load, self._acts = scene, model, load, acts
        self.step, self.nanoseconds, self.motion = step, nanoseconds, motion
        self.time = divmod(nanoseconds, NANOSECONDS)
        self._values = motion.tolist()
        self._half = len(self._values) // 2

    @property
    def joint_positions(self):
        """Carrier x, y [m] and shaft angle [rad]."""
        return self._values[:3]

    @property
    def joint_velocities(self):
        """Carrier x, y [m/s] and shaft speed [rad/s]."""
        return self._values[self._half:self._half + 3]

    @property
    def modal_state(self):
        """Modal coordinates [m sqrt(kg)], then their rates [m sqrt(kg)/s]."""
        return self._values[3:self._half] + self._values[self._half + 3:]

    @cached_property
    def _joints(self):
        integration, state, acting = self._acts
        return joints_of_state(integration, self.motion, state, acting)

    @property
    def effort(self):
        """
        Forces on the carrier in world axes [N] and torque on the shaft [N m].

        For a free joint those of commands and loads, for others those that hold or drive it.
        """
        load = self._load
        effort = (*place(load[FORCE_X], load[FORCE_Y], self._values[2], load[FORCE_I],
                         load[FORCE_II]), load[TORQUE])
        constrained = self._model.constrained
        if self._acts is None or not constrained.any():
            return effort
        return tuple(np.where(constrained, self._joints.reactions[0], effort).tolist())

    @cached_property
    def tip(self):
        """Position of the tip in the arm frame [m], and its rotation from the shaft [rad]."""
        return self._model.tip(self.motion).tolist()

    @property
    def root_strain(self):
        """Strain of the outer fibre at the root."""
        return float(self._joints.root_strain[0])

    @property
    def tip_turning(self):
        """Angular velocity of the end effector [rad/s]."""
        rotation = self._model.points.rotation[:, -1]
        return self._values[self._half + 2] + float(rotation @ self.motion[self._half + 3:])

    @property
    def tip_acceleration(self):
        """Specific force at the tip, acceleration less gravity, in its axes [m/s2]."""
        integration, state, acting = self._acts
        x, y = (integration.tip_acceleration(state, acting) - self._model.gravity).tolist()
        return rotate(-(self._values[2] + self.tip[2]), x, y)

    def sensor(self, name):
        """Return what a sensor reads, a tuple of float, one for each axis."""
        number, sensor = _SENSORS[name]
        return reading(self._scene.values, name, number, self.step, sensor.quantities(self))

    def variance(self, name):
        """Return the variance of what a sensor reads, on each axis."""
        return variance(self._scene.values, name)

    @cached_property
    def energy(self):
        """Kinetic plus strain energy [J]."""
        return float(self._model.energy(self.motion[np.newaxis])[0])

    @property
    def gravity(self):
        """Gravity in the plane of motion [m/s2]."""
        return math.hypot(*self._model.gravity)

    @property
    def length(self):
        """Length of the arm [m]."""
        return self._model.manipulator.arm.length
