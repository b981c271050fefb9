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
from scipy.linalg.lapack import dgebal

_NORM, _TERMS = 2.0, 22  # the series of phi_3 is truncated at a relative 2^23 3! / 26! = 1e-19


class Propagator(NamedTuple):
    """
    The matrices of one step, for one linear part L and one step size h.

    With `phi_0(z) = exp(z)`, `phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z`; each has shape (m, m),
    or those of many linear parts (n, m, m).
    """

    whole: np.ndarray        # phi_0(h L)
    half: np.ndarray         # phi_0(h L/2)
    half_weight: np.ndarray  # h/2 phi_1(h L/2)
    first: np.ndarray        # h (phi_1 - 3 phi_2 + 4 phi_3)(h L)
    middle: np.ndarray       # h (2 phi_2 - 4 phi_3)(h L)
    last: np.ndarray         # h (4 phi_3 - phi_2)(h L)


def propagator(linear, step):
    """
    Return the matrices of a step.

    Parameters
    ----------
    linear : ndarray, shape (..., m, m)
        L, per second.
    step : float
        h [s].

    Returns
    -------
    Propagator

    """
    (whole, phi_1, phi_2, phi_3), half = _of_balanced(_phi, step, linear)
    return Propagator(whole, half[0], 0.5 * step * half[1],
                      step * (phi_1 - 3.0 * phi_2 + 4.0 * phi_3),
                      step * (2.0 * phi_2 - 4.0 * phi_3), step * (4.0 * phi_3 - phi_2))


def _of_balanced(function, step, linear):
    """
    Return a function of h L, an array with axes before those of L.

    `function` takes some matrices that are small enough for a series, (n, m, m), and how often
    they have to be doubled. Stiffnesses and compliances differ by many decades. Balancing, exact
    by powers of two, brings the norm of h L to about that of the fastest wave, so that the
    exponential keeps its digits.
    """
    every = linear.reshape(-1, *linear.shape[-2:])
    found = [dgebal(each, scale=1, permute=0) for each in every]
    # In the order of memory that LAPACK returns, on which the last bits of products depend.
    balanced = np.array([each[0].T for each in found]).swapaxes(1, 2)
    z, scale = step * balanced, np.array([each[3] for each in found])
    norms = np.abs(z).sum(axis=1).max(axis=1)
    doublings = np.array([max(2, math.ceil(math.log2(norm / _NORM))) if norm > 0.0 else 2
                          for norm in norms])
    results = None
    for number in np.unique(doublings):
        those = doublings == number
        some = function((z.swapaxes(1, 2)[those] / 2.0**number).swapaxes(1, 2), number)
        if results is None:
            results = np.empty((*some.shape[:-3], *z.shape))
        results[..., those, :, :] = some
    results *= scale[:, :, np.newaxis]
    results /= scale[:, np.newaxis, :]
    return results.reshape(*results.shape[:-3], *linear.shape)


def _phi(z, doublings):
    """
    Return phi_0 to phi_3 of matrices that are doubled, and of their halves.

    First the series of phi_3 is summed up; then the argument is doubled:
    `2^k phi_k(2 z) = phi_0(z) phi_k(z) + sum_j phi_j(z) / (k - j)!`, j = 1..k. Source: Skaflestad
    and Wright, Appl. Numer. Math. 59 (2009) 783-799. Shape (2, 4, n, m, m).
    """
    one = np.eye(z.shape[-1])
    place = np.arange(len(one))
    phi_3 = np.broadcast_to(one / float(math.factorial(_TERMS + 3)), z.shape)
    for k in reversed(range(_TERMS)):
        phi_3 = z @ phi_3
        phi_3[:, place, place] += 1.0 / math.factorial(k + 3)
    phi_2 = z @ phi_3 + 0.5 * one
    phi_1 = z @ phi_2 + one
    found = [np.array([z @ phi_1 + one, phi_1, phi_2, phi_3])]
    for _ in range(doublings):
        phi_0, phi_1, phi_2, phi_3 = found[0]
        found.insert(0, np.array([
            phi_0 @ phi_0, 0.5 * (phi_0 @ phi_1 + phi_1), 0.25 * (phi_0 @ phi_2 + phi_1 + phi_2),
            0.125 * (phi_0 @ phi_3 + 0.5 * phi_1 + phi_2 + phi_3)]))
    return np.array(found[:2])
