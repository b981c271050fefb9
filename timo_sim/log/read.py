# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Read a log: by its summary and index, or all that is intact in it, which `recover` writes anew.

A damaged file is read once from its beginning, a record at a time, in bounded memory. Every
length, number and checksum is verified.
"""

from collections import Counter, defaultdict
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
import math
import os
from pathlib import Path
import struct
from typing import Any, NamedTuple
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment, Channel, ChunkIndex, Header, Metadata, MetadataIndex, Schema, Statistics)
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
import numpy as np

from timo_sim.log.records import (
    Broken, bytes_of, file_of, HEAD, held, LARGEST_RECORD, LogError, open_file, parsed, printable,
    START, uncompressed, UNREADABLE)
from timo_sim.log.write import Chunk, CHUNK_SIZE, create, sync, Writer

_FOOTER = struct.Struct('<BQQQI8s')    # opcode, length, places of summary and offsets, CRC, magic
_LARGEST_SUMMARY = 512 * 1024 * 1024   # [B], about that of a log of a month


def read_summary(stream):
    """
    Return the records of a log's summary by their type.

    Raises
    ------
    Broken
        If there is none, or it is damaged.

    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _FOOTER.size))
    end = stream.read(_FOOTER.size)
    if len(end) < _FOOTER.size or not end.endswith(MCAP0_MAGIC) or end[0] != Opcode.FOOTER:
        raise Broken('it has no end: its process died, or another tool still writes it')
    _, _, place, _, crc, _ = _FOOTER.unpack(end)
    length = size - place
    if not place or not _FOOTER.size < length <= _LARGEST_SUMMARY:
        raise Broken('there is no summary')
    stream.seek(place)
    data = stream.read(length)
    if crc and zlib.crc32(memoryview(data)[:-12]) != crc:  # it covers all but itself and the magic
        raise Broken('the checksum of the summary is wrong')
    found: defaultdict[type, list[Any]] = defaultdict(list)
    try:
        for record in StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records:
            found[type(record)].append(record)
    except (*UNREADABLE, ValueError) as error:  # ValueError: mcap 1.1, of short unknown records
        raise Broken(f'its index is damaged: {error}') from None
    if not found[Statistics]:
        raise Broken('there are no statistics')
    counts = found[Statistics][-1]
    for kind, count in ((Schema, counts.schema_count), (Channel, counts.channel_count),
                        (MetadataIndex, counts.metadata_count)):
        if len(found[kind]) < count:
            raise Broken(f'its summary has {len(found[kind])} of {count} records of kind '
                         f'{kind.__name__.lower()}')
    found[ChunkIndex].sort(key=lambda chunk: chunk.chunk_start_offset)
    found[MetadataIndex].sort(key=lambda entry: entry.offset)
    # Overlapping entries would let a forged index cost any amount of work.
    for spans in ([(chunk.chunk_start_offset, chunk.chunk_length + chunk.message_index_length)
                   for chunk in found[ChunkIndex]],
                  [(entry.offset, entry.length) for entry in found[MetadataIndex]]):
        before = 0
        for place, length in spans:
            if place < before or place + length > size:
                raise Broken('two entries of its index overlap')
            before = place + length
    return found


class Index:
    """
    The summary of a log, and its chunks.

    The summary is checked before it is used: whatever it claims, nothing is read twice or from
    outside of the file. The file is open only while it is read.

    Parameters
    ----------
    path : str or Path
        A file, or a bag's folder with one.

    Attributes
    ----------
    path : Path
        Of the file.
    schemas, channels : dict
        Records by number.
    statistics : Statistics
    chunks : list of ChunkIndex
        In the order of the file.

    Raises
    ------
    LogError
        If the file is not a log, or has no summary: the text says what to do.

    """

    def __init__(self, path):
        self.path = file_of(path)
        self.name = printable(self.path)
        with open_file(self.path) as self._stream:
            try:
                found = read_summary(self._stream)
            except Broken as error:
                reason = ('it is still being written: wait for its end, or' if held(self._stream)
                          else f'{error}:')
                raise LogError(f'{self.name}: {reason} timo_sim recover {self.name} makes a '
                               'complete log of what is there') from None
        self.schemas = {schema.id: schema for schema in found[Schema]}
        self.channels = {channel.id: channel for channel in found[Channel]}
        self.statistics = found[Statistics][-1]
        self.chunks, self._metadata = found[ChunkIndex], found[MetadataIndex]

    def metadata(self):
        """Yield the place in the file and the record of all metadata, without rosbag2's."""
        for entry in self._metadata:
            if entry.name != 'rosbag2':
                with self._checked():
                    yield entry.offset, parsed(Metadata, self._record(
                        entry.offset, entry.length, Opcode.METADATA))

    def read(self, chunk):
        """
        Return the data of a chunk, an ndarray of uint8, and the offsets of messages in it.

        The offsets are a dictionary by number of the channel, in the order of the chunk's index.
        """
        with self._checked():
            offsets = {channel: entries[:, 1] for channel, entries in self._entries(chunk)}
            return np.frombuffer(uncompressed(self._record(
                chunk.chunk_start_offset, chunk.chunk_length, Opcode.CHUNK)), np.uint8), offsets

    def times(self, chunk):
        """Return log times of a chunk's messages by channel, (n,) [ns]; reads its index only."""
        with self._checked():
            return {channel: entries[:, 0].astype(np.int64)
                    for channel, entries in self._entries(chunk)}

    @contextmanager
    def _checked(self):
        try:
            with open_file(self.path) as self._stream:
                yield
        except (Broken, struct.error) as error:
            raise LogError(f'{self.name} is damaged: {error}: timo_sim recover {self.name} keeps '
                           'what is intact') from None

    def _record(self, place, length, opcode):
        """Return the content of the record of this place, length and kind, or raise Broken."""
        if not HEAD.size <= length <= LARGEST_RECORD:
            raise Broken(f'a record would have {length} bytes')
        self._stream.seek(place)
        data = self._stream.read(length)
        if len(data) < length or HEAD.unpack_from(data) != (opcode, length - HEAD.size):
            raise Broken(f'at byte {place} is no record of kind {int(opcode)}')
        return data[HEAD.size:]

    def _entries(self, chunk):
        """Yield each channel of a chunk with times and positions of its messages, (n, 2)."""
        if chunk.message_index_length > LARGEST_RECORD:
            raise Broken(f'the index of a chunk would have {chunk.message_index_length} bytes')
        self._stream.seek(chunk.chunk_start_offset + chunk.chunk_length)
        data, place, seen = self._stream.read(chunk.message_index_length), 0, set()
        while place < len(data):
            opcode, length, channel, size = struct.unpack_from('<BQHI', data, place)
            place += 15
            if (opcode != Opcode.MESSAGE_INDEX or length != 6 + size or size % 16
                    or channel in seen or place + size > len(data)):
                raise Broken('the index of a chunk is malformed')
            yield channel, np.frombuffer(data, '<u8', size // 8, place).reshape(-1, 2)
            place += size
            seen.add(channel)


# Most bytes of schemas, channels and metadata of a file, and overhead that is counted for each.
_LARGEST_KEPT, _ENTRY = 64 * 1024 * 1024, 100
# Work that a file may cause, in unpacked bytes: any file, and for each of its bytes.
_WORK, _WORK_PER_BYTE = 500 * 1000 * 1000, 1000
_WORK_PER_MESSAGE, _WORK_PER_OTHER = 1000, 10000  # what a record inside of a chunk costs

_MESSAGE_HEAD = struct.Struct('<H4xQ8x')  # channel, log time; skips sequence and publish time
_KEPT = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}
_MADE_AGAIN = {Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
               Opcode.METADATA_INDEX, Opcode.STATISTICS, Opcode.SUMMARY_OFFSET, Opcode.DATA_END}
_PRIVATE = 0x80  # first opcode of private records


class Private(NamedTuple):
    """A private record: MCAP leaves its meaning to the application that wrote it."""

    opcode: int
    content: bytes


class Message(NamedTuple):
    """Channel, log time [ns] and content of a message's record."""

    channel: int
    time: int
    content: memoryview


def _attachment(content):
    """Return the Attachment of a record; its checksum may be 0, for none."""
    try:
        record = Attachment.read(ReadDataStream(BytesIO(content)))
        crc = zlib.crc32(content[:-4]).to_bytes(4, 'little')
        if bytes_of(record)[HEAD.size:-4] == content[:-4] and content[-4:] in (bytes(4), crc):
            return record
    except UNREADABLE:
        pass
    raise Broken('an attachment is malformed')


class _End(ValueError):
    """An error from which on the rest of a file cannot be read."""


class Reader:
    """
    Reads what is intact in a log; where the length of a record cannot be true, reading ends.

    Parameters
    ----------
    stream : binary file
        As `open_file` returns it.

    Attributes
    ----------
    size : int
        Of the file [B].
    profile : str
    counts : Counter
        Messages of each channel.
    earliest, latest : int
        Log times of the first and the last message [ns]; inf and 0 without any.
    kept : int
        Bytes of the file that were intact so far.
    damage : str or None
        The first damage, and its place. None after the last record: the file is complete.
    faults : int
        How many damages were found.
    began : int
        Place in the file at which messages of the last Chunk begin.

    """

    def __init__(self, stream):
        self._stream = stream
        self.size = os.fstat(stream.fileno()).st_size
        self.profile, self.counts, self.damage = 'ros2', Counter(), None
        self.earliest, self.latest = math.inf, 0
        self.faults = self.began = 0
        self.kept = self._place = len(MCAP0_MAGIC)
        self._crc = zlib.crc32(MCAP0_MAGIC)
        self._known = {Schema: {}, Channel: {}}
        self._held, self._work = 0, _WORK + _WORK_PER_BYTE * self.size
        self._ended = self._data_ended = False

    def records(self):
        """
        Yield each Schema, Channel, Metadata, Attachment, Private and Chunk, in the file's order.

        Each schema and channel comes once, before records that refer to it.
        """
        chunk, began = Chunk(), 0
        for record in self._intact():
            message = isinstance(record, Message)
            if message:
                began = began if chunk.data else self._place
                chunk.add_record(*record)
            if chunk.data and (len(chunk.data) >= CHUNK_SIZE or not message):
                self.began = began
                yield chunk
                chunk = Chunk()
            if not message:
                yield record
        if chunk.data:
            self.began = began
            yield chunk

    def _intact(self):
        """Yield the same as `records`, with single Messages in place of Chunks."""
        try:
            while not self._ended:
                yield from self._next()
            self._check_end()
        except _End as error:
            self._complain(error)

    def _spend(self, work):
        """End if a small file would unpack to more than any program has logged in it."""
        self._work -= work
        if self._work < 0:
            raise _End('it unpacks to far more than its size')

    def _complain(self, error):
        self.faults += 1
        self.damage = self.damage or f'{error} (byte {self._place})'

    def _next(self):
        """Read a record; yield what is in it."""
        left = self.size - self._place - HEAD.size
        if left == -HEAD.size:
            raise _End('it ends early')
        if left < 0:
            raise _End('it ends in the middle of a record')
        head = self._stream.read(HEAD.size)
        opcode, length = HEAD.unpack(head)
        if not opcode:
            raise _End('there are no more records')
        if length > left:
            raise _End('it ends in the middle of a record, or its length is wrong')
        if length > LARGEST_RECORD:
            self._stream.seek(length, os.SEEK_CUR)
            self._complain(f'a record of {length} bytes is larger than {LARGEST_RECORD}')
        else:
            content = self._stream.read(length)
            crc, self._crc = self._crc, zlib.crc32(content, zlib.crc32(head, self._crc))
            try:
                yield from self._contents(opcode, content, crc)
            except Broken as error:
                self._complain(error)
            else:
                self.kept += HEAD.size + length
        self._place += HEAD.size + length

    def _contents(self, opcode, content, crc):
        if opcode == Opcode.CHUNK:
            data = uncompressed(content)
            self._spend(len(data))
            yield from self._inside(memoryview(data))
        elif opcode == Opcode.METADATA:
            yield from self._keep(parsed(Metadata, content))
        elif opcode == Opcode.ATTACHMENT:
            yield from self._keep(_attachment(content))
        elif opcode == Opcode.HEADER:
            self.profile = parsed(Header, content).profile
        elif opcode == Opcode.DATA_END:
            self._data_ended = True
            if content not in (bytes(4), crc.to_bytes(4, 'little')):
                self._complain('the checksum of all data is wrong')
        elif opcode == Opcode.FOOTER:
            self._ended = True
        elif opcode not in _MADE_AGAIN:
            yield from self._entry(opcode, memoryview(content), 'log')

    def _inside(self, data):
        """Yield the records of an uncompressed chunk."""
        place = 0
        while place < len(data):
            if place + HEAD.size > len(data):
                raise Broken('a chunk ends in the middle of a record')
            opcode, length = HEAD.unpack_from(data, place)
            self._spend(_WORK_PER_MESSAGE if opcode == Opcode.MESSAGE else _WORK_PER_OTHER)
            place += HEAD.size
            if length > len(data) - place:
                raise Broken('a chunk ends in the middle of a record')
            try:
                yield from self._entry(opcode, data[place:place + length], 'chunk')
            except Broken as error:  # other records of the chunk are kept
                self._spend(_WORK_PER_OTHER)
                self._complain(error)
                self.kept -= HEAD.size + length
            place += length

    def _entry(self, opcode, content, where):
        """Yield the content of a record that may be inside or outside of a chunk."""
        if opcode == Opcode.MESSAGE:
            yield self._message(content)
        elif opcode in _KEPT:
            yield from self._keep(parsed(_KEPT[opcode], bytes(content)))
        elif opcode >= _PRIVATE:
            yield Private(opcode, bytes(content))
        else:
            raise Broken(f'a record of kind {opcode} has no place in a {where}')

    def _message(self, content):
        if len(content) < _MESSAGE_HEAD.size:
            raise Broken('a message is too short')
        channel, time = _MESSAGE_HEAD.unpack_from(content)
        if channel not in self._known[Channel]:
            raise Broken(f'a message is of an unknown channel, {channel}')
        self.counts[channel] += 1
        self.earliest, self.latest = min(self.earliest, time), max(self.latest, time)
        return Message(channel, time, content)

    def _keep(self, record):
        """Yield a schema, a channel, metadata or an attachment, unless it is known."""
        if isinstance(record, Metadata) and record.name == 'rosbag2' and self.profile == 'ros2':
            return  # `Writer.finish` makes it again
        if isinstance(record, (Schema, Channel)):
            known = self._known[type(record)]
            if record.id in known:
                if known[record.id] != record:
                    raise Broken(f'there are two {type(record).__name__.lower()}s {record.id}')
                return
            if not record.id and isinstance(record, Schema):
                raise Broken('a schema has the number 0')
            known[record.id] = record
            if isinstance(record, Channel) and record.schema_id not in {0, *self._known[Schema]}:
                self._complain(f'{record.topic[:80]!r} is of an unknown schema, '
                               f'{record.schema_id}, and is kept without')
                record = replace(record, schema_id=0)
        self._held += _ENTRY + len(bytes_of(
            replace(record, data=b'') if isinstance(record, Attachment) else record))
        if self._held > _LARGEST_KEPT:
            raise _End(f'there are more than {_LARGEST_KEPT} bytes of schemas, channels and '
                       'metadata')
        yield record

    def _check_end(self):
        if self._place + len(MCAP0_MAGIC) != self.size:
            raise _End('there is something else after its end'
                       if self._place + len(MCAP0_MAGIC) < self.size else 'it ends early')
        self.kept += len(MCAP0_MAGIC)
        if not self._data_ended:
            self._complain('the record that ends its data, with their checksum, is missing')
        try:
            statistics = read_summary(self._stream)[Statistics][-1]
            if Counter(statistics.channel_message_counts) != self.counts:
                raise Broken(f'{self.counts.total()} messages are there, the summary says '
                             f'{statistics.message_count}')
        except Broken as error:
            self._complain(error)


def recover(file, output=None):
    """
    Write what is intact in a damaged or incomplete log to a new one, with index and summary.

    Parameters
    ----------
    file : str or Path
        A file, or a bag's folder with one. It is only read.
    output : str or Path, optional
        A file that does not exist; by default beside `file`, with `_recovered` after its stem,
        and a number if that exists.

    Returns
    -------
    str
        What was found, what was lost, and what was written: nothing if the log is complete.

    Raises
    ------
    LogError
        If there is nothing to recover, or `output` exists.
    OSError
        If the new log cannot be written.

    """
    path = file_of(file)
    with open_file(path) as stream:
        # A first pass before anything is written: most files are complete, and some are no logs.
        reader = Reader(stream)
        found, own = 0, False
        for found, record in enumerate(reader.records(), 1):
            own = own or isinstance(record, Metadata) and record.name == START
        contents = f'{reader.counts.total()} messages ' + (
            f'until sim time {1e-9 * reader.latest:.3f} s' if own else
            # Log times of a bag are those of a wall clock.
            f'within {1e-9 * max(0, reader.latest - reader.earliest):.3f} s')
        if reader.damage is None:
            return f'{printable(path)} is complete: {contents}; nothing is written'
        if not found:
            raise LogError(f'{printable(path)}: nothing in it is intact: {reader.damage}')
        stream.seek(len(MCAP0_MAGIC))
        new = _write(Reader(stream).records(), reader.profile, Path(file), output)
        state = 'it is still being written' if held(stream) else reader.damage
    more = f' and {reader.faults - 1} more' if reader.faults > 1 else ''
    # Unpacked, damaged records may be larger than the file.
    lost = min(reader.size, reader.size - reader.kept)
    return (f'{printable(path)}: {state}{more}; {contents}, {lost} bytes lost; complete in '
            f'{printable(new)}')


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
                elif isinstance(record, Attachment):
                    writer.add_attachment(record)
                elif isinstance(record, Private):
                    writer.add_private(*record)
                else:
                    writer.add_record(record)
            writer.finish(new.name)
            sync(stream)
    except BaseException:
        new.unlink()  # an incomplete file would be taken for a recovered log
        raise
    return new


def payloads_of(recording):
    """Return the changes by step, mass [kg] and inertia [kg m2], as `Scene.payloads` does."""
    scene, changes = recording.scene, [(step, values) for step, _, values in recording.changes]
    starts, found = [0, *recording.resets.tolist()], []
    own = now = (scene.values['end_effector.mass'], scene.values['end_effector.inertia'])
    for start, end in zip(starts, [*starts[1:], float('inf')]):
        # A reset goes back to the mass and inertia that were set last.
        events = [(start, own), *((start + step, tuple(tip)) for step, *tip in scene.payloads)]
        for step, values in changes:
            if start <= step < end:
                before, own = own, tuple(values.get(f'end_effector.{name}', value)
                                         for name, value in zip(('mass', 'inertia'), own))
                # As in a simulator, a value that is set again changes nothing.
                events += [(step, own)] * (own != before)
        for step, tip in sorted(events, key=lambda event: event[0]):
            if step < end and tip != now:
                found.append((step, *tip))
                now = tip
    return tuple(found)
