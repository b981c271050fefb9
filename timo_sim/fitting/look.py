# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What a record says before any search: where it begins, its clock, signs, delays, resonances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from scipy.signal import csd, find_peaks

from timo_sim.fitting.problem import Problem, split_guess
from timo_sim.fitting.record import Channel, Record, unit_of
from timo_sim.fitting.response import Response
from timo_sim.runs.modes import frequencies_in_motion
from timo_sim.scene.numbers import INITIAL
from timo_sim.scene.parameters import ParameterError
from timo_sim.scene.scene import Scene
from timo_sim.topics.commands import JOINTS

GAUGES = 'root_strain', 'tip_acceleration'  # whose gains are known roughly
_SURE, _DEAD = 0.5, 0.1  # correlation that tells a sign; of a range, in which a gauge is not still
_FIRST, _STILL = 15, 5.0  # samples at the beginning; deviations of noise up to which one is still
_ELSEWHERE, _FAST = 0.02, 0.3  # of range and usual speed: from there on it begins otherwise
_GAP = 1.8  # periods from one sample to the next that are a gap
_JUMP, _SMOOTH = 0.5, 0.01  # of the range within three samples: least of a jump, most of others
_LEVELS, _AT_END = 10, 0.02  # least values of what is clipped, least part of samples at an end
_LATE, _BETTER = 3, 0.5  # samples; what a delay leaves of 1 - correlation, at most
_PARTS, _PROMINENCE, _APART = 4, 1.0, 0.1  # of spectra: parts; log of a peak; relative distance
_HEARD = 1e-4, 10.0  # least power, of the largest and of the median, that is not noise


def begin_with(scene: Scene, record: Record,
               free: Iterable[str]) -> tuple[dict[str, float], list[str], list[str]]:
    """
    Return changes of a scene that begins where a record does, what is free, and both in words.

    `free` are texts as for `fit`: what has a value there, or a sensor with a bias, is left alone.
    What changes is free, since the first samples show it roughly.
    """
    given = {name: value for name, value, _ in map(split_guess, free)}
    changes, more, told = {}, [], []
    if isinstance(record, Response) or scene.values['initial.equilibrium']:  # it begins at rest
        return changes, more, told
    for joint, held in zip(JOINTS, scene.build().constrained):
        if held or joint not in record.outputs or f'{joint}.bias' in given:
            continue
        channel = record.outputs[joint]
        (place, speed), _ = _first_of(channel, _FIRST)
        (_, early), error = _first_of(channel, _FIRST // 2)
        usual = _FAST * np.std(np.gradient(channel.values, channel.t))
        # A start from rest has no speed that is the same from fewer samples.
        sure = abs(early - speed) < _FAST * abs(speed)
        for name, found, least, sigma in (
                (f'initial.{joint}', place, _ELSEWHERE * np.ptp(channel.values), error[0]),
                (f'initial.{joint}_velocity', speed, usual if sure else np.inf, error[1])):
            if not given.get(name) and abs(found - scene.values[name]) > max(
                    least, _STILL * sigma):
                changes[name] = float(f'{found:.5g}')
                more += [] if {name, INITIAL} & {*given} else [f'{name}={found!r}~inf']
                told.append(f'{name} = {changes[name]:g} is taken, as {joint} begins, in place of '
                            f'{scene.values[name]:.5g} (give it in --free to keep that, or free '
                            f'{joint}.bias)')
    return changes, more, told


def _first_of(channel, count):
    """Return first value and slope of a channel, (2,), by so many samples, and their errors."""
    t, values = channel.t[:count] - channel.t[0], channel.values[:count]
    powers = np.vander(t / t[-1], 3, increasing=True)
    found, *_ = np.linalg.lstsq(powers, values)
    noise = max(noise_of(channel), np.std(values - powers @ found))
    error = noise * np.sqrt(np.diag(np.linalg.pinv(powers.T @ powers)))
    return [*map(float, found[:2] / [1.0, t[-1]])], [*map(float, error[:2] / [1.0, t[-1]])]


def look(problem: Problem, values: Mapping[str, float]) -> Iterator[str]:
    """Yield what a record says by itself, and beside the run with values by name; about a line."""
    record = problem.record
    if isinstance(record, Response):
        return
    record = record.cut(0.0, problem.until) if problem.until < record.duration else record
    start = min((float(each.t[np.argmax(each.values != 0.0)])
                 for each in record.inputs.values()), default=0.0)
    for name, channel in {**record.inputs, **record.outputs}.items():
        yield from _of_channel(name, channel, start if name in record.outputs else None)
    for name, (t, shown, *_) in record.outputs.items():
        alive = t[np.argmax(shown != shown[0])]
        if name in GAUGES and any(np.ptp(each.values[each.t < alive]) > _DEAD * np.ptp(each.values)
                                  for each in record.outputs.values() if each.t[0] < alive):
            yield (f'{name} stands still until {alive:.3g} s, while the arm is turned: it was not '
                   f'yet read; let the record begin there (start: {alive:.3g})')
    predicted = problem.predicted(values, problem.until)
    for name, measured in problem.measurements(problem.until).items():
        if np.ptp(measured) and np.ptp(predicted[name]):
            yield _beside_run(name, record.outputs[name].t, measured, predicted[name])
    yield from _resonances(record, problem.scene_of(values))


def turned(problem: Problem, values: Mapping[str, float]) -> list[str]:
    """Return gauges that move against the run with values by name, where all else goes with it."""
    if isinstance(problem.record, Response):
        return []
    shown = problem.predicted(values, problem.until)
    like = {name: np.corrcoef(each, shown[name])[0, 1] for name, each in problem.measurements(
        problem.until).items() if np.ptp(each) and np.ptp(shown[name])}
    sure = [each > _SURE for name, each in like.items() if name not in GAUGES]
    return [name for name in GAUGES if like.get(name, 0.0) < -_SURE and sure and all(sure)]


def _of_channel(name, channel, start):
    """Yield what an output shows, or an input, whose start is None."""
    t, values, unit, apart = channel.t, channel.values, unit_of(name), np.diff(channel.t)
    gaps = np.flatnonzero(apart > _GAP * np.median(apart)) if len(apart) > _FIRST else []
    if 0 < len(gaps) < 0.1 * len(apart):
        longest = gaps[np.argmax(apart[gaps])]
        yield (f'{name} has {len(gaps)} gaps, the longest of {apart[longest]:.3g} s at '
               f'{t[longest]:.4g} s: there nothing is compared, and inputs stay as they are')
    ways = np.abs(values[3:] - values[:-3])
    jumps = np.flatnonzero(ways > _JUMP * np.ptp(values))
    if start is not None and len(jumps) and np.median(ways) < _SMOOTH * np.ptp(values):
        yield (f'{name} jumps by {ways.max():.3g} {unit}, first at {t[jumps[0] + 1]:.4g} s: an '
               'angle that wraps, or wrong samples; mend them before the fit')
    levels = np.unique(values)
    steps = np.diff(levels)
    if start is not None and 0 < len(steps) < 0.5 * len(values) and np.allclose(
            steps / steps.min(), np.rint(steps / steps.min()), atol=0.05):
        yield (f'{name} is in steps of {steps.min():.3g} {unit}: nothing finer is known of it, '
               f'and its noise is at least {steps.min() / np.sqrt(12.0):.2g}')
    for end in levels[[0, -1]] if len(levels) >= _LEVELS else ():
        # What stands at an end when it begins or ends may rest there.
        if (share := np.mean(values == end)) > _AT_END and end not in values[[0, -1]] and (
                name not in JOINTS):
            yield f'{name} stands at {end:.4g} {unit} for {share:.0%} of its samples: ' + (
                'if it is cut there, log what acts behind the limit, or set it in the scene'
                if start is None else 'if the sensor is saturated, cut the record there')
    first = values[t < (start or 0.0)]
    if len(first) >= _FIRST and np.ptp(first) > 0.05 * np.ptp(values) > _STILL * noise_of(channel):
        yield (f'{name} moves before the input begins: free initial, or '
               'initial.modal_coordinates[0] and initial.modal_rates[0]')


def _beside_run(name, t, measured, shown):
    """Return how an output and the run of the first guess differ."""
    t = t[:len(measured)]
    grid = np.linspace(t[0], t[-1], len(t))
    a, b = (np.interp(grid, t, each - each.mean()) for each in (measured, shown))
    correlation = float(a @ b / np.sqrt((a @ a) * (b @ b)))
    text = f'{name} and the run of the first guess have a correlation of {correlation:.2f}'
    whole = np.fft.irfft(np.fft.rfft(a, 2 * len(a)) * np.conj(np.fft.rfft(b, 2 * len(a))))
    late = int(np.argmax(whole[:len(a) // 10]))
    best = whole[late] / np.sqrt((a @ a) * (b @ b))
    if correlation < -_SURE:
        text += ': if its sign is wrong, or that of the input, set scale: -1 in the mapping'
    elif late >= _LATE and 1.0 - best < _BETTER * (1.0 - correlation):
        text += (f', and of {best:.2f} with a delay of {late * (grid[1] - grid[0]):.3g} s: free '
                 'one of the input or of this output')
    elif correlation > 0.5 and not 0.5 < (ratio := np.std(a) / np.std(b)) < 2.0:
        text += f', but it is {ratio:.2g} times as large: look at unit, scale and gain'
    return text


def _resonances(record, scene):
    """Yield frequencies at which the last output answers most, beside those of the scene."""
    name = [*record.outputs][-1]
    channel = record.outputs[name]
    count = len(channel.t)
    t = np.linspace(channel.t[0], channel.t[-1], count)
    rate, seen = (count - 1) / (t[-1] - t[0]), np.interp(t, channel.t, channel.values)
    drives = [np.interp(t, each.t, each.values) for each in record.inputs.values()]
    part = max(_FIRST, count // _PARTS)
    f, power = csd(seen, seen, rate, nperseg=part, detrend='linear')
    power = np.abs(power)
    heard = power > max(_HEARD[0] * power.max(), _HEARD[1] * np.median(power))
    for drive in drives[:1]:  # what it answers, over what it is asked
        asked, answer = (np.abs(csd(drive, each, rate, nperseg=part, detrend='linear')[1])
                         for each in (drive, seen))
        power = answer / (asked + _HEARD[0] * asked.max() + 1e-300)
    level = np.log(np.where(heard, power, power[heard].min(initial=1.0)) + 1e-300)
    peaks, found = find_peaks(level, prominence=_PROMINENCE)
    if not len(peaks):
        return
    best = peaks[np.argmax(found['prominences'])]
    before, at, after = level[best - 1:best + 2]  # of a parabola
    best = float(f[1] * (best + 0.5 * (before - after) / (before - 2.0 * at + after)))
    text, all_modes = f'{name} rings at some {best:.3g} Hz', []
    for shaft in dict.fromkeys((scene.values['motor.shaft'], 'locked')):
        try:
            own = frequencies_in_motion(scene.vary({'motor.shaft': shaft}))
        except ParameterError:  # as where the step is too long for what is asked of it
            continue
        all_modes += [*own]
        text += f', the scene with its shaft {shaft} at ' + (
            ', '.join(f'{each:.3g}' for each in own[:3]) or 'none')
    if not all_modes:
        return
    ratio = min((best / each for each in all_modes), key=lambda each: abs(np.log(each)))
    yield text + (f': the nearest would need {ratio**2:.2g} times the stiffness'
                  if abs(ratio - 1.0) > _APART + 0.5 * f[1] / best else '')


def noise_of(channel: Channel) -> float:
    """Return the standard deviation of what changes from sample to sample of a smooth motion."""
    third, steps = np.diff(channel.values, 3), np.abs(np.diff(channel.values))
    step = steps[steps > 0.0].min(initial=np.ptp(channel.values)) * np.any(steps == 0.0)
    return float(max(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0), step / np.sqrt(12.0)))
