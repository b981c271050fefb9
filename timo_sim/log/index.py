# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a complete log says of itself at its end, and its messages by their index."""

from itertools import islice
import os
from pathlib import Path
import struct
from typing import Any, NamedTuple
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
import numpy as np

from timo_sim.log.records import (
    Broken, HEAD, LARGEST_RECORD, LogError, open_file, parsed, uncompressed)
from timo_sim.log.rosbag2 import printable

_FOOTER = struct.Struct('<BQQQI')      # opcode, length, where summary and its offsets are, CRC
_LARGEST_SUMMARY = 512 * 1024 * 1024   # [B]; that of a month takes about this
_CHUNK_INDEX = struct.Struct('<4QI')   # times, where the chunk is, its size, size of a map
_OFFSET = struct.Struct('<HQ')         # an entry of that map


class IndexedChunk(NamedTuple):
    """Where a chunk is, and when its messages were logged."""

    start: int
    end: int
    place: int
    length: int
    index_length: int
    indexes: dict     # place of each channel's index

    def counts(self):
        """Return how many messages of each channel it has, from the sizes of their indexes."""
        places = sorted((place, channel) for channel, place in self.indexes.items())
        ends = [place for place, _ in places[1:]] + [self.place + self.length + self.index_length]
        # Opcode, length, channel, size of the list; 16 bytes each.
        return {channel: (end - place - 15) // 16 for (place, channel), end in zip(places, ends)}


class Index:
    """
    The summary of a log, and its chunks.

    What it says is checked before it is used: nothing is read or decompressed twice, or outside
    of the file, whatever it claims.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    size : int
        Of the file [B].
    schemas, channels : dict
        Records by number.
    statistics : Statistics
    chunks : list of IndexedChunk
        In the order of the file.

    Raises
    ------
    LogError
        If the file is no log, or has no summary: the text says what to do.

    """

    def __init__(self, path):
        self.path = Path(path)
        self.name = printable(self.path)
        self.stream = open_file(self.path)
        self.size = os.fstat(self.stream.fileno()).st_size
        self.schemas, self.channels, self.chunks = {}, {}, []
        self.statistics: Any = None
        self._metadata = []
        try:
            self._read()
        except (Broken, struct.error, UnicodeDecodeError) as error:
            self.close()
            raise LogError(f'{self.name}: its index is damaged ({error}): timo_sim recover '
                           f'{self.name} makes a log with a new one') from None
        except LogError:
            self.close()
            raise

    def close(self):
        """Close the file."""
        self.stream.close()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.close()

    def metadata(self, limit=None):
        """
        Yield the metadata records but rosbag2's.

        Parameters
        ----------
        limit : int, optional
            So many at most.

        Yields
        ------
        place : int
        Metadata

        """
        wanted = (entry for entry in self._metadata if entry[2] != 'rosbag2')
        for place, length, _ in islice(wanted, limit):
            yield place, self.checked(lambda: parsed(
                Metadata, self._record(place, length, Opcode.METADATA)))

    def read(self, chunk):
        """
        Read a chunk.

        Returns
        -------
        data : ndarray of uint8
        offsets : dict
            Where the messages of each channel begin in it, in the order of its index.

        """
        return self.checked(lambda: self._messages(chunk))

    def times(self, chunk):
        """Return the log times of a chunk's messages by channel, (n,) [ns], without reading it."""
        return self.checked(lambda: {channel: entries[:, 0].astype(np.int64)
                                     for channel, entries in self._entries(chunk).items()})

    def checked(self, read):
        """Call a function; what it finds broken is an error with the file's name."""
        try:
            return read()
        except (Broken, struct.error) as error:
            raise LogError(f'{self.name} is damaged: {error}: timo_sim recover {self.name} keeps '
                           'what is intact') from None

    def _read(self):
        start = self.stream.read(len(MCAP0_MAGIC))
        if start != MCAP0_MAGIC:
            raise LogError(f'{self.name} is empty' if not start else
                           f'{self.name} is not an MCAP file: it begins with {start!r}')
        tail = _FOOTER.size + len(MCAP0_MAGIC)
        self.stream.seek(max(0, self.size - tail))
        end = self.stream.read(tail)
        if len(end) < tail or end[-len(MCAP0_MAGIC):] != MCAP0_MAGIC or end[0] != Opcode.FOOTER:
            raise LogError(f'{self.name} has no end, as after a crash: timo_sim recover '
                           f'{self.name} makes a complete log of it')
        _, _, place, _, crc = _FOOTER.unpack_from(end)
        length = self.size - tail - place
        if not place:
            raise Broken('there is no summary')
        if not 0 < length <= _LARGEST_SUMMARY:
            raise Broken(f'the summary would have {length} bytes')
        self.stream.seek(place)
        data = self.stream.read(length)
        if crc and zlib.crc32(end[:_FOOTER.size - 4], zlib.crc32(data)) != crc:
            raise Broken('the checksum of the summary is wrong')
        self._parse(memoryview(data))
        if self.statistics is None:
            raise Broken('there are no statistics')
        self._check_order(place)

    def _parse(self, data):
        place = 0
        while place < len(data):
            opcode, length = HEAD.unpack_from(data, place)
            content = data[place + HEAD.size:place + HEAD.size + length]
            if len(content) < length:
                raise Broken('a record ends outside of it')
            place += HEAD.size + length
            if opcode == Opcode.CHUNK_INDEX:
                self.chunks.append(_chunk(content))
            elif opcode == Opcode.METADATA_INDEX:
                where, size, name_size = struct.unpack_from('<QQI', content)
                self._metadata.append((where, size, bytes(content[20:20 + name_size]).decode()))
            elif opcode == Opcode.SCHEMA:
                schema = parsed(Schema, bytes(content))
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = parsed(Channel, bytes(content))
                self.channels[channel.id] = channel
            elif opcode == Opcode.STATISTICS:
                self.statistics = parsed(Statistics, bytes(content))

    def _check_order(self, end):
        # What overlaps would be read again and again.
        self.chunks.sort(key=lambda chunk: chunk.place)
        spans = [(chunk.place, chunk.length + chunk.index_length) for chunk in self.chunks]
        for group in (spans, sorted(entry[:2] for entry in self._metadata)):
            before = 0
            for place, length in group:
                if place < before or place + length > end:
                    raise Broken('two of its entries overlap')
                before = place + length

    def _record(self, place, length, opcode):
        """Return the content of a record of which place and length are known."""
        if not HEAD.size <= length <= LARGEST_RECORD:
            raise Broken(f'a record would have {length} bytes')
        self.stream.seek(place)
        data = self.stream.read(length)
        if len(data) < length or HEAD.unpack_from(data) != (opcode, length - HEAD.size):
            raise Broken(f'at byte {place} is no record of kind {int(opcode)}')
        return data[HEAD.size:]

    def _messages(self, chunk):
        entries = self._entries(chunk)
        data = np.frombuffer(uncompressed(
            self._record(chunk.place, chunk.length, Opcode.CHUNK)), np.uint8)
        return data, {channel: pairs[:, 1] for channel, pairs in entries.items()}

    def _entries(self, chunk):
        """Return times and positions of a chunk's messages by channel, shape (n, 2)."""
        if chunk.index_length > LARGEST_RECORD:
            raise Broken(f'the index of a chunk would have {chunk.index_length} bytes')
        self.stream.seek(chunk.place + chunk.length)
        data, place, found = self.stream.read(chunk.index_length), 0, {}
        while place < len(data):
            opcode, length, channel, size = struct.unpack_from('<BQHI', data, place)
            if opcode != Opcode.MESSAGE_INDEX or length != 6 + size or size % 16:
                raise Broken('the index of a chunk does not hold what it says')
            if channel in found or place + 15 + size > len(data):
                raise Broken('the index of a chunk does not hold what it says')
            found[channel] = np.frombuffer(data, '<u8', size // 8, place + 15).reshape(-1, 2)
            place += 15 + size
        return found


def _chunk(content):
    start, end, place, length, size = _CHUNK_INDEX.unpack_from(content)
    if size % _OFFSET.size or _CHUNK_INDEX.size + size + 8 > len(content):
        raise Broken('the index of chunks does not hold what it says')
    indexes = dict(_OFFSET.iter_unpack(content[_CHUNK_INDEX.size:_CHUNK_INDEX.size + size]))
    index_length, = struct.unpack_from('<Q', content, _CHUNK_INDEX.size + size)
    return IndexedChunk(start, end, place, length, index_length, indexes)
