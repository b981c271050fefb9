# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Open logs as runs, and replay them: the same to the last bit, or with a changed scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
import math
from pathlib import Path
import time
from typing import Any

import numpy as np
from tqdm import tqdm

from timo_sim.log.new_log import NewLog
from timo_sim.log.notes import CHANGE, change_note, environment_differences, plain, RESET
from timo_sim.log.read import LogError
from timo_sim.log.tables import Recording
from timo_sim.runs.simulate import resolve
from timo_sim.runs.run import Run
from timo_sim.scene.parameters import (
    check, checked, DEFAULTS, frame_names, ParameterError, PARAMETERS, PATH, steps_in, TEXT,
    whole_ratio)
from timo_sim.scene.scene import Scene, scene_from, values_of
from timo_sim.simulation.loads import load_of_commands
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.topics.cdr import pack
from timo_sim.topics.commands import COMMANDED, COMMANDS, has_tip_force, TIMED_OUT
from timo_sim.topics.outputs import title, with_angles

_ROUNDING = 1e-9  # relative error of times in steps
_BATCH = 500  # most steps of one compiled call
_MOST_SAMPLES = 10**7  # of a topic that a recording lacks: a day at 100 Hz


@checked(path=PATH, node=TEXT)
def open_log(path: str | Path, node: str | None = None) -> Run:
    """
    Open a log of the node, or of `Run.save`, as a run.

    Its samples are the messages of joint_states; `run.recording.topics` has all topics. `node` is
    the fully qualified name of the node, needed if the file has several.

    Raises
    ------
    LogError
        If the file is not a log, or is a bag without ~/scene.

    Examples
    --------
    >>> import timo_sim
    >>> path = timo_sim.simulate(timo_sim.load_scene('paper'), 1.0).save('run.mcap')
    >>> timo_sim.open_log(path).shaft.shape
    (1001,)

    """
    recording = Recording(path, node)
    ns, motion, _ = recording.motion()
    scene = recording.scene
    heat = np.full(len(ns), np.nan) if scene.has_dry_friction else np.zeros(len(ns))
    return Run(scene=scene, model=scene.build(), t=1e-9 * ns, values=motion, friction_heat=heat,
               warning=None, stats=recording.summary, recording=recording,
               payloads=recording.payloads)


def replay(file: str | Path, changes: Mapping[str, Any] | None = None,
           output: str | Path | None = None, scene_file: str | Path | None = None,
           duration: float | None = None, node: str | None = None,
           show: Callable[[str], object] = print) -> bool:
    """
    Replay a log or a bag, compare what it publishes with what was logged, and report.

    `changes` are values by dotted name that differ from those of the recorded scene, `scene_file`
    is a parameter file instead of it, which a plain bag needs; for `duration` and `node`
    see `segments_of` and `Recording`. `output` is a new log; by default there is none for an
    unchanged scene, else one in the working directory, named after `file` with `_replay` appended.
    `show` is called with each line of the report. Returns whether the run did not diverge and, if
    nothing was changed, all logged numbers are the same to the last bit. Raises LogError if the
    file is not a log, is damaged, or has nothing to replay; ParameterError if a value breaks its
    rule, a plain bag has no scene, or steps do not fit the log.
    """
    def say(text):
        show(plain(text))

    recording = Recording(file, node)
    values = _values(recording, scene_file, changes or {})
    if not recording.facts:
        recording.frames = frame_names(values)
    scene = scene_from(values)
    same = recording.facts and scene == recording.scene
    if scene.values['model.accuracy']:
        scene, _ = resolve(scene, duration or 0.0)
    values.update(scene.values)
    segments = segments_of(recording, scene, values, duration)
    log = None
    if output or not same:
        path = output or Path(recording.path.stem + '_replay.mcap')
        log = NewLog(path, scene, values, recording.name, replay_of=recording.title)
    again = Replay(scene, segments, log)
    begun = time.monotonic()
    try:
        with tqdm(total=segments[-1].last, unit='step', unit_scale=True, delay=1.0, disable=None,
                  leave=False) as bar:
            again.run(bar.update)
    finally:
        if log:
            log.close()
    _report(say, recording, segments, again, time.monotonic() - begun)
    count, differing, found = _compare(segments, scene, recording)
    repeats = same and recording.repeats
    logged = _count_logged(segments, scene, recording)
    say(f'{count} of {logged} logged numbers compared' + (
        '' if not same else f': {differing} differ' if differing else
        ': all are the same to the last bit' if count == logged and not recording.unread else
        ', the same to the last bit'))
    for text in recording.unread.values():
        say(text)
    if found and not (same and not differing):
        if not same and (scene.values['model.formulation']
                         != recording.scene.values['model.formulation']):
            # Formulations have different modes, so that modal coordinates cannot be compared.
            found = [row for row in found if not row[0].startswith('modal_state')]
        _show_table(say, found)
    ground = environment_differences(recording.facts)
    if ground:
        say(f'logged with {ground}: last bits may differ')
    if same and differing and not repeats:
        say('only a bag recorded in lock step says at which step a command began to act')
    if log:
        say(f'new log: {log.path}')
    if again.diverged:
        say(again.diverged)
    return not (again.diverged or repeats and (differing or count < logged or recording.unread))


def _values(recording, scene_file, changes):
    if scene_file is not None:
        return values_of(scene_file, changes)
    if not recording.facts:
        raise ParameterError(f'{recording.title} is a plain bag without {recording.name}/scene: '
                             'give its scene by --scene')
    # `recording.scene` raises LogError if values are wrong; it has none of the node's own.
    checked = recording.scene.values
    given = {**recording.parameters, **checked}
    return {**DEFAULTS, **check(given, recording.title), **check(changes, '--set')}


@dataclass
class Segment:
    """A part of a run, from its start or a reset to the next reset or its end."""

    first: int      # step
    last: int
    commands: list  # (step, index in COMMANDS, values that it sets, message), ascending
    changes: list   # (step, values by name) of each setting, ascending
    samples: dict   # by short name of a topic, the steps of its messages, ascending
    logged: dict    # their numbers, shape (n, k), of topics that the log has
    replayed: dict = field(default_factory=dict)  # numbers of the replay at the samples
    done: dict = field(default_factory=dict)      # how many samples were replayed so far
    timeouts: int = 0  # how many of `commands` are time-outs that a bag does not show


def segments_of(recording: Recording, scene: Scene, values: Mapping[str, Any],
                duration: float | None = None) -> list[Segment]:
    """
    Return the Segments of a recording, counted in steps of a scene.

    A scene may have another time step: a command acts from the next whole step on. `values` are
    the node's parameters, for the rates of topics that are not in the recording; `duration` is the
    sim time of the end, by default of the last message [s]. The first command of a bag that has no
    sim time acts at 0. Raises LogError if there is nothing to replay; ParameterError if logged
    messages are not at whole time steps, or the log is shorter than the duration.
    """
    recorded, result = _Recorded(recording, scene, values), []
    last = recorded.last_step(duration)
    for number, (first, end) in enumerate(pairwise([0, *recorded.resets, last])):
        end = min(end, last)
        if end < first:
            break
        samples, logged = recorded.motion(number, end)
        samples |= recorded.samples_of_others(samples, first, end, last)
        commands = given = recorded.commands(number, end)
        if recording.reset_times is not None:  # the log of a node has a message for each time-out
            commands = _with_timeouts(given, recording, scene, end)
        result.append(Segment(
            first=first, last=end, commands=commands, changes=recorded.changes(number),
            samples=samples, logged=logged, timeouts=len(commands) - len(given)))
    return result


class _Recorded:
    """
    What a recording has, in steps of a scene; arguments and errors are those of `segments_of`.

    Resets are counted: what has the number k comes after k of them. `resets` are their steps.
    """

    def __init__(self, recording, scene, values):
        self._recording, self._scene, self._values = recording, scene, values
        topics = recording.topics
        if not any(len(series.ns) for series in topics.values()):
            raise recording.lacks(f'messages of {recording.name}')
        self._outputs = {output.name: output for output in scene.outputs}
        self._ratio, self.resets = math.nan, []
        if recording.facts:
            self._ratio = recording.scene.step / scene.step
            self.resets = _round_up(recording.resets * self._ratio).tolist()
        motions = {name: series for name, series in topics.items()
                   if name in self._outputs and len(series.ns)}
        commands = [(number, topics[command.name]) for number, command in enumerate(COMMANDS)
                    if command.name in topics]
        self._shift = 0  # of stamps [ns]
        if not recording.facts and not motions:
            self._shift = -min(int(series.ns[0]) for _, series in commands if len(series.ns))
        # Of each topic of commands: its index in COMMANDS, its series, the steps of its messages.
        self._commands = [(number, series, _round_up(self._steps(series)))
                          for number, series in commands]
        # The motion in a plain bag is not compared, because it is not known exactly when its
        # commands began to act: it says only when the run ends.
        self._motions = motions if recording.facts else {}
        self._end = max([0, *(math.floor(self._steps(series).max()) for series in motions.values()
                              if not recording.facts)])
        self._published = {name: self._whole_steps(series)
                           for name, series in self._motions.items()}
        # Delayed messages that are not yet published at the end, or at a reset, are lost.
        self._late = _delays_in_steps(self._outputs, scene, scene.step)
        if not recording.facts and 'joint_states' in motions:
            _refuse_reset(recording, motions['joint_states'], scene)

    def _steps(self, series):
        if self._recording.facts:
            return series.step * self._ratio
        return 1e-9 * (series.ns + self._shift) / self._scene.step

    def _whole_steps(self, series):
        exact, step = self._steps(series), self._scene.step
        whole = _round_up(exact)
        missed = np.abs(whole - exact) > 1e-6
        if missed.any():
            raise ParameterError(
                f'integrator.step = {step:g} s does not meet the times of {series.topic}, such as '
                f'{exact[np.argmax(missed)] * step:.9g} s: take one that divides them')
        return whole

    def last_step(self, duration):
        """Return the step at a duration [s], by default that of the last message."""
        if self._published:
            delays = _delays_in_steps(self._outputs, self._recording.scene, self._scene.step)
            end = max(int((at + delays[name]).max()) for name, at in self._published.items())
        else:
            end = max([self._end, *(int(at.max(initial=0)) for *_, at in self._commands)])
        if duration is None:
            return end
        wanted = steps_in(duration, self._scene.step)
        if self._published and wanted > end:
            raise ParameterError(f'duration = {duration:g} s is beyond the end of the log, '
                                 f'{end * self._scene.step:.9g} s')
        return wanted

    def commands(self, number, end):
        """Return the commands of a segment that act before its end, as in `Segment`."""
        found = [(int(at[k]), kind, series.values[k], series.data[k])
                 for kind, series, at in self._commands
                 for k in np.flatnonzero((series.resets == number) & (at < end))]
        return sorted(found, key=lambda entry: entry[:2])

    def changes(self, number):
        """Return the changes of a segment, as in `Segment`."""
        return [(int(_round_up(step * self._ratio)), values)
                for step, resets, values in self._recording.changes if resets == number]

    def motion(self, number, end):
        """Return the steps of a segment's messages by topic, and their numbers."""
        samples, logged = {}, {}
        for name, at in self._published.items():
            series = self._motions[name]
            which = (series.resets == number) & (at <= end - self._late[name])
            samples[name], logged[name] = at[which], series.values[which]
        return samples, logged

    def samples_of_others(self, samples, first, end, last):
        """Return the steps, by topic, of what the node publishes and the recording lacks."""
        result, values = {}, self._values
        for name, output in self._outputs.items():
            until = end - self._late[name]
            if name in samples or name == '/clock' or (
                    output.delay and not values.get('record_sensors')):
                continue
            if 'joint_states' in samples:  # modal_state, if the scene of the log has no modes
                result[name] = samples['joint_states']
            elif self._motions:
                continue
            else:
                every = whole_ratio('1/integrator.step', 1.0 / self._scene.step, output.rate,
                                    values[output.rate])
                if last // every > _MOST_SAMPLES:
                    raise LogError(
                        f'{self._recording.title} lasts {last * self._scene.step:.3g} s, by its '
                        f'log times, with {last // every} samples of {name}, more than '
                        f'{_MOST_SAMPLES}: give --duration, or cut the bag')
                # A reset is published, too.
                result[name] = np.arange(first - first % every, until + 1, every).clip(first)
            result[name] = result[name][result[name] <= until]
        return result


def _with_timeouts(commands, recording, scene, end):
    """Return commands of a bag, ascending, and zeros where one has been in force for too long."""
    ratio = recording.scene.step / scene.step
    every, since, steps, changed, result = max(1, recording.period) * ratio, {}, 0.0, 0, []
    check_timeout, size = PARAMETERS['command_timeout'].check, recording.scene.step
    settings = [(int(_round_up(step * ratio)), -1, math.ceil(check_timeout(value) / size) * ratio)
                for step, value in recording.timeouts if step * ratio < end]
    for entry in sorted([*commands, *settings, (end, len(COMMANDS))], key=lambda each: each[:2]):
        for group, begun in list(since.items()) if steps else []:
            over = int(_round_up(_round_up(max(begun + steps, changed) / every) * every))
            if over < entry[0]:
                kind = TIMED_OUT[group]
                zeros = np.zeros(len(COMMANDS[kind].columns))
                result.append((over, kind, zeros, pack(COMMANDS[kind].type_name, {})))
                del since[group]
        if entry[1] < 0:
            changed, steps = entry[0], entry[2]
        elif entry[1] < len(COMMANDS):
            for group in COMMANDS[entry[1]].apply(entry[2], np.zeros(COMMANDED)):
                since[group] = entry[0]
            result.append(entry)
    return sorted(result, key=lambda entry: entry[:2])


def _refuse_reset(recording, joints, scene):
    """Raise LogError if joint states in a bag without ~/scene go back to the scene's start."""
    start = scene.initial_motion()
    start = np.append(start[:3], start[len(start) // 2:][:3])
    there = np.isclose(joints.values[:, :6], start, rtol=1e-9, atol=1e-12).all(axis=1)
    again = 1 + np.flatnonzero(there[1:] & ~there[:-1])
    if len(again):
        raise LogError(f'{recording.title}: joint_states go back to the start of the scene at log '
                       f'time {joints.log_ns[again[0]]} ns, as by a reset: cut the bag there, or '
                       f'record {recording.name}/scene, too')


def _delays_in_steps(known, scene, step):
    """Return how many whole steps the messages of each topic come after their measurement."""
    return {name: math.floor(scene.values[output.delay] / step + 1e-6) if output.delay else 0
            for name, output in known.items()}


def _round_up(exact):
    """Return steps as whole numbers, not below 0, but for their rounding errors."""
    whole = np.ceil(exact - _ROUNDING * np.maximum(1.0, np.abs(exact)))
    return np.maximum(whole, 0.0).astype(np.int64)


class Replay:
    """Runs segments and fills in `replayed` and `done`; `diverged` says why it ended early."""

    def __init__(self, scene: Scene, segments: list[Segment],
                 log: NewLog | None = None) -> None:
        self.simulator = Simulator(scene)
        self.simulator.warm_up()
        self.diverged: str | None = None
        self._segments, self._log = segments, log
        self._outputs = {output.name: output for output in scene.outputs}

    def run(self, report: Callable[[int], object] = lambda count: None) -> None:
        """Run all segments; `report(count)` is called after each `count` further steps."""
        for number, segment in enumerate(self._segments):
            if number:
                self.simulator.reset()
                if self._log:
                    self._log.note(RESET, {'step': str(self.simulator.steps)})
            try:
                self._run(segment, report)
            except DivergenceError as error:
                self.diverged = str(error)
                break

    def _run(self, segment, report):
        commanded = np.zeros(COMMANDED)
        topics = [(name, self._outputs[name], segment.samples[name].tolist() + [math.inf])
                  for name in self._outputs if name in segment.samples]
        for name, output, steps in topics:
            segment.replayed[name] = np.empty((len(steps) - 1, len(output.columns)))
            segment.done[name] = 0
        commands, next_command = [*segment.commands, (math.inf,)], 0
        changes, next_change = [*segment.changes, (math.inf,)], 0
        simulator = self.simulator
        while True:
            step, snapshot, following = simulator.steps, None, segment.last
            for name, output, steps in topics:
                place = segment.done[name]
                while steps[place] == step:
                    snapshot = snapshot or simulator.snapshot()
                    numbers = output.numbers(snapshot)
                    segment.replayed[name][place] = numbers
                    if self._log:
                        self._log.output(name, snapshot, numbers)
                    segment.done[name] = place = place + 1
                following = min(following, steps[place])
            while changes[next_change][0] <= step:
                _, values = changes[next_change]
                simulator.change(simulator.scene.vary(values))
                if self._log:
                    self._log.note(CHANGE, change_note(step, values))
                next_change += 1
            if step >= segment.last:
                return
            while commands[next_command][0] <= step:
                _, index, values, data = commands[next_command]
                COMMANDS[index].apply(values, commanded)
                if self._log:
                    self._log.write(index, step, simulator.nanoseconds, data)
                next_command += 1
            following = min(following, commands[next_command][0], changes[next_change][0],
                            step + (1 if has_tip_force(commanded) else _BATCH))
            simulator.advance(following - step, load_of_commands(commanded, simulator))
            report(following - step)


def _comparable(recording, scene, topic):
    """Return which columns of a topic are the same to the last bit, by definition."""
    columns = np.ones(recording.topics[topic].values.shape[1], dtype=bool)
    if topic == 'joint_states' and 'saved_by' in recording.facts:
        columns[6:] = ~scene.build().constrained  # others follow from the motion, by other code
    return columns


def _compare(segments, scene, recording):
    """Return counts of compared and differing numbers; name, largest, rms, time by column."""
    count, differing, result = 0, 0, []
    for output in scene.outputs:
        topic = output.name
        parts = [(segment, slice(segment.done[topic])) for segment in segments
                 if topic in segment.logged and topic in segment.replayed]
        if not parts:
            continue
        time, logged, replayed = (
            np.concatenate([getattr(segment, kind)[topic][part] for segment, part in parts])
            for kind in ('samples', 'logged', 'replayed'))
        columns = _comparable(recording, scene, topic)
        count += len(logged) * columns.sum()
        differing += (int(np.count_nonzero((logged.view('i8') != replayed.view('i8'))[:, columns]))
                      if logged.shape == replayed.shape else logged.size)
        if len(time):
            (names, logged), (others, replayed) = (
                with_angles(recording.topics[topic].columns, logged),
                with_angles(output.columns, replayed))
            for column in [name for name in names if name in others]:
                distance = np.abs(replayed[:, others.index(column)]
                                  - logged[:, names.index(column)])
                place = int(np.argmax(distance))
                result.append((f'{title(topic)} {column}', float(distance[place]),
                               float(np.sqrt(np.mean(distance**2))),
                               float(scene.step * time[place])))
    return count, differing, result


def _count_logged(segments, scene, recording):
    """Return how many numbers of the node's outputs the log has until the end of the replay."""
    series = {output.name: (output, recording.topics[output.name])
              for output in scene.outputs if output.name in recording.topics}
    if not recording.facts:
        return sum(found.values.size for _, found in series.values())
    end = round(segments[-1].last * scene.step / recording.scene.step, 6)
    late = _delays_in_steps({name: output for name, (output, _) in series.items()},
                            recording.scene, recording.scene.step)
    return sum(found.values[found.step + late[name] <= end][
        :, _comparable(recording, scene, name)].size for name, (_, found) in series.items())


def _report(show, recording, segments, again, seconds):
    simulator = again.simulator
    commands = sum(len(segment.commands) for segment in segments)
    sim_time = simulator.steps * simulator.scene.step
    show(f'{recording.title}: {commands} commands and {len(segments) - 1} resets in '
         f'{sim_time:.6g} s of sim time, replayed in {seconds:.2f} s')
    left = sum(len(series.ns) for series in recording.topics.values() if series.data) + sum(
        segment.timeouts for segment in segments) - commands
    if left:
        show(f'{left} commands are left out, because they act after the end or a reset')
    refused = sum(series.refused for series in recording.topics.values())
    if refused:
        show(f'{refused} commands are left out, because the node refuses them')


def _show_table(show, found):
    different = [row for row in found if row[1] or row[1] != row[1]]
    width = max([len(name) for name, *_ in different], default=10)
    show(f'{"difference":<{width}}  {"largest":>9}  {"at":>10}  {"rms":>9}')
    for name, largest, rms, at in different:
        show(f'{name:<{width}}  {largest:9.2e}  {at:8.4g} s  {rms:9.2e}')
    if len(different) < len(found):
        show(f'{len(found) - len(different)} other quantities are the same')
