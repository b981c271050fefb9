# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Read a log record by record, or its summary alone; recover what is before a damage.

Records are parsed by mcap. Checksums are verified, and lengths are compared with the file and with
fixed limits before anything is read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from io import BytesIO
import json
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
import numpy as np
import zstandard

from timo_sim.log.notes import CHANGE, printable, RESET, START, SUMMARY
from timo_sim.log.write import Chunk, HEAD, MESSAGE, MESSAGE_OPCODE, numbered, sync, Writer
from timo_sim.scene.files import whole_file

_LARGEST_CHUNK = 64 * 1024 * 1024      # [B] uncompressed
_LARGEST_RECORD = _LARGEST_CHUNK + 1024 * 1024
_LARGEST_SUMMARY = 512 * 1024 * 1024   # [B], about that of a log of a month
_FOOTER = struct.Struct('<BQQQI8s')    # opcode, length, places of summary and offsets, CRC, magic
_AT_ONCE = 512 * 1024  # [B] of messages outside of chunks that are read together
# A message, but for its data.
_MESSAGE = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4'),
                     ('log_time', '<u8'), ('publish_time', '<u8')])
_WHOLE = np.dtype(f'V{_MESSAGE.itemsize}')  # the same without fields, which is copied faster
# What mcap and the decompressors raise for bytes that they cannot read.
_UNREADABLE = (McapError, ValueError, OverflowError, RuntimeError, EOFError, LookupError,
               struct.error, zstandard.ZstdError)


class LogError(ValueError):
    """A log that cannot be read, or a file that cannot be written; the text says which and why."""


def file_of(path: Path | str) -> Path:
    """Return the Path of a file, or of the only *.mcap in a bag's folder; else raise LogError."""
    path = Path(path)
    if not path.is_dir():
        return path
    files = sorted(path.glob('*.mcap'))
    if len(files) != 1:
        raise LogError(f'{printable(path)} has {len(files)} files *.mcap, and must have one: '
                       'ros2 bag convert or rosbags-convert makes one file of others')
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


def _decompress(chunk):
    """Return the data of a Chunk of mcap; raise ValueError if size or checksum are wrong."""
    size = chunk.uncompressed_size
    if size > _LARGEST_CHUNK:
        raise ValueError(f'a chunk claims to hold {size} bytes, more than {_LARGEST_CHUNK}')
    # One byte more than the chunk states, to find out if it has more.
    if chunk.compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression == 'zstd':
        decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_CHUNK)
        data = decompressor.stream_reader(chunk.data).read(size + 1)
    elif chunk.compression:
        raise ValueError(f'the compression of a chunk is {chunk.compression[:20]!r}')
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f'a chunk does not have the {size} bytes that it states')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError('the checksum of a chunk is wrong')
    return data


def _read_summary(stream: BinaryIO) -> Summary:
    """Return the summary of a log; raise one of _UNREADABLE if it is missing or damaged."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _FOOTER.size))
    end = stream.read(_FOOTER.size)
    if len(end) < _FOOTER.size or not end.endswith(MCAP0_MAGIC) or end[0] != Opcode.FOOTER:
        raise ValueError('it has no end: it is still being written, or its process died')
    _, _, place, _, crc, _ = _FOOTER.unpack(end)
    if not place or not _FOOTER.size < size - place <= _LARGEST_SUMMARY:
        raise ValueError('there is no summary')
    stream.seek(place)
    # The checksum covers all but itself and the magic.
    if crc and zlib.crc32(memoryview(stream.read(size - place))[:-12]) != crc:
        raise ValueError('the checksum of the summary is wrong')
    stream.seek(0)  # where mcap reads the magic
    found = SeekingReader(stream, record_size_limit=_LARGEST_RECORD).get_summary()
    if not found or not (known := found.statistics) or (
            len(found.schemas) < known.schema_count or len(found.channels) < known.channel_count
            or len(found.metadata_indexes) < known.metadata_count):
        raise ValueError('its summary is incomplete')
    return found


def _reason(error):
    return str(error) or 'a record is cut'  # mcap's EndOfFile has no text


class LogNotes(NamedTuple):
    """The metadata of a log."""

    facts: dict    # texts noted at the start of the run; empty if there are none
    summary: dict  # texts noted at its end; empty if there are none
    resets: list   # steps, in the order of the file
    changes: list  # (step, resets before it in the file, values by name of the scene's parameters)


class Messages(NamedTuple):
    """Some messages that were written together."""

    resets: int        # before them
    data: bytes        # they are parts of it
    heads: np.ndarray  # (n,), their `channel`, `sequence`, `log_time` and `publish_time` [ns]
    ends: np.ndarray   # (n,), where they end in `data`

    def those(self, which: np.ndarray) -> Messages:
        """Return those where `which`, (n,) bool, is true."""
        return self._replace(heads=self.heads.view(_WHOLE)[which].view(_MESSAGE),
                             ends=self.ends[which])

    @property
    def sizes(self) -> np.ndarray:
        """Number of bytes of each serialised message, (n,) int."""
        return self.heads['length'].astype(np.int64) - MESSAGE.size

    def serialized(self) -> list[bytes]:
        """Return each serialised message."""
        begins = self.ends - self.sizes
        return [self.data[part] for part in map(slice, begins.tolist(), self.ends.tolist())]

    def rows(self) -> np.ndarray:
        """Return the serialised messages, if they are of one size, (n, size) uint8."""
        size = int(self.sizes[0])
        whole = np.ndarray(len(self.data) - size + 1, f'V{size}', self.data, strides=1)
        return whole[self.ends - size].view(np.uint8).reshape(-1, size)


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
            except _UNREADABLE as error:
                raise LogError(f'{self.name}: {_reason(error)}: timo_sim recover {self.name} '
                               'makes a complete log of what is there') from None

    def notes(self) -> LogNotes:
        """Return the metadata; raise LogError if they are malformed or of several runs."""
        found = LogNotes({}, {}, [], [])
        with _open(self.path) as stream:
            stream.seek(0)
            try:
                notes = [(record.name, record.metadata) for record in SeekingReader(
                    stream, record_size_limit=_LARGEST_RECORD).iter_metadata()]
            except _UNREADABLE as error:
                raise self._damaged(_reason(error)) from None
        for name, note in notes:
            if name == START:
                if found.facts not in ({}, note):
                    raise LogError(f'{self.name} has the notes of several runs: cut it, so that '
                                   'each part has one')
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

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, Messages]]:
        """Yield topics of these with Messages; raise LogError if the file is damaged."""
        channels = {number: channel.topic for number, channel in self.summary.channels.items()
                    if channel.topic in topics}
        if not channels:
            return
        with _open(self.path) as stream:
            reader = _Reader(stream)
            for record in reader.records():
                if isinstance(record, Messages):
                    for channel, topic in channels.items():
                        own = record.heads['channel'] == channel
                        if own.any():
                            yield topic, record.those(own)
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
    Reads a log, behind its magic, record by record.

    It stops at the first damage: `damage` says what it is, None after the end of a complete file.
    `place` is how far it has read, or where the damage is [B].
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self.profile, self.place = stream, 'ros2', len(MCAP0_MAGIC)
        self.damage: str | None = None
        self._schemas, self._resets = {0}, 0
        self._channels = np.zeros(2**16, dtype=bool)  # whether one is known

    def records(self) -> Iterator[Schema | Channel | Metadata | Messages]:
        """Yield each Schema and Channel once, Metadata but rosbag2's, and Messages."""
        try:
            for data, index in self._blocks():
                yield from self._inside(data, index)
            _read_summary(self._stream)
        except _UNREADABLE as error:
            self.damage = f'{_reason(error)} (byte {self.place})'

    def _blocks(self):
        """Yield chunks, with the index behind them, and what is outside, messages together."""
        size, crc = os.fstat(self._stream.fileno()).st_size, zlib.crc32(MCAP0_MAGIC)
        block, index, opcode = b'', b'', None
        while opcode != Opcode.DATA_END:
            head, left = self._stream.read(HEAD.size), size - self.place
            opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
            if HEAD.size + length > left or length > _LARGEST_RECORD:
                opcode = 0
            if opcode != Opcode.MESSAGE_INDEX and block and (
                    opcode != MESSAGE_OPCODE or len(block) > _AT_ONCE):
                yield block, index
                block = index = b''
            if not opcode:
                raise ValueError('it ends in the middle of a record, or its length is wrong'
                                 if any(head) else 'it ends early')
            content = self._stream.read(length)
            if opcode == Opcode.CHUNK:
                block = _decompress(_parse(ChunkRecord, content))
            elif opcode == Opcode.DATA_END:
                if content not in (bytes(4), crc.to_bytes(4, 'little')):
                    raise ValueError('the checksum of all data is wrong')
            elif opcode == Opcode.FOOTER:
                raise ValueError('the record that ends its data is missing')
            elif opcode == Opcode.MESSAGE_INDEX:
                index += content[6:]  # behind channel and size: a time and a place of each message
            else:
                block += head + content
            crc = zlib.crc32(content, zlib.crc32(head, crc))
            self.place += HEAD.size + length

    def _inside(self, data, index):
        """Yield the records in a block; raise an error behind those before a malformed one."""
        starts, places, wrong = _indexed(data, index), [], None
        place = len(data) if len(starts) else 0
        try:
            while place < len(data):
                opcode, length = HEAD.unpack_from(data, place)
                end = place + HEAD.size + length
                if end > len(data) or opcode in (0, Opcode.CHUNK) or (
                        opcode == MESSAGE_OPCODE and length < MESSAGE.size):
                    raise ValueError('its records are malformed')
                if opcode == MESSAGE_OPCODE:
                    places.append(place)
                else:
                    yield from self._record(opcode, data[place + HEAD.size:end])
                place = end
        except _UNREADABLE as error:
            wrong = error
        starts = np.array(places) if places else starts
        heads = _heads(data, starts)
        known = self._channels[heads['channel']]
        if known.any():
            yield Messages(self._resets, data, heads, starts + HEAD.size
                           + heads['length'].astype(np.int64)).those(known)
        if not known.all():
            raise ValueError(f'a message is of an unknown channel, {heads["channel"][~known][0]}')
        if wrong:
            raise wrong

    def _record(self, opcode, content):
        """Yield a record that is no message and no chunk, if a log needs it."""
        if opcode == Opcode.METADATA:
            record = _parse(Metadata, content)
            self._resets += record.name == RESET
            if record.name != 'rosbag2' or self.profile != 'ros2':  # else it is made anew
                yield record
        elif opcode == Opcode.SCHEMA:
            record = _parse(Schema, content)
            if record.id not in self._schemas:
                self._schemas.add(record.id)
                yield record
        elif opcode == Opcode.CHANNEL:
            record = _parse(Channel, content)
            if record.schema_id not in self._schemas:
                raise ValueError(f'{record.topic[:80]!r} is of an unknown schema')
            if not self._channels[record.id]:
                self._channels[record.id] = True
                yield record
        elif opcode == Opcode.HEADER:
            self.profile = _parse(Header, content).profile


def _heads(data, places):
    return np.ndarray(max(0, len(data) - _MESSAGE.itemsize + 1), _WHOLE, data, strides=1)[
        places].view(_MESSAGE)


def _indexed(data, index):
    """Return the places of messages by their index, (n,); none if it does not fit all data."""
    places = np.sort(np.frombuffer(index[:len(index) // 16 * 16], '<i8')[1::2])
    if len(places) and 0 == places[0] and places[-1] <= len(data) - _MESSAGE.itemsize:
        heads = _heads(data, places)
        ends = places + HEAD.size + heads['length'].astype(np.int64)
        if ends[-1] == len(data) and np.array_equal(ends[:-1], places[1:]) and (
                heads['opcode'] == MESSAGE_OPCODE).all() and (
                heads['length'] >= MESSAGE.size).all():
            return places
    return places[:0]


def _parse(kind, content):
    return kind.read(ReadDataStream(BytesIO(content)))


def recover(file: Path | str, output: Path | str | None = None) -> str:
    """
    Write what is intact in a damaged or incomplete log to a new one, with index and summary.

    `file`, or the only one in a bag's folder, is not changed. `output` must not exist; by default
    it is beside `file`, with `_recovered` after its stem, and a number if that exists. Returns
    what was found, lost and written: nothing if the log is complete. Raises LogError if the file
    is not a log or nothing in it is intact; OSError if the new file cannot be written, or exists.
    """
    path = file_of(file)
    with _open(path) as stream:
        # The file is read twice, because most files are complete, and some are no logs.
        reader, empty, count, latest = _Reader(stream), True, 0, 0
        for record in reader.records():
            empty = False
            if isinstance(record, Messages):
                count += len(record.heads)
                latest = max(latest, int(record.heads['log_time'].max()))
        contents = f'{count} messages until log time {1e-9 * latest:.3f} s'
        if not reader.damage:
            return f'{printable(path)} is complete: {contents}; nothing is written'
        if empty:
            raise LogError(f'{printable(path)}: nothing in it is intact: {reader.damage}')
        stream.seek(len(MCAP0_MAGIC))
        new = _write(_Reader(stream).records(), reader.profile, Path(file), output)
        lost = os.fstat(stream.fileno()).st_size - reader.place
    return (f'{printable(path)}: {reader.damage}; {contents}, {lost} bytes lost; '
            f'complete in {printable(new)}')


def _write(records, profile, path, output):
    """Write a new log; return its path."""
    path = Path(f'{path.resolve()}.mcap') if path.is_dir() else path
    path = path.with_stem(path.stem + '_recovered')
    new = Path(output or next(name for name in numbered(path) if not name.exists()))
    with whole_file(new, new=True) as part, open(part, 'wb') as stream:
        writer = Writer(stream, profile)
        for record in records:
            if isinstance(record, Messages):
                chunk = Chunk()
                for data, head in zip(record.serialized(), record.heads.tolist()):
                    chunk.add(data, *head[2:])
                writer.add_chunk(chunk)
            else:
                writer.add(record)
        writer.finish(new.name)
        sync(stream)
    return new
