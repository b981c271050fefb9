# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Divide a recording at its resets, and find the step at which each command acted."""

from dataclasses import dataclass, field
import math

import numpy as np

from timo_sim.log.records import LogError
from timo_sim.messages.commands import COMMANDS
from timo_sim.messages.outputs import outputs
from timo_sim.scene.parameter import LATEST, Parameter, ParameterError, whole_ratio
from timo_sim.scene.values import steps_in

_ROUNDING = 1e-9
_START = Parameter('start', 0.0, 's', 'sim time of the first message', low=-LATEST, high=LATEST)


@dataclass
class Segment:
    """A part of a run, from its start or a reset to the next reset or its end."""

    first: int      # step
    last: int
    commands: list  # (step, index in COMMANDS, values that it sets, message), ascending
    changes: list   # (step, values by name) of each setting of parameters, ascending
    samples: dict   # by short name of a topic, the steps of its messages, ascending
    logged: dict    # their numbers, shape (n, k), of topics that the log has
    replayed: dict = field(default_factory=dict)  # numbers of the replay at the samples
    done: dict = field(default_factory=dict)      # how many samples were replayed so far


def segments_of(recording, scene, values, start=0.0, duration=None):
    """
    Return the segments of a recording, counted in steps of a scene.

    Parameters
    ----------
    recording : Recording
    scene : Scene
        It may have another time step: a command acts from the next whole step on.
    values : dict
        The node's parameters, for the rates of topics that are not in the recording.
    start : float, optional
        Sim time of the first message of a bag that has no sim time [s].
    duration : float, optional
        Sim time of the end [s]; by default that of the last message.

    Returns
    -------
    list of Segment

    Raises
    ------
    LogError
        If there is nothing to replay.
    ParameterError
        If logged messages are not at whole time steps, or the log is shorter than the duration.

    """
    found = recording.topics
    known = {output.name: output for output in outputs(scene.modal_count)}
    commands = [(number, found[command.name]) for number, command in enumerate(COMMANDS)
                if command.name in found]
    motions = {name: series for name, series in found.items() if name in known and len(series.ns)}
    if not any(len(series.ns) for series in found.values()):
        raise recording.lacks(f'messages of {recording.name}')
    changed = [int(recording.resets_before(*when)) for *when, _ in recording.changes]
    for topic, resets in (*((series.topic, series.resets) for series in found.values()),
                          ('a setting', np.array(changed))):
        if (resets < 0).any():
            raise LogError(f'{recording.title} is in another order than it was logged in: '
                           f'whether {topic[:80]} at the step of a reset was before or after it '
                           'is not known')
    shift = _shift(recording, [series for _, series in commands], motions, start)

    def steps(series, must_fit):
        if recording.facts:
            exact = series.step * (recording.scene.step / scene.step)
        else:
            exact = 1e-9 * (series.ns + shift) / scene.step
        return _whole(exact, must_fit, scene.step, series.topic)

    # The motion in a plain bag is not compared: when commands began to act is not known exactly.
    own = motions if recording.facts else {}
    acting = [(number, series, steps(series, False)) for number, series in commands]
    published = {name: steps(series, True) for name, series in own.items()}
    delays = late_steps(known, recording.scene, scene.step) if own else {}
    last = _last(acting, {name: at + delays[name] for name, at in published.items()}, motions,
                 shift, scene, duration)
    if recording.facts:
        resets = _steps_of(recording.resets, recording, scene)
        before = [series.resets for _, series, _ in acting]
    else:
        logged, ns = _resets_of_bag(motions, scene)
        resets = _whole(1e-9 * ns / scene.step, False, scene.step, 'the resets')
        before = [np.searchsorted(logged, series.log_ns, 'right') for _, series, _ in acting]
    ends = [*resets.tolist(), last]
    unasked = {'/clock', *(name for name, output in known.items()
                           if output.delay and not values.get('record_sensors'))}
    # Late messages that are under way at the end, or at a reset, do not arrive.
    late = late_steps(known, scene, scene.step)
    result = []
    for number, end in enumerate(ends):
        first = ends[number - 1] if number else 0
        end = min(end, last)
        if end < first:
            break
        inside = [(int(at[k]), kind, series.values[k], series.data[k])
                  for (kind, series, at), count in zip(acting, before)
                  for k in np.flatnonzero((count == number) & (at < end))]
        changes = [(int(_steps_of(step, recording, scene)), values)
                   for count, (step, _, values) in zip(changed, recording.changes)
                   if count == number]
        until = {name: end - steps for name, steps in late.items()}
        samples, logged = {}, {}
        for name, at in published.items():  # what arrives in time
            which = (own[name].resets == number) & (at <= until[name])
            samples[name], logged[name] = at[which], own[name].values[which]
        for name in known.keys() - samples.keys() - unasked:
            if 'joint_states' in samples:  # modal_state, if the scene of the log has no modes
                at = samples['joint_states']
                samples[name] = at[at <= until[name]]
            elif not own:
                rate = known[name].rate
                every = whole_ratio('1/integrator.step', 1.0 / scene.step, rate, values[rate])
                at = np.arange(first, until[name] + 1)
                samples[name] = at[(at % every == 0) | (at == first)]  # a reset is published
        result.append(Segment(first, end, sorted(inside, key=lambda entry: entry[:2]), changes,
                              samples, logged))
    return result


def _resets_of_bag(motions, scene):
    """Return log and sim times [ns] at which a bag's motion is suddenly that of the start."""
    motion = scene.initial_motion()
    for name, part in (('joint_states', slice(3)), ('~/modal_state', slice(3, None))):
        start = np.concatenate([half[part] for half in np.split(motion, 2)])
        series = motions.get(name)
        if series is None or series.values.shape[1] < len(start):
            continue
        there = np.isclose(series.values[:, :len(start)], start, rtol=1e-9, atol=1e-12).all(axis=1)
        again = 1 + np.flatnonzero(there[1:] & ~there[:-1])
        if len(again):
            return series.log_ns[again], series.ns[again]
    return np.zeros(0), np.zeros(0)


def _steps_of(steps, recording, scene):
    # Steps of a recording, converted to those of a scene.
    ratio = recording.scene.step / scene.step
    return np.ceil(np.asarray(steps) * ratio - _ROUNDING).astype(int)


def late_steps(known, scene, step):
    """Return how many whole steps the messages of each topic come after their measurement."""
    return {name: math.floor(scene.values[output.delay] / step + 1e-6) if output.delay else 0
            for name, output in known.items()}


def _shift(recording, commands, motions, start):
    """Return the difference of sim time from the stamps of a bag [ns]."""
    if recording.facts or motions:
        return 0
    return round(1e9 * _START.check(start)) - min(
        int(series.ns[0]) for series in commands if len(series.ns))


def _whole(exact, must_fit, step, topic):
    """Return times in steps, rounded up; raise ParameterError if they must fit and do not."""
    whole = np.ceil(exact - _ROUNDING * np.maximum(1.0, np.abs(exact))).astype(np.int64)
    missed = np.abs(whole - exact) > 1e-6
    if must_fit and missed.any():
        raise ParameterError(
            f'integrator.step = {step:g} s does not meet the times of {topic}, such as '
            f'{exact[np.argmax(missed)] * step:.9g} s: take one that divides them')
    return np.maximum(whole, 0)


def _last(acting, published, motions, shift, scene, duration):
    ends = [at.max(initial=0) for at in published.values()]
    if not published:
        ends += [at.max(initial=0) for _, _, at in acting]
        ends += [math.floor(1e-9 * (series.ns.max(initial=0) + shift) / scene.step)
                 for series in motions.values()]
    end = int(max(ends))
    if duration is None:
        return end
    wanted = steps_in(duration, scene.step)
    if published and wanted > end:
        raise ParameterError(f'duration = {duration:g} s is beyond the end of the log, '
                             f'{end * scene.step:.9g} s')
    return wanted
