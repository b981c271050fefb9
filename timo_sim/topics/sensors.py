# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The table of sensors: parameters, topics, quantities of fits, outputs of linear models."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from timo_sim.model.layout import with_unit


class Sensor(NamedTuple):
    """
    A sensor.

    From its entry in `SENSORS` follow the parameters `sensor.NAME.noise`, `.bias` and
    `.resolution`, `Simulator.sensors.NAME`, its topic with rate and delay, and columns in logs.

    Attributes
    ----------
    name, unit, meaning : str
    topic : str
        Of its messages, a `sensor_msgs/msg/JointState`, or the `sensor_msgs/msg/Imu` of `IMU`.
    columns : tuple of str
        Names of its axes in logs, with units.
    read : function(simulation.snapshot.Snapshot) -> sequence of float
        Returns what it measures, a number for each axis.
    of_motion : function(Formulation, ndarray (n, 2 (3 + N))) -> ndarray (n,), or None
        In place of `read`, for a sensor of one axis that the motion alone determines. Such a
        sensor is also a quantity of fits and an output of linear models.
    quantity : str
        Of fits, which its last axis shows; by default its own name with `of_motion`, else none.
    joint : str
        Name in a `JointState`; by default that of the sensor.

    """

    name: str
    unit: str
    meaning: str
    topic: str
    columns: tuple[str, ...]
    read: Callable | None = None
    of_motion: Callable | None = None
    quantity: str = ''
    joint: str = ''

    def quantities(self, snapshot: Any) -> tuple[float, ...]:
        """Return what it measures in a Snapshot, without noise: a number for each axis."""
        if self.of_motion:
            return (float(self.of_motion(snapshot.model, snapshot.motion[np.newaxis])[0]),)
        return tuple(self.read(snapshot)) if self.read else ()

    @property
    def measured(self) -> str:
        """Name of the quantity of fits that it shows, or ''."""
        return self.quantity or (self.name if self.of_motion else '')

    @property
    def output(self) -> str:
        """Name of its output of linear models, with the unit, or ''."""
        return with_unit(self.measured, self.unit) if self.of_motion else ''


IMU = '~/tip_imu/data_raw'
# The random numbers of a sensor depend on its place in this list: append only.
SENSORS = (
    Sensor('root_strain', '', 'the strain of the outer fibre at the root',
           '~/root_strain', ('outer_fibre',),
           lambda snapshot: (snapshot.root_strain,), quantity='root_strain'),
    Sensor('tip_acceleration', 'm/s2', 'either axis of the specific force '
           '(acceleration less gravity) of the tip',
           IMU, ('acceleration_x_m_per_s2', 'acceleration_y_m_per_s2'),
           lambda snapshot: snapshot.tip_acceleration, quantity='tip_acceleration'),
    Sensor('gyro', 'rad/s', 'the angular velocity of the tip',
           IMU, ('turning_rad_per_s',), lambda snapshot: (snapshot.tip_turning,)),
    Sensor('encoder', 'rad', 'the shaft angle',
           '~/encoder', ('shaft_rad',),
           of_motion=lambda model, motions: motions[:, 2], quantity='shaft', joint='shaft'),
)
