# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The error of a state after many steps, estimated from what the solution leaves of the equations.

Numbers (T..) are those of doc/theory.md, section 7. The error E of the states obeys, to first
order, the linear part of the equations, driven by the defect of each step (T38):

    E_{k+1} = exp(h L) E_k + y_{k+1} - exp(h L) y_k - int_0^h exp((h - s) L) n(t_k + s) ds

The integral takes n as the polynomial of degree 5 through its values at six boundaries of steps
around, which the integrator has at hand: no further evaluation is needed.
"""

from functools import cached_property, lru_cache
import math

import numpy as np

from timo_sim.physics.integrate.propagator import phi_functions

_POINTS = 6  # of the polynomial
LEAST = 8  # steps that can be estimated
_BLOCK = 64  # steps whose defects are summed up by one matrix


@lru_cache(maxsize=1)
def _coefficients():
    """
    Return the weights of the moments of a step, shape (steps, powers, points).

    Of the polynomial through the points, its i-th derivative at the start of the o-th of the steps
    between them per value at the j-th.
    """
    offsets = np.arange(_POINTS) - np.arange(_POINTS - 1)[:, np.newaxis]
    inverse = np.linalg.inv(offsets[:, :, np.newaxis] ** np.arange(_POINTS, dtype=float))
    return inverse * np.array([math.factorial(i) for i in range(_POINTS)])[:, np.newaxis]


class GlobalError:
    """
    The estimated error of a model's state.

    Parameters
    ----------
    linear : ndarray, shape (m, m)
        L of the model.
    step : float
        h [s].

    Attributes
    ----------
    error : ndarray, shape (m,)
        E.

    """

    def __init__(self, linear, step):
        self._linear, self._step = linear, step
        self.error, self._matrices = np.zeros(len(linear)), {}

    @cached_property
    def _phi(self):
        return phi_functions(self._linear, self._step, _POINTS)

    @cached_property
    def _powers(self):
        """exp(k h L), k = 0..2 _BLOCK - 1, shape (2 _BLOCK, m, m)."""  # noqa: D403
        powers, square = np.eye(len(self._linear))[np.newaxis], self._phi[0]
        while len(powers) < 2 * _BLOCK:
            powers, square = np.concatenate([powers, square @ powers]), square @ square
        return powers

    def grow(self, steps):
        """Follow the error over steps without defects."""
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
            How much the defects count, which may stand for those of steps before.

        Returns
        -------
        errors : ndarray, shape (k, m)
            At some boundaries.
        numbers : list of int
            Of these boundaries.

        """
        steps, size = len(rates) - 1, states.shape[1]
        blocks = steps // _BLOCK
        if 0 < steps % _BLOCK < LEAST:
            blocks -= 1
        blocks = max(blocks, 0)
        rest = steps - blocks * _BLOCK
        numbers = [_BLOCK * k for k in range(blocks + 1)] + [steps] * bool(rest)
        integrals = []
        if blocks:
            rows = np.lib.stride_tricks.as_strided(
                rates, (blocks, (_BLOCK + 1) * size), (_BLOCK * rates.strides[0], 8))
            integrals.extend(rows @ self._matrix(_BLOCK))
        if rest:
            integrals.append(rates[steps - rest:].ravel() @ self._matrix(rest))
        errors = []
        for first, last, integral in zip(numbers, numbers[1:], integrals):
            power = self._powers[last - first]
            self.error = power @ (self.error - weight * states[first]) + weight * (
                states[last] - integral)
            errors.append(self.error)
        return np.array(errors), numbers[1:]

    def _matrix(self, steps):
        """Return what sums up the integrals of n over some steps, ((steps + 1) m, m)."""
        if steps not in self._matrices:
            size, middle = len(self._linear), _POINTS // 2 - 1
            # Of the o-th step between the points per value at the j-th, (5, 6, m, m).
            of_step = self._step * np.tensordot(
                _coefficients(), self._phi[1:], axes=(1, 0))
            sums = np.zeros((steps + 1, size, size))
            inner = steps + 2 - _POINTS  # steps in the middle of the points
            later = self._powers[steps - 1 - middle - np.arange(inner)]
            for point in range(_POINTS):
                sums[point:point + inner] += later @ of_step[middle, point]
            for step in (*range(middle), *range(middle + inner, steps)):
                offset = step if step < middle else step - steps + _POINTS - 1
                first = step - offset
                sums[first:first + _POINTS] += self._powers[steps - 1 - step] @ of_step[offset]
            self._matrices[steps] = np.ascontiguousarray(
                sums.transpose(0, 2, 1).reshape(-1, size))
        return self._matrices[steps]
