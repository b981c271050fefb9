# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Replace a load that has a kink inside a step by a parabola with the same moments.

A step takes a load at its start, middle and end, and its linear part integrates the parabola
through these three values exactly. A load with a kink inside the step is replaced by the parabola
with the same integral and the same first and second moment: with s from 0 to 1 over the step and
`I_j = int s^j p ds`,

    p(0)   =    9 I_0 - 36 I_1 + 30 I_2
    p(1/2) = -3/2 I_0 + 15 I_1 - 15 I_2
    p(1)   =    3 I_0 - 24 I_1 + 30 I_2
"""

from functools import cache

import numpy as np

_PARABOLA = np.array([[9.0, -36.0, 30.0], [-1.5, 15.0, -15.0], [3.0, -24.0, 30.0]])
_gauss = cache(np.polynomial.legendre.leggauss)
NEAR = 1e-6  # [steps] distance from a step boundary within which a position counts as on it


def on_boundaries(position):
    """Return positions, counted in steps, with those near a step boundary moved onto it."""
    whole = np.rint(position)
    return np.where(np.abs(position - whole) <= NEAR, whole, position)


def parabolas(function, breaks, degree, first, count):
    """
    Return the parabolas that replace a piecewise polynomial in steps with a break inside.

    Parameters
    ----------
    function : function(ndarray) -> ndarray
        Values at positions counted in steps, shape (n,) to (n, ...).
    breaks : ndarray, shape (k,)
        Where pieces meet, counted in steps; whole numbers are the boundaries of steps.
    degree : int
        Degree of the pieces.
    first, count : int
        First step, and number of steps.

    Returns
    -------
    steps : ndarray of int, shape (m,)
        Those with a break inside, counted from `first`.
    values : ndarray, shape (m, 3, ...)
        The parabolas at the start, middle and end of these steps.

    """
    inside = breaks[(first < breaks) & (breaks < first + count) & (breaks != np.floor(breaks))]
    if not len(inside):
        return inside.astype(int), np.zeros((0, 3, *function(inside).shape[1:]))
    steps = np.unique(np.floor(inside))
    edges = np.unique(np.concatenate([inside, steps, steps + 1.0]))
    # Keep the pieces between these edges that lie in a step with a break.
    owner = np.searchsorted(steps, edges[:-1], side='right') - 1
    within = edges[:-1] < steps[owner] + 1.0
    low, high, owner = edges[:-1][within], edges[1:][within], owner[within]
    # Gauss's rule, exact for such a polynomial times s^2.
    nodes, weights = _gauss((degree + 4) // 2)
    at = low[:, np.newaxis] + (high - low)[:, np.newaxis] * (0.5 + 0.5 * nodes)
    share = 0.5 * (high - low)[:, np.newaxis] * weights
    s = at - steps[owner][:, np.newaxis]
    values = function(at.ravel())
    powers = (share[..., np.newaxis] * s[..., np.newaxis] ** np.arange(3)).reshape(-1, 3)
    moments = np.zeros((len(steps), 3, *values.shape[1:]))
    np.add.at(moments, np.repeat(owner, len(nodes)),
              np.einsum('nj,n...->nj...', powers, values))
    return (steps - first).astype(int), np.einsum('ij,mj...->mi...', _PARABOLA, moments)
