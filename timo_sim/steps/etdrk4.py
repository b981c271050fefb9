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

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import (
    Array, as_vectors, Constants, declare, inner, magnitude, square_root, strict, WIDTH)
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
    size, count = linear.shape[-1], len(Propagator._fields)
    every = np.ascontiguousarray(linear, dtype=float).reshape(-1, size * size)
    found, compute = np.empty((len(every), count, size, size)), propagate.of()
    scale, room = np.empty(size), np.zeros((_MATRICES, size, -(-size // WIDTH) * WIDTH))
    rows = room.reshape(-1, WIDTH)
    for out, each in zip(found, every):
        compute(each, size, step, SERIES, scale, rows)
        out[:] = room[:count, :, :size]
    return Propagator._make(found.swapaxes(0, 1).reshape(count, *linear.shape))


# The series of phi_3 is summed where the norm of its argument is at most _NORM. Cut off after
# 22 terms, its relative error is 2^23 3! / 26! = 1e-19.
_NORM, SERIES = 2.0, np.array([1.0 / math.factorial(k + 3) for k in range(23)])
_TERMS = len(SERIES)
# Places of matrices in the room of `propagate`: phi_0 to phi_3 of the argument, those of half of
# it, and the argument. At the end the first are those of a Propagator.
_PHI, _HALF, _Z, _MATRICES = 0, 4, 8, 9


@inner
def _begin(size, matrix):
    """Return the first row of a matrix in the room; each of its rows takes `_width` of them."""
    return matrix * size * _width(size)


@inner
def _width(size):
    return (size + WIDTH - 1) // WIDTH


@inner
def _multiply(room, size, first, second, out):
    """Write the product of two matrices in the room; their number of rows is even."""
    width, rows = _width(size), as_vectors(room)
    a, c = _begin(size, first), _begin(size, out)
    for _ in range(0, size, 2):
        for j in range(width):
            b = _begin(size, second) + j
            upper, lower = room[a, 0] * rows[b, 0], room[a + width, 0] * rows[b, 0]
            for k in range(1, size):
                b += width
                upper += room[a, k] * rows[b, 0]
                lower += room[a + width, k] * rows[b, 0]
            rows[c + j, 0], rows[c + width + j, 0] = upper, lower
        a, c = a + 2 * width, c + 2 * width


@inner
def _add_one(room, size, matrix, value):
    """Add a multiple of the unit matrix to a matrix in the room."""
    for i in range(size):
        room[_begin(size, matrix) + i * _width(size), i] += value


@inner
def _balance(room, size, scale):
    """Replace L by S^-1 L S, whose rows and columns have like norms. Source: LAPACK, dgebal."""
    begin, width, changed = _begin(size, _Z), _width(size), True
    for i in range(size):
        scale[i] = 1.0
    while changed:
        changed = False
        for i in range(size):
            column, row, factor = 0.0, 0.0, 1.0
            for j in range(size):
                column += room[begin + j * width, i] * room[begin + j * width, i]
                row += room[begin + i * width, j] * room[begin + i * width, j]
            column, row = square_root(column), square_root(row)
            before = column + row
            while 0.0 < column < 0.5 * row:
                factor, column, row = 2.0 * factor, 2.0 * column, 0.5 * row
            while 0.5 * column >= row > 0.0:
                factor, column, row = 0.5 * factor, 0.5 * column, 2.0 * row
            if column + row < 0.95 * before:
                changed = True
                scale[i] *= factor
                for j in range(size):
                    room[begin + i * width, j] /= factor
                for j in range(size):
                    room[begin + j * width, i] *= factor


@entry_point(linear=Array((None,)), size=int, step=float, series=Array((None,)),
             scale=Array((None,)), room=Array((None, WIDTH)))
def propagate(linear, size, step, series, scale, room):
    """
    Write the matrices of a Propagator to the room, which has zeros; `size` is m.

    The definition of phi_k, divided by z, would cancel for small eigenvalues, such as those of a
    free manipulator, which are zero. Therefore the series of phi_3 is summed for a small argument,
    phi_2 to phi_0 follow from `phi_{k-1}(z) = z phi_k(z) + 1/(k-1)!`, and the argument is doubled
    by `2^k phi_k(2 z) = phi_0(z) phi_k(z) + sum_j phi_j(z) / (k - j)!`, j = 1..k. Source:
    Skaflestad and Wright, Appl. Numer. Math. 59 (2009) 783-799.

    Stiffnesses and compliances differ by many decades, so that the norm of h L is far above the
    phase h omega of the fastest vibration. A diagonal matrix S of powers of two balances L:
    S^-1 L S has a norm of about that phase, S is exact in floating point, and
    phi_k(L) = S phi_k(S^-1 L S) S^-1. Fewer doublings are then needed, and each costs digits.
    """
    width, length, rows = _width(size), _begin(size, 1), as_vectors(room)
    begin = _begin(size, _Z)
    for i in range(size):
        for j in range(size):
            room[begin + i * width, j] = linear[i * size + j]
    _balance(room, size, scale)
    norm = 0.0
    for j in range(size):
        total = 0.0
        for i in range(size):
            total += magnitude(step * room[begin + i * width, j])
        norm = max(norm, total)
    # At least two: the last doubling but one gives the functions of h L / 2.
    doublings, part = 2, 0.25
    while norm * part > _NORM:
        doublings, part = doublings + 1, 0.5 * part
    for k in range(length):
        rows[begin + k, 0] *= step * part
        rows[3 * length + k, 0] = 0.0 * rows[begin + k, 0]
    # Horner's scheme for phi_3(z) = sum_k z^k / (k + 3)!
    _add_one(room, size, 3, series[_TERMS - 1])
    for k in range(_TERMS - 2, 0, -2):
        _multiply(room, size, _Z, 3, 0)
        _add_one(room, size, 0, series[k])
        _multiply(room, size, _Z, 0, 3)
        _add_one(room, size, 3, series[k - 1])
    for k in range(2, -1, -1):
        _multiply(room, size, _Z, k + 1, k)
        _add_one(room, size, k, 0.5 if k == 2 else 1.0)
    for _ in range(doublings):
        for k in range(4 * length):
            rows[_HALF * length + k, 0] = rows[k, 0]
        for k in range(4):
            _multiply(room, size, _HALF, _HALF + k, k)
        for k in range(length):
            one, two, three = (rows[(_HALF + 1) * length + k, 0], rows[
                (_HALF + 2) * length + k, 0], rows[(_HALF + 3) * length + k, 0])
            rows[length + k, 0] = 0.5 * (rows[length + k, 0] + one)
            rows[2 * length + k, 0] = 0.25 * (rows[2 * length + k, 0] + one + two)
            rows[3 * length + k, 0] = 0.125 * (rows[3 * length + k, 0] + 0.5 * one + two + three)
    for i in range(size):
        for j in range(size):
            place, ratio = i * width, scale[i] / scale[j]
            one, two, three = room[length + place, j], room[2 * length + place, j], room[
                3 * length + place, j]
            room[place, j] *= ratio
            room[length + place, j] = ratio * room[_HALF * length + place, j]
            room[2 * length + place, j] = 0.5 * step * ratio * room[
                (_HALF + 1) * length + place, j]
            room[3 * length + place, j] = step * ratio * (one - 3.0 * two + 4.0 * three)
            room[4 * length + place, j] = step * ratio * (2.0 * two - 4.0 * three)
            room[5 * length + place, j] = step * ratio * (4.0 * three - two)


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
