# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Logs as other MCAP tools rewrite them; all are legal MCAP files."""

from dataclasses import replace
import random
import struct

from mcap.records import (
    Attachment, Channel, DataEnd, Footer, Message, Metadata, Schema)
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, MCAP0_MAGIC, Writer

from oracles.hostile_logs import chunk, payload, places, raw, written
import timo_sim
from timo_sim.log.write import NewLog
from timo_sim.runs.replay import Replay, Segment
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs

DATA_END, HEADER = 15, 1


def record(path, resets=()):
    """Log 0.4 s, a command every 50 ms, resets at these steps and a setting 30 ms after each."""
    scene, torque = timo_sim.load_scene({}), [each.name for each in COMMANDS].index(
        '~/motor_torque')
    ends, segments = [*resets, 400], []
    for first, last in zip([0, *resets], ends):
        samples = {output.name: range(first, last + 1, 20 if output.name == '~/modal_state' else 10
                                      ) for output in outputs(scene.modal_count)}
        segments.append(Segment(
            first, last, [(step, torque, COMMANDS[torque].row([], [[0.01 * step]]),
                           payload(0.01 * step)) for step in range(first, last, 50)],
            [(first + 30, {'motor.torque_limit': 1.5})] if first else [],
            {name: _List(steps) for name, steps in samples.items()}, {}))
    log = NewLog(path, scene, {**{name: each.default for name, each in PARAMETERS.items()},
                               **scene.values})
    Replay(scene, segments, log).run()
    log.close()
    return path


class _List(list):
    def tolist(self):
        return list(self)


def records(path):
    """Return the records of the data section, in their order, as mcap reads them."""
    found = []
    with open(path, 'rb') as stream:
        for entry in StreamReader(stream).records:
            if isinstance(entry, DataEnd):
                return found
            if isinstance(entry, (Schema, Channel, Message, Metadata, Attachment)):
                found.append(entry)
    return found


def write(path, entries, profile='ros2', **options):
    """Write records by mcap's writer, by default in chunks of 4 kB."""
    with open(path, 'wb') as stream:
        writer = Writer(stream, **{'chunk_size': 4096, **options})
        writer.start(profile)
        schemas, channels = {0: 0}, {}
        for entry in entries:
            if isinstance(entry, Schema) and entry.id not in schemas:
                schemas[entry.id] = writer.register_schema(entry.name, entry.encoding, entry.data)
            elif isinstance(entry, Channel) and entry.id not in channels:
                channels[entry.id] = writer.register_channel(
                    entry.topic, entry.message_encoding, schemas[entry.schema_id], entry.metadata)
            elif isinstance(entry, Message):
                writer.add_message(channels[entry.channel_id], entry.log_time, entry.data,
                                   entry.publish_time, entry.sequence)
            elif isinstance(entry, Metadata):
                writer.add_metadata(entry.name, entry.metadata)
            elif isinstance(entry, Attachment):
                writer.add_attachment(entry.create_time, entry.log_time, entry.name,
                                      entry.media_type, entry.data)
        writer.finish()


def _split(entries):
    """Return messages, metadata and all else."""
    parts = [], [], []
    for entry in entries:
        parts[0 if isinstance(entry, Message) else 1 if isinstance(entry, Metadata) else 2].append(
            entry)
    return parts


def _ordered(arrange):
    """Return a function that puts messages in another order, after all other records."""
    def change(entries):
        messages, notes, rest = _split(entries)
        return [*rest, *notes, *arrange(messages)]
    return change


def _each(kind, change):
    """Return a function that replaces each record of a kind by the list that `change` gives."""
    return lambda entries: [new for entry in entries for new in (
        change(entry) if isinstance(entry, kind) else [entry])]


def _shuffled(messages):
    return random.Random(5).sample(messages, len(messages))


def _beside(*more):
    """Return a function that adds records before the messages, and a message of each channel."""
    channels = [entry for entry in more if isinstance(entry, Channel)]
    messages = [Message(channel.id, 7000000, b'{"a": 1}', 7000000, 0) for channel in channels]
    return lambda entries: [*more, *entries[:80], *messages, *entries[80:]]


def _topic(end, change):
    """Return a function that changes the messages of topics whose names end with `end`."""
    def changed(entries):
        numbers = {entry.id for entry in entries
                   if isinstance(entry, Channel) and entry.topic.endswith(end)}
        return _each(Message, lambda entry: change(entry) if entry.channel_id in numbers else [
            entry])(entries)
    return changed


JSON = Channel(id=900, topic='/weather', message_encoding='json', metadata={}, schema_id=0)
PROTO = Schema(id=900, name='foxglove.Pose', encoding='protobuf', data=b'\x0a\x03')
OTHER = Channel(id=901, topic='/pose', message_encoding='protobuf', metadata={}, schema_id=900)
NOTE = Attachment(create_time=1, log_time=2, name='note.txt', media_type='text/plain',
                  data=b'by hand')

# Changes of the records, by name, and options of mcap's writer for them.
WRITTEN = {
    'as it is': (list, {}),
    'zstd': (list, {'compression': CompressionType.ZSTD}),
    'not compressed': (list, {'compression': CompressionType.NONE}),
    'a chunk a message': (list, {'chunk_size': 1}),
    'one chunk': (list, {'chunk_size': 1 << 24}),
    'no chunks': (list, {'use_chunking': False}),
    'no indexes': (list, {'index_types': IndexType.NONE}),
    'no index of messages': (list, {'index_types': IndexType.CHUNK | IndexType.METADATA}),
    'no index of metadata': (list, {'index_types': IndexType.CHUNK | IndexType.MESSAGE}),
    'no statistics': (list, {'use_statistics': False}),
    'channels not repeated': (list, {'repeat_channels': False}),
    'schemas not repeated': (list, {'repeat_schemas': False}),
    'no checksums': (list, {'enable_crcs': False}),
    'no profile': (list, {'profile': ''}),
    'reversed': (_ordered(lambda messages: messages[::-1]), {}),
    'reversed, no chunks': (_ordered(lambda messages: messages[::-1]), {'use_chunking': False}),
    'shuffled': (_ordered(_shuffled), {}),
    'shuffled in one chunk': (_ordered(_shuffled), {'chunk_size': 1 << 24}),
    'topic after topic': (_ordered(
        lambda messages: sorted(messages, key=lambda entry: entry.channel_id)), {}),
    'first and second half swapped': (_ordered(
        lambda messages: messages[len(messages) // 2:] + messages[:len(messages) // 2]), {}),
    'metadata last': (lambda entries: [*_split(entries)[2], *_split(entries)[0],
                                       *_split(entries)[1]], {}),
    'metadata reversed': (lambda entries: [*_split(entries)[2], *_split(entries)[1][::-1],
                                           *_split(entries)[0]], {}),
    'metadata emptied': (_each(Metadata, lambda entry: [replace(entry, metadata={})]), {}),
    'scene removed': (_each(Metadata, lambda entry: [replace(entry, metadata={
        'node': '/timo_sim'}) if entry.name == 'timo_sim' else entry]), {}),
    'metadata dropped': (_each(Metadata, lambda entry: []), {}),
    'metadata twice': (_each(Metadata, lambda entry: [entry, entry]), {}),
    'messages twice': (_each(Message, lambda entry: [entry, entry]), {}),
    'merged with itself': (lambda entries: [*entries, *entries], {}),
    'merged with another run': (lambda entries: [*entries, *_each(
        Metadata, lambda entry: [replace(entry, metadata={
            name: value.replace('"carrier.mass": 5', '"carrier.mass": 6')
            for name, value in entry.metadata.items()})])(entries)], {}),
    'every third message dropped': (_ordered(
        lambda messages: [entry for place, entry in enumerate(messages) if place % 3]), {}),
    'commands dropped': (_topic('/motor_torque', lambda entry: []), {}),
    'joint states dropped': (_topic('/joint_states', lambda entry: []), {}),
    'the middle dropped': (_ordered(
        lambda messages: messages[:len(messages) // 3] + messages[len(messages) // 2:]), {}),
    'without schemas': (_each(Channel, lambda entry: [replace(entry, schema_id=0)]), {}),
    'a topic without a schema': (_each(Channel, lambda entry: [replace(entry, schema_id=0)]
                                       if entry.topic.endswith('tip_pose') else [entry]), {}),
    'a topic said to be JSON': (_each(Channel, lambda entry: [replace(
        entry, message_encoding='json')] if entry.topic.endswith('tip_pose') else [entry]), {}),
    'channels of other tools': (_beside(JSON, PROTO, OTHER), {}),
    'channels of other tools, no chunks': (_beside(JSON, PROTO, OTHER), {'use_chunking': False}),
    'attachments': (lambda entries: [NOTE, *entries, NOTE], {}),
    'no sequence numbers': (_each(Message, lambda entry: [replace(entry, sequence=0)]), {}),
    'counted anew': (_each(Message, lambda entry, count=iter(range(1 << 30)): [
        replace(entry, sequence=next(count))]), {}),
    'wall clock': (_each(Message, lambda entry: [replace(
        entry, log_time=entry.log_time + 1700000000123456789)]), {}),
    'wall clock, no sequence numbers': (_each(Message, lambda entry: [replace(
        entry, log_time=entry.log_time + 1700000000123456789, sequence=0)]), {}),
}


def _no_summary(data, *more):
    """Return a log without its summary, with more records at the end of its data."""
    end = next(place for place, opcode, _ in places(data) if opcode == DATA_END)
    return data[:end] + b''.join(more) + written(DataEnd(0), Footer(0, 0, 0)) + MCAP0_MAGIC


def _unchunked(change):
    """Return a function that changes the records of a log without chunks and summary."""
    def changed(data):
        content = _no_summary(data)
        return content[:8] + b''.join(change(content[place:place + length], opcode) for (
            place, opcode, length) in places(content)) + MCAP0_MAGIC
    return changed


def _in_one_chunk(data):
    """Return a log whose schemas, channels, messages and a record of its own are in one chunk."""
    content = _no_summary(data)
    parts = [(opcode, content[place:place + length]) for place, opcode, length in places(content)]
    packed = chunk(b''.join(part for opcode, part in parts if opcode in (3, 4, 5))
                   + raw(0x90, b'private data'), 'zstd')
    return content[:8] + b''.join(part for opcode, part in parts if opcode in (HEADER, 12)) + (
        written(packed, DataEnd(0), Footer(0, 0, 0))) + MCAP0_MAGIC


# Changes of the bytes of a log without chunks, by name.
BYTES = {
    'no summary': _no_summary,
    'records of its own': lambda data: _no_summary(data, raw(0x90, b'private data')),
    'records of its own in a chunk': _in_one_chunk,
    'other numbers': _unchunked(lambda part, opcode: part if opcode not in (4, 5) else part[:9] + (
        struct.pack('<H', 65535 - struct.unpack_from('<H', part, 9)[0])) + part[11:]),
}


def rewritings(source, folder, pairs=0, generator=random):
    """Yield names and files of a log that is rewritten in all ways, and in some pairs of ways."""
    entries, path = records(source), folder / 'rewritten.mcap'
    for name, (change, options) in WRITTEN.items():
        write(path, change(entries), **options)
        yield name, path
    for _ in range(pairs):
        names = generator.sample(list(WRITTEN), 2)
        (first, options), (second, more) = map(WRITTEN.get, names)
        write(path, second(first(entries)), **{**options, **more})
        yield ', '.join(names), path
    for name, change in BYTES.items():
        write(path, entries, use_chunking=False)
        path.write_bytes(change(path.read_bytes()))
        yield name, path
