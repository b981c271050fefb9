# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Predictions of a record by runs of a scene with free parameters, and their distance from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math
from typing import Any
import warnings

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline, make_lsq_spline
from scipy.signal import lfilter

from timo_sim.fitting.record import Channel, DRIVE, OUTPUTS, Record, unit_of
from timo_sim.model.layout import INPUTS
from timo_sim.runs.run import Run, run_scene
from timo_sim.scene.loads import Load, on_boundaries, parabolas, Term
from timo_sim.scene.parameters import did_you_mean, ModelWarning, ParameterError, short
from timo_sim.scene.scene import (
    INITIAL, initial_names, initial_scale, motor_constants, number_of, overrides_of, Scene)
from timo_sim.simulation.warnings import DivergenceError

# What a quantity of the record is multiplied by, added to and late by; only an output has a lag.
SENSOR = {'gain': 1.0, 'bias': 0.0, 'delay': 0.0, 'lag': 0.0}
_MOST_FACTOR = 1e3  # by which a positive parameter may differ from its start


@dataclass(frozen=True)
class Free:
    """
    A free parameter.

    Attributes
    ----------
    name : str
        Of the scene, with [k] for an element of a list, or QUANTITY.gain, .bias, .delay, .lag.
    start, low, high : float
        First value and bounds, in the unit of the parameter.
    scale : float
        Change that matters, in the same unit; of a logarithm 1.
    log : bool
        Whether the fit works with its logarithm, and `scale` is a part of the value.
    unit : str

    """

    name: str
    start: float
    low: float
    high: float
    scale: float
    log: bool
    unit: str

    def coordinate(self, value: float) -> float:
        """Return the coordinate of the fit for a value."""
        with np.errstate(divide='ignore'):
            return np.log(value) if self.log else value / self.scale

    def value(self, coordinate: float) -> float:
        """Return the value for a coordinate."""
        return math.exp(coordinate) if self.log else float(coordinate * self.scale)


def free_parameters(names: Sequence[str], bounds: Mapping[str, Sequence[float]], scene: Scene,
                    record: Record) -> list[Free]:
    """
    Return the Free parameters of a fit.

    Parameters
    ----------
    names : sequence of str
        See `fit`.
    bounds : dict
        (low, high) by name.
    scene : Scene
    record : Record

    Raises
    ------
    ParameterError
        If a name is unknown or given twice, or a start is outside of its bounds.

    """
    wanted = [each for name in names for each in (
        initial_names(scene) if name == INITIAL else [name])]
    if not wanted:
        raise ParameterError('a fit must have at least one free parameter, got none')
    for place, name in enumerate(wanted):
        if name in wanted[:place]:
            raise ParameterError(f'{name} is free twice')
    for name in bounds:
        if name not in wanted:
            raise ParameterError(f'bounds of {short(name, str)} need it to be free; free are '
                                 f'{", ".join(wanted)}{did_you_mean(name, wanted)}')
    return [_free(name, bounds.get(name), scene, record) for name in wanted]


def _free(name, bounds, scene, record):
    quantity, _, kind = name.rpartition('.')
    channels = {**record.inputs, **record.outputs}
    if quantity in channels and kind in SENSOR and (kind != 'lag' or quantity in record.outputs):
        values = channels[quantity].values
        # A lag begins above its bound of 0, because a search leaves a bound slowly.
        start = 2.0 * record.period if kind == 'lag' else SENSOR[kind]
        low, high, scale, log, unit = {
            'gain': (0.0, math.inf, 1.0, True, ''),
            'bias': (-math.inf, math.inf, float(np.std(values)) or 1.0, False, unit_of(quantity)),
            'delay': (-0.1 * record.duration, 0.1 * record.duration, 10.0 * record.period, False,
                      's'),
            'lag': (0.0, 0.1 * record.duration, 10.0 * record.period, False, 's'),
        }[kind]
    else:
        parameter, start = number_of(
            name, scene, ' nor QUANTITY.gain, .bias, .delay or .lag of ' + ', '.join(channels),
            [f'{channel}.{kind}' for channel in channels for kind in SENSOR])
        low, high, unit = parameter.low, parameter.high, parameter.unit
        log = low == 0.0
        scale = initial_scale(name, scene) if name.startswith(INITIAL) else max(abs(start), 1.0)
        scale = 1.0 if log else scale
        if log and start == 0.0:
            raise ParameterError(f'{name} must be > 0 {unit} in the scene to be fitted, since its '
                                 'first value is a guess to begin with; got 0')
    given = (-math.inf, math.inf) if bounds is None else bounds
    try:
        given = float(given[0]), float(given[1])
        good = len(bounds or given) == 2 and given[0] < given[1]
    except (TypeError, ValueError, IndexError):
        good = False
    if not good:
        raise ParameterError(f'bounds of {name} must be two ascending numbers, got '
                             f'{short(bounds)}')
    low, high = max(low, given[0]), min(high, given[1])
    if log:
        low, high = max(low, start / _MOST_FACTOR), min(high, start * _MOST_FACTOR)
    if not low <= start <= high:
        raise ParameterError(f'{name} = {start:g} must be within its bounds, {low:g} to {high:g}, '
                             'where the fit begins')
    return Free(name, start, low, high, scale, log, unit)


_NEAREST = 5  # samples to each side from which the angle and speed of the shaft are taken


def initial_states(problem: Problem, values: Mapping[str, float]) -> list[list[Free]]:
    """
    Return the Free parameters of the initial state of each window.

    Their first values are the motion of one run of the whole record; those of the shaft are
    measured ones, if the record has its angle.
    """
    try:
        run = problem.run(values, 0.0, problem.until)
    except DivergenceError as error:
        run = error.run
    found = []
    for window in problem.windows:
        motion = run.motion[min(round(window.begin / run.scene.step), len(run.t) - 1)]
        half = len(motion) // 2
        guess = dict(zip(('initial.carrier_x', 'initial.carrier_y', 'initial.shaft'), motion))
        guess |= dict(zip((f'{name}_velocity' for name in [*guess]), motion[half:half + 3]))
        guess |= _measured_shaft(problem, window.begin, values)
        scene = problem.scene.vary({
            **{name: float(value) for name, value in guess.items() if name in window.names},
            'initial.modal_coordinates': motion[3:half], 'initial.modal_rates': motion[half + 3:]})
        found.append(free_parameters(window.names, {}, scene, problem.record))
    return found


def _measured_shaft(problem, begin, values):
    channel = problem.record.outputs.get('shaft')
    if channel is None:
        return {}
    sensor = problem.sensor(values)
    t = channel.t - begin - sensor('shaft', 'delay')
    place = np.searchsorted(t, 0.0)
    near = slice(max(0, place - _NEAREST), place + _NEAREST + 1)
    speed, angle = np.polyfit(t[near], (channel.values[near] - sensor('shaft', 'bias'))
                              / sensor('shaft', 'gain'), 1)
    return {'initial.shaft': angle, 'initial.shaft_velocity': speed}


_DEGREE = 5  # of the spline through a driven angle, whose acceleration is smooth


class Sampled(Term):
    """
    A load given by samples.

    A step sees the mean of values that hold, so that the impulse is right if they change inside
    it. Values that are joined by straight lines act as the table of a scene.

    Parameters
    ----------
    channel : Channel
    gain, bias, delay : float
        The load is `gain u(t - delay) + bias`; the delay is in [s].
    shift : float
        Time in the record at which the scene's begins [s].

    """

    def __init__(self, channel: Channel, gain: float = 1.0, bias: float = 0.0,
                 delay: float = 0.0, shift: float = 0.0) -> None:
        t, values = channel.t + (delay - shift), gain * channel.values + bias
        self._t, self._values, self._holds = t, values, channel.hold == 'zero'
        # The integral begins at the first sample, before which its value holds.
        self._integral = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(t))])

    def stages(self, first: int, count: int, step: float) -> np.ndarray:
        if self._holds:
            impulse = np.diff(self._integrate(step * np.arange(first, first + count + 1)))
            return (impulse / step)[:, np.newaxis]
        at = 0.5 * step * np.arange(2 * first, 2 * (first + count) + 1)
        values = np.interp(at, self._t, self._values)
        return np.column_stack([values[:-2:2], values[1::2], values[2::2]])

    def parabolas(self, first: int, count: int,
                  step: float) -> tuple[np.ndarray, np.ndarray]:
        if self._holds:
            return super().parabolas(first, count, step)
        return parabolas(lambda at: np.interp(at * step, self._t, self._values),
                         on_boundaries(self._t / step), 1, first, count)

    def _integrate(self, at):
        place = np.clip(np.searchsorted(self._t, at, side='right') - 1, 0, None)
        return self._integral[place] + self._values[place] * (at - self._t[place])


class Driven(Term):
    """
    The angle of a driven shaft, a spline through samples; before and after them it stays.

    Parameters are as for `Sampled`.
    """

    def __init__(self, channel: Channel, gain: float = 1.0, bias: float = 0.0,
                 delay: float = 0.0, shift: float = 0.0) -> None:
        self._spline = _spline(channel.t.tobytes(), channel.values.tobytes(), channel.knots)
        self._ends, self._late = channel.t[[0, -1]], delay - shift
        self._gain, self._bias = gain, bias

    def stages(self, first: int, count: int, step: float) -> np.ndarray:
        """Return angle, speed and acceleration at the stages of steps, shape (count, 3, 3)."""
        at = 0.5 * step * np.arange(2 * first, 2 * (first + count) + 1) - self._late
        inside = (self._ends[0] <= at) & (at <= self._ends[1])
        motion = self._gain * np.stack([
            self._spline(np.clip(at, *self._ends), order) * (inside if order else 1.0)
            for order in range(3)], axis=-1)
        motion[:, 0] += self._bias
        return np.stack([motion[:-2:2], motion[1::2], motion[2::2]], axis=1)


def loads_of(record: Record, scene: Scene, sensors: Callable[[str, str], float],
             shift: float = 0.0) -> Load:
    """
    Return the Load of a scene under its own loads and the inputs of a record.

    Parameters
    ----------
    record : Record
    scene : Scene
    sensors : function(str, str) -> float
        The gain, bias or delay of a quantity, by its name.
    shift : float
        Time in the record at which the scene's begins [s].

    """
    terms: dict[str, list[Term]] = {name: [*own] for name, own in scene.load.terms.items()}
    drive: Any = scene.load.drive
    for name, channel in record.inputs.items():
        gain, bias, delay = (sensors(name, kind) for kind in ('gain', 'bias', 'delay'))
        if name == DRIVE:
            drive = Driven(channel, gain, bias, delay, shift)
            continue
        if name == 'voltage':
            constant = motor_constants(scene.values)[0]
            gain, bias, name = constant * gain, constant * bias, 'torque'
        terms.setdefault(name, []).append(Sampled(channel, gain, bias, delay, shift))
    return Load({name: tuple(found) for name, found in terms.items()}, drive)


def limit_inputs(record: Record, values: Mapping[str, Any]) -> Record:
    """Return a record whose inputs are what a scene's actuators make of them, by its values."""
    for each in INPUTS:
        if each.name in record.inputs and each.needs and not values[each.needs]:
            raise ParameterError(f'the record has the input {each.name}, which needs '
                                 f'{each.needs} > 0, got 0')
    inputs = dict(record.inputs)
    for name, *_, limit, rate, _ in INPUTS:
        if name in inputs and limit and np.isfinite(values[limit]):
            goals = np.clip(inputs[name].values, -values[limit], values[limit])
            inputs[name] = inputs[name]._replace(values=goals)
        if name in inputs and rate and np.isfinite(values[rate]):
            inputs[name] = _ramp(inputs[name], values[rate])
    return replace(record, inputs=inputs)


def _ramp(channel, rate):
    """Return a channel that moves to each of its values on a straight line of this slope."""
    if channel.hold != 'zero':
        raise ParameterError('an input with a limited rate must have hold: zero, because its '
                             'values are goals')
    t, values, now = [channel.t[0]], [channel.values[0]], channel.values[0]
    for begin, end, goal in zip(channel.t, [*channel.t[1:], np.inf], channel.values):
        if goal == now:
            continue
        reached = min(begin + abs(goal - now) / rate, end)
        if begin > t[-1]:
            t.append(begin)
            values.append(now)
        now = goal if reached < end else now + np.sign(goal - now) * rate * (end - begin)
        t.append(reached)
        values.append(now)
    return channel._replace(t=np.array(t), values=np.array(values), hold='linear')


@functools.lru_cache(maxsize=4)
def _spline(t, angle, knots):
    t, angle = np.frombuffer(t), np.frombuffer(angle)
    if not knots:
        return make_interp_spline(t, angle, _DEGREE)
    count = max(1.0, np.rint((t[-1] - t[0]) / knots))
    try:
        if count + _DEGREE > len(t):
            raise ValueError
        ends, inner = np.ones(_DEGREE), np.linspace(t[0], t[-1], int(count) + 1)
        found = make_lsq_spline(
            t, angle, np.concatenate([inner[0] * ends, inner, inner[-1] * ends]), _DEGREE)
        if not np.isfinite(found.c).all():
            raise ValueError
        return found
    except (ValueError, np.linalg.LinAlgError):
        raise ParameterError(f'knots of {DRIVE} must be further apart than its samples, also '
                             f'where these have gaps, got {knots:g} s') from None


_AT_STEP = 1e-6   # [steps] distance from a step within which a sample is taken at it
_MOST_STEPS = 1e7
_DIVERGED = 1e3   # residual, in standard deviations, of a run that diverges


@dataclass(frozen=True)
class Window:
    """A part of a record that is predicted from an initial state of its own."""

    begin: float            # [s]
    end: float              # [s], excluded but for the last window
    names: tuple[str, ...]  # free parameters of its initial state; empty: that of the scene


class Problem:
    """
    A record, the scene that shall predict it, and the parameters that are free.

    Parameters
    ----------
    scene : Scene
    record : Record
    names : sequence of str
    bounds : dict
    until : float
        End of the part to which the parameters are fitted [s].
    window : float, optional
        Length of windows that are predicted from initial states of their own [s].

    Attributes
    ----------
    free : list of Free
    windows : list of Window

    """

    def __init__(self, scene: Scene, record: Record, names: Sequence[str],
                 bounds: Mapping[str, Sequence[float]], until: float,
                 window: float | None = None) -> None:
        if DRIVE in record.inputs and scene.values['motor.shaft'] != 'driven':
            scene = scene.vary({'motor.shaft': 'driven', 'motor.drive': {
                'time': [0.0], 'angle': [0.0], 'speed': [0.0], 'acceleration': [0.0]}})
        if DRIVE not in record.inputs and scene.values['motor.shaft'] == 'driven' and (
                window or not scene.load.drive):
            raise ParameterError('motor.shaft = driven needs a record of the input drive')
        if record.duration > _MOST_STEPS * scene.step:
            raise ParameterError(f'the record lasts {record.duration:g} s, but at most '
                                 f'{_MOST_STEPS:g} steps of {scene.step:g} s are fitted: cut it, '
                                 'if the unit of its times is right')
        self.scene, self.until = scene, until
        self.record = limit_inputs(record, scene.values)
        self.free = free_parameters(names, bounds, scene, record)
        self.windows = [Window(0.0, until, ())]
        self._own = set(initial_names(scene)) if window else set()
        if window:
            self._divide(window)
        still = not (scene.load or scene.load.drive or scene.initial_motion()[3:].any()
                     or scene.build().gravity.any())
        if still and not record.inputs and not any(name.startswith(INITIAL) for name in names):
            raise ParameterError('nothing moves the arm: the record has no input, and the scene '
                                 'no load, no motion at the beginning and no gravity')

    def _divide(self, window):
        if self.scene.load or self.scene.payloads or self.scene.values['initial.equilibrium']:
            raise ParameterError('windows need a scene without loads, payloads and '
                                 'initial.equilibrium of its own, which have their times')
        fixed = [free.name for free in self.free if free.name in self._own]
        if fixed:
            raise ParameterError(f'{fixed[0]} cannot be free with windows, which have initial '
                                 'states of their own')
        if not window >= 10.0 * self.scene.step:
            raise ParameterError('window must be at least ten steps, '
                                 f'{10.0 * self.scene.step:g} s, got {window:g}')
        count = max(1, round(self.until / window))
        edges = self.scene.step * np.rint(
            np.linspace(0.0, self.until, count + 1) / self.scene.step)
        names = tuple(initial_names(self.scene))
        self.windows = [Window(begin, end, names) for begin, end in zip(edges, edges[1:])]

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Return the values of the free parameters, by name, for coordinates of the fit."""
        return {free.name: free.value(each) for free, each in zip(self.free, x)}

    def scene_of(self, values: Mapping[str, float],
                 initial: Mapping[str, float] | None = None) -> Scene:
        """Return the scene with free values, and an initial state, without the record's loads."""
        own = {name: value for name, value in values.items() if not self._is_sensor(name)}
        return self.scene.vary(overrides_of({**own, **(initial or {})}, self.scene))

    def _is_sensor(self, name):
        quantity, _, kind = name.rpartition('.')
        return kind in SENSOR and (quantity in self.record.inputs
                                   or quantity in self.record.outputs)

    def run(self, values: Mapping[str, float], begin: float = 0.0, end: float | None = None,
            initial: Mapping[str, float] | None = None, scene: Scene | None = None) -> Run:
        """
        Return the Run that predicts a part of the record.

        Parameters
        ----------
        values : dict
            Free values by name.
        begin, end : float
            In the record [s]; by default all of it.
        initial : dict, optional
            Values of the initial state, by name.
        scene : Scene, optional
            By default `scene_of(values, initial)`.

        Raises
        ------
        DivergenceError
            If the run diverges.
        ParameterError
            If the values do not fit together.

        """
        scene = scene or self.scene_of(values, initial)
        scene = scene.with_load(loads_of(self.record, scene, self.sensor(values), begin))
        duration = (self.record.duration if end is None else end) - begin + self._latest(values)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ModelWarning)
            return run_scene(scene, max(1, math.ceil(duration / scene.step - _AT_STEP)))

    def _latest(self, values):
        return max(0.0, *(-values.get(f'{name}.delay', 0.0) for name in self.record.outputs))

    @staticmethod
    def sensor(values: Mapping[str, float]) -> Callable[[str, str], float]:
        """Return a function of quantity and kind: the gain, bias or delay of a sensor."""
        return lambda name, kind: values.get(f'{name}.{kind}', SENSOR[kind])

    def predictions(self, run: Run, values: Mapping[str, float], begin: float = 0.0,
                    end: float = math.inf) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return what each output should show at its samples in a part: by name, times, values."""
        sensor, found = self.sensor(values), {}
        for name, channel in self.record.outputs.items():
            t = channel.t[_is_within(channel.t, begin, end, self.until)]
            seen = _with_lag(OUTPUTS[name].of_run(run), sensor(name, 'lag') / run.scene.step)
            found[name] = t, sensor(name, 'gain') * _interpolate(
                t - begin - sensor(name, 'delay'), run, seen) + sensor(name, 'bias')
        return found

    def residuals(self, values: Mapping[str, float], deviations: Mapping[str, float],
                  window: Window, initial: Mapping[str, float] | None = None) -> np.ndarray:
        """
        Return the residuals of a window, in standard deviations, one output after another.

        Those of a run that diverges are all large.
        """
        measured = self.measurements(window)
        try:
            run = self.run(values, window.begin, window.end, initial)
            predicted = self.predictions(run, values, window.begin, window.end)
        except (DivergenceError, ParameterError):
            return np.full(sum(map(len, measured.values())), _DIVERGED)
        return np.concatenate([(predicted[name][1] - measured[name]) / deviations[name]
                               for name in measured])

    def measurements(self, window: Window) -> dict[str, np.ndarray]:
        """Return the measured samples of a window, by output."""
        return {name: channel.values[_is_within(channel.t, window.begin, window.end, self.until)]
                for name, channel in self.record.outputs.items()}


def _is_within(t, begin, end, until):
    """Return which times are from `begin` to `end`; `end` itself counts only at `until`."""
    return (t >= begin) & ((t < end) | (t <= end if end == until else False))


def _with_lag(values, lag):
    """Return what a first-order sensor shows; its time constant `lag` is in steps."""
    if lag <= 0.0:
        return values
    # The filter is exact for straight lines between the samples, and begins at rest.
    fade = math.exp(-1.0 / lag)
    old, new = lag * (1.0 - fade) - fade, 1.0 - lag * (1.0 - fade)
    return lfilter([new, old], [1.0, -fade], values, zi=[values[0] * (1.0 - new)])[0]


def _interpolate(times, run, values):
    """Return a quantity of a run at times, shape (n,) [s]."""
    position = times / run.scene.step
    whole = np.rint(position)
    if np.abs(position - whole).max(initial=0.0) <= _AT_STEP:
        return values[np.clip(whole, 0, len(values) - 1).astype(int)]
    if len(values) < 4:
        return np.interp(times, run.t, values)
    # Before the start of the run, its first motion is used.
    return CubicSpline(run.t, values)(np.clip(times, 0.0, run.t[-1]))
