# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Read a log record by record, or its summary alone; recover what is intact in a damaged one.

Records are parsed by mcap. Checksums are verified, and lengths are compared with the file and with
fixed limits before anything is read.
"""

from collections.abc import Iterator
from dataclasses import replace
import fcntl
from io import BytesIO
import json
import math
import os
from pathlib import Path
import stat
import struct
from typing import BinaryIO, NamedTuple
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk as ChunkRecord, Header, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
import zstandard

from timo_sim.log.write import (
    CHANGE, Chunk, CHUNK_SIZE, HEAD, in_wall_time, MESSAGE_OPCODE, numbered, printable, RESET,
    START, SUMMARY, sync, Writer)
from timo_sim.scene.files import whole_file

_LARGEST_CHUNK = 64 * 1024 * 1024      # [B] uncompressed
_LARGEST_RECORD = _LARGEST_CHUNK + 1024 * 1024
_LARGEST_SUMMARY = 512 * 1024 * 1024   # [B], about that of a log of a month
_FOOTER = struct.Struct('<BQQQI8s')    # opcode, length, places of summary and offsets, CRC, magic
_MESSAGE = struct.Struct('<HIQQ')      # channel, sequence number, log time, publish time
# What mcap and the decompressors raise for bytes that they cannot read.
_UNREADABLE = (McapError, ValueError, OverflowError, RuntimeError, EOFError, LookupError,
               struct.error, zstandard.ZstdError)
_COPIED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}
_CHUNK_OPCODE, _FIRST_PRIVATE_OPCODE = int(Opcode.CHUNK), 0x80


class LogError(ValueError):
    """A log that cannot be read, or a file that cannot be written; the text says which and why."""


class _DamageError(ValueError):
    """Bytes of a log that cannot be read; the text says why."""


def files_of(path: Path | str) -> list[Path]:
    """Return the Paths of a file, or of the parts of a bag in a folder; else raise LogError."""
    path = Path(path)
    inside = sorted(path.iterdir(), key=lambda file: (len(file.name), file.name)) if (
        path.is_dir()) else [path]
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
    name, _, first = files[0].stem.rpartition('_') if files else ('', '', '')
    if first.isdecimal() and [file.stem for file in files] == [
            f'{name}_{number}' for number in range(int(first), int(first) + len(files))]:
        return files
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


def _parse(kind, content):
    """Return a record of mcap."""
    try:
        return kind.read(ReadDataStream(BytesIO(content)))
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


def _split(data):
    """Return opcode and content of each record in the data of a chunk."""
    found, place = [], 0
    while place < len(data):
        opcode, length = HEAD.unpack_from(data, place)
        begin, place = place + HEAD.size, place + HEAD.size + length
        if place > len(data) or opcode == _CHUNK_OPCODE:
            raise struct.error
        found.append((opcode, data[begin:place]))
    return found


def _read_summary(stream: BinaryIO) -> Summary:
    """Return the summary of a log; raise _DamageError if it is missing or damaged."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _FOOTER.size))
    end = stream.read(_FOOTER.size)
    if len(end) < _FOOTER.size or not end.endswith(MCAP0_MAGIC) or end[0] != Opcode.FOOTER:
        raise _DamageError('it has no end: its process died, or another tool still writes it')
    _, _, place, _, crc, _ = _FOOTER.unpack(end)
    if not place or not _FOOTER.size < size - place <= _LARGEST_SUMMARY:
        raise _DamageError('there is no summary')
    stream.seek(place)
    # The checksum covers all but itself and the magic.
    if crc and zlib.crc32(memoryview(stream.read(size - place))[:-12]) != crc:
        raise _DamageError('the checksum of the summary is wrong')
    stream.seek(0)
    try:
        found = SeekingReader(stream, record_size_limit=_LARGEST_RECORD).get_summary()
    except _UNREADABLE as error:
        raise _DamageError(f'its index is damaged: {error}') from None
    if not found or not found.statistics:
        raise _DamageError('there are no statistics')
    for kind, there, count in (
            ('schema', found.schemas, found.statistics.schema_count),
            ('channel', found.channels, found.statistics.channel_count),
            ('metadata', found.metadata_indexes, found.statistics.metadata_count)):
        if len(there) < count:
            raise _DamageError(f'its summary has {len(there)} of {count} records of kind {kind}')
    return found


class LogNotes(NamedTuple):
    """The metadata of a log."""

    facts: dict    # texts noted at the start of the run; empty if there are none
    summary: dict  # texts noted at its end; empty if there are none
    resets: list   # steps, in the order of the file
    changes: list  # (step, resets before it in the file, values by name of the scene's parameters)


class LogFile:
    """
    The summary of a log; its metadata and records, read when they are asked for.

    The file, or that in a bag's folder, is open only while it is read. `name` is its path as text
    that can be printed, `summary` is mcap's. LogError is raised if it is not a log, or has no
    summary: the text says what to do.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = file_of(path)
        self.name = printable(self.path)
        with _open(self.path) as stream:
            try:
                self.summary = _read_summary(stream)
            except _DamageError as error:
                reason = ('it is still being written: wait for its end, or'
                          if _is_being_written(stream) else f'{error}:')
                raise LogError(f'{self.name}: {reason} timo_sim recover {self.name} makes a '
                               'complete log of what is there') from None

    def notes(self) -> LogNotes:
        """Return the metadata; raise LogError if they are malformed or of several runs."""
        found = LogNotes({}, {}, [], [])
        for name, note in self._metadata():
            if name == START:
                if found.facts not in ({}, note):
                    raise LogError(f'{self.name} has the notes of several runs')
                found.facts.update(note)
            elif name == SUMMARY:
                found.summary.update(note)
            try:
                if name == RESET:
                    found.resets.append(_step_of(note))
                elif name == CHANGE:
                    found.changes.append((_step_of(note), len(found.resets),
                                          dict(json.loads(note['values']))))
            except (KeyError, TypeError, ValueError, RecursionError):
                raise LogError(f'{self.name} has a malformed metadata record {name}: '
                               f'{str(note)[:80]!r}') from None
        return found

    def _metadata(self):
        with _open(self.path) as stream:
            stream.seek(0)
            try:
                return [(record.name, record.metadata) for record in SeekingReader(
                    stream, record_size_limit=_LARGEST_RECORD).iter_metadata()]
            except _UNREADABLE as error:
                raise self._damaged(error) from None

    def records(self) -> Iterator[Schema | Channel | Metadata | Chunk]:
        """Yield what the file has, see `_Reader.records`; raise LogError if it is damaged."""
        with _open(self.path) as stream:
            reader = _Reader(stream)
            yield from reader.records()
            if reader.damage:
                raise self._damaged(reader.damage)

    def _damaged(self, reason):
        return LogError(f'{self.name} is damaged: {reason}: timo_sim recover {self.name} keeps '
                        'what is intact')


def _step_of(note):
    if not note['step'].isdecimal() or len(note['step']) > 18:
        raise ValueError
    return int(note['step'])


class _Reader:
    """
    Reads a log, behind its magic, record by record until it breaks; damaged records are left out.

    `damage` is the first damage and its place, None for a complete file; `lost` are bytes that
    could not be read, `left_out` counts attachments and private records, which are not copied.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self.profile = stream, 'ros2'
        self.size = os.fstat(stream.fileno()).st_size
        self.place, self.lost, self.faults, self.count = len(MCAP0_MAGIC), 0, 0, 0
        self.earliest, self.latest, self.left_out = math.inf, 0, 0
        self.damage: str | None = None

    def records(self) -> Iterator[Schema | Channel | Metadata | Chunk]:
        """Yield each Schema and Channel once, Metadata (not rosbag2's) and Chunks of messages."""
        chunk = Chunk()
        known: set[tuple[type, int]] = {(Schema, 0)}
        for record in self._intact():
            if isinstance(record, bytes):
                channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record)
                if (Channel, channel) not in known:
                    self._report(f'a message is of an unknown channel, {channel}')
                    continue
                self.count += 1
                self.earliest = min(self.earliest, log_time)
                self.latest = max(self.latest, log_time)
                chunk.add(channel, sequence, log_time, publish_time, record[_MESSAGE.size:])
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
            if not isinstance(record, bytes):
                yield record
        if chunk.data:
            yield chunk

    def _report(self, damage, lost=0):
        self.faults += 1
        self.lost += lost
        self.damage = self.damage or f'{damage} (byte {self.place})'

    def _intact(self):
        """Yield the records that are to be copied, also those in chunks; messages as bytes."""
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
        if opcode == MESSAGE_OPCODE:
            if len(content) < _MESSAGE.size:
                raise _DamageError('a record of kind message is malformed')
            return [content]
        if opcode == _CHUNK_OPCODE:
            data = _decompress(_parse(ChunkRecord, content))
            try:
                inside = _split(data)
            except struct.error:
                raise _DamageError('a chunk cannot be read: its records are malformed') from None
            return [record for part in inside for record in self._contents(*part)]
        if opcode in _COPIED:
            record = _parse(_COPIED[opcode], content)
            made_again = isinstance(record, Metadata) and record.name == 'rosbag2'
            return [] if made_again and self.profile == 'ros2' else [record]
        if opcode == Opcode.HEADER:
            self.profile = _parse(Header, content).profile
        elif opcode == Opcode.ATTACHMENT or opcode >= _FIRST_PRIVATE_OPCODE:
            self.left_out += 1
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
            empty = False
            own = own or (isinstance(record, Metadata) and record.name == START
                          and not in_wall_time(record.metadata))
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
    lost = f'{reader.lost} bytes lost'
    if reader.left_out:
        lost += f', {reader.left_out} attachments or private records left out'
    return f'{printable(path)}: {state}{more}; {contents}, {lost}; complete in {printable(new)}'


def _write(records, profile, path, output):
    """Write a new log; return its path."""
    if output is None:
        path = Path(f'{path.resolve()}.mcap') if path.is_dir() else path
        path = path.with_stem(path.stem + '_recovered')
        new = next(name for name in numbered(path) if not name.exists())
    else:
        new = Path(output)
        if new.exists():
            raise LogError(f'{printable(output)} exists: remove it or choose another --output')
    with whole_file(new, new=True) as part, open(part, 'wb') as stream:
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
    return new
