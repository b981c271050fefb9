# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The error of a state after many steps, estimated from the defects of the steps.

Numbers (T..) are those of doc/theory.md, section 7. The error E of the states obeys, to first
order, the linear part of the equations, driven by the defect of each step (T38):

    E_{k+1} = exp(h L) E_k + y_{k+1} - exp(h L) y_k - int_0^h exp((h - s) L) n(t_k + s) ds

In the integral n is the polynomial of degree 5 through its values at the six nearest boundaries of
steps. The integrator has computed these, so n is not evaluated again.
"""

from functools import lru_cache
import math

import numpy as np

from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.integrate.propagator import phi_functions

POINTS = 6  # number of points of the polynomial
_MIDDLE = POINTS // 2 - 1  # the step between them for which it is most accurate
LEAST = 8  # least number of steps for an estimate
_BLOCK, _FEW = 64, 256  # steps summed up by one matrix; least number of steps for which that pays
_PRODUCTS = 2**18  # most products of numbers in a call of BLAS before it starts threads


@lru_cache(maxsize=1)
def _coefficients():
    """
    Return the derivatives of the polynomial per nodal value, shape (steps, powers, points).

    Entry (o, i, j) is the i-th derivative at the start of the o-th step between the points, per
    value at the j-th point; the unit of time is the step.
    """
    offsets = np.arange(POINTS) - np.arange(POINTS - 1)[:, np.newaxis]
    inverse = np.linalg.inv(offsets[:, :, np.newaxis] ** np.arange(POINTS, dtype=float))
    return inverse * np.array([math.factorial(i) for i in range(POINTS)])[:, np.newaxis]


def weights_of(phi, step):
    """
    Return the weights of n in the integral of a step, shape (steps, points, ..., m, m).

    Parameters
    ----------
    phi : ndarray, shape (1 + POINTS, ..., m, m)
        See `phi_functions`.
    step : float
        [s]

    """
    return step * np.tensordot(_coefficients(), phi[1:], axes=(1, 0))


class GlobalError:
    """
    The estimated error of a model's state.

    Parameters
    ----------
    linear : ndarray, shape (m, m)
        L of the model.
    step : float
        h [s].
    kept : dict
        Takes the matrices that depend on these alone, for further errors.

    Attributes
    ----------
    error : ndarray, shape (m,)
        E.

    """

    def __init__(self, linear, step, kept):
        self._linear, self._step, self.kept = linear, step, kept
        self.error = np.zeros(len(linear))

    @kept
    def _phi(self):
        return phi_functions(self._linear, self._step, POINTS)

    @kept
    def _powers(self):
        """exp(k h L), k = 0..2 _BLOCK - 1, shape (2 _BLOCK, m, m)."""  # noqa: D403
        powers, square = np.eye(len(self._linear))[np.newaxis], self._phi[0]
        while len(powers) < 2 * _BLOCK:
            powers, square = np.concatenate([powers, square @ powers]), square @ square
        return powers

    def grow(self, steps):
        """Propagate the error over steps without defects."""
        for _ in range(steps // _BLOCK):
            self.error = self._powers[_BLOCK] @ self.error
        self.error = self._powers[steps % _BLOCK] @ self.error

    def add(self, errors):
        """
        Follow the error over steps with known errors.

        Parameters
        ----------
        errors : ndarray, shape (steps, m)

        """
        for k in range(0, len(errors), _BLOCK):
            part = errors[k:k + _BLOCK]
            self.grow(len(part))
            self.error += np.einsum('kij,kj->i', self._powers[len(part) - 1::-1], part)

    def follow(self, states, rates, weight=1.0):
        """
        Follow the error over steps by their defects.

        Parameters
        ----------
        states, rates : ndarray, shape (steps + 1, m)
            y and n at the boundaries of the steps, smooth in between; at least `LEAST` steps.
        weight : float
            Factor of the defects, above 1 if they also stand for those of earlier steps.

        Returns
        -------
        errors : ndarray, shape (k, m)
            Errors at some boundaries.
        numbers : list of int
            Numbers of these boundaries.

        """
        steps, size = len(rates) - 1, states.shape[1]
        blocks = max(steps // _BLOCK - (0 < steps % _BLOCK < LEAST), 0)
        if steps < _FEW:
            blocks = 0
        done = blocks * _BLOCK
        errors = np.empty((blocks, size))
        at_once = max(1, _PRODUCTS // (_BLOCK * size**2))
        for first in range(0, blocks, at_once):
            part = slice(first * _BLOCK, min(first + at_once, blocks) * _BLOCK)
            ends, inner = states[part.start:part.stop + 1:_BLOCK], rates[part]
            errors[first:first + at_once] = weight * (
                ends[1:] - ends[:-1] @ self._powers[_BLOCK].T
                - inner.reshape(len(ends) - 1, -1) @ self._sums[:-size]
                - rates[part.start + _BLOCK:part.stop + 1:_BLOCK] @ self._sums[-size:])
        if blocks:
            self._accumulate(errors)
        if done < steps:
            self.add(weight * self._defects(states[done:], rates[done:]))
            errors = np.vstack([errors, self.error])
        return errors, [_BLOCK * (k + 1) for k in range(blocks)] + [steps] * (done < steps)

    def _defects(self, states, rates):
        """Return the defect of each step, shape (steps, m)."""
        steps, size = len(states) - 1, states.shape[1]
        defects = states[1:] - states[:-1] @ self._powers[1].T
        for offset, weights in enumerate(self._of_step):
            first, count = offset, 1
            if offset == _MIDDLE:
                count = steps - 2 * _MIDDLE
            elif offset > _MIDDLE:
                first = steps - (POINTS - 1) + offset
            windows = _windows(rates[first - offset:], 1, POINTS, count)
            defects[first:first + count] -= windows @ weights.transpose(0, 2, 1).reshape(-1, size)
        return defects

    def _accumulate(self, defects):
        """Turn the defects of blocks, (b, m), into the error after each."""
        defects[0] += self._powers[_BLOCK] @ self.error
        distance = 1
        while distance < len(defects):
            # Each entry now sums up to so many blocks, the last of which is its own.
            defects[distance:] += defects[:-distance] @ self._over_blocks(distance).T
            distance *= 2
        self.error = defects[-1].copy()

    @kept
    def _squares(self):
        return {}

    def _over_blocks(self, count):
        # exp(k h L) over `count` blocks, a power of two.
        if count == 1:
            return self._powers[_BLOCK]
        if count not in self._squares:
            root = self._over_blocks(count // 2)
            self._squares[count] = root @ root
        return self._squares[count]

    @kept
    def _of_step(self):
        """Return the weights of n in the integral of a step, (steps, points, m, m)."""
        return weights_of(self._phi, self._step)

    @kept
    def _sums(self):
        """Return the weights of n in the sum of integrals over a block, ((_BLOCK + 1) m, m)."""
        size, inner = len(self._linear), _BLOCK - 2 * _MIDDLE
        sums = np.zeros((_BLOCK + 1, size, size))
        later = self._powers[_BLOCK - 1 - _MIDDLE - np.arange(inner)]
        for point, weight in enumerate(self._of_step[_MIDDLE]):
            sums[point:point + inner] += later @ weight
        for offset in (*range(_MIDDLE), *range(_MIDDLE + 1, POINTS - 1)):
            step = offset if offset < _MIDDLE else _BLOCK - (POINTS - 1) + offset
            first = step - offset
            sums[first:first + POINTS] += self._powers[_BLOCK - 1 - step] @ self._of_step[offset]
        return np.ascontiguousarray(sums.transpose(0, 2, 1).reshape(-1, size))


def _windows(rows, stride, length, count):
    """Return windows of `length` rows, `stride` apart, each as one row, (count, length m)."""
    size = rows.shape[1]
    return np.lib.stride_tricks.as_strided(
        rows, (count, length * size), (stride * rows.strides[0], rows.strides[1]))
