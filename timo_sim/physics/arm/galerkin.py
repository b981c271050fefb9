# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Eigenmodes of the clamped arm by the Legendre-Galerkin method: any section along the arm."""

import functools

import numpy as np

from timo_sim.physics.arm.quadrature import Quadrature


@functools.lru_cache(maxsize=8)
def _operators(breaks, terms):
    # Nodes of the strains and of the fields; from nodal strains to their integral at the points,
    # to themselves at the nodes of the fields, and from there to the integral at the points.
    # Products of two fields, and a section cubic in xi, are integrated exactly.
    nodes, fine = Quadrature(breaks, terms), Quadrature(breaks, terms, extra=3)
    return (nodes, fine, nodes.integrate_to(fine.points), nodes.interpolate_to(fine.nodes),
            fine.integrate_to(fine.points))


def _strain_modes(manipulator, terms, vectors=True):
    # The singular value decomposition of G; factors of the scaled bending and shear strains.
    arm = manipulator.arm
    nodes, fine, once, there, twice = _operators(tuple(arm.breaks.tolist()), terms)
    section = arm.at(nodes.nodes)
    bend = 1.0 / np.sqrt(nodes.weights * section.bending_stiffness)
    shear = 1.0 / np.sqrt(nodes.weights * section.shear_stiffness)
    mass, inertia = (np.sqrt(values)[:, np.newaxis] for values in manipulator.inertia(fine))
    slope = np.hstack([once[:-1] * bend, there * shear])
    matrix = np.vstack([mass * (twice @ slope),
                        inertia * np.hstack([once * bend, np.zeros_like(once)])])
    return np.linalg.svd(matrix, full_matrices=False, compute_uv=vectors), bend, shear


def frequencies(manipulator, count):
    """
    Return the lowest eigenfrequencies of an arm, ascending, shape (count,) [rad/s].

    With fewer terms than `GalerkinModes`: within 1e-6, from a thousandth to the thousandfold of
    the arm's mass at the tip, and from slender to thick; enough to tell modes apart.
    """
    return 1.0 / _strain_modes(manipulator, 2 * count + 8, vectors=False)[0][:count]


class GalerkinModes:
    """
    The lowest modes, mass-normalised, of an arm whose section may vary along it.

    Curvature and shear strain are polynomials in each span on which the section is smooth, given
    by their values at Gauss-Legendre nodes; rotation and deflection are their integrals from
    the clamped root. Nothing has to match where spans meet. With the strain energy
    `|c|^2 / 2` of scaled nodal strains c and the kinetic energy `|G c'|^2 / 2`, the singular
    values of G are 1/omega_n: exact to round-off of the largest, which costs omega_n / omega_1 in
    relative accuracy and not its square. The sign makes the root curvature positive.

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
        # Two nodes for each mode give 1e-12 at the fortieth of a slender arm; the rest is margin
        # for a heavy tip or a strong taper.
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
