# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The recorder by itself: chunks, checksums, index, metadata in between."""

import os
import threading
import time

from mcap.reader import make_reader
import pytest

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


def test_a_log_without_messages_is_complete(tmp_path):
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    recorder.close()
    with open(recorder.path, 'rb') as stream:
        assert make_reader(stream).get_summary().statistics.message_count == 0


@pytest.mark.parametrize('make', [
    os.mkfifo, lambda path: path.symlink_to('/dev/null'), lambda path: path.symlink_to('/dev')])
def test_a_path_that_is_no_regular_file_is_refused(tmp_path, make):
    path = tmp_path / 'run.mcap'
    make(path)
    with pytest.raises(OSError, match=str(path)):
        Recorder(path, CHANNELS, {})
    assert list(tmp_path.iterdir()) == [path]


def cut(path):
    """Cut a file to half its size."""
    os.truncate(path, path.stat().st_size // 2)


def add(path):
    """Write to a file as a second program would."""
    with open(path, 'ab') as stream:
        stream.write(b'more')


def replace(path):
    """Replace a file by another of the same name."""
    path.with_stem('other').write_bytes(path.read_bytes())
    path.with_stem('other').replace(path)


@pytest.mark.parametrize('harm, words', [
    (os.unlink, 'deleted'), (replace, 'deleted'), (cut, 'bytes'), (add, 'bytes')])
@pytest.mark.parametrize('last', [False, True], ids=['amid', 'at the end'])
def test_changes_of_a_log_by_others_are_errors(tmp_path, monkeypatch, harm, words, last):
    """Also when it happens after the last check before a chunk."""
    monkeypatch.setattr('timo_sim.log.write.FLUSH_PERIOD', 60.0)
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
    monkeypatch.setattr('timo_sim.log.write.NOTABLE', 0.05)
    monkeypatch.setattr('timo_sim.log.write.PATIENCE', 300.0 if comes_back else 0.2)
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
    monkeypatch.setattr('timo_sim.log.write.PATIENCE', 3.0)  # less than all, far above one
    recorder = Recorder(tmp_path / 'run.mcap', CHANNELS, {})
    add_chunk = recorder._writer.add_chunk
    monkeypatch.setattr(recorder._writer, 'add_chunk', lambda chunk: (
        time.sleep(0.35), add_chunk(chunk)))
    for step in range(10):
        recorder.write(0, step, step, bytes(CHUNK_SIZE))
    recorder.close()
    assert recorder.error is None
    with open(recorder.path, 'rb') as stream:
        assert len([*make_reader(stream).iter_messages()]) == 10
