# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Derivatives of steps, of the motion after them by the motion before them and by loads.

The equations and the step are those of a run, compiled for duals.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.functions import Array, Constants, inner, local, value_of, with_derivatives
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import copy, linear_part_is_valid, observe
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS
from timo_sim.steps.etdrk4 import one_step, Work
from timo_sim.steps.steps import Steps


class Room(NamedTuple):
    """Work arrays: what the stages of a step see, and a motion."""

    loads: Annotated[np.ndarray, STEP_LOADS, LOADS]
    motion: Annotated[np.ndarray, 'motion']


@inner
def _set(values, slopes, first, out):
    """Set duals to values; their derivatives are columns of slopes, from `first` on."""
    numbers = with_derivatives(out)
    for i in range(len(values)):
        out[i] = values[i]
        for k in range(first, min(first + numbers.shape[1] - 1, slopes.shape[1])):
            numbers[i, 1 + k - first] = slopes[i, k]


@inner
def _set_inputs(unit, inputs, first, out):
    """Set the derivatives of the loads of a step by inputs, which begin at `first`."""
    numbers = with_derivatives(out)
    for row in range(STEP_LOADS):
        for i in range(LOADS):
            out[row, i] = 0.0
            for k in range(max(0, -first), min(inputs, numbers.shape[2] - 1 - first)):
                numbers[row, i, 1 + first + k] = unit[k, i]


@inner
def _invert(matrix):
    """Invert a matrix in place by elimination; that of rates by momenta needs no exchanges."""
    for k in range(len(matrix)):
        factor, matrix[k, k] = 1.0 / matrix[k, k], 1.0
        for j in range(len(matrix)):
            matrix[k, j] *= factor
        for i in range(len(matrix)):
            factor = matrix[i, k]
            if i != k and factor != 0.0:
                matrix[i, k] = 0.0
                for j in range(len(matrix)):
                    matrix[i, j] -= factor * matrix[k, j]


@inner
def _set_slopes(tables, places, state, load, now, room, slopes):
    """Set the derivatives of the state by the numbers of a motion at some places."""
    numbers = with_derivatives(room.motion)
    for i in range(len(slopes)):
        for k in range(len(slopes)):
            slopes[i, k] = 1.0 if i == k else 0.0
    for first in range(0, len(state), numbers.shape[1] - 1):
        _set(state, slopes, first, now)
        observe(tables, now, room.loads[AFTER], room.motion)
        for k in range(first, min(first + numbers.shape[1] - 1, len(state))):
            for i in range(len(state)):
                slopes[i, k] = numbers[places[i], 1 + k - first]
    _invert(slopes)


def differentiate(tables, propagator, places, state, load, loads, count, unit, inputs, end, out):
    """
    Write the derivatives of the motion after some steps; the state stays.

    Each row is what a unit of a number of the motion before the steps or, in the last rows, of an
    input changes.

    Parameters
    ----------
    tables, propagator : packed constants
    places : ndarray of int, shape (m,)
        Places of the free coordinates and their rates in a motion.
    state, load, loads, count
        As in `etdrk4.advance`.
    unit, inputs : ndarray, shape (k, LOADS), and k
        What one of each input adds to all loads.
    end : ndarray, shape (m,)
        Receives the state at the end.
    out : ndarray, shape (2 (3 + N) + k, 2 (3 + N))

    Returns
    -------
    int
        Steps done, as by `etdrk4.advance`.

    """
    work, room, slopes = (
        local_arrays(Work, propagator), local_arrays(Room, tables), local((state, state)))
    now, following, size = work.now, work.following, len(state)
    at_end, turns = with_derivatives(room.motion), with_derivatives(now).shape[1] - 1
    for i in range(LOADS):
        room.loads[AFTER, i] = load[i]
    _set_slopes(tables, places, state, load, now, room, slopes)
    for k in range(at_end.shape[0] + inputs):
        for i in range(at_end.shape[0]):
            out[k, i] = 0.0
    numbers, done = with_derivatives(room.loads), 0
    for first in range(0, size + inputs, turns):
        _set(state, slopes, first, now)
        _set_inputs(unit, inputs, size - first, room.loads)
        done = 0
        while done < count:
            for row in range(STEP_LOADS):
                for i in range(LOADS):
                    numbers[row, i, 0] = loads[done, row, i]
            one_step(propagator, tables, room.loads[START], room.loads[MIDDLE], room.loads[END],
                     work)
            copy(following, now)
            done += 1
            if not linear_part_is_valid(tables, now, room.loads[AFTER]):
                break
        observe(tables, now, room.loads[AFTER], room.motion)
        for k in range(first, min(first + turns, size + inputs)):
            row = places[k] if k < size else at_end.shape[0] + k - size
            for i in range(at_end.shape[0]):
                out[row, i] = at_end[i, 1 + k - first]
    for i in range(size):
        end[i] = value_of(now[i])
    return done


# By the size of duals.
_ENTRIES = {size: EntryPoint(differentiate, {
    'tables': Constants(duals=size), 'propagator': Constants(duals=size),
    'places': Array(('state',), whole=True), 'state': Array(('state',)), 'load': Array((LOADS,)),
    'loads': Array((None, STEP_LOADS, LOADS)), 'count': int, 'unit': Array((None, LOADS)),
    'inputs': int, 'end': Array(('state',)), 'out': Array((None, 'motion'))},
    f'differentiate_{size}') for size in range(8, 33, 4)}


def entry_for(model: Formulation) -> EntryPoint:
    """Return `differentiate` for duals with derivatives by motion and loads of joints."""
    wanted = 1 + len(model.linear) + len(model.axes) + 1 - model.driven
    return _ENTRIES[min(max(wanted + -wanted % 4, 8), max(_ENTRIES))]


def step_derivatives(steps: Steps, state: np.ndarray, load: np.ndarray, loads: np.ndarray,
                     unit: np.ndarray) -> np.ndarray:
    """
    Return the derivatives of the motion after some steps.

    Where the linear part changes between steps, which one is taken is not differentiated.

    Parameters
    ----------
    steps : Steps
    state, load, loads
        As in `Steps.advance`; the state stays.
    unit : ndarray, shape (k, LOADS)
        What one of each input adds to all loads.

    Returns
    -------
    ndarray, shape (2 (3 + N), 2 (3 + N) + k)
        Columns: by the motion before the steps, then by the inputs.

    """
    model, size, inputs, parts = steps.model, steps.model.size, len(unit), []
    while True:
        part, end = steps.part(model.sector(state, load)), np.empty(len(state))
        found = np.empty((size + inputs, size))
        done = entry_for(model).of(*part.constants)(
            model.free_places, state, load, loads, len(loads), unit, inputs, end, found)
        parts.append(found)
        if done == len(loads):
            break
        state, load, loads = end, loads[done - 1, AFTER], loads[done:]
    total = parts[0].T
    for found in parts[1:]:
        total = found[:size].T @ total
        total[:, size:] += found[size:].T
    return total
