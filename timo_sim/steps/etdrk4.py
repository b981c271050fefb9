# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Fourth-order exponential time differencing, ETDRK4.

For `y' = L y + n(y, t)`, with the stiff constant part L propagated exactly. Source: Cox and
Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. (26)-(29); doc/theory.md (T36).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgebal

from timo_sim.compiled.constants import local
from timo_sim.compiled.functions import entry_point, inlined, inner, strict
from timo_sim.compiled.lanes import is_lanes
from timo_sim.model.functions import holds, observe, rate
from timo_sim.model.layout import (
    ACCELERATION, AFTER, ANGLE, END, LOADS, MIDDLE, SPEED, START, STEP_LOADS)

# The matrices of a time step: functions phi_k of the linear part, exact to round-off.
#
# Source: Cox and Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. (26)-(29); doc/theory.md
# (T36).

_NORM, _TERMS = 2.0, 22  # the series of phi_3 is truncated at a relative 2^23 3! / 26! = 1e-19


class Propagator(NamedTuple):
    """
    The matrices of one step, for one linear part L and one step size h.

    With `phi_0(z) = exp(z)`, `phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z`; each has shape (m, m),
    or those of many linear parts (n, m, m).
    """

    whole: np.ndarray        # phi_0(h L)
    half: np.ndarray         # phi_0(h L/2)
    half_weight: np.ndarray  # h/2 phi_1(h L/2)
    first: np.ndarray        # h (phi_1 - 3 phi_2 + 4 phi_3)(h L)
    middle: np.ndarray       # h (2 phi_2 - 4 phi_3)(h L)
    last: np.ndarray         # h (4 phi_3 - phi_2)(h L)


def propagator(linear, step):
    """
    Return the matrices of a step.

    Parameters
    ----------
    linear : ndarray, shape (..., m, m)
        L, per second.
    step : float
        h [s].

    Returns
    -------
    Propagator

    """
    (whole, phi_1, phi_2, phi_3), half = _of_balanced(_phi, step, linear)
    return Propagator(whole, half[0], 0.5 * step * half[1],
                      step * (phi_1 - 3.0 * phi_2 + 4.0 * phi_3),
                      step * (2.0 * phi_2 - 4.0 * phi_3), step * (4.0 * phi_3 - phi_2))


def _of_balanced(function, step, linear):
    """
    Return a function of h L, an array with axes before those of L.

    `function` takes some matrices that are small enough for a series, (n, m, m), and how often
    they have to be doubled. Stiffnesses and compliances differ by many decades. Balancing, exact
    by powers of two, brings the norm of h L to about that of the fastest wave, so that the
    exponential keeps its digits.
    """
    every = linear.reshape(-1, *linear.shape[-2:])
    found = [dgebal(each, scale=1, permute=0) for each in every]
    # In the order of memory that LAPACK returns, on which the last bits of products depend.
    balanced = np.array([each[0].T for each in found]).swapaxes(1, 2)
    z, scale = step * balanced, np.array([each[3] for each in found])
    norms = np.abs(z).sum(axis=1).max(axis=1)
    doublings = np.array([max(2, math.ceil(math.log2(norm / _NORM))) if norm > 0.0 else 2
                          for norm in norms])
    results = None
    for number in np.unique(doublings):
        those = doublings == number
        some = function((z.swapaxes(1, 2)[those] / 2.0**number).swapaxes(1, 2), number)
        if results is None:
            results = np.empty((*some.shape[:-3], *z.shape))
        results[..., those, :, :] = some
    results *= scale[:, :, np.newaxis]
    results /= scale[:, np.newaxis, :]
    return results.reshape(*results.shape[:-3], *linear.shape)


def _phi(z, doublings):
    """
    Return phi_0 to phi_3 of matrices that are doubled, and of their halves.

    First the series of phi_3 is summed up; then the argument is doubled:
    `2^k phi_k(2 z) = phi_0(z) phi_k(z) + sum_j phi_j(z) / (k - j)!`, j = 1..k. Source: Skaflestad
    and Wright, Appl. Numer. Math. 59 (2009) 783-799. Shape (2, 4, n, m, m).
    """
    one = np.eye(z.shape[-1])
    place = np.arange(len(one))
    phi_3 = np.broadcast_to(one / float(math.factorial(_TERMS + 3)), z.shape)
    for k in reversed(range(_TERMS)):
        phi_3 = z @ phi_3
        phi_3[:, place, place] += 1.0 / math.factorial(k + 3)
    phi_2 = z @ phi_3 + 0.5 * one
    phi_1 = z @ phi_2 + one
    found = [np.array([z @ phi_1 + one, phi_1, phi_2, phi_3])]
    for _ in range(doublings):
        phi_0, phi_1, phi_2, phi_3 = found[0]
        found.insert(0, np.array([
            phi_0 @ phi_0, 0.5 * (phi_0 @ phi_1 + phi_1), 0.25 * (phi_0 @ phi_2 + phi_1 + phi_2),
            0.125 * (phi_0 @ phi_3 + 0.5 * phi_1 + phi_2 + phi_3)]))
    return np.array(found[:2])


_TURN = 1e-5  # largest turn of a section between a motion and those of `flow` [rad]


def flow(model, state, rate, load, observe):
    """
    Return motions just before and after states, and half the time between them.

    States and drives are extrapolated linearly over that time.

    Parameters
    ----------
    model : Formulation
        Or what `stacked` makes of many.
    state, rate, load : ndarray, shapes (..., k, m), (..., k, m), (..., k, LOADS)
    observe : function(ndarray, ndarray) -> ndarray
        Takes states and loads, and returns the motions, (..., k, 2 (3 + N)).

    Returns
    -------
    before, after : ndarray, shape (..., k, 2 (3 + N))
    half_time : ndarray, shape (..., k)
        [s]

    """
    drift, half = np.zeros_like(load), model.size // 2
    drift[..., ANGLE], drift[..., SPEED] = load[..., SPEED], load[..., ACCELERATION]
    speed = observe(state, load)[..., half + 2:]
    turning = np.abs(speed[..., :1] + speed[..., 1:] @ model.points.rotation).max(axis=-1)
    shift = _TURN / (_TURN + turning)
    by_rate, by_drift = shift[..., np.newaxis] * rate, shift[..., np.newaxis] * drift
    return (observe(state - by_rate, load - by_drift), observe(state + by_rate, load + by_drift),
            shift)


@inner
def copy(vector, out):
    for i in range(len(vector)):
        out[i] = vector[i]


@inner
def product(matrix, vector, out):
    """Write the product of a matrix, which for lanes is given transposed, and a vector."""
    if is_lanes(out):
        for i in range(len(out)):
            out[i] = 0.0
        _add_columns(matrix, vector, out)
    else:
        for i in range(matrix.shape[0]):
            total = 0.0
            for j in range(matrix.shape[1]):
                total += matrix[i, j] * vector[j]
            out[i] = total


@inner
def add_product(matrix, vector, out):
    """Add what `product` writes."""
    if is_lanes(out):
        _add_columns(matrix, vector, out)
    else:
        for i in range(matrix.shape[0]):
            total = 0.0
            for j in range(matrix.shape[1]):
                total += matrix[i, j] * vector[j]
            out[i] += total


@inner
def _add_columns(turned, vector, out):
    # The sums of lanes stay in registers, and each number of the vector is loaded once.
    for j in range(turned.shape[0]):
        for i in range(turned.shape[1]):
            out[i] += turned[j, i] * vector[j]


@strict
def is_finite(vector):
    for i in range(len(vector)):
        if not np.isfinite(vector[i]):
            return False
    return True


_SHAPES = (f'a step takes a state of its model, a load of shape ({LOADS},) and loads of shape '
           f'(steps, {STEP_LOADS}, {LOADS})')


@strict
def check(state, load, loads, propagator):
    """Raise ValueError if a state or loads have other shapes than the compiled step reads."""
    if len(state) != len(propagator.whole) or len(load) != LOADS or (
            loads.shape[1] != STEP_LOADS or loads.shape[2] != LOADS):
        raise ValueError(_SHAPES)


@inlined
def one_step(tables, propagator, now, start, middle, end, half, following, combined,
             rate_0, rate_a, rate_b, rate_c, stage):
    """Write the state one step after `now` to `stage`, n of the four stages to `rate_*`."""
    rate(tables, now, start, rate_0)
    product(propagator.half, now, half)
    copy(half, stage)
    add_product(propagator.half_weight, rate_0, stage)

    rate(tables, stage, middle, rate_a)
    product(propagator.half, stage, following)
    copy(half, stage)
    add_product(propagator.half_weight, rate_a, stage)

    rate(tables, stage, middle, rate_b)
    for i in range(len(propagator.half)):
        combined[i] = 2.0 * rate_b[i] - rate_0[i]
    add_product(propagator.half_weight, combined, following)

    rate(tables, following, end, rate_c)
    for i in range(len(propagator.half)):
        combined[i] = rate_a[i] + rate_b[i]
    product(propagator.whole, now, stage)
    add_product(propagator.first, rate_0, stage)
    add_product(propagator.middle, combined, stage)
    add_product(propagator.last, rate_c, stage)


@entry_point
def advance(tables, propagator, state, load, loads, sample_every, done, samples, remainder):
    """
    Integrate over some equal steps, as long as the linear part of the tables is valid.

    Parameters
    ----------
    tables : packed constants
        Constants of the formulation; the names of their fields select its functions.
    propagator : packed constants
        The matrices of the step.
    state : ndarray, shape (m,)
        Advanced in place.
    load : ndarray, shape (LOADS,)
        Load at the start, for the first sample.
    loads : ndarray, shape (steps, 4, LOADS)
        Load of each step at its start, middle and end, as the step itself sees it: of a jump on
        the boundary between two steps each sees its own side, and changes inside a step enter by
        their moments (T37). Then the true load at the end of the step, which samples show.
    sample_every : int
        Steps between samples; 0: none are taken.
    done : int
        Steps since the first sample.
    samples : ndarray, shape (n, 2 (3 + N))
        Receives the motions `sample_every`, 2 `sample_every`, ... steps after the first sample.
    remainder : ndarray, shape (m,)
        Receives n at the start of the last step that was done.

    Returns
    -------
    int
        Steps done; fewer than given if the state is no longer finite, or the linear part is not
        the one for it.

    """
    check(state, load, loads, propagator)
    size = propagator.whole
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    copy(state, now)
    for k in range(len(loads) + 1):
        # `Steps.motion` comes from here, too: compiled elsewhere it could be rounded differently.
        if sample_every and (done + k) % sample_every == 0:
            observe(tables, now, load, samples[(done + k) // sample_every])
        if k == len(loads):
            break
        start, middle, end = loads[k, START], loads[k, MIDDLE], loads[k, END]
        one_step(tables, propagator, now, start, middle, end, half, following, combined, rate_0,
                 rate_a, rate_b, rate_c, stage)
        if not is_finite(stage):
            copy(now, state)
            return k
        copy(rate_0, remainder)
        copy(stage, now)
        load = loads[k, AFTER]
        if k + 1 < len(loads) and not holds(tables, now, load):
            copy(now, state)
            return k + 1
    copy(now, state)
    return len(loads)
