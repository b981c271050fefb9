# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Loads that are known beforehand, and the angle of a driven shaft.

Loads are harmonic, piecewise constant, linear between points, or sums of those.

The compiled step takes three values of a load: at its start, middle and end. Where a load jumps on
the boundary between two steps, either step sees its own side; a jump inside a step would cost
the integrator its order.
"""

from dataclasses import dataclass
import functools

import numpy as np

from timo_sim.physics.layout import (
    ACCELERATION, ANGLE, FORCE_X, FORCE_Y, LOADS, SPEED, STAGES, TIP_TORQUE, TIP_X, TIP_Y, TORQUE)

CHANNELS = {'force_x': FORCE_X, 'force_y': FORCE_Y, 'torque': TORQUE, 'tip_force_x': TIP_X,
            'tip_force_y': TIP_Y, 'tip_torque': TIP_TORQUE}


@functools.lru_cache(maxsize=2)
def _times(first, count, step):
    # Start, middle and end of each step, shape (count, 3): from whole numbers, never summed up;
    # kept for the next term, and the next run.
    times = (np.arange(first, first + count)[:, np.newaxis] + np.array([0.0, 0.5, 1.0])) * step
    times.flags.writeable = False
    return times


class Term:
    """
    A part of a load.

    `jumps()` are the times at which it jumps [s], `stages(first, count, step)` its values at the
    stages of steps first, first + 1, ..., shape (count, 3).
    """

    def jumps(self):
        return ()


@dataclass(frozen=True)
class Harmonic(Term):
    """amplitude sin(2 pi frequency t + phase); frequency in [Hz], phase in [rad]."""

    amplitude: float
    frequency: float
    phase: float

    def stages(self, first, count, step):
        angle = 2.0 * np.pi * self.frequency * _times(first, count, step) + self.phase
        return self.amplitude * np.sin(angle)


@dataclass(frozen=True)
class Piecewise(Term):
    """value[i] from time[i] [s] until time[i + 1], the last for ever, and 0 before time[0]."""

    time: tuple
    value: tuple

    def jumps(self):
        return self.time

    def stages(self, first, count, step):
        begins = np.rint(np.array(self.time) / step)
        piece = np.searchsorted(begins, np.arange(first, first + count), side='right')
        values = np.append(0.0, self.value)[piece]
        return np.repeat(values[:, np.newaxis], STAGES, axis=1)


@dataclass(frozen=True)
class Table(Term):
    """Linear between (time[i] [s], value[i]); held before and after; a jump is a time twice."""

    time: tuple
    value: tuple

    def jumps(self):
        return tuple(a for a, b in zip(self.time, self.time[1:]) if a == b)

    def stages(self, first, count, step):
        times = _times(first, count, step)
        knots = np.array(self.time)
        # A knot on a step boundary is there to the last bit, for the choice of side below.
        steps = np.rint(knots / step)
        knots = np.where(np.isclose(steps * step, knots, rtol=1e-12, atol=0.0),
                         steps * step, knots)
        right = np.stack([np.searchsorted(knots, times[:, 0], side='right'),
                          np.searchsorted(knots, times[:, 1], side='right'),
                          np.searchsorted(knots, times[:, 2], side='left')], axis=1)
        low, high = np.maximum(right - 1, 0), np.minimum(right, len(knots) - 1)
        span = knots[high] - knots[low]
        share = np.where(span > 0.0, (times - knots[low]) / np.where(span > 0.0, span, 1.0), 0.0)
        value = np.array(self.value)
        return value[low] + share * (value[high] - value[low])


@dataclass(frozen=True)
class Drive:
    """
    The angle of a driven shaft: quintic between points, then at the last speed for ever.

    Two neighbours share angle, speed and acceleration at the point where they meet.
    """

    time: tuple          # [s], the first 0
    angle: tuple         # [rad]
    speed: tuple         # [rad/s]
    acceleration: tuple  # [rad/s2], the last 0

    def stages(self, first, count, step):
        """Return angle, speed and acceleration at the stages of steps, shape (count, 3, 3)."""
        time = _times(first, count, step)
        beyond = time - self.time[-1]
        zero = np.zeros_like(time)
        motion = np.stack([self.angle[-1] + self.speed[-1] * beyond, self.speed[-1] + zero, zero],
                          axis=-1)
        if len(self.time) > 1:
            # Imported here: a quarter of a second that only such a scene needs.
            from scipy.interpolate import BPoly
            curve = BPoly.from_derivatives(
                self.time, np.column_stack([self.angle, self.speed, self.acceleration]))
            within = beyond < 0.0
            for order in range(3):
                motion[within, order] = curve(time[within], order)
        return motion


@dataclass(frozen=True)
class Load:
    """Sum of terms for each of `CHANNELS`: a dictionary of tuples; and a shaft's drive."""

    terms: dict
    drive: Drive | None = None

    def __bool__(self):
        return any(self.terms.values())

    def fastest(self):
        """Return the highest frequency of a harmonic term [Hz] and its channel, or (0, '')."""
        return max(((term.frequency, channel) for channel, terms in self.terms.items()
                    for term in terms if isinstance(term, Harmonic)), default=(0.0, ''))

    def stages(self, first, count, step):
        """Return the loads of steps first, first + 1, ..., shape (count, 3, 14)."""
        loads = np.zeros((count, STAGES, LOADS))
        for channel, terms in self.terms.items():
            for term in terms:
                loads[:, :, CHANNELS[channel]] += term.stages(first, count, step)
        if self.drive is not None:
            loads[:, :, [ANGLE, SPEED, ACCELERATION]] = self.drive.stages(first, count, step)
        return loads
