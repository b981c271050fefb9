# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The natural vibrations of a scene about rest, or of its arm on a shaft that turns steadily."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.extras import optional
from timo_sim.model.bodies import Constraints
from timo_sim.model.formulation import Formulation, PointsOfArm
from timo_sim.model.layout import ANGLE, LOADS, Motion, rotate, SPEED
from timo_sim.model.statics import equilibrium
from timo_sim.runs.linear import in_contact, state_matrix, warn_of_friction
from timo_sim.scene.parameters import checked, CONTACT, Parameter, ParameterError
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.simulation.finer import MORE_MODES, refine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SPEED = Parameter('speed', 0.0, 'rad/s', 'speed of the shaft')
_POINTS = 41  # of the arm, whose largest displacement is that of a shape


@dataclass(frozen=True, repr=False)
class Vibrations(PointsOfArm):
    """
    The n natural vibrations about a motion, which is rest or steady rotation, by frequency.

    `poles`, (n,) [1/s], have positive imaginary parts. `vectors`, (n, 3 + N), are carrier, shaft
    and modal coordinates, complex; the largest displacement of the arm is 1 m. `error`, (n,), is
    the estimated relative error of the frequencies: their distance from those of a model with
    two more modes in bending and, in `exact`, one more axial mode. Vibrations that are more than
    half of static shapes, by their elastic energy, are left out.
    """

    model: Formulation
    motion: Motion
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
        return (-self.poles.real / self.omega).round(12) + 0.0  # without -0

    def shapes(self, xi: ArrayLike) -> np.ndarray:
        """
        Return displacements of points of the centre line, with those of carrier and shaft.

        Along and across the shaft, complex, (n, p, 2) [m]; xi is as in `Run.position`, (p,) [m].
        """
        points, found = self._points(np.ravel(xi)), []
        for rates in self.vectors.real, self.vectors.imag:
            motions = np.tile(self.motion.values, (len(rates), 1))
            motions[:, self.model.size // 2:] = rates
            world = self.model.velocities(motions, points)[0]
            found.append(np.stack(rotate(-self.motion.shaft, *np.moveaxis(world, -1, 0)), -1))
        return found[0] + 1j * found[1]

    def plot(self) -> Figure:
        """Draw up to six shapes; needs matplotlib."""
        with optional():
            from timo_sim.view.plot import shapes
        return shapes(self)

    def __str__(self) -> str:
        return '\n'.join(['mode          [Hz]       [rad/s]   damping  relative error'] + [
            f'{n:4d}  {hertz:12.6g}  {omega:12.6g}  {damping:8.2g}  {error:14.1g}'
            for n, (hertz, omega, damping, error) in enumerate(
                zip(self.frequency, self.omega, self.damping, self.error), start=1)])

    __repr__ = __str__


@checked(contact=CONTACT)
def modes(scene: SceneLike, speed: float | None = None, contact: str = '') -> Vibrations:
    """
    Return the natural vibrations of a scene about rest, or of its arm at a speed of the shaft.

    Without a speed [rad/s], carrier and shaft are free or held as in the scene. It is at rest:
    with `initial.equilibrium` where the scene starts, under its loads of t = 0, otherwise where it
    comes to rest under gravity. With a speed, the carrier is held and the shaft turns at exactly
    this speed: the vibrations are those of the clamped arm in the axes of the shaft, about its
    steady rotation, or at speed 0 at the scene's initial angle. Dry friction is the
    spring of its presliding. `contact` is that of a gear with backlash, as of
    `linearize`.

    Raises
    ------
    ParameterError
        If there is no such state, or the speed is not finite; if, at a speed other than 0, the
        formulation is not `exact` or there is gravity; if the gear's contact is not known.

    Warns
    -----
    ModelWarning
        If friction builds up over a speed or a way, as of `linearize`.

    Examples
    --------
    >>> import timo_sim
    >>> timo_sim.modes('paper').frequency.round(2)
    array([ 4.27,  9.96, 30.59])
    >>> timo_sim.modes('spin_up', 6.0).frequency.round(2)
    array([ 0.72,  4.4 , 11.28])

    """
    scene = load_scene(scene)
    start, load, constraints = scene.initial_motion(), np.zeros(LOADS), scene.constraints
    exact = scene.values['model.formulation'] == 'exact'
    if scene.values['initial.equilibrium']:
        load = scene.load_at_start()
    load[ANGLE], load[SPEED] = start[2], _SPEED.check(0.0 if speed is None else speed)
    body = scene.manipulator
    if speed is not None:
        constraints = Constraints(tuple(start[:2].tolist()), driven=True)
        body = replace(body, gear=None)
    if load[SPEED] and (not exact or any(scene.values['gravity'])):
        raise ParameterError(
            'vibrations at a shaft speed need model.formulation = exact, since others lack '
            'centrifugal stiffening, and gravity = [0, 0], since it turns in the axes of the '
            f'arm; got {scene.values["model.formulation"]}, {list(scene.values["gravity"])}')
    own, finer = (replace(each, constraints=constraints, manipulator=body, step=0.0) for each in (
        refine(scene, 1, 0, 0, same_equations=True),
        refine(scene, 1, MORE_MODES, int(exact), same_equations=True)))
    warn_of_friction(own, own.build())
    model, motion, poles, vectors = _about(own, start, load, contact)
    fine = np.abs(_about(finer, start, load, contact)[2])
    error = np.abs(fine / np.abs(poles)[:, np.newaxis] - 1.0).min(axis=1, initial=np.inf)
    found = Vibrations(model, Motion(motion), poles, vectors, error)
    moved = found.shapes(np.linspace(0.0, model.manipulator.arm.length, _POINTS))
    moved = moved.reshape(len(poles), 2 * _POINTS)
    largest = np.abs(moved).argmax(axis=1)[:, np.newaxis]
    return replace(found, vectors=vectors / np.take_along_axis(moved, largest, axis=1))


def frequencies_in_motion(scene: Scene) -> np.ndarray:
    """Return frequencies of motions that are large beside backlash and friction, (n,) [Hz]."""
    frictionless = scene.vary({f'{body}.coulomb_friction': 0.0
                               for body in ('carrier', 'motor', 'motor.rotor')})
    return modes(frictionless, contact='closed').frequency


def _about(scene, start, load, contact):
    """Return model, steady motion near a start with as many or less modes, poles, vectors."""
    model = scene.build()
    half = model.size // 2
    motion, known = np.zeros(model.size), min(len(start) // 2, half)
    motion[:3] = start[:3]
    if model.gravity.any() or model.manipulator.spring or np.delete(load, ANGLE).any():
        motion[:known] = start[:known]
        try:
            motion = equilibrium(model, motion, load)
        except ValueError as error:
            raise ParameterError(f'there must be a state of rest, but {error}') from None
    if not len(model.linear):  # rigid, and held
        return model, motion, np.empty(0, complex), np.empty((0, half), complex)
    model, motion = in_contact(scene, model, motion, contact)
    a, _, places = state_matrix(model, motion, load, scene.bristles)
    poles, found = np.linalg.eig(a)
    # Round-off splits the double poles of joints that are free.
    chosen = np.flatnonzero(poles.imag > 1e-3 + 1e-7 * np.abs(poles).max())
    chosen = chosen[np.abs(poles[chosen]).argsort()]
    vectors = np.zeros((len(chosen), half), complex)
    vectors[:, places[:len(places) // 2]] = found[:len(places) // 2, chosen].T
    # A static shape answers loads; its own vibration is none of the arm.
    energy, first = np.abs(vectors[:, 3:] * model.modes.omega)**2, scene.values['model.modes']
    of_shapes = energy[:, first:first + len(scene.static)].sum(axis=1)
    kept = of_shapes <= 0.5 * energy.sum(axis=1)
    return model, motion, poles[chosen][kept], vectors[kept]
