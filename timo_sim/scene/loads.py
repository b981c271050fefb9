# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Loads that a scene prescribes over time, and the prescribed angle of a driven shaft.

Loads are harmonic, piecewise constant, linear between points, or sums of those.

The compiled step takes three values of a load: at its start, middle and end. If a load jumps at
the boundary of two steps, each step sees its own side; a jump inside a step is refused. If a load
has a kink inside a step, the step sees the parabola with the same moments, see below.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import functools
from functools import cache
from typing import Any

import numpy as np

from timo_sim.model.layout import (
    ACCELERATION, AFTER, ANGLE, INPUTS, LOADS, STAGES, STEP_LOADS)
from timo_sim.scene.parameters import ParameterError

# Replace a load that has a kink inside a step by a parabola with the same moments.
#
# A step takes a load at its start, middle and end, and its linear part integrates the parabola
# through these three values exactly. A load with a kink inside the step is replaced by the
# parabola with the same integral and the same first and second moment: with s from 0 to 1 over the
# step and `I_j = int s^j p ds`,
#
#     p(0)   =    9 I_0 - 36 I_1 + 30 I_2
#     p(1/2) = -3/2 I_0 + 15 I_1 - 15 I_2
#     p(1)   =    3 I_0 - 24 I_1 + 30 I_2

_PARABOLA = np.array([[9.0, -36.0, 30.0], [-1.5, 15.0, -15.0], [3.0, -24.0, 30.0]])
_gauss = cache(np.polynomial.legendre.leggauss)
NEAR = 1e-6  # [steps] distance from a step boundary within which a position counts as on it


def on_boundaries(position: np.ndarray) -> np.ndarray:
    """Return positions, counted in steps, with those near a step boundary moved onto it."""
    whole = np.rint(position)
    return np.where(np.abs(position - whole) <= NEAR, whole, position)


def parabolas(function: Callable[[np.ndarray], np.ndarray], breaks: np.ndarray, degree: int,
              first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the parabolas that replace a piecewise polynomial in steps with a break inside.

    `function` returns values, (n, ...), at positions, (n,), counted in steps, as are `breaks`,
    where pieces of this degree meet; whole numbers are the boundaries of the `count` steps from
    `first` on. The result is the m steps with a break inside, counted from `first`, and the
    parabolas at their start, middle and end, shape (m, 3, ...).
    """
    inside = breaks[(first < breaks) & (breaks < first + count) & (breaks != np.floor(breaks))]
    if not len(inside):
        return inside.astype(int), np.zeros((0, 3, *function(inside).shape[1:]))
    steps = np.unique(np.floor(inside))
    edges = np.unique(np.concatenate([inside, steps, steps + 1.0]))
    # Keep the pieces between these edges that lie in a step with a break.
    owner = np.searchsorted(steps, edges[:-1], side='right') - 1
    within = edges[:-1] < steps[owner] + 1.0
    low, high, owner = edges[:-1][within], edges[1:][within], owner[within]
    # Gauss's rule, exact for such a polynomial times s^2.
    nodes, weights = _gauss((degree + 4) // 2)
    at = low[:, np.newaxis] + (high - low)[:, np.newaxis] * (0.5 + 0.5 * nodes)
    share = 0.5 * (high - low)[:, np.newaxis] * weights
    s = at - steps[owner][:, np.newaxis]
    values = function(at.ravel())
    powers = (share[..., np.newaxis] * s[..., np.newaxis] ** np.arange(3)).reshape(-1, 3)
    moments = np.zeros((len(steps), 3, *values.shape[1:]))
    np.add.at(moments, np.repeat(owner, len(nodes)),
              np.einsum('nj,n...->nj...', powers, values))
    return (steps - first).astype(int), np.einsum('ij,mj...->mi...', _PARABOLA, moments)


# Columns of the inputs that a scene may prescribe over time, by name.
CHANNELS = {each.name: column for column, each in enumerate(INPUTS) if each.prescribed}


@functools.lru_cache(maxsize=2)
def _instants(first, count, step):
    # Times [s] of the starts and middles of steps, and of the end of the last: products of whole
    # numbers, so that no round-off adds up; cached for the next term and the next run.
    times = 0.5 * np.arange(2 * first, 2 * (first + count) + 1) * step
    times.flags.writeable = False
    return times


@functools.lru_cache(maxsize=16)
def _wave(frequency, phase, first, count, step):
    # Runs often differ in the amplitude alone.
    return _of_stages(np.sin(2.0 * np.pi * frequency * _instants(first, count, step) + phase))


def _of_stages(values):
    """Return values at `_instants` as start, middle and end of each step, shape (count, 3)."""
    found = np.empty((len(values) // 2, STAGES))
    found[:, 0], found[:, 1], found[:, 2] = values[:-2:2], values[1::2], values[2::2]
    return found


class Term:
    """
    A term of a load, as a function of time.

    `jumps()` returns the times at which it jumps [s]. The other methods are for `count` steps of
    size `step` [s], from step `first` on. `stages` returns values at start, middle and end of each
    step, shape (count, 3), or (count, 1) if these are the same. `parabolas` returns which steps
    have a kink inside, and what replaces their stages, see `parabolas`.
    """

    def jumps(self) -> Sequence[float]:
        return ()

    def parabolas(self, first: int, count: int,
                  step: float) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(0, dtype=int), np.zeros((0, STAGES))


@dataclass(frozen=True)
class Harmonic(Term):
    """amplitude sin(2 pi frequency t + phase); frequency in [Hz], phase in [rad]."""

    amplitude: float
    frequency: float
    phase: float

    def stages(self, first: int, count: int, step: float) -> np.ndarray:
        return self.amplitude * _wave(self.frequency, self.phase, first, count, step)


@dataclass(frozen=True)
class Piecewise(Term):
    """0 before time[0] [s], then value[i] until time[i + 1]; the last value holds for ever."""

    time: tuple
    value: tuple

    def jumps(self) -> Sequence[float]:
        return self.time

    @functools.cached_property
    def _points(self):
        return np.array(self.time), np.append(0.0, self.value)

    def stages(self, first: int, count: int, step: float) -> np.ndarray:
        time, value = self._points
        begin = np.searchsorted(time, (first - 1) * step)
        end = np.searchsorted(time, (first + count + 1) * step, side='right')
        jumps = np.rint(time[begin:end] / step)  # in or around these steps
        edges = np.concatenate([[first], jumps, [first + count]]).clip(first, first + count)
        return np.repeat(value[begin:end + 1], np.diff(edges).astype(int))[:, np.newaxis]


@dataclass(frozen=True)
class Table(Term):
    """Linear between (time[i] [s], value[i]), constant outside; a repeated time is a jump."""

    time: tuple
    value: tuple

    def jumps(self) -> Sequence[float]:
        return tuple(a for a, b in zip(self.time, self.time[1:]) if a == b)

    @functools.cached_property
    def _points(self):
        return np.array(self.time), np.array(self.value)

    def _pieces(self, first, count, step):
        # Times and values of the knots from the last before these steps to the first after them.
        time, value = self._points
        begin = max(np.searchsorted(time, (first - 1) * step) - 1, 0)
        part = slice(begin, np.searchsorted(time, (first + count + 1) * step, side='right') + 1)
        position = on_boundaries(time[part] / step)
        # Knots near a step boundary are put exactly on it, so that `stages` finds the right side.
        return np.where(position == np.rint(position), position * step, time[part]), value[part]

    def stages(self, first: int, count: int, step: float) -> np.ndarray:
        times = _of_stages(_instants(first, count, step))
        knots, value = self._pieces(first, count, step)
        right = np.stack([np.searchsorted(knots, times[:, 0], side='right'),
                          np.searchsorted(knots, times[:, 1], side='right'),
                          np.searchsorted(knots, times[:, 2], side='left')], axis=1)
        low, high = np.maximum(right - 1, 0), np.minimum(right, len(knots) - 1)
        span = knots[high] - knots[low]
        share = np.where(span > 0.0, (times - knots[low]) / np.where(span > 0.0, span, 1.0), 0.0)
        return value[low] + share * (value[high] - value[low])

    def parabolas(self, first: int, count: int,
                  step: float) -> tuple[np.ndarray, np.ndarray]:
        knots, value = self._pieces(first, count, step)
        return parabolas(lambda at: np.interp(at * step, knots, value),
                         on_boundaries(knots / step), 1, first, count)


@dataclass(frozen=True)
class Drive(Term):
    """
    The angle of a driven shaft: quintic polynomials between points, then constant speed.

    Neighbouring polynomials have the same angle, speed and acceleration at their common point.
    """

    time: tuple          # [s], the first 0
    angle: tuple         # [rad]
    speed: tuple         # [rad/s]
    acceleration: tuple  # [rad/s2], the last 0

    @functools.cached_property
    def _curve(self):
        # Imported here because it takes a quarter of a second and only a drive needs it.
        from scipy.interpolate import BPoly
        return BPoly.from_derivatives(
            self.time, np.column_stack([self.angle, self.speed, self.acceleration]))

    def polynomials(self) -> np.ndarray:
        """Return coefficients of the angle from each point on, constant first, shape (n, 6)."""
        from scipy.interpolate import PPoly
        found = np.zeros((len(self.time), 6))
        found[-1, :2] = self.angle[-1], self.speed[-1]
        if len(self.time) > 1:
            found[:-1] = PPoly.from_bernstein_basis(self._curve).c[::-1].T
        return found

    def _at(self, time):
        # Angle, speed and acceleration, as a new last axis, at times of any shape.
        beyond = time - self.time[-1]
        zero = np.zeros_like(time)
        motion = np.stack([self.angle[-1] + self.speed[-1] * beyond, self.speed[-1] + zero, zero],
                          axis=-1)
        within = beyond < 0.0
        if len(self.time) > 1 and within.any():
            for order in range(3):
                motion[within, order] = self._curve(time[within], order)
        return motion

    def stages(self, first: int, count: int, step: float) -> np.ndarray:
        """Return angle, speed and acceleration at the stages of steps, shape (count, 3, 3)."""
        return self._at(_of_stages(_instants(first, count, step)))

    def parabolas(self, first: int, count: int,
                  step: float) -> tuple[np.ndarray, np.ndarray]:
        breaks = on_boundaries(np.array(self.time) / step)
        return parabolas(lambda at: self._at(at * step), breaks, 5, first, count)


@dataclass(frozen=True)
class Load:
    """The loads of a scene: a tuple of terms to be summed for each of `CHANNELS`, and a drive."""

    terms: dict
    drive: Drive | None = None

    def __bool__(self):
        return any(self.terms.values())

    @functools.cached_property
    def _columns(self) -> list[tuple[Any, tuple]]:
        # The columns of loads that are not zero, with their terms.
        found: list[tuple[Any, tuple]] = [*self.by_column()]
        return found if self.drive is None else [
            *found, (slice(ANGLE, ACCELERATION + 1), (self.drive,))]

    def by_column(self) -> list[tuple[int, tuple[Any, ...]]]:
        """Return the columns of prescribed loads with their terms, without the drive."""
        return [(CHANNELS[channel], terms) for channel, terms in self.terms.items() if terms]

    @property
    def columns(self) -> list[int]:
        """The columns of loads that are not zero, see `model.layout`, a list of int."""
        return [column for columns, _ in self._columns
                for column in (range(LOADS)[columns] if isinstance(columns, slice) else [columns])]

    def fastest(self) -> tuple[float, str]:
        """Return the highest frequency of a harmonic term [Hz] and its channel, or (0, '')."""
        return max(((term.frequency, channel) for channel, terms in self.terms.items()
                    for term in terms if isinstance(term, Harmonic)), default=(0.0, ''))

    def stages(self, first: int, count: int, step: float,
               room: np.ndarray | None = None) -> np.ndarray:
        """
        Return the loads of steps first, first + 1, ..., shape (count, 4, LOADS), see `layout`.

        If `room`, an array for at least as many steps, is given, they are written there and a view
        is returned. Its entries must be zeros, or earlier results of this load.
        """
        loads = np.zeros((count, STEP_LOADS, LOADS)) if room is None else room[:count]
        self.fill(loads, range(LOADS), first, count, step)
        return loads

    def fill(self, loads: np.ndarray, places: Any, first: int, count: int, step: float) -> None:
        """
        Write the columns of loads that are not zero into `loads`, (count, 4, c), see `stages`.

        Column k of `model.layout` stands at `places[k]` in it; those of a drive stand together.
        """
        for columns, terms in self._columns:
            place = places[columns]
            if isinstance(columns, slice):
                place = slice(place[0], place[-1] + 1)
            samples = [term.stages(first, count, step) for term in terms]
            loads[:, :STAGES, place] = total = sum(samples)
            loads[:, AFTER, place] = total[:, -1]
            for term, values in zip(terms, samples):
                steps, seen = term.parabolas(first, count, step)
                if len(steps):
                    loads[steps, :STAGES, place] += seen - values[steps]


# A step is stable up to 2.785 over the rate at which friction brakes joints, as is measured for 0
# to 5 modes; the mobility of joints may grow a little in a run.
_STABLE = 2.5


def check_slope(scene: Any) -> None:
    """Raise ParameterError if steps are too long for friction that builds up over a speed."""
    limit, speed = np.array(scene.manipulator.coulomb)[[0, 0, 1]].T
    if not limit.any():
        return
    model, motion = scene.build(), scene.initial_motion()
    free = [*model.axes, *range(2 + model.driven, model.size // 2)]
    root = np.sqrt(limit / speed)[[joint for joint in free if joint < 3], np.newaxis]
    rate = 0.0
    # Along the arm the carrier is less mobile than across it.
    for motion[2] in (0.0, 0.5 * np.pi):
        mobility = np.linalg.inv(model.mass_matrix(motion)[0][np.ix_(free, free)])
        slopes = root * mobility[:len(root), :len(root)] * root.T
        rate = max(rate, *np.linalg.eigvalsh(slopes), 0.0)
    if rate * scene.step > _STABLE:
        raise ParameterError(f'integrator.step = {scene.step:g} s must be at most '
                             f'{_STABLE / rate:.2g} s for Coulomb friction with this slope: take '
                             f'that, or a coulomb_speed {rate * scene.step / _STABLE:.2g} times '
                             'as large')
