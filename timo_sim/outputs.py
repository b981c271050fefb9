"""What the node tells of a motion: its quantities, topic by topic, without ROS."""

from functools import cached_property
import math
from typing import Callable, NamedTuple

import numpy as np

from timo_sim.physics.formulation import FORCE_I, FORCE_II, FORCE_X, FORCE_Y, TORQUE
from timo_sim.sensors import shown

NANOSECONDS = 1000000000


class Snapshot:
    """
    The motion at one step, and what messages need of it, computed when asked for.

    Parameters
    ----------
    simulator : Simulator
    load : list of float, length 14
        What acted at the end of the last step, columns as in `physics.formulation`.

    Attributes
    ----------
    step : int
    nanoseconds : int
        Sim time [ns].
    time : tuple of int
        The same in [s] and [ns].

    """

    def __init__(self, simulator, load):
        self._formulation, self._load = simulator.formulation, load
        self._simulator = simulator  # which has not gone on while a message is made
        self.step = simulator.steps
        self.nanoseconds = simulator.nanoseconds
        self.time = divmod(self.nanoseconds, NANOSECONDS)
        self.motion = simulator.motion()
        self._values = self.motion.tolist()
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

    @property
    def effort(self):
        """Forces on the carrier in world axes [N] and torque on the shaft [N m]."""
        load, theta = self._load, self._values[2]
        cosine, sine = math.cos(theta), math.sin(theta)
        return (load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II],
                load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II], load[TORQUE])

    @cached_property
    def tip(self):
        """Where the tip is in the arm frame [m], and its rotation relative to the shaft [rad]."""
        return self._formulation.tip(self.motion).tolist()

    @property
    def root_strain(self):
        """Strain of the outer fibre at the root."""
        return float(self._formulation.root_strain @ self.motion[3:self._half])

    @property
    def tip_turning(self):
        """Angular velocity of the end effector [rad/s]."""
        rotation = self._formulation.points.rotation[:, -1]
        return self._values[self._half + 2] + float(rotation @ self.motion[self._half + 3:])

    @property
    def tip_acceleration(self):
        """Acceleration of the tip along the axes of the end effector [m/s2]."""
        x, y = self._simulator.tip_acceleration().tolist()
        angle = self._values[2] + self.tip[2]
        cosine, sine = math.cos(angle), math.sin(angle)
        return cosine * x + sine * y, cosine * y - sine * x

    def shown(self, sensor, *quantities):
        """Return what a sensor shows of these quantities."""
        return shown(self._simulator.scene.values, sensor, self.step, *quantities)

    @cached_property
    def energy(self):
        """Kinetic plus strain energy [J]."""
        return float(self._formulation.energy(self.motion[np.newaxis])[0])

    @property
    def length(self):
        """Length of the arm [m]."""
        return self._formulation.manipulator.arm.length


def _joints(snapshot):
    return *snapshot.joint_positions, *snapshot.joint_velocities, *snapshot.effort


def _tip_deflection(snapshot):
    along, across, _ = snapshot.tip
    return along - snapshot.length, across


def _tip_pose(snapshot):
    x, y, theta = snapshot.joint_positions
    along, across, rotation = snapshot.tip
    cosine, sine = math.cos(theta), math.sin(theta)
    half = 0.5 * (theta + rotation)
    return (x + cosine * along - sine * across, y + sine * along + cosine * across,
            math.sin(half), math.cos(half))


def _carrier_pose(snapshot):
    return *snapshot.joint_positions[:2], 0.0, 1.0


def _root_strain(snapshot):
    return snapshot.shown('root_strain', snapshot.root_strain)


def _tip_imu(snapshot):
    return (*snapshot.shown('tip_acceleration', *snapshot.tip_acceleration),
            *snapshot.shown('gyro', snapshot.tip_turning))


def _encoder(snapshot):
    return snapshot.shown('encoder', snapshot.joint_positions[2])


def _transforms(snapshot):
    x, y, theta = snapshot.joint_positions
    along, across, rotation = snapshot.tip
    return (x, y, math.sin(0.5 * theta), math.cos(0.5 * theta),
            along, across, math.sin(0.5 * rotation), math.cos(0.5 * rotation))


class Output(NamedTuple):
    """
    The numbers of a topic.

    `numbers` reads them off a snapshot, `columns` names them with units, `places` says which of
    the floating-point numbers of a message they are; `rate` names the parameter with the rate,
    and `delay`, of a sensor, that with the time from measurement to message.
    """

    name: str
    type_name: str
    numbers: Callable[[Snapshot], tuple]
    columns: tuple
    places: tuple
    rate: str
    delay: str | None = None


def _output(name, type_name, numbers, columns, places=None):
    return Output(name, type_name, numbers, columns, places or tuple(range(len(columns))),
                  f'rate.{name.strip("~/")}')


def _sensor(*output):
    found = _output(*output)
    return found._replace(delay=f'sensor.{found.name.strip("~/")}.delay')


_POSE = 'x_m', 'y_m', 'orientation_z', 'orientation_w'
_IN_PLANE = 0, 1, 5, 6  # of a position and a quaternion
_IMU = 25, 26, 15  # after orientation, angular velocity and acceleration there are covariances


def outputs(modes):
    """Return the topics that carry the motion of an arm with so many modes, a list of Output."""
    numbers = range(1, modes + 1)
    modal = [_output('~/modal_state', 'sensor_msgs/msg/JointState',
                     lambda snapshot: snapshot.modal_state,
                     (*(f'mode_{n}_m_sqrt_kg' for n in numbers),
                      *(f'mode_{n}_rate_m_sqrt_kg_per_s' for n in numbers)))] if modes else []
    return [
        _output('joint_states', 'sensor_msgs/msg/JointState', _joints, (
            'carrier_x_m', 'carrier_y_m', 'shaft_rad', 'carrier_x_velocity_m_per_s',
            'carrier_y_velocity_m_per_s', 'shaft_velocity_rad_per_s', 'carrier_x_force_N',
            'carrier_y_force_N', 'shaft_torque_N_m')),
        *modal,
        _output('~/tip_deflection', 'geometry_msgs/msg/Vector3Stamped', _tip_deflection,
                ('axial_m', 'transverse_m')),
        _output('~/tip_pose', 'geometry_msgs/msg/PoseStamped', _tip_pose, _POSE, _IN_PLANE),
        _output('~/carrier_pose', 'geometry_msgs/msg/PoseStamped', _carrier_pose, _POSE,
                _IN_PLANE),
        _output('/clock', 'rosgraph_msgs/msg/Clock', lambda snapshot: (), ()),
        _sensor('~/root_strain', 'sensor_msgs/msg/JointState', _root_strain, ('outer_fibre',)),
        _sensor('~/tip_imu', 'sensor_msgs/msg/Imu', _tip_imu, (
            'acceleration_x_m_per_s2', 'acceleration_y_m_per_s2', 'turning_rad_per_s'), _IMU),
        _sensor('~/encoder', 'sensor_msgs/msg/JointState', _encoder, ('shaft_rad',)),
    ]


# Frames: carrier in world, arm (which turns with the shaft) on it, tip in the arm frame. Neither
# logged nor replayed: it is what is read off the motion above.
TRANSFORMS = _output('/tf', 'tf2_msgs/msg/TFMessage', _transforms, (
    'carrier_x_m', 'carrier_y_m', 'arm_orientation_z', 'arm_orientation_w',
    'tip_x_m', 'tip_y_m', 'tip_orientation_z', 'tip_orientation_w'))


def with_angles(columns, values):
    """
    Return columns and values with an angle instead of the two numbers of an orientation.

    Parameters
    ----------
    columns : tuple of str
    values : ndarray, shape (n, k)

    Returns
    -------
    tuple of str, ndarray, shape (n, k - 1) or (n, k)
        The angle, `rotation_rad`, is not wrapped.

    """
    if 'orientation_z' not in columns:
        return columns, values
    z, w = (values[:, columns.index(name)] for name in ('orientation_z', 'orientation_w'))
    # Half the angle is written, so that it comes back after two turns.
    angle = np.unwrap(2.0 * np.arctan2(z, w), period=4.0 * math.pi)
    kept = [place for place, name in enumerate(columns) if not name.startswith('orientation_')]
    return ((*(columns[place] for place in kept), 'rotation_rad'),
            np.column_stack([values[:, kept], angle]))
