# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The matrices of a time step: functions phi_k of the linear part, exact to round-off.

Source: Cox and Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. (26)-(29); doc/theory.md (T36).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance

_NORM, _TERMS = 2.0, 22  # the series of phi_3 is truncated at a relative 2^23 3! / 26! = 1e-19


class Propagator(NamedTuple):
    """
    The matrices of one step, for one linear part L and one step size h.

    With `phi_0(z) = exp(z)`, `phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z`; each has shape (m, m).
    """

    whole: np.ndarray        # phi_0(h L)
    half: np.ndarray         # phi_0(h L/2)
    half_weight: np.ndarray  # h/2 phi_1(h L/2)
    first: np.ndarray        # h (phi_1 - 3 phi_2 + 4 phi_3)(h L)
    middle: np.ndarray       # h (2 phi_2 - 4 phi_3)(h L)
    last: np.ndarray         # h (4 phi_3 - phi_2)(h L)


def propagator(linear, step):
    """Return the matrices of a step, a Propagator, see `propagators`."""
    return propagators(linear, step)[0]


def propagators(linear, step):
    """
    Return the matrices of a step and, at little more cost, those of a step half as long.

    Parameters
    ----------
    linear : ndarray, shape (m, m)
        L, per second.
    step : float
        h [s].

    Returns
    -------
    list of Propagator

    """
    # Stiffnesses and compliances differ by many decades. Balancing, exact by powers of two, brings
    # the norm of h L to about that of the fastest wave, so that the exponential keeps its digits.
    balanced, (scale, _) = matrix_balance(linear, permute=False, separate=True)
    whole, half, quarter = (scale[:, np.newaxis] * phi / scale for phi in _phi(step * balanced))
    return [_combined(step, whole, half), _combined(0.5 * step, half, quarter)]


def phi_functions(linear, step, order):
    """Return phi_0 to phi_order of h L, see `Propagator`, shape (1 + order, m, m)."""
    balanced, (scale, _) = matrix_balance(linear, permute=False, separate=True)
    z, doublings = _scaled(step * balanced)
    series = np.eye(len(z)) / float(math.factorial(_TERMS + order))
    phi = np.empty((1 + order, *z.shape))
    for k in reversed(range(_TERMS + order)):
        series = z @ series
        series.flat[::len(z) + 1] += 1.0 / math.factorial(k)
        phi[min(k, order)] = series
    # share[k, j]: weight of phi_j(z) in 2^k phi_k(2 z), besides phi_0(z) phi_k(z), see `_phi`.
    share = np.array([[1.0 / math.factorial(k - j) if 0 < j <= k else 0.0
                       for j in range(1 + order)] for k in range(1 + order)])
    half = 0.5 ** np.arange(1 + order)[:, np.newaxis, np.newaxis]
    for _ in range(doublings):
        phi = half * (phi[0] @ phi + np.tensordot(share, phi, axes=1))
    return scale[:, np.newaxis] * phi / scale


def _combined(step, whole, half):
    _, phi_1, phi_2, phi_3 = whole
    return Propagator(whole[0], half[0], 0.5 * step * half[1],
                      step * (phi_1 - 3.0 * phi_2 + 4.0 * phi_3),
                      step * (2.0 * phi_2 - 4.0 * phi_3), step * (4.0 * phi_3 - phi_2))


def _phi(z):
    """
    Return phi_0 to phi_3 of a matrix, of its half and of its quarter, each of shape (4, m, m).

    The matrix is divided by a power of two for the series of phi_3; then the argument is doubled:
    `2^k phi_k(2 z) = phi_0(z) phi_k(z) + sum_j phi_j(z) / (k - j)!`, j = 1..k. Source: Skaflestad
    and Wright, Appl. Numer. Math. 59 (2009) 783-799.
    """
    z, doublings = _scaled(z)
    one = np.eye(len(z))
    phi_3 = one / float(math.factorial(_TERMS + 3))
    for k in reversed(range(_TERMS)):
        phi_3 = z @ phi_3
        phi_3.flat[::len(z) + 1] += 1.0 / math.factorial(k + 3)
    phi_2 = z @ phi_3 + 0.5 * one
    phi_1 = z @ phi_2 + one
    found = [np.array([z @ phi_1 + one, phi_1, phi_2, phi_3])]
    for _ in range(doublings):
        phi_0, phi_1, phi_2, phi_3 = found[0]
        found.insert(0, np.array([
            phi_0 @ phi_0, 0.5 * (phi_0 @ phi_1 + phi_1), 0.25 * (phi_0 @ phi_2 + phi_1 + phi_2),
            0.125 * (phi_0 @ phi_3 + 0.5 * phi_1 + phi_2 + phi_3)]))
    return found[:3]


def _scaled(z):
    """Return a matrix divided by 2^k to be small enough for the series, and k >= 2."""
    norm = np.linalg.norm(z, 1)
    doublings = max(2, math.ceil(math.log2(norm / _NORM))) if norm > 0.0 else 2
    return z / 2.0**doublings, doublings
