# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Logs and bags as arrays, tables and facts: agreement with other readers; older and bad files."""

import csv
import json
import random
import re
import subprocess
import sys
from types import SimpleNamespace

from command_line import call
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer as McapWriter
from mcap_ros2.reader import read_ros2_messages
import numpy as np
from oracles.logs import places
import pyarrow.parquet
import pytest
from ros_process import Client, Process, replayed
from rosbags.interfaces import (
    Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
import yaml

import timo_sim
from timo_sim.log.info import info
from timo_sim.log.notes import CHANGE, change_note, RESET, START, SUMMARY
from timo_sim.log.read import LogError, LogFile, recover
from timo_sim.log.tables import common, Recording, table
from timo_sim.log.write import Channel, Recorder
from timo_sim.topics.cdr import Serializer
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs

LIES = 100
STORE, ZERO = get_typestore(Stores.ROS2_JAZZY), QosTime(0, 0)


@pytest.fixture(scope='module')
def log(tmp_path_factory, paper):
    """Log two seconds of the paper's scene, some topics slower than others, two remapped."""
    node = Process(tmp_path_factory.mktemp('log'), '--params-file', str(paper), '-r',
                   '__ns:=/left', '-r', 'joint_states:=timo_sim/joint_states', '-r',
                   '~/commands:=/arm/commands', real_time_factor=0.0, duration=2.0, **{
                       'rate.joint_states': 100.0, 'rate.tip_pose': 200.0,
                       'rate.modal_state': 50.0, 'rate.tip_deflection': 1000.0})
    assert node.wait()[0] == 0
    return node.log


@pytest.fixture(scope='module')
def run(paper):
    return timo_sim.simulate(timo_sim.load_scene(paper), 2.0, sample_every=10)


@pytest.fixture(scope='module')
def with_reset(ros, tmp_path_factory):
    """Log a command that acts, a reset, and the command again, 0.1 s each."""
    client = Client()
    node = Process(tmp_path_factory.mktemp('reset'), start_paused=True, steps_per_call=100)
    torque = client.command(Float64, '/timo_sim/motor_torque')
    step = client.service(Trigger, '/timo_sim/step')
    for reset in (True, False):
        torque.publish(Float64(data=1.0))
        step()
        if reset:
            client.service(Trigger, '/timo_sim/reset')()
    client.close()
    assert node.end()[0] == 0
    return node.log


def numbers(message):
    """Return the columns of a joint state that another reader has decoded."""
    return [*message.position, *message.velocity, *message.effort]


def recorded(path, topics, messages, notes=None):
    """Write messages, (index of a topic, step, numbers), on (topic, name of its output)."""
    known = {output.name: output for output in outputs(0)}
    recorder = Recorder(path, [Channel(topic, known[name].type_name)
                               for topic, name in topics], notes or {})
    serializers = [Serializer(known[name].type_name, known[name].template) for _, name in topics]
    for index, step, numbers in messages:
        recorder.write(index, step, step * 1000000,
                       serializers[index]((0, step * 1000000), numbers))
    recorder.close()
    return Recording(path)


def test_names_of_topics_of_other_nodes_and_of_older_logs(tmp_path):
    """The IMU had another name; joint states below a node's name are its, not ros2_control's."""
    imu, old = '~/tip_imu/data_raw', recorded(
        tmp_path / 'old.mcap', [('/left/sim/tip_imu', '~/tip_imu/data_raw')],
        [(0, 1, (1.0, 2.0, 3.0))])
    assert old.name == '/left/sim' and old.topics[imu].values.tolist() == [[1.0, 2.0, 3.0]]
    columns, _ = table(old, imu)
    assert list(columns)[0] == 'time_s' and len(columns) == 4
    two = recorded(tmp_path / 'bag.mcap', [
        ('/joint_states', 'joint_states'), ('/sim/joint_states', 'joint_states'),
        ('/sim/tip_deflection', '~/tip_deflection')], [(k, 1, 9 * [1.0 * k]) for k in (0, 1)])
    assert two.topics['joint_states'].values.tolist() == [[1.0] * 9]


def test_series_agree_with_another_reader(log, paper):
    recording = Recording(log)
    assert recording.name == '/left/timo_sim' and not len(recording.resets)
    assert recording.scene == timo_sim.load_scene(paper)
    topics = recording.topics
    # The log has no clock, and there is no motor with a voltage.
    assert set(topics) == {each.name for each in (*recording.scene.outputs, *COMMANDS)} - {
        '/clock', '~/motor_voltage'}
    found = {name: [] for name in topics}
    for message in read_ros2_messages(str(log)):
        if message.channel.topic not in ('/diagnostics', '/tf', '/left/robot_description'):
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
    run = timo_sim.simulate(recording.scene, 2.0, sample_every=20)
    assert np.array_equal(recording.motion()[1], run.values)


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
        types, none, three = STORE.types, np.zeros(0), np.zeros(3)
        joint_states = types['sensor_msgs/msg/JointState']
        for topic, late, names, *numbers in (
                ('/timo_sim/encoder', 200, ['shaft'], three[:1], none, none),
                ('/joint_states', 0, ['carrier_x', 'carrier_y', 'shaft'], three, three, three)):
            connection = bag.add_connection(topic, joint_states.__msgtype__, typestore=STORE)
            for k in range(11):
                header = types['std_msgs/msg/Header'](
                    types['builtin_interfaces/msg/Time'](5, (300 + k - late) * 1000000), '')
                bag.write(connection, 1000000 * k, STORE.serialize_cdr(
                    joint_states(header, names, *numbers), connection.msgtype))
        torque = bag.add_connection('/timo_sim/motor_torque', 'std_msgs/msg/Float64',
                                    typestore=STORE)
        bag.write(torque, 4000000, STORE.serialize_cdr(types[torque.msgtype](1.0),
                                                       torque.msgtype))
    topics = Recording(tmp_path / 'bag', '/timo_sim').topics
    assert topics['~/encoder'].ns[0] == 5100000000
    assert topics['~/motor_torque'].ns.tolist() == [5304000000]


def test_damaged_logs_are_refused_with_advice(log, tmp_path):
    data, path = log.read_bytes(), tmp_path / 'damaged.mcap'
    chunk = data.index(b'lz4') + 200
    for damaged, words in (
            (data[:-1000], 'has no end.*timo_sim recover'), (b'', 'is empty'),
            (data[:chunk] + b'\xff' * 8 + data[chunk + 8:], 'damaged.*timo_sim recover'),
            (data[:-100] + bytes([data[-100] ^ 1]) + data[-99:],
             'checksum of the summary is wrong.*timo_sim recover'),
            (b'oops' + data[4:], 'not an MCAP file')):
        path.write_bytes(damaged)
        with pytest.raises(LogError, match=words):
            Recording(path).topics


def test_a_log_without_a_scene_gives_one_line(tmp_path):
    for number, facts in enumerate((
            {'node': '/timo_sim'}, {'parameters': '', 'node': '/timo_sim'}, {'parameters': '[]'},
            {'topics': '[1]'}, {'topics': '{"/timo_sim/motor_torque": [1]}'})):
        path = tmp_path / f'{number}.mcap'
        Recorder(path, [Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')], {
            START: facts}).close()
        for command in (['replay'], ['replay', '--set', 'model.modes=2'],
                        ['export', '-o', 'a.csv']):
            text = call(command[0], path, *command[1:], code=2)
            assert text.count('\n') == 1
            assert 'its scene cannot be built' in text or command[0] == 'export'


def records(path):
    """Return the records of the data section, in their order, as mcap reads them."""
    found = []
    with open(path, 'rb') as stream:
        for entry in StreamReader(stream).records:
            if isinstance(entry, DataEnd):
                return found
            if isinstance(entry, (Schema, ChannelRecord, Message, Metadata)):
                found.append(entry)
    return found


def rewritten(log, path, change=list, attachment=False, **options):
    """Write what `change` makes of a log's records by mcap's writer, in small chunks."""
    with open(path, 'wb') as stream:
        writer = McapWriter(stream, **{'chunk_size': 4096, **options})
        writer.start('ros2')
        schemas, channels = {0: 0}, {}
        for entry in change(records(log)):
            if isinstance(entry, Schema):
                schemas[entry.id] = writer.register_schema(entry.name, entry.encoding, entry.data)
            elif isinstance(entry, ChannelRecord):
                channels[entry.id] = writer.register_channel(
                    entry.topic, entry.message_encoding, schemas[entry.schema_id], entry.metadata)
            elif isinstance(entry, Message):
                writer.add_message(channels[entry.channel_id], entry.log_time, entry.data,
                                   entry.publish_time, entry.sequence)
            else:
                writer.add_metadata(entry.name, entry.metadata)
        if attachment:
            writer.add_attachment(1, 2, 'note.txt', 'text/plain', b'by hand')
        writer.finish()
    return path


def messages_first(order):
    """Return a function that orders messages by `order` and puts metadata behind them."""
    def change(entries):
        rest, messages, notes = ([entry for entry in entries if kind(entry)] for kind in (
            lambda entry: not isinstance(entry, (Message, Metadata)),
            lambda entry: isinstance(entry, Message), lambda entry: isinstance(entry, Metadata)))
        return [*rest, *order(messages), *notes]
    return change


def shuffled(messages):
    return random.Random(5).sample(messages, len(messages))


@pytest.fixture(scope='module')
def source(with_reset, tmp_path_factory):
    """Return a log of the first 0.1 s of a run with a command, written by mcap's writer."""
    def before_the_reset(entries):
        names = [getattr(entry, 'name', '') for entry in entries]
        return entries[:names.index('timo_sim.reset')]
    return rewritten(with_reset, tmp_path_factory.mktemp('source') / 'run.mcap', before_the_reset)


def test_the_numbers_at_the_end_of_a_nodes_log_are_numbers(log, tmp_path):
    run = timo_sim.open_log(log)
    assert 'does not say whether there were warnings' in run.message and repr(run)
    assert run.stats.pop('timing').startswith('no sim time was lost')
    assert run.stats['refused_commands'] == 0
    assert {type(value) for value in run.stats.values()} == {int, float}
    assert 0.0 < run.stats['estimated_tip_error_m'] < 1e-5

    def forged(entries):
        return [Metadata(name=SUMMARY, metadata={'estimated_tip_error_m': text}) if (
            isinstance(entry, Metadata) and entry.name == SUMMARY) else entry
            for entry in entries]
    for text, told in ('1e-5', 'estimated tip error 1e-05 m'), ('no number', 'warnings; '):
        path = rewritten(log, tmp_path / f'{text}.mcap', forged)
        assert told in repr(timo_sim.open_log(path))


def test_a_log_that_other_tools_rewrote_is_read_and_replayed_the_same(source, tmp_path):
    ours, path, compared = Recording(source).topics, tmp_path / 'run.mcap', set()
    assert ours['~/motor_torque'].values.tolist() == [[1.0, 0.0]]
    for change, options in (
            (list, {}), (list, {'compression': CompressionType.ZSTD}),
            (list, {'compression': CompressionType.NONE, 'chunk_size': 1}),
            (list, {'use_chunking': False}), (list, {'attachment': True, 'enable_crcs': False}),
            (list, {'index_types': IndexType.CHUNK | IndexType.METADATA}),
            (messages_first(shuffled), {}),
            (messages_first(shuffled), {'use_chunking': False})):
        found = Recording(rewritten(source, path, change, **options)).topics
        assert found.keys() == ours.keys()
        for name, series in found.items():
            assert np.array_equal(series.step, ours[name].step)
            assert np.array_equal(series.values, ours[name].values, equal_nan=True)
        compared.update(line for line in replayed(path) if 'compared' in line)
        messages, text = LogFile(path).summary.statistics.message_count, call('info', path)
        assert f'is complete: {messages} messages' in recover(path)
        assert 'joint_states 11 100 Hz ' in ' '.join(text.split())
    line, = compared
    assert re.match(r'(\d+) of \1 logged numbers compared: all', line)


def test_a_log_without_a_whole_summary_is_refused(source, tmp_path):
    for options in ({'use_statistics': False}, {'repeat_channels': False},
                    {'repeat_schemas': False}, {'index_types': IndexType.NONE}):
        path = rewritten(source, tmp_path / 'run.mcap', **options)
        assert 'timo_sim recover' in call('replay', path, code=2)
        recover(path, tmp_path / 'new.mcap')
        replayed(tmp_path / 'new.mcap')
        (tmp_path / 'new.mcap').unlink()


def test_an_unknown_order_at_a_reset_is_refused(with_reset, tmp_path):
    assert len(Recording(with_reset).resets) == 1
    replayed(with_reset)
    for order in (shuffled, list):
        path = rewritten(with_reset, tmp_path / 'run.mcap', messages_first(order))
        assert 'does not say which messages were before a reset' in call('replay', path, code=2)


@pytest.mark.parametrize('lie', [b'\0', b'\1', b'\xff'])
def test_an_index_that_does_not_fit_its_chunk_is_not_believed(log, tmp_path, lie):
    data, path = bytearray(log.read_bytes()), tmp_path / 'run.mcap'
    for place, opcode, length in places(bytes(data)):
        if opcode == Opcode.MESSAGE_INDEX:
            data[place + 15:place + length] = (length - 15) * lie
        elif opcode == Opcode.DATA_END:  # without a checksum
            data[place + 9:place + length] = bytes(4)
    path.write_bytes(data)
    ours, same = Recording(log).topics, Recording(path).topics
    assert all(np.array_equal(ours[name].values, each.values) and each.data == ours[name].data
               for name, each in same.items()) and same.keys() == ours.keys()


def test_notes_of_two_runs_are_refused(source, tmp_path):
    def merged(entries):
        return [*entries, *(Metadata(entry.name, {**entry.metadata, 'node': '/other'})
                            for entry in entries if isinstance(entry, Metadata))]
    path = rewritten(source, tmp_path / 'run.mcap', merged)
    for command in ('info', 'replay'):
        assert 'has the notes of several runs' in call(command, path, code=2)


def test_a_topic_that_cannot_be_read_fails_a_replay_and_is_named_in_a_table(source, tmp_path):
    def without_a_schema(entries):
        for entry in entries:
            if isinstance(entry, ChannelRecord) and entry.topic.endswith('tip_pose'):
                entry.schema_id = 0
        return entries
    path = rewritten(source, tmp_path / 'run.mcap', without_a_schema)
    words = ('/timo_sim/tip_pose is not read: its type is unknown, without a schema, encoded as '
             "'cdr'")
    text = call('replay', path, code=1)
    assert words in text and ' of ' in text and ': all' not in text
    assert words in call('export', path, '-o', tmp_path / 'table.csv')


def test_a_changed_file_is_a_log_or_a_log_error(source, tmp_path):
    """With some bytes changed and no checksums it gives arrays or a LogError of one line."""
    intact = rewritten(source, tmp_path / 'run.mcap', compression=CompressionType.NONE,
                       enable_crcs=False).read_bytes()
    generator, path, refused = np.random.default_rng(1), tmp_path / 'run.mcap', 0
    for _ in range(LIES):
        data = bytearray(intact)
        place = int(generator.integers(len(data) - 9))
        size = int(generator.choice([1, 2, 4, 8]))
        data[place:place + size] = generator.choice(
            [generator.bytes(size), bytes(size), b'\xff' * size])
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
    def series(ns, resets):
        return SimpleNamespace(ns=np.array(ns, dtype=int), resets=np.array(resets, dtype=int))
    joints = series([25, 30, 35, 35, 40], [0, 0, 0, 1, 1])
    first, second = common(joints, series([30, 35, 40], [0, 1, 1]))
    assert first.tolist() == [1, 3, 4] and second.tolist() == [0, 1, 2]
    # A state that was shown twice has the last of the others both times.
    first, second = common(series([30, 30, 50], 3 * [0]), series([30, 30, 40], 3 * [0]))
    assert first.tolist() == [0, 1] and second.tolist() == [1, 1]
    assert not len(common(joints, series([], []))[0])


def test_info_describes_the_run(log):
    text = call('info', log)
    for words in ('log of /left/timo_sim', 'load.torque.harmonic.frequency = [4.0]', 'numpy ',
                  'sim time  0 to 2 s', 'refused_commands 0', 'resets    none'):
        assert words in text
    rows = {words[0]: words[1:] for words in map(str.split, text.splitlines()) if words}
    assert rows['/left/timo_sim/tip_pose'] == ['401', '200', 'Hz']
    assert rows['/left/timo_sim/modal_state'] == ['101', '50', 'Hz']
    assert rows['/left/timo_sim/motor_torque'] == ['0', '-']
    assert max(map(len, text.splitlines())) < 200


def test_info_says_how_many_resets_and_changes_it_leaves_out(tmp_path):
    recorder = Recorder(tmp_path / 'run.mcap', [Channel('/x', 'std_msgs/msg/Float64')],
                        {START: {'node': '/timo_sim'}})
    for step in range(23):
        recorder.note(RESET, {'step': str(step)})
        recorder.note(CHANGE, change_note(step, {'end_effector.mass': 1.0, 'gravity': 0.0}))
    recorder.close()
    text = call('info', tmp_path / 'run.mcap')
    assert 'resets    23, at steps 0, 1, 2, 3, 4, 5, 6, 7, ...\n' in text
    assert text.count('end_effector.mass') == 10 and '\n            and 26 more\n' in text


def test_info_prints_no_control_characters(tmp_path):
    recorder = Recorder(tmp_path / 'run.mcap', [Channel('/\x1b[2J', 'std_msgs/msg/Float64')], {
        'timo_sim': {'node': '\x1b]0;', 'changed': json.dumps({'\x1b': 1}), 'numpy': '\x1b'}})
    recorder.close()
    text = call('info', tmp_path / 'run.mcap')
    assert '\x1b' not in text and '[2J' in text


def test_info_of_a_gigabyte_reads_no_chunk(tmp_path):
    """It says the same of a log whose chunks, all but the metadata at their start, are gone."""
    path = tmp_path / 'run.mcap'
    recorder = Recorder(path, [Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')], {})
    for k in range(1001):
        recorder.write(0, k, k * 10000000, bytes(12))
    recorder.close()
    text = call('info', path)
    assert '1001  100 Hz' in text
    chunk, = LogFile(path).summary.chunk_indexes
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset:chunk.chunk_start_offset + chunk.chunk_length] = bytes(
        chunk.chunk_length)
    path.write_bytes(data)
    assert call('info', path) == text


def test_info_imports_no_physics(log):
    code = ('import sys; from timo_sim.log.info import info; info(sys.argv[1]); '
            'assert not {"numba", "scipy", "rclpy"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', code, log], check=True)


def test_a_table_has_the_run_with_units_in_its_names(log, run, tmp_path):
    """pandas and MATLAB read Parquet and CSV; pyarrow and csv do so here."""
    assert 'left out' in call('export', log, '-o', tmp_path / 'run.parquet')
    table = pyarrow.parquet.read_table(tmp_path / 'run.parquet').to_pydict()
    call('export', log, '-o', tmp_path / 'run.csv')
    with open(tmp_path / 'run.csv') as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(table)
    for name, values in table.items():
        assert [float(row[name]) if row[name] else None for row in rows] == values
    assert table['step'] == list(range(0, 2001, 10))
    assert np.allclose(table['time_s'], run.t, rtol=0, atol=1e-12)
    assert np.array_equal(table['carrier_x_m'], run.carrier[:, 0])
    assert np.array_equal(table['shaft_velocity_rad_per_s'], run.shaft_velocity)
    assert np.array_equal(table['mode_2_m_sqrt_kg'][::2], run.q[::2, 1])
    assert set(table['mode_2_m_sqrt_kg'][1::2]) == {None}  # half as often as joint states
    assert np.allclose(table['tip_deflection_transverse_m'], run.deflection(2.0)[:, 1],
                       rtol=0, atol=1e-14)
    assert np.allclose(table['tip_pose_rotation_rad'], run.shaft + run.rotation(2.0),
                       rtol=0, atol=1e-14)


def test_a_topic_alone_has_all_its_messages(log, tmp_path):
    path = tmp_path / 'pose.parquet'
    assert '401 rows' in call('export', log, '-o', path, '--topic', '~/tip_pose')
    table = pyarrow.parquet.read_table(path)
    assert table.column_names == ['time_s', 'step', 'x_m', 'y_m', 'rotation_rad']
    text = call('export', log, '-o', tmp_path / 'none.csv', '--topic', 'x', code=2)
    assert 'no x; it has' in text and 'joint_states' in text


def test_export_overwrites_nothing(log, tmp_path):
    for name in ('run.csv', 'run.parquet'):
        (tmp_path / name).write_text('precious')
        assert 'exists' in call('export', log, '-o', tmp_path / name, code=2)
        assert (tmp_path / name).read_text() == 'precious'
    assert 'exists' in call('export', log, '-o', tmp_path, '--bag', code=2)
    assert 'must end with' in call('export', log, '-o', tmp_path / 'run.xlsx', code=2)
    for option in ('--topic', '--node'):
        text = call('export', log, '-o', tmp_path / 'bag', '--bag', option, '/timo_sim', code=2)
        assert text == f'timo_sim: --bag takes the whole file: leave out {option}\n'
    assert not (tmp_path / 'bag').exists()


def test_a_bag_opens_as_a_folder(log, tmp_path):
    call('export', log, '-o', tmp_path / 'bag', '--bag')
    with Reader(tmp_path / 'bag') as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        assert bag.duration == 2000000001 and counts['/left/timo_sim/tip_pose'] == 401
        assert sum(1 for _ in bag.messages()) == bag.message_count
    content = yaml.safe_load((tmp_path / 'bag/metadata.yaml').read_text())
    topics = content['rosbag2_bagfile_information']['topics_with_message_count']
    assert {topic['topic_metadata']['offered_qos_profiles'][0]['reliability']
            for topic in topics} == {'reliable'}
    # `ros2 bag reindex` accepts only such names (rosbag2_cpp/reindexer.cpp).
    file, = (tmp_path / 'bag').glob('*.mcap')
    assert re.fullmatch(r'(.+_(\d+)\.([a-zA-Z0-9])+)', str(file)) and file.name == 'bag_0.mcap'
    # Commands take the folder for its file, `view` in test_view.py, `replay` in test_replay.py.
    for command in ('info', 'recover'):
        assert call(command, file.parent) == call(command, file)
    call('export', file.parent, '-o', tmp_path / 'other', '--bag')
    assert (tmp_path / 'other/other_0.mcap').samefile(log)
    (tmp_path / 'link.mcap').symlink_to('bag/bag_0.mcap')
    call('export', tmp_path / 'link.mcap', '-o', tmp_path / 'third', '--bag')
    assert (tmp_path / 'third/third_0.mcap').samefile(log)
    assert not (tmp_path / 'third/third_0.mcap').is_symlink()


def test_a_bag_of_humble_becomes_one_of_jazzy(tmp_path):
    """Until version 8, policies of QoS are numbers, which rosbag2 refuses in version 9."""
    kind, store = 'std_msgs/msg/Float64', get_typestore(Stores.ROS2_HUMBLE)
    offered = Qos(QosHistory.KEEP_ALL, 0, QosReliability.BEST_EFFORT, QosDurability.VOLATILE, ZERO,
                  ZERO, QosLiveliness.MANUAL_BY_TOPIC, ZERO, False)
    with Writer(tmp_path / 'humble', version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        torque = writer.add_connection('/timo_sim/motor_torque', kind, typestore=store,
                                       offered_qos_profiles=[offered])
        writer.write(torque, 10**9, store.serialize_cdr(store.types[kind](1.0), kind))
    assert 'reliability: 2' in (tmp_path / 'humble/metadata.yaml').read_text()
    call('export', tmp_path / 'humble', '-o', tmp_path / 'jazzy', '--bag')
    with Reader(tmp_path / 'jazzy') as bag:
        found, = bag.connections
        assert found.ext.offered_qos_profiles == [] and bag.message_count == 1
