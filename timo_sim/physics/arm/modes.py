# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Eigenfrequencies and mode shapes of the arm, clamped at its root, with the end effector."""

import functools

import numpy as np

from timo_sim.jit.constants import pack
from timo_sim.physics.arm.galerkin import frequencies, GalerkinModes
from timo_sim.physics.arm.quadrature import Quadrature
from timo_sim.physics.arm.static_modes import StaticModes
from timo_sim.physics.arm.waves import bisect, boundary_conditions, Constants, fields


@functools.lru_cache(maxsize=16)
def modes_of(manipulator, count, static=()):
    """
    Return the lowest modes of a manipulator's arm, both spectra together.

    They are cached, because the check of a scene and its run ask for the same modes.

    Parameters
    ----------
    manipulator : Manipulator
    count : int
        Number of modes N.
    static : tuple of str
        Loads on the tip, 'force' or 'torque', whose static shapes replace the last modes.

    Returns
    -------
    UniformModes, GalerkinModes or StaticModes
        The closed form for a uniform arm.

    """
    if count and static:
        static = static[:count]
        return StaticModes(manipulator, modes_of(manipulator, count - len(static)), static)
    kind = UniformModes if manipulator.arm.uniform else GalerkinModes
    return kind(manipulator, count)


class UniformModes:
    """
    The lowest modes of a uniform arm in closed form, mass-normalised.

    Each is the sum of four waves, see `waves`. The curvature of a mode is positive at the root.

    Source: paper eqs. (8)-(19), (23).

    Parameters
    ----------
    manipulator : Manipulator
        With a uniform arm.
    count : int
        Number of modes N.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular eigenfrequencies, ascending [rad/s].

    Raises
    ------
    ValueError
        If two eigenfrequencies are too close to be separated.

    """

    def __init__(self, manipulator, count):
        section = manipulator.arm.section
        self._arm = pack(Constants(
            manipulator.arm.length, section.mass_per_length, section.bending_stiffness,
            section.shear_stiffness, section.second_moment / section.area,
            section.young_modulus / (section.shear_correction * section.shear_modulus),
            manipulator.end_effector_mass, manipulator.end_effector_inertia))
        self.omega = self._roots(manipulator, count)
        matrices, scales = np.empty((count, 4, 4)), np.empty((count, 4))
        for omega, matrix, scale in zip(self.omega, matrices, scales):
            boundary_conditions(self._arm, omega, matrix, scale)
        self._shape = (np.linalg.svd(matrices)[2][:, -1] / scales).T
        fine = Quadrature(manipulator.arm.breaks, 4 * count + 40)
        mass, inertia = manipulator.inertia(fine)
        deflection, rotation, _, _ = self._fields(fine.points)
        modal_mass = mass @ deflection**2 + inertia @ rotation**2
        self._shape *= np.sign(self.curvature(np.zeros(1))[0]) / np.sqrt(modal_mass)

    def __len__(self):
        return len(self.omega)

    def deflection(self, xi):
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        return self._fields(xi)[0]

    def rotation(self, xi):
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._fields(xi)[1]

    def curvature(self, xi):
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        return self._fields(xi)[2]

    def shear(self, xi):
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._fields(xi)[3]

    def _fields(self, xi):
        values = np.empty((4, len(xi), len(self)))
        # A copy, because read-only points would need machine code of their own.
        fields(self._arm, self.omega, self._shape, np.array(xi, dtype=float), values)
        return values

    def _roots(self, manipulator, count):
        omega = np.zeros(count)
        if count == 0:
            return omega
        guesses = frequencies(manipulator, count + 1)
        # One Galerkin frequency lies between two limits, so the determinant of the boundary
        # conditions must change sign there. The limits are rounded, because the last bits of the
        # guesses depend on the number of BLAS threads, and those of the frequencies should not.
        limits = np.append(0.5 * guesses[0], np.sqrt(guesses[:-1] * guesses[1:]))
        limits = limits.astype(np.float32).astype(float)
        found = bisect(self._arm, limits, omega)
        if found < count:
            raise ValueError(f'mode {found + 1} of the arm is not separate from its neighbours')
        return omega
