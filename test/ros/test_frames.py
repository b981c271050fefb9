# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Given names of frames are used in messages, commands, logs and replays."""

import math

from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from geometry_msgs.msg import PoseStamped, Vector3Stamped, WrenchStamped
from mcap_ros2.reader import read_ros2_messages
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import Imu, JointState
from visualization_msgs.msg import Marker

from timo_sim.log.recording import Recording
from timo_sim.messages.outputs import in_frames, TRANSFORMS
from timo_sim.replay.replay import replay
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.values import frame_names

GIVEN = {'frame_prefix': 'left/', 'frame.world': 'map', 'frame.carrier': 'base_link'}
NAMES = {'world': 'map', 'carrier': 'left/base_link', 'arm': 'left/arm', 'tip': 'left/tip'}


def wrench_in(frame, x):
    """Return a force along the x axis of a frame."""
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.x = frame, x
    return message


def test_frames_of_topics_commands_log_and_replay(start, client, tmp_path):
    node = start('-r', '__ns:=/left', publish_arm_shape=True, record_sensors=True,
                 **{'initial.shaft': 0.5, 'initial.shaft_velocity': 1.0}, **GIVEN)
    for kind, topic, frame in (
            (Vector3Stamped, 'tip_deflection', 'arm'), (PoseStamped, 'tip_pose', 'world'),
            (PoseStamped, 'carrier_pose', 'world'), (Imu, 'tip_imu/data_raw', 'tip'),
            (Marker, 'arm_shape', 'world')):
        messages = client.collect(kind, f'/left/timo_sim/{topic}')
        client.wait(lambda: messages, topic)
        assert messages[-1].header.frame_id == NAMES[frame]
    states = client.collect(JointState, '/left/joint_states')
    push = client.command(WrenchStamped, '/left/timo_sim/carrier_wrench')
    for frame, turns in ('map', 0.0), ('left/arm', 1.0):
        push.publish(wrench_in(frame, 3.0))
        client.wait(lambda: states and abs(states[-1].effort[0] - 3.0 * math.cos(
            turns * states[-1].position[2])) < 1e-12, f'a force in {frame}')
    push.publish(wrench_in('arm', 1.0))
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: health and KeyValue(key='refused_commands', value='1') in
                health[-1].status[0].values, 'what is refused')
    code, output = node.end()
    assert code == 0 and "frame_id must be empty, 'map' or 'left/arm', got 'arm'" in output
    recording, lines = Recording(node.log), []
    assert len(recording.topics['~/carrier_wrench'].step) == 2
    assert replay(node.log, show=lines.append), lines
    again = tmp_path / 'again.mcap'
    replay(node.log, {'end_effector.mass': 1.0}, again, show=lines.append)
    for path in node.log, again:
        headers = [message.ros_msg.header for message in read_ros2_messages(str(path))
                   if hasattr(message.ros_msg, 'header')]
        assert {header.frame_id for header in headers} == {'', 'map', 'left/arm', 'left/tip'}


def test_commands_of_a_bag_use_the_frame_names_of_the_scene(tmp_path):
    store, kind = get_typestore(Stores.ROS2_JAZZY), 'geometry_msgs/msg/WrenchStamped'
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        wrench = writer.add_connection('/timo_sim/carrier_wrench', kind, typestore=store)
        types = {name: store.types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Wrench')}
        header = store.types['std_msgs/msg/Header'](
            store.types['builtin_interfaces/msg/Time'](0, 0), 'left/arm')
        force, none = types['Vector3'](2.0, 0.0, 0.0), types['Vector3'](0.0, 0.0, 0.0)
        writer.write(wrench, 10**9, store.serialize_cdr(
            store.types[kind](header, types['Wrench'](force, none)), kind))
    scene = tmp_path / 'scene.yaml'
    scene.write_text('timo_sim: {ros__parameters: {frame_prefix: left/}}')
    found, lines = tmp_path / 'run.mcap', []
    replay(tmp_path / 'bag', {}, found, scene, duration=0.1, show=lines.append)
    assert '1 commands' in lines[0]
    assert Recording(found).topics['joint_states'].values[-1, 6:8].any()


def test_frames_of_tf_have_these_names():
    found = [(frame['header']['frame_id'], frame['child_frame_id'])
             for frame in in_frames(TRANSFORMS.template, frame_names(GIVEN))['transforms']]
    assert found == [('map', 'left/base_link'), ('left/base_link', 'left/arm'),
                     ('left/arm', 'left/tip')]


@pytest.mark.parametrize('given, words', [
    ({'frame.arm': '/arm'},
     "frame.arm must be a name without blanks that does not begin with /, got '/arm'"),
    ({'frame.tip': ''}, 'frame.tip must be a name'),
    ({'frame_prefix': 'my robot/'}, 'frame_prefix must be empty or a text without blanks'),
    ({'frame.tip': 'arm'}, "must differ, got 'world', 'carrier', 'arm', 'arm'"),
])
def test_names_that_tf_would_refuse(given, words):
    with pytest.raises(ParameterError, match=words):
        frame_names(given)
