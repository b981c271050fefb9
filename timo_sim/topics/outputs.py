# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The topics that carry the motion: one entry of `outputs` says everything about a topic.

The table of sensors is the source of their parameters, topics, quantities of fits and outputs of
linear models.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np

from timo_sim.model.layout import LINKS, place, with_unit
from timo_sim.topics.cdr import columns, Number, Serializer


class Sensor(NamedTuple):
    """
    A sensor.

    From its entry in `SENSORS` follow the parameters `sensor.NAME.noise`, `.bias` and
    `.resolution`, `Simulator.sensors.NAME`, its topic with rate and delay, and columns in logs.
    Its messages are a `sensor_msgs/msg/JointState` or, on the topic `IMU`, `sensor_msgs/msg/Imu`.

    `read` takes the Joints of n motions and returns what it measures in them, (n,), or (n, axes)
    with a number for each of `columns`. Where the motion alone determines it, a sensor of one axis
    has `of_motion` in its place, which takes a Formulation and motions, (n, 2 (3 + N)), and
    returns (n,); it is also a quantity of fits and an output of linear models. `quantity` is the
    one of fits that its last axis shows, by default its own name with `of_motion`; `joint` is its
    name in a JointState, by default its own.
    """

    name: str
    unit: str
    meaning: str
    topic: str
    columns: tuple[str, ...]
    read: Any = None
    of_motion: Any = None
    quantity: str = ''
    joint: str = ''
    of_gear: bool = False  # whether only scenes with an elastic gear have its topic

    def of_joints(self, joints: Any) -> np.ndarray:
        """Return what it measures in n motions, given as Joints, without noise, (n, axes)."""
        found = self.of_motion(joints.model, joints.motions) if self.of_motion else (
            self.read(joints))
        return found.reshape(len(found), -1)

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
    Sensor('root_strain', '', 'the strain of the outer fibre at the gauge',
           '~/root_strain', ('outer_fibre',),
           read=lambda joints: joints.root_strain, quantity='root_strain'),
    Sensor('tip_acceleration', 'm/s2', 'either axis of the specific force '
           '(acceleration less gravity) of the IMU',
           IMU, ('acceleration_x_m_per_s2', 'acceleration_y_m_per_s2'),
           read=lambda joints: joints.tip_acceleration, quantity='tip_acceleration'),
    Sensor('gyro', 'rad/s', 'the angular velocity of the IMU',
           IMU, ('turning_rad_per_s',), read=lambda joints: joints.tip_turning),
    Sensor('encoder', 'rad', 'the shaft angle',
           '~/encoder', ('shaft_rad',),
           of_motion=lambda model, motions: motions[:, 2], quantity='shaft', joint='shaft'),
    Sensor('rotor', 'rad', 'the angle of the rotor over the gear ratio',
           '~/rotor', ('rotor_rad',),
           of_motion=lambda model, motions: motions[:, :len(model.rotor)] @ model.rotor,
           of_gear=True),
)


_GRAVITY = 9.80665  # [m/s2]
# The parent of each frame is the one before it; arm turns with the shaft. A node may give them
# other names, see `in_frames`. Between world and carrier is carrier_rail; arm_1, arm_2, ... are
# links from the root on, which follow the bent arm; arm_imu is an IMU that is not at the tip.
FRAMES = 'world', 'carrier', 'arm', 'tip'


def title(topic: str) -> str:
    """Return the short name of a topic in columns and rates: tip_imu for ~/tip_imu/data_raw."""
    return topic.strip('~/').partition('/')[0]


def _tip_pose(snapshot):
    x, y, theta = snapshot.joint_positions
    along, across, rotation = snapshot.tip
    half = 0.5 * (theta + rotation)
    return *place(x, y, theta, along, across), math.sin(half), math.cos(half)


def gravity_along_z(gravity: float) -> float:
    """Return what the gravity in the plane of motion leaves of the Earth's [m/s2]."""
    lean = min(gravity / _GRAVITY, 1.0)
    return _GRAVITY * math.sqrt(1.0 - lean * lean)


def _imu_unlogged(snapshot):
    # Along z; variances.
    return [gravity_along_z(math.hypot(*snapshot.model.gravity)), *(
        snapshot.variance(name) for name in ('tip_acceleration', 'tip_acceleration', 'gyro'))]


def _transforms(snapshot):
    x, y, theta = snapshot.joint_positions
    along, across, rotation = snapshot.tip
    return (x, y, math.sin(0.5 * theta), math.cos(0.5 * theta),
            along, across, math.sin(0.5 * rotation), math.cos(0.5 * rotation))


def _links(snapshot):
    half, body = 0.5 * snapshot.link_turns, snapshot.model.manipulator
    along = np.full(LINKS, body.arm.length / LINKS)
    along[0] = body.hub_radius
    # Of the precision of pictures: logs are smaller by 3 %.
    found = np.float32(np.column_stack([along, np.sin(half), np.cos(half)])).ravel().tolist()
    if snapshot.model.imu:
        *place, turn = snapshot.model.seen.tip(snapshot.motion).tolist()
        found += [*place, math.sin(0.5 * turn), math.cos(0.5 * turn)]
    return found


class Output(NamedTuple):
    """
    A topic that carries the motion; '~/encoder' is below the node's own name, '/clock' is not.

    `numbers` takes a Snapshot and returns those of a message in the order of `columns`; `template`
    is the message with a Number in place of each; time stamps are filled in. `delay` is the
    parameter with the time from measurement to message [s], for a sensor. `unlogged` takes a
    Snapshot and returns the values of the template's Numbers without a name.
    """

    name: str
    type_name: str
    numbers: Callable
    template: dict
    delay: str | None = None
    unlogged: Callable = lambda snapshot: ()

    def serializer(self, frames: Mapping[str, str]) -> Callable[[Any, Sequence[float]], bytes]:
        """Return a function that makes messages, in these FRAMES, of a Snapshot and `numbers`."""
        serialize = Serializer(self.type_name, in_frames(self.template, frames))
        return lambda snapshot, numbers: serialize(
            snapshot.time, (*numbers, *self.unlogged(snapshot)))

    @property
    def rate(self) -> str:
        """Name of the parameter with the rate."""
        return f'rate.{title(self.name)}'

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the numbers, with units."""
        return columns(self.template)


def _numbers(*names):
    return [Number(name) for name in names]


def _frame(name):
    return {'frame_id': name}


def _xy(x, y):
    return {'x': Number(x), 'y': Number(y)}


def _diagonal(x, y, z):
    return [x, *3 * [0.0], y, *3 * [0.0], z]  # a 3 x 3 matrix by rows


def _quaternion(z, w):
    return {'z': Number(z), 'w': Number(w)}


def _frame_below(parent, child, **transform):
    return {'header': _frame(parent), 'child_frame_id': child, 'transform': transform}


_POSE = {
    'header': _frame('world'),
    'pose': {'position': _xy('x_m', 'y_m'),
             'orientation': _quaternion('orientation_z', 'orientation_w')},
}


def _imu(frame, x, y, turning):
    return {
        'header': _frame(frame),
        # REP 145: -1 means no orientation; a covariance of zeros means that it is unknown.
        'orientation_covariance': [-1.0] + 8 * [0.0],
        # An accelerometer shows specific force: +g along z where the plane is horizontal.
        'linear_acceleration': {**_xy(x, y), 'z': Number()},
        'angular_velocity': {'z': Number(turning)},
        'linear_acceleration_covariance': _diagonal(Number(), Number(), 0.0),
        'angular_velocity_covariance': _diagonal(0.0, 0.0, Number())}


def _sensor_outputs(gear, imu):
    """Yield the Outputs of sensors, one for each topic."""
    topics: dict[str, list[Sensor]] = {}
    for sensor in [each for each in SENSORS if gear or not each.of_gear]:
        topics.setdefault(sensor.topic, []).append(sensor)
    for topic, sensors in topics.items():
        columns = [column for sensor in sensors for column in sensor.columns]
        delay = f'sensor.{title(topic)}.delay'

        def read(snapshot, names=tuple(each.name for each in sensors)):
            return [axis for name in names for axis in snapshot.sensor(name)]

        if topic == IMU:
            yield Output(name=topic, type_name='sensor_msgs/msg/Imu', numbers=read,
                         template=_imu('arm_imu' if imu else 'tip', *columns), delay=delay,
                         unlogged=_imu_unlogged)
        else:
            joint = sensors[0].joint or sensors[0].name
            yield Output(topic, 'sensor_msgs/msg/JointState', read, {
                'name': [joint], 'position': _numbers(*columns)}, delay)


def outputs(modes: int, gear: bool = True, imu: bool = False) -> list[Output]:
    """
    Return the list of Outputs, the topics that carry the motion, for a number of modes.

    `gear` says whether those of an elastic gear are among them, `imu` whether an IMU is not at the
    tip; see `Scene.outputs`.
    """
    names = [f'mode_{n + 1}' for n in range(modes)]
    modal = [Output('~/modal_state', 'sensor_msgs/msg/JointState',
                    lambda snapshot: snapshot.modal_state, {
                        'name': names,
                        'position': _numbers(*(f'{name}_m_sqrt_kg' for name in names)),
                        'velocity': _numbers(*(f'{name}_rate_m_sqrt_kg_per_s'
                                               for name in names))})]
    return [
        Output('joint_states', 'sensor_msgs/msg/JointState', lambda snapshot: (
            *snapshot.joint_positions, *snapshot.joint_velocities, *snapshot.effort), {
                'name': ['carrier_x', 'carrier_y', 'shaft'],
                'position': _numbers('carrier_x_m', 'carrier_y_m', 'shaft_rad'),
                'velocity': _numbers('carrier_x_velocity_m_per_s', 'carrier_y_velocity_m_per_s',
                                     'shaft_velocity_rad_per_s'),
                'effort': _numbers('carrier_x_force_N', 'carrier_y_force_N', 'shaft_torque_N_m')}),
        *(modal if modes else []),
        Output('~/tip_deflection', 'geometry_msgs/msg/Vector3Stamped',
               lambda snapshot: (
                   snapshot.tip[0] - float(snapshot.model.tip_point.lever[0]), snapshot.tip[1]),
               {'header': _frame('arm'), 'vector': _xy('axial_m', 'transverse_m')}),
        Output('~/tip_pose', 'geometry_msgs/msg/PoseStamped', _tip_pose, _POSE),
        Output('~/carrier_pose', 'geometry_msgs/msg/PoseStamped',
               lambda snapshot: (*snapshot.joint_positions[:2], 0.0, 1.0), _POSE),
        Output('/clock', 'rosgraph_msgs/msg/Clock', lambda snapshot: (), {}),
        *_sensor_outputs(gear, imu),
    ]


# Frames follow from the motion above: replays neither need nor compare them.
TRANSFORMS = Output('/tf', 'tf2_msgs/msg/TFMessage', _transforms, {'transforms': [
    _frame_below('world', 'carrier_rail', translation={'x': Number('carrier_x_m')}),
    _frame_below('carrier_rail', 'carrier', translation={'y': Number('carrier_y_m')}),
    _frame_below('carrier', 'arm',
                 rotation=_quaternion('arm_orientation_z', 'arm_orientation_w')),
    _frame_below('arm', 'tip', translation=_xy('tip_x_m', 'tip_y_m'),
                 rotation=_quaternion('tip_orientation_z', 'tip_orientation_w')),
    *[_frame_below(f'arm_{k}' if k else 'arm', f'arm_{k + 1}', translation={'x': Number()},
                   rotation={'z': Number(), 'w': Number()}) for k in range(LINKS)],
]}, unlogged=_links)
TRANSFORMS_OF_IMU = TRANSFORMS._replace(template={'transforms': [
    *TRANSFORMS.template['transforms'],
    _frame_below('arm', 'arm_imu', translation={'x': Number(), 'y': Number()},
                 rotation={'z': Number(), 'w': Number()})]})


def in_frames(template: Any, names: Mapping[str, str]) -> Any:
    """Return a template with its frames renamed; `names` is a dictionary with keys of FRAMES."""
    if isinstance(template, dict):
        return {key: renamed(part, names) if key.endswith('frame_id') else in_frames(part, names)
                for key, part in template.items()}
    return [in_frames(part, names) for part in template] if isinstance(
        template, list) else template


def renamed(frame: str, names: Mapping[str, str]) -> str:
    """Return the name of a frame, also of 'arm_1' or 'carrier_rail'; `names` as in `in_frames`."""
    own, *more = frame.split('_')
    return '_'.join([names.get(own, own), *more])


def with_angles(columns: tuple[str, ...],
                values: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Return columns and values, (n, k), with `rotation_rad`, unwrapped, for an orientation."""
    if 'orientation_z' not in columns:
        return columns, values
    z, w = (values[:, columns.index(name)] for name in ('orientation_z', 'orientation_w'))
    # A quaternion has half the angle, and so repeats after two turns.
    angle = np.unwrap(2.0 * np.arctan2(z, w), period=4.0 * math.pi)
    kept = [place for place, name in enumerate(columns) if not name.startswith('orientation_')]
    return ((*(columns[place] for place in kept), 'rotation_rad'),
            np.column_stack([values[:, kept], angle]))
