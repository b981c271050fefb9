# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What is intact in an MCAP file, of which no length, number or checksum is believed.

A file is read once from its beginning, a record at a time, in bounded memory. What does not hold
what it says is left out; where even the length of a record cannot be true, reading ends.
"""

from collections import Counter
import struct
from typing import NamedTuple
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from timo_sim.log.records import (
    Broken, bytes_of, HEAD, LARGEST_RECORD, LogError, parsed, uncompressed)

# Of schemas, channels and metadata of one file [B]; an entry in a table costs something, too.
_LARGEST_KEPT, _ENTRY = 64 * 1024 * 1024, 100

_MESSAGE_HEAD = struct.Struct('<H4xQ')  # channel, sequence number, log time
_MESSAGE_HEAD_SIZE = 22
_KEPT = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}
# Made again from the messages, or of no use without what is made again.
_DERIVED = {Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.METADATA_INDEX,
            Opcode.SUMMARY_OFFSET, Opcode.STATISTICS, Opcode.DATA_END, Opcode.FOOTER}


def _is_foreign(opcode):
    # Allowed, but not written by this package and not kept: attachments and private records.
    return opcode in (Opcode.ATTACHMENT, Opcode.ATTACHMENT_INDEX) or opcode >= 0x80


class _End(ValueError):
    """A place beyond which nothing can be read."""


class Message(NamedTuple):
    """A message; its content is all of the record, without opcode and length."""

    channel: int
    time: int  # [ns]
    content: memoryview


class Reader:
    """
    Reads what is intact in a log.

    Parameters
    ----------
    stream : binary file
        At its beginning.
    size : int
        Of the file [B].
    name : str
        For errors.

    Attributes
    ----------
    profile : str
    kept : int
        Bytes of the file that were intact so far.
    damage : str or None
        The first that was not, and where. None after the last record: the file is complete.

    Raises
    ------
    LogError
        If the file does not begin as MCAP files do.

    """

    def __init__(self, stream, size, name):
        self._stream, self._size = stream, size
        start = stream.read(len(MCAP0_MAGIC))
        if start != MCAP0_MAGIC:
            raise LogError(f'{name} is empty' if not start else
                           f'{name} is not an MCAP file: it begins with {start!r}')
        self.profile = 'ros2'
        self.kept = self._place = len(start)
        self.damage = None
        self._crc = zlib.crc32(start)
        self._schemas, self._channels = {}, {}
        self._held = 0
        self._counts = Counter()
        # Where the summary says the summary begins, and what it counts.
        self._summary_start, self._expected = None, None
        self._ended = False

    def records(self):
        """
        Yield what is intact, in the order of the file.

        Yields
        ------
        Schema, Channel, Metadata or Message
            Each schema and channel once, and before what refers to it.

        """
        try:
            while not self._ended:
                yield from self._next()
            self._check_end()
        except _End as error:
            self._complain(error, self._place)

    def _complain(self, error, place):
        if self.damage is None:
            self.damage = f'{error} (byte {place})'

    def _next(self):
        """Read a record; yield what is in it."""
        place = self._place
        if place == self._size:
            raise _End('it ends early')
        head = self._stream.read(HEAD.size)
        if len(head) < HEAD.size:
            raise _End('it ends in the middle of a record')
        opcode, length = HEAD.unpack(head)
        if not opcode:
            raise _End('there are no more records')
        if length > self._size - place - HEAD.size:
            raise _End('it ends in the middle of a record, or its length is wrong')
        self._place += HEAD.size + length
        if length > LARGEST_RECORD:
            self._stream.seek(self._place)
            self._complain(f'a record of {length} bytes is larger than any should be', place)
            return
        content = self._stream.read(length)
        if len(content) < length:
            raise _End('it ends in the middle of a record')
        crc, self._crc = self._crc, zlib.crc32(content, zlib.crc32(head, self._crc))
        try:
            yield from self._contents(opcode, content, crc)
        except _End:
            self._place = place
            raise
        except Broken as error:
            self._complain(error, place)
            if opcode not in _DERIVED:
                return
        if not _is_foreign(opcode):
            self.kept += HEAD.size + length

    def _contents(self, opcode, content, crc):
        if opcode == Opcode.CHUNK:
            yield from self._inside(memoryview(uncompressed(content)))
        elif opcode == Opcode.MESSAGE:
            yield self._message(memoryview(content))
        elif opcode in _KEPT:
            yield from self._keep(parsed(_KEPT[opcode], content))
        elif opcode == Opcode.HEADER:
            self.profile = parsed(Header, content).profile
        elif opcode == Opcode.DATA_END:
            self._end_data(content, crc)
        elif opcode == Opcode.STATISTICS:
            self._expected = parsed(Statistics, content)
        elif opcode == Opcode.FOOTER:
            self._end_summary(parsed(Footer, content), content, crc)
        elif opcode not in _DERIVED and not _is_foreign(opcode):
            raise Broken(f'a record of kind {opcode} has no place in a log')

    def _inside(self, data):
        """Yield what is in an uncompressed chunk."""
        place = 0
        while place < len(data):
            if place + HEAD.size > len(data):
                raise Broken('a chunk ends in the middle of a record')
            opcode, length = HEAD.unpack_from(data, place)
            place += HEAD.size
            if length > len(data) - place:
                raise Broken('a chunk ends in the middle of a record')
            if opcode == Opcode.MESSAGE:
                yield self._message(data[place:place + length])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                yield from self._keep(parsed(_KEPT[opcode], bytes(data[place:place + length])))
            else:
                raise Broken(f'a record of kind {opcode} has no place in a chunk')
            place += length

    def _message(self, content):
        if len(content) < _MESSAGE_HEAD_SIZE:
            raise Broken('a message is too short')
        channel, time = _MESSAGE_HEAD.unpack_from(content)
        if channel not in self._channels:
            raise Broken(f'a message is of an unknown channel, {channel}')
        self._counts[channel] += 1
        return Message(channel, time, content)

    def _keep(self, record):
        """Yield a schema, a channel or metadata, unless it is known."""
        if not isinstance(record, Metadata) and self._is_known(record):
            return
        if not isinstance(record, Metadata) or record.name != 'rosbag2':  # which is made again
            self._held += _ENTRY + len(bytes_of(record))
        if self._held > _LARGEST_KEPT:
            raise _End(f'there are more than {_LARGEST_KEPT} bytes of schemas, channels and '
                       'metadata')
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
        yield record

    def _is_known(self, record):
        known = self._schemas if isinstance(record, Schema) else self._channels
        if record.id in known and known[record.id] != record:
            raise Broken(f'there are two {type(record).__name__.lower()}s {record.id}')
        if isinstance(record, Channel) and record.schema_id not in self._schemas:
            raise Broken(f'{record.topic[:80]!r} is of an unknown schema, {record.schema_id}')
        if isinstance(record, Schema) and record.id == 0:
            raise Broken('a schema has the number 0')
        return record.id in known

    def _end_data(self, content, crc):
        if len(content) != 4:
            raise Broken('the end of the data has a wrong length')
        expected, = struct.unpack('<I', content)
        if expected not in (0, crc):
            raise Broken('the checksum of all data is wrong')
        self._summary_start, self._crc = self._place, 0

    def _end_summary(self, footer, content, crc):
        self._ended = True
        crc = zlib.crc32(content[:-4], zlib.crc32(HEAD.pack(Opcode.FOOTER, len(content)), crc))
        if footer.summary_crc not in (0, crc):
            raise Broken('the checksum of the summary is wrong')
        if footer.summary_start != self._summary_start or self._expected is None:
            raise Broken('there is no summary')
        if Counter(self._expected.channel_message_counts) != self._counts:
            raise Broken(f'{self._counts.total()} messages are there, the summary says '
                         f'{self._expected.message_count}')

    def _check_end(self):
        end = self._stream.read(len(MCAP0_MAGIC) + 1)
        if end != MCAP0_MAGIC:
            raise _End('after its end there is something else' if len(end) >= len(MCAP0_MAGIC)
                       else 'it ends early')
        self.kept += len(MCAP0_MAGIC)
