# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The table of sensors, which says what each measures; parameters and readings follow from it."""

from typing import Callable, NamedTuple


class Sensor(NamedTuple):
    """
    A sensor with noise, bias and resolution of its own (`sensor.NAME.noise` and so on).

    `quantities` reads what it measures off a snapshot, one number for each axis.
    """

    name: str
    unit: str
    meaning: str
    quantities: Callable


# The random numbers of a sensor depend on its place in this list: append only.
SENSORS = (
    Sensor('root_strain', '', 'the strain of the outer fibre at the root',
           lambda snapshot: (snapshot.root_strain,)),
    Sensor('tip_acceleration', 'm/s2', 'either axis of the specific force '
           '(acceleration less gravity) of the tip',
           lambda snapshot: snapshot.tip_acceleration),
    Sensor('gyro', 'rad/s', 'the angular velocity of the tip',
           lambda snapshot: (snapshot.tip_turning,)),
    Sensor('encoder', 'rad', 'the shaft angle',
           lambda snapshot: (snapshot.joint_positions[2],)),
)
