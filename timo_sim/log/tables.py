# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Read a log as arrays: what the node published, and the commands that it obeyed."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
import json
import math
from pathlib import Path

import numpy as np

from timo_sim.log.read import Index, Reader
from timo_sim.log.records import files_of, LogError, open_file, printable, read_names, read_notes
from timo_sim.log.write import Chunk
from timo_sim.scene.parameters import current, frame_names, ParameterError, SPLIT
from timo_sim.scene.scene import load_scene
from timo_sim.topics.cdr import CdrError, layout
from timo_sim.topics.commands import COMMANDS, LARGEST, Refused
from timo_sim.topics.outputs import NANOSECONDS, outputs

_HEAD = 31              # [B] of a message's record before its content, see `_HEAD_TYPE`
_HEAD_TYPE = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'),
                       ('sequence', '<u4'), ('log_time', '<u8'), ('publish_time', '<u8')])
_MOST_LAYOUTS = 100     # of a topic; names of frames in commands have different lengths
_COMMANDS = {command.name: command for command in COMMANDS}


@dataclass(frozen=True)
class Series:
    """
    The messages of a topic.

    Attributes
    ----------
    topic : str
    columns : tuple of str
        Names of k quantities, with units.
    step : ndarray of int64, shape (n,)
        Time steps; -1 in a plain bag, which has none.
    ns : ndarray of int64, shape (n,)
        Sim time [ns]. In a plain bag it is the stamp of the header. Stamps of commands mean
        nothing there: it is the sim time at their log time or, if that is not known, log time.
    log_ns : ndarray of int64, shape (n,)
        Time at which a message was logged [ns].
    values : ndarray, shape (n, k)
        NaN for what a command does not set.
    refused : int
        Commands that are left out, because the node refuses them.
    resets : ndarray of int64, shape (n,)
        How many resets were before a message; -1 if that is not known.
    data : list of bytes
        The messages of a command, CDR; empty for other topics.

    """

    topic: str
    columns: tuple
    step: np.ndarray
    ns: np.ndarray
    log_ns: np.ndarray
    values: np.ndarray
    refused: int
    resets: np.ndarray
    data: list


class Collector:
    """Gathers the messages of a topic; `frames` are the names of frames in commands."""

    def __init__(self, name, topic, type_name, frames):
        self.name, self.topic, self.type_name = name, topic, type_name
        self._frames = frames
        self.command = _COMMANDS.get(name)
        self.columns = self.command.names if self.command else ()
        self.refused = 0
        self._layouts, self._parts = [], []

    def add(self, place, data, offsets, channel):
        """Add the messages at these offsets in a block of data."""
        if not len(offsets):
            return
        heads = _gather(data, offsets, _HEAD_TYPE)
        sizes = heads['length'] - (_HEAD - 9)
        # A forged index might point outside, or to the same place twice.
        if not (np.all(heads['opcode'] == 5) and np.all(heads['channel'] == channel)
                and np.all(sizes <= len(data)) and np.all(offsets + _HEAD + sizes <= len(data))
                and np.all(np.diff(np.sort(offsets)) >= _HEAD)
                and sizes.sum() + _HEAD * len(sizes) <= len(data)):
            raise CdrError('the index points to something else')
        for size in np.unique(sizes):
            if not 4 <= size <= LARGEST:
                raise CdrError(f'it has {size} bytes')
            same = np.flatnonzero(sizes == size)
            rows = _gather(data, offsets[same] + np.uint64(_HEAD), np.dtype(f'V{size}')).view(
                np.uint8).reshape(len(same), -1)
            while len(rows):
                found = self._layout(bytes(rows[0]))
                alike = np.all(rows[:, found.fixed] == rows[0, found.fixed], axis=1)
                self._keep(place, offsets[same[alike]], heads[same[alike]], found, rows[alike])
                same, rows = same[~alike], rows[~alike]

    def _layout(self, data):
        for known, size, text in self._layouts:
            if len(data) == size and bytes(data[place] for place in known.fixed) == text:
                return known
        found = layout(self.type_name, data)
        self._layouts.append((found, len(data), bytes(data[place] for place in found.fixed)))
        if len(self._layouts) > (_MOST_LAYOUTS if self.command else 1):
            raise CdrError('its texts or lists are not those of the messages before it')
        if not self.command:
            self._name_columns(found)
        return found

    def _name_columns(self, found):
        texts = found.texts[1:]  # after the frame
        by_name = {output.name: output for output in outputs(max(1, len(texts)))}
        output = by_name[self.name]
        self.columns, self._places = output.columns, output.places
        if texts != output.texts[1:] or len(found.doubles) <= max(self._places, default=-1):
            raise CdrError(f'{", ".join(texts)[:80]} are not the joints of this node')

    def _keep(self, place, offsets, heads, found, rows):
        """Keep messages of one layout, for `arrays`."""
        log_ns, messages = heads['log_time'].astype(np.int64), np.empty(len(rows), object)
        if self.command:
            kept, loads = [], []
            for number, row in enumerate(_doubles(rows, found.doubles).tolist()):
                try:
                    loads.append(self.command.row(
                        found.texts, found.split(row), self._frames))
                    kept.append(number)
                    messages[number] = rows[number].tobytes()
                except Refused:
                    self.refused += 1
            offsets, heads, log_ns, messages = (
                array[kept] for array in (offsets, heads, log_ns, messages))
            ns, values = log_ns, np.array(loads, dtype=float).reshape(-1, len(self.columns))
        else:
            values = _doubles(rows, [found.doubles[place] for place in self._places])
            first = found.stamps[0]
            stamp = np.ascontiguousarray(rows[:, first:first + 8]).view('<i4')
            # As int64 before the product, which NumPy 1.26 would take in 32 bits.
            ns = NANOSECONDS * stamp[:, 0].astype(np.int64) + stamp[:, 1]
        self._parts.append((np.full(len(heads), place), offsets,
                            heads['sequence'].astype(np.int64), log_ns, ns, values, messages))

    def arrays(self):
        """
        Return arrays of n messages in the order of the file.

        They are: place, sequence number, log time [ns] and stamp [ns], int64; values, shape
        (n, k); bytes of commands. The stamp of a command is its log time.
        """
        none = np.zeros(0, dtype=np.int64)
        place, offset, *others = map(np.concatenate, zip(*self._parts or [
            (*[none] * 5, np.zeros((0, len(self.columns))), np.zeros(0, object))]))
        order = np.lexsort((offset, place))
        return tuple(array[order] for array in (place, *others))


def _gather(data, offsets, kind):
    """Return an element of the type `kind` from each of these offsets, shape (n,)."""
    last = len(data) - kind.itemsize
    if last < 0 or int(offsets.max()) > last:
        raise CdrError('the index points to something outside of its chunk')
    return np.ndarray((last + 1,), kind, data, strides=(1,))[offsets]


def _doubles(rows, places):
    columns = [place + byte for place in places for byte in range(8)]
    return np.ascontiguousarray(rows[:, columns]).view('<f8').reshape(len(rows), len(places))


def common(first, second):
    """
    Return the places of the same values in two ascending lists, pairwise.

    If a value occurs several times, as the step of a reset may, the last ones are paired.
    """
    if np.array_equal(first, second):
        return slice(None), slice(None)
    keys = []
    for values in (first, second):
        _, place, count = np.unique(values, return_index=True, return_counts=True)
        left = np.repeat(place + count, count) - np.arange(len(values))  # 1 for the last of each
        keys.append(np.rec.fromarrays([values, left]))
    _, one, other = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
    order = np.argsort(one)
    return one[order], other[order]


_WRAP = 2**32  # sequence numbers are steps modulo this, or all 0 if a tool has not kept them
_RESTART = 10**8  # [ns] by which stamps fall only if a simulator is started again
_EARLIER = {'~/tip_imu': '~/tip_imu/data_raw'}  # names of topics in older versions
_TYPES = {**{output.name: output.type_name for output in outputs(1)},
          **{command.name: command.type_name for command in COMMANDS}}


class Recording:
    """
    A log of this package, or a bag with the topics of a node.

    Series are read when they are asked for, chunk by chunk. All content is checked, because a file
    may come from anybody.

    Parameters
    ----------
    path : str or Path
        A file, or a bag's folder with one, or with the files of a plain bag that was split.
    node : str, optional
        Fully qualified name of the node; needed if a bag has several.

    Attributes
    ----------
    path : Path
    title : str
        Name of the file, or of the folder of a bag that was split.
    name : str
        The node's fully qualified name, such as '/timo_sim'.
    scene : Scene or None
        None for a plain bag.
    facts : dict
        What the node noted at its start: 'parameters', 'timo_sim', 'numpy', ...; empty for a plain
        bag.
    summary : dict
        What the node noted at its end; empty if it noted nothing.
    resets : ndarray of int
        Steps at which the motion was reset.
    changes : list of tuple
        (step, place in the file, values by name) of each setting of the scene's parameters.
    unread : dict of str
        By topic of the node, why its messages are not read.
    parts : list of Index
        Of the files; `index` is the first.

    Raises
    ------
    LogError
        If the file is not a log, or damaged, or incomplete: the text says what to do.

    """

    def __init__(self, path, node=None):
        self.parts = [Index(file) for file in files_of(path)]
        self.index = self.parts[0]
        split = len(self.parts) > 1
        self.path, self.title = (Path(path), printable(path)) if split else (
            self.index.path, self.index.name)
        if split and any(read_notes(index).facts for index in self.parts):
            raise LogError(f'{self.title} has {len(self.parts)} logs: name one')
        self.facts, self.summary, resets, self.changes = read_notes(self.index)
        self.resets, self.reset_places = np.array(resets, dtype=np.int64).reshape(-1, 2).T
        self.name = node or self.facts.get('node') or self._find_node()
        # If ros2_control publishes joint_states, the node publishes its own below its name.
        topics = {channel.topic for _, channel, _ in self._channels()}
        own, usual = f'{self.name}/joint_states', f'{self.name.rpartition("/")[0]}/joint_states'
        self._names = {own if own in topics else usual: 'joint_states', **read_names(self.facts)}
        self._wanted, self.unread = {}, {}
        for number, channel, schema in self._channels():
            short = self.short_name(channel.topic)
            if short in _TYPES:
                kind = schema.name if schema else 'unknown, without a schema'
                if (kind, channel.message_encoding) == (_TYPES[short], 'cdr'):
                    self._wanted[number] = short, channel.topic, kind
                else:
                    self.unread[channel.topic] = (
                        f'{channel.topic[:80]} is not read: its type is {kind[:80]}, encoded as '
                        f'{channel.message_encoding[:20]!r}')

    @cached_property
    def parameters(self):
        """All logged parameters of the node by present name, not checked."""
        return current(self._logged_parameters)

    @cached_property
    def _logged_parameters(self):
        parameters = json.loads(self.facts.get('parameters', 'null'))
        if not isinstance(parameters, dict):
            raise ValueError('its parameters are no dictionary')
        return parameters

    @property
    def split_steps(self):
        """Whether an earlier version may have split steps of this run, which is done no more."""
        return bool(self.facts and self._logged_parameters.get(SPLIT))

    @cached_property
    def scene(self):
        """The scene of a log of this package, else None."""
        return self._made(load_scene) if self.facts else None

    @cached_property
    def frames(self):
        """Names of frames in commands, see `scene.values.frame_names`."""
        return self._made(frame_names) if self.facts else frame_names({})

    def _made(self, make):
        try:
            return make(self.parameters)
        except (KeyError, ValueError, RecursionError, ParameterError) as error:
            reason = ' '.join(str(error).split())[:300]
            raise LogError(f'{self.title}: its scene cannot be built: {reason}') from None

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
            Short names; by default all. Those that the file does not have are left out.
        most_chunks : int, optional
            Read at most so many chunks, spread over the file.

        Returns
        -------
        dict of Series

        """
        found = {number: about for number, about in self._wanted.items()
                 if not names or about[0] in names}
        twice = Counter((part, about[0]) for (part, _), about in found.items()).most_common(1)
        if twice and twice[0][1] > 1:
            raise LogError(f'{self.title} has two channels of {twice[0][0][1]}')
        collectors = {about: Collector(*about, self.frames) for about in found.values()}
        for part, place, data, offsets in self._blocks(most_chunks):
            for number, at in offsets.items():
                if (part, number) not in found:
                    continue
                collector = collectors[found[part, number]]
                try:
                    collector.add(place, data, at, number)
                except CdrError as error:
                    raise LogError(f'{self.title}: a message on {collector.topic[:80]} '
                                   f'is not a {collector.type_name}: {error}') from None
        return {collector.name: self._series(collector) for collector in collectors.values()}

    def motion(self, series=None):
        """
        Return the motion at the samples of joint_states that have a modal_state.

        Parameters
        ----------
        series : dict of Series, optional
            What `read` returned for these, if they have been read already.

        Returns
        -------
        step, ns : ndarray of int64, shape (n,)
            Time step and sim time [ns]. The step of a reset may occur twice: before and after it.
        motion : ndarray, shape (n, 2 (3 + N))
            See `model.layout`.

        """
        found = self.read('joint_states', '~/modal_state') if series is None else series
        if 'joint_states' not in found:
            raise self.lacks(f'joint_states of {self.name}')
        joints, modes = found['joint_states'], found.get('~/modal_state')
        if modes is None:
            if self.scene is None or self.scene.modal_count:
                raise self.lacks(f'modal_state of {self.name}')
            return joints.step, joints.ns, joints.values[:, :6]
        first, second = common(joints.ns, modes.ns)
        q, rates = np.hsplit(modes.values[second], 2)
        position, velocity = joints.values[first, :3], joints.values[first, 3:6]
        return (joints.step[first], joints.ns[first],
                np.hstack([position, q, velocity, rates]))

    def lacks(self, what):
        """Return a LogError about what is missing, and about topics that are not read."""
        return LogError('; '.join([f'{self.title} has no {what}', *self.unread.values()])[
            :500])

    def resets_before(self, step, place):
        """
        Return how many resets were before messages of these steps, at these places in the file.

        At the step of a reset the place decides; -1 is returned if places contradict steps, as in
        a file that another tool has written again.
        """
        first, last = (np.searchsorted(self.resets, step, side) for side in ('left', 'right'))
        found = np.searchsorted(np.sort(self.reset_places), place)
        if (np.diff(self.reset_places) < 0).any() or ((found < first) | (found > last)).any():
            found = np.where(first < last, -1, found)
        return np.where(found < 0, -1, np.clip(found, first, last))

    def short_name(self, topic):
        """Return a topic's name before remapping: '~/tip_pose', 'joint_states', '/clock'."""
        if topic in self._names:
            return self._names[topic]
        if topic.startswith(self.name + '/'):
            short = '~/' + topic.removeprefix(self.name + '/')
            return _EARLIER.get(short, short)
        return topic

    def _channels(self):
        """Yield (part, number), Channel and Schema or None of each channel."""
        for part, index in enumerate(self.parts):
            for number, channel in index.channels.items():
                yield (part, number), channel, index.schemas.get(channel.schema_id)

    def _find_node(self):
        ends = [name.removeprefix('~') for name in (*_TYPES, *_EARLIER) if name.startswith('~')]
        topics = [channel.topic for _, channel, _ in self._channels()]
        nodes = {topic.removesuffix(end) for topic in topics for end in ends
                 if topic.endswith(end)}
        if not nodes:
            raise LogError(f'{self.title} has no topic of a node timo_sim')
        if len(nodes) > 1:
            raise LogError(f'{self.title} has topics of several nodes, say which: '
                           f'{", ".join(sorted(nodes))[:200]}')
        return nodes.pop()

    def _blocks(self, most):
        """Yield part, place, data and offsets by channel of chunks, in the order of files."""
        before = 0
        for part, index in enumerate(self.parts):
            for place, *block in self._blocks_of(index, most):
                yield part, before + place, *block
            before += index.path.stat().st_size

    def _blocks_of(self, index, most):
        chunks = index.chunks
        # A record of a message index has 15 bytes, and 16 more for each message.
        indexed = sum((chunk.message_index_length - 15 * len(chunk.message_index_offsets)) // 16
                      for chunk in chunks)
        if indexed == index.statistics.message_count:
            for chunk in chunks[::math.ceil(len(chunks) / (most or math.inf)) or 1]:
                yield chunk.chunk_start_offset, *index.read(chunk)
            return
        # A file without chunks, or without their indexes, is read record by record.
        with open_file(index.path) as stream:
            reader = Reader(stream)
            place = 0
            for record in reader.records():
                if isinstance(record, Chunk):
                    place = max(place + 1, reader.began)
                    yield place, np.frombuffer(record.data, np.uint8), {
                        channel: np.array(entries[1::2], np.uint64)
                        for channel, entries in record.index.items()}
            if reader.damage is not None:
                raise LogError(f'{index.name}: {reader.damage}: timo_sim recover '
                               f'{index.name} keeps what is intact')

    def _series(self, collector):
        place, sequence, log_ns, ns, values, messages = collector.arrays()
        resets, step = np.zeros(len(ns), dtype=np.int64), np.full(len(ns), -1)
        if self.facts:
            # In lock step, the stamp of the first state differs from its time by some ns.
            step = np.rint(1e-9 * ns / self.scene.step).astype(np.int64)
            ns = np.rint(step * self.scene.step * 1e9).astype(np.int64)
            if collector.command and sequence.any() and ((step - sequence) % _WRAP).any():
                raise LogError(f'{self.title}: log times of {collector.topic[:80]} do not '
                               'agree with its sequence numbers, which are time steps')
            resets = self.resets_before(step, place)
            if (np.diff(step) < 0).any() and np.isin(step, self.resets).any():
                raise LogError(f'{self.title}: {collector.topic[:80]} is in another order '
                               'than it was logged in, so that it does not say which messages '
                               'were before a reset')
        elif collector.command:
            ns = self._sim_time(log_ns)
        else:
            self._refuse_restart(collector.topic, log_ns, ns)
        # The network, or a tool that has written the file again, may have changed the order.
        order = np.argsort(ns, kind='stable')
        resets, step, log_ns, ns, values, messages = (
            array[order] for array in (resets, step, log_ns, ns, values, messages))
        return Series(collector.topic, collector.columns, step, ns, log_ns, values,
                      collector.refused, resets, messages.tolist() if collector.command else [])

    def _refuse_restart(self, topic, log_ns, ns):
        order = np.argsort(log_ns, kind='stable')
        falls = np.flatnonzero(np.diff(ns[order]) < -_RESTART)
        if len(falls):
            before, after = order[falls[0]:falls[0] + 2]
            raise LogError(
                f'{self.title}: stamps of {topic[:80]} fall from {1e-9 * ns[before]:.6g} to '
                f'{1e-9 * ns[after]:.6g} s at log time {log_ns[after]} ns, where a simulator was '
                'started again: cut the bag there, so that each part has one run')

    def _sim_time(self, log_ns):
        if self._clock is None or not len(log_ns):
            return log_ns
        logged, sim = self._clock
        # Interpolated between messages; extrapolated beyond them at their mean pace.
        pace = (sim[-1] - sim[0]) / max(1, logged[-1] - logged[0])
        inside = np.interp(log_ns - logged[0], logged - logged[0], (sim - sim[0]).astype(float))
        beyond = (log_ns - np.clip(log_ns, logged[0], logged[-1])) * pace
        return sim[0] + np.rint(inside + beyond).astype(np.int64)

    @cached_property
    def _clock(self):
        """Log times and sim times of messages of a topic with sim time in a bag, or None."""
        names = [output.name for output in outputs(1)]
        found = self.read(*names)
        # Sensors are the last of `names`, because their stamps may be those of late messages.
        for series in [found[name] for name in names if name in found]:
            if len(series.ns) > 1:
                order = np.argsort(series.log_ns, kind='stable')
                return series.log_ns[order], series.ns[order]
        return None
