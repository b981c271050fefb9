# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Logs and bags as arrays: agreement with other readers, old logs, damaged and forged files."""

import json
import os
import shutil

from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer as McapWriter
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from ros_process import Process
import timo_sim
from timo_sim.cli import main
from timo_sim.log.export import table
from timo_sim.log.info import info
from timo_sim.log.notes import CHANGE, START
from timo_sim.log.read import LogError
from timo_sim.log.tables import common, Recording
from timo_sim.log.write import Channel, Recorder
from timo_sim.topics.cdr import Serializer
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs

LIES = 150
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope='module')
def log(tmp_path_factory, paper):
    """Log two seconds of the paper's scene, some topics slower than others, two remapped."""
    node = Process(tmp_path_factory.mktemp('log'), '--params-file', str(paper), '-r',
                   '__ns:=/left', '-r', 'joint_states:=timo_sim/joint_states', '-r',
                   '~/commands:=/arm/commands', real_time_factor=0.0, duration=2.0,
                   **{'rate.joint_states': 500.0, 'rate.modal_state': 250.0})
    assert node.wait()[0] == 0
    return node.log


def numbers(message):
    """Return the columns of a joint state that another reader has decoded."""
    return [*message.position, *message.velocity, *message.effort]


def test_a_log_of_version_0_1_gets_the_present_names_and_limits(tmp_path):
    """Two parameters had other names, and a limit of 0 meant no limit."""
    recorder = Recorder(tmp_path / 'old.mcap', [
        Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')], {START: {
            'node': '/timo_sim', 'changed': '{}', 'parameters': json.dumps({
                'motor.dc.resistance': 0.5, 'motor.dc.torque_constant': 0.06,
                'motor.dc.gear': 3.0, 'motor.dc.voltage_limit': 0.0, 'motor.torque_limit': 0.0,
                'carrier.force_limit': 100.0, 'step_count': 7})}})
    recorder.note(CHANGE, {'step': '5', 'values': '{"carrier.force_limit": 0.0}'})
    recorder.close()
    recording = Recording(tmp_path / 'old.mcap')
    found = recording.scene.values
    assert found['motor.dc.gear_ratio'] == 3.0 and found['carrier.force_limit'] == 100.0
    assert found['motor.torque_limit'] == found['motor.dc.voltage_limit'] == np.inf
    assert recording.parameters['steps_per_call'] == 7
    (step, _, values), = recording.changes
    assert step == 5 and values == {'carrier.force_limit': np.inf}


def test_an_imu_of_an_older_log_or_bag_gets_its_present_name(tmp_path):
    output, = (output for output in outputs(0) if output.name == '~/tip_imu/data_raw')
    recorder = Recorder(
        tmp_path / 'old.mcap', [Channel('/left/sim/tip_imu', output.type_name)], {})
    recorder.write(0, 1, 1000000, Serializer(output.type_name, output.template)(
        (0, 1000000), (1.0, 2.0, 3.0)))
    recorder.close()
    recording = Recording(tmp_path / 'old.mcap')
    assert recording.name == '/left/sim'
    assert recording.topics['~/tip_imu/data_raw'].values.tolist() == [[1.0, 2.0, 3.0]]
    columns, _ = table(recording, '~/tip_imu/data_raw')
    assert list(columns) == ['time_s', *output.columns]


def test_joint_states_of_a_bag_are_those_of_the_simulator(tmp_path):
    """If ros2_control publishes joint_states, the simulator's are those below its name."""
    output, = (output for output in outputs(0) if output.name == 'joint_states')
    serialize = Serializer(output.type_name, output.template)
    recorder = Recorder(tmp_path / 'bag.mcap', [
        Channel('/joint_states', output.type_name), Channel('/sim/joint_states', output.type_name),
        Channel('/sim/motor_torque', 'std_msgs/msg/Float64')], {})
    for index in 0, 1:
        recorder.write(index, 1, 1000000, serialize((0, 1000000), [float(index)] * 9))
    recorder.close()
    assert Recording(tmp_path / 'bag.mcap').topics['joint_states'].values.tolist() == [[1.0] * 9]


def test_series_agree_with_another_reader(log):
    recording = Recording(log)
    assert recording.name == '/left/timo_sim' and not len(recording.resets)
    topics = recording.topics
    assert set(topics) == {'joint_states', '~/modal_state', '~/tip_deflection', '~/tip_pose',
                           '~/carrier_pose', '~/root_strain', '~/tip_imu/data_raw', '~/encoder',
                           *(command.name for command in COMMANDS)} - {
                               '~/motor_voltage'}  # there is no such motor
    found = {name: [] for name in topics}
    for message in read_ros2_messages(str(log)):
        if message.channel.topic != '/diagnostics':
            found[recording.short_name(message.channel.topic)].append(message)
    for name, series in topics.items():
        assert series.step.tolist() == [message.sequence_count for message in found[name]]
        assert series.ns.tolist() == [message.log_time_ns for message in found[name]]
        assert series.values.shape == (len(found[name]), len(series.columns))
    for name in ('joint_states', '~/modal_state'):
        assert topics[name].values.tolist() == [
            numbers(message.ros_msg) for message in found[name]]
    assert topics['~/tip_pose'].values.tolist() == [
        [pose.position.x, pose.position.y, pose.orientation.z, pose.orientation.w]
        for pose in (message.ros_msg.pose for message in found['~/tip_pose'])]
    assert topics['~/tip_deflection'].columns == ('axial_m', 'transverse_m')


def test_motion_and_scene_are_those_of_the_run(log, paper):
    recording = Recording(log)
    scene = timo_sim.load_scene(paper)
    assert recording.scene == scene
    step, ns, motion = recording.motion()
    run = timo_sim.simulate(scene, 2.0, sample_every=4)
    assert step.tolist() == list(range(0, 2001, 4)) and ns.tolist() == (step * 1000000).tolist()
    assert np.array_equal(motion, run.motion)


def test_a_bag_has_sim_time_of_headers_and_commands_by_log_time(tmp_path):
    """A bag of another tool: wall time as log time, and one command that the node would refuse."""
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        deflection, torque = (
            bag.add_connection(topic, kind, typestore=STORE) for topic, kind in (
                ('/timo_sim/tip_deflection', 'geometry_msgs/msg/Vector3Stamped'),
                ('/timo_sim/motor_torque', 'std_msgs/msg/Float64')))
        types = STORE.types
        start = 1700000000000000000
        for k in (0, 1, 3, 2, *range(4, 11)):  # at half speed, one late
            header = types['std_msgs/msg/Header'](
                types['builtin_interfaces/msg/Time'](5, k * 1000000), 'arm')
            message = types[deflection.msgtype](
                header, types['geometry_msgs/msg/Vector3'](0.5 * k, -k, 0.0))
            bag.write(deflection, start + 2000000 * k,
                      STORE.serialize_cdr(message, deflection.msgtype))
        for log_time, value in ((-4, 1.0), (5, np.nan), (5, 2.0), (30, 3.0)):
            bag.write(torque, start + 1000000 * log_time, STORE.serialize_cdr(
                types[torque.msgtype](value), torque.msgtype))
    recording = Recording(tmp_path / 'bag')
    assert recording.scene is None and recording.name == '/timo_sim'
    tip, torque = recording.topics['~/tip_deflection'], recording.topics['~/motor_torque']
    assert tip.ns.tolist() == [5000000000 + k * 1000000 for k in range(11)]
    assert tip.values.tolist() == [[0.5 * k, -k] for k in range(11)]
    assert torque.values.tolist() == [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]] and torque.refused == 1
    assert torque.ns.tolist() == [4998000000, 5002500000, 5015000000]
    assert set(torque.step) == {-1}


def test_a_late_sensor_is_not_the_clock_of_a_bag(tmp_path):
    """Its headers have the time of measurement, 0.2 s ago; joint states have the present time."""
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        encoder, joints, torque = (
            bag.add_connection(topic, kind, typestore=STORE) for topic, kind in (
                ('/timo_sim/encoder', 'sensor_msgs/msg/JointState'),
                ('/joint_states', 'sensor_msgs/msg/JointState'),
                ('/timo_sim/motor_torque', 'std_msgs/msg/Float64')))
        types, none = STORE.types, np.zeros(0)
        for k in range(11):
            for connection, names, late in ((encoder, ['shaft'], 200), (
                    joints, ['carrier_x', 'carrier_y', 'shaft'], 0)):
                header = types['std_msgs/msg/Header'](
                    types['builtin_interfaces/msg/Time'](5, (300 + k - late) * 1000000), '')
                numbers = np.zeros(len(names))
                message = types[connection.msgtype](
                    header, names, numbers, *([none, none] if late else [numbers, numbers]))
                bag.write(connection, 1000000 * k, STORE.serialize_cdr(
                    message, connection.msgtype))
        bag.write(torque, 4000000, STORE.serialize_cdr(types[torque.msgtype](1.0),
                                                       torque.msgtype))
    topics = Recording(tmp_path / 'bag', '/timo_sim').topics
    assert topics['~/encoder'].ns[0] == 5100000000
    assert topics['~/motor_torque'].ns.tolist() == [5304000000]


def changed(log, folder, change):
    """Return a copy of a log, changed by a function of its bytes."""
    data = bytearray(log.read_bytes())
    change(data)
    path = folder / 'changed.mcap'
    path.write_bytes(data)
    return path


def cut(data):
    del data[-1000:]


def damage_chunk(data):
    place = data.index(b'lz4') + 200
    data[place:place + 8] = b'\xff' * 8


def damage_summary(data):
    data[-100] ^= 1


@pytest.mark.parametrize('change, words', [
    (cut, 'has no end.*timo_sim recover'),
    (damage_chunk, 'damaged.*timo_sim recover'),
    (damage_summary, 'checksum of the summary is wrong.*timo_sim recover'),
    (lambda data: data.clear(), 'is empty'),
    (lambda data: data.__setitem__(slice(0, 4), b'oops'), 'not an MCAP file')])
def test_damaged_logs_are_refused_with_advice(log, tmp_path, change, words):
    with pytest.raises(LogError, match=words):
        recording = Recording(changed(log, tmp_path, change))
        recording.topics


def lying_index(log, folder, lie):
    """Return a copy of a log in which `lie` has changed the index of a channel, (n, 2)."""
    index = Recording(log).index
    chunk = index.chunks[0]
    number, place = next(
        (number, place) for number, place in chunk.message_index_offsets.items()
        if index.channels[number].topic.endswith('joint_states'))
    count = len(index.times(chunk)[number])

    def change(data):
        entries = np.frombuffer(data[place + 15:place + 15 + 16 * count], '<u8').reshape(-1, 2)
        entries = entries.copy()
        lie(entries)
        data[place + 15:place + 15 + 16 * count] = entries.tobytes()
    return changed(log, folder, change)


@pytest.mark.parametrize('lie', [
    lambda entries: entries.__setitem__((slice(None), 1), entries[0, 1]),   # all alike
    lambda entries: entries.__setitem__((3, 1), 2**63),                     # far outside
    lambda entries: entries.__setitem__((3, 1), entries[3, 1] + 1),         # beside a message
])
def test_a_forged_index_is_refused(log, tmp_path, lie):
    with pytest.raises(LogError, match='joint_states.*the index points to something'):
        Recording(lying_index(log, tmp_path, lie)).topics


def test_an_invalid_scene_in_a_log_is_an_error(log, tmp_path):
    def change(data):
        place = data.index(b'"arm.length": 2.0')
        data[place:place + 17] = b'"arm.length": -20'
    path = changed(log, tmp_path, change)
    recording = Recording(path)
    with pytest.raises(LogError, match='scene cannot be built: arm.length must be'):
        recording.scene


@pytest.mark.parametrize('facts', [
    {'node': '/timo_sim'}, {'parameters': '', 'node': '/timo_sim'}, {'parameters': '[]'},
    {'topics': '[1]'}, {'topics': '{"/timo_sim/motor_torque": [1]}'}])
def test_a_log_without_a_scene_gives_one_line(tmp_path, facts):
    path = tmp_path / 'run.mcap'
    recorder = Recorder(path, [
        Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')], {START: facts})
    recorder.close()
    for command in (['replay'], ['replay', '--set', 'model.modes=2'], ['export', '-o', 'a.csv']):
        result = CliRunner().invoke(main, [command[0], str(path), *command[1:]])
        assert result.exit_code == 2 and result.output.count('\n') == 1
        assert 'its scene cannot be built' in result.output or command[0] == 'export'


def test_a_log_is_open_only_while_it_is_read(log):
    recording = Recording(log)
    assert len(recording.topics['joint_states'].ns) == 1001
    opened = {os.path.realpath(f'/proc/self/fd/{number}') for number in
              os.listdir('/proc/self/fd')}
    assert str(log) not in opened


def test_files_without_chunks_are_read_too(log, tmp_path):
    """rosbag2 writes such files with its profile `fastwrite`; here mcap's writer makes one."""
    path = tmp_path / 'plain.mcap'
    with open(log, 'rb') as source, open(path, 'wb') as target:
        writer = McapWriter(target, use_chunking=False)
        writer.start('ros2')
        numbers = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata)
            writer.add_message(numbers[channel.id], message.log_time, message.data,
                               message.publish_time, message.sequence)
        writer.finish()
    ours, plain = Recording(log).topics, Recording(path).topics
    for name, series in plain.items():
        assert np.array_equal(series.values, ours[name].values)


def test_a_folder_with_two_files_asks_for_one(log, tmp_path):
    for name in ('a.mcap', 'b.mcap'):
        shutil.copy(log, tmp_path / name)
    with pytest.raises(LogError, match='2 files'):
        Recording(tmp_path)


@pytest.fixture(scope='module')
def unchecked(log, tmp_path_factory):
    """Return the bytes of a short log without checksums, so that no change of bytes shows."""
    path = tmp_path_factory.mktemp('unchecked') / 'run.mcap'
    with open(log, 'rb') as source, open(path, 'wb') as target:
        writer = McapWriter(target, chunk_size=2000, compression=CompressionType.NONE,
                            enable_crcs=False)
        writer.start('ros2')
        reader, numbers = make_reader(source), {}
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.add_metadata('timo_sim.reset', {'step': '20'})
        for schema, channel, message in reader.iter_messages(end_time=50000000):
            if channel.id not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, b'')
                numbers[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, {})
            writer.add_message(numbers[channel.id], message.log_time, message.data,
                               message.publish_time, message.sequence)
        writer.finish()
    return path.read_bytes()


def test_a_changed_file_is_a_log_or_a_log_error(unchecked, tmp_path):
    """With some bytes changed it gives arrays or a LogError of one line."""
    random, path, refused = np.random.default_rng(1), tmp_path / 'run.mcap', 0
    for _ in range(LIES):
        data = bytearray(unchecked)
        place = int(random.integers(len(data) - 9))
        size = int(random.choice([1, 2, 4, 8]))
        data[place:place + size] = random.choice(
            [random.bytes(size), bytes(size), b'\xff' * size])
        path.write_bytes(data)
        try:
            info(path)
            recording = Recording(path)
            recording.scene, recording.topics, recording.motion()
        except LogError as error:
            refused += 1
            assert '\n' not in str(error)
    assert 0.05 * LIES < refused < LIES


def test_samples_after_a_reset_are_joined_with_those_after_it():
    """With a reset at 35 joint states are before and after it, modal states after it only."""
    joints, modes = np.array([25, 30, 35, 35, 40]), np.array([30, 35, 40])
    first, second = common(joints, modes)
    assert first.tolist() == [1, 3, 4] and second.tolist() == [0, 1, 2]
    first, second = common(np.array([30, 30, 30, 50]), np.array([30, 30, 30, 40]))
    assert first.tolist() == second.tolist() == [0, 1, 2]
