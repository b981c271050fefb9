# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Loads that a scene prescribes over time, and the prescribed angle of a driven shaft.

Loads are harmonic, piecewise constant, linear between points, or sums of those. `steps.loads`
computes what the steps see of them. A jump inside a step is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from timo_sim.compiled.functions import WIDTH
from timo_sim.model.layout import ACCELERATION, ANGLE, INPUTS, LOADS, STEP_LOADS
from timo_sim.scene.parameters import StepError
from timo_sim.steps.bristles import fastest, mobilities, MORE, REACH, SLOW, springs_of
from timo_sim.steps.loads import add_scene_loads, NEAR, POINT, SceneLoads

# Columns of the inputs that a scene may prescribe over time, by name.
CHANNELS = {each.name: column for column, each in enumerate(INPUTS) if each.prescribed}


@dataclass(frozen=True)
class Harmonic:
    """amplitude sin(2 pi frequency t + phase); frequency in [Hz], phase in [rad]."""

    amplitude: float
    frequency: float
    phase: float

    def jumps(self) -> Sequence[float]:
        """Return no time: it does not jump."""
        return ()


@dataclass(frozen=True)
class Piecewise:
    """0 before time[0] [s], then value[i] until time[i + 1]; the last value holds for ever."""

    time: tuple
    value: tuple

    def jumps(self) -> Sequence[float]:
        """Return the times at which it jumps [s]."""
        return self.time

    def rows(self, step: float) -> np.ndarray:
        """Return times for steps of this size, twice, and values before and after, (2 n, 2)."""
        times = np.rint(np.array(self.time) / step) * step
        return np.column_stack([np.repeat(times, 2), np.repeat([0.0, *self.value], 2)[1:-1]])


@dataclass(frozen=True)
class Table:
    """Linear between (time[i] [s], value[i]), constant outside; a repeated time is a jump."""

    time: Sequence[float] | np.ndarray
    value: Sequence[float] | np.ndarray

    def jumps(self) -> Sequence[float]:
        """Return the times at which it jumps [s]."""
        return tuple(a for a, b in zip(self.time, self.time[1:]) if a == b)

    def rows(self, step: float) -> np.ndarray:
        """Return times for steps of this size, and values, shape (n, 2)."""
        return np.column_stack([on_boundaries(self.time, step), self.value])


@dataclass(frozen=True)
class Drive:
    """
    The angle of a driven shaft: quintic polynomials between points, then constant speed.

    Neighbouring polynomials have the same angle, speed and acceleration at their common point.
    """

    time: tuple          # [s], the first 0
    angle: tuple         # [rad]
    speed: tuple         # [rad/s]
    acceleration: tuple  # [rad/s2], the last 0

    def rows(self, step: float) -> np.ndarray:
        """
        Return times and polynomials for steps of this size, shape (n, 7).

        From each time on the angle is a polynomial of the time since, constant first.
        """
        time = on_boundaries(self.time, step)
        angle, speed, half = np.array([self.angle, self.speed, self.acceleration]) * [
            [1.0], [1.0], [0.5]]
        found = np.zeros((len(time), POINT))
        found[:, 0], found[:, 1], found[:, 2], found[:, 3] = time, angle, speed, half
        h = np.diff(time)
        # What the parabola of a point lacks at the next one, times powers of h.
        lacking = np.stack([
            np.diff(angle) - h * (speed[:-1] + h * half[:-1]),
            h * (np.diff(speed) - 2.0 * h * half[:-1]), h * h * np.diff(half)])
        cubic = np.array([[10.0, -4.0, 1.0], [-15.0, 7.0, -2.0], [6.0, -3.0, 1.0]])
        found[:-1, 4:] = (cubic @ lacking / h ** np.array([[3], [4], [5]])).T
        return found


@dataclass(frozen=True)
class Load:
    """The loads of a scene: a tuple of terms to be summed for each of `CHANNELS`, and a drive."""

    terms: dict[str, tuple[Any, ...]]
    drive: Any = None

    def __bool__(self):
        return any(self.terms.values())

    @property
    def columns(self) -> list[int]:
        """The columns of loads that are not zero, see `model.layout`, a list of int."""
        found = [CHANNELS[channel] for channel, terms in self.terms.items() if terms]
        return found if self.drive is None else [*found, *range(ANGLE, ACCELERATION + 1)]

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
            step, rows.harmonics, len(rows.harmonics), rows.tables, len(rows.tables), rows.knots,
            rows.drive, len(rows.drive), first, count, loads, np.empty(WIDTH))
        return loads

    def rows(self, step: float) -> SceneLoads:
        """Return the constants of its terms for steps of a size [s]; they are made once."""
        known = self.__dict__.setdefault('_rows', {})
        if step not in known:
            harmonics: list[Any] = []
            tables: list[Any] = []
            knots = [np.empty((0, 2))]
            for channel, terms in self.terms.items():
                for term in terms:
                    if isinstance(term, Harmonic):
                        harmonics.append((CHANNELS[channel], term.amplitude, term.frequency,
                                          np.fmod(term.phase, 2.0 * np.pi)))
                        continue
                    begin = sum(map(len, knots))
                    knots.append(term.rows(step))
                    tables.append((CHANNELS[channel], begin, begin + len(knots[-1])))
            known[step] = SceneLoads(
                step, np.array(harmonics, dtype=float).reshape(-1, 4),
                np.array(tables, dtype=float).reshape(-1, 3), np.concatenate(knots),
                np.empty((0, POINT)) if self.drive is None else self.drive.rows(step))
        return known[step]


def on_boundaries(times: Any, step: float) -> np.ndarray:
    """Return times [s], with those near the boundary of two steps moved onto it."""
    times = np.asarray(times, dtype=float)
    whole = np.rint(times / step)
    return np.where(np.abs(times / step - whole) <= NEAR, whole * step, times)


# A step is stable up to 2.785 over the rate at which friction brakes joints, as is measured for 0
# to 5 modes; the mobility of joints may grow a little in a run.
_STABLE = 2.5
# Largest phase in a step of the fastest vibration of a gear with play, or of joints on bristles.
# From 1.5 on contacts without damping gain energy, as is measured for rigid and bending arms, held
# and free.
_CONTACT = 1.0


def check_slope(scene: Any) -> None:
    """Raise StepError if steps are too long for friction over a speed or way, or for backlash."""
    gear, bristles = scene.manipulator.gear, scene.bristles
    # By joint as bristles: carrier x, y, rotor or shaft, shaft of an elastic gear.
    limit, speed, asymmetry = np.array(scene.manipulator.coulomb)[
        [0, 0, 2 if gear else 1, 1]].T * [[1.0, 1.0, 1.0, bool(gear)], 4 * [1.0], 4 * [1.0]]
    if not limit.any() and not bristles[:, REACH].any() and not (gear and gear.backlash):
        return
    mobile = mobilities(scene.build(), scene.initial_motion())
    # The steepest slope of t (1 + a t) is at most 1 + 0.52 a times the one at rest, and that of
    # 1 / (1 + x^2) is 0.65.
    slope = limit / speed * (1.0 + 0.52 * np.abs(asymmetry)) + 0.65 * bristles[
        :, :2].max(axis=1) * np.abs(bristles[:, MORE]) / bristles[:, SLOW]
    rate = fastest(slope, mobile)
    bristle = np.sqrt(fastest(springs_of(bristles), mobile))
    contact = 0.0
    if gear and gear.backlash:  # its twist is the rotor's angle less that of the shaft
        contact = max(np.sqrt(gear.stiffness * (each[2, 2] + each[3, 3] - 2.0 * each[2, 3]))
                      for each in mobile)
    for found, most, what, name, power in (
            (contact, _CONTACT, 'backlash of a gear with this stiffness', 'motor.gear.stiffness',
             -2),
            (bristle, _CONTACT, 'Coulomb friction with so small a presliding',
             'coulomb_presliding', 2),
            (rate, _STABLE, 'Coulomb friction with this slope', 'coulomb_speed', 1)):
        if found * scene.step > most:
            longest = 0.99 * most / found
            default = ' (as large as 0.001 rad or 0.0001 m by default)' * (power == 2)
            raise StepError(f'integrator.step = {scene.step:g} s must be at most {longest:.3g} s '
                            f'for {what}: take that, or a {name} '
                            f'{(scene.step / longest)**power:.3g} times as large{default}',
                            longest)
