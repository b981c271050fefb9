# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Eigenmodes, followed by residual static shapes under loads on the tip or the arm's weight."""

import numpy as np

from timo_sim.physics.arm.quadrature import Quadrature


def _outboard(manipulator, rule):
    """Return bending moment and shear force at the nodes of a rule by load, shape (n_g,) each."""
    distance = manipulator.arm.length - rule.nodes
    mass, _ = manipulator.inertia(rule)
    inner = rule.integrate_to(rule.nodes)
    weight = mass.sum() - inner @ (mass[:-1] / rule.weights)
    return {'force': (distance, np.ones_like(distance)),
            'torque': (np.ones_like(distance), np.zeros_like(distance)),
            'weight': ((rule.integrate_to(rule.points[-1:]) - inner) @ weight, weight)}


class StaticModes:
    """
    Eigenmodes, then residual static shapes, all normalised as in doc/theory.md (T3).

    A residual is a static shape less its share in the eigenmodes. It is orthogonal to them in mass
    and stiffness, and therefore a further mode with the frequency of Rayleigh's quotient (T9).

    Parameters
    ----------
    manipulator : Manipulator
    modes : UniformModes or GalerkinModes
    loads : sequence of str
        Of 'force', 'torque', 'weight'.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular frequencies of the eigenmodes, then of the static shapes [rad/s].

    """

    def __init__(self, manipulator, modes, loads):
        arm = manipulator.arm
        self._modes = modes
        self._rule = rule = Quadrature(arm.breaks, 4 * len(modes) + 40)
        section = arm.at(rule.nodes)
        bending, shearing = (np.broadcast_to(stiffness, rule.nodes.shape)[:, np.newaxis]
                             for stiffness in (section.bending_stiffness, section.shear_stiffness))
        found = _outboard(manipulator, rule)
        moment, force = np.moveaxis(np.array([found[load] for load in loads]), 0, -1)
        curvature, shear = moment / bending, force / shearing
        weights = rule.weights[:, np.newaxis]
        bent, sheared = modes.curvature(rule.nodes), modes.shear(rule.nodes)
        for _ in range(2):  # twice, since cancellation is strong beside many modes
            share = (bent.T @ (weights * bending * curvature)
                     + sheared.T @ (weights * shearing * shear)) / modes.omega[:, np.newaxis]**2
            curvature, shear = curvature - bent @ share, shear - sheared @ share
        # The residuals of two loads are also uncoupled from each other, and normalised.
        self._curvature, self._shear = curvature, shear
        mass, inertia = manipulator.inertia(rule)
        deflection, rotation = (field(rule.points)[:, len(modes):] for field in (
            self.deflection, self.rotation))
        kinetic = (deflection.T * mass) @ deflection + (rotation.T * inertia) @ rotation
        strain = (curvature.T @ (weights * bending * curvature)
                  + shear.T @ (weights * shearing * shear))
        inverse = np.linalg.inv(np.linalg.cholesky(strain))
        squares, vectors = np.linalg.eigh(inverse @ kinetic @ inverse.T)
        self.omega = np.append(modes.omega, 1.0 / np.sqrt(squares[::-1]))
        vectors = (inverse.T @ vectors / np.sqrt(squares))[:, ::-1]
        vectors *= np.sign((rule.interpolate_to(np.zeros(1)) @ curvature @ vectors)[0])
        self._curvature, self._shear = curvature @ vectors, shear @ vectors

    def __len__(self):
        return len(self._modes) + self._curvature.shape[1]

    def deflection(self, xi):
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        nodes = self._rule.integrate_to(self._rule.nodes) @ self._curvature + self._shear
        return np.hstack([self._modes.deflection(xi), self._rule.integrate_to(xi) @ nodes])

    def rotation(self, xi):
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return np.hstack([self._modes.rotation(xi),
                          self._rule.integrate_to(xi) @ self._curvature])

    def curvature(self, xi):
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        return np.hstack([self._modes.curvature(xi),
                          self._rule.interpolate_to(xi) @ self._curvature])

    def shear(self, xi):
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return np.hstack([self._modes.shear(xi), self._rule.interpolate_to(xi) @ self._shear])
