# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is read off motions of any formulation: places, velocities, energy, momentum."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from timo_sim.physics.layout import rotate


class Observables(ABC):
    """What every formulation tells of its motions; `base.Formulation` sets the attributes."""

    manipulator: Any
    modes: Any
    points: Any
    point_mass: np.ndarray
    point_inertia: np.ndarray
    damping: np.ndarray
    gravity: np.ndarray
    constrained: np.ndarray
    size: int

    @abstractmethod
    def centre_line(self, q, points):
        """
        Return the positions of points of the centre line in the arm frame.

        Parameters
        ----------
        q : ndarray, shape (n, N)
        points : Points
            See `at`.

        Returns
        -------
        ndarray, shape (n, p, 2)
            Along axes I and II, from the root [m].

        """

    @abstractmethod
    def centre_line_rate(self, q, qdot, points):
        """Return the rate of `centre_line`, components in the arm frame, shape (n, p, 2) [m/s]."""

    def section_rotation(self, q, points):
        """Return section rotations from the shaft, shape (n, p) [rad]. Source: paper eq. (36)."""
        return q @ points.rotation

    def world(self, motions, points):
        """Return the world positions of points of the centre line, shape (n, p, 2) [m]."""
        along, across = np.moveaxis(self.centre_line(self._split(motions)[0], points), -1, 0)
        turned = np.stack(rotate(motions[..., 2, np.newaxis], along, across), axis=-1)
        return motions[..., np.newaxis, 0:2] + turned

    def energy(self, motions):
        """
        Return kinetic plus strain energy, and the potential of gravity, which is 0 at the origin.

        Parameters
        ----------
        motions : ndarray, shape (n, 2 (3 + N))

        Returns
        -------
        ndarray, shape (n,)
            [J]

        """
        q, qdot = self._split(motions)
        velocity, turning = self.velocities(motions, self.points)
        base = motions[:, self.size // 2:][:, :3]
        body = self.manipulator
        kinetic = (body.base_mass * np.sum(base[:, :2]**2, axis=1)
                   + body.shaft_inertia * base[:, 2]**2
                   + np.sum(velocity**2, axis=2) @ self.point_mass
                   + turning**2 @ self.point_inertia)
        energy = 0.5 * (kinetic + q**2 @ self.modes.omega**2)
        if self.gravity.any():
            energy -= (body.base_mass * motions[:, :2] + np.einsum(
                'p,npi->ni', self.point_mass, self.world(motions, self.points))) @ self.gravity
        return energy

    def friction(self, motions):
        """
        Return the friction of the equations against carrier [N] and shaft [N m], shape (n, 3).

        It is the viscous one and the Coulomb friction that builds up over a speed; coordinates
        that are held, locked or driven have none.
        """
        speeds, body = motions[:, self.size // 2:][:, :3], self.manipulator
        viscous = np.array([body.carrier_friction, body.carrier_friction, body.shaft_friction])
        limit, slow = np.array(body.coulomb)[[0, 0, 1]].T
        return np.where(self.constrained, 0.0,
                        viscous * speeds + limit * np.tanh(speeds / slow))

    def dissipation(self, motions):
        """Return the power that this friction and modal damping take, shape (n,) [W]."""
        rates = motions[:, self.size // 2:]
        return (np.sum(self.friction(motions) * rates[:, :3], axis=1)
                + rates[:, 3:]**2 @ (2.0 * self.damping * self.modes.omega))

    def mass_matrix(self, motion):
        """
        Return the mass matrix of all coordinates at a motion, and the tip's velocities.

        Returns
        -------
        matrix, tip : ndarray, shapes (3 + N, 3 + N), (3, 3 + N)
            Of 3 + N rates; the tip's velocity in world axes and angular velocity per rate.

        """
        half, body = self.size // 2, self.manipulator
        motions = np.tile(motion, (half, 1))
        motions[:, half:] = np.eye(half)
        velocity, turning = self.velocities(motions, self.points)
        matrix = (np.einsum('kpi,p,lpi->kl', velocity, self.point_mass, velocity)
                  + (turning * self.point_inertia) @ turning.T)
        matrix[range(3), range(3)] += [body.base_mass, body.base_mass, body.shaft_inertia]
        return matrix, np.vstack([velocity[:, -1].T, turning[:, -1]])

    def momentum(self, motions):
        """
        Return linear momentum in world axes and angular momentum about the world's origin.

        Parameters
        ----------
        motions : ndarray, shape (n, 2 (3 + N))

        Returns
        -------
        ndarray, shape (n, 3)
            [kg m/s], [kg m/s], [kg m2/s]

        """
        velocity, turning = self.velocities(motions, self.points)
        base = motions[:, self.size // 2:][:, :3]
        body = self.manipulator
        position = self.world(motions, self.points)
        linear = body.base_mass * base[:, :2] + np.einsum('p,npi->ni', self.point_mass, velocity)
        angular = (
            body.base_mass * (motions[:, 0] * base[:, 1] - motions[:, 1] * base[:, 0])
            + body.shaft_inertia * base[:, 2]
            + (position[..., 0] * velocity[..., 1] - position[..., 1] * velocity[..., 0])
            @ self.point_mass
            + turning @ self.point_inertia)
        return np.column_stack([linear, angular])

    def _split(self, motions):
        half = self.size // 2
        return motions[..., 3:half], motions[..., half + 3:]

    def velocities(self, motions, points):
        """
        Return the velocities of points of the centre line and of the sections there.

        Velocity in world axes, shape (n, p, 2) [m/s], and angular velocity of the sections,
        shape (n, p) [rad/s].

        """
        half = self.size // 2
        q, qdot = self._split(motions)
        omega = motions[..., half + 2, np.newaxis]
        along, across = np.moveaxis(self.centre_line(q, points), -1, 0)
        rate_1, rate_2 = np.moveaxis(self.centre_line_rate(q, qdot, points), -1, 0)
        first, second = rate_1 - omega * across, rate_2 + omega * along
        turned = np.stack(rotate(motions[..., 2, np.newaxis], first, second), axis=-1)
        return (motions[..., np.newaxis, half:half + 2] + turned,
                omega + self.section_rotation(qdot, points))
