# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The natural vibrations of a scene about rest, or of its arm on a shaft that turns steadily."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.extras import optional
from timo_sim.model.layout import ANGLE, LOADS, rotate, SPEED
from timo_sim.model.statics import equilibrium
from timo_sim.runs.linear import state_matrix
from timo_sim.scene.parameters import ParameterError, short
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.simulation.finer import refine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 41  # of the arm, whose largest displacement is that of a shape
# Least imaginary part of a pole that vibrates [1/s], and over the largest pole: round-off splits
# the double poles of a free joint.
_LEAST, _LEAST_SHARE = 1e-3, 1e-7


@dataclass(frozen=True, repr=False)
class Vibrations:
    """
    The n natural vibrations of a scene, by ascending frequency.

    At k shaft speeds all arrays have k as first size; where a speed has fewer vibrations than
    another, its last ones are NaN.

    Attributes
    ----------
    scene : Scene
        With the carrier held and the shaft driven, if there is a speed.
    speed : float, ndarray of shape (k,), or None
        Speed of the shaft [rad/s]; None: shaft and carrier are as in the scene.
    motion : ndarray, shape (2 (3 + N),)
        State of rest, or of steady rotation, about which it vibrates.
    poles : ndarray of complex, shape (n,)
        With positive imaginary parts [1/s].
    vectors : ndarray of complex, shape (n, 3 + N)
        Carrier, shaft and modal coordinates; the largest displacement of the arm is 1 m.
    error : ndarray, shape (n,)
        Estimated relative error of the frequencies: their distance from those of a model with
        three more modes in bending and, in `exact`, one more axial mode.

    Examples
    --------
    >>> import timo_sim
    >>> found = timo_sim.modes('paper')
    >>> found.frequency.round(2), found.shapes([1.0, 2.0]).shape
    (array([ 4.27,  9.96, 30.59]), (3, 2, 2))
    >>> timo_sim.modes('spin_up', speed=[0.0, 6.0]).frequency[:, 0].round(3)
    array([0.604, 0.719])

    """

    scene: Scene
    speed: Any
    motion: np.ndarray
    poles: np.ndarray
    vectors: np.ndarray
    error: np.ndarray

    @property
    def omega(self) -> np.ndarray:
        """Natural angular frequencies, without damping, shape (n,) [rad/s]."""
        return np.abs(self.poles)

    @property
    def frequency(self) -> np.ndarray:
        """Natural frequencies, shape (n,) [Hz]."""
        return self.omega / (2.0 * math.pi)

    @property
    def damping(self) -> np.ndarray:
        """Damping ratios, shape (n,); negative: the vibration grows."""
        return -self.poles.real / self.omega

    def shapes(self, xi: ArrayLike) -> np.ndarray:
        """
        Return displacements of points of the centre line, carrier and shaft included.

        Along and across the shaft, complex, shape (n, p, 2), for distances xi from the root, (p,)
        [m]. The largest displacement of the arm is 1 m.
        """
        if np.ndim(self.speed):
            return np.array([_shapes(self.scene, *each, xi)
                             for each in zip(self.motion, self.vectors)])
        return _shapes(self.scene, self.motion, self.vectors, xi)

    def plot(self) -> Figure:
        """Draw up to six shapes, or frequencies over several speeds; needs matplotlib."""
        with optional():
            from timo_sim.view.plot import campbell, shapes
        return campbell(self) if np.ndim(self.speed) else shapes(self)

    def __str__(self) -> str:
        if np.ndim(self.speed):
            lines = ['speed [rad/s]   error   frequencies [Hz]'] + [
                f'{speed:13.6g} {np.nanmax(error):7.1g}' + ''.join(f'{each:12.6g}' for each in row)
                for speed, error, row in zip(self.speed, self.error, self.frequency)]
        else:
            lines = ['mode          [Hz]       [rad/s]   damping     error'] + [
                f'{n:4d}  {each[0]:12.6g}  {each[1]:12.6g}  {each[2]:8.2g}  {each[3]:8.1g}'
                for n, each in enumerate(zip(self.frequency, self.omega, self.damping.round(12) + 0.0,
                                             self.error), start=1)]
        return '\n'.join(lines)

    def __repr__(self) -> str:
        return f'<Vibrations of {self.scene!r}>\n{self}'


def modes(scene: SceneLike, speed: ArrayLike | None = None) -> Vibrations:
    """
    Return the natural vibrations of a scene about rest, or of its arm at a speed of the shaft.

    Without a speed, carrier and shaft are free or held as in the scene. It is at rest: with
    `initial.equilibrium` where the scene starts, under its loads of t = 0, otherwise where it
    comes to rest under gravity. With a speed, the carrier is held and the shaft turns at exactly
    this speed: the vibrations are those of the clamped arm in the axes of the shaft, about its
    steady rotation. Dry friction is left out.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    speed : float or array_like, shape (k,), optional
        [rad/s]; 0: the clamped arm at rest, at the angle of the shaft with which the scene starts.

    Raises
    ------
    ParameterError
        If there is no such state, or a speed is not finite; if, at a speed other than 0, the
        formulation is not `exact` or there is gravity.

    Examples
    --------
    >>> import timo_sim
    >>> timo_sim.modes('paper', speed=0.0).frequency.round(2)
    array([ 1.79,  9.07, 29.81])

    """
    scene = load_scene(scene)
    if speed is None:
        return _vibrations(scene, None)
    try:
        speeds = np.asarray(speed, dtype=float)
    except (TypeError, ValueError):
        speeds = np.array(np.nan)
    if speeds.ndim > 1 or not speeds.size or not np.isfinite(speeds).all():
        raise ParameterError(f'speed must be finite, one or a list [rad/s], got {short(speed)}')
    _check_speeds(scene, speeds)
    found = [_vibrations(scene, float(each)) for each in np.atleast_1d(speeds)]
    if not speeds.ndim:
        return found[0]
    most = max(len(each.poles) for each in found)
    poles, vectors, error = (np.array([np.concatenate([values, np.full(
        (most - len(values), *values.shape[1:]), np.nan)]) for values in (
            getattr(each, name) for each in found)]) for name in ('poles', 'vectors', 'error'))
    return Vibrations(found[0].scene, speeds, np.array([each.motion for each in found]), poles,
                      vectors, error)


def _check_speeds(scene, speeds):
    form, gravity = scene.values['model.formulation'], scene.values['gravity']
    if speeds.any() and form != 'exact':
        raise ParameterError('model.formulation must be exact for vibrations at a shaft speed, '
                             f'got {form}, which lacks the stiffening by centrifugal forces')
    if speeds.any() and any(gravity):
        raise ParameterError('gravity must be [0, 0] for vibrations at a shaft speed, got '
                             f'{short(list(gravity))}: in the axes of the arm it is not steady')


def _vibrations(scene, speed):
    start, load = scene.initial_motion(), np.zeros(LOADS)
    if scene.values['initial.equilibrium']:
        load = scene.load_at_start()
    load[ANGLE], load[SPEED] = start[2], speed or 0.0
    if speed is not None:
        scene = scene.vary({
            'carrier.held': 'both', 'motor.shaft': 'driven', 'motor.drive.time': [0.0],
            'motor.drive.angle': [start[2]], 'motor.drive.speed': [speed],
            'motor.drive.acceleration': [0.0], 'initial.equilibrium': False,
            'initial.carrier_x_velocity': 0.0, 'initial.carrier_y_velocity': 0.0,
            'arm.damping_ratio': scene.build().damping.tolist(), 'arm.damping_of': 'clamped'})
    motion, poles, vectors = _about(scene, start, load)
    exact = scene.values['model.formulation'] == 'exact'
    fine = _about(refine(scene, 1, axial=int(exact), same_equations=True), start, load)[1]
    error = np.abs(np.abs(fine) / np.abs(poles)[:, np.newaxis] - 1.0).min(axis=1, initial=np.inf)
    return Vibrations(scene, speed, motion, poles, vectors, error)


def _about(scene, start, load):
    """Return steady motion, vibrating poles and vectors; the motion is sought from `start`."""
    model = scene.build()
    motion = np.zeros(model.size)
    motion[:3] = start[:3]
    if model.gravity.any() or np.delete(load, ANGLE).any():
        count = min(len(start) // 2 - 3, len(model.modes))
        motion[3:3 + count] = start[3:3 + count]
        try:
            motion = equilibrium(model, motion, load)
        except ValueError as error:
            raise ParameterError(f'there must be a state of rest, but {error}') from None
    a, _, places = state_matrix(model, motion, load)
    poles, found = np.linalg.eig(a)
    vibrating = np.flatnonzero(
        poles.imag > max(_LEAST, _LEAST_SHARE * np.abs(poles).max(initial=0.0)))
    vibrating = vibrating[np.argsort(np.abs(poles[vibrating]))]
    vectors = np.zeros((len(vibrating), model.size // 2), dtype=complex)
    half = len(places) // 2
    vectors[:, places[:half]] = found[:half, vibrating].T
    line = np.linspace(0.0, model.manipulator.arm.length, _POINTS)
    moved = _shapes(scene, motion, vectors, line).reshape(len(vectors), 2 * _POINTS)
    largest = np.argmax(np.abs(moved), axis=1)[:, np.newaxis]
    return motion, poles[vibrating], vectors / np.take_along_axis(moved, largest, axis=1)


def _shapes(scene, motion, vectors, xi):
    """Return displacements along and across the shaft, see `Vibrations.shapes`."""
    model = scene.build()
    points, found = model.at(np.ravel(xi)), 0.0
    for part, unit in (vectors.real, 1.0), (vectors.imag, 1.0j):
        motions = np.tile(motion, (len(vectors), 1))
        motions[:, model.size // 2:] = part
        world = model.velocities(motions, points)[0]
        found = found + unit * np.stack(rotate(-motion[2], *np.moveaxis(world, -1, 0)), axis=-1)
    return found
