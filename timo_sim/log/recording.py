# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A log as arrays: what the node published, and the commands that it obeyed."""

from functools import cached_property
import json
import math
from pathlib import Path

import numpy as np

from timo_sim.log.index import Index
from timo_sim.log.notes import read_notes
from timo_sim.log.reader import Message, Reader
from timo_sim.log.records import LogError, open_file
from timo_sim.log.rosbag2 import printable
from timo_sim.log.series import Collector, Series
from timo_sim.messages.cdr import CdrError, TYPES
from timo_sim.messages.commands import COMMANDS
from timo_sim.messages.outputs import outputs
from timo_sim.scene.compatibility import current
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.scene import load_scene

_BLOCK = 1024 * 1024    # [B] of messages at once where there are no chunks
_WRAP = 2**32           # steps after which a sequence number starts again


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
    changes : list of tuple
        Step, place in the file and values by name of each setting of the scene's parameters.
    index : Index

    Raises
    ------
    LogError
        If the file is no log, or damaged, or has no end: the text says what to do.

    """

    def __init__(self, path, node=None):
        self.path = _single(Path(path))
        self.index = Index(self.path)
        self.facts, self.summary, resets, self.changes = read_notes(self.index)
        self.resets, self.reset_places = np.array(resets, dtype=np.int64).reshape(-1, 2).T
        self.name = node or self.facts.get('node') or self._find_node()

    @cached_property
    def parameters(self):
        """What the log says of all parameters of the node, not checked, by present name."""
        parameters = json.loads(self.facts['parameters'])
        if not isinstance(parameters, dict):
            raise ValueError('they are no dictionary')
        return current(parameters)

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
                wanted[number] = Collector(short, channel.topic, known)
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
            See `physics.layout`.

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
            if self.scene is None or self.scene.modal_count:
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
        names = [entry.name for entry in (*COMMANDS, *outputs(1))]
        ends = [name.removeprefix('~') for name in names if name.startswith('~')]
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
            return load_scene(self.parameters)
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
        with open_file(self.path) as stream:
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
        names = [output.name for output in outputs(1)]
        found = self.read(*names)
        # In this order, because what a sensor shows may have been measured a while ago.
        for series in [found[name] for name in names if name in found]:
            if len(series.ns) > 1:
                order = np.argsort(series.log_ns, kind='stable')
                return series.log_ns[order], series.ns[order]
        return None


def _single(path):
    if not path.is_dir():
        return path
    files = sorted(path.glob('*.mcap'))
    if len(files) != 1:
        raise LogError(f'{printable(path)} has {len(files)} files *.mcap: name one')
    return files[0]


def _arrays(data, offsets):
    return (np.frombuffer(bytes(data), np.uint8),
            {channel: np.array(places, np.uint64) for channel, places in offsets.items()})


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
    _, one, other = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
    order = np.argsort(one)
    return one[order], other[order]
