# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The equilibrium under gravity and constant loads, and the motion after a load is picked up."""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays, pack
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, Constants
from timo_sim.model.differences import differences
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import copy, momenta, sincos, tip_velocity
from timo_sim.model.layout import SPEED

_SHIFT = 1e-5             # half-width of differences, as a turn of the most turned section [rad]
_MAX_TURN = 0.3           # most that a section turns from one iteration to the next [rad]
_CONVERGED = 1e-12        # turn of the most turned section in the last iteration [rad]
_ITERATIONS = 400
_PUSH = 1e-3              # turn of a section by which an unstable equilibrium is left [rad]
_NEWTON = 1e3             # step over the slowest time constant, beyond which it is Newton's step
_UNBALANCED = 1e-9        # share of all forces that may be left on a free carrier


def equilibrium(model: Formulation, motion: np.ndarray, load: np.ndarray) -> np.ndarray:
    """
    Return a motion at rest in which nothing accelerates, shape (2 (3 + N),).

    A driven shaft turns at the load's speed, with the arm at rest in its axes.

    Found by following `u' = M^-1 F(u)` of the forces F on shaft and modes in implicit steps that
    grow (T47), pseudo-transient continuation (C. T. Kelley, D. E. Keyes, SIAM J. Numer. Anal. 35
    (1998) 508-523). It leads from the given motion downhill to an equilibrium that is stable; the
    carrier and a driven shaft stay where they are. The load, (LOADS,), is constant.

    Raises
    ------
    ValueError
        If there is none: the text says what is not balanced.

    """
    forces = _Forces(model, load)
    half, time, found = model.size // 2, None, not len(forces.turn)
    motion = np.concatenate([motion[:half], np.zeros(half)])
    motion[half + 2] = load[SPEED] if model.driven else 0.0
    for _ in range(_ITERATIONS):
        if found:
            _check_carrier(model, forces.at(motion), load)
            return motion
        flow, slope = forces.flow(motion), forces.slope(motion)
        if not np.isfinite(slope).all():
            break
        # Growth rates of the flow near this motion; the equilibrium is stable if none is positive.
        growth, directions = np.linalg.eig(slope)
        fastest = growth.real.max()
        if time is None:
            time = _MAX_TURN / max(forces.turned_by(flow), _CONVERGED)
        if fastest > 0.0:
            time = min(time, 0.5 / fastest)  # longer steps would go uphill
        while True:  # an implicit step (T47), shorter as long as a section turns too far
            change = np.linalg.solve(np.eye(len(flow)) / time - slope, flow)
            if forces.turned_by(change) <= _MAX_TURN:
                break
            time *= 0.25
        motion = forces.moved(motion, change)
        slowest = max(np.abs(growth).min(), 1e-12 * np.abs(growth).max())
        if forces.turned_by(change) <= _CONVERGED and fastest * time > 0.4:
            # It has come to rest where a direction grows: leave along this one.
            away = directions[:, np.argmax(growth.real)].real
            motion = forces.moved(motion, _PUSH * away / forces.turned_by(away))
        elif forces.turned_by(change) <= _CONVERGED:
            found = time * slowest > _NEWTON
        time *= 4.0
    raise ValueError('no equilibrium was found: under these loads the shaft turns, or the arm '
                     'bends, without end; hold the shaft by motor.shaft or motor.spring')


class _Forces:
    """Forces on a motion at rest; what they do to shaft and modes, as far as these are free."""

    def __init__(self, model, load):
        self._model, self._load = model, load
        self._axes, self._half = len(model.axes), len(model.linear) // 2
        self._unknown = slice(2 + model.driven, model.size // 2)
        self._mobility = model.linear[self._axes:self._half, self._half + self._axes:]
        self.turn = np.append(1.0, model.section_turn_bound)[model.driven:]

    def at(self, motion):
        """Return the forces on free axes of the carrier, shaft and modes, shape (m / 2,)."""
        return self._model.rate(self._model.state(motion), self._load)[self._half:]

    def flow(self, motion):
        """Return the speed M^-1 F of shaft and modes."""
        return self._mobility @ self.at(motion)[self._axes:]

    def slope(self, motion):
        """Return the derivative of the flow, by central differences."""
        return differences(lambda shifts: np.array([
            self.flow(self.moved(motion, shift)) for shift in shifts]), _SHIFT / self.turn)[1]

    def moved(self, motion, change):
        """Return the motion after a change of shaft and modes."""
        motion = motion.copy()
        motion[self._unknown] += change
        return motion

    def turned_by(self, change):
        """Return by how much a section turns at most [rad]."""
        return self.turn @ np.abs(change)


def _check_carrier(model, forces, load):
    weights = np.abs(model.mass * model.gravity).sum() + np.abs(load).sum()
    for axis, left in zip(model.axes, forces):
        if abs(left) > _UNBALANCED * weights:
            raise ValueError('there is no equilibrium, because the carrier is free along '
                             f'{"xy"[axis]} and the forces along it do not balance; hold it with '
                             'carrier.held')


def pick_up(model: Formulation, motion: np.ndarray, mass: float, inertia: float,
            offset: float) -> tuple[np.ndarray, float]:
    """
    Return the motion after a plastic impact with a load at rest, and the energy that is lost.

    The momenta of all free coordinates stay: those of carrier, shaft and modes (T48). The energy
    lost is that of the impact of two bodies, the end effector and the load: forces in the arm are
    finite. Modes take more from the motion, 12 % with five and 1 % with forty in a tested scene;
    that is the energy of the vibrations that they leave out.

    The model has the load of this mass [kg], inertia [kg m2] and offset [m] at its tip. Returns
    the motion, shape (2 (3 + N),), and the energy [J].
    """
    half, motion_after = model.size // 2, motion.copy()
    impact(model.packed, pack(model.root), np.array([mass, inertia, offset]), motion_after)
    matrix, tip = model.mass_matrix(motion)
    body, angle = model.manipulator, motion[2] + float(model.section_rotation(
        motion[3:half], model.tip_point)[0])
    added = _by_tip(mass, inertia, offset, angle)
    both = _by_tip(body.end_effector_mass, body.end_effector_inertia, body.end_effector_offset,
                   angle)
    rates, after = motion[half:], motion_after[half:]
    if len(model.modes) > model.axial + bool(model.gear):  # it bends
        velocity = tip @ rates
        lost = 0.5 * velocity @ (both - added) @ np.linalg.pinv(both) @ added @ velocity
    else:
        # A drive does work on what it moves; the rest is lost.
        before = matrix - tip.T @ added @ tip
        given = np.zeros(half)
        given[:3] = np.where(model.constrained, rates[:3], 0.0)
        lost = 0.5 * (rates @ before @ rates - after @ matrix @ after) + given @ (
            matrix @ after - before @ rates)
    return motion_after, float(lost)


def _by_tip(mass, inertia, offset, angle):
    # The mass matrix of a body off the tip by the tip's velocity in world axes, (3, 3).
    centre = np.eye(3)
    centre[:2, 2] = -offset * np.sin(angle), offset * np.cos(angle)
    return centre.T * [mass, mass, inertia] @ centre


class _Room(NamedTuple):
    """Work arrays: a motion, place and speed of its tip, momenta, and the mass matrix."""

    motion: Annotated[np.ndarray, 'motion']
    place: Annotated[np.ndarray, 3]
    speed: Annotated[np.ndarray, 3]
    kept: Annotated[np.ndarray, 'accelerations']
    matrix: Annotated[np.ndarray, 'accelerations', 'accelerations']


@entry_point(tables=Constants(), root=Constants(), added=Array((3,)), motion=Array(('motion',)))
def impact(tables, root, added, motion):
    """Set the rates after mass, inertia and offset that rested are `added`, see `pick_up`."""
    room, half = local_arrays(_Room, tables), len(motion) // 2
    trial, kept, matrix = room.motion, room.kept, room.matrix
    copy(motion, trial)
    momenta(tables, trial, kept)
    x, y = tip_velocity(tables, room)
    turning = motion[half + 2] + room.speed[2]
    sine, cosine = sincos(motion[2] + room.place[2])
    lever_x, lever_y = -added[2] * sine, added[2] * cosine
    x, y = x + lever_x * turning, y + lever_y * turning
    for k in range(half):
        for i in range(half):
            trial[half + i] = 1.0 if i == k else 0.0
        momenta(tables, trial, matrix[k])
        one_x, one_y = tip_velocity(tables, room)
        turn = trial[half + 2] + room.speed[2]
        kept[k] -= (added[0] * ((one_x + lever_x * turn) * x + (one_y + lever_y * turn) * y)
                    + added[1] * turn * turning)
    for k in range(3):
        if root.constrained[k] != 0:  # its rate is given
            for i in range(half):
                kept[i] -= matrix[k, i] * motion[half + k]
                matrix[k, i], matrix[i, k] = 0.0, 0.0
            matrix[k, k], kept[k] = 1.0, motion[half + k]
    for k in range(half):
        for i in range(k + 1, half):
            factor = matrix[i, k] / matrix[k, k]
            kept[i] -= factor * kept[k]
            for j in range(k + 1, half):
                matrix[i, j] -= factor * matrix[k, j]
    for k in range(half - 1, -1, -1):
        for i in range(k + 1, half):
            kept[k] -= matrix[k, i] * kept[i]
        kept[k] /= matrix[k, k]
        motion[half + k] = kept[k]
