# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
An extended Kalman filter of the motion of an arm, in factors, see doc/theory.md, section 13.

Covariances are L L^T of lower triangular L. What sensors should show is the text of the equations,
compiled for duals.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.functions import (
    Array, as_vectors, Constants, inner, square_root, sum_of, with_derivatives,
    without_derivatives)
from timo_sim.model.functions import (
    copy, observe, rotor_turn, sense_forces, state_of, tip_rate)
from timo_sim.model.layout import AFTER, LOADS, STEP_LOADS
from timo_sim.steps.bristles import add_friction, MEMORY
from timo_sim.steps.derivatives import differentiate, ENTRIES
from timo_sim.steps.etdrk4 import is_finite

# Axes of the first entries of `topics.outputs.SENSORS`; those before _OF_MOTION need forces.
SENSED, _OF_MOTION = 6, 3
# Over how many numbers the mean of squares is taken, and as what larger squares count.
_MEANT, _LARGEST = 200.0, 100.0


class Filter(NamedTuple):
    """The memory of a filter: m states, free coordinates, their rates and disturbances."""

    motion: Annotated[np.ndarray, 'motion']
    gravity: Annotated[np.ndarray, 2]
    places: Annotated[np.ndarray, int, 'state']   # of the free coordinates and rates in a motion
    unit: Annotated[np.ndarray, 'disturbances', LOADS]  # what one of each adds to a load
    deviation: Annotated[np.ndarray, 'disturbances']
    fade: Annotated[np.ndarray, 'disturbances']   # what is left of each after a step
    disturbance: Annotated[np.ndarray, 'disturbances']
    root: Annotated[np.ndarray, 'estimated', 'padded_estimated']  # L
    noise: Annotated[np.ndarray, SENSED]  # of sensors, by axis
    bias: Annotated[np.ndarray, SENSED]
    axis: Annotated[np.ndarray, int, 'readings']  # of each number that is measured
    shown: Annotated[np.ndarray, 'readings']
    expected: Annotated[np.ndarray, 'readings']
    slope: Annotated[np.ndarray, 'readings', 'estimated']
    normalised: Annotated[np.ndarray, 'readings']  # innovations
    square: Annotated[np.ndarray, 1]  # mean of their squares
    joint: Annotated[np.ndarray, 'joint', 'padded_joint']   # room for a factor, and for its L
    lower: Annotated[np.ndarray, 'joint', 'padded_joint']
    found: Annotated[np.ndarray, 'moved', 'motion']  # derivatives by motion and disturbances


class _Room(NamedTuple):
    """Work arrays: derivatives of `differentiate`, and a load with dry friction."""

    slopes: Annotated[np.ndarray, 'estimated', 'state']
    memory_slopes: Annotated[np.ndarray, 'estimated', MEMORY]
    acting: Annotated[np.ndarray, LOADS]


class _Seen(NamedTuple):
    """Work arrays: a motion, and what belongs to it."""

    motion: Annotated[np.ndarray, 'motion']
    state: Annotated[np.ndarray, 'state']
    load: Annotated[np.ndarray, LOADS]
    accelerations: Annotated[np.ndarray, 'accelerations']
    needed: Annotated[np.ndarray, 3]
    tip_rate: Annotated[np.ndarray, 3]
    axes: Annotated[np.ndarray, SENSED]


@inner
def _add_rows(share, matrix, row, out, goal):
    """Add a share of a row of a matrix to a row of another one, which is at least as long."""
    given, sums = as_vectors(matrix), as_vectors(out)
    for j in range(given.shape[1]):
        sums[goal, j] += share * given[row, j]


@inner
def _clear(matrix):
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@inner
def _factorise(joint, count, lower):
    """Write the lower triangular L with L L^T = A A^T; rows A are lost (Gram and Schmidt)."""
    rows = as_vectors(joint)
    for i in range(count):
        square = 0.0 * rows[i, 0]
        for j in range(rows.shape[1]):
            square += rows[i, j] * rows[i, j]
        norm = square_root(sum_of(square, joint))
        inverse = 1.0 / norm if norm > 0.0 else 0.0
        for j in range(rows.shape[1]):
            rows[i, j] *= inverse
        lower[i, i] = norm
        for k in range(i + 1, count):
            product = 0.0 * rows[i, 0]
            for j in range(rows.shape[1]):
                product += rows[k, j] * rows[i, j]
            lower[k, i] = sum_of(product, joint)
            _add_rows(-lower[k, i], joint, i, joint, k)


@inner
def _take(known, first, root):
    """Take the part of the factor in `lower` from a row and column on."""
    for i in range(len(root)):
        for j in range(i + 1):
            root[i, j] = known[first + i, first + j]


@inner
def _predict(known, steps):
    """Go on by steps that were done: `motion` is that after them, without disturbances."""
    places, joint, root, found = known.places, known.joint, known.root, known.found
    states, size, free = len(root), len(known.motion), len(places)
    _clear(joint)
    for i in range(free):
        for j in range(free):
            _add_rows(found[places[j], places[i]], root, j, joint, i)
    for d in range(states - free):
        fade = 1.0
        for _ in range(steps):
            fade *= known.fade[d]
        known.disturbance[d] *= fade
        noise = known.deviation[d] * square_root(1.0 - fade * fade)
        for i in range(free):
            slope = found[size + d, places[i]]
            known.motion[places[i]] += slope * known.disturbance[d]
            _add_rows(fade * slope, root, free + d, joint, i)
            joint[i, states + d] = noise * slope
        _add_rows(fade, root, free + d, joint, free + d)
        joint[free + d, states + d] = noise
    _factorise(joint, states, known.lower)
    _take(known.lower, 0, root)


@inner
def _sense(tables, beyond, sight, flow, root, gravity, forces, seen):
    """Write what sensors should show in a motion under a load that acts."""
    motion, axes, half = seen.motion, seen.axes, len(seen.motion) // 2
    tip_rate(sight, motion, seen.tip_rate)
    axes[3] = motion[half + 2] + seen.tip_rate[2]
    axes[4] = motion[2]
    axes[5] = rotor_turn(root, motion, 0)
    if forces:
        state_of(tables, motion, seen.state)
        _, axes[0], axes[1], axes[2] = sense_forces(
            tables, beyond, sight, flow, root, gravity, motion, seen.state, seen.load,
            seen.accelerations, seen.needed)


@inner
def _expect(tables, beyond, sight, flow, root, known, acting, count):
    """Set what is expected of the first `count` numbers, and its derivatives by the states."""
    seen, places, forces = local_arrays(_Seen, tables), known.places, False
    by_state, by_load, found = (with_derivatives(seen.motion), with_derivatives(seen.load),
                                with_derivatives(seen.axes))
    free, turns = len(places), by_state.shape[1] - 1
    for r in range(count):
        forces = forces or known.axis[r] < _OF_MOTION
    for first in range(0, len(known.root), turns):
        copy(known.motion, seen.motion)
        for i in range(LOADS):
            total = acting[i]
            for d in range(len(known.unit)):
                total += known.disturbance[d] * known.unit[d, i]
            seen.load[i] = total
        last = min(first + turns, len(known.root))
        for k in range(first, last):
            if k < free:
                by_state[places[k], 1 + k - first] = 1.0
            else:
                for i in range(LOADS):
                    by_load[i, 1 + k - first] = known.unit[k - free, i]
        _sense(tables, beyond, sight, flow, root, known.gravity, forces, seen)
        for r in range(count):
            known.expected[r] = found[known.axis[r], 0] + known.bias[known.axis[r]]
            for k in range(first, last):
                known.slope[r, k] = found[known.axis[r], 1 + k - first]


@inner
def _correct(tables, beyond, sight, flow, root, known, acting, count):
    """Take the first `count` numbers that are `shown` in the motion, under a load that acts."""
    joint, lower, states = known.joint, known.lower, len(known.root)
    free = len(known.places)
    _expect(tables, beyond, sight, flow, root, known, acting, count)
    # A factor of the joint covariance of readings and states (T58).
    _clear(joint)
    for r in range(count):
        for k in range(states):
            _add_rows(known.slope[r, k], known.root, k, joint, r)
        joint[r, states + r] = known.noise[known.axis[r]]
    for i in range(states):
        _add_rows(1.0, known.root, i, joint, count + i)
    _factorise(joint, count + states, lower)
    for r in range(count):
        left = known.shown[r] - known.expected[r]
        for s in range(r):
            left -= lower[r, s] * known.normalised[s]
        known.normalised[r] = left / lower[r, r]
        square = known.normalised[r] * known.normalised[r]
        known.square[0] += (min(square, _LARGEST) - known.square[0]) / _MEANT
        for i in range(states):
            change = lower[count + i, r] * known.normalised[r]
            if i < free:
                known.motion[known.places[i]] += change
            else:
                known.disturbance[i - free] += change
    _take(lower, count, known.root)


def update(tables, propagator, bristles, beyond, sight, flow, root, known, state, memory, load,
           loads, count, readings):
    """
    Go on by `count` steps, then take the first `readings` numbers that are `shown`.

    State, memory and loads are those of `etdrk4.advance`. Return the steps done: fewer if the
    linear part of the tables is not the one for the state after them, and then nothing is taken;
    -1 if the state is not finite.
    """
    plain, room = without_derivatives(tables), local_arrays(_Room, known)
    motion, done = known.motion, 0
    if count > 0:
        done = differentiate(
            tables, propagator, bristles, known.places, 1, state, memory, room.slopes,
            room.memory_slopes, load, loads, count, known.unit, len(known.unit), known.found)
        load = loads[done - 1, AFTER]
    observe(plain, state, load, motion)
    if not is_finite(motion):
        return -1
    if done > 0:
        _predict(known, done)
    if done == count and readings > 0:
        copy(load, room.acting)
        add_friction(memory, room.acting)
        _correct(tables, beyond, sight, flow, root, known, room.acting, readings)
    state_of(plain, motion, state)
    return done if is_finite(motion) else -1


# By the size of duals.
UPDATES = {size: EntryPoint(update, {
    **dict.fromkeys(('tables', 'propagator', 'bristles', 'beyond', 'sight', 'flow', 'root'),
                    Constants(duals=size)),
    'known': Constants(), 'state': Array(('state',), own=True),
    'memory': Array((MEMORY,), own=True), 'load': Array((LOADS,), own=True),
    'loads': Array((None, STEP_LOADS, LOADS), own=True), 'count': int, 'readings': int},
    f'update_{size}') for size in ENTRIES}
