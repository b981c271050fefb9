# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`timo_sim recover` on logs that end early, are damaged or come from other tools."""

from inspect import signature
import os
import random
import resource
import signal
import struct
import time
import zlib

from click.testing import CliRunner
from command_line import call
import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment, Channel, Chunk, DataEnd, Footer, Header, Message, Schema)
from mcap.writer import MCAP0_MAGIC
from oracles.logs import contents, decoded, outcome, payload, places, record
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
import yaml
import zstandard

from timo_sim.cli import main
from timo_sim.log.read import LogError, recover

SEED = 20240  # of the random damage


@pytest.fixture(scope='module')
def intact(tmp_path_factory):
    """Return the contents of a log that was closed: 120 and 12 messages, resets in between."""
    return record(tmp_path_factory.mktemp('intact') / 'run.mcap')


@pytest.fixture
def log(tmp_path, intact):
    path = tmp_path / 'run.mcap'
    path.write_bytes(intact)
    return path


def run(*arguments):
    """Return code, output and errors of `timo_sim recover`."""
    # Before click 8.2 output and errors were mixed by default.
    apart = {'mix_stderr'} & signature(CliRunner).parameters.keys()
    runner = CliRunner(**dict.fromkeys(apart, False))
    result = runner.invoke(main, ['recover', *map(str, arguments)], prog_name='timo_sim')
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def test_a_complete_log_is_left_alone(log, intact):
    assert run(log) == (0, f'{log} is complete: 132 messages until log time 0.119 s; '
                        'nothing is written\n', '')
    assert [*log.parent.iterdir()] == [log] and log.read_bytes() == intact


def records_of(path):
    """Return profile, schemas, channels, metadata and statistics of a log."""
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        return (reader.get_header().profile, summary.schemas, summary.channels,
                [(entry.name, entry.metadata) for entry in reader.iter_metadata()],
                summary.statistics)


def messages_of(path):
    """Return all that a reader says about each message."""
    with open(path, 'rb') as stream:
        return [(channel.topic, schema.name, message.log_time, message.publish_time,
                 message.sequence, message.data)
                for schema, channel, message in make_reader(stream).iter_messages()]


def test_a_log_without_its_summary_gets_the_same_again(log, intact):
    """A log cut where its summary begins gets the summary that the recorder had written."""
    end = next(place for place, opcode, _ in places(intact) if opcode == Opcode.DATA_END)
    cut = log.with_name('cut.mcap')
    cut.write_bytes(intact[:end])
    code, output, errors = run(cut)
    assert (code, errors) == (0, '')
    new = log.with_name('cut_recovered.mcap')
    assert output == (f'{cut}: it ends early (byte {end}); 132 messages until log time 0.119 s, '
                      f'0 bytes lost; complete in {new}\n')
    assert messages_of(new) == messages_of(log)
    *same, notes, statistics = records_of(new)
    *expected, expected_notes, expected_statistics = records_of(log)
    assert same == expected
    assert notes[:-1] == expected_notes[:-1] and len(notes) == 7
    assert [name for name, _ in notes] == ['timo_sim', *5 * ['timo_sim.reset'], 'rosbag2']
    ours, bag = (yaml.safe_load(found[-1][1]['serialized_metadata'])
                 for found in (expected_notes, notes))
    assert bag['relative_file_paths'] == [new.name] and bag['files'][0]['path'] == new.name
    for differing in (ours, bag):
        del differing['relative_file_paths'], differing['files'][0]['path']
    assert ours == bag
    assert statistics.channel_message_counts == expected_statistics.channel_message_counts
    assert decoded(new) == {'/timo_sim/motor_torque': 120, '/rare': 12}
    assert run(new)[1].startswith(f'{new} is complete: 132 messages')


@pytest.mark.parametrize('name', ['bag', '.'])
def test_a_bag_of_a_wall_clock_is_recovered_beside_its_folder(tmp_path, monkeypatch, name):
    """rosbag2 was killed; the new file beside the bag is complete, and the bag does not change."""
    store, kind = get_typestore(Stores.ROS2_JAZZY), 'std_msgs/msg/Float64'
    bag = tmp_path / 'bag'
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        torque = writer.add_connection('/timo_sim/motor_torque', kind, typestore=store)
        for moment in (0, 250000000, 1500000000):
            writer.write(torque, 1700000000123456789 + moment,
                         store.serialize_cdr(store.types[kind](1.0), kind))
    (bag / 'metadata.yaml').unlink()
    file, = bag.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[:-20])
    monkeypatch.chdir(bag if name == '.' else tmp_path)
    code, output, _ = run(name)
    new = tmp_path / 'bag_recovered.mcap'
    assert code == 0 and ' 3 messages until log time 1700000001.623 s, ' in output
    assert [*bag.iterdir()] == [file] and file.read_bytes() == whole[:-20]
    assert decoded(new) == {'/timo_sim/motor_torque': 3}
    assert 'is complete: 3 messages until log time 1700000001.623 s;' in run(new)[1]


def test_no_file_is_overwritten(log, intact):
    log.write_bytes(intact[:-20])
    for name in ('run_recovered.mcap', 'run_recovered_1.mcap', 'run_recovered_2.mcap'):
        assert run(log)[1].endswith(f'complete in {log.with_name(name)}\n')
    taken = log.with_name('taken.mcap')
    taken.write_bytes(b'precious')
    code, output, errors = run(log, '--output', taken)
    assert (code, output) == (2, '')
    assert errors == f'timo_sim: {taken} exists: remove it or choose another name\n'
    assert taken.read_bytes() == b'precious' and log.read_bytes() == intact[:-20]
    code, output, _ = run(log, '-o', log.with_name('mine.mcap'))
    assert code == 0 and contents(log.with_name('mine.mcap')).total() == 132


@pytest.fixture
def no_sync(monkeypatch):
    monkeypatch.setattr(os, 'fsync', lambda number: None)


def cuts(content):
    """Return places to cut at: around and within each record, and in the magic."""
    yield from range(9)
    for place, _, length in places(content):
        yield from {place, place + 4, place + 9, place + length // 2}
    yield from (len(content) - 8, len(content) - 1)


def test_a_cut_loses_only_the_part_behind_it(log, intact, no_sync):
    """Each chunk that is there as a whole is kept."""
    ends = [place + length for place, opcode, length in places(intact) if opcode == Opcode.CHUNK]
    each = [length for place, opcode, length in places(intact) if opcode == Opcode.CHUNK]
    assert len(each) >= 6
    for cut in cuts(intact):
        log.write_bytes(intact[:cut])
        new = log.with_name('new.mcap')
        try:
            recover(log, new)
        except LogError:
            # The file has the header at most.
            assert cut < places(intact)[1][0] + places(intact)[1][2]
            continue
        with open(new, 'rb') as stream:
            kept = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
        whole = sum(end <= cut for end in ends)
        assert (kept == 132) == (whole == len(ends)) and kept >= 20 * whole
        new.unlink()


def test_flipped_bits_are_detected(log, intact, no_sync):
    """A closed log has checksums over every byte; also a record may become one of another kind."""
    generator, new = random.Random(SEED), log.with_name('new.mcap')
    bits = [[generator.randrange(8 * len(intact)) for _ in range(count)]
            for count in generator.choices((1, 2, 20), (3, 1, 1), k=40)]
    bits += [[8 * place + bit] for place, _, _ in places(intact) for bit in (0, 5)]
    bits += [[bit] for bit in range(8 * (len(intact) - 37), 8 * len(intact), 9)]  # the footer
    for each in bits:
        damaged = bytearray(intact)
        for bit in each:
            damaged[bit // 8] ^= 1 << bit % 8
        log.write_bytes(damaged)
        try:
            assert 'is complete' not in recover(log, new), each
            new.unlink()
        except LogError:
            assert min(each) < 8 * places(intact)[2][0], each  # nothing but the header is left
    assert outcome(log) == 'recovered'


def test_what_is_before_a_flipped_bit_is_kept(log, intact):
    place, _, length = [entry for entry in places(intact) if entry[1] == Opcode.CHUNK][2]
    damaged = bytearray(intact)
    damaged[place + length - 20] ^= 4
    log.write_bytes(damaged)
    code, output, _ = run(log)
    assert code == 0 and f'(byte {place})' in output
    assert f'{len(intact) - place} bytes lost' in output
    assert decoded(log.with_name('run_recovered.mcap'))['/timo_sim/motor_torque'] == 40


def test_bad_files_are_refused_or_recovered(tmp_path):
    """Nothing that a length or a size claims is read before it is compared with the file."""
    head = MCAP0_MAGIC + written(Header(profile='ros2', library=''))
    start = head + written(
        Schema(id=1, name='std_msgs/msg/Float64', encoding='ros2msg', data=b'float64 data'),
        Channel(id=1, schema_id=1, topic='/a', message_encoding='cdr', metadata={}))
    one = written(message())
    refused = {b'', MCAP0_MAGIC[:4], b'a text\n' * 100, MCAP0_MAGIC, MCAP0_MAGIC + bytes(5000),
               head}
    end = written(DataEnd(0), Footer(0, 0, 0)) + MCAP0_MAGIC
    bomb = zstandard.compress(bytes(1 << 30))
    lost = [
        raw(Opcode.CHUNK, b'x', 2**64 - 1), raw(Opcode.CHUNK, b'x', 10 << 30), end, end + end,
        raw(0, b''), raw(Opcode.MESSAGE, b'short'), written(message(channel=9)),
        raw(Opcode.CHANNEL, struct.pack('<HHI', 2, 1, 2**32 - 1) + b'x'),
        raw(Opcode.METADATA, struct.pack('<I2sI', 2, b'\xff\xfe', 0)),
        *(written(chunk(*content, **claims)) for content, claims in (
            ([one, 'lz4'], {'size': 10 << 30}), ([one, 'lz4'], {'size': 3}), ([one], {'crc': 1}),
            ([one], {'size': 1000, 'crc': 0}),
            ([one, 'lz4'], {'stored': bytes(1000)}), ([one, 'zstd'], {'stored': bytes(1000)}),
            ([b'', 'zstd'], {'stored': bomb, 'size': 1 << 30}),
            ([b'', 'zstd'], {'stored': bomb, 'size': 60 << 20}),
            ([one, 'bzip2'], {'stored': one})))]
    path = tmp_path / 'run.mcap'
    for content in refused:
        path.write_bytes(content)
        assert outcome(path) == 'refused', content[:50]
    for content in lost:
        path.write_bytes(start + one + content)
        assert outcome(path) == 'recovered', content[:50]
        new = tmp_path / 'new.mcap'
        recover(path, new)
        assert contents(new) == {'/a': 1}
        new.unlink()


def raw(opcode, content, length=None):
    """Return a record, by default with its true length."""
    return struct.pack('<BQ', opcode, len(content) if length is None else length) + content


def written(*records):
    """Return records as mcap writes them; bytes are taken as they are."""
    builder = RecordBuilder()
    for entry in records:
        builder.write(entry) if isinstance(entry, bytes) else entry.write(builder)
    return builder.end()


def message(channel=1):
    return Message(channel_id=channel, log_time=5, publish_time=6, sequence=1, data=payload(1.0))


def chunk(data, compression='', size=None, crc=None, stored=None):
    """Return a chunk record; `size`, `crc` and `stored` may contradict its data."""
    compress = {'lz4': lz4.frame.compress, 'zstd': zstandard.compress}.get(compression, bytes)
    return Chunk(data=compress(data) if stored is None else stored, compression=compression,
                 message_start_time=5, message_end_time=5,
                 uncompressed_crc=zlib.crc32(data) if crc is None else crc,
                 uncompressed_size=len(data) if size is None else size)


def test_what_other_tools_write_is_kept(tmp_path):
    """Messages without a chunk or a schema are; attachments and private records are left out."""
    note = Attachment(create_time=1, log_time=2, name='note', media_type='', data=b'by hand')
    other = Schema(id=7, name='foxglove.Pose', encoding='protobuf', data=b'\x0a\x03')
    path, new = tmp_path / 'run.mcap', tmp_path / 'new.mcap'
    path.write_bytes(MCAP0_MAGIC + written(
        Header(profile='', library=''), other,
        Channel(id=900, topic='/weather', message_encoding='json', metadata={}, schema_id=0),
        Channel(id=901, topic='/pose', message_encoding='protobuf', metadata={}, schema_id=7),
        message(900), note, raw(0x90, b'of my own'), written(chunk(
            written(message(901), message(9)), 'zstd'))))
    text = recover(path, new)
    assert 'a message is of an unknown channel, 9 (byte' in text and '; 2 messages until' in text
    with open(new, 'rb') as stream:
        found = [(schema and schema.data, channel.topic, entry.publish_time, entry.data)
                 for schema, channel, entry in make_reader(stream).iter_messages()]
    assert sorted(found, key=lambda each: each[1]) == [
        (b'\x0a\x03', '/pose', 6, payload(1.0)), (None, '/weather', 6, payload(1.0))]


def test_paths_that_are_no_files_are_refused(tmp_path):
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    code, output, errors = run(tmp_path)
    assert (code, output) == (2, '') and 'has 0 files *.mcap, and must have one: ros2' in errors
    for path in (pipe, '/dev/zero', '/dev/null'):
        assert run(path) == (2, '', f'timo_sim: {path} is not a file\n')
    code, output, errors = run(tmp_path / 'nowhere.mcap')
    assert (code, output) == (2, '') and 'nowhere.mcap' in errors and errors.count('\n') == 1
    pipe.unlink()
    pipe.write_bytes(b'')
    assert run(pipe / 'below')[0] == 2


def test_a_full_disk_leaves_no_half_recovered_log(log, intact, small_disk):
    code, output, errors = run(log, '-o', log.with_name('unused.mcap'))
    assert code == 0 and 'is complete' in output
    resource.setrlimit(resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)[1:] * 2)
    log.write_bytes(intact[:-20])
    resource.setrlimit(resource.RLIMIT_FSIZE,
                       (2000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    code, output, errors = run(log)
    assert (code, output) == (1, '') and 'File too large' in errors and errors.count('\n') == 1
    assert [*log.parent.iterdir()] == [log]


def test_killed_nodes_leave_logs_that_can_be_recovered(start, client, tmp_path):
    """
    Killed at random moments they keep all but the last second, for every reader.

    Sim time is slower than the clock, so that a busy machine may take longer to write.
    """
    generator = random.Random(SEED)
    nodes = []
    for name in ('first', 'second'):
        node = start('-r', f'__ns:=/{name}', record_file=str(tmp_path / f'{name}.mcap'),
                     real_time_factor=0.4,
                     **{'rate.joint_states': 1000.0 if name == 'first' else 100.0})
        states = client.collect(JointState, f'/{name}/joint_states')
        done = client.service(Trigger, f'/{name}/timo_sim/reset')().message
        nodes.append((name, node, states, 1e-3 * int(done.removeprefix('reset at step '))))
    for name, node, states, reset in nodes:
        moment = reset + generator.uniform(1.0, 1.8)  # the reset is not in the last second
        client.wait(lambda: states and time_of(states[-1]) > moment, f'{moment} s of {name}')
        node.send(signal.SIGKILL)
        node.wait()
    time.sleep(0.1)  # for messages on their way to the client
    for name, node, states, _ in nodes:
        text = recover(tmp_path / f'{name}.mcap')
        new = tmp_path / f'{name}_recovered.mcap'
        found, latest = decoded(new), max(entry[2] for entry in messages_of(new))
        assert f'{found.total()} messages until log time {1e-9 * latest:.3f} s' in text
        assert 1e-9 * latest > time_of(states[-1]) - 1.0
        profile, schemas, channels, notes, _ = records_of(new)
        assert profile == 'ros2' and len(schemas) >= 5 and len(channels) >= 6
        names = [entry for entry, _ in notes]
        assert names == ['timo_sim', *['timo_sim.reset'] * (len(names) - 2), 'rosbag2']
        assert 'timo_sim.reset' in names  # twice where the answer to the first was lost
        assert set(notes[0][1]) >= {'parameters', 'changed', 'timo_sim'}


def test_a_log_that_is_still_being_written_is_refused(start, client, tmp_path):
    node = start()
    client.wait(lambda: node.log.exists() and node.log.stat().st_size > 10000, 'the log')
    for arguments in (['info', node.log], ['export', node.log, '-o', tmp_path / 'run.csv']):
        told = call(*arguments, code=2)
        assert told.count('\n') == 1 and (
            'it is still being written, or its process died: timo_sim recover' in told)
    assert 'it ends early' in call('recover', node.log)


def time_of(state):
    return state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
