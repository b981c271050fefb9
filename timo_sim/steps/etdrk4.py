# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The step: fourth-order exponential time differencing, ETDRK4, and its matrices.

For `y' = L y + n(y, t)`, with the stiff constant part L propagated exactly. Source: Cox and
Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. (26)-(29); doc/theory.md (T36).
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from scipy.linalg.lapack import dgebal

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, as_vectors, Constants, declare, inner, strict
from timo_sim.model.functions import copy, linear_part_is_valid, observe, rate
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS
from timo_sim.steps.bristles import (
    BEGINNING, Bent, FIRST, HEAT, LAST, MEMORY, rub, SECOND, start_bristles)


class Propagator(NamedTuple):
    """
    The matrices of one step, for one linear part L and one step size h.

    With `phi_0(z) = exp(z)`, `phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z`; each has shape (m, m),
    or those of many linear parts (n, m, m).
    """

    whole: Annotated[np.ndarray, 'state', 'padded_state']        # phi_0(h L)
    half: Annotated[np.ndarray, 'state', 'padded_state']         # phi_0(h L/2)
    half_weight: Annotated[np.ndarray, 'state', 'padded_state']  # h/2 phi_1(h L/2)
    # h (phi_1 - 3 phi_2 + 4 phi_3)(h L), h (2 phi_2 - 4 phi_3)(h L), h (4 phi_3 - phi_2)(h L)
    start_weight: Annotated[np.ndarray, 'state', 'padded_state']
    middle_weight: Annotated[np.ndarray, 'state', 'padded_state']
    end_weight: Annotated[np.ndarray, 'state', 'padded_state']


def propagator(linear: np.ndarray, step: float) -> Propagator:
    """Return the matrices of a step h [s] for linear parts L, shape (..., m, m) [1/s]."""
    (whole, phi_1, phi_2, phi_3), half = _phi_of_balanced(linear, step)
    return Propagator(whole=whole, half=half[0], half_weight=0.5 * step * half[1],
                      start_weight=step * (phi_1 - 3.0 * phi_2 + 4.0 * phi_3),
                      middle_weight=step * (2.0 * phi_2 - 4.0 * phi_3),
                      end_weight=step * (4.0 * phi_3 - phi_2))


# The series of phi_3 is summed where the norm of its argument is at most _NORM. Cut off after
# _TERMS terms, its relative error is 2^23 3! / 26! = 1e-19.
_NORM, _TERMS = 2.0, 22


def _phi_of_balanced(linear, step):
    """
    Return phi_0 to phi_3 of h L and of h L / 2, shape (2, 4, ..., m, m).

    Stiffnesses and compliances differ by many decades, so that the norm of h L is far above the
    phase h omega of the fastest vibration. A diagonal matrix S of powers of two balances L:
    S^-1 L S has a norm of about that phase, S is exact in floating point, and
    phi_k(L) = S phi_k(S^-1 L S) S^-1. Fewer doublings are then needed, and each costs digits.
    """
    every = linear.reshape(-1, *linear.shape[-2:])
    found = [dgebal(each, scale=1, permute=0) for each in every]
    # In the order of memory that LAPACK returns, on which the last bits of products depend.
    balanced = np.array([each[0].T for each in found]).swapaxes(1, 2)
    z, scale = step * balanced, np.array([each[3] for each in found])
    norms = np.abs(z).sum(axis=1).max(axis=1)
    # At least two: the last doubling but one gives the functions of h L / 2.
    doublings = np.array([max(2, math.ceil(math.log2(norm / _NORM))) if norm > 0.0 else 2
                          for norm in norms])
    phi = np.empty((2, 4, *z.shape))
    for number in np.unique(doublings):  # matrices with the same number go through together
        those = doublings == number
        phi[..., those, :, :] = _phi(
            (z.swapaxes(1, 2)[those] / 2.0**number).swapaxes(1, 2), number)
    phi *= scale[:, :, np.newaxis]
    phi /= scale[:, np.newaxis, :]
    return phi.reshape(*phi.shape[:-3], *linear.shape)


def _phi(z, doublings):
    """
    Return phi_0 to phi_3 of matrices that are doubled some times, and of half of that.

    The definition of phi_k, divided by z, would cancel for small eigenvalues, such as those of a
    free manipulator, which are zero. Therefore the series of phi_3 is summed for a small argument,
    phi_2 to phi_0 follow from `phi_{k-1}(z) = z phi_k(z) + 1/(k-1)!`, and the argument is doubled
    by `2^k phi_k(2 z) = phi_0(z) phi_k(z) + sum_j phi_j(z) / (k - j)!`, j = 1..k. Source:
    Skaflestad and Wright, Appl. Numer. Math. 59 (2009) 783-799.

    `z`, (n, m, m), have norms up to `_NORM`; the shape of the result is (2, 4, n, m, m).
    """
    one = np.eye(z.shape[-1])
    diagonal = np.arange(len(one))
    # Horner's scheme for phi_3(z) = sum_k z^k / (k + 3)!
    phi_3 = np.broadcast_to(one / float(math.factorial(_TERMS + 3)), z.shape)
    for k in reversed(range(_TERMS)):
        phi_3 = z @ phi_3
        phi_3[:, diagonal, diagonal] += 1.0 / math.factorial(k + 3)
    phi_2 = z @ phi_3 + 0.5 * one
    phi_1 = z @ phi_2 + one
    found = [np.array([z @ phi_1 + one, phi_1, phi_2, phi_3])]
    for _ in range(doublings):
        phi_0, phi_1, phi_2, phi_3 = found[0]
        found.insert(0, np.array([
            phi_0 @ phi_0, 0.5 * (phi_0 @ phi_1 + phi_1), 0.25 * (phi_0 @ phi_2 + phi_1 + phi_2),
            0.125 * (phi_0 @ phi_3 + 0.5 * phi_1 + phi_2 + phi_3)]))
    return np.array(found[:2])


@inner
def product(turned, vector, out):
    """Write the product of a matrix, which is given transposed, and a vector."""
    for i in range(len(out)):
        out[i] = 0.0
    add_product(turned, vector, out)


@inner
def add_product(turned, vector, out):
    """Add what `product` writes."""
    # Rows here are columns of the matrix. Two sums, vectors or duals, stay in registers.
    rows, sums = as_vectors(turned), as_vectors(out)
    for i in range(0, len(sums) - 1, 2):
        first, second = sums[i], sums[i + 1]
        for j in range(len(rows)):
            first += rows[j, i] * vector[j]
            second += rows[j, i + 1] * vector[j]
        sums[i], sums[i + 1] = first, second
    for i in range(len(sums) - len(sums) % 2, len(sums)):
        for j in range(len(rows)):
            sums[i] += rows[j, i] * vector[j]


@strict
def is_finite(vector):
    for i in range(len(vector)):
        if vector[i] - vector[i] != 0.0:
            return False
    return True


class Work(NamedTuple):
    """Work arrays of a step. Cox and Matthews call the stages a, b and c."""

    now: Annotated[np.ndarray, 'padded_state']        # the state at the start
    following: Annotated[np.ndarray, 'padded_state']  # a and b, then the state at the end
    half: Annotated[np.ndarray, 'padded_state']       # the start, propagated freely by h/2
    third: Annotated[np.ndarray, 'padded_state']      # c
    combined: Annotated[np.ndarray, 'padded_state']   # a sum of rates
    rate_0: Annotated[np.ndarray, 'padded_state']     # n at the start
    rate_a: Annotated[np.ndarray, 'padded_state']     # n in the middle, at a
    rate_b: Annotated[np.ndarray, 'padded_state']     # n in the middle, at b
    rate_c: Annotated[np.ndarray, 'padded_state']     # n at the end, at c


@declare
def one_step(matrices, tables, bristles, bent, start, middle, end, work):
    """
    Write the state one step after `now` to `following`; the stages see three loads.

    They also see the friction of bristles, whose constants and start are given.
    """


@inner
def rate_of_stage(tables, bristles, bent, stage, state, load, out):
    """Write the rate of the state of a stage, under a load and the friction of bristles."""
    if len(bristles.reach):
        rub(tables, bristles, bent, stage, state, load)
        rate(tables, state, bent.load, out)
    else:
        rate(tables, state, load, out)


@one_step.of(Propagator, merge=True)
def _one_step(propagator, tables, bristles, bent, start, middle, end, work):
    """As `one_step`, by (T36)."""
    now, following = work.now, work.following
    rate_of_stage(tables, bristles, bent, BEGINNING, now, start, work.rate_0)

    # a = e^(hL/2) y + h/2 phi_1(hL/2) n_0
    product(propagator.half, now, work.half)
    copy(work.half, following)
    add_product(propagator.half_weight, work.rate_0, following)
    rate_of_stage(tables, bristles, bent, FIRST, following, middle, work.rate_a)

    # The first term of c, e^(hL/2) a, before b takes the place of a;
    # b = e^(hL/2) y + h/2 phi_1(hL/2) n_a
    product(propagator.half, following, work.third)
    copy(work.half, following)
    add_product(propagator.half_weight, work.rate_a, following)
    rate_of_stage(tables, bristles, bent, SECOND, following, middle, work.rate_b)

    # c = e^(hL/2) a + h/2 phi_1(hL/2) (2 n_b - n_0)
    for i in range(len(propagator.half)):
        work.combined[i] = 2.0 * work.rate_b[i] - work.rate_0[i]
    add_product(propagator.half_weight, work.combined, work.third)
    rate_of_stage(tables, bristles, bent, LAST, work.third, end, work.rate_c)

    # The result, with the weights of n_0, of n_a + n_b and of n_c.
    for i in range(len(propagator.half)):
        work.combined[i] = work.rate_a[i] + work.rate_b[i]
    product(propagator.whole, now, following)
    add_product(propagator.start_weight, work.rate_0, following)
    add_product(propagator.middle_weight, work.combined, following)
    add_product(propagator.end_weight, work.rate_c, following)


class Room(NamedTuple):
    """A work array: a motion."""

    motion: Annotated[np.ndarray, 'motion']


@entry_point(tables=Constants(), propagator=Constants(), bristles=Constants(),
             memory=Array((MEMORY,), own=True), state=Array(('state',), own=True),
             load=Array((LOADS,), own=True), loads=Array((None, STEP_LOADS, LOADS), own=True),
             count=int, sample_every=int, since=int, samples=Array((None, 'motion'), own=True),
             heat=Array((None,), own=True))
def advance(tables, propagator, bristles, memory, state, load, loads, count, sample_every, since,
            samples, heat):
    """
    Integrate over `count` equal steps, as long as the linear part of the tables is valid.

    `tables` are the constants of a formulation; their kind selects its functions. `state` is
    advanced in place, `load` is that at the start. `loads` has for each step those that its stages
    see, (T37), then the true load at its end, which samples show, see `model.layout`. `samples`
    receive the motions `sample_every`, 2 `sample_every`, ... steps after the first sample, which
    was `since` steps ago; with `sample_every` = 0 none. `memory`, see `bristles`, is advanced in
    place; with bristles `heat` receives that with each sample.

    Return the steps done; they are fewer if the state is no longer finite, or the linear part is
    not the one for it.
    """
    work = local_arrays(Work, propagator)
    now, following, motion = work.now, work.following, local_arrays(Room, tables).motion
    bent = local_arrays(Bent, bristles)
    copy(state, now)
    k = 0
    while True:
        sampled = sample_every != 0 and (since + k) % sample_every == 0
        if len(bristles.reach):
            observe(tables, now, load, motion)
            start_bristles(tables, bristles, now, load, motion, k > 0, bent, memory)
            if sampled:
                copy(motion, samples[(since + k) // sample_every])
                heat[(since + k) // sample_every] = memory[HEAT]
        # `Steps.motion` comes from here, too: compiled elsewhere it could be rounded differently.
        elif sampled:
            observe(tables, now, load, samples[(since + k) // sample_every])
        if k == count or k > 0 and not linear_part_is_valid(tables, now, load):
            break
        start, middle, end = loads[k, START], loads[k, MIDDLE], loads[k, END]
        one_step(propagator, tables, bristles, bent, start, middle, end, work)
        if not is_finite(following):
            break
        copy(following, now)
        load = loads[k, AFTER]
        k += 1
    copy(now, state)
    return k
