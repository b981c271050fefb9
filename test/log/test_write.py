# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Logs as the recorder and the node write them, read by other libraries; errors of writing."""

from collections import Counter
import os
from pathlib import Path
import resource
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import lz4.frame
from mcap.reader import make_reader
from oracles import logs
import pytest
from ros_process import nanoseconds
import yaml

import timo_sim
from timo_sim.log import write
from timo_sim.log.read import recover
from timo_sim.log.write import BACKLOG, Channel, CHUNK_SIZE, Recorder

CHANNELS = [Channel('/a', 'sensor_msgs/msg/JointState'), Channel('/b', 'std_msgs/msg/Float64'),
            Channel('/silent', 'std_msgs/msg/Float64')]
STEPS = 5000


@pytest.fixture
def path(tmp_path):
    """Return the path of a log with two channels, one a tenth as dense, and a note inside."""
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {'first': {'key': 'value'}})
    for step in range(STEPS):
        if step == STEPS // 2:
            recorder.note('middle', {'step': str(step)})
        recorder.write(0, step, step * 1000, step.to_bytes(4, 'little') + bytes(100))
        if step % 10 == 0:
            recorder.write(1, step, step * 1000, bytes(7))
    recorder.close()
    assert recorder.error is None
    return recorder.path


def test_every_message_is_there_with_checksums_in_order(path):
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = {'/a': [], '/b': []}
        for _, channel, message in reader.iter_messages():
            assert message.log_time == message.publish_time == message.sequence * 1000
            found[channel.topic].append((message.sequence, message.data))
        assert found['/a'] == [(step, step.to_bytes(4, 'little') + bytes(100))
                               for step in range(STEPS)]
        assert found['/b'] == [(step, bytes(7)) for step in range(0, STEPS, 10)]
        assert [(record.name, record.metadata) for record in reader.iter_metadata()][:2] == [
            ('first', {'key': 'value'}), ('middle', {'step': str(STEPS // 2)})]


def test_a_reader_that_seeks_finds_its_part(path):
    with open(path, 'rb') as stream:
        reader = make_reader(stream)
        part = [message.sequence for _, _, message in reader.iter_messages(
            ['/b'], 1000000, 1500000)]
        summary = reader.get_summary()
    assert part == list(range(1000, 1500, 10))
    assert len(summary.chunk_indexes) >= STEPS * 135 // CHUNK_SIZE
    assert summary.statistics.channel_message_counts == {1: STEPS, 2: STEPS // 10}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
        0, (STEPS - 1) * 1000)
    assert [channel.topic for channel in summary.channels.values()] == ['/a', '/b', '/silent']


def test_a_path_that_is_no_regular_file_is_refused(tmp_path):
    path = tmp_path / 'run.mcap'
    for make in (os.mkfifo, lambda path: path.symlink_to('/dev/null'),
                 lambda path: path.symlink_to('/dev')):
        make(path)
        with pytest.raises(OSError, match=str(path)):
            Recorder(path, CHANNELS, {})
        assert list(tmp_path.iterdir()) == [path]
        path.unlink()
    with pytest.raises(IsADirectoryError, match=str(tmp_path)):
        Recorder(tmp_path, CHANNELS, {})
    assert not tmp_path.with_name(tmp_path.name + '_1').exists()


def cut(path):
    os.truncate(path, path.stat().st_size // 2)


def replace(path):
    path.with_stem('other').write_bytes(path.read_bytes())
    path.with_stem('other').replace(path)


@pytest.mark.parametrize('harm, words', [(replace, 'deleted'), (cut, 'bytes')])
@pytest.mark.parametrize('last', [False, True], ids=['amid', 'at the end'])
def test_changes_of_a_log_by_others_are_errors(tmp_path, monkeypatch, harm, words, last):
    """Also when it happens after the last check before a chunk."""
    monkeypatch.setattr(write, 'FLUSH_PERIOD', 60.0)
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    recorder.write(0, 0, 0, bytes(100))
    if last:
        finish = recorder._writer.finish
        monkeypatch.setattr(recorder._writer, 'finish', lambda name: (
            harm(recorder.path), finish(name)))
    else:
        harm(recorder.path)
    recorder.close()
    assert str(recorder.path) in recorder.error and words in recorder.error


def test_a_log_that_is_moved_goes_on_and_is_complete(tmp_path):
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    moved = recorder.path.rename(tmp_path / 'moved.mcap')
    recorder.write(0, 0, 0, bytes(100))
    recorder.close()
    assert recorder.error is None and str(recorder.path) in recorder.warning
    assert 'is complete: 1 messages' in recover(moved)


@pytest.mark.parametrize('comes_back', [True, False])
def test_a_disk_that_hangs_gives_a_warning_and_does_not_block_the_node_for_ever(
        tmp_path, monkeypatch, comes_back):
    monkeypatch.setattr(write, 'WARN_AFTER', 0.05)
    monkeypatch.setattr(write, 'GIVE_UP_AFTER', 300.0 if comes_back else 0.2)
    recorder, hangs = Recorder(tmp_path / 'run.mcap', CHANNELS, {}), threading.Event()
    add_chunk = recorder._writer.add_chunk

    def add_when_it_can(chunk):
        hangs.wait()
        add_chunk(chunk)

    monkeypatch.setattr(recorder._writer, 'add_chunk', add_when_it_can)

    def come_back():
        while recorder.warning is None:
            time.sleep(0.01)
        hangs.set()

    if comes_back:
        threading.Thread(target=come_back).start()
    for step in range(BACKLOG + 5):
        recorder.write(0, step, step, bytes(CHUNK_SIZE))
    assert 'the simulation has waited for the disk' in recorder.warning
    recorder.close()
    if comes_back:
        assert recorder.error is None
        with open(recorder.path, 'rb') as stream:
            assert len([*make_reader(stream).iter_messages()]) == BACKLOG + 5
    else:
        assert 'has taken nothing for 0.2 s' in recorder.error
        hangs.set()
        recorder._thread.join()


def test_a_slow_disk_is_given_the_time_it_takes_to_end_a_log(tmp_path, monkeypatch):
    monkeypatch.setattr(write, 'GIVE_UP_AFTER', 1.5)  # less than all, far above one
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    add_chunk = recorder._writer.add_chunk
    monkeypatch.setattr(recorder._writer, 'add_chunk', lambda chunk: (
        time.sleep(0.2), add_chunk(chunk)))
    for step in range(10):
        recorder.write(0, step, step, bytes(CHUNK_SIZE))
    recorder.close()
    assert recorder.error is None
    with open(recorder.path, 'rb') as stream:
        assert len([*make_reader(stream).iter_messages()]) == 10


def test_a_disk_that_is_full_at_the_start_leaves_no_file(tmp_path, small_disk):
    with pytest.raises(OSError, match='File too large'):
        Recorder(tmp_path / 'run.mcap', CHANNELS, {'timo_sim': {'long': 'x' * 10000}})
    assert not (tmp_path / 'run.mcap').exists()


def test_an_error_in_the_recorders_thread_does_not_block_the_simulation(tmp_path, monkeypatch):
    def fail(_):
        raise RuntimeError('no lz4 today')

    monkeypatch.setattr(lz4.frame, 'compress', fail)
    monkeypatch.setattr(write, 'CHUNK_SIZE', 100)
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    writing = threading.Thread(target=lambda: [
        recorder.write(0, step, step, logs.payload(step)) for step in range(1000)], daemon=True)
    writing.start()
    writing.join(30.0)
    assert not writing.is_alive()
    recorder.close()
    assert 'no lz4 today' in recorder.error


def test_a_log_is_on_the_disk_when_it_is_closed(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, 'fsync', lambda number: synced.append(os.fstat(number).st_size))
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    recorder.write(0, 0, 0, logs.payload(1.0))
    recorder.close()
    assert synced == [recorder.path.stat().st_size]


def test_only_the_name_of_a_log_depends_on_the_wall_clock():
    """A clock that is set back changes no stamp and no deadline, because no code reads it."""
    package = Path(write.__file__).parents[1]
    looking = {path.name: line.strip() for path in package.rglob('*.py')
               for line in path.read_text().splitlines()
               if 'time.time(' in line or 'time_ns(' in line or '.now(' in line or 'utcnow' in line
               or 'get_clock' in line}
    assert [*looking] == ['topics.py']
    assert 'datetime.now():%Y%m%d_%H%M%S' in looking['topics.py']


def test_metadata_that_rosbag2_and_rerun_need(start, paper):
    node = start('--params-file', str(paper), duration=0.3)
    assert node.wait()[0] == 0
    assert logs.decoded(node.log)['/joint_states'] == 31  # by two other readers
    with open(node.log, 'rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        counts = Counter(channel.topic for _, channel, _ in reader.iter_messages())
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
        assert yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]['depth'] == 10
    assert summary.chunk_indexes and summary.statistics.message_count == sum(counts.values())

    bag = yaml.safe_load(metadata['rosbag2']['serialized_metadata'])
    assert (bag['version'], bag['storage_identifier']) == (9, 'mcap')
    assert bag['message_count'] == summary.statistics.message_count
    assert {t['topic_metadata']['name']: t['message_count']
            for t in bag['topics_with_message_count'] if t['message_count']} == dict(counts)


def test_frames_and_urdf_make_a_log_larger_by_less_than_a_third(tmp_path, paper):
    path = timo_sim.simulate(timo_sim.load_scene(paper), 10.0, 10).save(tmp_path / 'run.mcap')
    bare, topics = tmp_path / 'bare.mcap', []
    with open(path, 'rb') as stream:
        reader = make_reader(stream)
        names = {channel.topic: (number, reader.get_summary().schemas[channel.schema_id].name)
                 for number, channel in reader.get_summary().channels.items()
                 if channel.topic not in ('/tf', '/robot_description')}
        recorder = Recorder(bare, [Channel(topic, kind) for topic, (_, kind) in names.items()], {
            record.name: record.metadata for record in reader.iter_metadata()
            if record.name == 'timo_sim'})
        places = {topic: place for place, topic in enumerate(names)}
        for _, channel, message in reader.iter_messages():
            if channel.topic in places:
                recorder.write(places[channel.topic], message.sequence, message.log_time,
                               message.data)
            topics.append(channel.topic)
    recorder.close()
    assert topics.count('/tf') == 251 and topics.count('/robot_description') == 1
    assert path.stat().st_size < 1.3 * bare.stat().st_size


def test_a_log_is_never_overwritten_and_its_default_name_has_a_date(start, tmp_path):
    earlier = [tmp_path / name for name in ('run.mcap', 'run_1.mcap')]
    for path in earlier:
        path.write_bytes(b'precious')
    nodes = [start(duration=0.1), start(duration=0.1, record_file="''")]
    assert [node.wait()[0] for node in nodes] == [0, 0]
    assert [path.read_bytes() for path in earlier] == 2 * [b'precious']
    dated, = tmp_path.glob('timo_sim_????????_??????.mcap')
    for path in (tmp_path / 'run_2.mcap', dated):
        assert logs.contents(path).total() > 0


def test_a_log_that_cannot_be_written_is_an_error_and_the_node_goes_on(start, client, tmp_path):
    """No folder can be below a file; a second node's log may grow to 60 kB, as on a full disk."""
    (tmp_path / 'file').write_text('not a folder')
    limit = 60000
    nodes = {
        'no log is written': start('-r', '__ns:=/a', record_file=str(tmp_path / 'file/run.mcap')),
        'the log ends early': start('-r', '__ns:=/b', preexec_fn=lambda: resource.setrlimit(
            resource.RLIMIT_FSIZE, (limit, limit)))}
    health = client.collect(DiagnosticArray, '/diagnostics')
    for words, node in nodes.items():
        def failed():
            return [message for message in health if words in message.status[0].message
                    and message.status[0].level == DiagnosticStatus.ERROR]
        client.wait(lambda: len({nanoseconds(each) for each in failed()}) > 1, 'time going on')
        assert 'run.mcap' in failed()[0].status[0].message
        code, output = node.end()
        last = output.splitlines()[-1]  # it does not say that there is a log
        assert code == 0 and output.count(words) == 2 and words in last and 'log: ' not in last
    assert 'complete in' in recover(node.log)
    assert logs.decoded(node.log.with_name('run_recovered.mcap'))['/b/joint_states'] > 0
