# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Strains that an arm would have but its modes lack, see doc/theory.md (T39), (T40).

All is computed for one model or for many of one size at once. Arrays of one model have the states
as first axis; arrays of many models have the models before it, (models, states, ...).
"""

import numpy as np
from scipy.linalg.lapack import dgeev

from timo_sim.physics.equations.stack import stacked
from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.layout import rotate, tip_force, TIP_TORQUE

_LAST = 2  # number of last bending modes whose strain is watched


class LeftOut:
    """
    What strains outside of the modes of one model, or of many, do to the tip.

    Inertia and loads outboard of a section determine its bending moment and shear force, and so
    the strains that the arm would have. The part of them that is not in the modes shifts the tip.
    It also makes natural frequencies too high, so that vibrations run ahead.

    Parameters
    ----------
    models : list of Formulation
        Of one class and size; the arm has at least one mode.
    kept : dict
        Takes the matrices that depend on these alone, for further uses.

    """

    def __init__(self, models, kept):
        self._models, self._model, self.kept = models, stacked(models), kept
        self._alike = self._model is models[0]

    def strains(self, q):
        """Return the strain of the last bending modes for q, (..., k, N); shape (..., k)."""
        # Modes that are left out vary at least as fast along the arm.
        omega, end = self._omega, self._omega.shape[-1] - self._models[0].axial
        # Sums over so short an axis would take ten times as long.
        return sum((np.abs(q[..., k]) * omega[..., k] for k in range(max(0, end - _LAST), end)),
                   start=np.zeros(q.shape[:-1]))

    def shifts(self, before, after, half_time, load):
        """
        Return the shifts of the tip along and across the shaft, shapes (..., k, 2) [m].

        Parameters
        ----------
        before, after : ndarray, shape (..., k, 2 (3 + N))
            Motions just before and after a state, see `flow.flow`.
        half_time : ndarray, shape (..., k)
            Half the time between them [s].
        load : ndarray, shape (..., k, 14)
            Load that acts, friction included.

        Returns
        -------
        bent, stretched : ndarray
            By the strains of bending and shear that are not in the modes, and by the axial force,
            if the model does not stretch.

        """
        model, motion = self._model, 0.5 * (before + after)
        theta, rate = motion[..., 2], 0.5 / half_time[..., np.newaxis]
        count = before.shape[-2]
        speed, turning = model.velocities(np.concatenate([before, after], axis=-2), model.points)
        pull = self._gravity - (
            speed[..., count:, :, :] - speed[..., :count, :, :]) * rate[..., np.newaxis]
        forces = [self._mass * pull[..., axis] for axis in range(2)]
        for force, at_tip in zip(forces, tip_force(load, theta)):
            force[..., -1] += at_tip
        moment = self._inertia * (turning[..., :count, :] - turning[..., count:, :]) * rate
        moment[..., -1] += load[..., TIP_TORQUE]
        q, (rotation, _, shear, *_) = motion[..., 3:motion.shape[-1] // 2], self._fields
        phi, gamma = q @ rotation, q @ shear
        cosine, sine = np.cos(phi), np.sin(phi)
        slope = cosine - gamma * sine, sine + gamma * cosine
        force = self._section_force(*rotate(-theta[..., np.newaxis], *forces))
        curvature, shear = self._strains(q, force, moment, slope, (cosine, sine))
        turn = curvature @ _turned(self._inboard)
        strain = (cosine * force[0] + sine * force[1]) * self._softness
        return (np.concatenate([(-slope[1] * turn - sine * shear) @ self._whole,
                                (slope[0] * turn + cosine * shear) @ self._whole], axis=-1),
                np.concatenate([(strain * cosine) @ self._whole,
                                (strain * sine) @ self._whole], axis=-1))

    def _section_force(self, along, across):
        # The force on each node's section, from forces at the points of mass outboard of it.
        return along @ _turned(self._outboard), across @ _turned(self._outboard)

    def _strains(self, q, force, moment, slope, normal):
        """
        Return the curvature and shear strain at the nodes that are not in the modes (T39).

        For q, (..., k, N); `_section_force`; moments at the points of mass, (..., k, p); slopes
        a, b of the centre line; cosine and sine of the sections' rotation.
        """
        bending = (slope[0] * force[1] - slope[1] * force[0]) @ _turned(self._rest) + (
            moment @ _turned(self._outboard))
        _, curvature, shear, stiffness, shear_stiffness = self._fields
        curved = bending / stiffness - q @ curvature
        sheared = (normal[0] * force[1] - normal[1] * force[0]) / shear_stiffness - q @ shear
        share = ((curved * self._weights * stiffness) @ _turned(curvature)
                 + (sheared * self._weights * shear_stiffness) @ _turned(shear)) / self._omega**2
        return curved - share @ curvature, sheared - share @ shear

    def vibrations(self, step, motions, tip_shift):
        """
        Return left eigenvectors of the straight arm and how far its tip runs ahead, see (T40).

        They belong to its natural vibrations, shape (..., v, m); where a model has fewer of these,
        rows are zero. The tip runs ahead in a step per modal component of the state's rate, shape
        (..., v).

        Parameters
        ----------
        step : float
            [s]
        motions, tip_shift : ndarray, shapes (..., 3 + N, m / 2), (..., 4, m / 2)
            See `run_error.linearised`.

        """
        values, left, right = self._eigen
        half = left.shape[-1] // 2
        # As motions: carrier along y, shaft, modes.
        shapes = _turned(motions @ right[..., :half, :])
        y, theta, q = shapes[..., 1:2], shapes[..., 2:3], shapes[..., 3:]
        omega, points = values.imag[..., np.newaxis], self._model.points
        force = omega**2 * self._mass * (
            y + theta * points.xi[..., np.newaxis, :] + q @ points.deflection)
        moment = omega**2 * self._inertia * (theta + q @ points.rotation)
        straight = 1.0, 0.0
        curvature, shear = self._strains(q, self._section_force(0.0 * force, force), moment,
                                         straight, straight)
        _, _, _, stiffness, shear_stiffness = self._fields
        energy = np.sum((np.abs(curvature)**2 * stiffness + np.abs(shear)**2 * shear_stiffness)
                        * self._weights, axis=-1)
        own = np.sum(np.abs(q)**2 * self._omega**2, axis=-1)
        share = np.divide(0.5 * energy, own, out=np.zeros_like(energy), where=energy != 0.0)
        reach = np.linalg.norm(tip_shift @ right[..., :half, :], axis=-2)
        # What vibrates is twice the real part of an eigenvector.
        return left, 2.0 * share * step * reach * values.imag / np.abs(values)

    @kept
    def _eigen(self):
        # Eigenvalues with a positive imaginary part, with left and right eigenvectors.
        if self._alike:
            return _vibrations(self._models[0].linear)
        found = [_vibrations(model.linear) for model in self._models]
        most = max(len(values) for values, *_ in found)
        size = len(self._models[0].linear)
        values = np.full((len(found), most), 1j)
        left, right = np.zeros((2, len(found), most, size), dtype=complex)
        for k, (own, own_left, own_right) in enumerate(found):
            values[k, :len(own)], left[k, :len(own)], right[k, :len(own)] = (
                own, own_left, own_right.T)
        return values, left, _turned(right)

    def _rows(self, number):
        # Numbers of each model, `number(model)`, to be combined with rows of all states.
        if self._alike:
            return np.asarray(number(self._models[0]))
        return np.array([number(model) for model in self._models])[:, np.newaxis]

    def _matrices(self, matrix):
        # Matrices of each model, `matrix(model)`.
        if self._alike:
            return matrix(self._models[0])
        return np.array([matrix(model) for model in self._models])

    @kept
    def _omega(self):
        return self._rows(lambda model: model.modes.omega)

    @kept
    def _mass(self):
        return self._rows(lambda model: model.point_mass)

    @kept
    def _inertia(self):
        return self._rows(lambda model: model.point_inertia)

    @kept
    def _gravity(self):
        return self._rows(lambda model: model.gravity[np.newaxis])

    @kept
    def _weights(self):
        return self._rows(lambda model: model.quadrature.weights)

    @kept
    def _fields(self):
        """Rotation, curvature, shear of the modes at the nodes; bending and shear stiffness."""
        def at_nodes(name):
            return self._matrices(
                lambda model: getattr(model.modes, name)(model.quadrature.nodes).T)

        def stiffness(name):
            return self._rows(lambda model: _along(model, name))
        return (at_nodes('rotation'), at_nodes('curvature'), at_nodes('shear'),
                stiffness('bending_stiffness'), stiffness('shear_stiffness'))

    @kept
    def _softness(self):
        # Axial strain per axial force; 0 if the model stretches.
        return self._rows(lambda model: (not model.axial) / _along(model, 'axial_stiffness'))

    @kept
    def _inboard(self):
        return self._matrices(
            lambda model: model.quadrature.integrate_to(model.quadrature.nodes))

    @kept
    def _whole(self):
        return self._matrices(lambda model: model.tip_point.integral)

    @kept
    def _rest(self):
        # From nodal values to their integrals from each node to the tip.
        return _turned(self._whole) - self._inboard

    @kept
    def _outboard(self):
        # From values at the points of mass to their sums outboard of each node.
        return self._matrices(
            lambda model: model.points.integral / model.quadrature.weights[:, np.newaxis])


def _turned(matrices):
    """Return matrices, (..., a, b), transposed."""
    return np.swapaxes(matrices, -1, -2)


def _along(model, stiffness):
    # A stiffness of the arm at the nodes.
    nodes = model.quadrature.nodes
    return np.broadcast_to(getattr(model.manipulator.arm.at(nodes), stiffness), nodes.shape)


def _vibrations(linear):
    # LAPACK gives an eigenvector as two columns, those of its real and of its imaginary part.
    real, imaginary, left, right, _ = dgeev(linear)
    first = np.flatnonzero(imaginary > 1e-6 * np.hypot(real, imaginary).max())
    values = real[first] + 1j * imaginary[first]
    left, right = (part[:, first] + 1j * part[:, first + 1] for part in (left, right))
    left = left.conj().T
    return values, left / np.sum(left * right.T, axis=1)[:, np.newaxis], right
