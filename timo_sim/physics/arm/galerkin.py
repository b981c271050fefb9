# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Eigenmodes of a clamped arm with any section along it, by the Legendre-Galerkin method."""

import functools

import numpy as np

from timo_sim.physics.arm.quadrature import Quadrature


@functools.lru_cache(maxsize=8)
def _operators(breaks, terms):
    # Returns the nodes of the strains, the finer nodes and points of the fields, and matrices:
    # nodal strains to integrals at the points, nodal strains to values at the fine nodes, these
    # to integrals at the points. Three more nodes integrate exactly two fields times a cubic.
    nodes, fine = Quadrature(breaks, terms), Quadrature(breaks, terms, extra=3)
    return (nodes, fine, nodes.integrate_to(fine.points), nodes.interpolate_to(fine.nodes),
            fine.integrate_to(fine.points))


@functools.lru_cache(maxsize=8)
def _of_arm(arm, terms):
    # Factors from scaled to nodal strains of bending and shear, and the matrices from scaled
    # strains to deflections and rotations of the points of mass; cached, since manipulators often
    # differ in the end effector alone.
    nodes, _, integrate, interpolate, integrate_fine = _operators(
        tuple(arm.breaks.tolist()), terms)
    section = arm.at(nodes.nodes)
    bend = 1.0 / np.sqrt(nodes.weights * section.bending_stiffness)
    shear = 1.0 / np.sqrt(nodes.weights * section.shear_stiffness)
    slope = np.hstack([integrate[:-1] * bend, interpolate * shear])
    return bend, shear, integrate_fine @ slope, np.hstack(
        [integrate * bend, np.zeros_like(integrate)])


def _strain_modes(manipulator, terms, vectors=True):
    # Returns the singular value decomposition of G, see `GalerkinModes`, and the factors from
    # scaled to nodal strains of bending and shear.
    arm = manipulator.arm
    fine = _operators(tuple(arm.breaks.tolist()), terms)[1]
    bend, shear, deflection, rotation = _of_arm(arm, terms)
    mass, inertia = (np.sqrt(values)[:, np.newaxis] for values in manipulator.inertia(fine))
    matrix = np.vstack([mass * deflection, inertia * rotation])
    return np.linalg.svd(matrix, full_matrices=False, compute_uv=vectors), bend, shear


def frequencies(manipulator, count):
    """
    Return the lowest eigenfrequencies of an arm, ascending, shape (count,) [rad/s].

    With fewer terms than `GalerkinModes` they are within 1e-6 for slender and thick arms with
    0.001 to 1000 times the arm's mass at the tip, which is enough to separate the modes.
    """
    return 1.0 / _strain_modes(manipulator, 2 * count + 8, vectors=False)[0][:count]


class GalerkinModes:
    """
    The lowest modes, mass-normalised, of an arm whose section may vary along it.

    Curvature and shear strain are polynomials in each span on which the section is smooth, given
    by their values at Gauss-Legendre nodes; rotation and deflection are their integrals from
    the clamped root, so they are continuous where spans meet. With the strain energy
    `|c|^2 / 2` of scaled nodal strains c and the kinetic energy `|G c'|^2 / 2`, the singular
    values of G are 1/omega_n. Round-off of the largest costs omega_n a factor omega_n / omega_1
    in relative accuracy; eigenvalues of G^T G would cost its square. The curvature of a mode is
    positive at the root.

    Source: weak form of the paper's (1), (2) with M, J of its Remark 1; doc/theory.md (T8).

    Parameters
    ----------
    manipulator : Manipulator
    count : int
        Number of modes N.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular eigenfrequencies, ascending [rad/s].

    """

    def __init__(self, manipulator, count):
        # Two nodes for each mode give 1e-12 at the fortieth mode of a slender arm; the others are
        # a margin for a heavy tip or a strong taper.
        terms = 2 * count + 30
        self._strains, self._fields = _operators(tuple(manipulator.arm.breaks.tolist()), terms)[:2]
        (_, singular, rows), bend, shear = _strain_modes(manipulator, terms)
        self.omega = 1.0 / singular[:count]
        scaled = rows[:count].T * self.omega
        self._curvature = scaled[:len(bend)] * bend[:, np.newaxis]
        self._shear = scaled[len(bend):] * shear[:, np.newaxis]
        sign = np.sign(self.curvature(np.zeros(1))[0])
        self._curvature *= sign
        self._shear *= sign

    def __len__(self):
        return len(self.omega)

    def deflection(self, xi):
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        nodes = self._fields.nodes
        return self._fields.integrate_to(xi) @ (self.rotation(nodes) + self.shear(nodes))

    def rotation(self, xi):
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._strains.integrate_to(xi) @ self._curvature

    def curvature(self, xi):
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        return self._strains.interpolate_to(xi) @ self._curvature

    def shear(self, xi):
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._strains.interpolate_to(xi) @ self._shear
