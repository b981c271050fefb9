# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Read the summary of a complete log, and its messages by their index."""

from collections import defaultdict
from contextlib import contextmanager
from io import BytesIO
import os
import struct
from typing import Any
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Metadata, MetadataIndex, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
import numpy as np

from timo_sim.log.records import (
    Broken, file_of, HEAD, held, LARGEST_RECORD, LogError, open_file, parsed, printable,
    uncompressed, UNREADABLE)

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
