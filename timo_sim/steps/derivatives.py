# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Derivatives of steps, of the motion after them by the motion before them and by loads.

The equations and the step are those of a run, compiled for duals.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.functions import Array, Constants, inner, value_of, with_derivatives
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import copy, linear_part_is_valid, observe, state_of
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS
from timo_sim.steps.bristles import Bent, MEMORY, start_bristles
from timo_sim.steps.etdrk4 import one_step, Work
from timo_sim.steps.steps import Steps


class Room(NamedTuple):
    """Work arrays: what the stages of a step see, what steps hand on, and a motion."""

    loads: Annotated[np.ndarray, STEP_LOADS, LOADS]
    memory: Annotated[np.ndarray, MEMORY]
    motion: Annotated[np.ndarray, 'motion']


@inner
def _set(values, slopes, first, last, out):
    """Set duals to values; their derivatives are rows of slopes, from `first` to `last`."""
    numbers = with_derivatives(out)
    for i in range(len(values)):
        out[i] = values[i]
        for k in range(first, last):
            numbers[i, 1 + k - first] = slopes[k, i]


@inner
def _get(given, first, last, slopes):
    """Get the derivatives of duals."""
    numbers = with_derivatives(given)
    for i in range(len(given)):
        for k in range(first, last):
            slopes[k, i] = numbers[i, 1 + k - first]


@inner
def _set_inputs(load, unit, inputs, first, out):
    """Set the loads of a step, with derivatives by inputs, which begin at `first`."""
    numbers = with_derivatives(out)
    for row in range(STEP_LOADS):
        for i in range(LOADS):
            out[row, i] = load[i]
            for k in range(max(0, -first), min(inputs, numbers.shape[2] - 1 - first)):
                numbers[row, i, 1 + first + k] = unit[k, i]


@inner
def _set_slopes(tables, places, state, memory_slopes, now, room, slopes, columns):
    """Set the derivatives of state and memory at the start, by the motion and by inputs."""
    motion, numbers, size = room.motion, with_derivatives(room.motion), len(state)
    turns = numbers.shape[1] - 1
    for k in range(columns):
        for i in range(size):
            slopes[k, i] = 0.0
        for i in range(MEMORY):
            memory_slopes[k, i] = 0.0
    for i in range(size):
        now[i] = state[i]
    observe(tables, now, room.loads[AFTER], motion)
    for first in range(0, size, turns):
        last = min(first + turns, size)
        for i in range(len(motion)):
            motion[i] = value_of(motion[i])
        for k in range(first, last):
            numbers[places[k], 1 + k - first] = 1.0
        state_of(tables, motion, now)
        _get(now, first, last, slopes)


@inner
def differentiate(tables, propagator, bristles, places, begins, state, memory, slopes,
                  memory_slopes, load, loads, count, unit, inputs, out):
    """
    Advance a state and its derivatives over some steps; write those of the motion at the end.

    Derivatives, in rows, are by the numbers of the motion at the start that are free and, in the
    last rows, by inputs.

    Parameters
    ----------
    tables, propagator, bristles : packed constants
    places : ndarray of int, shape (m,)
        Places of the free coordinates and their rates in a motion.
    begins : int
        Whether the state is that at the start; otherwise derivatives are known.
    state, memory : ndarray, shapes (m,), (MEMORY,)
        As in `etdrk4.advance`.
    slopes, memory_slopes : ndarray, shapes (m + k, m), (m + k, MEMORY)
        Their derivatives.
    load, loads, count
        As in `etdrk4.advance`.
    unit, inputs : ndarray, shape (k, LOADS), and k
        What one of each input adds to all loads.
    out : ndarray, shape (2 (3 + N) + k, 2 (3 + N))
        Receives derivatives of the motion, by all of its numbers.

    Returns
    -------
    int
        Steps done, as by `etdrk4.advance`.

    """
    work, room, bent = (local_arrays(Work, propagator), local_arrays(Room, propagator),
                        local_arrays(Bent, bristles))
    now, following, motion, size = work.now, work.following, room.motion, len(state)
    numbers, at_end = with_derivatives(room.loads), with_derivatives(motion)
    turns, done = at_end.shape[1] - 1, 0
    if begins != 0:
        for i in range(LOADS):
            room.loads[AFTER, i] = load[i]
        _set_slopes(tables, places, state, memory_slopes, now, room, slopes, size + inputs)
    for k in range(len(motion) + inputs):
        for i in range(len(motion)):
            out[k, i] = 0.0
    for first in range(0, size + inputs, turns):
        last = min(first + turns, size + inputs)
        _set(state, slopes, first, last, now)
        _set(memory, memory_slopes, first, last, room.memory)
        _set_inputs(load, unit, inputs, size - first, room.loads)
        done = 0
        while True:
            ends = done == count or done > 0 and not linear_part_is_valid(
                tables, now, room.loads[AFTER])
            if ends or len(bristles.reach):
                observe(tables, now, room.loads[AFTER], motion)
                start_bristles(tables, bristles, now, room.loads[AFTER], motion, done > 0, bent,
                               room.memory)
            if ends:
                break
            for row in range(STEP_LOADS):
                for i in range(LOADS):
                    numbers[row, i, 0] = loads[done, row, i]
            one_step(propagator, tables, bristles, bent, room.loads[START], room.loads[MIDDLE],
                     room.loads[END], work)
            copy(following, now)
            done += 1
        _get(now, first, last, slopes)
        _get(room.memory, first, last, memory_slopes)
        for k in range(first, last):
            row = places[k] if k < size else len(motion) + k - size
            for i in range(len(motion)):
                out[row, i] = at_end[i, 1 + k - first]
    for i in range(size):
        state[i] = value_of(now[i])
    for i in range(MEMORY):
        memory[i] = value_of(room.memory[i])
    return done


# By the size of duals.
ENTRIES = {size: EntryPoint(differentiate.function, {
    'tables': Constants(duals=size), 'propagator': Constants(duals=size),
    'bristles': Constants(duals=size), 'places': Array(('state',), whole=True), 'begins': int,
    'state': Array(('state',)), 'memory': Array((MEMORY,)), 'slopes': Array((None, 'state')),
    'memory_slopes': Array((None, MEMORY)), 'load': Array((LOADS,)),
    'loads': Array((None, STEP_LOADS, LOADS)), 'count': int, 'unit': Array((None, LOADS)),
    'inputs': int, 'out': Array((None, 'motion'))},
    f'differentiate_{size}') for size in range(8, 33, 4)}


def entry_for(model: Formulation, entries: dict[int, EntryPoint] = ENTRIES) -> EntryPoint:
    """Return the entry for duals with derivatives by motion and loads of joints."""
    wanted = 1 + len(model.linear) + len(model.axes) + 1 - model.driven
    return entries[min(max(wanted + -wanted % 4, 8), max(entries))]


def step_derivatives(steps: Steps, state: np.ndarray, load: np.ndarray, loads: np.ndarray,
                     unit: np.ndarray, earlier: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the derivatives of the motion after some steps.

    Where the linear part changes between steps, which one is taken is not differentiated.

    Parameters
    ----------
    steps : Steps
    state, load, loads
        As in `Steps.advance`; the state stays, and the memory of the steps.
    unit : ndarray, shape (k, LOADS)
        What one of each input adds to all loads.
    earlier : tuple of ndarray, optional
        What this function returned of earlier steps of another model, which ended in this motion.

    Returns
    -------
    ndarray, shape (2 (3 + N), 2 (3 + N) + k)
        Columns: by the motion before the steps, the earlier ones if given, then by the inputs.
    ndarray, shape (m + k, MEMORY)
        The derivatives of the memory, in rows.

    """
    model, state, memory, done = steps.model, state.copy(), steps.memory.copy(), 0
    slopes, memory_slopes = (np.empty((len(state) + len(unit), len(each)))
                             for each in (state, memory))
    found = np.empty((model.size + len(unit), model.size))

    def advance(begins, following):
        part = steps.part(model.sector(state, load))
        return entry_for(model).of(*part, steps.bristles)(
            model.free_places, begins, state, memory, slopes, memory_slopes, load, following,
            len(following), unit, len(unit), found)
    if earlier is not None:
        advance(True, loads[:0])  # for the derivatives of the state by the motion
        places = model.free_places
        rows = earlier[0].T[[*places, *range(model.size, len(found))]]
        slopes, memory_slopes = rows[:, places] @ slopes[:len(state)], earlier[1]
    while True:
        count = advance(earlier is None and done == 0, loads[done:])
        done += count
        if not count or done == len(loads):
            return found.T, memory_slopes
        load = loads[done - 1, AFTER]
