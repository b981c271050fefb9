# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of steps: of the motion after them by the motion before them and by loads."""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays, pack, Packed
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, as_vectors, Constants, inner, separate
from timo_sim.model import exact_derivatives  # noqa: F401  bodies of the functions below
from timo_sim.model.functions import (
    add_multiple, copy, differential, motion_by_state, state_by_motion)
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS
from timo_sim.steps.etdrk4 import add_product
from timo_sim.steps.steps import Steps


def step_derivatives(steps: Steps, state: np.ndarray, load: np.ndarray, loads: np.ndarray,
                     unit: np.ndarray) -> np.ndarray:
    """
    Return the derivatives of the motion after some steps.

    Parameters
    ----------
    steps : Steps
        Of a model without sectors whose state has momenta alone.
    state, load, loads
        As in `Steps.advance`; the state stays.
    unit : ndarray, shape (k, LOADS)
        What one of each input adds to all loads.

    Returns
    -------
    ndarray, shape (2 (3 + N), 2 (3 + N) + k)
        Columns: by the motion before the steps, then by the inputs.

    """
    motion, part = steps.model.size, steps.part(None)
    out = np.empty((motion + len(unit), motion))
    inputs = inputs_of(unit, motion)
    differentiate.of(*part, inputs)(state, load, loads, len(loads), out)
    return out.T


class Inputs(NamedTuple):
    """
    What steps are differentiated by.

    Columns are the numbers of a motion from the shaft angle on, since nothing depends on the
    carrier's place, then the inputs; each input acts during all of the steps.
    """

    unit: Annotated[np.ndarray, LOADS, 'padded_columns']  # what one of each adds to a load


def inputs_of(unit: np.ndarray, motion: int) -> Packed:
    """Return the constants for unit loads, (k, LOADS), and the length of a motion."""
    return pack(Inputs(np.hstack([np.zeros((LOADS, motion - 2)), unit.T])),
                rows=motion + len(unit))


class Point(NamedTuple):
    """A state or a rate, and its change by a unit of each column."""

    values: Annotated[np.ndarray, 'padded_state']
    changes: Annotated[np.ndarray, 'state', 'padded_columns']


class Rows(NamedTuple):
    """Work arrays: changes of one number, and of the motion at the end."""

    one: Annotated[np.ndarray, 'padded_columns']
    motion: Annotated[np.ndarray, 'motion', 'padded_columns']


@inner
def _set_zero(out):
    changes = as_vectors(out)
    for i in range(len(changes)):
        for d in range(changes.shape[1]):
            changes[i, d] = 0.0


@inner
def _set_sum(factor, left, other_factor, right, out):
    lefts, rights, sums = (
        as_vectors(left.changes), as_vectors(right.changes), as_vectors(out.changes))
    for i in range(len(sums)):
        out.values[i] = factor * left.values[i] + other_factor * right.values[i]
        for d in range(sums.shape[1]):
            sums[i, d] = factor * lefts[i, d] + other_factor * rights[i, d]


@separate
def _set_product(tables, turned, point, base, out):
    """
    Write a point `base` plus the product of a matrix, which is given transposed, and a point.

    In L, and hence in all matrices of a step, the place of the mass centre along each free axis is
    connected with its momentum alone, coordinates with coordinates and their momenta.
    """
    copy(base.values, out.values)
    add_product(turned, point.values, out.values)
    changes, bases, sums = (
        as_vectors(point.changes), as_vectors(base.changes), as_vectors(out.changes))
    total, axes = as_vectors(local_arrays(Rows, tables)).one, len(tables.axes)
    for k in range(axes):
        _set_block(turned, changes, bases, k, k + 1, total, sums)
    _set_block(turned, changes, bases, axes, len(turned) // 2, total, sums)


@inner
def _set_block(turned, changes, bases, first, last, total, sums):
    half = len(turned) // 2
    for row in range(0, 2 * half, half):
        for i in range(row + first, row + last):
            copy(bases[i], total)
            for column in range(0, 2 * half, half):
                for j in range(column + first, column + last):
                    add_multiple(turned[j, i], changes[j], total)
            copy(total, sums[i])


@entry_point(tables=Constants(), propagator=Constants(), inputs=Constants(),
             state=Array(('state',)), load=Array((LOADS,)), loads=Array((None, STEP_LOADS, LOADS)),
             count=int, out=Array(('rows', 'motion')))
def differentiate(tables, propagator, inputs, state, load, loads, count, out):
    """
    Write the derivatives of the motion after some steps, each through its stages; the state stays.

    Each row is what a unit of a number of the motion before the steps or, in the last rows, of an
    input changes. The changes go through the stages of a step (T36) as the state does, with the
    changes of n at each stage, doc/theory.md, section 7.

    Parameters
    ----------
    tables, propagator, inputs : packed constants
    state, load, loads, count
        As in `etdrk4.advance`.
    out : ndarray, shape (2 (3 + N) + inputs, 2 (3 + N))

    """
    none, now, stage = (
        local_arrays(Point, inputs), local_arrays(Point, inputs), local_arrays(Point, inputs))
    half, ahead = local_arrays(Point, inputs), local_arrays(Point, inputs)
    rate_0, rate_a = local_arrays(Point, inputs), local_arrays(Point, inputs)
    rate_b, rate_c = local_arrays(Point, inputs), local_arrays(Point, inputs)
    _set_zero(none.changes)
    for i in range(len(none.values)):
        none.values[i] = 0.0
    _set_zero(now.changes)
    copy(state, now.values)
    state_by_motion(tables, state, load, now.changes)
    for n in range(count):
        # The stages a, b and c of `etdrk4.one_step`, with their changes.
        differential(tables, inputs, now, loads[n, START], rate_0)
        _set_product(tables, propagator.half, now, none, half)
        _set_product(tables, propagator.half_weight, rate_0, half, stage)
        differential(tables, inputs, stage, loads[n, MIDDLE], rate_a)
        _set_product(tables, propagator.half, stage, none, ahead)

        _set_product(tables, propagator.half_weight, rate_a, half, stage)
        differential(tables, inputs, stage, loads[n, MIDDLE], rate_b)

        _set_sum(2.0, rate_b, -1.0, rate_0, stage)
        _set_product(tables, propagator.half_weight, stage, ahead, ahead)
        differential(tables, inputs, ahead, loads[n, END], rate_c)

        _set_sum(1.0, rate_a, 1.0, rate_b, rate_a)
        _set_product(tables, propagator.whole, now, none, ahead)
        _set_product(tables, propagator.start_weight, rate_0, ahead, ahead)
        _set_product(tables, propagator.middle_weight, rate_a, ahead, ahead)
        _set_product(tables, propagator.end_weight, rate_c, ahead, now)
        load = loads[n, AFTER]
    end = local_arrays(Rows, inputs).motion
    _set_zero(end)
    motion_by_state(tables, now.values, load, now.changes, end)
    for i in range(len(end)):
        out[0, i] = out[1, i] = 0.0
        for k in range(2, len(out)):
            out[k, i] = end[i, k - 2]
    for k in range(len(tables.axes)):
        out[tables.axes[k], tables.axes[k]] = 1.0
