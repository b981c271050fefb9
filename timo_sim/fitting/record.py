# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The class Record: what was measured, in time, and the quantities that a record may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Callable, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from timo_sim.model.layout import INPUTS, PUSH_X, PUSH_Y, rotate, TIP_TORQUE, TIP_X, TIP_Y
from timo_sim.scene.parameters import did_you_mean, ParameterError, short
from timo_sim.topics.sensors import SENSORS

DRIVE = 'drive'


class Output(NamedTuple):
    """A measured quantity."""

    unit: str
    meaning: str
    of_run: Callable  # from a Run to the quantity at its samples, shape (n,)


def _tip(run, axis):
    return run.deflection(run.scene.manipulator.arm.length)[:, axis]


def _tip_angle(run):
    length = run.scene.manipulator.arm.length
    return np.arctan2(_tip(run, 1), length + _tip(run, 0))


def _place(run, axis):
    return run.position(run.scene.manipulator.arm.length)[:, axis]


def _rate(run, values):
    # A spline through the samples is differentiated: a run has thousands, and its friction need
    # not be known.
    return CubicSpline(run.t, values).derivative()(run.t) if len(run.t) > 3 else np.gradient(
        values, run.t, axis=0)


def _root_strain(run):
    """Return the strain at the root from the arm's angular momentum about it, shape (n,)."""
    model, half = run.model, run.motion.shape[1] // 2
    velocity, turning = model.velocities(run.motion, model.points)
    place = model.world(run.motion, model.points) - run.carrier[:, np.newaxis]
    linear = np.einsum('p,npi->ni', model.point_mass, velocity)
    angular = (_cross(place, velocity) @ model.point_mass + turning @ model.point_inertia)
    load = run.loads()
    tip = np.column_stack([load[:, TIP_X], load[:, TIP_Y]])
    moment = (_rate(run, angular) + _cross(run.motion[:, half:half + 2], linear)
              - _cross(np.einsum('p,npi->ni', model.point_mass, place), model.gravity)
              - _cross(place[:, -1], tip) - load[:, TIP_TORQUE])
    if model.push_point:
        place = model.world(run.motion, model.push_point)[:, 0] - run.carrier
        moment -= _cross(place, load[:, [PUSH_X, PUSH_Y]])
    return model.strain(run.motion, 0.0, -moment)


def _tip_acceleration(run):
    """Return the specific force across the tip, shape (n,) [m/s2]."""
    model = run.model
    x, y = (_rate(run, model.velocities(run.motion, model.tip_point)[0][:, 0])
            - model.gravity).T
    turned = run.shaft + run.rotation(run.scene.manipulator.arm.length)
    return rotate(-turned, x, y)[1]


def _cross(first, second):
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


# Units of the inputs that a record may have.
INPUT_UNITS = {**{each.name: each.unit for each in INPUTS if each.argument}, DRIVE: 'rad'}


def _of_motion(sensor):
    return Output(sensor.unit, sensor.meaning, lambda run: sensor.of_motion(run.model, run.motion))


OUTPUTS = {
    **{sensor.measured: _of_motion(sensor) for sensor in SENSORS if sensor.of_motion},
    'shaft_velocity': Output('rad/s', 'speed of the shaft', lambda run: run.shaft_velocity),
    'carrier_x': Output('m', 'position of the carrier', lambda run: run.carrier[:, 0]),
    'carrier_y': Output('m', 'position of the carrier', lambda run: run.carrier[:, 1]),
    'tip_x': Output('m', 'position of the tip, world axes', lambda run: _place(run, 0)),
    'tip_y': Output('m', 'position of the tip, world axes', lambda run: _place(run, 1)),
    'tip_transverse': Output('m', 'deflection of the tip across the arm',
                             lambda run: _tip(run, 1)),
    'tip_angle': Output('rad', 'direction of the tip as seen from the root, straight arm: 0',
                        _tip_angle),
    'tip_rotation': Output('rad', 'rotation of the end effector relative to the shaft',
                           lambda run: run.rotation(run.scene.manipulator.arm.length)),
    'root_strain': Output('', 'strain of the outer fibre at the root',
                          _root_strain),
    'tip_acceleration': Output('m/s2', 'specific force on the tip across it, as an accelerometer '
                               'shows it', _tip_acceleration),
}
UNITS = {
    'rad': {'rad': 1.0, 'mrad': 1e-3, 'deg': np.pi / 180.0, 'turn': 2.0 * np.pi},
    'rad/s': {'rad/s': 1.0, 'deg/s': np.pi / 180.0, 'rpm': np.pi / 30.0},
    'm': {'m': 1.0, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6},
    'm/s2': {'m/s2': 1.0, 'g': 9.80665},
    's': {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9},
    'N': {'N': 1.0, 'mN': 1e-3}, 'N m': {'N m': 1.0, 'mN m': 1e-3}, 'V': {'V': 1.0, 'mV': 1e-3},
    '': {'': 1.0, 'strain': 1.0, 'microstrain': 1e-6},
}


def unit_of(name: str) -> str:
    """Return the unit of a quantity; values in a Record have it."""
    return INPUT_UNITS[name] if name in INPUT_UNITS else OUTPUTS[name].unit


HOLDS = 'zero', 'linear'
# Limits of values, and of noise relative to them, that keep squares of residuals finite.
_LARGEST, _LEAST_NOISE = 1e100, 1e-12
_FEWEST = 20  # samples of an output, or of a drive


class Channel(NamedTuple):
    """
    The samples of one quantity.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times, ascending [s]; they may be uneven.
    values : ndarray, shape (n,)
        In the unit of the quantity, see `UNITS`.
    noise : float or None
        Standard deviation of the noise of a sensor, if it is known.
    hold : str
        Of an input: `zero` if each value holds until the next sample, as a controller's command
        does, or `linear` in between.
    knots : float or None
        Of the input `drive`: distance of the knots of the spline that smooths the angle [s], since
        noise and counts of an encoder would become accelerations; None: it meets all samples.

    """

    t: np.ndarray
    values: np.ndarray
    noise: float | None = None
    hold: str = 'zero'
    knots: float | None = None


@dataclass(frozen=True)
class Record:
    """
    A measured record of an arm; t = 0 is its first sample.

    Attributes
    ----------
    inputs, outputs : dict of Channel
        By name of a quantity, see `timo_sim.fitting.record`.
    source : str
        Where it is from, for messages.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> t = np.arange(100) * 0.01
    >>> timo_sim.Record.of({'torque': (t, np.sin(t))}, {'shaft': (t, t**3 / 6.0)}).duration
    0.99

    """

    inputs: dict[str, Channel]
    outputs: dict[str, Channel]
    source: str = 'given arrays'

    @staticmethod
    def of(inputs: Mapping[str, Any], outputs: Mapping[str, Any],
           noise: Mapping[str, float] | None = None, source: str = 'given arrays') -> Record:
        """
        Return a checked Record of arrays.

        Parameters
        ----------
        inputs, outputs : dict
            By quantity its times and values, two arrays of shape (n,), or a Channel. Samples
            that are not finite are left out.
        noise : dict, optional
            Standard deviations of the noise of sensors, by quantity; by default fitted, too.
        source : str
            For messages.

        Raises
        ------
        ParameterError
            If a quantity is unknown, has too few samples, or times do not ascend.

        """
        ins: dict[str, Channel] = {}
        outs: dict[str, Channel] = {}
        rules: Any = (ins, inputs, INPUT_UNITS, 'input'), (outs, outputs, OUTPUTS, 'output')
        for kept, given, known, kind in rules:
            for name, channel in given.items():
                if name not in known:
                    raise ParameterError(f'{short(name, str)} is no {kind} of a record, but '
                                         f'{", ".join(known)}{did_you_mean(name, known)} '
                                         f'({source})')
                kept[name] = _checked(name, channel, source, kind == 'output')
        for name, deviation in (noise or {}).items():
            least = _LEAST_NOISE * np.abs(outs[name].values).max() if name in outs else 0.0
            if name not in outs or not max(least, np.finfo(float).tiny) < deviation < _LARGEST:
                raise ParameterError(f'noise of {short(name, str)} must be > 0 and at least '
                                     f'{_LEAST_NOISE:g} of the largest value, of one of '
                                     f'{", ".join(outs)}, got {short(deviation)} ({source})')
            outs[name] = outs[name]._replace(noise=float(deviation))
        if not outs:
            raise ParameterError(f'a record must have an output, one of {", ".join(OUTPUTS)} '
                                 f'({source})')
        begin = min(channel.t[0] for channel in (*ins.values(), *outs.values()))
        for part in (ins, outs):
            part.update({name: channel._replace(t=channel.t - begin)
                         for name, channel in part.items()})
        return Record(ins, outs, source)

    @property
    def duration(self) -> float:
        """Time of the last sample of an output [s]."""
        return float(max(channel.t[-1] for channel in self.outputs.values()))

    @property
    def period(self) -> float:
        """The shortest of the median times between samples of a quantity [s]."""
        return float(min(np.median(np.diff(channel.t)) for channel in (
            *self.inputs.values(), *self.outputs.values()) if len(channel.t) > 1))

    def select(self, *outputs: str) -> Record:
        """Return the record with these outputs alone; ParameterError if it has not got one."""
        for name in outputs:
            if name not in self.outputs:
                raise ParameterError(f'{short(name, str)} is no output of this record, but '
                                     f'{", ".join(self.outputs)} ({self.source})')
        return replace(self, outputs={name: self.outputs[name] for name in outputs})

    def cut(self, start: float = 0.0, end: float = np.inf) -> Record:
        """
        Return the part from `start` to `end` [s], whose time begins at 0 again.

        An input that has no sample in it keeps the value that acts there. Raises ParameterError
        if an output has too few samples in it.
        """
        def part(name, channel, is_input):
            first, last = np.searchsorted(channel.t, [start, end])
            if is_input and first and (first == len(channel.t) or channel.t[first] > start):
                first -= 1  # its value still holds at the start
            t = np.maximum(channel.t[first:last + 1] - start, 0.0)
            within = t <= end - start
            found = channel._replace(t=t[within], values=channel.values[first:last + 1][within])
            if is_input and name != DRIVE and not len(found.t):
                found = channel._replace(t=np.zeros(1), values=channel.values[first:first + 1])
            _check_count(name, len(found.t), not is_input, f'from {start:g} s to {end:g} s of '
                         f'{self.duration:g} s, {self.source}')
            return found
        return Record({name: part(name, channel, True) for name, channel in self.inputs.items()},
                      {name: part(name, channel, False) for name, channel in self.outputs.items()},
                      self.source)


def _check_count(name, count, is_output, place):
    fewest = _FEWEST if is_output or name == DRIVE else 1
    if count < fewest:
        raise ParameterError(f'{name} must have at least {fewest} finite samples, got {count} '
                             f'({place})')


def _checked(name, channel, source, is_output):
    t, values, *more = channel
    try:
        # Converted to floats, complex values would lose a part, and stamps their unit.
        good = not any(np.asarray(each).dtype.kind in 'cmM' for each in (t, values))
        t, values = (np.array(each if good else [], dtype=float) for each in (t, values))
        good = good and t.ndim == 1 and t.shape == values.shape
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ParameterError(f'{name} must have as many times as values, lists of real '
                             f'numbers ({source})')
    kept = np.isfinite(t) & np.isfinite(values)
    t, values = t[kept], values[kept]
    _check_count(name, len(t), is_output, source)
    if np.abs(values).max() > _LARGEST:
        raise ParameterError(f'values of {name} must be at most {_LARGEST:g} in size, got '
                             f'{np.abs(values).max():g} ({source})')
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if len(late):
        raise ParameterError(f'times of {name} must ascend, got {t[late[0]]:.12g} s and then '
                             f'{t[late[0] + 1]:.12g} s ({source})')
    found = Channel(t, values, *more)
    if found.hold not in HOLDS:
        raise ParameterError(f'hold of {name} must be one of {", ".join(HOLDS)}, got '
                             f'{short(found.hold)} ({source})')
    return found
