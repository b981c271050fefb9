# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives by central differences, where there are no exact ones."""

from collections.abc import Callable

import numpy as np

# By order: numbers of steps from the middle, and weights.
_STENCILS = {2: ((-1, -0.5), (1, 0.5)),
             4: ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))}


def differences(function: Callable[[np.ndarray], np.ndarray], steps: np.ndarray,
                order: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the value of a function of shifts at 0, and its derivatives by them.

    Parameters
    ----------
    function : function of (n, k)
        Returns the values for n shifts, shape (n, p).
    steps : ndarray, shape (k,)
        Those of differences.
    order : int
        Of their error, 2 or 4.

    Returns
    -------
    value, slope : ndarray, shapes (p,), (p, k)

    """
    shifts, stencil = np.diag(steps), _STENCILS[order]
    value, *found = np.split(function(np.vstack([
        0.0 * steps, *(number * shifts for number, _ in stencil)])), 1 + np.arange(
            len(stencil)) * len(steps))
    slope = np.sum([weight * each for (_, weight), each in zip(stencil, found)], axis=0)
    return value[0], slope.T / steps
