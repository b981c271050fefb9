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
those of exact_code: i and k count coordinates, the shaft first, and j vectors of nodes.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.functions import as_vectors, inner, local, separate, sum_of
from timo_sim.model import functions
from timo_sim.model.exact_code import (
    _carrier_speed, _half, _push_work, _set_slopes, _set_speed, _translate, Tables, Work)
from timo_sim.model.functions import sincos
from timo_sim.model.layout import (
    FORCE_I, FORCE_II, FORCE_X, FORCE_Y, PUSH_X, PUSH_Y, TIP_I, TIP_II, TIP_TORQUE, TIP_X, TIP_Y,
    TORQUE)


class Variations(NamedTuple):
    """Derivatives at a state by the coordinates; the first index k is that of q_k."""

    mass: Annotated[np.ndarray, 'coordinates', 'coordinates']     # M
    inverse: Annotated[np.ndarray, 'coordinates', 'coordinates']  # of the free part of M, else 0
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
    centre_speed: Annotated[np.ndarray, 2, 'coordinates']      # of its speed at constant q'
    momentum: Annotated[np.ndarray, 'coordinates', 'coordinates']  # of p_i at constant q'
    speed: Annotated[np.ndarray, 'coordinates', 'coordinates']     # of q_i' at constant momenta


class Terms(NamedTuple):
    """Work arrays of the derivatives of forces."""

    stiffness: Annotated[np.ndarray, 'coordinates', 'coordinates']  # see `_set_stiffness`
    by_rotation: Annotated[np.ndarray, 'padded_nodes']
    by_shear: Annotated[np.ndarray, 'padded_nodes']
    image_1: Annotated[np.ndarray, 'padded_nodes']
    image_2: Annotated[np.ndarray, 'padded_nodes']
    resistance: Annotated[np.ndarray, 3]  # derivatives of friction by speeds of carrier and shaft
    turned: Annotated[np.ndarray, 4]      # of forces on carrier and tip, x, y, by the shaft angle
    none: Annotated[np.ndarray, 'coordinates']


@separate
def _set_variations(tables, state, load, numbers, work, var):
    """Set slopes and speeds in `work`, and the Variations (T38), (T39)."""
    _set_slopes(tables, state, load, work)
    _set_speed(tables, state, load, numbers, work)
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
    _set_places(tables, work, var)
    _set_mass(tables, work, var)
    for i in range(count):
        var.momentum[0, i] = 0.0  # M does not depend on the shaft angle
    for k in range(1, count):
        for i in range(count):
            total = 0.0
            for j in range(nodes):
                g_1, g_2 = var.image_1[j], var.image_2[j]
                total += (rotation[i, j] * (work.c1[k, j] * g_2 - work.c2[k, j] * g_1)
                          - shear[i, j] * rotation[k, j] * (cosine[j] * g_1 + sine[j] * g_2)
                          + var.rate_1[k, j] * work.image_1[i, j]
                          + var.rate_2[k, j] * work.image_2[i, j])
            var.momentum[k, i] = sum_of(total, tables.rotary)
    for k in range(count):
        for i in range(count):
            total = 0.0
            for n in range(count):
                total -= var.inverse[i, n] * var.momentum[k, n]
            var.speed[k, i] = total


@inner
def _set_places(tables, work, var):
    """Set the derivatives of mass centre, tip and the place of a force on the arm."""
    for k in range(len(work.speed)):
        _integrate(tables.to_centre, work.c1, work.c2, k, var.centre)
        _integrate(tables.to_centre, var.rate_1, var.rate_2, k, var.centre_speed)
        _integrate(tables.to_tip, work.c1, work.c2, k, var.tip)
        for n in range(len(tables.push)):
            _integrate(tables.push[n], work.c1, work.c2, k, var.arm)
        if len(tables.push) == 0:
            var.arm[0, k] = var.arm[1, k] = 0.0


@inner
def _integrate(weights, slopes_1, slopes_2, k, out):
    vectors = as_vectors(weights)
    x, y = 0.0, 0.0
    for j in range(len(vectors)):
        x += vectors[j] * slopes_1[k, j]
        y += vectors[j] * slopes_2[k, j]
    out[0, k], out[1, k] = sum_of(x, weights), sum_of(y, weights)


@inner
def _set_mass(tables, work, var):
    """Set M (T26) and, by elimination without pivots, the inverse of its free part."""
    count = len(work.speed)
    first = count - len(tables.straight)
    inverse = var.inverse
    for i in range(count):
        for k in range(i + 1):
            total = 0.0
            for j in range(work.c1.shape[1]):
                total += (work.image_1[i, j] * work.c1[k, j]
                          + work.image_2[i, j] * work.c2[k, j])
            var.mass[i, k] = tables.rotary[i, k] + sum_of(total, tables.rotary)
            var.mass[k, i] = var.mass[i, k]
            inverse[i, k] = inverse[k, i] = var.mass[i, k] if k >= first else 0.0
    for k in range(first, count):
        pivot = 1.0 / inverse[k, k]
        inverse[k, k] = 1.0
        for n in range(first, count):
            inverse[k, n] *= pivot
        for i in range(first, count):
            if i != k:
                factor = inverse[i, k]
                inverse[i, k] = 0.0
                for n in range(first, count):
                    inverse[i, n] -= factor * inverse[k, n]


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
            arm_x, arm_y = _push_work(tables, load, j)
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
def _write_by(tables, var, resistance, change, push_x, push_y, out):
    """
    Write the derivative of a rate by what changes q' by `change` and the force on the carrier.

    The force, x and y, is that at constant q'; `out` has what is to be added to the rates of the
    coordinates.
    """
    count, half = len(var.mass), _half(tables)
    driven = count - len(tables.straight)
    momenta = 2 * half - count
    for i in range(count):
        push_x += resistance[0] * var.centre[0, i] * change[i]
        push_y += resistance[1] * var.centre[1, i] * change[i]
    for k in range(len(tables.axes)):
        out[half + k] = push_x if tables.axes[k] == 0 else push_y
    for i in range(driven, count):
        out[momenta - half + i] += change[i]
        total = (-var.centre[0, i] * push_x - var.centre[1, i] * push_y
                 - tables.damping[i] * out[momenta - half + i])
        for n in range(count):
            total += var.momentum[i, n] * change[n]
        if i == 0:
            total -= resistance[2] * change[0]
        out[momenta + i] = total


@functions.jacobian.of(Tables)
def _jacobian(tables, state, load, inputs, by_state, by_input):
    """Write the derivatives of the rate less its linear part (T39)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    work, var = as_vectors(numbers), as_vectors(variations)
    _set_variations(tables, state, load, numbers, work, var)
    count, size, half = len(tables.rotation), 2 * _half(tables), _half(tables)
    driven, momenta = count - len(tables.straight), size - count
    terms = as_vectors(local_arrays(Terms, tables))
    resistance, turned, none = terms.resistance, terms.turned, terms.none
    forces = _translate(tables, state, load, work, local((state,)))
    _set_resistance(tables, state, work, resistance)
    _set_stiffness(tables, load, forces, work, variations, var, terms)
    shaft_y, shaft_x = sincos(work.coordinate[0])
    for i in range(count):
        none[i] = 0.0
    zeros = as_vectors(by_state)
    for k in range(len(zeros)):
        for i in range(zeros.shape[1]):
            zeros[k, i] = 0.0

    for k in range(driven, count):  # by q_k
        push_x = resistance[0] * var.centre_speed[0, k]
        push_y = resistance[1] * var.centre_speed[1, k]
        if k == 0:
            _turn(tables, load, shaft_x, shaft_y, turned)
            push_x += turned[0]
            push_y += turned[1]
        out = by_state[momenta - half + k]
        _write_by(tables, var, resistance, var.speed[k], push_x, push_y, out)
        for i in range(driven, count):
            out[momenta + i] += terms.stiffness[i, k]
            if k == 0:
                out[momenta + i] += var.tip[0, i] * turned[2] + var.tip[1, i] * turned[3]
    for k in range(driven, count):  # by p_k
        out = by_state[momenta + k]
        for i in range(driven, count):
            out[momenta - half + i] = -tables.straight[i - driven, k - driven]
        _write_by(tables, var, resistance, var.inverse[k], 0.0, 0.0, out)
    for k in range(len(tables.axes)):  # by P
        push = -resistance[tables.axes[k]] / tables.mass
        push_x, push_y = (push, 0.0) if tables.axes[k] == 0 else (0.0, push)
        _write_by(tables, var, resistance, none, push_x, push_y, by_state[half + k])
    _write_by_inputs(tables, var, inputs, resistance, none, shaft_x, shaft_y, by_input)


@inner
def _set_resistance(tables, state, work, resistance):
    """Set the derivatives of friction by the speeds of carrier x, y and shaft, (T33)."""
    resistance[0] = resistance[1] = 0.0
    for k in range(len(tables.axes)):
        derivative = work.c1 if tables.axes[k] == 0 else work.c2
        speed = _carrier_speed(tables, state, k, derivative, work.speed)
        resistance[tables.axes[k]] = (
            tables.carrier_friction + functions.coulomb_slope(tables, 0, speed))
    resistance[2] = functions.coulomb_slope(tables, 1, work.speed[0])


@inner
def _turn(tables, load, cosine, sine, out):
    """Write the derivatives of the forces on carrier and tip, x, y each, by the shaft angle."""
    out[0] = out[1] = 0.0
    out[2] = -sine * load[TIP_I] - cosine * load[TIP_II]
    out[3] = cosine * load[TIP_I] - sine * load[TIP_II]
    for k in range(len(tables.axes)):
        if tables.axes[k] == 0:
            out[0] = out[2] - sine * load[FORCE_I] - cosine * load[FORCE_II]
        else:
            out[1] = out[3] + cosine * load[FORCE_I] - sine * load[FORCE_II]


@inner
def _write_by_inputs(tables, var, inputs, resistance, none, shaft_x, shaft_y, by_input):
    """Write the derivatives by loads: those that a unit of each load adds (T28), (T32)."""
    rows, half = tables.rotation, _half(tables)
    count = len(rows)
    driven, momenta = count - len(tables.straight), 2 * half - count
    for k in range(len(inputs.unit)):
        unit, out = inputs.unit[k], by_input[k]
        for i in range(len(out)):
            out[i] = 0.0
        tip_x = unit[TIP_X] + shaft_x * unit[TIP_I] - shaft_y * unit[TIP_II]
        tip_y = unit[TIP_Y] + shaft_y * unit[TIP_I] + shaft_x * unit[TIP_II]
        push_x, push_y = 0.0, 0.0
        for n in range(len(tables.axes)):
            if tables.axes[n] == 0:
                push_x = (tip_x + unit[PUSH_X] + unit[FORCE_X] + shaft_x * unit[FORCE_I]
                          - shaft_y * unit[FORCE_II])
            else:
                push_y = (tip_y + unit[PUSH_Y] + unit[FORCE_Y] + shaft_y * unit[FORCE_I]
                          + shaft_x * unit[FORCE_II])
        _write_by(tables, var, resistance, none, push_x, push_y, out)
        for i in range(driven, count):
            out[momenta + i] += (
                var.tip[0, i] * tip_x + var.tip[1, i] * tip_y
                + var.arm[0, i] * unit[PUSH_X] + var.arm[1, i] * unit[PUSH_Y]
                + tables.tip_rotation[i] * unit[TIP_TORQUE])
        if driven == 0:
            out[momenta] += unit[TORQUE]


@functions.state_by_motion.of(Tables)
def _state_by_motion(tables, state, load, out):
    """Write the derivatives of (T25), (T26), (T27)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    work, var = as_vectors(numbers), as_vectors(variations)
    _set_variations(tables, state, load, numbers, work, var)
    count, size, half = len(tables.rotation), 2 * _half(tables), _half(tables)
    rates = 2 + count
    driven, momenta = count - len(tables.straight), size - count
    zeros = as_vectors(out)
    for k in range(len(zeros)):
        for i in range(zeros.shape[1]):
            zeros[k, i] = 0.0
    for k in range(len(tables.axes)):
        axis = tables.axes[k]
        out[axis, k] = 1.0
        out[rates + axis, half + k] = tables.mass
        for i in range(driven, count):
            out[2 + i, k] = var.centre[axis, i]
            out[2 + i, half + k] = tables.mass * var.centre_speed[axis, i]
            out[rates + 2 + i, half + k] = tables.mass * var.centre[axis, i]
    for i in range(driven, count):
        out[2 + i, momenta - half + i] = 1.0
        for n in range(driven, count):
            out[2 + i, momenta + n] = var.momentum[i, n]
            out[rates + 2 + i, momenta + n] = var.mass[i, n]


@functions.motion_by_state.of(Tables)
def _motion_by_state(tables, state, load, changes, out):
    """Write the changes of (T25) and (T33)."""
    numbers, variations = local_arrays(Work, tables), local_arrays(Variations, tables)
    work, var = as_vectors(numbers), as_vectors(variations)
    _set_variations(tables, state, load, numbers, work, var)
    count, size, half = len(tables.rotation), 2 * _half(tables), _half(tables)
    rates = 2 + count
    driven, momenta = count - len(tables.straight), size - count
    for d in range(len(changes)):
        change, motion = changes[d], out[d]
        for i in range(len(motion)):
            motion[i] = 0.0
        for i in range(driven, count):
            total = 0.0
            for k in range(driven, count):
                total += (var.speed[k, i] * change[momenta - half + k]
                          + var.inverse[i, k] * change[momenta + k])
            motion[2 + i] = change[momenta - half + i]
            motion[rates + 2 + i] = total
        for k in range(len(tables.axes)):
            axis = tables.axes[k]
            place, speed = change[k], change[half + k] / tables.mass
            for i in range(driven, count):
                place -= var.centre[axis, i] * motion[2 + i]
                speed -= (var.centre_speed[axis, i] * motion[2 + i]
                          + var.centre[axis, i] * motion[rates + 2 + i])
            motion[axis] = place
            motion[rates + axis] = speed
