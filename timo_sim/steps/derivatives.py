# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Derivatives of steps: of the motion after them by the motion before them and by loads."""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays, pack, Packed
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, as_vectors, Constants, inner, separate
from timo_sim.model import exact_derivatives  # noqa: F401  bodies of the functions below
from timo_sim.model.functions import differential, motion_by_state, state_by_motion
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS
from timo_sim.steps.etdrk4 import add_product, copy
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
    differentiate.of(*part.constants, inputs)(state, load, loads, len(loads), out)
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


class End(NamedTuple):
    """Work array: changes of the motion at the end."""

    changes: Annotated[np.ndarray, 'motion', 'padded_columns']


@inner
def _set_zero(out):
    changes = as_vectors(out)
    for i in range(len(changes)):
        for d in range(changes.shape[1]):
            changes[i, d] = 0.0


@inner
def _copy(source, out):
    copy(source.values, out.values)
    sources, changes = as_vectors(source.changes), as_vectors(out.changes)
    for i in range(len(changes)):
        for d in range(changes.shape[1]):
            changes[i, d] = sources[i, d]


@inner
def _set_sum(factor, left, other_factor, right, out):
    for i in range(len(out.values)):
        out.values[i] = factor * left.values[i] + other_factor * right.values[i]
    lefts, rights, sums = (
        as_vectors(left.changes), as_vectors(right.changes), as_vectors(out.changes))
    for i in range(len(sums)):
        for d in range(sums.shape[1]):
            sums[i, d] = factor * lefts[i, d] + other_factor * rights[i, d]


@inner
def _set_product(axes, turned, point, out):
    for i in range(len(out.values)):
        out.values[i] = 0.0
    _set_zero(out.changes)
    _add_product(axes, turned, point, out)


@separate
def _add_product(axes, turned, point, out):
    """
    Add the product of a matrix, which is given transposed, and a point.

    In L, and hence in all matrices of a step, the place of the mass centre along each of the free
    `axes` is connected with its momentum alone, coordinates with coordinates and their momenta.
    """
    add_product(turned, point.values, out.values)
    half = len(turned) // 2
    for row in range(0, 2 * half, half):
        for column in range(0, 2 * half, half):
            for k in range(axes):
                _add_block(turned, point.changes, row, column, k, k + 1, out.changes)
            _add_block(turned, point.changes, row, column, axes, half, out.changes)


@inner
def _add_block(turned, factors, row, column, first, last, out):
    changes, sums = as_vectors(factors), as_vectors(out)
    for i in range(row + first, row + last):
        for j in range(column + first, column + last):
            for d in range(sums.shape[1]):
                sums[i, d] += turned[j, i] * changes[j, d]


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
    axes = len(tables.axes)
    now, stage = local_arrays(Point, inputs), local_arrays(Point, inputs)
    half, ahead = local_arrays(Point, inputs), local_arrays(Point, inputs)
    rate_0, rate_a = local_arrays(Point, inputs), local_arrays(Point, inputs)
    rate_b, rate_c = local_arrays(Point, inputs), local_arrays(Point, inputs)
    copy(state, now.values)
    _set_zero(now.changes)
    state_by_motion(tables, state, load, now.changes)
    for n in range(count):
        differential(tables, inputs, now, loads[n, START], rate_0)
        _set_product(axes, propagator.half, now, half)

        _copy(half, stage)  # stage a of `etdrk4.one_step`
        _add_product(axes, propagator.half_weight, rate_0, stage)
        differential(tables, inputs, stage, loads[n, MIDDLE], rate_a)
        _set_product(axes, propagator.half, stage, ahead)

        _add_product(axes, propagator.half_weight, rate_a, half)  # b
        differential(tables, inputs, half, loads[n, MIDDLE], rate_b)

        _set_sum(2.0, rate_b, -1.0, rate_0, stage)
        _add_product(axes, propagator.half_weight, stage, ahead)  # c
        differential(tables, inputs, ahead, loads[n, END], rate_c)

        _set_sum(1.0, rate_a, 1.0, rate_b, stage)
        _set_product(axes, propagator.whole, now, ahead)
        _add_product(axes, propagator.start_weight, rate_0, ahead)
        _add_product(axes, propagator.middle_weight, stage, ahead)
        _add_product(axes, propagator.end_weight, rate_c, ahead)
        _copy(ahead, now)
        load = loads[n, AFTER]
    end = local_arrays(End, inputs).changes
    _set_zero(end)
    motion_by_state(tables, now.values, load, now.changes, end)
    for i in range(len(end)):
        out[0, i] = out[1, i] = 0.0
        for k in range(2, len(out)):
            out[k, i] = end[i, k - 2]
    for k in range(axes):
        out[tables.axes[k], tables.axes[k]] = 1.0
