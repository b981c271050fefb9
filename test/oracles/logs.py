# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Small logs, and what other readers find in a log: mcap, mcap_ros2 and rosbags."""

from collections import Counter
import struct

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from timo_sim.log.info import info
from timo_sim.log.read import LogError, recover
from timo_sim.log.tables import Recording
from timo_sim.log.write import Channel, Recorder

CHANNELS = [Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64'),
            Channel('/rare', 'std_msgs/msg/Float64'),
            Channel('/joint_states', 'sensor_msgs/msg/JointState')]
MAGIC_SIZE = 8  # [B] at the beginning and at the end of a log


def payload(value):
    """Return a std_msgs/Float64 as it is on the wire."""
    return b'\0\1\0\0' + struct.pack('<d', value)


def record(path, steps=120, chunk=20):
    """Record a log with a reset after each chunk; return its contents."""
    recorder = Recorder(path, CHANNELS, {'timo_sim': {'parameters': '{}'}})
    for step in range(steps):
        if step and step % chunk == 0:
            recorder.note('timo_sim.reset', {'step': str(step)})
        recorder.write(0, step, 1000000 * step, payload(step))
        if step % 10 == 0:
            recorder.write(1, step, 1000000 * step, payload(-step))
    recorder.close()
    if recorder.error:
        raise RuntimeError(recorder.error)
    return recorder.path.read_bytes()


def places(content):
    """Return place, opcode and length of each record of an intact log."""
    found, place = [], MAGIC_SIZE
    while place < len(content) - MAGIC_SIZE:
        opcode, length = struct.unpack_from('<BQ', content, place)
        found.append((place, opcode, 9 + length))
        place += 9 + length
    return found


def outcome(path):
    """
    Read a log and recover it; check the result.

    Returns
    -------
    str
        'complete', 'refused' or 'recovered'; any other result is an exception.

    """
    new = path.with_name('out.mcap')
    for read in info, lambda file: Recording(file).topics:
        try:
            read(path)
        except LogError as error:
            if '\n' in str(error):
                raise RuntimeError(f'a refusal is one line: {error}') from None
    try:
        text = recover(path, new)
    except LogError as error:
        if new.exists() or '\n' in str(error) or path.name not in str(error):
            raise RuntimeError(f'a refusal is one line and writes nothing: {error}') from None
        return 'refused'
    if not new.exists():
        return 'complete'
    try:
        said = f'{contents(new).total()} messages'
        if said not in text or f'is complete: {said}' not in recover(new):
            raise RuntimeError(f'{said} are there: {text}')
    finally:
        new.unlink()
    return 'recovered'


def contents(path):
    """Return messages by topic, as mcap's own reader finds them."""
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        times = [(channel.topic, message.log_time)
                 for _, channel, message in reader.iter_messages()]
    found = Counter(topic for topic, _ in times)
    latest = max((time for _, time in times), default=0)
    if (found.total(), latest) != (summary.statistics.message_count,
                                   summary.statistics.message_end_time):
        raise RuntimeError(f'{path} has {found}, its summary says {summary.statistics}')
    return found


def decoded(path):
    """Return a log's messages by topic, as mcap_ros2 and rosbags decode them, if they agree."""
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        first = Counter(channel.topic for _, channel, _, _ in reader.iter_decoded_messages())
    second = Counter()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            second[connection.topic] += 1
    if first != second:
        raise RuntimeError(f'{path}: mcap_ros2 finds {first}, rosbags {second}')
    return first
