# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Waves of a uniform arm, whose sums are its mode shapes: boundary conditions and fields, compiled.

The characteristic equation (8) has two roots s: one is `-alpha^2`, the other `beta^2` below the
cut-off frequency and `-beta'^2` above it. With `g'' = s g` and `g = G'` the field equations (1),
(2) have the solutions

    W = g     Phi = (s + nu) G     W' - Phi = -nu G     nu = rho A omega^2 / (kappa G A)

A mode is the sum of four, two for each root. For s = -k^2 the pairs (g, G) are (cos, sin / k) and
(-k sin, cos) of k xi; for a small s > 0 the same with cosh and sinh, so that nothing is singular
at the cut-off; for a larger s exponentials that decay from either end, because sinh and cosh of
beta xi, as printed in (18), cancel beyond the twelfth mode.

Source: paper eqs. (8)-(19), with the corrections listed in doc/paper.md; doc/theory.md (T5), (T6),
and (T7) for the boundary conditions.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.jit.decorators import entry_point, strict


class Constants(NamedTuple):
    """A uniform arm and the body at its tip, for the compiled functions."""

    length: float
    mass_per_length: float
    bending_stiffness: float
    shear_stiffness: float
    radius2: float          # I / A [m2]
    ratio: float            # E / (kappa G)
    end_effector_mass: float
    end_effector_inertia: float


@strict
def _wave_numbers(arm, omega):
    """Return both roots s of the characteristic equation, and nu."""
    k2 = omega * np.sqrt(arm.mass_per_length / arm.bending_stiffness)
    root = np.sqrt((0.5 * (1.0 - arm.ratio) * arm.radius2 * k2)**2 + 1.0)
    mean = 0.5 * (1.0 + arm.ratio) * arm.radius2 * k2
    # root - mean, written without the cancellation near the cut-off, where it changes sign.
    second = k2 * (1.0 - arm.ratio * (arm.radius2 * k2)**2) / (root + mean)
    return -k2 * (root + mean), second, arm.mass_per_length / arm.shear_stiffness * omega**2


@strict
def _standing(s, xi):
    """Return cos, sin / k, -k sin, cos of k xi for s = -k^2; hyperbolic for s > 0."""
    k = np.sqrt(abs(s))
    if s > 0.0:
        even, odd = np.cosh(k * xi), np.sinh(k * xi)
    else:
        even, odd = np.cos(k * xi), np.sin(k * xi)
    integral = odd / k if k > 0.0 else xi
    return even, integral, s * integral, even


@strict
def _waves(arm, omega, xi):
    """Return g, G, s of the four waves, and nu."""
    first, second, nu = _wave_numbers(arm, omega)
    g_0, integral_0, g_1, integral_1 = _standing(first, xi)
    if second * arm.length**2 > 1.0:
        beta = np.sqrt(second)
        g_2, g_3 = np.exp(-beta * xi), np.exp(-beta * (arm.length - xi))
        integral_2, integral_3 = -g_2 / beta, g_3 / beta
    else:
        g_2, integral_2, g_3, integral_3 = _standing(second, xi)
    return ((g_0, g_1, g_2, g_3), (integral_0, integral_1, integral_2, integral_3),
            (first, first, second, second), nu)


@entry_point
def boundary_conditions(arm, omega, matrix, scale):
    """
    Write the boundary conditions at a frequency.

    Parameters
    ----------
    arm : packed constants
        Of `Constants`.
    omega : float
        [rad/s]
    matrix : ndarray, shape (4, 4)
        Receives W(0), Phi(0), shear force and moment balance of the end effector as rows, one
        column for each wave; first rows, then columns are scaled to length 1.
    scale : ndarray, shape (4,)
        Receives the lengths of the columns.

    """
    g_root, integral_root, s, nu = _waves(arm, omega, 0.0)
    g_tip, integral_tip, _, _ = _waves(arm, omega, arm.length)
    for j in range(4):
        matrix[0, j] = g_root[j]
        matrix[1, j] = (s[j] + nu) * integral_root[j]
        matrix[2, j] = (-arm.shear_stiffness * nu * integral_tip[j]
                        - arm.end_effector_mass * omega**2 * g_tip[j])
        matrix[3, j] = (s[j] + nu) * (arm.bending_stiffness * g_tip[j]
                                      - arm.end_effector_inertia * omega**2 * integral_tip[j])
    for i in range(4):
        length = np.sqrt(matrix[i, 0]**2 + matrix[i, 1]**2 + matrix[i, 2]**2 + matrix[i, 3]**2)
        for j in range(4):
            matrix[i, j] /= length
    for j in range(4):
        scale[j] = np.sqrt(matrix[0, j]**2 + matrix[1, j]**2 + matrix[2, j]**2 + matrix[3, j]**2)
        for i in range(4):
            matrix[i, j] /= scale[j]


@strict
def _minor(matrix, i, j, k):
    """Return the minor of rows i, i + 1 and columns j, k."""
    return matrix[i, j] * matrix[i + 1, k] - matrix[i, k] * matrix[i + 1, j]


# Columns of a minor of the first two rows, and of the last two in the order that gives the sign.
_LAPLACE = ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 2, 0), (2, 3, 0, 1))


@strict
def _determinant(arm, omega, matrix, scale):
    """Return the determinant of the boundary conditions at a frequency."""
    boundary_conditions(arm, omega, matrix, scale)
    total = 0.0
    for j, k, m, n in _LAPLACE:  # a loop, because numba would compile each call by its columns
        total += _minor(matrix, 0, j, k) * _minor(matrix, 2, m, n)
    return total


@entry_point
def bisect(arm, limits, omega):
    """
    Find one eigenfrequency between each two neighbouring limits, to the last bit.

    Parameters
    ----------
    arm : packed constants
        Of `Constants`.
    limits : ndarray, shape (N + 1,)
        Ascending [rad/s].
    omega : ndarray, shape (N,)
        Receives the frequencies.

    Returns
    -------
    int
        Number of frequencies found before a pair of limits between which the determinant of the
        boundary conditions does not change sign; N if all are found.

    """
    matrix, scale = np.empty((4, 4)), np.empty(4)
    for n in range(len(omega)):
        low, high = limits[n], limits[n + 1]
        at_low = at_high = 0.0
        point = low
        # The determinant has one place in this loop, because it is compiled for each place.
        while True:
            value = _determinant(arm, point, matrix, scale)
            if at_low == 0.0:
                at_low, point = value, high
                if value == 0.0:
                    return n
                continue
            if at_high == 0.0:
                at_high = value
                if not at_low * value < 0.0:
                    return n
            elif at_low * value > 0.0:
                low = point
            else:
                high = point
            point = 0.5 * (low + high)
            if not low < point < high:
                break
        omega[n] = point
    return len(omega)


@entry_point
def fields(arm, omega, shape, xi, out):
    """
    Write the fields of modes at points.

    Parameters
    ----------
    arm : packed constants
        Of `Constants`.
    omega : ndarray, shape (N,)
        Frequencies [rad/s].
    shape : ndarray, shape (4, N)
        Share of each wave in each mode.
    xi : ndarray, shape (p,)
        Points [m].
    out : ndarray, shape (4, p, N)
        Receives deflection, rotation, curvature and shear strain. The last is computed as -nu G,
        since the difference W' - Phi would lose seven digits on a slender arm.

    """
    for n in range(len(omega)):
        for i in range(len(xi)):
            for field in range(4):
                out[field, i, n] = 0.0
            g, integral, s, nu = _waves(arm, omega[n], xi[i])
            for j in range(4):
                out[0, i, n] += shape[j, n] * g[j]
                out[1, i, n] += shape[j, n] * (s[j] + nu) * integral[j]
                out[2, i, n] += shape[j, n] * (s[j] + nu) * g[j]
                out[3, i, n] -= shape[j, n] * nu * integral[j]
