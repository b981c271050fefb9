# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The straight arm on its carrier, and on a shaft that turns, by linear finite elements.

Timoshenko's equations in w and phi, both absolute, by elements of high order (Lagrange polynomials
at Gauss-Lobatto nodes, exact quadrature): the error of a mesh of the default size is round-off.
The arm lies along x, so only motion across it and rotations are modelled.
"""

import numpy as np
from numpy.polynomial import legendre

ELEMENTS, ORDER = 8, 8
# First three frequencies of a thin spinning arm without a tip and a hub, across the plane of
# rotation, by its speed, both over sqrt(E I / (rho A l^4)): Wright, Smith, Thresher and Wang, J.
# Appl. Mech. 49 (1982) 197-202, to the three decimals of G. Bir, AIAA 2009-1035, Table 3a, as the
# tests of pyBModes transcribe it. Within the plane they are sqrt(these^2 - speed^2).
WRIGHT = {
    0.0: (3.516, 22.035, 61.697), 1.0: (3.682, 22.181, 61.842),
    2.0: (4.137, 22.615, 62.273), 3.0: (4.797, 23.320, 62.985),
    4.0: (5.585, 24.273, 63.967), 5.0: (6.450, 25.446, 65.205),
    6.0: (7.360, 26.809, 66.684), 7.0: (8.300, 28.334, 68.386),
    8.0: (9.257, 29.995, 70.293), 9.0: (10.226, 31.771, 72.387),
    10.0: (11.202, 33.640, 74.649), 11.0: (12.184, 35.589, 77.064),
    12.0: (13.170, 37.603, 79.615)}


def _shapes(size):
    """Return nodes from -1 to 1, polynomials; values, slopes and weights at Gauss points."""
    inner = legendre.Legendre.basis(ORDER).deriv().roots().real
    lobatto = np.concatenate([[-1.0], inner, [1.0]])
    gauss, weights = legendre.leggauss(ORDER + 2)
    shapes = np.linalg.inv(legendre.legvander(lobatto, ORDER))
    return (lobatto, shapes, legendre.legval(gauss, shapes),
            2.0 / size * legendre.legval(gauss, legendre.legder(shapes)), 0.5 * size * weights)


class LinearBeam:
    """
    A scene at rest with a uniform arm along x; `u` holds w, phi at the nodes, (2 n,).

    Its first number is the y of the carrier, from which a hub reaches to the root.

    Parameters
    ----------
    scene : Scene
        Its modes and its Coulomb friction are not used. Gauge and IMU are at ends of elements.
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
        _, shapes, value, slope, weights = _shapes(size)
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
        gauge, imu = (ORDER * round(scene.values[f'sensor.{name}.position'] / size)
                      for name in ('root_strain', 'tip_imu'))
        self._strain, self._imu = np.zeros(2 * count), imu or count - 1
        self._strain[count + gauge:count + gauge + ORDER + 1] = (
            section.height / size * legendre.legval(-1.0, legendre.legder(shapes)))
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
                'tip_acceleration_m_per_s2': s**2 * u[self._imu],
                'root_strain': self._strain @ u,
                'carrier_y_force_N': held[0], 'shaft_torque_N_m': held[half]}


def spinning(scene, speed, count, elements=3):
    """
    Return the lowest frequencies of the arm, clamped to a shaft that turns at a speed, (count,).

    Displacements u, w along and across the turning shaft and rotation phi vibrate about the arm
    that is stretched by centrifugal forces, e_0 = u_0', by Lagrange's equations with

        T = 1/2 int m ((u' - Omega w)^2 + (w' + Omega (x + u_0 + u))^2) + J (phi' + Omega)^2
        U = 1/2 int E A e^2 + kappa G A gamma^2 + E I phi_x^2
        e = (1 + e_0 + u_x) cos phi + w_x sin phi - 1
        gamma = w_x cos phi - (1 + e_0 + u_x) sin phi

    to second order in u, w and phi, where the dashes of T are rates. [rad/s], for [rad/s].
    """
    body, arm = scene.manipulator, scene.manipulator.arm
    section, size = arm.section, arm.length / elements
    lobatto, _, value, slope, weights = _shapes(size)
    n = elements * ORDER + 1
    line, rotary, rod = (np.zeros((n, n)) for _ in range(3))
    every = [element * ORDER + np.arange(ORDER + 1) for element in range(elements)]
    for nodes in every:
        mass = (value * weights) @ value.T
        line[np.ix_(nodes, nodes)] += section.mass_per_length * mass
        rotary[np.ix_(nodes, nodes)] += section.inertia_per_length * mass
        rod[np.ix_(nodes, nodes)] += section.axial_stiffness * (slope * weights) @ slope.T
    line[-1, -1] += body.end_effector_mass
    rotary[-1, -1] += body.end_effector_inertia
    place = np.empty(n)
    for number, nodes in enumerate(every):
        place[nodes] = size * (number + 0.5 + 0.5 * lobatto)
    steady = np.zeros(n)
    steady[1:] = np.linalg.solve((rod - speed**2 * line)[1:, 1:], speed**2 * (line @ place)[1:])

    stiffness = np.zeros((3, n, 3, n))
    stiffness[0, :, 0] = rod
    for nodes in every:
        strain = steady[nodes] @ slope
        tension = section.axial_stiffness * strain
        at = np.ix_(nodes, nodes)
        shear = np.stack([slope, -(1.0 + strain) * value])  # gamma per w and per phi
        for i in (0, 1):
            for j in (0, 1):
                stiffness[i + 1, :, j + 1][at] += section.shear_stiffness * (
                    shear[i] * weights) @ shear[j].T
        stiffness[2, :, 2][at] += section.bending_stiffness * (slope * weights) @ slope.T - (
            value * weights * tension * (1.0 + strain)) @ value.T
        stiffness[1, :, 2][at] += (slope * weights * tension) @ value.T
        stiffness[2, :, 1][at] += (value * weights * tension) @ slope.T
    mass, coriolis = np.zeros((3, n, 3, n)), np.zeros((3, n, 3, n))
    mass[0, :, 0] = mass[1, :, 1] = line
    mass[2, :, 2] = rotary
    coriolis[0, :, 1], coriolis[1, :, 0] = -2.0 * speed * line, 2.0 * speed * line
    stiffness[0, :, 0] -= speed**2 * line
    stiffness[1, :, 1] -= speed**2 * line
    mass, coriolis, stiffness = (matrix[:, 1:, :, 1:].reshape(3 * n - 3, 3 * n - 3)
                                 for matrix in (mass, coriolis, stiffness))
    # 1 / s is an eigenvalue of a matrix whose largest ones are those of the lowest frequencies.
    inverse = np.linalg.inv(stiffness)
    s = 1.0 / np.linalg.eigvals(np.block([[-inverse @ coriolis, -inverse @ mass],
                                          [np.eye(len(mass)), np.zeros_like(mass)]]))
    return np.sort(s.imag[s.imag > 0.0])[:count]
