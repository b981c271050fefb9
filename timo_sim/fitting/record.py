# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The class Record: what was measured, in time, and the quantities that a record may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Callable, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from timo_sim.model.layout import INPUTS
from timo_sim.scene.parameters import (
    check_keys, checked, MAPPING, NUMBER, ParameterError, short, TEXT)
from timo_sim.topics.outputs import SENSORS

DRIVE = 'drive'


class Quantity(NamedTuple):
    """A measured quantity."""

    unit: str
    meaning: str
    of_run: Callable  # from a Run to the quantity at its samples, shape (n,)


# Units of the inputs that a record may have.
INPUT_UNITS = {**{each.name: each.unit for each in INPUTS if each.argument}, DRIVE: 'rad'}


OUTPUTS = {
    **{sensor.measured: Quantity(
        sensor.unit, sensor.meaning,
        lambda run, read=sensor.of_motion: read(run.model, run.values))
        for sensor in SENSORS if sensor.of_motion},
    'shaft_velocity': Quantity('rad/s', 'speed of the shaft', lambda run: run.shaft_velocity),
    'rotor_velocity': Quantity('rad/s', 'speed of the rotor over the gear ratio',
                               lambda run: run.rotor_velocity),
    'carrier_x': Quantity('m', 'position of the carrier', lambda run: run.carrier[:, 0]),
    'carrier_y': Quantity('m', 'position of the carrier', lambda run: run.carrier[:, 1]),
    'tip_x': Quantity('m', 'position of the tip, world axes', lambda run: run.position()[:, 0]),
    'tip_y': Quantity('m', 'position of the tip, world axes', lambda run: run.position()[:, 1]),
    'tip_transverse': Quantity('m', 'deflection of the tip across the arm',
                               lambda run: run.deflection()[:, 1]),
    'tip_angle': Quantity('rad', 'direction of the tip as seen from the root, straight arm: 0',
                          lambda run: np.angle(run.model.manipulator.arm.length
                                               + run.deflection() @ [1.0, 1.0j])),
    'tip_rotation': Quantity('rad', 'rotation of the end effector relative to the shaft',
                             lambda run: run.rotation()),
    'root_strain': Quantity('', 'strain of the outer fibre at the gauge',
                            lambda run: run.root_strain()),
    'tip_acceleration': Quantity(
        'm/s2', 'specific force across the tip, or where the IMU is, as that shows it',
        lambda run: run.tip_acceleration()[:, 1]),
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


HOLDS = {'zero': 0, 'linear': 1}  # degree of an input between its samples
# Limits of values, and of noise relative to them, that keep squares of residuals finite.
_MAX_VALUE, _MIN_NOISE = 1e100, 1e-12
_MIN_SAMPLES = 20  # samples of an output, or of a drive


class Channel(NamedTuple):
    """
    The samples of one quantity.

    Attributes
    ----------
    t, values : ndarray, shape (n,)
        Times, ascending [s], which may be uneven; values in the unit of the quantity, see `UNITS`.
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
    @checked(inputs=MAPPING, outputs=MAPPING, source=TEXT)
    def of(inputs: Mapping[str, Any], outputs: Mapping[str, Any],
           source: str = 'given arrays') -> Record:
        """
        Return a checked Record of arrays.

        `inputs` and `outputs` have by quantity its times and values, two arrays of shape (n,), and
        the standard deviation of its sensor if it is known; or a Channel. Samples that are not
        finite are left out. `source` is for messages. Raises ParameterError if a quantity is
        unknown, has too few samples, or times do not ascend.
        """
        given: Any = (inputs, INPUT_UNITS, 'input'), (outputs, OUTPUTS, 'output')
        for part, known, kind in given:
            check_keys(f'{kind}s of {source}', part, known)
        ins, outs = ({name: _check_channel(name, channel, source, kind == 'output')
                      for name, channel in part.items()} for part, _, kind in given)
        if not outs:
            raise ParameterError(f'a record must have an output, one of {", ".join(OUTPUTS)} '
                                 f'({source})')
        begin = min(channel.t[0] for channel in (*ins.values(), *outs.values()))
        ins, outs = ({name: channel._replace(t=channel.t - begin)
                      for name, channel in part.items()} for part in (ins, outs))
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
        check_keys(f'outputs of {self.source}', dict.fromkeys(map(str, outputs)), self.outputs)
        return replace(self, outputs={name: self.outputs[name] for name in outputs})

    @checked(start=NUMBER, end=(lambda end: float(end) > 0.0, 'a number > 0'))
    def cut(self, start: float = 0.0, end: float = np.inf) -> Record:
        """
        Return the part from `start` to `end` [s], whose time begins at 0 again.

        An input has its value at `start` there; ParameterError: an output has too few samples.
        """
        if not 0.0 <= start < end:
            raise ParameterError(f'start and end must be 0 <= start < end, got {start:g} and '
                                 f'{end:g}')

        near = 1e-6 * self.period  # within which a sample is at the start

        def part(name, channel, is_input):
            t, values = channel.t - start, channel.values
            if is_input and t[0] < -near and np.abs(t).min() > near:
                after = np.searchsorted(t, 0.0)
                degree = 5 if name == DRIVE else HOLDS[channel.hold]
                x, y = (each[max(after - 10, 0):after + 10] for each in (t, values))
                value = make_interp_spline(x, y, min(degree, len(x) - 1))(min(0.0, x[-1]))
                t, values = np.insert(t, after, 0.0), np.insert(values, after, value)
            kept = (t >= -near) & (t <= end - start)
            kept[0] |= is_input and name != DRIVE and not kept.any()  # it holds before, too
            found = channel._replace(t=np.maximum(t[kept], 0.0), values=values[kept])
            _check_count(name, len(found.t), not is_input, f'from {start:g} s to {end:g} s of '
                         f'{self.duration:g} s, {self.source}')
            return found
        return Record({name: part(name, channel, True) for name, channel in self.inputs.items()},
                      {name: part(name, channel, False) for name, channel in self.outputs.items()},
                      self.source)


def _check_count(name, count, is_output, place):
    if count < (fewest := _MIN_SAMPLES if is_output or name == DRIVE else 1):
        raise ParameterError(f'{name} must have at least {fewest} finite samples, got {count} '
                             f'({place})')


def _check_channel(name, channel, source, is_output):
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
    if np.abs(values).max() > _MAX_VALUE:
        raise ParameterError(f'values of {name} must be at most {_MAX_VALUE:g} in size, got '
                             f'{np.abs(values).max():g} ({source})')
    if len(late := np.flatnonzero(np.diff(t) <= 0.0)):
        raise ParameterError(f'times of {name} must ascend, got {t[late[0]]:.12g} s and then '
                             f'{t[late[0] + 1]:.12g} s ({source})')
    found = Channel(t, values, *more)
    least = max(_MIN_NOISE * np.abs(values).max(), np.finfo(float).tiny)
    if found.noise is not None and not least < found.noise < _MAX_VALUE:
        raise ParameterError(f'noise of {name} must be > 0 and at least {_MIN_NOISE:g} of the '
                             f'largest value, got {short(found.noise)} ({source})')
    if found.hold not in HOLDS:
        raise ParameterError(f'hold of {name} must be one of {", ".join(HOLDS)}, got '
                             f'{short(found.hold)} ({source})')
    return found
