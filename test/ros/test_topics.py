# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The packed messages are those that rclpy makes."""

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point, Pose, PoseStamped, Quaternion, Vector3, Vector3Stamped)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Header

from timo_sim.messages.cdr import layout
from timo_sim.messages.outputs import outputs
from timo_sim.messages.packing import Serializer
from timo_sim.ros.topics import message_class

EMPTY_LISTS = {'~/modal_state': 1, '~/root_strain': 2, '~/encoder': 2}


def joint_state(time, *numbers):
    """Return positions, speeds and efforts of the joints."""
    return JointState(header=Header(stamp=time), name=['carrier_x', 'carrier_y', 'shaft'],
                      position=numbers[:3], velocity=numbers[3:6], effort=numbers[6:])


def modal_state(time, *numbers):
    """Return coordinates and rates of four modes."""
    return JointState(header=Header(stamp=time), name=['mode_1', 'mode_2', 'mode_3', 'mode_4'],
                      position=numbers[:4], velocity=numbers[4:])


def vector_in_arm(time, x, y):
    """Return a vector in the arm frame."""
    return Vector3Stamped(header=Header(stamp=time, frame_id='arm'), vector=Vector3(x=x, y=y))


def pose_in_world(time, x, y, z, w):
    """Return a pose in the world."""
    return PoseStamped(header=Header(stamp=time, frame_id='world'),
                       pose=Pose(position=Point(x=x, y=y), orientation=Quaternion(z=z, w=w)))


def one_joint(name):
    """Return a function that makes messages with the position of one joint."""
    return lambda time, position: JointState(
        header=Header(stamp=time), name=[name], position=[position])


def imu_at_tip(time, x, y, turning):
    """Return an IMU message of the tip; by REP 145 -1 means no orientation."""
    return Imu(header=Header(stamp=time, frame_id='tip'),
               orientation_covariance=[-1.0] + 8 * [0.0], angular_velocity=Vector3(z=turning),
               linear_acceleration=Vector3(x=x, y=y, z=9.80665))


# The messages as a user of rclpy would write them.
BUILD = {
    'joint_states': joint_state,
    '~/modal_state': modal_state,
    '~/tip_deflection': vector_in_arm,
    '~/tip_pose': pose_in_world,
    '~/carrier_pose': pose_in_world,
    '~/root_strain': one_joint('root_strain'),
    '~/tip_imu/data_raw': imu_at_tip,
    '~/encoder': one_joint('shaft'),
    '/clock': lambda time: Clock(clock=time),
}


@pytest.mark.parametrize('output', outputs(4), ids=lambda output: output.name)
def test_packed_is_what_rclpy_serializes(output):
    message_type, size = message_class(output.type_name), len(output.columns)
    pack = Serializer(output.type_name, output.template)
    for sec, nanosec in ((0, 0), (1, 999999999), (2**31 - 1, 1)):
        numbers = np.random.default_rng(sec).normal(size=size).tolist()
        message = BUILD[output.name](Time(sec=sec, nanosec=nanosec), *numbers)
        assert isinstance(message, message_type)
        # The acceleration along z of a plane without gravity is no column, and comes last.
        upright = [9.80665] * (output.name == '~/tip_imu/data_raw')
        packed, expected = pack((sec, nanosec), numbers + upright), serialize_message(message)
        # In padding, and in four bytes of an empty list, rclpy leaves bytes of old memory.
        meant = layout(output.type_name, expected).meant()
        assert [packed[place] for place in meant] == [expected[place] for place in meant]
        assert not any(packed[place] for place in set(range(len(packed))) - set(meant))
        assert len(expected) - len(packed) == 4 * EMPTY_LISTS.get(output.name, 0)
        assert deserialize_message(packed, message_type) == message
