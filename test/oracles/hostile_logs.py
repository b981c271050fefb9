# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Damaged and forged logs, as a crash, a bad disk or an attacker would leave them."""

import struct
import zlib

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, DataEnd, Footer, Header, Message, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
import zstandard

from timo_sim.log.write import Channel, Recorder

CHANNELS = [Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64'),
            Channel('/rare', 'std_msgs/msg/Float64'),
            Channel('/joint_states', 'sensor_msgs/msg/JointState')]
STEP = 1000000  # [ns]
GIGABYTE = 1 << 30


def payload(value):
    """Return a std_msgs/Float64 as it is on the wire."""
    return b'\0\1\0\0' + struct.pack('<d', value)


def record(path, steps=120, chunk=20):
    """Record a log with a reset after each chunk; return its contents."""
    recorder = Recorder(path, CHANNELS, {'timo_sim': {'parameters': '{}'}})
    for step in range(steps):
        if step and step % chunk == 0:
            recorder.note('timo_sim.reset', {'step': str(step)})
        recorder.write(0, step, step * STEP, payload(step))
        if step % 10 == 0:
            recorder.write(1, step, step * STEP, payload(-step))
    recorder.close()
    if recorder.error:
        raise RuntimeError(recorder.error)
    return recorder.path.read_bytes()


def places(content):
    """Return place, opcode and length of each record of an intact log."""
    found, place = [], len(MCAP0_MAGIC)
    while place < len(content) - len(MCAP0_MAGIC):
        opcode, length = struct.unpack_from('<BQ', content, place)
        found.append((place, opcode, 9 + length))
        place += 9 + length
    return found


def raw(opcode, content, length=None):
    """Return a record, by default with its true length."""
    return struct.pack('<BQ', opcode, len(content) if length is None else length) + content


def written(*records):
    """Return records as mcap writes them; bytes are taken as they are."""
    parts = []
    for entry in records:
        builder = RecordBuilder()
        if isinstance(entry, bytes):
            builder.write(entry)
        else:
            entry.write(builder)
        parts.append(builder.end())
    return b''.join(parts)


def message(channel=1, time=STEP, value=1.0):
    """Return a message record."""
    return Message(channel_id=channel, log_time=time, publish_time=time, sequence=1,
                   data=payload(value))


def chunk(data, compression='', size=None, crc=None, stored=None):
    """Return a chunk record; `size`, `crc` and `stored` may contradict its data."""
    compress = {'lz4': lz4.frame.compress, 'zstd': zstandard.compress}.get(compression, bytes)
    return Chunk(data=compress(data) if stored is None else stored, compression=compression,
                 message_start_time=STEP, message_end_time=STEP,
                 uncompressed_crc=zlib.crc32(data) if crc is None else crc,
                 uncompressed_size=len(data) if size is None else size)


def _bomb(compression, size):
    """Return compressed zeros, made without holding them all in memory."""
    block = bytes(1 << 20)
    if compression == 'zstd':
        compressor = zstandard.ZstdCompressor().compressobj()
        parts = [compressor.compress(block) for _ in range(size >> 20)]
        return b''.join([*parts, compressor.flush()])
    with lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB) as compressor:
        parts = [compressor.begin()]
        parts += [compressor.compress(block) for _ in range(size >> 20)]
        return b''.join([*parts, compressor.flush()])


def hostile(large=False):
    """
    Return forged files by name.

    Parameters
    ----------
    large : bool
        Whether to add files that take long to make and to read.

    Returns
    -------
    dict of bytes

    """
    head = MCAP0_MAGIC + written(Header(profile='ros2', library=''))
    schema = Schema(id=1, name='std_msgs/msg/Float64', encoding='ros2msg', data=b'float64 data')
    channel = ChannelRecord(id=1, schema_id=1, topic='/a', message_encoding='cdr', metadata={})
    start = head + written(schema, channel, chunk(written(message()), 'lz4'))
    one = written(message())
    end = written(DataEnd(0), Footer(0, 0, 0)) + MCAP0_MAGIC
    size = GIGABYTE if large else GIGABYTE // 8
    files = {
        'empty': b'', 'half a magic': MCAP0_MAGIC[:4], 'text': b'a text\n' * 100,
        'magic only': MCAP0_MAGIC, 'magic and zeros': MCAP0_MAGIC + bytes(5000),
        'header only': head, 'no summary': start + end,
        'a length of 2^64 - 1': start + raw(6, b'x', 2**64 - 1),
        'a length of 10 GB': start + raw(6, b'x', 10 * GIGABYTE),
        'a length of 10 GB in a chunk': start + written(chunk(raw(5, one[9:], 10 * GIGABYTE))),
        'a chunk that claims 10 GB': start + written(chunk(one, 'lz4', size=10 * GIGABYTE)),
        'a chunk that claims 2^64 - 1': start + written(chunk(one, 'lz4', size=2**64 - 1)),
        'a chunk that claims less': start + written(chunk(one, 'lz4', size=3)),
        'a chunk that claims nothing': start + written(chunk(one, 'lz4', size=0, crc=0)),
        'a chunk that claims more': start + written(chunk(one, size=1000, crc=0)),
        'a chunk of garbage': start + written(chunk(one, 'lz4', stored=bytes(1000), crc=0)),
        'zstd of garbage': start + written(chunk(one, 'zstd', stored=bytes(1000), crc=0)),
        'a zstd chunk': start + written(chunk(one, 'zstd')),
        'zstd with a window of 2 GB': start + written(chunk(
            one, 'zstd', stored=b'\x28\xb5\x2f\xfd\0\xa8' + bytes(100), crc=0)),
        'an unknown compression': start + written(chunk(one, 'bzip2', stored=one)),
        'a wrong checksum': start + written(chunk(one, crc=1)),
        'a chunk within a chunk': start + written(chunk(written(chunk(one)))),
        'a chunk that ends early': start + written(chunk(one[:-3])),
        'an unknown channel': start + written(message(channel=9)),
        'a short message': start + raw(5, b'short'),
        'an unknown schema': start + written(
            ChannelRecord(id=2, schema_id=7, topic='/b', message_encoding='cdr', metadata={})),
        'a schema of another type': start + written(
            Schema(id=2, name='std_msgs/msg/Float64', encoding='ros2msg', data=b'string data'),
            ChannelRecord(id=2, schema_id=2, topic='/b', message_encoding='cdr', metadata={}),
            message(channel=2)),
        'a schema number for two': start + written(
            Schema(id=1, name='a/msg/B', encoding='ros2msg', data=b'')),
        'a channel number for two': start + written(
            ChannelRecord(id=1, schema_id=1, topic='/b', message_encoding='cdr', metadata={})),
        'a string of 4 GB': start + raw(4, struct.pack('<HHI', 2, 1, 2**32 - 1) + b'x'),
        'a map of 4 GB': start + raw(12, struct.pack('<I1sI', 1, b'a', 2**32 - 1)),
        'no UTF-8': start + raw(12, struct.pack('<I2sI', 2, b'\xff\xfe', 0)),
        'an unknown record': start + raw(0x42, b'what?') + raw(0, b''),
        'two ends': start + end + end,
        'statistics that lie': start + written(DataEnd(0), Statistics(
            0, 1, {1: 99}, 1, 99, 0, 0, 0, 1), Footer(len(start) + 13, 0, 0)) + MCAP0_MAGIC,
        'a code to run': start + written(Metadata(
            'timo_sim', {'parameters': '!!python/object/apply:os.system ["touch hacked"]'})),
        'QoS that explodes': start + written(ChannelRecord(
            id=2, schema_id=1, topic='/b', message_encoding='cdr', metadata={
                'offered_qos_profiles': 'a: &a [1]\n' + ''.join(
                    f'{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n'
                    for a, b in zip('abcdefghijk', 'bcdefghijkl'))})),
        'every channel there can be': start + b''.join(written(ChannelRecord(
            id=number, schema_id=1, topic=f'/{number}', message_encoding='cdr', metadata={}))
            for number in range(2, 65536 if large else 3000)),
        'a name that is a path': start + written(ChannelRecord(
            id=2, schema_id=1, topic='/../../etc/passwd\0', message_encoding='', metadata={}))}
    for compression in ('lz4', 'zstd'):
        bomb = _bomb(compression, size)
        files[f'a {compression} bomb'] = start + written(
            chunk(b'', compression, stored=bomb, size=size, crc=0))
        files[f'a {compression} bomb that claims 60 MB'] = start + written(
            chunk(b'', compression, stored=bomb, size=60 << 20, crc=0))
    # Of 590 kB; each chunk unpacks to 60 MB of records without content.
    for name, kind in (('nothing', 0), ('private records', 0x90)):
        most = written(chunk(raw(kind, b'') * ((60 << 20) // 9), 'zstd'))
        files[f'chunks full of {name}'] = start + most * (590000 // len(most))
    if large:
        note = written(Metadata('timo_sim.reset', {'step': '1'}))
        files['endless metadata'] = start + note * 700000
        files['a record of 100 MB'] = start + raw(12, bytes(100 << 20))
        files['metadata of 60 MB'] = start + 4 * written(Metadata('a', {'b': 'c' * (60 << 20)}))
        files['messages of 22 bytes'] = start + written(
            chunk(raw(5, struct.pack('<HIQQ', 1, 0, 0, 0)) * (10000000 // 31), 'lz4'))
    return files
