# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Write MCAP files chunk by chunk, in a thread of their own.

Besides messages, a file has what rosbag2 writes: the QoS of topics, and its own metadata record.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
import os
from pathlib import Path
import struct
import threading
import time
from typing import Any, BinaryIO, NamedTuple
import zlib

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel as ChannelRecord, Chunk as ChunkRecord, ChunkIndex, DataEnd, Footer, Header, Metadata,
    MetadataIndex, Schema, Statistics)
from mcap.summary import Summary
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC

from timo_sim.log.rosbag2 import information, offered_qos, yaml_text
from timo_sim.scene.files import check_target
from timo_sim.topics.cdr import schema_text

HEAD = struct.Struct('<BQ')       # of a record: opcode, and length of the content
MESSAGE = struct.Struct('<HIQQ')  # channel, sequence number, log time, publish time; data follow
_HEAD_AND_MESSAGE = struct.Struct('<BQHIQQ')
MESSAGE_OPCODE = int(Opcode.MESSAGE)  # comparing with the enum itself takes longer


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


FLUSH_PERIOD = 0.5       # [s] of wall time; a crash loses at most twice this
CHUNK_SIZE = 512 * 1024  # [B] so that a day has few; none waits longer than `FLUSH_PERIOD`
BACKLOG = 20             # chunks that may wait for the disk before `write` waits, too
WARN_AFTER, GIVE_UP_AFTER = 0.5, 60.0  # [s] that `write` waits for the disk


class Channel(NamedTuple):
    """A topic of the log."""

    topic: str      # fully qualified name
    type_name: str  # as in 'sensor_msgs/msg/JointState'
    name: str = ''  # before remapping, as in '~/tip_pose'
    durability: str = 'volatile'  # or 'transient_local'


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
                          metadata={'offered_qos_profiles': offered_qos(channel.durability)})
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
