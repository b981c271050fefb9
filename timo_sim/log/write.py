# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Write MCAP files chunk by chunk, in a thread of their own; the metadata records of a run's log.

Besides messages, a file has what rosbag2 writes: the QoS of topics, and its own metadata record.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
import fcntl
from functools import cache
from importlib.metadata import version
from itertools import count
import json
import math
import os
from pathlib import Path
import platform
import struct
import threading
import time
from typing import Any, BinaryIO, NamedTuple, TYPE_CHECKING
import zlib

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel as ChannelRecord, Chunk as ChunkRecord, ChunkIndex, DataEnd, Footer, Header, Metadata,
    MetadataIndex, Schema, Statistics)
from mcap.summary import Summary
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC
import numpy as np
import yaml

from timo_sim.scene.files import check_target
from timo_sim.scene.parameters import changed, frame_names
from timo_sim.topics.cdr import pack, schema_text, Serializer, TYPE_HASHES
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import in_frames, TRANSFORMS
from timo_sim.version import __version__

if TYPE_CHECKING:  # the import of its module takes longer than `timo_sim info`
    from timo_sim.scene.scene import Scene

DESCRIPTION, TEXT = 'robot_description', 'std_msgs/msg/String'
START, RESET, SUMMARY = 'timo_sim', 'timo_sim.reset', 'timo_sim.summary'
CHANGE = 'timo_sim.change'
# Versions and hardware that the last bits of a run depend on.
ENVIRONMENT = ('timo_sim', 'python', 'numpy', 'scipy', 'numba', 'machine', 'processor', 'log')
LOG_VERSION = 2  # of what rows hold, see doc/log.md; the first one is not noted


def start_note(node: str, values: dict) -> dict[str, str]:
    """Return the metadata for the start of a run of a node with these parameters."""
    return {'node': node, 'parameters': _json(values), 'changed': _json(changed(values)),
            **_environment()}


def change_note(step: int, values: dict) -> dict[str, str]:
    """Return the metadata for what was set while the node runs, as in `Recording.changes`."""
    return {'step': str(step), 'values': _json(values)}


def names_note(channels: list) -> dict[str, str]:
    """Return the metadata for the names of topics before they were remapped."""
    return {'topics': _json({channel.topic: channel.name for channel in channels})}


def scene_message(event: str, step: int, node: str, channels: list, values: dict,
                  given: dict) -> bytes:
    """
    Return what ~/scene says of an event at a step, JSON in a serialised message.

    The event is a start, a reset, or that the values `given` were set, as in `change_note`;
    `values` are the node's parameters from this step on.
    """
    return pack(TEXT, {'data': json.dumps({
        'event': event, 'step': step, 'set': _plain(given), 'node': node, **_environment(),
        'topics': {channel.topic: channel.name for channel in channels},
        'parameters': _plain(values)}, indent=1)})


def _json(values):
    return json.dumps(_plain(values))


def _plain(values):
    # A limit may be infinite, and JSON has no infinity; the text is read as a number again.
    return {name: str(value) if value in (math.inf, -math.inf) else value
            for name, value in values.items()}


def original_names(facts: dict[str, str]) -> dict[str, str]:
    """Return the names of topics before they were remapped, by topic; {} if a log has none."""
    try:
        return {topic: str(name) for topic, name in json.loads(facts['topics']).items()}
    except (KeyError, AttributeError, ValueError, RecursionError):
        return {}


def environment_differences(facts: dict[str, str]) -> str:
    """Return in words which versions and hardware differ from those of a log, or ''."""
    return ', '.join(f'{name} {facts[name][:40]} (here {value})'
                     for name, value in _environment().items() if facts.get(name, value) != value)


@cache
def _environment():
    from llvmlite.binding import get_host_cpu_name  # steps are compiled for this processor
    return dict(zip(ENVIRONMENT, (
        __version__, platform.python_version(),
        *(version(package) for package in ('numpy', 'scipy', 'numba')),
        platform.machine(), get_host_cpu_name(), str(LOG_VERSION))))


HEAD = struct.Struct('<BQ')       # of a record: opcode, and length of the content
MESSAGE = struct.Struct('<HIQQ')  # channel, sequence number, log time, publish time; data follow
_HEAD_AND_MESSAGE = struct.Struct('<BQHIQQ')
MESSAGE_OPCODE = int(Opcode.MESSAGE)  # comparing with the enum itself takes longer
_FOR_EVER = {'sec': 9223372036, 'nsec': 854775807}
DEPTH = 10  # default depth of a topic's queue [messages]
# What the node offers on a topic by default, as rosbag2 writes it (metadata version 9).
_QOS = {
    'history': 'keep_last', 'depth': DEPTH, 'reliability': 'reliable', 'durability': 'volatile',
    'deadline': _FOR_EVER, 'lifespan': _FOR_EVER, 'liveliness': 'automatic',
    'liveliness_lease_duration': _FOR_EVER, 'avoid_ros_namespace_conventions': False}


def printable(path: Path | str) -> str:
    """Return a path as text that can be printed anywhere; on Linux a name may be any bytes."""
    return os.fsencode(path).decode(errors='replace')


def plain(text: str) -> str:
    """Return a text of a file without control characters, which a terminal would obey."""
    return ''.join(char if char.isprintable() else ' ' for char in text)


class Chunk:
    """A chunk that grows; `index` has by channel [time, offset, time, offset, ...] [ns, B]."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.index: defaultdict[int, list[int]] = defaultdict(list)

    def add(self, data: bytes, channel: int, sequence: int, log_time: int,
            publish_time: int) -> None:
        """Append a message with its times [ns]."""
        self.index[channel] += log_time, len(self.data)
        self.data += _HEAD_AND_MESSAGE.pack(
            MESSAGE_OPCODE, MESSAGE.size + len(data), channel, sequence, log_time, publish_time)
        self.data += data


class Writer:
    """Writes an MCAP file with a profile; `size` is the number of bytes so far."""

    def __init__(self, stream: BinaryIO, profile: str) -> None:
        self._stream, self._profile = stream, profile
        self._crc = self.size = 0
        # Kept as bytes: a log of a day has so many that objects would fill the memory.
        self._chunk_indexes, self._metadata_indexes = RecordBuilder(), RecordBuilder()
        self._statistics = Statistics(
            attachment_count=0, channel_count=0, channel_message_counts=Counter(), chunk_count=0,
            message_count=0, metadata_count=0, message_start_time=0, message_end_time=0,
            schema_count=0)
        self._summary = Summary()
        self._summary.statistics = self._statistics
        self._put(MCAP0_MAGIC)
        self._write(Header(profile=profile, library=LIBRARY_IDENTIFIER))

    def add(self, record: Schema | ChannelRecord | Metadata) -> None:
        """Write a record, and note it for the summary."""
        offset, length = self.size, self._write(record)
        if isinstance(record, Schema):
            self._summary.schemas[record.id] = record
        elif isinstance(record, ChannelRecord):
            self._summary.channels[record.id] = record
        else:
            MetadataIndex(offset=offset, length=length, name=record.name).write(
                self._metadata_indexes)
            self._statistics.metadata_count += 1

    def add_chunk(self, chunk: Chunk) -> None:
        """Compress a chunk that has messages, and write it with its index."""
        times = [entries[::2] for entries in chunk.index.values()]
        facts: dict[str, Any] = {
            'compression': 'lz4', 'uncompressed_size': len(chunk.data),
            'message_start_time': min(map(min, times)), 'message_end_time': max(map(max, times))}
        compressed = lz4.frame.compress(chunk.data)
        offset = self.size
        length = self._write(
            ChunkRecord(data=compressed, uncompressed_crc=zlib.crc32(chunk.data), **facts))
        places, place = {}, offset + length
        for channel, entries in chunk.index.items():
            places[channel] = place
            place += self._put(struct.pack(
                f'<BQHI{len(entries)}Q', Opcode.MESSAGE_INDEX, 6 + 8 * len(entries), channel,
                8 * len(entries), *entries))
        ChunkIndex(
            chunk_start_offset=offset, chunk_length=length, compressed_size=len(compressed),
            message_index_offsets=places, message_index_length=place - offset - length, **facts
        ).write(self._chunk_indexes)
        total, start = self._statistics, facts['message_start_time']
        total.message_start_time = min(total.message_start_time, start) if (
            total.chunk_count) else start
        total.message_end_time = max(total.message_end_time, facts['message_end_time'])
        counts = {channel: len(entries) // 2 for channel, entries in chunk.index.items()}
        total.channel_message_counts.update(counts)
        total.message_count += sum(counts.values())
        total.chunk_count += 1

    def finish(self, name: str) -> None:
        """Write the end of the file: rosbag2's metadata, with the file's name, and summary."""
        schemas, channels = self._summary.schemas.values(), self._summary.channels.values()
        self._statistics.schema_count = len(schemas)
        self._statistics.channel_count = len(channels)
        if self._profile == 'ros2':
            self.add(Metadata(name='rosbag2', metadata={
                'serialized_metadata': yaml_text(information(self._summary, name))}))
        self._write(DataEnd(self._crc))
        start, data = self.size, b''.join([
            _bytes_of(*schemas, *channels, self._statistics), self._chunk_indexes.end(),
            self._metadata_indexes.end()])
        # The checksum covers the footer up to the checksum itself.
        head = struct.pack('<BQQQ', Opcode.FOOTER, 20, start, 0)
        self._put(data)
        self._write(Footer(summary_start=start, summary_offset_start=0,
                           summary_crc=zlib.crc32(head, zlib.crc32(data))))
        self._put(MCAP0_MAGIC)

    def _write(self, record):
        return self._put(_bytes_of(record))

    def _put(self, data):
        self._crc = zlib.crc32(data, self._crc)
        self.size += len(data)
        return self._stream.write(data)


def _bytes_of(*records):
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    def ignore_aliases(self, data):
        return True


def yaml_text(value: Any) -> str:
    """Return a value as YAML without aliases."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False)


# Names of QoS policies by their numbers in rmw, which bags of Humble and Iron have.
_POLICIES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': ('system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': ('system_default', 'automatic', 'manual_by_node', 'manual_by_topic', 'unknown',
                   'best_available')}


def _qos_of(channel):
    """Return the QoS of a channel with names of policies; none if it cannot be read."""
    text = channel.metadata.get('offered_qos_profiles', '')
    try:
        profiles = yaml.safe_load(text if '&' not in text else '') or []  # & would expand
        return [{policy: _POLICIES[policy][value] if policy in _POLICIES and (
            isinstance(value, int)) else value for policy, value in profile.items()}
            for profile in profiles]
    except (yaml.YAMLError, RecursionError, ValueError, IndexError, AttributeError, TypeError):
        return []


def information(summary: Summary, name: str) -> dict[str, Any]:
    """Return rosbag2's metadata (version 9) of a bag with this summary and file name."""
    statistics = summary.statistics
    assert statistics is not None
    start, end = statistics.message_start_time, statistics.message_end_time
    span = {'duration': {'nanoseconds': end - start},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': statistics.message_count}
    types = {schema.id: schema.name for schema in summary.schemas.values()}
    topics = [
        {'topic_metadata': {
            'name': channel.topic, 'type': types.get(channel.schema_id, ''),
            'serialization_format': channel.message_encoding,
            'offered_qos_profiles': _qos_of(channel),
            'type_description_hash': channel.metadata.get('topic_type_hash', '')},
         'message_count': statistics.channel_message_counts.get(channel.id, 0)}
        for channel in summary.channels.values()]
    return {
        'version': 9, 'storage_identifier': 'mcap', **span,
        'topics_with_message_count': topics, 'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [printable(name)], 'files': [{'path': printable(name), **span}],
        'custom_data': {}, 'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy')}


FLUSH_PERIOD = 0.5       # [s] of wall time; a crash loses at most twice this
CHUNK_SIZE = 512 * 1024  # [B] so that a day has few; none waits longer than `FLUSH_PERIOD`
BACKLOG = 20             # chunks that may wait for the disk before `write` waits, too
WARN_AFTER, GIVE_UP_AFTER = 0.5, 60.0  # [s] that `write` waits for the disk


class Channel(NamedTuple):
    """A topic of the log."""

    topic: str      # fully qualified name
    type_name: str  # as in 'sensor_msgs/msg/JointState'
    name: str = ''  # before remapping, as in '~/tip_pose'
    depth: int = DEPTH
    reliability: str = 'reliable'  # or 'best_effort'
    durability: str = 'volatile'   # or 'transient_local'


class Recorder:
    """
    Write serialised messages and metadata, `notes`, to a new MCAP file, numbered if it exists.

    `write` only appends to a chunk; a thread compresses chunks, for the most part without holding
    up other threads, and gives them to the operating system at least every `FLUSH_PERIOD`. If that
    fails or takes longer than `GIVE_UP_AFTER`, or another program deletes, cuts or writes to the
    file, `error` says so and later messages are dropped; `warning` says that the file has been
    moved or the disk is slow. Times in the file are sim time. Raises OSError if the file cannot be
    made.
    """

    def __init__(self, path: Path | str, channels: list[Channel],
                 notes: dict[str, dict[str, str]]) -> None:
        self.error: str | None = None
        self.warning: str | None = None
        self._lock = threading.Lock()  # of the chunk that grows
        self._chunk = Chunk()
        self._queue: deque[tuple] = deque()  # method of the Writer and its argument, to be called
        self._ready = threading.Event()
        self._closing = False
        types = list(dict.fromkeys(channel.type_name for channel in channels))
        records: list[Schema | ChannelRecord | Metadata] = [
            Schema(id=number, name=name, encoding='ros2msg', data=schema_text(name).encode())
            for number, name in enumerate(types, start=1)]
        records += [
            ChannelRecord(id=number, topic=channel.topic, message_encoding='cdr',
                          schema_id=types.index(channel.type_name) + 1,
                          metadata={
                              'offered_qos_profiles': yaml_text([{
                                  **_QOS, **{policy: getattr(channel, policy) for policy in (
                                      'depth', 'reliability', 'durability')}}]),
                              'topic_type_hash': TYPE_HASHES[channel.type_name]})
            for number, channel in enumerate(channels, start=1)]
        records += [Metadata(name=name, metadata=values) for name, values in notes.items()]
        self.path, self._file = create(Path(path))
        try:
            self._writer = Writer(self._file, 'ros2')
            for record in records:
                self._writer.add(record)
            self._file.flush()
        except OSError:
            with suppress(OSError):
                self._file.close()
            self.path.unlink()  # this process made it, and it is not a log
            raise
        self._thread = threading.Thread(target=self._run, name='recorder', daemon=True)
        self._thread.start()

    def write(self, index: int, step: int, stamp: int, data: bytes) -> None:
        """Log a message, CDR, of a channel at a step and its stamp, sim time [ns]."""
        if self.error is not None:
            return
        with self._lock:
            self._chunk.add(data, index + 1, step & 0xffffffff, stamp, stamp)
            if len(self._chunk.data) < CHUNK_SIZE:
                return
        self._queue_chunk()
        self._ready.set()
        begun = time.monotonic()
        while len(self._queue) > BACKLOG and self.error is None:
            time.sleep(0.001)
            if time.monotonic() - begun > WARN_AFTER:
                self.warning = f'the simulation has waited for the disk of {self.path}'
            if time.monotonic() - begun > GIVE_UP_AFTER:
                self.error = f'{self.path}: the disk has taken nothing for {GIVE_UP_AFTER:g} s'

    def note(self, name: str, values: dict[str, str]) -> None:
        """Log a metadata record: a name, and a dictionary of str."""
        if self.error is None:
            self._queue_chunk()
            self._queue.append((self._writer.add, Metadata(name=name, metadata=values)))

    def close(self) -> None:
        """Write what is waiting, the index and the summary, and close the file."""
        self._closing = True
        self._ready.set()
        size = None
        while self._thread.is_alive() and self._writer.size != size:  # while it makes progress
            size = self._writer.size
            self._thread.join(GIVE_UP_AFTER)
        if self._thread.is_alive():
            self.error = self.error or f'{self.path}: the disk does not take the end of the log'

    def _queue_chunk(self):
        """Queue the chunk that grows, to be written as it is."""
        with self._lock:
            if self._chunk.data:
                self._queue.append((self._writer.add_chunk, self._chunk))
                self._chunk = Chunk()

    def _run(self):
        try:
            while not self._closing:
                if not self._ready.wait(FLUSH_PERIOD):
                    self._queue_chunk()
                self._ready.clear()
                self._write_queue()
            self._queue_chunk()
            self._write_queue()
            self._writer.finish(self.path.name)
            sync(self._file)
            self._check_file()
        except Exception as error:  # of any type, because `write` must not wait for this thread
            self.error = f'{self.path}: {error}'
            self._queue.clear()
        finally:
            try:
                self._file.close()
            except OSError as error:
                self.error = self.error or f'{self.path}: {error}'

    def _write_queue(self):
        self._check_file()
        while self._queue:
            write, what = self._queue.popleft()
            write(what)
        self._file.flush()

    def _check_file(self):
        """Raise OSError if another program changed or deleted the file: `write` gives no error."""
        ours = os.fstat(self._file.fileno())
        if ours.st_size != self._writer.size:
            raise OSError(f'it has {ours.st_size} bytes, {self._writer.size} were written: '
                          'another program has cut it or written to it')
        with suppress(OSError):
            if os.path.samestat(ours, os.stat(self.path)):
                return
        if not ours.st_nlink:
            raise OSError('it was deleted')
        self.warning = f'{self.path} was moved; the log goes on where it is now'


def description(scene: Scene, frames: dict[str, str]) -> bytes:
    """Return the message with the URDF of a scene, with these names of frames."""
    from timo_sim.scene.urdf import urdf_of
    return pack(TEXT, {'data': urdf_of(scene.manipulator, frames)})


class NewLog(Recorder):
    """
    A log of a run without a node: the same topics, and the bytes that the node writes.

    `summary`, a dictionary of str, is noted at its end.
    """

    def __init__(self, path: Path | str, scene: Scene, values: dict[str, Any],
                 node: str = '/timo_sim', **notes: str) -> None:
        namespace = node.rpartition('/')[0]
        channels = [Channel(node + command.name[1:], command.type_name) for command in COMMANDS]
        self._topics: dict[str, tuple] = {}
        self.summary: dict[str, str] = {}
        frames = frame_names(values)
        for output in (*scene.outputs, TRANSFORMS):
            name = output.name
            topic = (name if name.startswith('/') else
                     node + name[1:] if name.startswith('~') else f'{namespace}/{name}')
            delay = round(1e9 * scene.values[output.delay]) if output.delay else 0
            self._topics[name] = (
                len(channels), Serializer(output.type_name, in_frames(output.template, frames)),
                delay, output)
            channels.append(Channel(topic, output.type_name))
        channels.append(Channel(f'{namespace}/{DESCRIPTION}', TEXT, durability='transient_local'))
        super().__init__(path, channels, {START: {**start_note(node, values), **notes}})
        self.write(len(channels) - 1, 0, 0, description(scene, frames))
        self._frames_due, self._frames_period = 0, round(1e9 / values[TRANSFORMS.rate])

    def output(self, name: str, snapshot: Any, numbers: np.ndarray) -> None:
        """Log a message of an output, and frames where they are due; commands go to `write`."""
        if name == 'joint_states' and snapshot.nanoseconds >= self._frames_due:
            # A microsecond less, because times are rounded to nanoseconds.
            self._frames_due = snapshot.nanoseconds + self._frames_period - 1000
            self.output(TRANSFORMS.name, snapshot, TRANSFORMS.numbers(snapshot))
        index, serialize, delay, output = self._topics[name]
        self.write(index, snapshot.step, snapshot.nanoseconds + delay,
                   serialize(snapshot.time, output.content(snapshot, numbers)))

    def close(self) -> None:
        """Complete the file; raise OSError if that fails, or the log has ended early."""
        self.note(SUMMARY, self.summary)
        super().close()
        if self.error:
            raise OSError(self.error)


def create(path: Path) -> tuple[Path, BinaryIO]:
    """Make a new file, numbered if it exists, and its folders; return its path and stream."""
    check_target(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # With mode 'x' the file system guarantees that nothing is overwritten.
    for candidate in numbered(path):
        try:
            # O_APPEND: if another program cuts the file or adds to it, its size shows that.
            stream = open(candidate, 'xb', opener=lambda name, flags: os.open(
                name, flags | os.O_APPEND, 0o666))
        except FileExistsError:
            continue
        with suppress(OSError):  # some network file systems have no locks
            # Marks it as being written until the stream is closed or its process ends.
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        break
    return candidate, stream


def numbered(path: Path) -> Iterator[Path]:
    """Yield a path, and the same with `_1`, `_2`, ... after its stem, without end."""
    yield path
    for number in count(1):
        yield path.with_stem(f'{path.stem}_{number}')


def sync(stream: BinaryIO) -> None:
    """Wait until all that was written is on the disk: a closed log survives a power cut."""
    stream.flush()
    os.fsync(stream.fileno())
