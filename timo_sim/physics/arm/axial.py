# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Axial modes of an arm that stretches, appended to its bending modes."""

import numpy as np

from timo_sim.physics.arm.quadrature import Quadrature


class AxialModes:
    """
    Bending modes, followed by axial modes of the same arm with its end effector.

    Fields have a column for each mode. Axial modes have no deflection, rotation or shear; bending
    modes have no stretch. The first eigenmode of the rod misses 1.4 % of the lengthening of a
    uniform arm that turns. The axial modes therefore span the responses to loads: to centrifugal
    forces, to an acceleration along the arm, then to the inertia of earlier responses. They are
    orthogonal and normalised as the bending modes are (T3).

    Source: load-dependent Ritz vectors, Wilson, Yuan and Dickens, Earthquake Eng. Struct. Dyn. 10
    (1982) 813-821; strains at Gauss nodes and singular values as in `galerkin`.

    Parameters
    ----------
    bending : UniformModes or GalerkinModes
        N modes.
    manipulator : Manipulator
    count : int
        Number of axial modes A.
    constraints : Constraints
        They set the centre of rotation for the centrifugal forces: the root if the carrier is
        held, the mass centre if it is free, the point half-way between if one axis is held.

    Attributes
    ----------
    omega : ndarray, shape (N + A,)
        Angular frequencies of the bending modes, then of the axial ones, both ascending [rad/s].

    """

    def __init__(self, bending, manipulator, count, constraints):
        terms, breaks = 2 * count + 30, manipulator.arm.breaks
        self._bending, self._strains = bending, Quadrature(breaks, terms)
        fine = Quadrature(breaks, terms, extra=3)
        mass, section = manipulator.inertia(fine)[0], manipulator.arm.at(self._strains.nodes)
        free = 0.5 * len(constraints.free_axes)
        centre = free * (mass @ fine.points) / (manipulator.base_mass + mass.sum())
        scale = 1.0 / np.sqrt(self._strains.weights * section.axial_stiffness)
        root_mass = np.sqrt(mass)
        matrix = root_mass[:, np.newaxis] * self._strains.integrate_to(fine.points) * scale
        basis, loads = np.empty((len(scale), 0)), [root_mass * (fine.points - centre), root_mass]
        for number in range(count):
            basis = np.linalg.qr(np.column_stack([basis, matrix.T @ loads[number]]))[0]
            loads.append(matrix @ basis[:, number])
        _, singular, rows = np.linalg.svd(matrix @ basis, full_matrices=False)
        self.omega = np.append(bending.omega, 1.0 / singular)
        self._stretch = scale[:, np.newaxis] * (basis @ (rows.T / singular))
        self._stretch *= np.sign(self._strains.interpolate_to([0.0]) @ self._stretch)

    def __len__(self):
        return len(self.omega)

    def deflection(self, xi):
        """Return W_n(xi), shape (len(xi), N + A) [1/sqrt(kg)]."""
        return self._before_axial(self._bending.deflection(xi))

    def rotation(self, xi):
        """Return Phi_n(xi), shape (len(xi), N + A) [1/(m sqrt(kg))]."""
        return self._before_axial(self._bending.rotation(xi))

    def curvature(self, xi):
        """Return Phi_n'(xi), shape (len(xi), N + A) [1/(m2 sqrt(kg))]."""
        return self._before_axial(self._bending.curvature(xi))

    def shear(self, xi):
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N + A) [1/(m sqrt(kg))]."""
        return self._before_axial(self._bending.shear(xi))

    def stretch(self, xi):
        """Return the axial strain E_n(xi), shape (len(xi), N + A) [1/(m sqrt(kg))]."""
        return self._after_bending(self._strains.interpolate_to(xi) @ self._stretch)

    def displacement(self, xi):
        """Return the integral of E_n from the root to xi, shape (len(xi), N + A) [1/sqrt(kg)]."""
        return self._after_bending(self._strains.integrate_to(xi) @ self._stretch)

    def _before_axial(self, fields):
        return np.pad(fields, ((0, 0), (0, self._stretch.shape[1])))

    def _after_bending(self, fields):
        return np.pad(fields, ((0, 0), (len(self._bending), 0)))
