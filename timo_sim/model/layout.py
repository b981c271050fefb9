# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Layout of the arrays for loads and motions, and rotations of the plane."""

from dataclasses import dataclass
import math

import numpy as np

# Columns of a load: forces on the carrier in world axes and in the shaft's axes [N], torque on the
# shaft [N m]; forces on the tip likewise [N], torque on the end effector [N m]; angle, speed and
# acceleration of a driven shaft [rad], [rad/s], [rad/s2]; voltage at a DC motor [V], of which the
# equations see only the torque.
(FORCE_X, FORCE_Y, FORCE_I, FORCE_II, TORQUE, TIP_X, TIP_Y, TIP_I, TIP_II, TIP_TORQUE,
 ANGLE, SPEED, ACCELERATION, VOLTAGE) = range(14)
LOADS = 14
# Rows of the loads of a step: three that its stages see, then the true load at its end.
START, MIDDLE, END, AFTER = range(4)
STAGES, STEP_LOADS = 3, 4


class MotionFields:
    """
    Names for the parts of a motion; a mixin for classes with an attribute `values`.

    `values` is one motion or many, shape (..., 2 (3 + N)):
    `[x_c, y_c, theta, q_1..q_N, d/dt of each]`.
    """

    values: np.ndarray

    @property
    def _half(self):
        return self.values.shape[-1] // 2

    @property
    def carrier(self):
        """Carrier position in world axes, shape (..., 2) [m]."""
        return self.values[..., :2]

    @property
    def shaft(self):
        """Shaft angle, not wrapped, shape (...,) [rad]."""
        return self.values[..., 2]

    @property
    def q(self):
        """Modal coordinates, shape (..., N) [m sqrt(kg)]."""
        return self.values[..., 3:self._half]

    @property
    def carrier_velocity(self):
        """Carrier velocity in world axes, shape (..., 2) [m/s]."""
        return self.values[..., self._half:self._half + 2]

    @property
    def shaft_velocity(self):
        """Shaft speed, shape (...,) [rad/s]."""
        return self.values[..., self._half + 2]

    @property
    def qdot(self):
        """Modal rates, shape (..., N) [m sqrt(kg)/s]."""
        return self.values[..., self._half + 3:]


@dataclass(frozen=True)
class Motion(MotionFields):
    """
    One motion or many, with names for the parts.

    Attributes
    ----------
    values : ndarray, shape (..., 2 (3 + N))
        Carrier x and y in world axes [m], shaft angle [rad], modal coordinates [m sqrt(kg)], then
        the rate of each.

    """

    values: np.ndarray


def rotate(theta, x, y):
    """
    Return a vector of the plane turned by an angle.

    Parameters
    ----------
    theta : float or ndarray
        [rad]
    x, y : float or ndarray
        Components in the turned axes, such as along and across the shaft.

    Returns
    -------
    x, y : float or ndarray
        Components in the axes from which theta is counted, such as the world's.

    """
    library = math if isinstance(theta, float) else np
    cosine, sine = library.cos(theta), library.sin(theta)
    return cosine * x - sine * y, sine * x + cosine * y


def tip_force(loads, theta):
    """Return x, y of the tip force in world axes [N], for loads (..., 14), shaft angles (...)."""
    x, y = rotate(theta, loads[..., TIP_I], loads[..., TIP_II])
    return x + loads[..., TIP_X], y + loads[..., TIP_Y]


def place(origin_x, origin_y, theta, x, y):
    """Return an origin plus the vector x, y turned by theta, such as a point in world axes."""
    cosine, sine = math.cos(theta), math.sin(theta)
    return origin_x + cosine * x - sine * y, origin_y + sine * x + cosine * y
