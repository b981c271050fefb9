# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What is intact in a damaged log, and a complete log of it.

A file is read once from its beginning, a record at a time, in bounded memory; no length, number or
checksum is believed.
"""

from collections import Counter
import os
from pathlib import Path
import struct
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from timo_sim.log.index import read_summary
from timo_sim.log.recorder import CHUNK_SIZE, create, sync
from timo_sim.log.records import (
    Broken, bytes_of, HEAD, LARGEST_RECORD, LogError, open_file, parsed, printable, uncompressed)
from timo_sim.log.writer import Chunk, Writer

# Of schemas, channels and metadata of one file [B]; an entry in a table costs something, too.
_LARGEST_KEPT, _ENTRY = 64 * 1024 * 1024, 100

_MESSAGE_HEAD = struct.Struct('<H4xQ8x')  # channel, sequence number, log time, publish time
_KEPT = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}


def recover(file, output=None):
    """
    Write what is intact in a log to a new one, with index and summary.

    Parameters
    ----------
    file : str or Path
        It is only read.
    output : str or Path, optional
        A file that does not exist; by default beside `file`, with `_recovered` after its stem,
        and a number if that exists.

    Returns
    -------
    str
        What was found and done. If the log is complete, nothing is written.

    Raises
    ------
    LogError
        If there is nothing to recover, or `output` exists.
    OSError
        If the new log cannot be written.

    """
    path = Path(file)
    with open_file(path) as stream:
        # Read once before anything is written: most files are complete, and some are no logs.
        reader = Reader(stream)
        found = sum(1 for _ in reader.records())
        contents = (f'{reader.counts.total()} messages until sim time '
                    f'{1e-9 * reader.latest:.3f} s')
        if reader.damage is None:
            return f'{printable(path)} is complete: {contents}; nothing is written'
        if not found:
            raise LogError(f'{printable(path)}: nothing in it is intact: {reader.damage}')
        stream.seek(len(MCAP0_MAGIC))
        new = _write(Reader(stream).records(), reader.profile, path, output)
    return (f'{printable(path)}: {reader.damage}; {contents}, {reader.size - reader.kept} bytes '
            f'lost; complete in {printable(new)}')


def _write(records, profile, path, output):
    """Write a new log; return its path."""
    if output is None:
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
        new.unlink()  # what is not whole would be taken for it
        raise
    return new


class _End(ValueError):
    """A place beyond which nothing can be read."""


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
    latest : int
        Log time of the last message [ns].
    kept : int
        Bytes of the file that were intact so far.
    damage : str or None
        The first that was not, and where. None after the last record: the file is complete.

    """

    def __init__(self, stream):
        self._stream = stream
        self.size = os.fstat(stream.fileno()).st_size
        self.profile, self.counts, self.latest, self.damage = 'ros2', Counter(), 0, None
        self.kept = self._place = len(MCAP0_MAGIC)
        self._crc = zlib.crc32(MCAP0_MAGIC)
        self._known = {Schema: {}, Channel: {}}
        self._held = 0
        self._ended = False

    def records(self):
        """
        Yield each Schema, Channel, Metadata and Chunk that is intact, in the order of the file.

        Each schema and channel comes once, and before what refers to it.
        """
        chunk = Chunk()
        for record in self._intact():
            if isinstance(record, tuple):
                chunk.add_record(*record)
            if chunk.data and (len(chunk.data) >= CHUNK_SIZE or not isinstance(record, tuple)):
                yield chunk
                chunk = Chunk()
            if not isinstance(record, tuple):
                yield record
        if chunk.data:
            yield chunk

    def _intact(self):
        """Yield what `records` does, but for a message channel, time and content of its record."""
        try:
            while not self._ended:
                yield from self._next()
            self._check_end()
        except _End as error:
            self._complain(error)

    def _complain(self, error):
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
            self._complain(f'a record of {length} bytes is larger than any should be')
        else:
            content = self._stream.read(length)
            crc, self._crc = self._crc, zlib.crc32(content, zlib.crc32(head, self._crc))
            try:
                yield from self._contents(opcode, content, crc)
            except Broken as error:
                self._complain(error)
            else:
                # Attachments and private records are allowed, but not kept.
                if opcode not in (Opcode.ATTACHMENT, Opcode.ATTACHMENT_INDEX) and opcode < 0x80:
                    self.kept += HEAD.size + length
        self._place += HEAD.size + length

    def _contents(self, opcode, content, crc):
        if opcode == Opcode.CHUNK:
            yield from self._inside(memoryview(uncompressed(content)))
        elif opcode == Opcode.MESSAGE:
            yield self._message(memoryview(content))
        elif opcode in _KEPT:
            yield from self._keep(parsed(_KEPT[opcode], content))
        elif opcode == Opcode.HEADER:
            self.profile = parsed(Header, content).profile
        elif opcode == Opcode.DATA_END and content not in (bytes(4), crc.to_bytes(4, 'little')):
            self._complain('the checksum of all data is wrong')
        elif opcode == Opcode.FOOTER:
            self._ended = True
        elif Opcode.DATA_END < opcode < 0x80:
            raise Broken(f'a record of kind {opcode} has no place in a log')
        # Indexes and statistics are made again from the messages.

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
        if len(content) < _MESSAGE_HEAD.size:
            raise Broken('a message is too short')
        channel, time = _MESSAGE_HEAD.unpack_from(content)
        if channel not in self._known[Channel]:
            raise Broken(f'a message is of an unknown channel, {channel}')
        self.counts[channel] += 1
        self.latest = max(self.latest, time)
        return channel, time, content

    def _keep(self, record):
        """Yield a schema, a channel or metadata, unless it is known."""
        if isinstance(record, Metadata):
            if record.name == 'rosbag2':  # which is made again
                return
        else:
            known = self._known[type(record)]
            if record.id in known:
                if known[record.id] != record:
                    raise Broken(f'there are two {type(record).__name__.lower()}s {record.id}')
                return
            if isinstance(record, Channel) and record.schema_id not in self._known[Schema]:
                raise Broken(f'{record.topic[:80]!r} is of an unknown schema, {record.schema_id}')
            if not record.id and isinstance(record, Schema):
                raise Broken('a schema has the number 0')
            known[record.id] = record
        self._held += _ENTRY + len(bytes_of(record))
        if self._held > _LARGEST_KEPT:
            raise _End(f'there are more than {_LARGEST_KEPT} bytes of schemas, channels and '
                       'metadata')
        yield record

    def _check_end(self):
        if self._place + len(MCAP0_MAGIC) != self.size:
            raise _End('after its end there is something else'
                       if self._place + len(MCAP0_MAGIC) < self.size else 'it ends early')
        self.kept += len(MCAP0_MAGIC)
        try:
            statistics = read_summary(self._stream)[Statistics][-1]
            if Counter(statistics.channel_message_counts) != self.counts:
                raise Broken(f'{self.counts.total()} messages are there, the summary says '
                             f'{statistics.message_count}')
        except Broken as error:
            self._complain(error)
