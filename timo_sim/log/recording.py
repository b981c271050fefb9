"""A log as arrays: what the node published, and the commands that it obeyed."""

from dataclasses import dataclass
from functools import cached_property
import json
import math
from pathlib import Path

import numpy as np

from timo_sim.commands import COMMANDS, Refused
from timo_sim.log.cdr import CdrError, layout, TYPES
from timo_sim.log.index import Index
from timo_sim.log.notes import read_notes
from timo_sim.log.reader import LogError, Message, open_log, Reader
from timo_sim.log.rosbag2 import shown
from timo_sim.outputs import NANOSECONDS, outputs
from timo_sim.parameters import ParameterError
from timo_sim.scene import load_scene

_HEAD = 31              # [B] of a message before its content: opcode, length and so on
_HEAD_TYPE = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'),
                       ('sequence', '<u4'), ('log_time', '<u8'), ('publish_time', '<u8')])
_MOST_LAYOUTS = 100     # of a topic; frames of commands have different lengths
_LARGEST = 65536        # [B] of a message; those of 40 modes have 2000
_BLOCK = 1024 * 1024    # [B] of messages at once where there are no chunks
_COMMANDS = {command.name: command for command in COMMANDS}
_WRAP = 2**32           # steps after which a sequence number starts again


@dataclass(frozen=True)
class Series:
    """
    The messages of a topic.

    Attributes
    ----------
    topic, type_name : str
    columns : tuple of str
        Names of k quantities, with units.
    step : ndarray of int64, shape (n,)
        Time steps; of a plain bag, which has none, -1.
    ns : ndarray of int64, shape (n,)
        Sim time. Of a plain bag that of the header; commands, whose headers mean nothing, have
        the sim time that went with their log time, or log time where nothing says that.
    log_ns : ndarray of int64, shape (n,)
        When a message was logged.
    values : ndarray, shape (n, k)
    refused : int
        Commands that are left out, because the node refuses them.
    place : ndarray of int64, shape (n,)
        In the file: what orders messages and resets of the same step.
    data : list of bytes
        The messages of a command, CDR; of other topics empty.

    """

    topic: str
    type_name: str
    columns: tuple
    step: np.ndarray
    ns: np.ndarray
    log_ns: np.ndarray
    values: np.ndarray
    refused: int
    place: np.ndarray
    data: list


class Recording:
    """
    A log of this package, or a bag with the topics of a node.

    Series are read when they are asked for, chunk by chunk. What the file says is checked as in
    `reader`: it may come from anybody.

    Parameters
    ----------
    path : str or Path
        A file, or a bag's folder with one.
    node : str, optional
        Fully qualified name of the node, needed for a bag of several.

    Attributes
    ----------
    path : Path
    name : str
        The node's fully qualified name, such as '/timo_sim'.
    scene : Scene or None
        None for a plain bag.
    facts : dict
        What the node noted at its start: 'parameters', 'timo_sim', 'numpy', ...; of a plain bag
        empty.
    summary : dict
        What it noted at its end; empty if it did not.
    resets : ndarray of int
        Steps at which the motion was reset.
    index : Index

    Raises
    ------
    LogError
        If the file is no log, or damaged, or has no end: the text says what to do.

    """

    def __init__(self, path, node=None):
        self.path = _single(Path(path))
        self.index = Index(self.path)
        self.facts, self.summary, resets = read_notes(self.index)
        self.resets, self.reset_places = np.array(resets, dtype=np.int64).reshape(-1, 2).T
        self.name = node or self.facts.get('node') or self._find_node()

    @cached_property
    def scene(self):
        """The scene of a log of this package, else None."""
        return self._scene() if self.facts else None

    @cached_property
    def topics(self):
        """All series by short name: 'joint_states', '~/tip_pose', ..., '~/motor_torque'."""
        return self.read()

    def read(self, *names, most_chunks=None):
        """
        Read some series, in one pass.

        Parameters
        ----------
        *names : str
            Short names; none: all. What the file does not have is left out.
        most_chunks : int, optional
            Read of so many chunks only, spread over the file.

        Returns
        -------
        dict of Series

        """
        wanted = {}
        for number, channel in self.index.channels.items():
            short, known = self.short_name(channel.topic), self._type_of(channel)
            if known in TYPES and self._expects(short) == known and (not names or short in names):
                if any(other.name == short for other in wanted.values()):
                    raise LogError(f'{self.index.name} has two channels of {channel.topic[:80]}')
                wanted[number] = _Collector(short, channel.topic, known)
        for place, data, offsets in self._blocks(most_chunks):
            for number in wanted.keys() & offsets.keys():
                try:
                    wanted[number].add(place, data, offsets[number], number)
                except CdrError as error:
                    raise LogError(f'{self.index.name}: a message on {wanted[number].topic[:80]} '
                                   f'is not a {wanted[number].type_name}: {error}') from None
        return {collector.name: self._series(collector) for collector in wanted.values()}

    def motion(self, series=None):
        """
        Return the samples of joint states for which there are modal states.

        Parameters
        ----------
        series : dict of Series, optional
            What `read` gave for 'joint_states' and '~/modal_state', where that is done already.

        Returns
        -------
        step, ns : ndarray of int64, shape (n,)
            Where a reset was, a step may be there twice: before and after it.
        motion : ndarray, shape (n, 2 (3 + N))
            See `physics.formulation`.

        Raises
        ------
        LogError
            If the log has none.

        """
        found = self.read('joint_states', '~/modal_state') if series is None else series
        if 'joint_states' not in found:
            raise LogError(f'{self.index.name} has no joint_states of {self.name}')
        joints, modes = found['joint_states'], found.get('~/modal_state')
        if modes is None:
            if self.scene is None or self.scene.values['model.modes']:
                raise LogError(f'{self.index.name} has no modal_state of {self.name}')
            return joints.step, joints.ns, joints.values[:, :6]
        first, second = common(joints.ns, modes.ns)
        q, rates = np.hsplit(modes.values[second], 2)
        position, velocity = joints.values[first, :3], joints.values[first, 3:6]
        return (joints.step[first], joints.ns[first],
                np.hstack([position, q, velocity, rates]))

    def short_name(self, topic):
        """Return a topic's name relative to the node: '~/tip_pose', 'joint_states', '/clock'."""
        namespace = self.name.rpartition('/')[0] + '/'
        if topic.startswith(self.name + '/'):
            return '~/' + topic.removeprefix(self.name + '/')
        if topic == namespace + 'joint_states':
            return 'joint_states'
        return topic

    # What the file is.

    def _find_node(self):
        ends = [name.removeprefix('~') for name in
                [*_COMMANDS, '~/modal_state', '~/tip_deflection', '~/tip_pose', '~/carrier_pose']]
        topics = [channel.topic for channel in self.index.channels.values()]
        nodes = {topic.removesuffix(end) for topic in topics for end in ends
                 if topic.endswith(end)}
        if not nodes:
            raise LogError(f'{self.index.name} has no topic of a node timo_sim')
        if len(nodes) > 1:
            raise LogError(f'{self.index.name} has topics of several nodes, say which: '
                           f'{", ".join(sorted(nodes))[:200]}')
        return nodes.pop()

    def _scene(self):
        try:
            parameters = json.loads(self.facts['parameters'])
            if not isinstance(parameters, dict):
                raise ValueError('they are no dictionary')
            return load_scene(parameters)
        except (KeyError, ValueError, RecursionError, ParameterError) as error:
            reason = ' '.join(str(error).split())[:300]
            raise LogError(f'{self.index.name}: its scene cannot be built: {reason}') from None

    def _type_of(self, channel):
        schema = self.index.schemas.get(channel.schema_id)
        return schema.name if schema and channel.message_encoding == 'cdr' else None

    @staticmethod
    def _expects(short):
        types = {output.name: output.type_name for output in outputs(1)}
        types.update({command.name: command.type_name for command in COMMANDS})
        return types.get(short)

    # Its messages.

    def _blocks(self, most):
        """Yield place, data and offsets by channel, in the order of the file."""
        counts = sum(sum(chunk.counts().values()) for chunk in self.index.chunks)
        if counts == self.index.statistics.message_count:
            chunks = self.index.chunks
            for chunk in chunks[::math.ceil(len(chunks) / (most or math.inf)) or 1]:
                yield chunk.place, *self.index.read(chunk)
        else:  # a file without chunks, or without their indexes, has all the same what it has
            yield from self._blocks_without_index()

    def _blocks_without_index(self):
        with open_log(self.path) as stream:
            reader = Reader(stream, self.index.size, self.index.name)
            data, offsets, place = bytearray(), {}, 0
            for record in reader.records():
                if not isinstance(record, Message):
                    continue
                offsets.setdefault(record.channel, []).append(len(data))
                data += b'\x05' + len(record.content).to_bytes(8, 'little') + record.content
                if len(data) > _BLOCK:
                    yield place, *_arrays(data, offsets)
                    data, offsets, place = bytearray(), {}, place + 1
            if reader.damage is not None:
                raise LogError(f'{self.index.name}: {reader.damage}: timo_sim recover '
                               f'{self.index.name} keeps what is intact')
            yield place, *_arrays(data, offsets)

    def _series(self, collector):
        sequence, log_ns, place, stamps, values = collector.arrays()
        ns = log_ns if stamps is None else stamps
        if self.facts:
            turns = np.rint((1e-9 * log_ns / self.scene.step - sequence) / _WRAP)
            step = sequence + _WRAP * turns.astype(np.int64)
        else:
            step = np.full(len(log_ns), -1)
            if stamps is None:
                ns = self._sim_time(log_ns)
            # The network may have changed the order.
            order = np.argsort(ns, kind='stable')
            ns, log_ns, values, place = ns[order], log_ns[order], values[order], place[order]
            if collector.data:
                collector.data = [collector.data[at] for at in order]
        return Series(collector.topic, collector.type_name, collector.columns, step, ns, log_ns,
                      values, collector.refused, place, collector.data)

    def _sim_time(self, log_ns):
        if self._clock is None or not len(log_ns):
            return log_ns
        logged, sim = self._clock
        # Between two messages, and at the pace of their mean beyond them.
        pace = (sim[-1] - sim[0]) / max(1, logged[-1] - logged[0])
        inside = np.interp(log_ns - logged[0], logged - logged[0], (sim - sim[0]).astype(float))
        beyond = (log_ns - np.clip(log_ns, logged[0], logged[-1])) * pace
        return sim[0] + np.rint(inside + beyond).astype(np.int64)

    @cached_property
    def _clock(self):
        """Log times and sim times of a bag's messages with sim time, if there are any."""
        for series in self.read(*(output.name for output in outputs(1))).values():
            if len(series.ns) > 1:
                order = np.argsort(series.log_ns, kind='stable')
                return series.log_ns[order], series.ns[order]
        return None


class _Collector:
    """Gathers the messages of a topic."""

    def __init__(self, name, topic, type_name):
        self.name, self.topic, self.type_name = name, topic, type_name
        self.columns = ()
        self.refused, self.data = 0, []
        self._command = _COMMANDS.get(name)
        if self._command:
            self.columns = self._command.names
        self._layouts = []
        self._parts = []

    def add(self, place, data, offsets, channel):
        """Add the messages of a block, of which these are the offsets."""
        heads = _gather(data, offsets, _HEAD_TYPE)
        sizes = heads['length'] - (_HEAD - 9)
        if not len(offsets):
            return
        order = np.sort(offsets)
        # Nothing outside, and nothing twice: an index may be a lie.
        if not (np.all(heads['opcode'] == 5) and np.all(heads['channel'] == channel)
                and np.all(sizes <= len(data)) and np.all(offsets + _HEAD + sizes <= len(data))
                and np.all(np.diff(order) >= _HEAD)
                and sizes.sum() + _HEAD * len(sizes) <= len(data)):
            raise CdrError('the index names something else')
        if sizes.max() > _LARGEST or sizes.min() < 4:
            raise CdrError(f'it has {sizes.max() if sizes.max() > _LARGEST else sizes.min()} '
                           'bytes')
        found = []
        for size in np.unique(sizes):
            same = np.flatnonzero(sizes == size)
            rows = _gather(data, offsets[same] + np.uint64(_HEAD), np.dtype(f'V{size}')).view(
                np.uint8).reshape(len(same), -1)
            found += self._decode(same, rows)
        which, stamps, values, messages = found[0] if len(found) == 1 else _merged(found)
        self.data += messages
        self._parts.append((heads['sequence'][which].astype(np.int64),
                            heads['log_time'][which].astype(np.int64),
                            np.full(len(which), place), stamps, values))

    def _decode(self, which, rows):
        """Yield index, stamps and values of messages of one size, layout by layout."""
        while len(rows):
            found = self._layout(bytes(rows[0]))
            same = np.all(rows[:, found.fixed] == rows[0, found.fixed], axis=1)
            yield self._numbers(found, which[same], rows[same])
            which, rows = which[~same], rows[~same]

    def _layout(self, data):
        for known, size, text in self._layouts:
            if len(data) == size and bytes(data[place] for place in known.fixed) == text:
                return known
        found = layout(self.type_name, data)
        self._layouts.append((found, len(data), bytes(data[place] for place in found.fixed)))
        if len(self._layouts) > (_MOST_LAYOUTS if self._command else 1):
            raise CdrError('its texts or lists are not those of the messages before it')
        if not self._command:
            self._name_columns(found)
        return found

    def _name_columns(self, found):
        texts = found.texts[1:]  # after the frame
        by_name = {output.name: output for output in outputs(max(1, len(texts)))}
        output = by_name[self.name]
        self.columns, self._places = output.columns, output.places
        expected = {'joint_states': ['carrier_x', 'carrier_y', 'shaft'],
                    '~/modal_state': [f'mode_{n + 1}' for n in range(len(texts))]}
        if texts != expected.get(self.name, texts) or len(found.doubles) <= max(
                self._places, default=-1):
            raise CdrError(f'{", ".join(texts)[:80]} are not the joints of this node')

    def _numbers(self, found, which, rows):
        if self._command:
            values = _doubles(rows, found.doubles)
            kept, loads, frame = [], [], found.texts[0] if found.texts else ''
            for number, row in enumerate(values.tolist()):
                try:
                    loads.append(self._command.load(frame, row))
                    kept.append(number)
                except Refused:
                    self.refused += 1
            shape = len(kept), len(self.columns)
            return which[kept], None, np.array(loads, dtype=float).reshape(shape), [
                row.tobytes() for row in rows[kept]]
        values = _doubles(rows, [found.doubles[place] for place in self._places])
        stamp = np.ascontiguousarray(rows[:, found.stamp:found.stamp + 8]).view('<i4')
        return which, stamp[:, 0] * np.int64(NANOSECONDS) + stamp[:, 1], values, []

    def arrays(self):
        """Return sequence numbers, log times, places, stamps (None for commands) and values."""
        if not self._parts:
            none = np.zeros(0, dtype=np.int64)
            return (none, none, none, None if self._command else none,
                    np.zeros((0, len(self.columns))))
        return [None if parts[0] is None else np.concatenate(parts)
                for parts in zip(*self._parts)]


def _merged(found):
    """Return messages of several layouts in the order of the file."""
    order = np.argsort(np.concatenate([part[0] for part in found]))
    messages = [message for part in found for message in part[3]]
    return *(None if found[0][place] is None else
             np.concatenate([part[place] for part in found])[order] for place in range(3)), (
                 [messages[place] for place in order] if messages else [])


def _single(path):
    if not path.is_dir():
        return path
    files = sorted(path.glob('*.mcap'))
    if len(files) != 1:
        raise LogError(f'{shown(path)} has {len(files)} files *.mcap: name one')
    return files[0]


def _arrays(data, offsets):
    return (np.frombuffer(bytes(data), np.uint8),
            {channel: np.array(places, np.uint64) for channel, places in offsets.items()})


def _gather(data, offsets, kind):
    """Return what is at these offsets, one element of `kind` each."""
    if not len(offsets):
        return np.zeros(0, kind)
    last = len(data) - kind.itemsize
    if last < 0 or int(offsets.max()) > last:
        raise CdrError('the index names something outside of its chunk')
    if not kind.itemsize:
        return np.zeros(len(offsets), kind)
    return np.ndarray((last + 1,), kind, data, strides=(1,))[offsets]


def _doubles(rows, places):
    columns = [place + byte for place in places for byte in range(8)]
    return np.ascontiguousarray(rows[:, columns]).view('<f8').reshape(len(rows), len(places))


def common(first, second):
    """
    Return where two ascending lists have the same values, pairwise.

    Of a value that is in a list several times, as a step with a reset, the last ones are paired.
    """
    if np.array_equal(first, second):
        return slice(None), slice(None)
    keys = []
    for values in (first, second):
        _, place, count = np.unique(values, return_index=True, return_counts=True)
        left = np.repeat(place + count, count) - np.arange(len(values))  # 1 for the last
        keys.append(np.rec.fromarrays([values, left]))
    _, one, other = np.intersect1d(*keys, assume_unique=True, return_indices=True)
    order = np.argsort(one)
    return one[order], other[order]
