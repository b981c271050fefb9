# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Write MCAP files chunk by chunk; a message is only appended to a chunk.

Besides messages, a file has what rosbag2 writes: the QoS of topics, and its own metadata record.
"""

from collections import Counter, defaultdict
import re
import struct
import zlib

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex, ChunkIndex, DataEnd, Footer, Header, Metadata, MetadataIndex, Schema,
    Statistics, SummaryOffset)
from mcap.records import Chunk as ChunkRecord
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC
import yaml

from timo_sim.log.records import bytes_of, HEAD, printable

# Opcode, length of what follows; channel, sequence number, log time and publish time.
_MESSAGE = struct.Struct('<BQHIQQ')
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_FOR_EVER = {'sec': 9223372036, 'nsec': 854775807}
DEPTH = 10  # default depth of a topic's queue [messages]
# What the node offers on a topic by default, as rosbag2 writes it (metadata version 9).
_QOS = {
    'history': 'keep_last', 'depth': DEPTH, 'reliability': 'reliable', 'durability': 'volatile',
    'deadline': _FOR_EVER, 'lifespan': _FOR_EVER, 'liveliness': 'automatic',
    'liveliness_lease_duration': _FOR_EVER, 'avoid_ros_namespace_conventions': False}


class Chunk:
    """
    Messages that are compressed together.

    Attributes
    ----------
    data : bytearray
    index : dict
        For each channel a flat list of times [ns] and positions of its messages, alternating.

    """

    def __init__(self):
        self.data = bytearray()
        self.index = defaultdict(list)

    def add(self, channel, sequence, time, data):
        """Append a message."""
        self.index[channel] += time, len(self.data)
        length = _MESSAGE.size - HEAD.size + len(data)
        self.data += _MESSAGE.pack(_MESSAGE_OPCODE, length, channel, sequence, time, time)
        self.data += data

    def add_record(self, channel, time, content):
        """Append a message from another file: the content of its record."""
        self.index[channel] += time, len(self.data)
        self.data += HEAD.pack(_MESSAGE_OPCODE, len(content))
        self.data += content


class Writer:
    """
    Writes a stream from its first byte to its last.

    Parameters
    ----------
    stream : binary file
    profile : str

    Attributes
    ----------
    size : int
        Number of bytes written so far.

    """

    def __init__(self, stream, profile):
        self._stream, self._profile = stream, profile
        self._crc = self.size = 0
        self._schemas, self._channels = [], []
        # Kept as bytes: a log of a day has so many that objects would fill the memory.
        self._chunk_indexes, self._metadata_indexes = RecordBuilder(), RecordBuilder()
        self._attachment_indexes = RecordBuilder()
        self._statistics = Statistics(
            attachment_count=0, channel_count=0, channel_message_counts=Counter(), chunk_count=0,
            message_count=0, metadata_count=0, message_start_time=0, message_end_time=0,
            schema_count=0)
        self._put(MCAP0_MAGIC)
        self._write(Header(profile=profile, library=LIBRARY_IDENTIFIER))

    def add_record(self, record):
        """Add a Schema or a Channel."""
        (self._schemas if isinstance(record, Schema) else self._channels).append(record)
        self._write(record)

    def add_metadata(self, name, values):
        """Add a metadata record."""
        offset = self.size
        length = self._write(Metadata(name=name, metadata=values))
        MetadataIndex(offset=offset, length=length, name=name).write(self._metadata_indexes)
        self._statistics.metadata_count += 1

    def add_attachment(self, attachment):
        """Add an Attachment."""
        offset = self.size
        about = {name: getattr(attachment, name)
                 for name in ('log_time', 'create_time', 'name', 'media_type')}
        AttachmentIndex(offset=offset, length=self._write(attachment),
                        data_size=len(attachment.data), **about).write(self._attachment_indexes)
        self._statistics.attachment_count += 1

    def add_private(self, opcode, content):
        """Add a private record, whose meaning the application that wrote it knows."""
        self._put(HEAD.pack(opcode, len(content)) + content)

    def add_chunk(self, chunk):
        """Compress a chunk that has messages, and write it with its index."""
        times = [entries[::2] for entries in chunk.index.values()]
        facts = {
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
        known, start = self._statistics, facts['message_start_time']
        known.message_start_time = min(known.message_start_time, start) if (
            known.chunk_count) else start
        known.message_end_time = max(known.message_end_time, facts['message_end_time'])
        counts = {channel: len(entries) // 2 for channel, entries in chunk.index.items()}
        known.channel_message_counts.update(counts)
        known.message_count += sum(counts.values())
        known.chunk_count += 1

    def finish(self, name):
        """Write the end of the file: rosbag2's metadata, with the file's name, and summary."""
        self._statistics.schema_count = len(self._schemas)
        self._statistics.channel_count = len(self._channels)
        if self._profile == 'ros2':
            self.add_metadata('rosbag2', {'serialized_metadata': yaml_text(information(
                self._schemas, self._channels, self._statistics, name))})
        self._write(DataEnd(self._crc))
        start, data, offsets = self.size, b'', []
        for opcode, group in (
                (Opcode.SCHEMA, bytes_of(*self._schemas)),
                (Opcode.CHANNEL, bytes_of(*self._channels)),
                (Opcode.STATISTICS, bytes_of(self._statistics)),
                (Opcode.CHUNK_INDEX, self._chunk_indexes.end()),
                (Opcode.ATTACHMENT_INDEX, self._attachment_indexes.end()),
                (Opcode.METADATA_INDEX, self._metadata_indexes.end())):
            offsets.append(SummaryOffset(group_opcode=opcode, group_start=start + len(data),
                                         group_length=len(group)))
            data += group
        offsets_start = start + len(data)
        data += bytes_of(*offsets)
        # The checksum covers the footer up to the checksum itself.
        head = struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offsets_start)
        self._put(data)
        self._write(Footer(summary_start=start, summary_offset_start=offsets_start,
                           summary_crc=zlib.crc32(head, zlib.crc32(data))))
        self._put(MCAP0_MAGIC)

    def _write(self, record):
        return self._put(bytes_of(record))

    def _put(self, data):
        self._crc = zlib.crc32(data, self._crc)
        self.size += len(data)
        return self._stream.write(data)


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    def ignore_aliases(self, data):
        return True


def yaml_text(value):
    """Return a value as YAML without aliases."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False)


_OWN_QOS = re.compile(
    '- history: keep_last\n  depth: ([0-9]{1,5})\n  reliability: ([a-z_]{1,11})\n')


def _qos(depth, reliability):
    return [{**_QOS, 'depth': depth, 'reliability': reliability}]


def channel_metadata(type_hash, depth=DEPTH, reliability='reliable'):
    """Return the metadata of a channel: the QoS of its topic, and the hash of its type."""
    return {'offered_qos_profiles': yaml_text(_qos(depth, reliability)),
            'topic_type_hash': type_hash}


def _qos_of(channel):
    """Return the QoS that `channel_metadata` wrote; any other text may be hostile: no QoS."""
    text = channel.metadata.get('offered_qos_profiles', '')
    found = _OWN_QOS.match(text)
    profiles = _qos(int(found[1]), found[2]) if found else []
    return profiles if yaml_text(profiles) == text else []


def information(schemas, channels, statistics, name):
    """Return rosbag2's metadata (version 9) of a bag with these records and this file name."""
    start, end = statistics.message_start_time, statistics.message_end_time
    span = {'duration': {'nanoseconds': end - start},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': statistics.message_count}
    types = {schema.id: schema.name for schema in schemas}
    topics = [
        {'topic_metadata': {
            'name': channel.topic, 'type': types.get(channel.schema_id, ''),
            'serialization_format': channel.message_encoding,
            'offered_qos_profiles': _qos_of(channel),
            'type_description_hash': channel.metadata.get('topic_type_hash', '')},
         'message_count': statistics.channel_message_counts.get(channel.id, 0)}
        for channel in channels]
    return {
        'version': 9, 'storage_identifier': 'mcap', **span,
        'topics_with_message_count': topics, 'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [printable(name)], 'files': [{'path': printable(name), **span}],
        'custom_data': {}, 'ros_distro': 'jazzy'}
