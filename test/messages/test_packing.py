# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Other readers find the right number in each field of a packed message."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.typesys import get_typestore, Stores
from ros_messages import message_class

from timo_sim.topics.cdr import CdrError, columns, form, layout, Number, pack, Serializer
from timo_sim.topics.outputs import outputs, TRANSFORMS

A, B, C = Number('a'), Number('b'), Number('c')
DOWN, NONE = [-1.0] + 8 * [0.0], 9 * [0.0]


def _joints(names, message):
    assert message.name == names and message.header.frame_id == ''
    return [*message.position, *message.velocity, *message.effort]


def _pose(message):
    place, turned = message.pose.position, message.pose.orientation
    assert message.header.frame_id == 'world'
    assert (place.z, turned.x, turned.y) == (0.0, 0.0, 0.0)
    return [place.x, place.y, turned.z, turned.w]


def _deflection(message):
    assert message.header.frame_id == 'arm' and message.vector.z == 0.0
    return [message.vector.x, message.vector.y]


def _imu(message):
    assert message.header.frame_id == 'tip'
    assert list(message.orientation_covariance) == DOWN
    assert list(message.angular_velocity_covariance) == NONE
    assert list(message.linear_acceleration_covariance) == NONE
    turning, acceleration = message.angular_velocity, message.linear_acceleration
    assert (turning.x, turning.y, acceleration.z) == (0.0, 0.0, 9.80665)
    return [acceleration.x, acceleration.y, turning.z]


# Functions that read the numbers of a topic from the fields of a message, by topic.
READ = {
    'joint_states': lambda message: _joints(['carrier_x', 'carrier_y', 'shaft'], message),
    '~/modal_state': lambda message: _joints([f'mode_{n}' for n in (1, 2, 3, 4)], message),
    '~/tip_deflection': _deflection,
    '~/tip_pose': _pose,
    '~/carrier_pose': _pose,
    '/clock': lambda message: [],
    '~/root_strain': lambda message: _joints(['root_strain'], message),
    '~/tip_imu/data_raw': _imu,
    '~/encoder': lambda message: _joints(['shaft'], message),
}


@pytest.mark.parametrize('output', outputs(4), ids=lambda output: output.name)
def test_rclpy_reads_the_numbers_of_every_topic(output):
    serialize = Serializer(output.type_name, output.template)
    for sec, nanosec in ((0, 0), (1, 999999999), (2**31 - 1, 1)):
        numbers = np.random.default_rng(sec).normal(size=len(output.columns)).tolist()
        upright = [9.80665] * (output.name == '~/tip_imu/data_raw')  # no column, so it comes last
        data = serialize((sec, nanosec), numbers + upright)
        message = deserialize_message(data, message_class(output.type_name))
        assert READ[output.name](message) == numbers
        stamp = message.clock if output.name == '/clock' else message.header.stamp
        assert (stamp.sec, stamp.nanosec) == (sec, nanosec)


def test_rosbags_reads_the_frames():
    """Also where tf2_msgs is not installed."""
    numbers = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]
    data = Serializer(TRANSFORMS.type_name, TRANSFORMS.template)((3, 5), numbers)
    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, TRANSFORMS.type_name)
    found = []
    for frame in message.transforms:
        moved, turned = frame.transform.translation, frame.transform.rotation
        found.append((frame.header.frame_id, frame.child_frame_id, moved.x, moved.y, turned.z,
                      turned.w))
        assert (frame.header.stamp.sec, frame.header.stamp.nanosec) == (3, 5)
    assert found == [('world', 'carrier', 1.0, 2.0, 0.0, 1.0),
                     ('carrier', 'arm', 0.0, 0.0, 3.0, 4.0), ('arm', 'tip', 5.0, 6.0, 7.0, 8.0)]


@pytest.mark.parametrize('output', [*outputs(4), TRANSFORMS], ids=lambda output: output.name)
def test_places_and_texts_are_those_of_the_messages(output):
    numbers = [float(n + 2) for n in range(len(output.columns))]
    data = Serializer(output.type_name, output.template)((0, 0), numbers)
    found = layout(output.type_name, data)
    doubles = [np.frombuffer(data, '<f8', 1, place)[0] for place in found.doubles]
    assert [doubles[place] for place in output.places] == numbers
    assert found.texts == output.texts


def test_numbers_are_counted_in_the_order_of_the_template():
    template = {'effort': [A], 'name': ['x'], 'position': [B, 7.0, C]}
    assert columns(template) == ('a', 'b', 'c')
    assert form('sensor_msgs/msg/JointState', template).places == (3, 0, 2)
    data = Serializer('sensor_msgs/msg/JointState', template)((1, 2), [10.0, 20.0, 30.0])
    assert data == pack('sensor_msgs/msg/JointState', {
        'header': {'stamp': {'sec': 1, 'nanosec': 2}}, 'name': ['x'],
        'position': [20.0, 7.0, 30.0], 'effort': [10.0]})


def test_a_message_without_a_time_is_refused():
    with pytest.raises(ValueError, match='^std_msgs/msg/Float64 has no time$'):
        Serializer('std_msgs/msg/Float64', {'data': A})


def test_a_template_with_a_field_that_the_type_does_not_have_is_refused():
    with pytest.raises(CdrError, match='has no field positions'):
        Serializer('sensor_msgs/msg/JointState', {'positions': [A]})
