# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Time of compiled code beside a calibrating loop, because machines change their speed."""

from statistics import median
import time
from typing import NamedTuple

import numba
import numpy as np

_SIZE, _PRODUCTS = 16, 20000


@numba.njit(fastmath=True)
def _products(matrix, vector, out, count):
    for _ in range(count):
        for i in range(_SIZE):
            total = 0.0
            for j in range(_SIZE):
                total += matrix[i, j] * vector[j]
            out[i] = total
        vector[:] = out


def product():
    """Return the time of one compiled 16 x 16 matrix-vector product [s]."""
    matrix, vector = 0.999 * np.eye(_SIZE), np.ones(_SIZE)
    _products(matrix, vector, np.ones(_SIZE), 1)  # compiles
    return seconds(lambda: _products(matrix, vector, np.ones(_SIZE), _PRODUCTS)) / _PRODUCTS


def seconds(work):
    """Return the wall time of a call [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


class Timing(NamedTuple):
    """Times of one unit of work [s], and what it is in calibrating products."""

    least: float
    middle: float
    products: float

    def shown(self, unit=1e-6, name='us'):
        """Return the figures as text."""
        return (f'{self.middle / unit:.3g} {name} (min {self.least / unit:.3g}, '
                f'{self.products:.3g} products)')


def timed(*works, units, rounds=25):
    """
    Return the Timing of a function, or a list of those of several, which take turns.

    Each call does some units of work, such as time steps. Ratios are medians of those to the
    calibrating product that is timed just before each call.
    """
    product()  # compiles
    for work in works:
        work()
    rows = [[(product(), seconds(work) / units) for work in works] for _ in range(rounds)]
    found = [Timing(min(span for _, span in column), median(span for _, span in column),
                    median(span / each for each, span in column)) for column in zip(*rows)]
    return found if len(found) > 1 else found[0]
