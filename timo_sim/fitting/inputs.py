# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The inputs of a record as loads of a scene."""

from dataclasses import replace
import functools

import numpy as np
from scipy.interpolate import make_interp_spline, make_lsq_spline

from timo_sim.fitting.quantities import DRIVE
from timo_sim.scene.build import motor_constants
from timo_sim.scene.loads import Load, Term
from timo_sim.scene.moments import on_boundaries, parabolas
from timo_sim.scene.parameter import ParameterError

_DEGREE = 5  # of the spline through a driven angle, whose acceleration is smooth
# Limits of commands, and of the rates at which they act, by input.
_LIMITS = {'voltage': ('motor.dc.voltage_limit', None),
           'torque': ('motor.torque_limit', 'motor.torque_rate_limit'),
           **{axis: ('carrier.force_limit', 'carrier.force_rate_limit')
              for axis in ('force_x', 'force_y')}}


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

    def __init__(self, channel, gain=1.0, bias=0.0, delay=0.0, shift=0.0):
        t, values = channel.t + (delay - shift), gain * channel.values + bias
        self._t, self._values, self._holds = t, values, channel.hold == 'zero'
        # The integral from the first sample on, before which its value holds.
        self._integral = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(t))])

    def stages(self, first, count, step):
        if self._holds:
            impulse = np.diff(self._integrate(step * np.arange(first, first + count + 1)))
            return (impulse / step)[:, np.newaxis]
        at = 0.5 * step * np.arange(2 * first, 2 * (first + count) + 1)
        values = np.interp(at, self._t, self._values)
        return np.column_stack([values[:-2:2], values[1::2], values[2::2]])

    def parabolas(self, first, count, step):
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

    def __init__(self, channel, gain=1.0, bias=0.0, delay=0.0, shift=0.0):
        self._spline = _spline(channel.t.tobytes(), channel.values.tobytes(), channel.knots)
        self._ends, self._late = channel.t[[0, -1]], delay - shift
        self._gain, self._bias = gain, bias

    def stages(self, first, count, step):
        """Return angle, speed and acceleration at the stages of steps, shape (count, 3, 3)."""
        at = 0.5 * step * np.arange(2 * first, 2 * (first + count) + 1) - self._late
        inside = (self._ends[0] <= at) & (at <= self._ends[1])
        motion = self._gain * np.stack([
            self._spline(np.clip(at, *self._ends), order) * (inside if order else 1.0)
            for order in range(3)], axis=-1)
        motion[:, 0] += self._bias
        return np.stack([motion[:-2:2], motion[1::2], motion[2::2]], axis=1)


def loads_of(record, scene, sensors, shift=0.0):
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
    terms, drive = {name: [*own] for name, own in scene.load.terms.items()}, scene.load.drive
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


def limited(record, values):
    """Return a record whose inputs are what a scene's actuators make of them, by its values."""
    if 'voltage' in record.inputs and not values['motor.dc.resistance']:
        raise ParameterError('the record has a voltage, which needs a DC motor: '
                             'motor.dc.resistance must be > 0 ohm, and motor.dc.torque_constant')
    inputs = dict(record.inputs)
    for name, (limit, rate) in _LIMITS.items():
        if name in inputs and np.isfinite(values[limit]):
            goals = np.clip(inputs[name].values, -values[limit], values[limit])
            inputs[name] = inputs[name]._replace(values=goals)
        if name in inputs and rate and np.isfinite(values[rate]):
            inputs[name] = _ramped(inputs[name], values[rate])
    return replace(record, inputs=inputs)


def _ramped(channel, rate):
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
