# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Read what is intact in a log, complete or not.

A file is read once from its beginning, a record at a time, in bounded memory. Every length, number
and checksum is verified.
"""

from collections import Counter
from dataclasses import replace
from io import BytesIO
import math
import os
import struct
from typing import NamedTuple
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from timo_sim.log.index import read_summary
from timo_sim.log.recorder import CHUNK_SIZE
from timo_sim.log.records import (
    Broken, bytes_of, HEAD, LARGEST_RECORD, parsed, uncompressed, UNREADABLE)
from timo_sim.log.writer import Chunk

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
