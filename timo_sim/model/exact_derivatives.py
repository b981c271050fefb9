# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Derivatives of the compiled functions of the `exact` formulation, for states of momenta alone.

They are those of (T22) to (T33) in closed form, see doc/theory.md, (T38) and (T39). Indices are
those of exact_code: i and k count coordinates, the shaft first, and j vectors of nodes; d counts
vectors of changes.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.functions import as_vectors, inner, local, separate, sum_of
from timo_sim.model import functions
from timo_sim.model.exact_code import (
    carrier_speed, copy_factors, half_length, push_work, set_slopes, solve_for_speed, Tables, Work,
    write_rate)
from timo_sim.model.functions import sincos
from timo_sim.model.layout import (
    FORCE_X, PUSH_X, PUSH_Y, TIP_TORQUE, TIP_X, TORQUE)


class Variations(NamedTuple):
    """Derivatives at a state by the coordinates; the first index k is that of q_k."""

    turning: Annotated[np.ndarray, 'padded_nodes']                # phi' and gamma' at the nodes
    shearing: Annotated[np.ndarray, 'padded_nodes']
    image_1: Annotated[np.ndarray, 'padded_nodes']                # K a', K b'
    image_2: Annotated[np.ndarray, 'padded_nodes']
    # Of a' and b' at constant q'.
    rate_1: Annotated[np.ndarray, 'coordinates', 'padded_nodes']
    rate_2: Annotated[np.ndarray, 'coordinates', 'padded_nodes']
    # Of places from the carrier, x and y: the tip, where a force acts on the arm, the mass centre.
    tip: Annotated[np.ndarray, 2, 'coordinates']
    arm: Annotated[np.ndarray, 2, 'coordinates']
    centre: Annotated[np.ndarray, 2, 'coordinates']
    centre_speed: Annotated[np.ndarray, 2, 'coordinates']          # of its speed at constant q'
    momentum: Annotated[np.ndarray, 'coordinates', 'coordinates']  # of p_i at constant q'


class Terms(NamedTuple):
    """Work arrays of the derivatives of forces, and changes of q'."""

    stiffness: Annotated[np.ndarray, 'coordinates', 'coordinates']  # see `_set_stiffness`
    by_rotation: Annotated[np.ndarray, 'padded_nodes']
    by_shear: Annotated[np.ndarray, 'padded_nodes']
    image_1: Annotated[np.ndarray, 'padded_nodes']
    image_2: Annotated[np.ndarray, 'padded_nodes']
    resistance: Annotated[np.ndarray, 3]  # derivatives of friction by speeds of carrier and shaft


class Speeds(NamedTuple):
    """Changes of q', a column for each number by which steps are differentiated."""

    speed: Annotated[np.ndarray, 'coordinates', 'padded_columns']


@separate
def _set_variations(tables, state, load, numbers, work, var):
    """Set slopes, speeds and factors in `work`, and the Variations (T38), (T39)."""
    set_slopes(tables, state, load, work)
    mass, inverse = local((tables.rotary, tables.rotary)), local((tables.rotary,))
    solve_for_speed(tables, state, load, numbers, work, mass, inverse)
    copy_factors(tables, mass, inverse, work)
    rotation, shear = as_vectors(tables.rotation), as_vectors(tables.shear)
    cosine, sine, speed = work.cosine, work.sine, work.speed
    count, nodes = rotation.shape
    for j in range(nodes):
        turning, shearing, g_1, g_2 = 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            turning += speed[i] * rotation[i, j]
            shearing += speed[i] * shear[i, j]
            g_1 += speed[i] * work.image_1[i, j]
            g_2 += speed[i] * work.image_2[i, j]
        var.turning[j], var.shearing[j] = turning, shearing
        var.image_1[j], var.image_2[j] = g_1, g_2
        for k in range(count):
            sheared = rotation[k, j] * shearing
            var.rate_1[k, j] = -work.c2[k, j] * turning - cosine[j] * sheared
            var.rate_2[k, j] = work.c1[k, j] * turning - sine[j] * sheared
    for k in range(count):
        _integrate(tables.to_centre, work.c1, work.c2, k, var.centre)
        _integrate(tables.to_centre, var.rate_1, var.rate_2, k, var.centre_speed)
        _integrate(tables.to_tip, work.c1, work.c2, k, var.tip)
        for n in range(len(tables.push)):
            _integrate(tables.push[n], work.c1, work.c2, k, var.arm)
        for i in range(count):
            total = 0.0
            for j in range(nodes):
                g_1, g_2 = var.image_1[j], var.image_2[j]
                total += (rotation[i, j] * (work.c1[k, j] * g_2 - work.c2[k, j] * g_1)
                          - shear[i, j] * rotation[k, j] * (cosine[j] * g_1 + sine[j] * g_2)
                          + var.rate_1[k, j] * work.image_1[i, j]
                          + var.rate_2[k, j] * work.image_2[i, j])
            var.momentum[k, i] = sum_of(total, tables.rotary) if k else 0.0  # M: not by the shaft


@inner
def _integrate(weights, slopes_1, slopes_2, k, out):
    vectors = as_vectors(weights)
    x, y = 0.0, 0.0
    for j in range(len(vectors)):
        x += vectors[j] * slopes_1[k, j]
        y += vectors[j] * slopes_2[k, j]
    out[0, k], out[1, k] = sum_of(x, weights), sum_of(y, weights)


@inner
def _set_speed_changes(tables, work, var, changes, d, speed):
    """Set changes of q': M times them is the change of p less that by q at constant q' (T39)."""
    count = len(work.speed)
    driven, momenta = count - len(tables.straight), 2 * half_length(tables) - count
    coordinates = len(tables.axes) - driven
    for i in range(driven, count):
        total = changes[momenta + i, d]
        for k in range(driven, count):
            total -= var.momentum[k, i] * changes[coordinates + k, d]
        for k in range(driven, i):
            total -= work.factors[i, k] * speed[k, d]
        speed[i, d] = total
    for i in range(count - 1, driven - 1, -1):
        total = work.factors[i, i] * speed[i, d]
        for k in range(i + 1, count):
            total -= work.factors[k, i] * speed[k, d]
        speed[i, d] = total


@inner
def _set_stiffness(tables, load, forces, work, numbers, var, terms):
    """
    Set the derivatives of the forces on coordinates at constant q' and forces, (1 + N, 1 + N).

    They are d^2 T / dq_k dq_i, and the forces times the second derivatives of the slopes (T39).
    """
    kernel = as_vectors(tables.kernel)
    rotation, shear = as_vectors(tables.rotation), as_vectors(tables.shear)
    to_centre, to_tip = as_vectors(tables.to_centre), as_vectors(tables.to_tip)
    cosine, sine, out = work.cosine, work.sine, terms.stiffness
    by_rotation, by_shear = terms.by_rotation, terms.by_shear
    image_1, image_2 = terms.image_1, terms.image_2
    push_x, push_y, tip_x, tip_y = forces
    count, nodes = rotation.shape
    for k in range(count):
        for j in range(nodes):
            total_1, total_2 = 0.0, 0.0
            for n in range(kernel.shape[1]):  # K is symmetric
                total_1 += numbers.rate_1[k, n] * kernel[0, n, j]
                total_2 += numbers.rate_2[k, n] * kernel[len(kernel) - 1, n, j]
            image_1[j], image_2[j] = total_1, total_2
            # The forces against the slopes, as in `_set_moments`.
            arm_x, arm_y = push_work(tables, load, j)
            force_1 = to_tip[j] * tip_x - to_centre[j] * push_x - arm_x
            force_2 = to_tip[j] * tip_y - to_centre[j] * push_y - arm_y
            twist = 0.0
            if k:  # T does not depend on the shaft angle
                g_1, g_2 = var.image_1[j], var.image_2[j]
                force_1 += var.turning[j] * g_2
                force_2 -= var.turning[j] * g_1
                twist = var.shearing[j] * (sine[j] * g_1 - cosine[j] * g_2)
            by_rotation[j] = (work.c1[k, j] * force_2 - work.c2[k, j] * force_1
                              + rotation[k, j] * twist)
            by_shear[j] = -rotation[k, j] * (cosine[j] * force_1 + sine[j] * force_2)
        for i in range(k, count):
            total = 0.0
            for j in range(nodes):
                total += rotation[i, j] * by_rotation[j] + shear[i, j] * by_shear[j]
                if k:
                    total += (var.rate_1[i, j] * image_1[j] + var.rate_2[i, j] * image_2[j])
            out[i, k] = out[k, i] = sum_of(total, tables.to_centre)


@inner
def _set_resistance(tables, state, work, resistance):
    """Set the derivatives of friction by the speeds of carrier x, y and shaft, (T33)."""
    resistance[0] = resistance[1] = 0.0
    for k in range(len(tables.axes)):
        derivative = work.c1 if tables.axes[k] == 0 else work.c2
        speed = carrier_speed(tables, state, k, derivative, work.speed)
        resistance[tables.axes[k]] = (
            tables.carrier_friction + functions.coulomb_slope(tables, 0, speed))
    resistance[2] = functions.coulomb_slope(tables, 1, work.speed[0])


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
    work, var = as_vectors(numbers), as_vectors(variations)
    _set_variations(tables, point.values, load, numbers, work, var)
    terms, speed = as_vectors(local_arrays(Terms, tables)), as_vectors(
        local_arrays(Speeds, tables)).speed
    forces = write_rate(tables, point.values, load, work, rate.values)
    _set_stiffness(tables, load, forces, work, variations, var, terms)
    resistance = terms.resistance
    _set_resistance(tables, point.values, work, resistance)
    shaft_y, shaft_x = sincos(work.coordinate[0])
    loads, changes, out = as_vectors(inputs.unit), as_vectors(point.changes), as_vectors(
        rate.changes)
    count, half, axes = len(work.speed), half_length(tables), tables.axes
    driven, momenta = count - len(tables.straight), 2 * half - count
    coordinates = momenta - half
    for d in range(loads.shape[1]):
        _set_speed_changes(tables, work, var, changes, d, speed)
        turn = 0.0 * loads[0, d]
        if driven == 0:
            turn = changes[coordinates, d]
        tip_x, tip_y = _force(load, loads, TIP_X, d, turn, shaft_x, shaft_y)
        force_x, force_y = _force(load, loads, FORCE_X, d, turn, shaft_x, shaft_y)
        push_x, push_y = 0.0, 0.0
        for k in range(len(axes)):
            axis = axes[k]
            change = changes[half + k, d] / tables.mass
            for i in range(driven, count):
                change -= (var.centre[axis, i] * speed[i, d]
                           + var.centre_speed[axis, i] * changes[coordinates + i, d])
            if axis == 0:
                push_x = force_x + tip_x + loads[PUSH_X, d] - resistance[0] * change
            else:
                push_y = force_y + tip_y + loads[PUSH_Y, d] - resistance[1] * change
            out[k, d] = 0.0
            out[half + k, d] = push_x if axis == 0 else push_y
        for i in range(driven, count):
            by_speed = speed[i, d]
            for k in range(driven, count):
                by_speed -= tables.straight[i - driven, k - driven] * changes[momenta + k, d]
            total = (var.tip[0, i] * tip_x + var.tip[1, i] * tip_y
                     - var.centre[0, i] * push_x - var.centre[1, i] * push_y
                     + tables.tip_rotation[i] * loads[TIP_TORQUE, d]
                     - tables.damping[i] * by_speed)
            for n in range(len(tables.push)):
                total += (var.arm[0, i] * loads[PUSH_X, d] + var.arm[1, i] * loads[PUSH_Y, d])
            for k in range(driven, count):
                total += (terms.stiffness[i, k] * changes[coordinates + k, d]
                          + var.momentum[i, k] * speed[k, d])
            if i == 0:
                total += loads[TORQUE, d] - resistance[2] * speed[0, d]
            out[coordinates + i, d] = by_speed
            out[momenta + i, d] = total


@functions.state_by_motion.of(Tables)
def _state_by_motion(tables, state, load, out):
    """Write the derivatives of (T25), (T26), (T27)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    work, var = as_vectors(numbers), as_vectors(variations)
    _set_variations(tables, state, load, numbers, work, var)
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
    work, var = as_vectors(numbers), as_vectors(variations)
    _set_variations(tables, state, load, numbers, work, var)
    states, motions = as_vectors(changes), as_vectors(out)
    speed = as_vectors(local_arrays(Speeds, tables)).speed
    count, half = len(work.speed), half_length(tables)
    driven, rates = count - len(tables.straight), 2 + count
    for d in range(states.shape[1]):
        _set_speed_changes(tables, work, var, states, d, speed)
        for i in range(driven, count):
            motions[2 + i, d] = states[len(tables.axes) - driven + i, d]
            motions[rates + 2 + i, d] = speed[i, d]
        for k in range(len(tables.axes)):
            axis = tables.axes[k]
            place, change = states[k, d], states[half + k, d] / tables.mass
            for i in range(driven, count):
                place -= var.centre[axis, i] * motions[2 + i, d]
                change -= (var.centre_speed[axis, i] * motions[2 + i, d]
                           + var.centre[axis, i] * speed[i, d])
            motions[axis, d] = place
            motions[rates + axis, d] = change
