# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Gauss-Legendre quadrature along the arm, with integration from the root and interpolation."""

import functools

import numpy as np
from numpy.polynomial import legendre

_FEWEST = 4  # least number of nodes in a span


def legendre_values(x, count):
    """
    Evaluate Legendre polynomials and their integrals from -1.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Points in [-1, 1].
    count : int
        Number of polynomials, degrees 0 to count - 1.

    Returns
    -------
    values, integrals : ndarray, shape (n, count)

    """
    values = legendre.legvander(x, count)
    integrals = np.empty((len(x), count))
    integrals[:, :1] = x[:, np.newaxis] + 1.0
    degree = np.arange(1, count)
    integrals[:, 1:] = (values[:, 2:] - values[:, :-2]) / (2 * degree + 1)
    return values[:, :count], integrals


@functools.lru_cache(maxsize=64)
def _rule(count):
    # Nodes, weights, and the matrix from nodal values to Legendre coefficients, in [-1, 1].
    x, weights = legendre.leggauss(count)
    values, _ = legendre_values(x, count)
    to_coefficients = (np.arange(count) + 0.5)[:, np.newaxis] * values.T * weights
    for constant in (x, weights, to_coefficients):
        constant.flags.writeable = False
    return x, weights, to_coefficients


@functools.lru_cache(maxsize=64)
def _integrals(spans, xi):
    # The matrix of `Quadrature.integrate_to`; cached, since arms that differ only in section or
    # end effector share it.
    rows = []
    for start, stop, count in spans:
        # A clipped point left of the span gives 0, one right of it the integral over the span.
        x = np.clip(2.0 * (np.array(xi) - start) / (stop - start) - 1.0, -1.0, 1.0)
        rows.append(0.5 * (stop - start) * legendre_values(x, count)[1] @ _rule(count)[2])
    matrix = np.hstack(rows)
    matrix.flags.writeable = False
    return matrix


@functools.lru_cache(maxsize=64)
def _spanned(ends, count, extra):
    # Spans, nodes, weights and points of a Quadrature; cached as `_integrals` are.
    shares = np.diff(ends) / ends[-1]
    # 1e-9: round-off must not raise a share that is a whole number.
    counts = np.maximum(np.ceil(count * shares - 1e-9).astype(int), _FEWEST) + extra
    spans = tuple(zip(ends, ends[1:], counts.tolist()))
    nodes = np.concatenate([start + 0.5 * (stop - start) * (_rule(n)[0] + 1.0)
                            for start, stop, n in spans])
    weights = np.concatenate([0.5 * (stop - start) * _rule(n)[1] for start, stop, n in spans])
    points = np.append(nodes, ends[-1])
    for constant in (nodes, weights, points):
        constant.flags.writeable = False
    return spans, nodes, weights, points


class Quadrature:
    """
    Gauss-Legendre quadrature on the spans of an arm.

    Nodal values stand for the polynomial through them in each span.

    Parameters
    ----------
    breaks : ndarray, shape (spans + 1,)
        Ends of the spans, ascending from 0 [m].
    count : int
        Least number of nodes, distributed by length; each span has at least four.
    extra : int
        Further nodes in each span.

    Attributes
    ----------
    nodes, weights : ndarray, shape (n,)
        [m]
    points : ndarray, shape (n + 1,)
        The nodes and the tip [m].

    """

    def __init__(self, breaks, count, extra=0):
        self._spans, self.nodes, self.weights, self.points = _spanned(
            tuple(np.asarray(breaks, dtype=float).tolist()), count, extra)

    def integrate_to(self, xi):
        """
        Return the matrix from nodal values to their integrals from 0 to the given points.

        Parameters
        ----------
        xi : array_like, shape (p,)
            [m]

        Returns
        -------
        ndarray, shape (p, n)
            [m]

        """
        return _integrals(self._spans, tuple(np.asarray(xi, dtype=float).tolist()))

    def interpolate_to(self, xi):
        """Return the matrix from nodal values to values at the given points, shape (p, n)."""
        xi = np.asarray(xi, dtype=float)
        rows, past = [], np.zeros(len(xi), dtype=bool)
        for start, stop, count in self._spans:
            x = 2.0 * (xi - start) / (stop - start) - 1.0
            here = (x <= 1.0) & ~past if stop < self.points[-1] else ~past
            values, _ = legendre_values(np.where(here, x, 0.0), count)
            rows.append(here[:, np.newaxis] * values @ _rule(count)[2])
            past |= here
        return np.hstack(rows)
