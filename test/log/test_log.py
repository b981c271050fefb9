# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node's log: contents by other readers, resets, names, and errors when it is not writable."""

from collections import Counter
import json
import resource

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from mcap.reader import make_reader, NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
from oracles import log_readers
import pytest
from ros_process import Client, Process
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
import yaml

import timo_sim
from timo_sim.log.read import recover

PUBLISHED = {'/joint_states': 'sensor_msgs/msg/JointState',
             '/timo_sim/modal_state': 'sensor_msgs/msg/JointState',
             '/timo_sim/tip_deflection': 'geometry_msgs/msg/Vector3Stamped',
             '/timo_sim/tip_pose': 'geometry_msgs/msg/PoseStamped',
             '/timo_sim/carrier_pose': 'geometry_msgs/msg/PoseStamped'}


@pytest.fixture(scope='module')
def recorded(ros, paper, tmp_path_factory):
    """Record a second of the paper's scene with a command; return log and received messages."""
    node, client = Process(tmp_path_factory.mktemp('run'), '--params-file', str(paper)), Client()
    seen = {'/joint_states': client.collect(JointState, '/joint_states'),
            '/timo_sim/tip_deflection': client.collect(Vector3Stamped,
                                                       '/timo_sim/tip_deflection')}
    client.command(Float64, '/timo_sim/motor_torque').publish(Float64(data=1.0))
    for messages in seen.values():
        client.wait(lambda: len(messages) >= 100, 'a second of messages')
    client.close()
    assert node.end()[0] == 0
    return node.log, seen


def key(stamp):
    """Return a time in nanoseconds."""
    return stamp.sec * 1000000000 + stamp.nanosec


def test_two_other_readers_find_the_published_messages(recorded):
    path, seen = recorded
    found = {topic: [] for topic in seen}
    with open(path, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert message.log_time == message.publish_time
            if channel.topic in PUBLISHED:
                assert schema.name == PUBLISHED[channel.topic]
                assert key(decoded.header.stamp) == message.log_time
                assert message.sequence == message.log_time // 1000000  # the time step, 1 ms
            if channel.topic in found:
                found[channel.topic].append(decoded)
    with AnyReader([path]) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        assert PUBLISHED.items() <= types.items()
        again = {topic: [] for topic in seen}
        for connection, timestamp, data in reader.messages():
            if connection.topic in again:
                message = reader.deserialize(data, connection.msgtype)
                assert key(message.header.stamp) == timestamp
                again[connection.topic].append(message)

    counts = {topic: len(messages) for topic, messages in found.items()}
    assert counts == {topic: len(messages) for topic, messages in again.items()}
    assert counts['/joint_states'] == counts['/timo_sim/tip_deflection']
    for source in (found, again):
        states = {key(m.header.stamp): m for m in source['/joint_states']}
        tips = {key(m.header.stamp): m for m in source['/timo_sim/tip_deflection']}
        for message in seen['/joint_states']:
            logged = states[key(message.header.stamp)]
            assert list(logged.name) == message.name
            for field in ('position', 'velocity', 'effort'):
                assert np.array_equal(getattr(logged, field), getattr(message, field))
        for message in seen['/timo_sim/tip_deflection']:
            logged = tips[key(message.header.stamp)]
            assert logged.header.frame_id == 'arm'
            assert (logged.vector.x, logged.vector.y) == (message.vector.x, message.vector.y)


def test_metadata_that_rosbag2_and_rerun_need(recorded):
    path, _ = recorded
    with open(path, 'rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        counts = Counter(channel.topic for _, channel, _ in reader.iter_messages())
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
        assert channel.metadata['topic_type_hash'].startswith('RIHS01_')
        assert len(channel.metadata['topic_type_hash']) == 7 + 64
        assert yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]['depth'] == 10
    # This is the hash of the type by REP-2011, as in every installation of ROS 2.
    hashes = {channel.topic: channel.metadata['topic_type_hash']
              for channel in summary.channels.values()}
    assert hashes['/joint_states'] == (
        'RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e')
    assert summary.chunk_indexes and summary.statistics.message_count == sum(counts.values())

    bag = yaml.safe_load(metadata['rosbag2']['serialized_metadata'])
    assert (bag['version'], bag['storage_identifier']) == (9, 'mcap')
    assert bag['message_count'] == summary.statistics.message_count
    assert {t['topic_metadata']['name']: t['message_count']
            for t in bag['topics_with_message_count'] if t['message_count']} == dict(counts)


def test_the_scene_in_the_log_repeats_the_run(recorded):
    """Parameters, initial motion and the command with its step are enough to get the motion."""
    path, seen = recorded
    with open(path, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        record = next(r.metadata for r in reader.iter_metadata() if r.name == 'timo_sim')
        commands = [(message.sequence, decoded.data) for _, channel, message, decoded
                    in reader.iter_decoded_messages() if channel.topic.endswith('motor_torque')]
    assert commands[0][1] == 1.0 and len(commands) == 1
    scene = timo_sim.load_scene(json.loads(record['parameters']), {
        'load.torque.piecewise.time': [commands[0][0] * 0.001],
        'load.torque.piecewise.value': [1.0]})
    assert json.loads(record['initial_motion']) == scene.initial_motion().tolist()
    assert {'numpy', 'scipy', 'numba', 'python', 'timo_sim'} <= set(record)
    last = seen['/joint_states'][-1]
    run = timo_sim.simulate(scene, key(last.header.stamp) * 1e-9, sample_every=10)
    # Here the command is one of the scene's loads, which are summed in another order.
    assert np.abs(run.motion[-1, :3] - last.position).max() < 1e-13


def test_a_reset_is_in_the_log(start, client):
    node = start(start_paused=True, steps_per_call=30)
    step = client.service(Trigger, '/timo_sim/step')
    assert step().success and client.service(Trigger, '/timo_sim/reset')().success
    assert step().success
    assert node.end()[0] == 0
    with open(node.log, 'rb') as stream:
        resets = [record.metadata for record in make_reader(stream).iter_metadata()
                  if record.name == 'timo_sim.reset']
    assert resets == [{'step': '30'}]


def test_a_log_is_never_overwritten(start, tmp_path):
    earlier = [tmp_path / name for name in ('run.mcap', 'run_1.mcap')]
    for path in earlier:
        path.write_bytes(b'precious')
    assert start(duration=0.1).wait()[0] == 0
    assert [path.read_bytes() for path in earlier] == 2 * [b'precious']
    with open(tmp_path / 'run_2.mcap', 'rb') as stream:
        assert make_reader(stream).get_summary().statistics.message_count > 0


def test_the_default_name_has_date_and_time(start, tmp_path):
    assert start(duration=0.1, record_file="''").wait()[0] == 0
    assert len(list(tmp_path.glob('timo_sim_????????_??????.mcap'))) == 1


def errors(client, health):
    """Wait for an error in diagnostics and for time going on after it; return its text."""
    client.wait(lambda: health and health[-1].status[0].level == DiagnosticStatus.ERROR,
                'an error in diagnostics')
    first = health[-1]
    client.wait(lambda: key(health[-1].header.stamp) > key(first.header.stamp), 'time going on')
    return first.status[0].message


def test_a_folder_that_cannot_be_made_is_an_error_and_the_node_goes_on(start, client, tmp_path):
    (tmp_path / 'file').write_text('not a folder')
    node = start(record_file=str(tmp_path / 'file' / 'run.mcap'))
    message = errors(client, client.collect(DiagnosticArray, '/diagnostics'))
    assert 'no log is written' in message and 'run.mcap' in message
    code, output = node.end()
    assert code == 0 and output.count('no log is written') == 1


def test_a_disk_that_fills_up_is_an_error_and_the_log_can_be_recovered(start, client):
    """The kernel refuses to let the file grow beyond 60 kB, as a full disk would."""
    limit = 60000
    node = start(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    message = errors(client, client.collect(DiagnosticArray, '/diagnostics'))
    assert 'the log ends early' in message
    code, output = node.end()
    assert code == 0 and output.count('the log ends early') == 1
    with open(node.log, 'rb') as stream:
        assert count_whole_chunks(stream) > 0
    assert 'complete in' in recover(node.log)
    assert log_readers.decoded(node.log.with_name('run_recovered.mcap'))['/joint_states'] > 0


def count_whole_chunks(stream):
    """Count the messages of a log without an end."""
    count = 0
    try:
        for _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
            count += 1
    except Exception:  # the end of a cut file; messages before it count
        pass
    return count
