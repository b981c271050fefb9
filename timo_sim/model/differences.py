# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives by finite differences, where there are no exact ones."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# By order: numbers of steps from the middle, and weights; in order 1 the middle is subtracted.
_STENCILS = {1: ((1, 1.0),),
             2: ((-1, -0.5), (1, 0.5)),
             4: ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))}


class Differences(NamedTuple):
    """The value of a function, (p,), and its derivatives by k shifts, (p, k)."""

    value: np.ndarray
    slope: np.ndarray
    kink: np.ndarray  # of order 2: half of the difference of the derivatives on both sides


def differences(function: Callable[[np.ndarray], np.ndarray], steps: np.ndarray,
                order: int = 2) -> Differences:
    """
    Return the Differences of a function of shifts about 0.

    Parameters
    ----------
    function : function of (n, k)
        Returns the values for n shifts, shape (n, p). Where they are NaN on one side, derivatives
        of order 2 are those of the other side.
    steps : ndarray, shape (k,)
        Those of differences.
    order : int
        Of their error: 1, with shifts to one side, 2 or 4.

    """
    shifts, stencil = np.diag(steps), _STENCILS[order]
    value, *shifted = np.split(function(np.vstack([
        0.0 * steps, *(number * shifts for number, _ in stencil)])), 1 + np.arange(
            len(stencil)) * len(steps))
    slope = np.asarray(sum(weight * each for (_, weight), each in zip(stencil, shifted)))
    kink = np.full(slope.shape, np.nan)
    if order == 1:
        slope = slope - value
    elif order == 2:
        behind, ahead = value - shifted[0], shifted[1] - value
        kink = 0.5 * (ahead - behind)
        slope = np.where(np.isnan(slope), np.where(np.isnan(ahead), behind, ahead), slope)
    return Differences(value[0], slope.T / steps, kink.T / steps)
