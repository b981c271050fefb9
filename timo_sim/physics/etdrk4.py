"""
Fourth-order exponential time differencing, ETDRK4.

For `y' = L y + n(y, t)`, with the stiff constant part L propagated exactly. Source: Cox and
Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. (26)-(29); doc/theory.md (T29).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance

from timo_sim.physics.compiled import dispatch, entry_point, inner, local, pasted, strict

STAGES = 3  # a step evaluates its load at t, t + h/2 and t + h
_NORM, _TERMS = 2.0, 22  # 2^23 3! / 26! = 1e-19 is left of the series of phi_3


class Propagator(NamedTuple):
    """
    The matrices of one step, for one linear part L and one step size h.

    With `phi_0(z) = exp(z)`, `phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z`; each has shape (m, m).
    """

    whole: np.ndarray        # phi_0(h L)
    half: np.ndarray         # phi_0(h L/2)
    half_weight: np.ndarray  # h/2 phi_1(h L/2)
    first: np.ndarray        # h (phi_1 - 3 phi_2 + 4 phi_3)(h L)
    middle: np.ndarray       # h (2 phi_2 - 4 phi_3)(h L)
    last: np.ndarray         # h (4 phi_3 - phi_2)(h L)


def propagator(linear, step):
    """Build the matrices of a step, see `propagators`."""
    return propagators(linear, step)[0]


def propagators(linear, step):
    """
    Build the matrices of a step and, for little more, those of a step half as long.

    Parameters
    ----------
    linear : ndarray, shape (m, m)
        L, per second.
    step : float
        h [s].

    Returns
    -------
    list of Propagator

    """
    # Stiffnesses and compliances differ by many decades; balanced (by powers of two, exactly),
    # the norm of h L is about that of the fastest wave and the exponential keeps its digits.
    balanced, (scale, _) = matrix_balance(linear, permute=False, separate=True)
    whole, half, quarter = (scale[:, np.newaxis] * phi / scale for phi in _phi(step * balanced))
    return [_combined(step, whole, half), _combined(0.5 * step, half, quarter)]


def _combined(step, whole, half):
    _, phi_1, phi_2, phi_3 = whole
    return Propagator(whole[0], half[0], 0.5 * step * half[1],
                      step * (phi_1 - 3.0 * phi_2 + 4.0 * phi_3),
                      step * (2.0 * phi_2 - 4.0 * phi_3), step * (4.0 * phi_3 - phi_2))


def _phi(z):
    """
    Return phi_0 to phi_3 of a matrix, of its half and of its quarter, each of shape (4, m, m).

    By the series of phi_3 of the matrix divided by a power of two, then doubling the argument:
    `2^k phi_k(2 z) = phi_0(z) phi_k(z) + sum_j phi_j(z) / (k - j)!`, j = 1..k. Source: Skaflestad
    and Wright, Appl. Numer. Math. 59 (2009) 783-799.
    """
    norm = np.linalg.norm(z, 1)
    doublings = max(2, math.ceil(math.log2(norm / _NORM))) if norm > 0.0 else 2
    z, one = z / 2.0**doublings, np.eye(len(z))
    phi_3 = one / math.factorial(_TERMS + 3)
    for k in reversed(range(_TERMS)):
        phi_3 = z @ phi_3
        phi_3.flat[::len(z) + 1] += 1.0 / math.factorial(k + 3)
    phi_2 = z @ phi_3 + 0.5 * one
    phi_1 = z @ phi_2 + one
    found = [np.array([z @ phi_1 + one, phi_1, phi_2, phi_3])]
    for _ in range(doublings):
        phi_0, phi_1, phi_2, phi_3 = found[0]
        found.insert(0, np.array([
            phi_0 @ phi_0, 0.5 * (phi_0 @ phi_1 + phi_1), 0.25 * (phi_0 @ phi_2 + phi_1 + phi_2),
            0.125 * (phi_0 @ phi_3 + 0.5 * phi_1 + phi_2 + phi_3)]))
    return found[:3]


@inner
def copy(vector, out):
    for i in range(len(vector)):
        out[i] = vector[i]


@inner
def _multiply(matrix, vector, out):
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] = total


@inner
def _multiply_add(matrix, vector, out):
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] += total


@strict
def is_finite(vector):
    for i in range(len(vector)):
        if not np.isfinite(vector[i]):
            return False
    return True


@dispatch
def rate(tables, state, load, out):
    """
    Write the nonlinear part n(y, load) of a formulation, the load included.

    Parameters
    ----------
    tables : record
        The formulation's constants.
    state, out : ndarray, shape (m,)
    load : ndarray, shape (14,)
        Columns as in `formulation`.

    """


@dispatch
def observe(tables, state, load, out):
    """Write the motion (see `formulation`) that belongs to a state and a load."""


@dispatch
def tip(tables, motion, out):
    """
    Write where the tip of a motion's arm is.

    Parameters
    ----------
    tables : record
        The formulation's constants.
    motion : ndarray
        See `formulation`.
    out : ndarray, shape (3,)
        Along axes I and II from the root [m], rotation relative to the shaft [rad].

    """


@entry_point
def rate_once(tables, state, load, out):
    """Call `rate` from Python."""
    rate(tables, state, load, out)


@entry_point
def tip_once(tables, motion, out):
    """Call `tip` from Python."""
    tip(tables, motion, out)


@pasted
def one_step(tables, propagator, now, start, middle, end, half, following, combined,
             rate_0, rate_a, rate_b, rate_c, stage):
    """Write the state one step after `now`, and the rates of the four stages."""
    rate(tables, now, start, rate_0)
    _multiply(propagator.half, now, half)
    copy(half, stage)
    _multiply_add(propagator.half_weight, rate_0, stage)

    rate(tables, stage, middle, rate_a)
    _multiply(propagator.half, stage, following)
    copy(half, stage)
    _multiply_add(propagator.half_weight, rate_a, stage)

    rate(tables, stage, middle, rate_b)
    for i in range(len(propagator.half)):
        combined[i] = 2.0 * rate_b[i] - rate_0[i]
    _multiply_add(propagator.half_weight, combined, following)

    rate(tables, following, end, rate_c)
    for i in range(len(propagator.half)):
        combined[i] = rate_a[i] + rate_b[i]
    _multiply(propagator.whole, now, stage)
    _multiply_add(propagator.first, rate_0, stage)
    _multiply_add(propagator.middle, combined, stage)
    _multiply_add(propagator.last, rate_c, stage)


@entry_point
def advance(tables, propagator, state, load, loads, every, samples):
    """
    Integrate over a run of equal steps.

    Parameters
    ----------
    tables : record
        The formulation's constants; their names select the formulation.
    propagator : record
        The matrices of the step.
    state : ndarray, shape (m,)
        Advanced in place.
    load : ndarray, shape (14,)
        Load at the start, for the first sample.
    loads : ndarray, shape (steps, 3, 14)
        Load of each step at its start, middle and end, as the step itself sees it: a jump on the
        boundary between two steps appears on the right side in either.
    every : int
        Steps between samples; 0: none are taken.
    samples : ndarray, shape (1 + steps // every, 2 (3 + N))
        Receives the motion at the start and after steps every, 2 every, ...

    Returns
    -------
    int
        Steps done; fewer than given if the state is no longer finite.

    """
    size = propagator.whole
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    copy(state, now)
    for k in range(len(loads) + 1):
        # The only place from which motions come: others would be rounded in another way.
        if every and k % every == 0:
            observe(tables, now, load, samples[k // every])
        if k == len(loads):
            break
        start, middle, end = loads[k, 0], loads[k, 1], loads[k, 2]
        one_step(tables, propagator, now, start, middle, end, half, following, combined, rate_0,
                 rate_a, rate_b, rate_c, stage)
        if not is_finite(stage):
            copy(now, state)
            return k
        copy(stage, now)
        load = end
    copy(now, state)
    return len(loads)


@entry_point
def advance_within(tables, whole, halves, shift, tolerance, state, load, loads, first, every,
                   samples, errors):
    """
    Integrate as `advance`, until a step and its two halves differ by more than a tolerance.

    It is the halves that count; their error is about 1/15 of the difference.

    Parameters
    ----------
    whole, halves : record
        The matrices of the step, and of one half as long.
    shift : ndarray, shape (m, m)
        Turns the difference of the states into errors, of which the sizes are summed up.
    tolerance : float
    loads : ndarray, shape (2 steps, 3, 14)
        Of the halves.
    first : int
        Steps that are done.
    errors : ndarray, shape (2,)
        Receives the largest error of a step that was done, and that of the one that was not.

    Returns
    -------
    int
        Steps done, the first ones included.

    """
    size = whole.whole
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    begin, coarse, difference = local((size,)), local((size,)), local((size,))
    copy(state, now)
    steps = len(loads) // 2
    done = first
    for k in range(first, steps + 1):
        if every and k % every == 0:
            observe(tables, now, load, samples[k // every])
        if k == steps:
            break
        copy(now, begin)
        for part in range(3):  # the whole, then the halves
            if part == 0:
                matrices = whole
                start, middle, end = loads[2 * k, 0], loads[2 * k, 2], loads[2 * k + 1, 2]
            else:
                matrices, i = halves, 2 * k + part - 1
                start, middle, end = loads[i, 0], loads[i, 1], loads[i, 2]
            one_step(tables, matrices, begin, start, middle, end, half, following, combined,
                     rate_0, rate_a, rate_b, rate_c, stage)
            if part == 0:
                copy(stage, coarse)
            else:
                copy(stage, begin)
        for i in range(len(size)):
            coarse[i] -= stage[i]
        _multiply(shift, coarse, difference)
        error = 0.0
        for i in range(len(size)):
            error += abs(difference[i])
        if not (error <= tolerance and is_finite(stage)):
            errors[1] = error
            break
        errors[0] = max(errors[0], error)
        copy(stage, now)
        load = end
        done += 1
    copy(now, state)
    return done
