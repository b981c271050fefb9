# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

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
    vector, out = np.ones(_SIZE), np.ones(_SIZE)
    start = time.perf_counter()
    _products(_MATRIX, vector, out, _PRODUCTS)
    return (time.perf_counter() - start) / _PRODUCTS


_MATRIX = 0.999 * np.eye(_SIZE)
product()  # compiles


class Timing(NamedTuple):
    """Times of one unit of work [s], and what it is in calibrating products."""

    least: float
    middle: float
    products: float

    def shown(self, unit=1e-6, name='us'):
        """Return the figures as text."""
        return (f'{self.middle / unit:.3g} {name} (min {self.least / unit:.3g}, '
                f'{self.products:.3g} products)')


def timed(work, units, rounds=25):
    """
    Time `work`, taking turns with the calibrating loop.

    Parameters
    ----------
    work : function()
    units : int
        Units of work in a call, such as time steps.
    rounds : int

    Returns
    -------
    Timing
        Least, median, and median of the ratios to the product timed just before.

    """
    work()
    times, ratios = [], []
    for _ in range(rounds):
        calibration = product()
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) / units)
        ratios.append(times[-1] / calibration)
    return Timing(min(times), median(times), median(ratios))
