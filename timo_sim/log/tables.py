# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Read a log as arrays: what was published and commanded; export it as a table or a folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
import csv
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
import json
import math
from operator import index
import os
from pathlib import Path
import shutil
from typing import Any

import numpy as np

from timo_sim.extras import optional
from timo_sim.log.notes import original_names, printable, TEXT
from timo_sim.log.read import LogError, LogFile
from timo_sim.log.rosbag2 import information, yaml_text
from timo_sim.scene.files import check_new, whole_file
from timo_sim.scene.parameters import frame_names, ParameterError, PARAMETERS
from timo_sim.scene.scene import load_scene
from timo_sim.topics.cdr import CdrError, form, layout, NANOSECONDS, Reader
from timo_sim.topics.commands import COMMANDS, RefusedError
from timo_sim.topics.outputs import outputs, title, with_angles

_AT_ONCE = 4096  # messages that are converted to arrays together
_COMMANDS = {command.name: command for command in COMMANDS}
_WRAP = 2**32  # sequence numbers are steps modulo this, or all 0 if a tool has not kept them
_RESTART = 10**8  # [ns] by which stamps fall only if a simulator is started again
_FAR = 2.0**61  # [ns] that a log time may be from the others before sim times overflow
_RENAMED = {'~/tip_imu': '~/tip_imu/data_raw'}  # names of topics in 0.2.0
# Parameters of 0.2.0 and their present names; None: they are gone, and their values do not matter.
_PARAMETERS = {
    **{f'arm.{name}': f'arm.section.{name}' for name in ('width', 'height', 'shear_correction')},
    'rate.arm_shape': None, 'publish_arm_shape': None, 'integrator.tolerance': None,
    'rerun_live': None}
_TYPES = {**{output.name: output.type_name for output in outputs(1)},
          **{command.name: command.type_name for command in COMMANDS}}


@dataclass(frozen=True)
class Series:
    """
    The n messages of a topic, with `columns`, the names of k quantities with units.

    `step`, int64 of shape (n,) as the following, are time steps, -1 in a plain bag. `ns` is the
    sim time of the message [ns]: in a log from its step, in a bag the header's stamp. Stamps of
    commands do not say when they acted: there it is the log time by the node's clock, if that is
    known. `log_ns` is when the message was logged, or published in a bag with ~/scene [ns].
    `resets` says how many resets were before a message. `values`, shape (n, k), are NaN for what a
    command does not set. Commands that the node refused are left out and counted. `data` are a
    command's messages, CDR.
    """

    topic: str
    columns: tuple[str, ...]
    step: np.ndarray
    ns: np.ndarray
    log_ns: np.ndarray
    values: np.ndarray
    refused: int
    resets: np.ndarray
    data: list[bytes]

    def sorted_by(self, key: np.ndarray) -> Series:
        """Return it in the order of a key, (n,); equal ones stay in their order."""
        if (key[:-1] <= key[1:]).all():
            return self
        order = np.argsort(key, kind='stable')
        arrays = {name: getattr(self, name)[order]
                  for name in ('resets', 'step', 'ns', 'log_ns', 'values')}
        return replace(self, **arrays, data=[self.data[k] for k in order] if self.data else [])


class Recording:
    """
    A log of this package, or a bag with the topics of a node; series are read when asked for.

    `path` may be a bag's folder; `node` is the fully qualified name of the node, needed if a bag
    has several. LogError is raised if the file is not a log, or damaged, or incomplete: the text
    says what to do.

    Attributes
    ----------
    title, name : str
        Of the file; the node's fully qualified name.
    facts, summary : dict
        What the node noted at its start ('parameters', 'numpy', ...), texts, and at its end:
        numbers, NaN where a text is none, but for 'timing'. In a bag, the facts are those of
        ~/scene; what was not noted is missing.
    resets : ndarray of int
        Steps at which the motion was reset.
    changes : list of tuple
        (step, resets before it, values by name) of each setting of the scene's parameters.
    unread : dict of str
        By topic of the node, why its messages are not read.
    reset_times : ndarray of int or None
        Of a bag with ~/scene, the times at which its resets were published [ns].
    timeouts : list of tuple
        Of a bag with ~/scene, (step, command_timeout from it on [s], not checked), ascending.

    """

    def __init__(self, path: Path | str, node: str | None = None) -> None:
        self._file = LogFile(path)
        self.path, self.title = self._file.path, self._file.name
        self.facts, summary, logged, self.changes = self._file.notes()
        self.summary = {name: text if name == 'timing' else _number(text)
                        for name, text in summary.items()}
        if self.facts.get('timo_sim', '').startswith('0.1.'):
            raise LogError(f'{self.title} is of timo_sim {self.facts["timo_sim"][:9]}: read it '
                           'with timo_sim 0.2.0, the last version that can')
        self.resets = np.array(logged, dtype=np.int64)
        self.name = self.facts.get('node') or node or self._find_node()
        if node and node != self.name:
            raise LogError(f'{self.title} is a log of the node {self.name}, got '
                           f'{printable(node)}')
        self.reset_times: np.ndarray | None = None
        self.timeouts: list[tuple[int, Any]] = []
        if not self.facts:
            self._read_scene()
        if self.changes:
            steps, resets, _ = zip(*self.changes)
            self._check_order(np.array(steps), np.array(resets))
        # If ros2_control publishes joint_states, the node publishes its own below its name.
        topics = {channel.topic for channel, _ in self._channels()}
        own, usual = f'{self.name}/joint_states', f'{self.name.rpartition("/")[0]}/joint_states'
        known = original_names(self.facts)
        self._names = {own if own in topics else usual: 'joint_states', **known}
        self._wanted, self.unread = {}, {}
        self._read: dict[str, Series] = {}
        for channel, schema in self._channels():
            short = self.short_name(channel.topic)
            # A /clock that the node does not publish is another node's.
            if short in _TYPES and (short != '/clock' or not known or channel.topic in known):
                kind = schema.name if schema else 'unknown, without a schema'
                if (kind, channel.message_encoding) == (_TYPES[short], 'cdr'):
                    self._wanted[channel.topic] = short
                else:
                    self.unread[channel.topic] = (
                        f'{channel.topic[:80]} is not read: its type is {kind[:80]}, encoded as '
                        f'{channel.message_encoding[:20]!r}')

    def _read_scene(self):
        """Take start, resets and changes from ~/scene, if a bag has it."""
        wanted = [channel.topic for channel, schema in self._channels()
                  if channel.topic == f'{self.name}/scene' and schema and schema.name == TEXT]
        received = sorted(each for _, messages in self._file.messages(wanted) for each in zip(
            messages.heads['publish_time'].tolist(), messages.serialized()))
        if not received:
            return
        try:
            told = [(sent, json.loads(layout(TEXT, data).texts[0])) for sent, data in received]
            steps = [index(message['step']) for _, message in told]
            events = [message['event'] for _, message in told]
            given = [dict(message['set']) for _, message in told]
            self.timeouts = [(step, dict(message['parameters']).get('command_timeout', 0.0))
                             for step, (_, message) in zip(steps, told)]
            self.facts = {name: value if isinstance(value, str) else json.dumps(value)
                          for name, value in told[0][1].items()}
            if not 0 <= min(steps) <= max(steps) < 10**18:
                raise ValueError
        except (CdrError, LookupError, TypeError, ValueError, RecursionError):
            raise LogError(f'{self.title} has a malformed message on {self.name}/scene: '
                           'give the scene by --scene') from None
        if events.count('start') > 1:
            raise LogError(f'{self.title} has {events.count("start")} runs of {self.name}: cut '
                           'the bag, so that each part has one')
        resets = [k for k, event in enumerate(events) if event == 'reset']
        self.resets = np.array([steps[k] for k in resets], dtype=np.int64)
        self.reset_times = np.array([told[k][0] for k in resets], dtype=np.int64)
        self.changes = [(steps[k], sum(reset <= k for reset in resets), given[k])
                        for k, event in enumerate(events) if event == 'set' and k and given[k]]

    @property
    def repeats(self) -> bool:
        """Whether a replay is the same to the last bit: steps of commands, if any, are known."""
        return bool(self.facts) and (
            self.reset_times is None or self.period > 0
            or not any(series.data for series in self.topics.values()))

    @cached_property
    def period(self) -> int:
        """Steps from one wait for a command to the next in lock step, else 0."""
        return 0 if self.own('sync') == 'free' else round(self.own('sync_period')
                                                          / self.scene.step)

    def own(self, name: str) -> Any:
        """Return a logged parameter of the node itself, by default its default; ParameterError."""
        return PARAMETERS[name].check(self.parameters.get(name, PARAMETERS[name].default))

    @cached_property
    def parameters(self) -> dict[str, Any]:
        """All logged parameters of the node, not checked, by their present names."""
        parameters = json.loads(self.facts.get('parameters', 'null')) if self.facts else {}
        if not isinstance(parameters, dict):
            raise ValueError('its parameters are no dictionary')
        if parameters.get('integrator.tolerance'):
            raise LogError(f'{self.title} has steps split by integrator.tolerance: replay it '
                           'with timo_sim 0.2.0, the last version that can')
        return {now: value for name, value in parameters.items()
                if (now := _PARAMETERS.get(name, name))}

    @cached_property
    def scene(self) -> Any:
        """The scene of a log of this package, else None."""
        return self._build(lambda values: load_scene({}, values)) if self.facts else None

    @cached_property
    def frames(self) -> dict[str, str]:
        """Names of frames in commands, see `scene.parameters.frame_names`."""
        return self._build(frame_names)

    def _build(self, build):
        try:
            return build(self.parameters)
        except (KeyError, ValueError, RecursionError, ParameterError) as error:
            reason = ' '.join(str(error).split())[:300]
            raise LogError(f'{self.title}: its scene cannot be built: {reason}') from None

    @property
    def topics(self) -> dict[str, Series]:
        """All series by short name: 'joint_states', '~/tip_pose', ..., '~/motor_torque'."""
        return self.read()

    def read(self, *names: str) -> dict[str, Series]:
        """Return series by short name, by default all; what was read once is kept."""
        names = names or tuple(self._wanted.values())
        found = {topic: name for topic, name in self._wanted.items()
                 if name in names and name not in self._read}
        if twice := [name for name, count in Counter(found.values()).items() if count > 1]:
            raise LogError(f'{self.title} has two topics that are {twice[0]}')
        collectors = {topic: _Collector(self.title, name, topic, self.frames,
                                        self.reset_times is not None)
                      for topic, name in found.items()}
        for topic, messages in self._file.messages(found):
            collectors[topic].add(messages)
        self._read |= {name: self._series(collectors[topic]) for topic, name in found.items()}
        return {name: self._read[name] for name in self._wanted.values() if name in names}

    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the motion at the samples of joint_states that have a modal_state.

        The results are sim time [ns], int64, shape (n,), n > 0, the motion, shape (n, 2 (3 + N)),
        see `model.layout`, and the efforts of the joints, (n, 3) [N, N m]. The time of a reset may
        occur twice: before and after it. Raises LogError if these topics, common samples of them
        or the scene are missing.
        """
        if self.scene is None:
            raise self.lacks(f'{self.name}/scene, so that the simulated scene is not known: '
                             'timo_sim export makes a table of it')
        found = self.read('joint_states', '~/modal_state')
        if 'joint_states' not in found:
            raise self.lacks(f'joint_states of {self.name}')
        joints, modes = found['joint_states'], found.get('~/modal_state')
        if modes is not None:
            first, second = common(joints, modes)
            q, rates = np.hsplit(modes.values[second], 2)
            position, velocity = joints.values[first, :3], joints.values[first, 3:6]
            motion = np.hstack([position, q, velocity, rates])
        elif self.scene.modal_count:
            raise self.lacks(f'modal_state of {self.name}')
        else:
            first, motion = slice(None), joints.values[:, :6]
        if motion.shape[1] != 2 * (3 + self.scene.modal_count):
            raise LogError(f'{self.title} has {motion.shape[1] // 2 - 3} modal coordinates, but '
                           f'its scene has {self.scene.modal_count}')
        if not len(motion):
            raise self.lacks('joint_states with a modal_state of the same time: choose rates of '
                             'which one is a multiple of the other')
        return joints.ns[first], motion, joints.values[first, 6:9]

    def lacks(self, what: str) -> LogError:
        """Return a LogError about what is missing, and about topics that are not read."""
        return LogError('; '.join([f'{self.title} has no {what}', *self.unread.values()])[:500])

    @property
    def payloads(self) -> tuple[tuple[Any, ...], ...]:
        """Changes of the load: step, then mass [kg], inertia [kg m2], offset [m]."""
        scene, changes = self.scene, [(step, values) for step, _, values in self.changes]
        starts, found = [0, *self.resets.tolist()], []
        names = [f'end_effector.{name}' for name in ('mass', 'inertia', 'offset')]
        own = now = tuple(scene.values[name] for name in names)
        for start, end in zip(starts, [*starts[1:], float('inf')]):
            # A reset goes back to the mass and inertia that were set last.
            events = [(start, own), *((start + step, tuple(tip)) for step, *tip in scene.payloads)]
            for step, values in changes:
                if start <= step < end:
                    before, own = own, tuple(map(values.get, names, own))
                    # As in a simulator, a value that is set again changes nothing.
                    events += [(step, own)] * (own != before)
            for step, tip in sorted(events, key=lambda event: event[0]):
                if step < end and tip != now:
                    found.append((step, *tip))
                    now = tip
        return tuple(found)

    def _check_order(self, step, resets):
        """Raise LogError unless messages at these steps were behind so many resets, (n,) each."""
        first, last = (np.searchsorted(self.resets, step, side) for side in ('left', 'right'))
        if (resets < first).any() or (resets > last).any() or (np.diff(self.resets) < 0).any():
            raise LogError(f'{self.title} is in another order than it was logged in, so that it '
                           'does not say which messages were before a reset')

    def short_name(self, topic: str) -> str:
        """Return a topic's name before remapping: '~/tip_pose', 'joint_states', '/clock'."""
        if topic in self._names:
            return self._names[topic]
        if topic.startswith(self.name + '/'):
            short = '~/' + topic.removeprefix(self.name + '/')
            return _RENAMED.get(short, short)
        return topic

    def _channels(self):
        """Yield each channel, with its schema or None."""
        for channel in self._file.summary.channels.values():
            yield channel, self._file.summary.schemas.get(channel.schema_id)

    def _find_node(self):
        ends = [name.removeprefix('~') for name in (*_TYPES, *_RENAMED) if name.startswith('~')]
        topics = [channel.topic for channel, _ in self._channels()]
        nodes = {topic.removesuffix(end) for topic in topics for end in ends
                 if topic.endswith(end)}
        if not nodes:
            raise LogError(f'{self.title} has no topic of a node timo_sim: record '
                           'joint_states and ~/scene')
        if len(nodes) > 1:
            raise LogError(f'{self.title} has topics of several nodes, say which: '
                           f'{", ".join(sorted(nodes))[:200]}')
        return nodes.pop()

    def _series(self, collector):
        found, command = collector.series(), collector.command is not None
        if self.reset_times is not None:
            found = self._sent(found, command)
        if self.facts:
            found = self._at_steps(found, command)
        else:
            found = self._in_plain_bag(found, command)
        # The network, or a tool that has written the file again, may have changed the order.
        return found.sorted_by(found.ns)

    def _sent(self, found, command):
        """Return messages of a bag with ~/scene by the times at which they were sent."""
        assert self.reset_times is not None
        found = found.sorted_by(found.log_ns)
        resets = np.searchsorted(self.reset_times, found.log_ns, 'right')
        if not command:
            return replace(found, resets=resets)
        ns = 1e9 * self.scene.step * self._steps_of_commands(found.log_ns, found.ns, resets)
        # Sequence numbers are those of the recorder.
        return replace(found, resets=resets, ns=np.rint(ns), step=np.zeros(len(ns), np.int64))

    def _at_steps(self, found, command):
        """Return messages with their time steps, which commands of a log have as numbers, too."""
        # In lock step, the stamp of the first state differs from its time by some ns.
        step = np.rint(1e-9 * found.ns / self.scene.step).astype(np.int64)
        if command and found.step.any() and ((step - found.step) % _WRAP).any():
            raise LogError(f'{self.title}: log times of {found.topic[:80]} do not agree with its '
                           'sequence numbers, which are time steps')
        self._check_order(step, found.resets)
        return replace(found, step=step,
                       ns=np.rint(step * self.scene.step * 1e9).astype(np.int64))

    def _in_plain_bag(self, found, command):
        """Return messages with sim time, without steps; raise LogError if they are of two runs."""
        ns = self._sim_time(found.log_ns) if command else found.ns
        order = np.argsort(found.log_ns, kind='stable')
        falls = np.flatnonzero(np.diff(ns[order]) < -_RESTART)
        if len(falls):
            before, after = order[falls[0]:falls[0] + 2]
            raise LogError(f'{self.title}: stamps of {found.topic[:80]} fall from '
                           f'{1e-9 * ns[before]:.6g} to {1e-9 * ns[after]:.6g} s at log time '
                           f'{found.log_ns[after]} ns, where a simulator was started again: cut '
                           'the bag there, so that each part has one run')
        return replace(found, ns=ns, step=np.full(len(ns), -1), resets=np.zeros(len(ns), int))

    def _steps_of_commands(self, sent, stamps, resets):
        """
        Return the steps from which commands of a bag act.

        That is by the times at which they were sent and, in lock step, by their stamps [ns] of the
        states that they answer, 0 if they have none.
        """
        if self._clock is None:
            raise self.lacks(f'states of {self.name}, between which its commands came')
        if self.period:
            # A command answers the state that was published last, after a reset any one.
            published, ns = self._clock
            answered = ns[np.maximum(np.searchsorted(published, sent, 'right') - 1, 0)]
            if self.own('sync') == 'wait':
                answered = np.where(stamps, stamps, answered)
            step = np.ceil(np.rint(1e-9 * answered / self.scene.step) / self.period) * self.period
        else:
            step = np.ceil(1e-9 * self._sim_time(sent) / self.scene.step - 1e-6)
        bounds = np.concatenate([[0], self.resets, [np.iinfo(np.int64).max]])
        return np.clip(step.astype(np.int64), bounds[resets], bounds[resets + 1])

    def _sim_time(self, log_ns):
        if self._clock is None or not len(log_ns):
            return log_ns
        logged, sim = self._clock
        # Interpolated between messages; extrapolated beyond them at their mean pace.
        pace = (sim[-1] - sim[0]) / max(1, logged[-1] - logged[0])
        inside = np.interp(log_ns - logged[0], logged - logged[0], (sim - sim[0]).astype(float))
        beyond = (log_ns - np.clip(log_ns, logged[0], logged[-1])) * pace
        return sim[0] + np.rint(inside + np.clip(beyond, -_FAR, _FAR)).astype(np.int64)

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


def _number(text):
    for kind in int, float:
        try:
            return kind(text)
        except ValueError:
            continue
    return math.nan


def common(first: Series, second: Series) -> tuple:
    """Return places in one series, and in another those of the last message of the same time."""
    if np.array_equal(first.ns, second.ns):
        return slice(None), slice(None)
    # At the step of a reset there are messages before and after it.
    ours, theirs = (np.rec.fromarrays([each.ns, each.resets]) for each in (first, second))
    place = np.searchsorted(theirs, ours, 'right') - 1
    found = np.flatnonzero(place >= 0)
    found = found[theirs[place[found]] == ours[found]]
    return found, place[found]


class _Collector:
    """
    Gathers the messages of a topic as arrays; `frames` are the names of frames in commands.

    Of a bag with ~/scene (`in_bag`), times are those at which they were published, with the stamps
    of commands, else those at which they were logged. A message that does not match its type, or
    has other texts or lists than those before it on an output's topic, is a LogError.
    """

    def __init__(self, title, name, topic, frames, in_bag):
        self._title, self._name, self._topic, self._type_name = title, name, topic, _TYPES[name]
        self._frames, self._in_bag = frames, in_bag
        self.command = _COMMANDS.get(name)
        self._columns = self.command.names if self.command else ()
        self._refused, self._waiting, self._parts = 0, [], []
        self._reader = Reader(self._type_name)

    def add(self, messages):
        """Add Messages."""
        self._waiting.append(messages)
        if sum(len(each.heads) for each in self._waiting) >= _AT_ONCE:
            self._convert()

    def series(self):
        """Return a Series in the order of the file, with sequence numbers as steps."""
        if self._waiting:
            self._convert()
        none = np.zeros(0, dtype=np.int64)
        resets, step, log_ns, ns, values, data = zip(*self._parts or [
            (*4 * [none], np.zeros((0, len(self._columns))), [])])
        return Series(
            topic=self._topic, columns=self._columns, refused=self._refused,
            resets=np.concatenate(resets), step=np.concatenate(step), ns=np.concatenate(ns),
            log_ns=np.concatenate(log_ns), values=np.concatenate(values), data=[*chain(*data)])

    def _convert(self):
        waiting, self._waiting = self._waiting, []
        resets = np.concatenate([np.full(len(each.heads), each.resets) for each in waiting])
        heads = np.concatenate([each.heads for each in waiting])
        log_ns = heads['publish_time' if self._in_bag else 'log_time'].astype(np.int64)
        try:
            if self.command:
                data = [message for each in waiting for message in each.serialized()]
                kept, stamps, values = self._read_commands(data)
                ns, data = stamps if self._in_bag else log_ns[kept], [data[k] for k in kept]
            else:
                kept, (ns, values), data = slice(None), self._read_outputs(waiting), []
        except CdrError as error:
            raise LogError(f'{self._title}: a message on {self._topic[:80]} is not a '
                           f'{self._type_name}: {error}') from None
        self._parts.append((resets[kept], heads['sequence'].astype(np.int64)[kept],
                            log_ns[kept], ns, values, data))

    def _read_commands(self, data):
        """Return which of n messages are not refused, their stamps or 0 [ns], and their rows."""
        assert self.command
        kept, stamps, rows = [], [], []
        for number, message in enumerate(data):
            texts, lists, stamp = self._reader(message)
            try:
                rows.append(self.command.row(texts, lists, self._frames))
            except RefusedError:
                self._refused += 1
                continue
            kept.append(number)
            stamps.append(stamp)
        return (kept, np.array(stamps, dtype=np.int64),
                np.array(rows, dtype=float).reshape(-1, len(self._columns)))

    def _read_outputs(self, waiting):
        """Return stamps [ns] and values of messages."""
        first = waiting[0].rows()[0].tobytes()
        found = layout(self._type_name, first)
        texts = found.texts[1:]  # after the frame
        output = {each.name: each for each in outputs(max(1, len(texts)))}[self._name]
        _, own, places = form(output.type_name, output.template)
        places = places[:len(output.columns)]
        if texts != own.texts[1:] or len(found.doubles) <= max(places, default=-1):
            raise CdrError(f'{", ".join(texts)[:80]} are not the joints of this node')
        self._columns = self._columns or output.columns
        if self._columns == output.columns and all(
                (each.sizes == len(first)).all() for each in waiting):
            rows = np.concatenate([each.rows() for each in waiting])
            varying = np.full(len(first), 255, dtype=np.uint8)
            varying[found.fixed] = 0
            if (rows | varying == rows[0] | varying).all():
                times = _eight_bytes(rows, found.stamps[:1], '<i4').astype(np.int64)
                return NANOSECONDS * times[:, 0] + times[:, 1], _eight_bytes(
                    rows, [found.doubles[place] for place in places], '<f8')
        raise CdrError('its texts or lists are not those of the messages before it')


def _eight_bytes(rows, places, kind):
    """Return what rows of bytes have at some places, eight bytes each, as numbers of a kind."""
    every = np.ndarray((len(rows), rows.shape[1] - 7), '<u8', rows, strides=(rows.shape[1], 1))
    return every[:, places].view(kind).reshape(
        len(rows), 8 * len(places) // np.dtype(kind).itemsize)


_ROWS = 10000  # rows of a CSV file that are converted to text at a time


def export(file: Path | str, output: Path | str, topic: str | None = None,
           node: str | None = None) -> str:
    """
    Write a log as a table to `output`, a new *.parquet or *.csv; return what was written.

    There is one row for each message of joint_states, with the messages of the other topics that
    have the same stamp (NaN if missing), or of `topic` alone, such as '~/motor_torque'. Raises
    LogError if `file`, of which `node` is as for `Recording`, is not a log or lacks the topic, or
    `output` has another suffix; FileExistsError if it exists.
    """
    path = Path(output)
    check_table(path)
    recording = Recording(file, node)
    columns, left = table(recording, topic)
    write_table(columns, path)
    text = f'{printable(path)}: {len(columns["time_s"])} rows, {len(columns)} columns'
    if left:
        text += '; messages at other times are left out, --topic writes them: ' + ', '.join(left)
    return '; '.join([text, *recording.unread.values()])


def write_table(columns: dict[str, np.ndarray], path: Path) -> None:
    """Write columns by name to a path; raises as `check_table`."""
    check_table(path)
    with whole_file(path, new=True) as part:
        if path.suffix == '.parquet':
            with optional():
                import pyarrow
                import pyarrow.parquet
            pyarrow.parquet.write_table(pyarrow.table({
                name: pyarrow.array(np.ascontiguousarray(values), from_pandas=True)
                for name, values in columns.items()}), part)
            return
        with open(part, 'w', newline='') as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            for first in range(0, len(next(iter(columns.values()))), _ROWS):
                writer.writerows(zip(*(
                    ['' if value != value else value
                     for value in values[first:first + _ROWS].tolist()]
                    for values in columns.values())))


def check_table(path: Path, also: str = '') -> None:
    """Raise FileExistsError unless a path is new, LogError unless it is *.parquet or *.csv."""
    if path.suffix not in ('.parquet', '.csv'):
        raise LogError(f'{printable(path)} must end with {also}.parquet or .csv')
    check_new(path)


def column_names(topic: str, columns: Iterable[str]) -> list[str]:
    """Return the names that columns of a topic have in a table of several topics."""
    if topic == 'joint_states':
        return list(columns)
    prefix = title(topic) + '_'
    return [column if column.startswith('mode_') else prefix + column for column in columns]


def table(recording: Recording, topic: str | None = None) -> tuple[
        dict[str, np.ndarray], list[str]]:
    """Return columns by name, (n,) each, and the topics whose messages are in part left out."""
    found = recording.read(*([topic] if topic else [output.name for output in outputs(1)]))
    base = found.pop(topic or 'joint_states', None)
    if base is None:
        topics = ', '.join(sorted(recording.read())) or 'none'
        raise recording.lacks(f'{topic or "joint_states"}; it has {topics}')
    columns, left = {'time_s': 1e-9 * base.ns}, []
    if recording.facts:
        columns['step'] = base.step
    names, values = with_angles(base.columns, base.values)
    columns.update(zip(names, values.T))
    for name, series in found.items():
        names, values = with_angles(series.columns, series.values)
        here, there = common(base, series)
        whole = np.full((len(base.ns), len(names)), np.nan)
        whole[here] = values[there]
        columns.update(zip(column_names(name, names), whole.T))
        if names and len(series.ns[there]) < len(series.ns):
            left.append(name)
    return columns, left


def export_bag(file: Path | str, output: Path | str) -> str:
    """Make a new folder as rosbag2 writes it; return a text that says what was done."""
    folder, log = Path(output), LogFile(file)
    name = f'{folder.name}_0.mcap'  # `ros2 bag reindex` takes no other name
    content = information(log.summary, name)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(folder, new=True) as part:
        part.mkdir()
        try:
            os.link(log.path.resolve(), part / name)  # no time nor space for a gigabyte
        except OSError:
            shutil.copyfile(log.path, part / name)
        (part / 'metadata.yaml').write_text(yaml_text({'rosbag2_bagfile_information': content}))
    return f'{printable(folder)}: {printable(name)} and metadata.yaml'
