# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
What sensors read of true quantities: bias and noise are added, the sum is rounded.

The noise is a function of seed, axis and step alone: Philox-4x32-10 (J. K. Salmon et al., Parallel
random numbers: as easy as 1, 2, 3, SC 2011) gives bits, of which Marsaglia's polar method makes
normal numbers. Python and an exported arm call this code. It has no fast math and so gives the
same bits on all processors.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, Constants, magnitude, square_root, strict


class SensorErrors(NamedTuple):
    """Errors of sensors, a number for each of their axes."""

    seed: int  # below 2^32
    key: Annotated[np.ndarray, int, 'sensor_axes']  # of random numbers, below 2^32
    noise: Annotated[np.ndarray, 'sensor_axes']  # standard deviation
    bias: Annotated[np.ndarray, 'sensor_axes']
    resolution: Annotated[np.ndarray, 'sensor_axes']
    delay: Annotated[np.ndarray, int, 'sensor_axes']  # until it is read [steps]


_LOW = 0xFFFFFFFF  # the lower 32 bits
# Added and subtracted, it rounds to whole numbers, up to half of it, ties to even.
_ROUNDING = 1.5 * 2.0**52


@entry_point(fast=False, errors=Constants(), axis=int, step=int, count=int, values=Array((None,)))
def add_errors(errors, axis, step, count, values):
    """Turn the true values of `count` axes from `axis` on into what is read at a step."""
    for k in range(count):
        values[k] = reading(errors, axis + k, step, values[k])


@strict
def reading(errors, axis, step, value):
    """Return what an axis reads of a value at a step."""
    value += errors.bias[axis]
    if errors.noise[axis] > 0.0:
        value += errors.noise[axis] * normal(errors.seed, errors.key[axis], step)
    resolution = errors.resolution[axis]
    # Of a number of more resolutions the last bit is coarser than one.
    if magnitude(value) < 2.0**51 * resolution:
        value = resolution * (value / resolution + _ROUNDING - _ROUNDING)
    return value


@strict
def normal(seed, key, step):
    """Return the standard normal number of a seed, a key and a step."""
    attempt = 0
    while True:
        a, b, c, d = philox(step & _LOW, step >> 32, attempt, 0, seed, key)
        x, y = _centred(a, b), _centred(c, d)
        square = x * x + y * y
        if square < 1.0:
            return x * square_root(-2.0 * _logarithm(square) / square)
        attempt += 1


@strict
def philox(a, b, c, d, key, other):
    """Return four words of 32 random bits of a counter of four words and a key of two."""
    for _ in range(10):
        first, second = 0xD2511F53 * a, 0xCD9E8D57 * c
        a, b = (second >> 32) & _LOW ^ b ^ key, second & _LOW
        c, d = (first >> 32) & _LOW ^ d ^ other, first & _LOW
        key, other = (key + 0x9E3779B9) & _LOW, (other + 0xBB67AE85) & _LOW
    return a, b, c, d


@strict
def _centred(high, low):
    """Return a number between -1 and 1, but not 0, of 52 random bits."""
    return ((high << 20 | low >> 12) + 0.5) * 2.0**-51 - 1.0


@strict
def _logarithm(value):
    """Return the logarithm of a number between 0 and 1: ln 2 times an exponent, 2 artanh z."""
    exponent = 0
    while value < 0.7071067811865476:
        value *= 2.0
        exponent += 1
    z, series = (value - 1.0) / (value + 1.0), 0.0
    for k in range(10, -1, -1):  # of z^2 < 0.03
        series = series * (z * z) + 1.0 / (2 * k + 1)
    return 2.0 * z * series - exponent * 0.6931471805599453
