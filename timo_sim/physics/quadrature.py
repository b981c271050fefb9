"""Gauss-Legendre nodes along the arm, and the integral of what is known there from the root."""

import numpy as np
from numpy.polynomial import legendre


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


class Quadrature:
    """
    Gauss-Legendre quadrature on [0, length].

    Attributes
    ----------
    nodes, weights : ndarray, shape (count,)
        [m]

    """

    def __init__(self, length, count):
        self.length = length
        self._x, self._w = legendre.leggauss(count)
        self.nodes = 0.5 * length * (self._x + 1.0)
        self.weights = 0.5 * length * self._w

    def integrate_to(self, xi):
        """
        Return the rows that integrate nodal values from 0 to each of the given points.

        The interpolant through the nodes is integrated exactly; at xi = length this is the
        quadrature itself.

        Parameters
        ----------
        xi : array_like, shape (n,)
            [m]

        Returns
        -------
        ndarray, shape (n, count)
            [m]

        """
        count = len(self._x)
        at_nodes, _ = legendre_values(self._x, count)
        x = 2.0 * np.asarray(xi, dtype=float) / self.length - 1.0
        _, integrals = legendre_values(x, count)
        to_coefficients = (np.arange(count) + 0.5)[:, np.newaxis] * at_nodes.T * self._w
        return 0.5 * self.length * integrals @ to_coefficients
