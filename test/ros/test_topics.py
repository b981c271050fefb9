# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Topics: the physics that they carry, their bytes, rates and QoS."""

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point, Pose, PoseStamped, Quaternion, Vector3, Vector3Stamped)
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_sensor_data, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from ros_process import nanoseconds
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, Header
import yaml

import timo_sim
from timo_sim.log.tables import export_bag
from timo_sim.ros.parameters import ParameterNode
from timo_sim.ros.topics import message_class
from timo_sim.scene.parameters import ParameterError
from timo_sim.topics.cdr import layout, Serializer
from timo_sim.topics.outputs import outputs

TORQUE, TIP = '/timo_sim/motor_torque', '/timo_sim/tip_pose'
OVERRIDES = {f'qos_overrides.{name}': value for name, value in {
    '/joint_states.publisher.history': 'keep_last',
    f'{TIP}.publisher.depth': 1, f'{TIP}.publisher.reliability': 'best_effort',
    f'{TORQUE}.subscription.depth': 1000,
    f'{TORQUE}.subscription.reliability': 'best_effort'}.items()}
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


def test_topics_carry_the_physics(start, client, paper):
    node = start('--params-file', str(paper), record=False)
    joints = client.collect(JointState, '/joint_states')
    modes = client.collect(JointState, '/timo_sim/modal_state')
    deflections = client.collect(Vector3Stamped, '/timo_sim/tip_deflection')
    tips = client.collect(PoseStamped, '/timo_sim/tip_pose')
    carriers = client.collect(PoseStamped, '/timo_sim/carrier_pose')
    for received in (joints, modes, deflections, tips, carriers):
        client.wait(lambda: len(received) >= 100, 'a second of messages')
    assert node.end()[0] == 0

    run = timo_sim.simulate(timo_sim.load_scene(paper), 1.0 + 1e-9 * nanoseconds(joints[-1]),
                            sample_every=10)

    def at(message):
        return round(1e-7 * nanoseconds(message))

    for joint in joints:
        k = at(joint)
        assert joint.name == ['carrier_x', 'carrier_y', 'shaft']
        assert np.array_equal(joint.position, run.motion[k, :3])
        assert np.array_equal(joint.velocity, run.motion[k, 6:9])
        assert joint.effort == pytest.approx(
            5 * np.sin(2 * np.pi * np.array([2, 3, 4]) * run.t[k]), abs=1e-12)
    for mode in modes:
        assert mode.name == ['mode_1', 'mode_2', 'mode_3'] and not mode.effort
        assert np.array_equal(mode.position, run.q[at(mode)])
        assert np.array_equal(mode.velocity, run.qdot[at(mode)])
    across, rotation, position = run.deflection(2.0), run.rotation(2.0), run.position(2.0)
    for deflection in deflections:
        assert deflection.header.frame_id == 'arm'
        assert (deflection.vector.x, deflection.vector.y) == pytest.approx(
            across[at(deflection)], abs=1e-14)
    for tip in tips:
        k, z, w = at(tip), tip.pose.orientation.z, tip.pose.orientation.w
        assert tip.header.frame_id == 'world'
        assert (tip.pose.position.x, tip.pose.position.y) == pytest.approx(position[k], abs=1e-14)
        assert 2 * np.arctan2(z, w) == pytest.approx(run.shaft[k] + rotation[k], abs=1e-14)
    for carrier in carriers:
        place = carrier.pose.position
        assert (place.x, place.y) == tuple(run.carrier[at(carrier)])
        assert carrier.pose.orientation.w == 1.0
    stamps = [at(joint) for joint in joints]
    assert stamps == list(range(stamps[0], stamps[0] + len(stamps)))


def test_packed_is_what_rclpy_serializes():
    for output in outputs(4):
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


def test_each_topic_has_its_rate_in_one_run(start):
    rates = {'joint_states': 500.0, 'modal_state': 250.0, 'tip_deflection': 200.0,
             'tip_pose': 1000.0, 'carrier_pose': 8.0, 'clock': 40.0}
    node = start(real_time_factor=0.0, duration=1.0, publish_clock=True,
                 **{f'rate.{topic}': rate for topic, rate in rates.items()})
    assert node.wait()[0] == 0
    steps = {topic: [] for topic in rates}
    for message in read_ros2_messages(str(node.log)):
        topic = message.channel.topic.rpartition('/')[2]
        if topic in steps:
            steps[topic].append(message.sequence_count)
    assert steps == {topic: list(range(0, 1001, round(1000 / rate)))
                     for topic, rate in rates.items()}


def test_subscribers_of_sensor_data_receive_every_topic_and_overrides_act(start, client):
    node = start(record=False, publish_clock=True, **OVERRIDES)
    heard, topics = {}, {output.name: output.type_name for output in outputs(3)}
    assert len(topics) >= 9
    for topic, type_name in topics.items():
        full = topic.replace('~', '/timo_sim') if topic[0] in '~/' else f'/{topic}'
        heard[topic] = []
        client.create_subscription(message_class(type_name), full, heard[topic].append,
                                   qos_profile_sensor_data)
    client.wait(lambda: all(heard.values()), 'a message of each topic')

    remote = AsyncParameterClient(client, '/timo_sim')
    client.wait(remote.services_are_ready, 'the services of parameters')
    names, values = remote.list_parameters(['qos_overrides'], 10), remote.get_parameters(
        [*OVERRIDES])
    late = 'qos_overrides./joint_states.publisher.depth'
    refused = remote.set_parameters([Parameter(late, value=3)])
    client.wait(lambda: names.done() and values.done() and refused.done(), 'parameters')
    assert refused.result().results[0].reason == (
        f'{late} is not declared; QoS is set only at the start')
    assert {*names.result().result.names} == {*OVERRIDES}
    assert [*map(parameter_value_to_python, values.result().values)] == [*OVERRIDES.values()]

    # A reliable subscriber gets nothing from a best-effort publisher.
    offered = {found.topic_type: found.qos_profile.reliability
               for topic in (TIP, '/joint_states')
               for found in client.get_publishers_info_by_topic(topic)}
    assert offered == {'geometry_msgs/msg/PoseStamped': ReliabilityPolicy.BEST_EFFORT,
                       'sensor_msgs/msg/JointState': ReliabilityPolicy.RELIABLE}
    torque = client.create_publisher(Float64, TORQUE, qos_profile_sensor_data)

    def acts():
        torque.publish(Float64(data=2.0))
        return heard['joint_states'][-1].effort[2] == 2.0
    client.wait(acts, 'the torque of an unreliable publisher')
    assert node.end()[0] == 0


def test_the_log_names_the_qos_that_acts(start, tmp_path):
    node = start(duration=0.1, **OVERRIDES)
    assert node.wait()[0] == 0
    profile = {'/timo_sim/tip_pose': (1, 'best_effort'), TORQUE: (1000, 'best_effort')}
    with open(node.log, 'rb') as stream:
        channels = make_reader(stream).get_summary().channels.values()
    logged = {channel.topic: yaml.safe_load(channel.metadata['offered_qos_profiles'])
              for channel in channels}
    export_bag(node.log, tmp_path / 'bag')
    bag = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    exported = {topic['topic_metadata']['name']: topic['topic_metadata']['offered_qos_profiles']
                for topic in bag['rosbag2_bagfile_information']['topics_with_message_count']}
    assert logged == exported and {*profile} < {*logged}
    for topic, (qos,) in logged.items():
        assert (qos['depth'], qos['reliability']) == profile.get(topic, (10, 'reliable')), topic


def test_overrides_without_effect_are_errors(ros):
    for name, value, words in (
            ('/timo_sim/tip_pose.publisher.reliability', 'sometimes',
             'must be one of reliable, best_effort'),
            ('/timo_sim/tip_pose.publisher.depth', 0, 'must be a whole number >= 1 and <= 10000'),
            ('/timo_sim/tip_pose.publisher.history', 'keep_all', 'must be one of keep_last'),
            ('/timo_sim/tip_pose.publisher.deadline', 5,
             'must set one of history, depth, reliability'),
            ('depth', 5, 'is for no publisher or subscription'),
            ('/parameter_events.publisher.depth', 5, 'is for no publisher or subscription')):
        name = f'qos_overrides.{name}'
        node = ParameterNode('timo_sim', parameter_overrides=[Parameter(name, value=value)])
        with pytest.raises(ParameterError) as error:
            node.declare(node.given(), None)
        node.destroy_node()
        told = str(error.value)
        assert told.startswith(name) and words in told and repr(value) in told
        assert '\n' not in told
