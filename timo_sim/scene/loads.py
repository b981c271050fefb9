# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Loads that a scene prescribes over time, the angle of a driven shaft, and loads at the tip.

Loads are harmonic, piecewise constant, linear between points, or sums of those. A piecewise
constant one is a table that jumps from 0 on. `steps.loads` computes what the steps see of them. A
jump inside a step is refused.
"""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
import math
from typing import Any

import numpy as np

from timo_sim.compiled.functions import WIDTH
from timo_sim.model.layout import ACCELERATION, ANGLE, INPUTS, LOADS, SPEED, STEP_LOADS
from timo_sim.scene.parameters import ParameterError, same_length, short, whole_ratio
from timo_sim.steps.loads import add_scene_loads, NEAR, PIECE, SceneLoads

# Columns of the inputs that a scene may prescribe over time, by name, and these with place and
# speed of a driven carrier and the angle of a driven shaft.
CHANNELS = {each.name: column for column, each in enumerate(INPUTS) if each.prescribed}
SHAFT_DRIVE = 'angle'
CURVES = {each.name: column for column, each in enumerate(INPUTS)
          if each.prescribed or each.name.startswith('carrier_') or each.name == SHAFT_DRIVE}


@dataclass(frozen=True)
class Harmonic:
    """amplitude sin(2 pi frequency t + phase); frequency in [Hz], phase in [rad]."""

    amplitude: float
    frequency: float
    phase: float


def _pieces(time, *coefficients):
    """Return pieces of curves that begin at times [s], with polynomials, constant first."""
    found = np.zeros((len(time), PIECE))
    for k, each in enumerate((time, *coefficients)):
        found[:, k] = each
    return found


@dataclass(frozen=True)
class Table:
    """Linear between (time[i] [s], value[i]), constant outside; a repeated time is a jump."""

    time: Sequence[float] | np.ndarray
    value: Sequence[float] | np.ndarray

    def jumps(self) -> Sequence[float]:
        """Return the times at which it jumps [s]."""
        return tuple(a for a, b in zip(self.time, self.time[1:]) if a == b)

    def rows(self, step: float) -> np.ndarray:
        """Return its pieces for steps of this size, see `SceneLoads`."""
        time, value = on_boundaries(self.time, step), np.asarray(self.value)
        length, slope = np.diff(time), np.zeros(len(time) + 1)
        np.divide(np.diff(value), length, out=slope[1:-1], where=length > 0.0)
        return _pieces(np.append(time[:1], time), np.append(value[:1], value), slope)


@dataclass(frozen=True)
class Drive:
    """
    The angle of a driven shaft: quintic polynomials between points, then constant speed.

    Neighbouring polynomials have the same angle, speed and acceleration at their common point. For
    a place of a driven carrier read [m]; of order 1 it is its speed, of order 2 its acceleration.
    """

    time: tuple          # [s], the first 0
    angle: tuple         # [rad]
    speed: tuple         # [rad/s]
    acceleration: tuple  # [rad/s2], the last 0
    order: int = 0

    def rows(self, step: float) -> np.ndarray:
        """Return its pieces for steps of this size, see `SceneLoads`."""
        time = on_boundaries(self.time, step)
        angle, speed, half = np.array([self.angle, self.speed, self.acceleration]) * [
            [1.0], [1.0], [0.5]]
        found = _pieces(time, angle, speed, half)
        h = np.diff(time)
        # What the parabola of a point lacks at the next one, times powers of h.
        lacking = np.stack([
            np.diff(angle) - h * (speed[:-1] + h * half[:-1]),
            h * (np.diff(speed) - 2.0 * h * half[:-1]), h * h * np.diff(half)])
        cubic = np.array([[10.0, -4.0, 1.0], [-15.0, 7.0, -2.0], [6.0, -3.0, 1.0]])
        found[:-1, 4:] = (cubic @ lacking / h ** np.array([[3], [4], [5]])).T
        for _ in range(self.order):
            found[:, 1:-1], found[:, -1] = found[:, 2:] * np.arange(1, PIECE - 1), 0.0
        return found


@dataclass(frozen=True)
class Load:
    """The loads of a scene, and what drives it: terms to be summed by names of `CURVES`."""

    terms: dict[str, tuple[Any, ...]]

    def __bool__(self):
        return any(self.terms.values())

    @property
    def columns(self) -> list[int]:
        """The columns of loads that are not zero, see `model.layout`, a list of int."""
        found = [CURVES[channel] for channel, terms in self.terms.items() if terms]
        return [*found, *range(SPEED, ACCELERATION + 1)] if ANGLE in found else found

    def fastest(self) -> tuple[float, str]:
        """Return the highest frequency of a harmonic term [Hz] and its channel, or (0, '')."""
        return max(((term.frequency, channel) for channel, terms in self.terms.items()
                    for term in terms if isinstance(term, Harmonic)), default=(0.0, ''))

    def stages(self, first: int, count: int, step: float,
               room: np.ndarray | None = None) -> np.ndarray:
        """
        Return the loads of steps first, first + 1, ..., shape (count, 4, LOADS), see `layout`.

        If `room`, an array for at least as many steps, is given, they are written there and a view
        is returned.
        """
        loads = np.empty((count, STEP_LOADS, LOADS)) if room is None else room[:count]
        loads[:] = 0.0
        rows = self.rows(step)
        add_scene_loads(
            step, rows.harmonics, len(rows.harmonics), rows.curves, len(rows.curves), rows.pieces,
            first, count, loads, np.empty(WIDTH))
        return loads

    def rows(self, step: float) -> SceneLoads:
        """Return the constants of its terms for steps of a size [s]; they are made once."""
        known = self.__dict__.setdefault('_rows', {})
        if step not in known:
            harmonics, curves, pieces = [], [], [np.empty((0, PIECE))]
            for column, term in ((CURVES[channel], term) for channel, terms in self.terms.items()
                                 for term in terms):
                if isinstance(term, Harmonic):
                    harmonics.append((column, term.amplitude, term.frequency,
                                      math.fmod(term.phase, 2.0 * math.pi)))
                else:
                    begin = sum(map(len, pieces))
                    pieces.append(term.rows(step))
                    curves.append((column, begin, begin + len(pieces[-1])))
            known[step] = SceneLoads(
                step, np.array(harmonics, dtype=float).reshape(-1, 4),
                np.array(curves, dtype=float).reshape(-1, 3), np.concatenate(pieces))
        return known[step]


def on_boundaries(times: Any, step: float) -> np.ndarray:
    """Return times [s], with those near the boundary of two steps moved onto it, (n,)."""
    times = np.asarray(times, dtype=float)
    whole = np.rint(times / step)
    return np.where(np.abs(times / step - whole) <= NEAR, whole * step, times)


# Parameters of a load's terms, by its name.
TERM_NAMES = {channel: tuple(f'load.{channel}.{name}' for name in (
    'harmonic.amplitude', 'harmonic.frequency', 'harmonic.phase', 'piecewise.time',
    'piecewise.value', 'table.time', 'table.value'))
    for channel in CHANNELS}


def load_of(values: Mapping[str, Any]) -> Load:
    """Return the Load that the values describe, or raise ParameterError."""
    terms = {channel: _terms_of(channel, tuple([values[name] for name in names]),
                                values['integrator.step'])
             for channel, names in TERM_NAMES.items()}
    return Load({**terms, **_carrier_drive(values), SHAFT_DRIVE: _drive(values)})


@lru_cache(maxsize=4 * len(TERM_NAMES))
def _terms_of(channel, given, step):
    # Equal terms are one object, so that scenes under the same load can share what follows of it.
    values = dict(zip(TERM_NAMES[channel], given))
    return tuple(_terms(f'load.{channel}', values, step)) if any(given) else ()


def _terms(prefix, values, step):
    yield from _harmonics(values, *(f'{prefix}.harmonic.{part}' for part in (
        'amplitude', 'frequency', 'phase')))
    for kind, ordered in ('piecewise', np.less), ('table', np.less_equal):
        names = f'{prefix}.{kind}.time', f'{prefix}.{kind}.value'
        time, value = same_length({name: values[name] for name in names})
        if not time:
            continue
        if not np.all(ordered(time[:-1], time[1:])):
            raise ParameterError(f'{names[0]} must ascend, got {short(list(time))}')
        table = Table(time, value) if kind == 'table' else Table(
            tuple(np.repeat(time, 2).tolist()), (0.0, *np.repeat(value, 2).tolist()[:-1]))
        for jump in table.jumps():
            place = bisect_left(time, jump)
            whole_ratio(f'{names[0]}[{place}]', jump, 'integrator.step', step)
        yield replace(table, time=_whole(table.time, step))


def _harmonics(values, amplitude, frequency, phase):
    # The harmonic terms of parameters with these names.
    return [*map(Harmonic, *same_length({
        amplitude: values[amplitude], frequency: values[frequency],
        phase: values[phase] or (0.0,) * len(values[amplitude])}))]


def _whole(time, step):
    # What is on a boundary of two steps stays there, however the steps are divided.
    return tuple(on_boundaries(time, step).tolist())


def _curve(values, names):
    # The Drive of points, whose times, places, speeds and accelerations have these names, or ().
    time, place, speed, acceleration = same_length({name: values[name] for name in names})
    if not time:
        return ()
    if time[0] != 0.0 or not np.all(np.less(time[:-1], time[1:])):
        raise ParameterError(f'{names[0]} must ascend from 0, got {short(list(time))}')
    if acceleration[-1] != 0.0:
        raise ParameterError(f'{names[3]} must end with 0, since what is driven goes on at the '
                             f'last speed; got {acceleration[-1]}')
    return Drive(_whole(time, values['integrator.step']), place, speed, acceleration),


def _drive(values):
    shaft, count = values['motor.shaft'], len(values['motor.drive.time'])
    drive = _curve(values, [f'motor.drive.{name}' for name in (
        'time', 'angle', 'speed', 'acceleration')])
    if (shaft == 'driven') != bool(count):
        raise ParameterError(f'motor.drive must be given with motor.shaft = driven, and only '
                             f'then; got {count} points with motor.shaft = {shaft}')
    return drive if shaft != 'locked' else (
        Drive((0.0,), (values['initial.shaft'],), (0.0,), (0.0,)),)


def _carrier_drive(values):
    # Terms of place, speed and acceleration of a driven carrier, by name of channel.
    found: dict[str, tuple[Any, ...]] = {}
    drive, wave = 'carrier.drive.', 'carrier.drive.harmonic.'
    for given, prefix in (f'{drive}time', drive), (f'{wave}frequency', wave):
        if values[given] and not (values[f'{prefix}x'] or values[f'{prefix}y']):
            raise ParameterError(f'{prefix}x or {prefix.removeprefix(drive)}y must be given '
                                 f'with {given}')
    for axis in 'xy':
        names = [f'{drive}{name}' for name in (
            'time', axis, f'{axis}_speed', f'{axis}_acceleration')]
        curve = _curve(values, names) if any(values[name] for name in names[1:]) else ()
        waves = _harmonics(values, f'{wave}{axis}', f'{wave}frequency', f'{wave}phase') if (
            values[f'{wave}{axis}']) else ()
        for order, name in enumerate(('place', 'speed', 'acceleration')):
            parts = *(replace(each, order=order) for each in curve), *(
                Harmonic(each.amplitude * (2.0 * np.pi * each.frequency)**order, each.frequency,
                         each.phase + 0.5 * np.pi * order) for each in waves)
            if parts:
                found[f'carrier_{name}_{axis}'] = parts
    return found


def payloads_of(values: Mapping[str, Any]) -> tuple[tuple[int, float, float, float], ...]:
    """Return steps at which the load at the tip changes, with mass, inertia, offset from then."""
    given = {name: values[f'payload.{name}'] for name in ('time', 'mass', 'inertia', 'offset')}
    if not any(given.values()):
        return ()
    if not given['offset']:
        if given['time'] and values['end_effector.offset']:
            raise ParameterError('payload.offset must be given with end_effector.offset = '
                                 f'{values["end_effector.offset"]:g}, got []')
        given['offset'] = (0.0,) * len(given['time'])
    times, *tips = same_length({f'payload.{name}': each for name, each in given.items()})
    if not np.all(np.less(times[:-1], times[1:])):
        raise ParameterError(f'payload.time must ascend, got {short(list(times))}')
    steps = [whole_ratio(f'payload.time[{k}]', time, 'integrator.step', values['integrator.step'])
             for k, time in enumerate(times)]
    return tuple(zip(steps, *tips))
