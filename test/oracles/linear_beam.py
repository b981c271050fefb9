# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The straight arm on its carrier by linear finite elements: an oracle for linear models.

Timoshenko's equations in w and phi, both absolute, by elements of high order (Lagrange polynomials
at Gauss-Lobatto nodes, exact quadrature): the error of a mesh of the default size is round-off.
The arm lies along x, so only motion across it and rotations are modelled.
"""

import numpy as np
from numpy.polynomial import legendre

ELEMENTS, ORDER = 8, 8


class LinearBeam:
    """
    A scene at rest with a uniform arm along x; `u` holds w, phi at the nodes, (2 n,).

    Its first number is the y of the carrier, from which a hub reaches to the root.

    Parameters
    ----------
    scene : Scene
        Its modes and its Coulomb friction are not used.
    held, locked : bool
        Whether the carrier's y is held; whether the shaft is locked.
    stress_damping : float
        Factor of a stiffness-proportional damping of the arm, C = stress_damping K [s].
    elements : int
        Round-off grows with their number where a heavy tip makes inertia large against stiffness.

    """

    def __init__(self, scene, held=False, locked=False, stress_damping=0.0,
                 elements=ELEMENTS):
        body, arm = scene.manipulator, scene.manipulator.arm
        section, size = arm.section, arm.length / elements
        lobatto = np.concatenate([[-1.0], legendre.Legendre.basis(ORDER).deriv().roots(), [1.0]])
        gauss, weights = legendre.leggauss(ORDER + 2)
        shapes = np.linalg.inv(legendre.legvander(lobatto, ORDER))
        value = legendre.legval(gauss, shapes)  # of each shape at the Gauss points
        slope = 2.0 / size * legendre.legval(gauss, legendre.legder(shapes))
        weights = 0.5 * size * weights
        count = elements * ORDER + 1
        mass, stiffness = np.zeros((2 * count, 2 * count)), np.zeros((2 * count, 2 * count))
        none = np.zeros_like(value)
        for element in range(elements):
            nodes = element * ORDER + np.arange(ORDER + 1)
            place = np.ix_(*2 * [np.concatenate([nodes, count + nodes])])
            for factor, field, matrix in (
                    (section.mass_per_length, [value, none], mass),
                    (section.inertia_per_length, [none, value], mass),
                    (section.bending_stiffness, [none, slope], stiffness),
                    (section.shear_stiffness, [slope, -value], stiffness)):
                field = np.vstack(field)
                matrix[place] += factor * (field * weights) @ field.T
        hub = np.eye(2 * count)
        hub[0, count] = body.hub_radius
        mass, stiffness = hub.T @ mass @ hub, hub.T @ stiffness @ hub
        for place, inertia in ((0, body.base_mass), (count, body.shaft_inertia),
                               (count - 1, body.end_effector_mass),
                               (2 * count - 1, body.end_effector_inertia)):
            mass[place, place] += inertia
        damping = stress_damping * stiffness
        damping[0, 0] += body.carrier_friction
        damping[count, count] += body.shaft_friction
        self.mass, self.damping, self.stiffness = mass, damping, stiffness
        self.free = np.setdiff1d(np.arange(2 * count), held * [0] + locked * [count])
        self._rows = {'force_y_N': 0, 'torque_N_m': count, 'tip_force_y_N': count - 1,
                      'tip_torque_N_m': 2 * count - 1}
        self._strain = np.zeros(2 * count)
        self._strain[count:count + ORDER + 1] = section.height / size * legendre.legval(
            -1.0, legendre.legder(shapes))
        self.length = body.hub_radius + arm.length

    def response(self, cause, frequency):
        """
        Return the complex response to a harmonic load of size 1, by names of `linearize`.

        Parameters
        ----------
        cause : str
            An input of `linearize`.
        frequency : float
            [Hz]

        """
        s = 2j * np.pi * frequency
        matrix = s**2 * self.mass + s * self.damping + self.stiffness
        load, u = np.zeros(len(matrix)), np.zeros(len(matrix), dtype=complex)
        load[self._rows[cause]] = 1.0
        u[self.free] = np.linalg.solve(matrix[np.ix_(self.free, self.free)], load[self.free])
        half, held = len(u) // 2, matrix @ u - load
        return {'carrier_y_m': u[0], 'shaft_rad': u[half], 'tip_y_m': u[half - 1],
                'tip_transverse_m': u[half - 1] - u[0] - u[half] * self.length,
                'tip_rotation_rad': u[-1] - u[half],
                'tip_acceleration_m_per_s2': s**2 * u[half - 1],
                'root_strain': self._strain @ u,
                'carrier_y_force_N': held[0], 'shaft_torque_N_m': held[half]}
