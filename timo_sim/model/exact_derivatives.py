# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Derivatives of the compiled functions of the `exact` formulation, for states of momenta alone.

They are those of (T22) to (T33) in closed form, see doc/theory.md, (T38) and (T39). Indices are
those of exact_code: i and k count coordinates, the shaft first, and j vectors of nodes; d counts
vectors of columns, the numbers by which steps are differentiated.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.functions import as_vectors, inner, local, separate, some, sum_of
from timo_sim.model import functions
from timo_sim.model.exact_code import (
    carrier_speed, copy_factors, half_length, push_work, set_slopes, solve_for_speed, Tables, Work,
    write_rate)
from timo_sim.model.functions import add_multiple, copy, sincos
from timo_sim.model.layout import FORCE_X, PUSH_X, PUSH_Y, TIP_TORQUE, TIP_X, TORQUE


class Variations(NamedTuple):
    """Derivatives at a state by the coordinates; the first index k is that of q_k."""

    # Of a' and b' at constant q'.
    rate_1: Annotated[np.ndarray, 'coordinates', 'padded_nodes']
    rate_2: Annotated[np.ndarray, 'coordinates', 'padded_nodes']
    # Of places from the carrier, x and y: the tip, where a force acts on the arm, the mass centre.
    tip: Annotated[np.ndarray, 2, 'coordinates']
    arm: Annotated[np.ndarray, 2, 'coordinates']
    centre: Annotated[np.ndarray, 2, 'coordinates']
    # Of its speed, of momenta p_i and of their rates, all at constant q' and force on the carrier.
    centre_speed: Annotated[np.ndarray, 2, 'coordinates']
    momentum: Annotated[np.ndarray, 'coordinates', 'coordinates']
    rate: Annotated[np.ndarray, 'coordinates', 'coordinates']


class Changes(NamedTuple):
    """Work arrays: changes at a state, in columns."""

    speed: Annotated[np.ndarray, 'coordinates', 'padded_columns']  # of q'
    tip_x: Annotated[np.ndarray, 'padded_columns']   # of the forces on tip and carrier
    tip_y: Annotated[np.ndarray, 'padded_columns']
    push_x: Annotated[np.ndarray, 'padded_columns']
    push_y: Annotated[np.ndarray, 'padded_columns']
    by_speed: Annotated[np.ndarray, 'padded_columns']  # of the rate of q_i
    total: Annotated[np.ndarray, 'padded_columns']     # of the rate of p_i; a sum on its way


class AtNodes(NamedTuple):
    """Work arrays at the nodes."""

    turning: Annotated[np.ndarray, 'padded_nodes']     # phi' and gamma'
    shearing: Annotated[np.ndarray, 'padded_nodes']
    g_1: Annotated[np.ndarray, 'padded_nodes']         # K a', K b'
    g_2: Annotated[np.ndarray, 'padded_nodes']
    image_1: Annotated[np.ndarray, 'padded_nodes']     # K times the derivatives of a', b' by q_k
    image_2: Annotated[np.ndarray, 'padded_nodes']
    # Factors of Phi_i and Gamma_i in derivatives by q_k of momenta, 0, and of their rates, 1.
    rotation: Annotated[np.ndarray, 2, 'padded_nodes']
    shear: Annotated[np.ndarray, 2, 'padded_nodes']


@separate
def _set_variations(tables, state, load, numbers, variations, rate):
    """Set slopes, speeds and factors in `numbers`, the Variations (T38), (T39), and the rate."""
    work, var = as_vectors(numbers), as_vectors(variations)
    set_slopes(tables, state, load, work)
    mass, inverse = local((tables.rotary, tables.rotary)), local((tables.rotary,))
    solve_for_speed(tables, state, load, numbers, work, mass, inverse)
    copy_factors(tables, mass, inverse, work)
    push_x, push_y, tip_x, tip_y = write_rate(tables, state, load, work, rate)
    kernel, at = as_vectors(tables.kernel), as_vectors(local_arrays(AtNodes, tables))
    rotation, shear = as_vectors(tables.rotation), as_vectors(tables.shear)
    to_centre, to_tip = as_vectors(tables.to_centre), as_vectors(tables.to_tip)
    cosine, sine, c1, c2 = work.cosine, work.sine, work.c1, work.c2
    count, nodes = rotation.shape
    for j in range(nodes):
        turning, shearing, g_1, g_2 = 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            turning += work.speed[i] * rotation[i, j]
            shearing += work.speed[i] * shear[i, j]
            g_1 += work.speed[i] * work.image_1[i, j]
            g_2 += work.speed[i] * work.image_2[i, j]
        at.turning[j], at.shearing[j], at.g_1[j], at.g_2[j] = turning, shearing, g_1, g_2
        for k in range(count):
            sheared = rotation[k, j] * shearing
            var.rate_1[k, j] = -c2[k, j] * turning - cosine[j] * sheared
            var.rate_2[k, j] = c1[k, j] * turning - sine[j] * sheared
    for k in range(count):
        _integrate(tables.to_centre, c1, c2, k, var.centre)
        _integrate(tables.to_centre, var.rate_1, var.rate_2, k, var.centre_speed)
        _integrate(tables.to_tip, c1, c2, k, var.tip)
        for n in range(len(tables.push)):
            _integrate(tables.push[n], c1, c2, k, var.arm)
        for j in range(nodes):
            at.image_1[j], at.image_2[j] = 0.0, 0.0
            for n in range(kernel.shape[1]):  # K is symmetric
                at.image_1[j] += variations.rate_1[k, n] * kernel[0, n, j]
                at.image_2[j] += variations.rate_2[k, n] * kernel[len(kernel) - 1, n, j]
            g_1, g_2 = at.g_1[j], at.g_2[j]
            at.rotation[0, j] = c1[k, j] * g_2 - c2[k, j] * g_1
            at.shear[0, j] = -rotation[k, j] * (cosine[j] * g_1 + sine[j] * g_2)
            # The forces against the slopes, as in `_set_moments`, and those of the turning.
            arm_x, arm_y = push_work(tables, load, j)
            x = to_tip[j] * tip_x - to_centre[j] * push_x - arm_x + at.turning[j] * g_2
            y = to_tip[j] * tip_y - to_centre[j] * push_y - arm_y - at.turning[j] * g_1
            at.rotation[1, j] = (
                c1[k, j] * y - c2[k, j] * x
                + rotation[k, j] * at.shearing[j] * (sine[j] * g_1 - cosine[j] * g_2))
            at.shear[1, j] = -rotation[k, j] * (cosine[j] * x + sine[j] * y)
        for i in range(count):
            momentum, force = 0.0, 0.0
            for j in range(nodes):
                momentum += (rotation[i, j] * at.rotation[0, j] + shear[i, j] * at.shear[0, j]
                             + var.rate_1[k, j] * work.image_1[i, j]
                             + var.rate_2[k, j] * work.image_2[i, j])
                if i >= k:
                    force += (rotation[i, j] * at.rotation[1, j] + shear[i, j] * at.shear[1, j]
                              + var.rate_1[i, j] * at.image_1[j]
                              + var.rate_2[i, j] * at.image_2[j])
            var.momentum[k, i] = sum_of(momentum, tables.rotary)
            if i >= k:
                var.rate[i, k] = var.rate[k, i] = sum_of(force, tables.rotary)


@inner
def _integrate(weights, slopes_1, slopes_2, k, out):
    vectors = as_vectors(weights)
    x, y = 0.0, 0.0
    for j in range(len(vectors)):
        x += vectors[j] * slopes_1[k, j]
        y += vectors[j] * slopes_2[k, j]
    out[0, k], out[1, k] = sum_of(x, weights), sum_of(y, weights)


@inner
def _set_speed_changes(tables, work, var, changes, made):
    """
    Set changes of q', by M = L D L^T: M times them is the change of p less dM q' (T39).

    `dM q'` is what changes of q change of the momenta at constant q'.
    """
    count, speed, total = len(work.speed), made.speed, made.total
    driven, momenta = count - len(tables.straight), 2 * half_length(tables) - count
    coordinates = len(tables.axes) - driven
    for i in range(driven, count):
        copy(changes[momenta + i], total)
        for k in range(driven, count):
            add_multiple(-var.momentum[k, i], changes[coordinates + k], total)
        for k in range(driven, i):
            add_multiple(-work.factors[i, k], speed[k], total)
        copy(total, speed[i])
    for i in range(count - 1, driven - 1, -1):
        for d in range(len(total)):
            total[d] = work.factors[i, i] * speed[i, d]
        for k in range(i + 1, count):
            add_multiple(-work.factors[k, i], speed[k], total)
        copy(total, speed[i])


@inner
def _carrier_change(tables, var, k, changes, speed, d):
    """Return changes of the carrier's speed along its k-th free axis."""
    axis, driven = tables.axes[k], len(tables.rotation) - len(tables.straight)
    change = changes[half_length(tables) + k, d] / tables.mass
    for i in range(driven, len(tables.rotation)):
        change -= (var.centre[axis, i] * speed[i, d]
                   + var.centre_speed[axis, i] * changes[len(tables.axes) - driven + i, d])
    return change


@inner
def _resistance_slope(tables, state, k, work):
    """Return the derivative of friction by the carrier's speed along its k-th free axis, (T33)."""
    speed = carrier_speed(
        tables, state, k, work.c1 if tables.axes[k] == 0 else work.c2, work.speed)
    return tables.carrier_friction + functions.coulomb_slope(tables, 0, speed)


@inner
def _force(load, loads, first, d, turn, cosine, sine):
    """Return the change, x and y, of the force in four columns of a load: x, y, I and II."""
    along = loads[first + 2, d] - load[first + 3] * turn
    across = loads[first + 3, d] + load[first + 2] * turn
    return (loads[first, d] + cosine * along - sine * across,
            loads[first + 1, d] + sine * along + cosine * across)


@functions.differential.of(Tables)
def _differential(tables, inputs, point, load, rate):
    """Write the rate less its linear part, and its changes (T39)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    _set_variations(tables, point.values, load, numbers, variations, rate.values)
    work, var = as_vectors(numbers), as_vectors(variations)
    loads, changes, out = (
        as_vectors(inputs.unit), as_vectors(point.changes), as_vectors(rate.changes))
    made = as_vectors(local_arrays(Changes, tables))
    speed, by_speed, total = made.speed, made.by_speed, made.total
    tip_x, tip_y, push_x, push_y = made.tip_x, made.tip_y, made.push_x, made.push_y
    count, half = len(work.speed), half_length(tables)
    driven, momenta = count - len(tables.straight), 2 * half - count
    coordinates = momenta - half
    _set_speed_changes(tables, work, var, changes, made)

    # Forces on tip and carrier; those along the arm turn with the shaft.
    shaft_y, shaft_x = sincos(work.coordinate[0])
    for d in range(len(total)):
        turn = changes[coordinates, d] if driven == 0 else 0.0
        tip_x[d], tip_y[d] = _force(load, loads, TIP_X, d, turn, shaft_x, shaft_y)
        force_x, force_y = _force(load, loads, FORCE_X, d, turn, shaft_x, shaft_y)
        push_x[d], push_y[d] = 0.0, 0.0
        for k in range(len(tables.axes)):
            if tables.axes[k] == 0:
                push_x[d] = force_x + tip_x[d] + loads[PUSH_X, d]
            else:
                push_y[d] = force_y + tip_y[d] + loads[PUSH_Y, d]
    if some((tables.carrier_friction != 0.0) | (tables.coulomb[0, 0] != 0.0)):
        for k in range(len(tables.axes)):
            push = push_x if tables.axes[k] == 0 else push_y
            slope = _resistance_slope(tables, point.values, k, work)
            for d in range(len(total)):
                push[d] -= slope * _carrier_change(tables, var, k, changes, speed, d)

    for k in range(len(tables.axes)):
        for d in range(len(total)):
            out[k, d] = 0.0  # as in `rate`, X' = P / m_t is in the linear part
        copy(push_x if tables.axes[k] == 0 else push_y, out[half + k])
    slope = functions.coulomb_slope(tables, 1, work.speed[0])
    limited = functions.is_limited(tables, load, work.speed[0])
    for i in range(driven, count):
        copy(speed[i], by_speed)
        for k in range(driven, count):
            add_multiple(-tables.straight[i - driven, k - driven], changes[momenta + k], by_speed)
        for d in range(len(total)):
            total[d] = (var.tip[0, i] * tip_x[d] + var.tip[1, i] * tip_y[d]
                        - var.centre[0, i] * push_x[d] - var.centre[1, i] * push_y[d]
                        + tables.tip_rotation[i] * loads[TIP_TORQUE, d]
                        - tables.damping[i] * by_speed[d])
            if i == 0:
                total[d] += loads[TORQUE, d] - slope * speed[0, d]
                for n in range(len(tables.motor_limit)):
                    total[d] -= limited * (
                        loads[TORQUE, d] - tables.motor_limit[n, 1] * speed[0, d])
        for n in range(len(tables.push)):
            add_multiple(var.arm[0, i], loads[PUSH_X], total)
            add_multiple(var.arm[1, i], loads[PUSH_Y], total)
        for k in range(driven, count):
            add_multiple(var.rate[i, k], changes[coordinates + k], total)
            add_multiple(var.momentum[i, k], speed[k], total)
        copy(by_speed, out[coordinates + i])
        copy(total, out[momenta + i])


@functions.state_by_motion.of(Tables)
def _state_by_motion(tables, state, load, out):
    """Write the derivatives of (T25), (T26), (T27)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    _set_variations(tables, state, load, numbers, variations, local((state,)))
    work, var = as_vectors(numbers), as_vectors(variations)
    count, half = len(work.speed), half_length(tables)
    driven, momenta, rates = count - len(tables.straight), 2 * half - count, 2 + count
    # Columns are the numbers of a motion from the shaft angle on.
    for k in range(len(tables.axes)):
        axis = tables.axes[k]
        out[half + k, count + axis] = tables.mass
        for i in range(driven, count):
            out[k, i] = var.centre[axis, i]
            out[half + k, i] = tables.mass * var.centre_speed[axis, i]
            out[half + k, rates + i] = tables.mass * var.centre[axis, i]
    for i in range(driven, count):
        out[momenta - half + i, i] = 1.0
        for k in range(driven, count):
            mass = 0.0
            for j in range(work.c1.shape[1]):
                mass += (work.image_1[i, j] * work.c1[k, j] + work.image_2[i, j] * work.c2[k, j])
            out[momenta + i, k] = var.momentum[k, i]
            out[momenta + i, rates + k] = tables.rotary[i, k] + sum_of(mass, tables.rotary)


@functions.motion_by_state.of(Tables)
def _motion_by_state(tables, state, load, changes, out):
    """Write the changes of (T25) and (T33)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    _set_variations(tables, state, load, numbers, variations, local((state,)))
    work, var = as_vectors(numbers), as_vectors(variations)
    states, motions = as_vectors(changes), as_vectors(out)
    made, count = as_vectors(local_arrays(Changes, tables)), len(work.speed)
    driven, rates = count - len(tables.straight), 2 + count
    _set_speed_changes(tables, work, var, states, made)
    for i in range(driven, count):
        copy(states[len(tables.axes) - driven + i], motions[2 + i])
        copy(made.speed[i], motions[rates + 2 + i])
    for k in range(len(tables.axes)):
        place, speed = motions[tables.axes[k]], motions[rates + tables.axes[k]]
        copy(states[k], place)
        for i in range(driven, count):
            add_multiple(-var.centre[tables.axes[k], i], motions[2 + i], place)
        for d in range(len(speed)):
            speed[d] = _carrier_change(tables, var, k, states, made.speed, d)
