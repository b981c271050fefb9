# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""QoS of the topics: subscribers with the profile for sensor data, and qos_overrides.*."""

from mcap.reader import make_reader
import pytest
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_sensor_data, ReliabilityPolicy
from std_msgs.msg import Float64
import yaml

from timo_sim.log.export import export_bag
from timo_sim.messages.outputs import outputs
from timo_sim.ros.parameters import ParameterNode
from timo_sim.ros.topics import message_class
from timo_sim.scene.parameter import ParameterError

TORQUE, TIP = '/timo_sim/motor_torque', '/timo_sim/tip_pose'
OVERRIDES = {f'qos_overrides.{name}': value for name, value in {
    '/joint_states.publisher.history': 'keep_last',
    f'{TIP}.publisher.depth': 1, f'{TIP}.publisher.reliability': 'best_effort',
    f'{TORQUE}.subscription.depth': 1000,
    f'{TORQUE}.subscription.reliability': 'best_effort'}.items()}


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


@pytest.mark.parametrize('name, value, words', [
    ('/timo_sim/tip_pose.publisher.reliability', 'sometimes',
     'must be one of reliable, best_effort'),
    ('/timo_sim/tip_pose.publisher.depth', 0, 'must be a whole number >= 1 and <= 10000'),
    ('/timo_sim/tip_pose.publisher.history', 'keep_all', 'must be one of keep_last'),
    ('/timo_sim/tip_pose.publisher.deadline', 5, 'must set one of history, depth, reliability'),
    ('depth', 5, 'is for no publisher or subscription'),
    ('/parameter_events.publisher.depth', 5, 'is for no publisher or subscription')])
def test_overrides_without_effect_are_errors(ros, name, value, words):
    name = f'qos_overrides.{name}'
    node = ParameterNode('timo_sim', parameter_overrides=[Parameter(name, value=value)])
    with pytest.raises(ParameterError) as error:
        node.declare(node.given(), None)
    node.destroy_node()
    told = str(error.value)
    assert told.startswith(name) and words in told and repr(value) in told and '\n' not in told


def test_an_override_of_an_unknown_topic_ends_the_node_with_one_line(start):
    name = 'qos_overrides./timo_sim/tip_pos.publisher.depth'
    code, output = start(record=False, duration=0.1, **{name: 5}).wait()
    assert code == 2 and output.splitlines() == [
        f'timo_sim: {name} = 5 is for no publisher or subscription whose QoS can be set; '
        'did you mean /timo_sim/tip_pose?']
