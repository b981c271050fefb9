# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives by finite differences and secants, where there are no exact ones."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

# By order: numbers of steps from the middle, and weights; in order 1 the middle is subtracted.
_STENCILS = {1: ((1, 1.0),),
             2: ((-1, -0.5), (1, 0.5)),
             4: ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))}
_MISSED = 0.2  # part of what the coordinates of a move do, each alone, that is not foreseen


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


class Secants:
    """
    The Jacobian of a function, (n,) of (p,), at points of a search; `jacobian` makes one anew.

    Where the last one foresees the values at the next point, it is changed as little as makes it
    foresee them exactly, in coordinates that move the values alike, and `count` is one more, to
    the `most`. Source: Broyden, Mathematics of Computation 19 (1965) 577-593.
    """

    def __init__(self, function: Callable[[np.ndarray], np.ndarray],
                 jacobian: Callable[[np.ndarray], np.ndarray], most: int) -> None:
        self._function, self._jacobian, self._most = function, jacobian, most
        self._last: Any = None
        self.count = most

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the Jacobian at x, shape (n, p)."""
        values, near = self._function(x), False
        if self.count < self._most:
            before, known, slope = self._last
            move = x - before
            along = move * np.sum(slope**2, axis=0)
            missed, size = values - known - slope @ move, along @ move
            near = missed @ missed < _MISSED**2 * size
        self.count = self.count + 1 if near else 0
        slope = slope + np.outer(missed / size, along) if near else self._jacobian(x)
        self._last = x.copy(), values, slope
        return slope.copy()
