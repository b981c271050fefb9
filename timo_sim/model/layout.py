# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The table of inputs, the layout of the arrays for loads and motions, rotations of the plane."""

from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np


class Input(NamedTuple):
    """
    What acts on the manipulator from outside, and its column in a load.

    From its entry in `INPUTS` follow the parameters `load.NAME...` of a scene, arguments of
    `Simulator.step` and `Batch.step`, limits, columns of commands in logs, inputs of `linearize`
    and of fits, and scales of sensitivities.
    """

    name: str
    unit: str
    meaning: str
    group: str = ''       # the inputs that a command sets together; empty: commands set it not
    frame: str = 'world'  # axes along which a force acts: world, arm or tip
    limit: str = ''       # parameter with the largest magnitude of its commands; empty: none
    rate_limit: str = ''  # parameter with the largest rate at which they act; empty: none
    needs: str = ''       # parameter that must be > 0 where it acts; empty: none

    @property
    def argument(self) -> str:
        """Name of the argument of `Simulator.step` that sets it, or ''."""
        known = self.group and self.frame == 'world'
        return self.name.removesuffix('_x').removesuffix('_y') if known else ''

    @property
    def prescribed(self) -> bool:
        """Whether a scene may prescribe it over time: forces, torques, accelerations."""
        return bool(self.argument) and self.unit in ('N', 'N m', 'm/s2')

    @property
    def column(self) -> str:
        """Name of a column with its numbers, such as `torque_N_m`."""
        return with_unit(self.name, self.unit)


def with_unit(name: str, unit: str) -> str:
    """Return the name of a column with numbers in a unit: `speed_rad_per_s`."""
    return f'{name}_{unit}'.replace(' ', '_').replace('/', '_per_') if unit else name


def without_unit(column: str) -> tuple[str, str]:
    """Return name and unit of a column: ('speed', 'rad/s') of `speed_rad_per_s`."""
    for unit in 'rad/s', 'm/s2', 'm/s', 'N m', 'rad', 'm', 'N', 'V':
        if column.endswith(end := with_unit('', unit)):
            return column.removesuffix(end), unit
    return column, ''


_FORCE = {'limit': 'carrier.force_limit', 'rate_limit': 'carrier.force_rate_limit'}


def _driven(axis):
    # Of a carrier that does not move freely along an axis.
    along = f'of a driven carrier along world {axis}'
    return (Input(f'carrier_place_{axis}', 'm', f'place {along}'),
            Input(f'carrier_speed_{axis}', 'm/s', f'speed {along}'),
            Input(f'carrier_acceleration_{axis}', 'm/s2', 'acceleration of what holds the carrier '
                  f'along world {axis}, such as a base that shakes', 'base'))


# The columns of a load, in this order. Arm axes turn with the shaft. The angle, speed and
# acceleration are those of a driven shaft. The equations see only the torque of a voltage.
INPUTS = (
    Input('force_x', 'N', 'force on the carrier along world x', 'carrier', 'world', **_FORCE),
    Input('force_y', 'N', 'force on the carrier along world y', 'carrier', 'world', **_FORCE),
    Input('force_along_arm', 'N', 'force on the carrier along the arm', 'carrier', 'arm',
          **_FORCE),
    Input('force_across_arm', 'N', 'force on the carrier across the arm', 'carrier', 'arm',
          **_FORCE),
    Input('torque', 'N m', 'torque on the shaft', 'shaft', limit='motor.torque_limit',
          rate_limit='motor.torque_rate_limit'),
    Input('tip_force_x', 'N', 'force on the end effector along world x', 'tip'),
    Input('tip_force_y', 'N', 'force on the end effector along world y', 'tip'),
    Input('tip_force_along_arm', 'N', 'force on the end effector along the arm', 'tip', 'arm'),
    Input('tip_force_across_arm', 'N', 'force on the end effector across the arm', 'tip', 'arm'),
    Input('tip_torque', 'N m', 'torque on the end effector', 'tip'),
    Input('angle', 'rad', 'angle of a driven shaft'),
    Input('speed', 'rad/s', 'speed of a driven shaft'),
    Input('acceleration', 'rad/s2', 'acceleration of a driven shaft'),
    Input('voltage', 'V', 'voltage at a DC motor', 'shaft', limit='motor.dc.voltage_limit',
          needs='motor.dc.resistance'),
    Input('push_x', 'N', 'force on the arm at push.position along world x', 'push',
          needs='push.position'),
    Input('push_y', 'N', 'force on the arm at push.position along world y', 'push',
          needs='push.position'),
    Input('shaft_friction', 'N m', 'friction on the shaft of an elastic gear, by its bristle'),
    Input('motor_friction', 'N m', 'what of the torque is dry friction of shaft or rotor'),
    *_driven('x'), *_driven('y'),
)
LOADS = len(INPUTS)
(FORCE_X, FORCE_Y, FORCE_I, FORCE_II, TORQUE, TIP_X, TIP_Y, TIP_I, TIP_II, TIP_TORQUE,
 ANGLE, SPEED, ACCELERATION, VOLTAGE, PUSH_X, PUSH_Y, SHAFT_FRICTION,
 MOTOR_FRICTION, PLACE_X, SPEED_X, ACCELERATION_X, PLACE_Y, SPEED_Y, ACCELERATION_Y,
 *_) = range(LOADS)
# Rows of the loads of a step: three that its stages see, then the true load at its end.
START, MIDDLE, END, AFTER = range(4)
STAGES, STEP_LOADS = 3, 4
LINKS = 10  # rigid links by which frames and URDF show the bent arm


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
    def carrier(self) -> np.ndarray:
        """Carrier position in world axes, shape (..., 2) [m]."""
        return self.values[..., :2]

    @property
    def shaft(self) -> np.ndarray:
        """Shaft angle, not wrapped, shape (...,) [rad]."""
        return self.values[..., 2]

    @property
    def q(self) -> np.ndarray:
        """Modal coordinates, shape (..., N) [m sqrt(kg)]."""
        return self.values[..., 3:self._half]

    @property
    def carrier_velocity(self) -> np.ndarray:
        """Carrier velocity in world axes, shape (..., 2) [m/s]."""
        return self.values[..., self._half:self._half + 2]

    @property
    def shaft_velocity(self) -> np.ndarray:
        """Shaft speed, shape (...,) [rad/s]."""
        return self.values[..., self._half + 2]

    @property
    def qdot(self) -> np.ndarray:
        """Modal rates, shape (..., N) [m sqrt(kg)/s]."""
        return self.values[..., self._half + 3:]


# Units of the parts of a motion.
_PARTS = {'carrier': 'm', 'shaft': 'rad', 'q': 'm sqrt(kg)', 'carrier_velocity': 'm/s',
          'shaft_velocity': 'rad/s', 'qdot': 'm sqrt(kg)/s'}


@dataclass(frozen=True, repr=False)
class Motion(MotionFields):
    """
    One motion or many, with names for the parts, see `MotionFields`.

    `np.asarray` returns its `values`; an index picks of many.
    """

    values: np.ndarray

    def __repr__(self):
        parts = {name: getattr(self, name) for name in _PARTS}
        return 'Motion' + ''.join(
            f'\n  {name:16} {each.shape if self.values.ndim > 1 else each} {_PARTS[name]}'
            for name, each in parts.items())

    def __getitem__(self, number: Any) -> 'Motion':
        return Motion(self.values[number, ...])

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype)


def rotate(theta: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """
    Return a vector of the plane turned by an angle [rad], floats or arrays.

    x, y are components in the turned axes, such as along and across the shaft; the result's are in
    the axes from which theta is counted, such as the world's.
    """
    library = math if isinstance(theta, float) else np
    cosine, sine = library.cos(theta), library.sin(theta)
    return cosine * x - sine * y, sine * x + cosine * y


def place(origin_x: float, origin_y: float, theta: float, x: float,
          y: float) -> tuple[float, float]:
    """Return an origin plus the vector x, y turned by theta, such as a point in world axes."""
    cosine, sine = math.cos(theta), math.sin(theta)
    return origin_x + cosine * x - sine * y, origin_y + sine * x + cosine * y
