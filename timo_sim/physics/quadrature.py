"""Gauss-Legendre nodes along the arm, and the integral of what is known there from the root."""

import functools

import numpy as np
from numpy.polynomial import legendre

_FEWEST = 4  # nodes in a span, however short


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


class Quadrature:
    """
    Gauss-Legendre quadrature on the spans of an arm.

    A function with its values at the nodes stands for the polynomial through them in each span.

    Parameters
    ----------
    breaks : ndarray, shape (spans + 1,)
        Ends of the spans, ascending from 0 [m].
    count : int
        Number of nodes, shared out by length; a short span has a few at least.
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
        shares = np.diff(breaks) / breaks[-1]
        # 1e-9: a share that is whole but for its rounding.
        counts = np.maximum(np.ceil(count * shares - 1e-9).astype(int), _FEWEST) + extra
        self._spans = [(start, stop, *_rule(n))
                       for start, stop, n in zip(breaks, breaks[1:], counts)]
        self.nodes = np.concatenate([start + 0.5 * (stop - start) * (x + 1.0)
                                     for start, stop, x, _, _ in self._spans])
        self.weights = np.concatenate([0.5 * (stop - start) * w
                                       for start, stop, _, w, _ in self._spans])
        self.points = np.append(self.nodes, breaks[-1])

    def integrate_to(self, xi):
        """
        Return the rows that integrate nodal values from 0 to each of the given points.

        Parameters
        ----------
        xi : array_like, shape (p,)
            [m]

        Returns
        -------
        ndarray, shape (p, n)
            [m]

        """
        rows = []
        for start, stop, to_coefficients, x in self._within(xi):
            # Left of the span this is nothing, right of it the whole span.
            _, integrals = legendre_values(np.clip(x, -1.0, 1.0), len(to_coefficients))
            rows.append(0.5 * (stop - start) * integrals @ to_coefficients)
        return np.hstack(rows)

    def interpolate_to(self, xi):
        """Return the rows that interpolate nodal values at the given points, shape (p, n)."""
        rows, past = [], np.zeros(len(xi), dtype=bool)
        for _, stop, to_coefficients, x in self._within(xi):
            here = (x <= 1.0) & ~past if stop < self.points[-1] else ~past
            values, _ = legendre_values(np.where(here, x, 0.0), len(to_coefficients))
            rows.append(here[:, np.newaxis] * values @ to_coefficients)
            past |= here
        return np.hstack(rows)

    def _within(self, xi):
        # Of each span: its ends, nodal values to Legendre coefficients, and xi in [-1, 1] of it.
        xi = np.asarray(xi, dtype=float)
        for start, stop, _, _, to_coefficients in self._spans:
            yield start, stop, to_coefficients, 2.0 * (xi - start) / (stop - start) - 1.0
