# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Definitions and CDR are those of ROS; layouts name every byte that has a meaning."""

import math
import os
from pathlib import Path
import struct
import sys

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from ros_messages import installed, message_class, random_message
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from timo_sim.topics.cdr import (
    CdrError, columns, DEFINITIONS, form, Layout, layout, Number, pack, Reader, schema_text,
    Serializer)
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs, TRANSFORMS


@pytest.mark.parametrize('type_name', filter(installed, DEFINITIONS))
def test_packed_is_what_rclpy_serializes(type_name):
    random = np.random.default_rng(1)
    for _ in range(20):
        message, values = random_message(type_name, random)
        packed, expected = pack(type_name, values), serialize_message(message)
        found = layout(type_name, packed)
        assert found == layout(type_name, expected)
        meant = [*found.fixed, *(place + byte for place in (*found.stamps, *found.doubles)
                                 for byte in range(8))]  # bytes with content
        assert [packed[place] for place in meant] == [expected[place] for place in meant]
        assert len(set(meant)) == len(meant)
        # Padding is at most 7 zeros in a row; rclpy may add some at the end.
        assert not any(packed[place] for place in set(range(len(packed))) - set(meant))
        assert np.diff(sorted(meant)).max() <= 8
        assert len(packed) == max(meant) + 1 <= len(expected)
        assert deserialize_message(packed, message_class(type_name)) == message
    # Missing fields have the defaults of ROS.
    message_type = message_class(type_name)
    assert deserialize_message(pack(type_name, {}), message_type) == message_type()


def test_layout_of_a_message_counted_by_hand():
    data = pack('sensor_msgs/msg/JointState', {
        'header': {'stamp': {'sec': 1, 'nanosec': 2}, 'frame_id': 'w'}, 'position': [3.0]})
    # Encoding 0, stamp 4, length of the frame 12, frame 16, number of names 20, of positions 24,
    # a position 28 (aligned to eight from byte 4 on), number of velocities 36, of efforts 40.
    assert layout('sensor_msgs/msg/JointState', data) == Layout(
        [4], [28], [1, 0, 0], ['w'], [0, 1, *range(12, 18), *range(20, 28), *range(36, 44)])
    assert struct.unpack_from('<iI', data, 4) == (1, 2)
    assert struct.unpack_from('<d', data, 28) == (3.0,)


def test_what_does_not_fit_is_refused():
    """A message that ends too early, with a length beyond its end, in another encoding, ..."""
    for type_name in DEFINITIONS:
        data = pack(type_name, {})
        for size in range(2, len(data)):
            with pytest.raises(CdrError, match='^it is too short$'):
                layout(type_name, data[:size])
        assert layout(type_name, data + bytes(3)) == layout(type_name, data)
    kind = 'sensor_msgs/msg/JointState'
    for call, words in (
            (lambda: layout(kind, pack(kind, {})[:-4] + b'\xff' * 4), '^it is too short$'),
            (lambda: layout('std_msgs/msg/Float64', bytes(4) + struct.pack('>d', math.pi)),
             r"^its encoding is b'\\x00\\x00', not b'\\x00\\x01'$"),
            (lambda: pack(kind, {'header': {'id': 'arm', 'frame': ''}}),
             '^std_msgs/msg/Header has no field frame, id$'),
            (lambda: pack('sensor_msgs/msg/Imu', {'orientation_covariance': [-1.0]}),
             '^orientation_covariance of sensor_msgs/msg/Imu must have 9 elements, got 1$')):
        with pytest.raises(CdrError, match=words):
            call()


A, B, C = Number('a'), Number('b'), Number('c')


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
    assert found[:4] == [
        ('world', 'carrier_rail', 1.0, 0.0, 0.0, 1.0),
        ('carrier_rail', 'carrier', 0.0, 2.0, 0.0, 1.0),
        ('carrier', 'arm', 0.0, 0.0, 3.0, 4.0), ('arm', 'tip', 5.0, 6.0, 7.0, 8.0)]
    assert found[4][:2] == ('arm', 'arm_1') and found[-1][:2] == ('arm_9', 'arm_10')


def test_numbers_are_counted_in_the_order_of_the_template():
    template = {'effort': [A], 'name': ['x'], 'position': [B, 7.0, C]}
    assert columns(template) == ('a', 'b', 'c')
    assert form('sensor_msgs/msg/JointState', template)[2] == (3, 0, 2)
    data = Serializer('sensor_msgs/msg/JointState', template)((1, 2), [10.0, 20.0, 30.0])
    assert data == pack('sensor_msgs/msg/JointState', {
        'header': {'stamp': {'sec': 1, 'nanosec': 2}}, 'name': ['x'],
        'position': [20.0, 7.0, 30.0], 'effort': [10.0]})


def test_places_and_texts_are_those_of_the_messages():
    for output in (*outputs(4), TRANSFORMS):
        numbers = [float(n + 2) for n in range(len(output.columns))]
        data = Serializer(output.type_name, output.template)((2**31 - 1, 999999999), numbers)
        found = layout(output.type_name, data)
        assert {struct.unpack_from('<iI', data, place) for place in found.stamps} == {
            (2**31 - 1, 999999999)}
        doubles = [np.frombuffer(data, '<f8', 1, place)[0] for place in found.doubles]
        _, own, places = form(output.type_name, output.template)
        assert [doubles[place] for place in places[:len(numbers)]] == numbers
        assert found == own


def share(type_name, suffix):
    """Return the text of a file of a message package, None where tf2_msgs is not installed."""
    package, _, name = type_name.split('/')
    for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]:
        path = Path(prefix, 'share', package, 'msg', name + suffix)
        if prefix and path.exists():
            return path.read_text(encoding='utf-8')
    if package != 'tf2_msgs':  # which has no wheel on PyPI
        raise ModuleNotFoundError(f'{type_name} is not installed', name=package)


def test_definitions_are_those_of_ros():
    for type_name, lines in DEFINITIONS.items():
        definition = share(type_name, '.msg')
        if definition:
            theirs = [line.split('#')[0].split() for line in definition.splitlines()]
            assert [line.split() for line in lines] == [line for line in theirs if line], type_name


def test_schemas_of_topics_are_those_of_each_ros_distribution():
    """Rosbags reads the schema and computes the hash of the type by REP-2011."""
    stores = [get_typestore(getattr(Stores, f'ROS2_{distribution}'))
              for distribution in ('JAZZY', 'KILTED', 'LYRICAL')]
    for type_name in {topic.type_name for topic in [*outputs(1), TRANSFORMS, *COMMANDS]}:
        store = get_typestore(Stores.EMPTY)
        types = get_types_from_msg(schema_text(type_name), type_name)
        store.register(types)
        own = store.hash_rihs01(type_name)
        assert all(each.hash_rihs01(type_name) == own for each in stores)
        assert types.keys() <= DEFINITIONS.keys()


def test_a_reader_says_what_messages_of_changing_layouts_hold():
    read, kind = Reader('sensor_msgs/msg/JointState'), 'sensor_msgs/msg/JointState'
    for names in (['a'], ['a'], ['b'], ['b', 'cc']):
        numbers = [1.0 + k for k in range(len(names))]
        assert read(pack(kind, {'header': {'stamp': {'sec': 1, 'nanosec': 2}, 'frame_id': 'f'},
                                'name': names, 'position': numbers, 'effort': [7.0]})) == (
            ['f', *names], [numbers, [], [7.0]], 1000000002)
    with pytest.raises(CdrError, match='more than 8192'):
        read(pack(kind, {'name': [8991 * 'a']}))
