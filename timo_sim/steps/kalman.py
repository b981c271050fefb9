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
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import (
    Array, as_vectors, Constants, inner, square_root, sum_of, with_derivatives)
from timo_sim.model.functions import (
    accelerate, copy, effort, root_forces, root_strain, rotor_turn, sincos, state_of, tip,
    tip_rate)
from timo_sim.model.layout import LOADS

# Axes of the first entries of `topics.outputs.SENSORS`; those before _OF_MOTION need forces.
SENSED, _OF_MOTION = 6, 3
_SIZE = 16  # of duals


class Filter(NamedTuple):
    """The memory of a filter: m states, free coordinates, their rates and disturbances."""

    motion: Annotated[np.ndarray, 'motion']
    gravity: Annotated[np.ndarray, 2]
    places: Annotated[np.ndarray, int, 'state']   # of the free coordinates and rates in a motion
    unit: Annotated[np.ndarray, 'disturbances', LOADS]  # what one of each adds to a load
    deviation: Annotated[np.ndarray, 'disturbances']
    fade: Annotated[np.ndarray, 'disturbances']   # what is left of each after the time of steps
    disturbance: Annotated[np.ndarray, 'disturbances']
    root: Annotated[np.ndarray, 'estimated', 'padded_estimated']  # L
    # Of each number that is measured: its axis or, if SENSED or more, what is expected is given.
    axis: Annotated[np.ndarray, int, 'readings']
    noise: Annotated[np.ndarray, 'readings']
    shown: Annotated[np.ndarray, 'readings']
    expected: Annotated[np.ndarray, 'readings']
    slope: Annotated[np.ndarray, 'readings', 'estimated']
    normalised: Annotated[np.ndarray, 'readings']  # innovations
    joint: Annotated[np.ndarray, 'joint', 'padded_joint']   # room for a factor, and for its L
    lower: Annotated[np.ndarray, 'joint', 'padded_joint']


class _Seen(NamedTuple):
    """Work arrays: a motion, and what belongs to it."""

    motion: Annotated[np.ndarray, 'motion']
    state: Annotated[np.ndarray, 'state']
    load: Annotated[np.ndarray, LOADS]
    accelerations: Annotated[np.ndarray, 'accelerations']
    needed: Annotated[np.ndarray, 3]
    tip: Annotated[np.ndarray, 3]
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


@entry_point(known=Constants(), found=Array((None, 'motion')))
def predict(known, found):
    """
    Go on by steps that were done: `motion` is that after them, without disturbances.

    `found` are the derivatives by the motion before them and by the disturbances, in rows.
    """
    places, joint, root, fade = known.places, known.joint, known.root, known.fade
    states, size = len(root), len(known.motion)
    free = len(places)
    _clear(joint)
    for i in range(free):
        for j in range(free):
            _add_rows(found[places[j], places[i]], root, j, joint, i)
    for d in range(states - free):
        known.disturbance[d] *= fade[d]
        noise = known.deviation[d] * square_root(1.0 - fade[d] * fade[d])
        for i in range(free):
            slope = found[size + d, places[i]]
            known.motion[places[i]] += slope * known.disturbance[d]
            _add_rows(fade[d] * slope, root, free + d, joint, i)
            joint[i, states + d] = noise * slope
        _add_rows(fade[d], root, free + d, joint, free + d)
        joint[free + d, states + d] = noise
    _factorise(joint, states, known.lower)
    _take(known.lower, 0, root)


@inner
def _sense(tables, flow, root, gravity, forces, seen):
    """Write what sensors should show in a motion under a load that acts."""
    motion, axes, half = seen.motion, seen.axes, len(seen.motion) // 2
    tip(tables, motion, seen.tip)
    tip_rate(tables, motion, seen.tip_rate)
    axes[3] = motion[half + 2] + seen.tip_rate[2]
    axes[4] = motion[2]
    axes[5] = rotor_turn(root, motion, 0)
    if forces:
        state_of(tables, motion, seen.state)
        x, y = accelerate(tables, flow, motion, seen.state, seen.load, seen.accelerations)
        sine, cosine = sincos(motion[2] + seen.tip[2])
        x, y = x - gravity[0], y - gravity[1]
        for k in range(2):
            seen.accelerations[k] -= gravity[k]
        effort(tables, motion, seen.accelerations, seen.load, seen.needed)
        force, moment = root_forces(
            tables, root, motion, seen.accelerations, seen.needed, seen.load)
        axes[0] = root_strain(root, motion, force, moment)
        axes[1], axes[2] = cosine * x + sine * y, cosine * y - sine * x


@inner
def _expect(tables, flow, root, known, acting, count):
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
        _sense(tables, flow, root, known.gravity, forces, seen)
        for r in range(count):
            if known.axis[r] < SENSED:
                known.expected[r] = found[known.axis[r], 0]
                for k in range(first, last):
                    known.slope[r, k] = found[known.axis[r], 1 + k - first]


@entry_point(tables=Constants(duals=_SIZE), flow=Constants(duals=_SIZE),
             root=Constants(duals=_SIZE), known=Constants(), acting=Array((LOADS,)), count=int)
def correct(tables, flow, root, known, acting, count):
    """Take the first `count` numbers that are `shown` in the motion, under a load that acts."""
    joint, lower, states = known.joint, known.lower, len(known.root)
    free = len(known.places)
    _expect(tables, flow, root, known, acting, count)
    # A factor of the joint covariance of readings and states (T58).
    _clear(joint)
    for r in range(count):
        for k in range(states):
            _add_rows(known.slope[r, k], known.root, k, joint, r)
        joint[r, states + r] = known.noise[r]
    for i in range(states):
        _add_rows(1.0, known.root, i, joint, count + i)
    _factorise(joint, count + states, lower)
    for r in range(count):
        left = known.shown[r] - known.expected[r]
        for s in range(r):
            left -= lower[r, s] * known.normalised[s]
        known.normalised[r] = left / lower[r, r]
        for i in range(states):
            change = lower[count + i, r] * known.normalised[r]
            if i < free:
                known.motion[known.places[i]] += change
            else:
                known.disturbance[i - free] += change
    _take(lower, count, known.root)
