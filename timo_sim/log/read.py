# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Read a log by its summary and index; write a new one of what is there before the first damage.

Records are parsed by mcap. Checksums are verified, and lengths are compared with the file and with
fixed limits before anything is read.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
import fcntl
from io import BytesIO
import json
import math
import os
from pathlib import Path
import stat
import struct
from typing import Any, BinaryIO, NamedTuple
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel, Chunk as ChunkRecord, ChunkIndex, Header, Message, Metadata, MetadataIndex, Schema,
    Statistics)
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import MCAP0_MAGIC
import numpy as np
import zstandard

from timo_sim.log.write import (
    CHANGE, Chunk, CHUNK_SIZE, create, HEAD, printable, RESET, START, SUMMARY, sync, Writer)

_LARGEST_CHUNK = 64 * 1024 * 1024      # [B] uncompressed
_LARGEST_RECORD = _LARGEST_CHUNK + 1024 * 1024
_LARGEST_SUMMARY = 512 * 1024 * 1024   # [B], about that of a log of a month
_FOOTER = struct.Struct('<BQQQI8s')    # opcode, length, places of summary and offsets, CRC, magic
# What mcap and the decompressors raise for bytes that they cannot read.
_UNREADABLE = (McapError, ValueError, OverflowError, RuntimeError, EOFError, struct.error,
               zstandard.ZstdError)
_COPIED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}
_FIRST_PRIVATE_OPCODE = 0x80


class LogError(ValueError):
    """A log that cannot be read, or a file that cannot be written; the text says which and why."""


class _DamageError(ValueError):
    """Bytes of a log that cannot be read; the text says why."""


def files_of(path: Path | str) -> list[Path]:
    """Return the Paths of a file, or of the parts of a bag in a folder; else raise LogError."""
    path = Path(path)
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    foreign = [file for file in inside if file.suffix in ('.db3', '.zstd')]
    if foreign:
        kind = 'SQLite' if '.db3' in foreign[0].suffixes else 'compressed as a whole'
        raise LogError(
            f'{printable(foreign[0])} is {kind}, not MCAP: rosbags-convert --src BAG --dst NEW '
            '--dst-storage mcap (pip install rosbags) makes a bag that can be read')
    if not path.is_dir():
        return inside
    files = [file for file in inside if file.suffix == '.mcap']
    # A bag that rosbag2 has split has files NAME_0.mcap, NAME_1.mcap, ...
    parts = {int(number): file for file in files
             if (number := file.stem.rpartition('_')[2]).isdecimal()}
    first = min(parts, default=0)
    if len(files) > 1 and len({file.stem.rpartition('_')[0] for file in files}) == 1 and (
            sorted(parts) == [*range(first, first + len(files))]):
        return [parts[number] for number in sorted(parts)]
    if len(files) != 1:
        raise LogError(f'{printable(path)} has {len(files)} files *.mcap: name one')
    return files


def file_of(path: Path | str) -> Path:
    """Return the Path of a file, or of the only one in a bag's folder; else raise LogError."""
    files = files_of(path)
    if len(files) > 1:
        raise LogError(f'{printable(path)} has {len(files)} files *.mcap: name one')
    return files[0]


def _open(path):
    """Open a log and read its magic; raise LogError if it is not an MCAP file."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a pipe might never end
            raise LogError(f'{printable(path)} is not a file')
        stream = open(path, 'rb')
    except (PermissionError, NotADirectoryError) as error:
        raise LogError(f'{printable(path)}: {error.strerror}') from None
    start = stream.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        stream.close()
        raise LogError(f'{printable(path)} is empty' if not start else
                       f'{printable(path)} is not an MCAP file: it begins with {start!r}')
    return stream


def _is_being_written(stream):
    """Return whether a process of this package holds the lock of a log, see `write.create`."""
    try:
        fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    fcntl.flock(stream, fcntl.LOCK_UN)
    return False


def _parse(kind, content, *length):
    """Return a record of mcap; its messages must be told their length."""
    try:
        return kind.read(ReadDataStream(BytesIO(content)), *length)
    except _UNREADABLE:
        raise _DamageError(f'a record of kind {kind.__name__.lower()} is malformed') from None


def _decompress(chunk):
    """Return the data of a Chunk of mcap; raise _DamageError if size or checksum are wrong."""
    size = chunk.uncompressed_size
    if size > _LARGEST_CHUNK:
        raise _DamageError(f'a chunk claims to hold {size} bytes, more than {_LARGEST_CHUNK}')
    try:
        # One byte more than the chunk states, to find out if it has more.
        if chunk.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
        elif chunk.compression == 'zstd':
            decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_CHUNK)
            data = decompressor.stream_reader(chunk.data).read(size + 1)
        elif chunk.compression:
            raise ValueError(f'its compression is {chunk.compression[:20]!r}')
        else:
            data = chunk.data
    except _UNREADABLE as error:
        raise _DamageError(f'a chunk cannot be read: {error}') from None
    if len(data) != size:
        raise _DamageError(f'a chunk does not have the {size} bytes that it states')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise _DamageError('the checksum of a chunk is wrong')
    return data


def _read_summary(stream):
    """Return the records of a log's summary by their type; raise _DamageError without one."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _FOOTER.size))
    end = stream.read(_FOOTER.size)
    if len(end) < _FOOTER.size or not end.endswith(MCAP0_MAGIC) or end[0] != Opcode.FOOTER:
        raise _DamageError('it has no end: its process died, or another tool still writes it')
    _, _, place, _, crc, _ = _FOOTER.unpack(end)
    if not place or not _FOOTER.size < size - place <= _LARGEST_SUMMARY:
        raise _DamageError('there is no summary')
    stream.seek(place)
    data = stream.read(size - place)
    if crc and zlib.crc32(memoryview(data)[:-12]) != crc:  # it covers all but itself and the magic
        raise _DamageError('the checksum of the summary is wrong')
    found: defaultdict[type, list[Any]] = defaultdict(list)
    try:
        for record in StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records:
            found[type(record)].append(record)
    except _UNREADABLE as error:
        raise _DamageError(f'its index is damaged: {error}') from None
    if not found[Statistics]:
        raise _DamageError('there are no statistics')
    counts = found[Statistics][-1]
    for kind, count in ((Schema, counts.schema_count), (Channel, counts.channel_count),
                        (MetadataIndex, counts.metadata_count)):
        if len(found[kind]) < count:
            raise _DamageError(f'its summary has {len(found[kind])} of {count} records of kind '
                               f'{kind.__name__.lower()}')
    return found


class LogNotes(NamedTuple):
    """The metadata of a log."""

    facts: dict    # texts noted at the start of the run; empty if there are none
    summary: dict  # texts noted at its end; empty if there are none
    resets: list   # (step, place in the file) of each
    changes: list  # (step, place, values by name) of each setting of the scene's parameters


class LogFile:
    """
    The summary of a log, and its metadata and chunks, read when they are asked for.

    The file, or that in a bag's folder, is open only while it is read. `name` is its path as text
    that can be printed; `schemas` and `channels` are records by number, `statistics` is one, and
    `chunks` is a list of ChunkIndex in the order of the file. LogError is raised if it is not a
    log, or has no summary: the text says what to do.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = file_of(path)
        self.name = printable(self.path)
        with _open(self.path) as stream:
            try:
                found = _read_summary(stream)
            except _DamageError as error:
                reason = ('it is still being written: wait for its end, or'
                          if _is_being_written(stream) else f'{error}:')
                raise LogError(f'{self.name}: {reason} timo_sim recover {self.name} makes a '
                               'complete log of what is there') from None
        self.schemas = {schema.id: schema for schema in found[Schema]}
        self.channels = {channel.id: channel for channel in found[Channel]}
        self.statistics = found[Statistics][-1]
        self.chunks = sorted(found[ChunkIndex], key=lambda chunk: chunk.chunk_start_offset)
        self._metadata = sorted(found[MetadataIndex], key=lambda entry: entry.offset)

    def notes(self) -> LogNotes:
        """Return the metadata; raise LogError if they are malformed or of several runs."""
        starts, summary, resets, changes = [], {}, [], []
        for entry in self._metadata:
            if entry.name not in (START, SUMMARY, RESET, CHANGE):
                continue
            with self._opened() as stream:
                note = _parse(Metadata, self._record(
                    stream, entry.offset, entry.length, Opcode.METADATA)).metadata
            try:
                if entry.name == START:
                    starts.append(note)
                elif entry.name == SUMMARY:
                    summary = note
                elif not note['step'].isdecimal() or len(note['step']) > 18:
                    raise ValueError
                elif entry.name == RESET:
                    resets.append((int(note['step']), entry.offset))
                else:
                    changes.append((int(note['step']), entry.offset,
                                    dict(json.loads(note['values']))))
            except (KeyError, TypeError, ValueError, RecursionError):
                raise LogError(f'{self.name} has a malformed metadata record {entry.name}: '
                               f'{str(note)[:80]!r}') from None
        if any(note != starts[0] for note in starts):
            raise LogError(f'{self.name} has the notes of several runs')
        return LogNotes(starts[0] if starts else {}, summary, sorted(resets),
                        sorted(changes, key=lambda change: change[:2]))

    def blocks(self, most: int | None = None) -> Iterator[
            tuple[int, np.ndarray, dict[int, np.ndarray]]]:
        """Yield place, bytes, and message offsets by channel of at most `most` blocks, spread."""
        # A record of a message index has 15 bytes, and 16 more for each message.
        indexed = sum((chunk.message_index_length - 15 * len(chunk.message_index_offsets)) // 16
                      for chunk in self.chunks)
        if indexed == self.statistics.message_count:
            for chunk in self.chunks[::math.ceil(len(self.chunks) / (most or math.inf)) or 1]:
                with self._opened() as stream:
                    data = _decompress(_parse(ChunkRecord, self._record(
                        stream, chunk.chunk_start_offset, chunk.chunk_length, Opcode.CHUNK)))
                    yield chunk.chunk_start_offset, np.frombuffer(data, np.uint8), {
                        channel: entries[:, 1]
                        for channel, entries in self._index(stream, chunk)}
            return
        # Files without chunks, or without their indexes, are read record by record.
        with _open(self.path) as stream:
            reader, place = _Reader(stream), 0
            for record in reader.records():
                if isinstance(record, Chunk):
                    place = max(place + 1, reader.place)
                    yield place, np.frombuffer(record.data, np.uint8), {
                        channel: np.array(entries[1::2], np.uint64)
                        for channel, entries in record.index.items()}
            if reader.damage:
                raise LogError(f'{self.name}: {reader.damage}: timo_sim recover {self.name} keeps '
                               'what is intact')

    def times(self, chunk: ChunkIndex) -> dict[int, np.ndarray]:
        """Return log times of a chunk's messages by channel, (n,) [ns]; reads its index only."""
        with self._opened() as stream:
            return {channel: entries[:, 0].astype(np.int64)
                    for channel, entries in self._index(stream, chunk)}

    @contextmanager
    def _opened(self):
        try:
            with _open(self.path) as stream:
                yield stream
        except (_DamageError, struct.error) as error:
            raise LogError(f'{self.name} is damaged: {error}: timo_sim recover {self.name} keeps '
                           'what is intact') from None

    def _record(self, stream, place, length, opcode):
        """Return the content of the record of this place, length and kind."""
        if not HEAD.size <= length <= _LARGEST_RECORD:
            raise _DamageError(f'a record would have {length} bytes')
        stream.seek(place)
        data = stream.read(length)
        if len(data) < length or HEAD.unpack_from(data) != (opcode, length - HEAD.size):
            raise _DamageError(f'at byte {place} is no record of kind {int(opcode)}')
        return data[HEAD.size:]

    def _index(self, stream, chunk):
        """Yield each channel of a chunk with times and offsets of its messages, (n, 2)."""
        if chunk.message_index_length > _LARGEST_RECORD:
            raise _DamageError(f'the index of a chunk would have {chunk.message_index_length} '
                               'bytes')
        stream.seek(chunk.chunk_start_offset + chunk.chunk_length)
        data, place = stream.read(chunk.message_index_length), 0
        while place < len(data):
            opcode, length, channel, size = struct.unpack_from('<BQHI', data, place)
            place += 15
            if (opcode != Opcode.MESSAGE_INDEX or length != 6 + size or size % 16
                    or place + size > len(data)):
                raise _DamageError('the index of a chunk is malformed')
            yield channel, np.frombuffer(data, '<u8', size // 8, place).reshape(-1, 2)
            place += size


class _Reader:
    """
    Reads a log, behind its magic, record by record until it breaks; damaged records are left out.

    `damage` is the first damage and its place, None for a complete file; `lost` are bytes that
    could not be read, `left_out` attachments and private records, which are not copied.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self.profile = stream, 'ros2'
        self.size = os.fstat(stream.fileno()).st_size
        self.place, self.lost, self.faults, self.count = len(MCAP0_MAGIC), 0, 0, 0
        self.earliest, self.latest = math.inf, 0
        self.damage: str | None = None
        self.left_out: Counter = Counter()

    def records(self) -> Iterator[Schema | Channel | Metadata | Chunk]:
        """Yield each Schema and Channel once, Metadata (not rosbag2's) and Chunks of messages."""
        chunk = Chunk()
        known: set[tuple[type, int]] = {(Schema, 0)}
        for record in self._intact():
            if isinstance(record, Message):
                if (Channel, record.channel_id) not in known:
                    self._report(f'a message is of an unknown channel, {record.channel_id}')
                    continue
                self.count += 1
                self.earliest = min(self.earliest, record.log_time)
                self.latest = max(self.latest, record.log_time)
                chunk.add(record.channel_id, record.sequence, record.log_time,
                          record.publish_time, record.data)
                if len(chunk.data) < CHUNK_SIZE:
                    continue
            if chunk.data:
                yield chunk
                chunk = Chunk()
            if isinstance(record, (Schema, Channel)):
                if (type(record), record.id) in known:
                    continue
                known.add((type(record), record.id))
                if isinstance(record, Channel) and (Schema, record.schema_id) not in known:
                    self._report(f'{record.topic[:80]!r} is of an unknown schema, '
                                 f'{record.schema_id}, and is kept without')
                    record = replace(record, schema_id=0)
            if not isinstance(record, Message):
                yield record
        if chunk.data:
            yield chunk

    def _report(self, damage, lost=0):
        self.faults += 1
        self.lost += lost
        self.damage = self.damage or f'{damage} (byte {self.place})'

    def _intact(self):
        """Yield the records of mcap that are to be copied, also those inside of chunks."""
        crc, opcode, data_ended = zlib.crc32(MCAP0_MAGIC), None, False
        while opcode != Opcode.FOOTER:
            head, left = self._stream.read(HEAD.size), self.size - self.place
            opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
            if not opcode or HEAD.size + length > left or length > _LARGEST_RECORD:
                self._report('it ends early' if not any(head) else
                             'it ends in the middle of a record, or its length is wrong', left)
                return
            content = self._stream.read(length)
            try:
                yield from self._contents(opcode, content)
            except _DamageError as error:
                self._report(error, HEAD.size + length)
            if opcode == Opcode.DATA_END:
                data_ended = True
                if content not in (bytes(4), crc.to_bytes(4, 'little')):
                    self._report('the checksum of all data is wrong')
            crc = zlib.crc32(content, zlib.crc32(head, crc))
            self.place += HEAD.size + length
        if not data_ended:
            self._report('the record that ends its data, with their checksum, is missing')
        elif self.place + len(MCAP0_MAGIC) != self.size:
            self._report('there is something else after its end')
        else:
            try:
                _read_summary(self._stream)
            except _DamageError as error:
                self._report(error)

    def _contents(self, opcode, content):
        """Return the list of records to copy that a record is or contains."""
        if opcode == Opcode.CHUNK:
            chunk = _parse(ChunkRecord, content)
            data = _decompress(chunk)
            try:
                return breakup_chunk(replace(chunk, compression='', data=data))
            except _UNREADABLE as error:
                raise _DamageError(f'a chunk cannot be read: {error}') from None
        if opcode == Opcode.MESSAGE:
            return [_parse(Message, content, len(content))]
        if opcode in _COPIED:
            record = _parse(_COPIED[opcode], content)
            made_again = isinstance(record, Metadata) and record.name == 'rosbag2'
            return [] if made_again and self.profile == 'ros2' else [record]
        if opcode == Opcode.HEADER:
            self.profile = _parse(Header, content).profile
        elif opcode == Opcode.ATTACHMENT or opcode >= _FIRST_PRIVATE_OPCODE:
            self.left_out['attachments' if opcode == Opcode.ATTACHMENT else 'private records'] += 1
        return []


def recover(file: Path | str, output: Path | str | None = None) -> str:
    """
    Write what is intact in a damaged or incomplete log to a new one, with index and summary.

    `file`, or the only one in a bag's folder, is not changed. `output` must not exist; by default
    it is beside `file`, with `_recovered` after its stem, and a number if that exists. Returns
    what was found, lost and written: nothing if the log is complete. Raises LogError if the file
    is not a log or nothing in it is intact, or if `output` exists; OSError if the new file cannot
    be written.
    """
    path = file_of(file)
    with _open(path) as stream:
        # The file is read twice, because most files are complete, and some are no logs.
        reader, empty, own = _Reader(stream), True, False
        for record in reader.records():
            empty, own = False, own or isinstance(record, Metadata) and record.name == START
        contents = f'{reader.count} messages ' + (
            f'until sim time {1e-9 * reader.latest:.3f} s' if own else
            # Log times of a bag are those of a wall clock.
            f'within {1e-9 * max(0, reader.latest - reader.earliest):.3f} s')
        if not reader.damage:
            return f'{printable(path)} is complete: {contents}; nothing is written'
        if empty:
            raise LogError(f'{printable(path)}: nothing in it is intact: {reader.damage}')
        stream.seek(len(MCAP0_MAGIC))
        new = _write(_Reader(stream).records(), reader.profile, Path(file), output)
        state = 'it is still being written' if _is_being_written(stream) else reader.damage
    more = f' and {reader.faults - 1} more' if reader.faults > 1 else ''
    lost = ', '.join([f'{reader.lost} bytes lost', *(
        f'{count} {kind} left out' for kind, count in reader.left_out.items())])
    return f'{printable(path)}: {state}{more}; {contents}, {lost}; complete in {printable(new)}'


def _write(records, profile, path, output):
    """Write a new log; return its path."""
    if output is None:
        path = Path(f'{path.resolve()}.mcap') if path.is_dir() else path
        new, stream = create(path.with_stem(path.stem + '_recovered'))
    else:
        try:
            new, stream = Path(output), open(output, 'xb')
        except FileExistsError:
            raise LogError(
                f'{printable(output)} exists: remove it or choose another --output') from None
    try:
        with stream:
            writer = Writer(stream, profile)
            for record in records:
                if isinstance(record, Chunk):
                    writer.add_chunk(record)
                elif isinstance(record, Metadata):
                    writer.add_metadata(record.name, record.metadata)
                else:
                    writer.add_record(record)
            writer.finish(new.name)
            sync(stream)
    except BaseException:
        new.unlink()  # an incomplete file would be taken for a recovered log
        raise
    return new
