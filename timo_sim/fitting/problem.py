# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Predictions of a record by runs with free parameters, and how certain the closest are."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
import functools
import math
import time
from typing import Any
import warnings

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline, make_lsq_spline, PPoly
from scipy.linalg import matmul_toeplitz, solve_toeplitz
from scipy.linalg.lapack import dptsv
from scipy.signal import lfilter

from timo_sim.fitting.record import Channel, DRIVE, OUTPUTS, Record, unit_of
from timo_sim.model.layout import INPUTS
from timo_sim.runs.run import Run, run_scene
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.loads import SHAFT_DRIVE, Load, on_boundaries, Table
from timo_sim.scene.numbers import (
    INITIAL, initial_names, initial_scale, number_of, overrides_of)
from timo_sim.scene.parameters import (
    did_you_mean, ModelWarning, OF_MATERIAL, ParameterError, short, StepError)
from timo_sim.scene.scene import Scene, with_load
from timo_sim.simulation.loads import limits_of

# What a quantity of the record is multiplied by, added to and late by. `lag` is the time constant
# of a sensor, or of what puts an input out, of first order, whose values up to `dead_zone` are 0.
SENSOR = {'gain': 1.0, 'bias': 0.0, 'delay': 0.0, 'lag': 0.0, 'dead_zone': 0.0}
_MAX_FACTOR = 1e3  # by which a positive parameter may differ from its start


@dataclass(frozen=True)
class Free:
    """
    A free parameter: its name, with [k] for an element of a list, or QUANTITY.gain and such.

    First value `start` and bounds are in the unit of the parameter, as is `scale`, a change that
    matters. With `log` the fit works with its logarithm, and `scale` is a part of the value.
    `width` is the standard deviation of the first value, in coordinates of the fit; inf: unknown.
    """

    name: str
    start: float
    low: float
    high: float
    scale: float
    log: bool
    unit: str
    width: float = math.inf

    @property
    def text(self) -> str:
        """What `split_guess` takes apart."""
        size = self.scale * (self.start if self.log else 1.0)
        return f'{self.name}={self.start!r}~{float(self.width * size)!r}'

    @property
    def is_own(self) -> bool:
        """Whether each of several records has a value of its own, as a sensor has that drifts."""
        quantity, _, kind = self.name.partition('.')
        return quantity == INITIAL or kind.startswith('bias') and quantity in (*OUTPUTS, DRIVE)

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
    Return the Free parameters of a fit from texts NAME=VALUE~WIDTH, with bounds (low, high).

    A width without a name is that of all that have none. ParameterError: a name is unknown or
    given twice, or a start is outside of its bounds.
    """
    guesses = [(each, value, width) for name, value, width in map(split_guess, names) if name
               for each in (initial_names(scene) if name == INITIAL else [name])]
    usual = ([width for name, _, width in map(split_guess, names) if not name] or [''])[-1]
    wanted = [name for name, *_ in guesses]
    for name, value, _ in map(split_guess, names):
        if name == INITIAL and value:
            raise ParameterError(f'{name} must be given without a value, since it stands for '
                                 f'several numbers, got {value}')
    for place, name in enumerate(wanted):
        if name.removesuffix('[0]') in [each.removesuffix('[0]') for each in wanted[:place]]:
            raise ParameterError(f'{name} is free twice')
    for name in bounds:
        if name not in wanted:
            raise ParameterError(f'bounds of {short(name, str)} need it to be free; free are '
                                 f'{", ".join(wanted)}{did_you_mean(name, wanted)}')
    return [_free(name, value, width or usual, bounds.get(name), scene, record)
            for name, value, width in guesses]


def split_guess(text: str) -> tuple[str, str, str]:
    """Return name, value and width of a text NAME=VALUE~WIDTH, '' for what it lacks."""
    rest, _, width = text.partition('~')
    name, _, value = rest.partition('=')
    return name.strip(), value.strip(), width.strip()


def names_for(record: Record, records: Sequence[Record], free: Sequence[str]) -> list[str]:
    """Return the texts in `free` without sensors that other records have, but not this one."""
    quantities = {name for each in records for name in (*each.inputs, *each.outputs)}
    missing = quantities - {*record.inputs, *record.outputs}
    return [each for each in free if split_guess(each)[0].rpartition('.')[0] not in missing]


_RULE = ('must be NAME, NAME=VALUE, NAME~WIDTH or NAME=VALUE~WIDTH with a width such as 5%, x3 '
         '(a factor), 0.01 or inf')
_GIVEN, _LENGTH, _FACTOR, _OTHER = 0.05, 0.01, 3.0, 10.0  # usual widths: parts, and factors
_BIAS = 0.05  # that of a bias, of the range of what was measured
_DEAD_ZONE = 0.02  # first guess, of the largest value


def _width_of(text, name, start, scale, log, usual):
    """Return the width in coordinates that a text gives, by default a usual one."""
    size = scale * (start if log else 1.0)  # of a coordinate
    try:
        width = usual if not text else (
            math.log(float(text[1:])) if text[0] == 'x' and log else
            0.01 * float(text[:-1]) * abs(start) / size if text[-1] == '%' else
            float(text) / size)
    except ValueError:
        width = math.nan
    if not width > 0.0:
        raise ParameterError(f'{name} {_RULE}, and > 0, got {short(text, str)}')
    return width


def _usual_width(name, scene, unit, log):
    """Return how well a parameter of a scene is known before it is measured, in coordinates."""
    if not log:
        return math.inf
    if name in OF_MATERIAL and scene.values['arm.material'] != 'none':
        return _GIVEN
    loose = any(word in name for word in ('friction', 'damping', 'coulomb'))
    return _LENGTH if unit == 'm' and not loose else math.log(_FACTOR if loose else _OTHER)


def _free(name, value, width, bounds, scene, record):
    quantity, _, kind = name.rpartition('.')
    channels = {**record.inputs, **record.outputs}
    if quantity in channels and kind in kinds_of(record, quantity):
        values = channels[quantity].values
        # What has a bound of 0 begins above it, because a search leaves a bound slowly.
        start = {'lag': 2.0 * record.period, 'dead_zone': _DEAD_ZONE * np.abs(values).max()}.get(
            kind, SENSOR[kind])
        spread, late = spread_of(values) or 1.0, 0.1 * record.duration
        low, high, scale, log, unit, usual = {
            'gain': (0.0, math.inf, 1.0, True, '', _GIVEN if value else math.log(_FACTOR)),
            'bias': (-math.inf, math.inf, spread, False, unit_of(quantity),
                     _BIAS * np.ptp(values) / spread or math.inf),
            'delay': (-late, late, 10.0 * record.period, False, 's', math.inf),
            'lag': (0.0, late, 10.0 * record.period, False, 's', math.inf),
            'dead_zone': (0.0, np.abs(values).max(), spread, False, unit_of(quantity),
                          math.inf)}[kind]
    else:
        parameter, start = number_of(
            name, scene, ' nor QUANTITY.gain, .bias, .delay, .lag or, of an input, .dead_zone of '
            + ', '.join(channels),
            [f'{channel}.{kind}' for channel in channels for kind in kinds_of(record, channel)])
        low, high, unit = parameter.low, parameter.high, parameter.unit
        log = low == 0.0
        scale = initial_scale(name, scene) if name.startswith(INITIAL) else max(abs(start), 1.0)
        scale = 1.0 if log else scale
        usual = _usual_width(name.partition('[')[0], scene, unit, log)
    try:
        lowest, highest = map(float, (-math.inf, math.inf) if bounds is None else bounds)
        good = lowest < highest
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ParameterError(f'bounds of {name} must be two ascending numbers, got '
                             f'{short(bounds)}')
    try:
        start = float(value or start)
    except ValueError:
        raise ParameterError(f'{name} {_RULE}, got {short(value, str)}') from None
    if log and start <= 0.0:
        raise ParameterError(f'{name} must be > 0 {unit} in the scene to be fitted, since its '
                             f'first value is a guess to begin with; got {start:g}')
    low, high = max(low, lowest), min(high, highest)
    if log:
        low, high = max(low, start / _MAX_FACTOR), min(high, start * _MAX_FACTOR)
    if not low <= start <= high:
        raise ParameterError(f'{name} = {start:g} must be within its bounds, {low:g} to {high:g}, '
                             'where the fit begins')
    return Free(name=name, start=start, low=low, high=high, scale=scale, log=log, unit=unit,
                width=_width_of(width, name, start, scale, log, usual))


_DEGREE = 5  # of the spline through a driven angle, whose acceleration is smooth


class Driven:
    """A driven shaft's angle, a spline through the samples of a Channel, constant outside."""

    def __init__(self, channel: Channel, gain: float, bias: float, late: float) -> None:
        spline = _spline(channel.t.tobytes(), channel.values.tobytes(), channel.knots)
        t, width = spline.x, len(spline.c)
        self._rows = np.zeros((len(t) + 1, 1 + width))
        self._rows[:, 0] = np.append(t[0] - 1.0, t) + late
        self._rows[1:-1, 1:] = gain * spline.c[::-1].T
        self._rows[[0, -1], 1] = gain * spline(t[[0, -1]])
        self._rows[:, 1] += bias

    def rows(self, step: float) -> np.ndarray:
        """Return times and polynomials, see `scene.loads.Drive`."""
        return np.column_stack([on_boundaries(self._rows[:, 0], step), self._rows[:, 1:]])


def kinds_of(record: Record, quantity: str) -> list[str]:
    """Return those of `SENSOR` which a quantity of a record may have."""
    has = {'dead_zone': quantity in record.inputs and quantity != DRIVE, 'lag': quantity != DRIVE}
    return [kind for kind in SENSOR if has.get(kind, True)]


def sensor_of(values: Mapping[str, float], quantity: str) -> list[float]:
    """Return all of `SENSOR` of a quantity, from values by name."""
    return [values.get(f'{quantity}.{kind}', usual) for kind, usual in SENSOR.items()]


def loads_of(record: Record, scene: Scene, values: Mapping[str, float]) -> Load:
    """Return the Load of a scene and a record's inputs, whose sensors have values by name."""
    terms: dict[str, list[Any]] = {name: [*own] for name, own in scene.load.terms.items()}
    for name, channel in record.inputs.items():
        gain, bias, delay, lag, dead = sensor_of(values, name)
        if name == DRIVE:
            terms[SHAFT_DRIVE] = [Driven(channel, gain, bias, delay)]
            continue
        acts = gain * (channel.values - np.clip(channel.values, -dead, dead)) + bias
        channel = _limited(name, channel._replace(values=acts), scene.values)
        t, shown = channel.t + delay, channel.values
        if name == 'voltage':
            shown, name = motor_constants(scene.values)[0] * shown, 'torque'
        if channel.hold == 'zero':  # a table that jumps, also inside a step
            t, shown = np.repeat(t, 2)[1:], np.repeat(shown, 2)[:-1]
        if lag > 0.0:
            t, shown = _lagging(t, shown, max(t[-1], record.duration), scene.step, lag)
        terms.setdefault(name, []).append(Table(t, shown))
    return Load({name: tuple(found) for name, found in terms.items()})


def _lagging(t, values, end, step, lag):
    """Return times and values until `end` of what follows a table with a lag; at rest at first."""
    grid = t[0] + step * np.arange(math.ceil((end - t[0]) / step) + 1)
    # Its integral is exact also for jumps, and taken to be straight within each step.
    inside = grid[~np.isin(grid, t)]
    places = np.searchsorted(t, inside)
    every = np.insert(t, places, inside)
    integral = np.interp(grid, every, cumulative_trapezoid(np.insert(
        values, places, np.interp(inside, t, values)) - values[0], every, initial=0.0))
    # lag y' = u - y, for the integrals of u and y
    return grid, values[0] + (integral - _with_lag(integral, lag / step)) / lag


def _limited(name, channel, values):
    """Return what a scene's actuators make of an input, a channel, by the scene's values."""
    each, = (each for each in INPUTS if each.name == name)
    if each.needs and not values[each.needs]:
        raise ParameterError(f'the record has the input {name}, which needs {each.needs} > 0, '
                             'got 0')
    limit, rate = (values[name] if name else np.inf for name in (each.limit, each.rate_limit))
    channel = channel._replace(values=np.clip(channel.values, -limit, limit))
    return _ramp(channel, rate) if np.isfinite(rate) else channel


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
    """Return a spline through samples, or near them with knots so far apart, as a PPoly."""
    t, angle = np.frombuffer(t), np.frombuffer(angle)
    count = max(1, round((t[-1] - t[0]) / knots)) if knots else 0
    try:
        if count + _DEGREE > len(t):
            raise ValueError
        inner = np.pad(np.linspace(t[0], t[-1], count + 1), _DEGREE, 'edge')
        found = (make_lsq_spline(t, angle, inner, _DEGREE) if knots
                 else make_interp_spline(t, angle, _DEGREE))
        if not np.isfinite(found.c).all():
            raise ValueError
    except (ValueError, np.linalg.LinAlgError):
        raise ParameterError(f'knots of {DRIVE} must be further apart than its samples, also '
                             f'where these have gaps, got {knots:g} s') from None
    pieces = PPoly.from_spline(found)
    wide = np.diff(pieces.x) > 0.0  # knots at the ends are repeated
    return PPoly(pieces.c[:, wide], np.append(pieces.x[:-1][wide], pieces.x[-1]))


_AT_STEP = 1e-6  # [steps] distance from a step within which a sample is taken at it
_MAX_STEPS = 1e7
_MAX_KEPT = 2**22  # most numbers of the runs that are kept
_MAX_PARTS = 16  # of a step, for friction that is steep


def vary(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return a scene with changes, and a part of its step where this is too long for friction."""
    try:
        return scene.vary(changes)
    except StepError as error:
        if (parts := 2**math.ceil(math.log2(scene.step / error.longest))) > _MAX_PARTS:
            raise
        return scene.vary({**changes, 'integrator.step': scene.step / parts})


class TimeIsUp(KeyboardInterrupt):
    """A run was asked for after the `deadline` of its Problem."""


class Problem:
    """
    A record, the scene that shall predict it, and the parameters that are free.

    They are fitted to the part before `until` [s]. `free` is a list of Free. After `deadline`, a
    time of `time.monotonic`, `run` raises TimeIsUp.
    """

    deadline = math.inf

    def __init__(self, scene: Scene, record: Record, names: Sequence[str],
                 bounds: Mapping[str, Sequence[float]], until: float) -> None:
        if DRIVE in record.inputs and scene.values['motor.shaft'] != 'driven':
            scene = scene.vary({'motor.shaft': 'driven', 'motor.drive': {
                'time': [0.0], 'angle': [0.0], 'speed': [0.0], 'acceleration': [0.0]}})
        if record.duration > _MAX_STEPS * scene.step:
            raise ParameterError(f'the record lasts {record.duration:g} s, but at most '
                                 f'{_MAX_STEPS:g} steps of {scene.step:g} s are fitted: cut it, '
                                 'if the unit of its times is right')
        self.scene, self.record, self.until = scene, record, until
        self._sensors = {f'{name}.{kind}' for name in record.outputs for kind in SENSOR}
        self.free = free_parameters(names, bounds, scene, record)
        self._shown: dict[tuple[Any, ...], tuple[float, dict[str, np.ndarray]]] = {}
        self._loads: tuple[Any, Any] = (None, None)  # the last, and what they depend on
        still = not (scene.load or scene.initial_motion()[3:].any()
                     or scene.build().gravity.any() or scene.manipulator.spring)
        if still and not record.inputs and not any(name.startswith(INITIAL) for name in names):
            raise ParameterError('nothing moves the arm: the record has no input, and the scene '
                                 'no load, no motion at the beginning, no gravity and no spring')

    def scene_of(self, values: Mapping[str, float]) -> Scene:
        """Return the scene with free values, without the record's loads, and a step as `vary`."""
        own = {name: value for name, value in values.items()
               if name not in self._sensors and name.rpartition('.')[0] not in self.record.inputs}
        return vary(self.scene, overrides_of(own, self.scene))

    def run(self, values: Mapping[str, float], end: float = math.inf,
            scene: Scene | None = None) -> Run:
        """
        Return the Run that predicts the record until `end` [s], with free values by name.

        `scene` is by default `scene_of(values)`. Raises DivergenceError if the run diverges,
        ParameterError if the values do not fit together.
        """
        if time.monotonic() > self.deadline:
            raise TimeIsUp('its time was up')
        scene = scene or self.scene_of(values)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ModelWarning)
            return self._run(scene, values, end)

    def _run(self, scene, values, end):
        scene = with_load(scene, self._loads_for(scene, values))
        duration = min(end, self.record.duration) + self._early(values)
        # Steps that friction makes short are not all shown: outputs take as long as steps.
        parts = max(1, round(self.scene.step / scene.step))
        steps = math.ceil(duration / (parts * scene.step) - _AT_STEP)
        return run_scene(scene, parts * max(1, steps), parts)

    def _loads_for(self, scene, values):
        """Return `loads_of` values; most of these do not change them."""
        key = (scene.step, scene.load, limits_of(scene.values), motor_constants(scene.values),
               [sensor_of(values, name) for name in self.record.inputs])
        if self._loads[0] != key:
            self._loads = key, loads_of(self.record, scene, values)
        return self._loads[1]

    def _early(self, values):
        """Return how long after the record a run must go on, since outputs show it early [s]."""
        return max(0.0, *(-values.get(f'{name}.delay', 0.0) for name in self.record.outputs))

    def predicted(self, values: Mapping[str, float], end: float = math.inf,
                  run: Any = None) -> dict[str, np.ndarray]:
        """Return what outputs should show at samples until `end`, by a `run`, which may raise."""
        step, shown = self._shown_by(values, end) if run is None else self._outputs_of(run)
        found = {}
        for name, channel in self.record.outputs.items():
            gain, bias, delay, lag, _ = sensor_of(values, name)
            late, times = _with_lag(shown[name], lag / step), channel.t[channel.t <= end] - delay
            found[name] = gain * _interpolate(times, step, late) + bias
        return found

    def _outputs_of(self, run):
        """Return the time between samples of a Run, and outputs at all of these by name."""
        return float(run.t[1]), {name: OUTPUTS[name].of_run(run) for name in self.record.outputs}

    def _shown_by(self, values, end):
        """Return `_outputs_of` values; some are kept, which differ in those of sensors alone."""
        key = end, self._early(values), *(
            each for each in values.items() if each[0] not in self._sensors)
        if key not in self._shown:
            found = self._outputs_of(self.run(values, end))
            size = sum(map(len, found[1].values()))
            while self._shown and (1 + len(self._shown)) * size > _MAX_KEPT:
                del self._shown[next(iter(self._shown))]
            self._shown[key] = found
        return self._shown[key]

    def __getstate__(self):
        return {**vars(self), '_shown': {}}

    def measurements(self, end: float) -> dict[str, np.ndarray]:
        """Return the measured samples until `end`, by output."""
        return {name: channel.values[channel.t <= end]
                for name, channel in self.record.outputs.items()}


def _with_lag(values, lag):
    """Return what follows values with a lag of first order, a time constant in steps."""
    if lag <= 0.0:
        return values
    # The filter is exact for straight lines between the samples, and begins at rest.
    fade = math.exp(-1.0 / lag)
    old, new = lag * (1.0 - fade) - fade, 1.0 - lag * (1.0 - fade)
    return lfilter([new, old], [1.0, -fade], values, zi=[values[0] * (1.0 - new)])[0]


def _interpolate(times, step, values):
    """Return a quantity of a run with samples at all steps at times, shape (n,) [s]."""
    position = times / step
    whole = np.rint(position)
    if np.abs(position - whole).max(initial=0.0) <= _AT_STEP:
        return values[np.clip(whole, 0, len(values) - 1).astype(int)]
    # Before the start of the run, its first motion is used.
    position = np.clip(position, 0.0, len(values) - 1.0)
    if len(values) < 6:  # too few for the equations of a spline
        return np.interp(position, np.arange(len(values)), values)
    # Second derivatives of the cubic spline, by steps: (M_(k-1) + 4 M_k + M_(k+1)) / 6 is the
    # second difference, and the third derivative does not jump next to the ends.
    change, bends = np.diff(values, 2), np.empty(len(values))
    bends[[1, -2]] = change[[0, -1]]
    right = 6.0 * change[1:-1]
    right[[0, -1]] -= change[[0, -1]]
    bends[2:-2] = dptsv(np.full(len(right), 4.0), np.ones(len(right) - 1), right)[2]
    bends[[0, -1]] = 2.0 * bends[[1, -2]] - bends[[2, -3]]
    place = np.minimum(position.astype(int), len(values) - 2)
    after, before = position - place, place + 1.0 - position
    return before * values[place] + after * values[place + 1] - before * after / 6.0 * (
        (1.0 + before) * bends[place] + (1.0 + after) * bends[place + 1])


WHITE = 0.01         # probability below which residuals do not count as white
NORMAL = 1.959964    # standard deviations of a 95 % interval
_LAGS = 20  # of the test for whiteness
_MAX_ORDER = 12  # largest of an autoregressive process
_MIN_SENSITIVITY = 1e-30  # sensitivity of residuals that counts as none
_UNKNOWN_DEVIATION = 1e3  # deviation of a combination on which residuals do not depend
_NOTHING_KNOWN = 1e6  # most of it, which leaves others their digits
_ROUND_OFF = 1e-9  # singular value, relative to the largest, below which it is that of noise
# Parts of the largest in a combination, above which a parameter is named: any, or one that is
# not identified.
_MIN_PART, _MIN_PART_UNIDENTIFIED = 0.25, 0.02


def whiteness(residuals: np.ndarray) -> float:
    """Return the probability that white residuals of mean 0, (n,), are as correlated (Ljung)."""
    from scipy.stats import chi2
    r, n = residuals, len(residuals)
    lags = min(_LAGS, n // 4)
    if not (power := r @ r):
        return 1.0
    lag = np.arange(1, lags + 1)
    correlation = np.array([r[k:] @ r[:-k] for k in lag]) / power
    return float(chi2.sf(n * (n + 2.0) * np.sum(correlation**2 / (n - lag)), lags))


def alike(residuals: np.ndarray) -> float:
    """Return how many residuals of a series, (n,), tell as much as one that is independent."""
    n = len(residuals)
    if whiteness(residuals) >= WHITE:
        return 1.0
    # The sum of the squares of correlations: that for a column with the same spectrum.
    power = np.abs(np.fft.rfft(residuals, 2 * n))**2
    correlation = np.fft.irfft(power)[:max(1, n // 20)] / (residuals @ residuals)
    return float(2.0 * np.sum(correlation**2) - 1.0)


def covariance(jacobians: Sequence[np.ndarray], residuals: Sequence[np.ndarray],
               widths: Any = math.inf) -> tuple[np.ndarray, bool]:
    """
    Return the covariance, (p, p), of least-squares estimates, and whether residuals are white.

    If the residuals of all outputs are white it is that of independent noise. Otherwise each
    series counts as an autoregressive process, whose order minimises Schwarz's criterion (BIC),
    and no combination as more certain than with independent noise. The arguments are lists with an
    element for each series (an output of a record): derivatives, (n_i, p), of the residuals,
    (n_i,), in standard deviations. `widths`, (p,), are the deviations of first guesses.
    """
    whole = np.concatenate(jacobians)
    norms = np.maximum(np.linalg.norm(whole, axis=0), _MIN_SENSITIVITY)
    u, s, vt = np.linalg.svd(whole / norms, full_matrices=False)
    root = vt.T / norms[:, np.newaxis]
    # Singular values below the errors of the derivatives may be zero.
    most = np.abs(root).max(axis=0) / _UNKNOWN_DEVIATION
    s = np.where(s < _ROUND_OFF * s[0], np.minimum(s, most), s)
    root /= np.maximum(s, _MIN_SENSITIVITY)
    white = all(whiteness(each) >= WHITE for each in residuals if len(each) > 4)
    if not white:
        # It is computed for orthonormal columns, because for the parameters themselves round-off
        # may exceed its smallest eigenvalue.
        parts = np.split(u, np.cumsum([len(each) for each in residuals])[:-1])
        size, axes = np.linalg.eigh(sum(map(_covariance_of_sums, parts, residuals)))
        root = root @ (axes * np.sqrt(np.maximum(size, 1.0)))
    # (R R')^-1 + W W' is inverted by the singular values of W' R, which keeps small ones.
    root /= np.maximum(np.abs(root).max(axis=0) / _NOTHING_KNOWN, 1.0)
    _, s, vt = np.linalg.svd(root / np.reshape(widths, (-1, 1)))
    root = root @ (vt.T / np.hypot(1.0, s))
    return root @ root.T, white


def _covariance_of_sums(columns, residuals):
    """Return the covariance, shape (p, p), of sums of residuals weighted by columns, (n, p)."""
    n = len(residuals)
    lags = range(min(_MAX_ORDER, n // 10) + 1)
    # The equations of Yule and Walker, from the autocovariances.
    found = np.array([residuals[k:] @ residuals[:n - k] for k in lags]) / n
    best = np.inf, np.zeros(0), found[0]  # criterion, coefficients, variance of the innovations
    for order in lags:
        past = solve_toeplitz(found[:order], found[1:order + 1]) if order else np.zeros(0)
        left = found[0] - past @ found[1:order + 1]
        if not left > _ROUND_OFF * found[0]:
            break
        best = min(best, (n * np.log(left) + order * np.log(n), past, left), key=lambda it: it[0])
    _, past, left = best
    response = np.fft.rfft(np.append(1.0, -past), 4 * n)
    covariances = np.fft.irfft(left / np.abs(response)**2, 4 * n)[:n]
    return columns.T @ matmul_toeplitz(covariances, columns)


def unidentified_combinations(jacobian: np.ndarray, names: Sequence[str],
                              doubtful: Collection[str]) -> list[dict[str, float]]:
    """
    Return the combinations of parameters on which the residuals hardly depend.

    Each has the part of each parameter that matters in it, by name. `jacobian`, (n, p), is that of
    all residuals in standard deviations; `doubtful` names those that are not identified, of which
    a combination has one. One is unknown if half of its 95 % interval is more than 1.
    """
    _, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    found = []
    for value, parts in zip(s, vt):
        if value < NORMAL or value < _ROUND_OFF * s[0]:
            share = np.abs(parts) / np.abs(parts).max()
            least = [_MIN_PART_UNIDENTIFIED if name in doubtful else _MIN_PART for name in names]
            sign = np.sign(parts[np.argmax(np.abs(parts))])
            found.append({name: float(sign * part)
                          for name, part, kept in zip(names, parts, share > least) if kept})
    return [parts for parts in found if not parts.keys().isdisjoint(doubtful)]


def spread_of(values: np.ndarray) -> float:
    """Return the standard deviation of values, (n,): 0, without round-off, if all are the same."""
    return float(np.std(values)) if np.any(values != values[:1]) else 0.0


def r_squared(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Return the coefficient of determination R^2; NaN if nothing was measured to vary."""
    spread = spread_of(measured)
    return float(1.0 - np.mean((measured - predicted)**2) / spread**2) if spread else np.nan
