# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled functions of the `exact` formulation, in the order of doc/theory.md, section 6.

Slopes (T22)-(T24), mass matrix and speeds (T26), (T31), translation (T25), (T27), (T33), forces on
the coordinates (T28), (T29), (T32), the rate, motion and tip; then what an arm that stretches adds
(T34), coordinates that have rates in place of momenta (T35), and sectors (section 7). An index i
counts coordinates, the shaft first; j counts vectors of quadrature nodes, or single nodes in code
for lanes, and k single nodes. `driven` is 1 if the shaft is driven or locked, else 0, and thus the
number of the first coordinate that is free.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.functions import (
    as_vectors, chain, declare, floor, inner, local, some, strict, sum_of, value_of, where,
    with_derivatives, without_derivatives)
from timo_sim.model import functions
from timo_sim.model.functions import DRAG, PER_COORDINATE, sincos
from timo_sim.model.layout import (
    ACCELERATION, ACCELERATION_X, ACCELERATION_Y, ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y,
    PUSH_X, PUSH_Y, SHAFT_FRICTION, SPEED, TIP_I, TIP_II, TIP_TORQUE, TIP_X, TIP_Y)


class Tables(NamedTuple):
    """
    Constants of the compiled functions.

    Sizes: 1 + N `coordinates`, of which n are `free`, the last A `axial`, and the last R have
    `rates` in place of momenta in the state (T35); n_g `nodes`, of which the last are those of an
    end effector beyond the tip and of a hub (T50). `gears` is 1 if the gear is elastic, else 0;
    its coordinate precedes the axial ones. `kernels` is 2, or 1 if that for x holds for y, too;
    `axes` counts those along which the carrier is free, `pushes` is 1 if a force may act on the
    arm, else 0, `springs` if one holds the shaft, and `limits` if the motor's current has a limit;
    `banded` is the length of the state for an arm that stretches with one axis of the carrier
    held, else 0.
    """

    mass: float  # m_t
    # K for x and for y
    kernel: Annotated[np.ndarray, 'kernels', 'nodes', 'padded_nodes']
    to_centre: Annotated[np.ndarray, 'padded_nodes']  # d / m_t, from slopes to the mass centre
    rotation: Annotated[np.ndarray, 'coordinates', 'padded_nodes']   # Phi_i at the nodes
    shear: Annotated[np.ndarray, 'coordinates', 'padded_nodes']      # Gamma_i at the nodes
    # Xi_ij = int J Phi_i Phi_j, with the shaft's J_m
    rotary: Annotated[np.ndarray, 'coordinates', 'coordinates']
    straight: Annotated[np.ndarray, 'free', 'free']     # M^-1 of the straight arm
    damping: Annotated[np.ndarray, 'coordinates']       # c_s, then 2 zeta_i omega_i
    carrier_friction: float                             # c_c
    coulomb: Annotated[np.ndarray, 3, 3]                # `Manipulator.coulomb`
    motor_limit: Annotated[np.ndarray, 'limits', 2]     # `Manipulator.motor_limit`
    axes: Annotated[np.ndarray, int, 'axes']            # axes along which the carrier is free
    held_position: Annotated[np.ndarray, 2]             # of a carrier that is held
    to_tip: Annotated[np.ndarray, 'padded_nodes']       # D_l, from slopes to the tip
    tip_rotation: Annotated[np.ndarray, 'coordinates']  # Phi_i at the tip
    weight: Annotated[np.ndarray, 2]                    # m_t g along world x and y
    push: Annotated[np.ndarray, 'pushes', 'padded_nodes']    # from slopes to where a force acts
    stretch: Annotated[np.ndarray, 'axial', 'padded_nodes']  # E_i of the axial coordinates
    stiffness: Annotated[np.ndarray, 'coordinates']     # of a spring on the shaft, then omega_i^2
    spring: Annotated[np.ndarray, 'springs', 2]         # `Manipulator.spring`
    # Linear part of the last accelerations per q_i and per q_i'.
    linear_rate: Annotated[np.ndarray, 'rates', 2, 'rates']
    # Number of the sector for which the linear part is, plus SECTORS times that of the band of the
    # speed; -1: any.
    sector: int
    bands_per_speed: float  # bands per p_0, or per q_0' of a driven shaft
    # What the linear part has for the speed of the band.
    of_band: Annotated[np.ndarray, 'banded', 'banded']
    # Of an elastic gear: turn of the rotor per coordinate, 1 / sqrt(J_r), viscous friction of the
    # rotor c_r, half of the play as a coordinate (T60).
    gear: Annotated[np.ndarray, 'gears', 3]


@inner
def half_length(tables):
    """Return the half of the length of a state."""
    return len(tables.axes) + len(tables.straight)


class Work(NamedTuple):
    """Work arrays of a rate; functions get them as vectors, see `as_vectors`."""

    coordinate: Annotated[np.ndarray, 'coordinates']            # q
    speed: Annotated[np.ndarray, 'coordinates']                 # q'
    # L and 1/D of the mass matrix, where they are needed.
    factors: Annotated[np.ndarray, 'coordinates', 'coordinates']
    cosine: Annotated[np.ndarray, 'padded_nodes']               # of phi
    sine: Annotated[np.ndarray, 'padded_nodes']
    a: Annotated[np.ndarray, 'padded_nodes']                    # slopes of the centre line (T23)
    b: Annotated[np.ndarray, 'padded_nodes']
    c1: Annotated[np.ndarray, 'coordinates', 'padded_nodes']    # C1, C2 (T24)
    c2: Annotated[np.ndarray, 'coordinates', 'padded_nodes']
    image_1: Annotated[np.ndarray, 'coordinates', 'padded_nodes']  # K C1, K C2 (T26)
    image_2: Annotated[np.ndarray, 'coordinates', 'padded_nodes']
    g1: Annotated[np.ndarray, 'padded_nodes']  # K a', K b' beside duals
    g2: Annotated[np.ndarray, 'padded_nodes']


# Slopes of the centre line and their derivatives, (T22) to (T24).

@inner
def _set_slopes_of_state(tables, state, load, work):
    """Set q and what `_set_slopes` sets."""
    count = len(tables.rotation)
    driven = count - len(tables.straight)
    work.coordinate[0] = load[ANGLE]
    for i in range(driven, count):
        work.coordinate[i] = state[len(tables.axes) + i - driven]
    _set_slopes(tables, work)


@inner
def _set_slopes(tables, work):
    """Set cosine and sine of phi, a, b (T23), C1 and C2 (T24)."""
    a, b, c1, c2, cosine, sine = work.a, work.b, work.c1, work.c2, work.cosine, work.sine
    coordinate = work.coordinate
    rotation, shear = as_vectors(tables.rotation), as_vectors(tables.shear)
    count, nodes = rotation.shape
    for j in range(nodes):
        phi = 0.0
        gamma = 0.0
        for i in range(count):
            phi += coordinate[i] * rotation[i, j]
            gamma += coordinate[i] * shear[i, j]
        sine[j], cosine[j] = sincos(phi)
        a[j] = cosine[j] - gamma * sine[j]
        b[j] = sine[j] + gamma * cosine[j]
    for i in range(count):
        for j in range(nodes):
            c1[i, j] = -b[j] * rotation[i, j] - sine[j] * shear[i, j]
            c2[i, j] = a[j] * rotation[i, j] + cosine[j] * shear[i, j]
    _add_stretch_to_slopes(tables, work)


# Mass matrix and speeds, (T26) and (T31).

@declare
def _set_speed(tables, state, load, numbers, work):
    """Do what `_solve_for_speed` does."""


@_set_speed.of(Tables)
def _set_speed_of_floats(tables, state, load, numbers, work):
    """Do so; L and D stay in registers."""
    mass, inverse = local((tables.rotary, tables.rotary)), local((tables.rotary,))
    _solve_for_speed(tables, state, load, numbers, work, mass, inverse)


@_set_speed.of(Tables, duals=True)
def _set_speed_of_duals(tables, state, load, numbers, work):
    """
    Set q' and (g1, g2) = K (a', b'), with M factorised once, as floats (T39).

    By each direction d it is M q'_d = p_d - M_d q', where M q' = Xi q' + C1 g1 + C2 g2.
    """
    if len(tables.linear_rate):
        mass, inverse = local((tables.rotary, tables.rotary)), local((tables.rotary,))
        _solve_for_speed(tables, state, load, numbers, work, mass, inverse)
        for j in range(len(work.g1)):
            work.g1[j], work.g2[j] = _momenta_of_images(tables, work, j)
        return
    floats = without_derivatives(tables)
    alone, mass, inverse = (local_arrays(Work, floats), local((floats.rotary, floats.rotary)),
                            local((floats.rotary,)))
    c1, c2, g1, g2, speed = work.c1, work.c2, work.g1, work.g2, work.speed
    count, nodes = c1.shape
    driven, momenta = count - len(tables.straight), 2 * half_length(tables) - count
    # The numbers alone, with q' and the images K C.
    vectors = as_vectors(alone)
    for i in range(count):
        for j in range(vectors.c1.shape[1]):
            vectors.c1[i, j], vectors.c2[i, j] = 0.0, 0.0
        for j in range(nodes):
            alone.c1[i, j], alone.c2[i, j] = value_of(c1[i, j]), value_of(c2[i, j])
    values, loads = local((with_derivatives(state),)), local((with_derivatives(load),))
    for i in range(len(values)):
        values[i] = value_of(state[i])
    loads[SPEED] = value_of(load[SPEED])
    _solve_for_speed(floats, values, loads, alone, vectors, mass, inverse)

    a, b = local((tables.to_centre,)), local((tables.to_centre,))
    for j in range(nodes):
        a[j], b[j] = 0.0, 0.0
    _add_slope_rates(alone.speed, 0, c1, c2, a, b)
    _set_forces_of_slopes(tables, a, b, g1, g2)
    speed[0] = load[SPEED]
    for i in range(driven, count):
        speed[i] = state[momenta + i] - _momentum(tables, alone.speed, 0, work, i)
        mass[i, i] = inverse[i]
    _solve(tables, mass, driven, speed)
    for i in range(driven, count):
        for j in range(nodes):
            g1[j] += alone.image_1[i, j] * speed[i]
            g2[j] += alone.image_2[i, j] * speed[i]
        speed[i] = chain(alone.speed[i], 1.0, speed[i])


@inner
def _solve_for_speed(tables, state, load, numbers, work, mass, inverse):
    """
    Set the images K C1, K C2 and q', the solution of M q' = p (T26), (T31).

    `numbers` are the work arrays as single numbers, `work` the same as vectors. Below the diagonal
    `mass` gets L of the free part M = L D L^T, and `inverse` gets 1/D.

    The kernel K turns slopes at the nodes into forces on them: it integrates accelerations of the
    slopes to the points of mass, takes those of the mass centre away along an axis on which the
    carrier is free (T26), not where it is held (T30), multiplies by the masses and sums outwards.
    """
    kernel, rotary = as_vectors(tables.kernel), tables.rotary
    c1, c2, image_1, image_2 = work.c1, work.c2, work.image_1, work.image_2
    speed = work.speed
    count, nodes = c1.shape
    driven = count - len(tables.straight)
    for i in range(count):
        for j in range(nodes):
            total_1 = 0.0
            total_2 = 0.0
            for k in range(kernel.shape[1]):  # K is symmetric
                total_1 += numbers.c1[i, k] * kernel[0, k, j]
                total_2 += numbers.c2[i, k] * kernel[len(kernel) - 1, k, j]
            image_1[i, j] = total_1
            image_2[i, j] = total_2
    # The lower triangle of M_ij = Xi_ij + C1_i K C1_j + C2_i K C2_j.
    for i in range(driven, count):
        for j in range(i + 1):
            product = 0.0
            for k in range(nodes):
                product += image_1[i, k] * c1[j, k] + image_2[i, k] * c2[j, k]
            mass[i, j] = rotary[i, j] + sum_of(product, rotary)

    # The momenta less the share M_i0 q_0' of a driven shaft, whose speed is given (T31).
    momenta = 2 * half_length(tables) - count
    speed[0] = load[SPEED]
    for i in range(driven, count):
        speed[i] = state[momenta + i]
        for j in range(driven):
            speed[i] -= mass[i, j] * speed[j]
    # M = L D L^T column by column, in place; the same loop solves L x = p, the last one L^T.
    factor = local((rotary,))
    for k in range(driven, count):
        inverse[k] = 1.0 / mass[k, k]
        for i in range(k + 1, count):
            factor[i] = mass[i, k] * inverse[k]
            speed[i] -= factor[i] * speed[k]
        for i in range(k + 1, count):
            for j in range(k + 1, i + 1):
                mass[i, j] -= factor[i] * mass[j, k]
        for i in range(k + 1, count):
            mass[i, k] = factor[i]
    for i in range(driven, count):
        speed[i] *= inverse[i]
    _take_rates_of_state(tables, state, mass, inverse, work)
    for k in range(count - 1, driven - 1, -1):
        for i in range(driven, k):
            speed[i] -= mass[k, i] * speed[k]


# A force on the arm. Without one it is -0.0, the neutral element of addition: x + -0.0 == x for
# every x, so that LLVM removes the additions.

@inner
def _push_force(tables, load):
    """Return x, y of the force on the arm at push.position."""
    x, y = -0.0, -0.0
    if len(tables.push):
        x, y = load[PUSH_X], load[PUSH_Y]
    return x, y


@inner
def _push_on_slopes(tables, load, j):
    """Return x, y of the generalised force of the push against the slopes at nodes j (T29)."""
    push = as_vectors(tables.push)
    x, y = -0.0, -0.0
    if len(push):
        x, y = -push[0, j] * load[PUSH_X], -push[0, j] * load[PUSH_Y]
    return x, y


# Mass centre and carrier, (T25), (T27), (T33), (T46).

@inner
def carrier_speed(tables, state, k, derivative, speed):
    """Return the carrier's speed along its k-th free axis (T33); `derivative` is C1 or C2."""
    to_centre = as_vectors(tables.to_centre)
    centre = 0.0
    for j in range(len(to_centre)):
        slope_rate = 0.0
        for i in range(len(speed)):
            slope_rate += derivative[i, j] * speed[i]
        centre += to_centre[j] * slope_rate
    return state[half_length(tables) + k] / tables.mass - sum_of(centre, tables.to_centre)


@inner
def _resistance(tables, speed):
    """Return the friction against a speed of the carrier."""
    return tables.carrier_friction * speed + functions.coulomb(tables, 0, speed)


@inner
def _translate(tables, state, load, work, out):
    """
    Write the rates of the mass centre (T27).

    Return x, y of two forces: F of (T28), along free axes the sum of the forces on carrier and tip
    (T32), and that on the tip. Where the carrier is held, the weights act on the arm as a force
    -m_t (g - a) on the carrier would (T46), with the acceleration a of what holds it (T71).
    """
    axes, half, weight = tables.axes, half_length(tables), tables.weight
    push_x, push_y = 0.0 - weight[0], 0.0 - weight[1]
    if len(axes) < 2:  # what holds the carrier may accelerate
        push_x += tables.mass * load[ACCELERATION_X]
        push_y += tables.mass * load[ACCELERATION_Y]
    shaft_y, shaft_x = sincos(work.coordinate[0])
    tip_x = load[TIP_X] + shaft_x * load[TIP_I] - shaft_y * load[TIP_II]
    tip_y = load[TIP_Y] + shaft_y * load[TIP_I] + shaft_x * load[TIP_II]
    arm_x, arm_y = _push_force(tables, load)
    rubs = some((tables.carrier_friction != 0.0) | (tables.coulomb[0, 0] != 0.0))
    for k in range(len(axes)):
        if axes[k] == 0:
            push_x = (load[FORCE_X] + shaft_x * load[FORCE_I] - shaft_y * load[FORCE_II]
                      + tip_x + arm_x)
            if rubs:
                speed = carrier_speed(tables, state, k, work.c1, work.speed)
                push_x -= _resistance(tables, speed)
        else:
            push_y = (load[FORCE_Y] + shaft_y * load[FORCE_I] + shaft_x * load[FORCE_II]
                      + tip_y + arm_y)
            if rubs:
                speed = carrier_speed(tables, state, k, work.c2, work.speed)
                push_y -= _resistance(tables, speed)
        out[k] = 0.0  # X' = P / m_t is in the linear part
        out[half + k] = push_x + weight[0] if axes[k] == 0 else push_y + weight[1]
    return push_x, push_y, tip_x, tip_y


# Forces on the coordinates, (T28), (T29), (T32).

@declare
def _momenta_of_slopes(tables, work, j):
    """Return (g1, g2) = K (a', b') at nodes j."""


@_momenta_of_slopes.of(Tables, merge=True)
def _momenta_of_images(tables, work, j):
    g1, g2 = 0.0, 0.0
    for i in range(len(work.speed)):
        g1 += work.speed[i] * work.image_1[i, j]
        g2 += work.speed[i] * work.image_2[i, j]
    return g1, g2


@_momenta_of_slopes.of(Tables, merge=True, duals=True)
def _momenta_that_are_set(tables, work, j):
    return work.g1[j], work.g2[j]


@inner
def _set_moments(tables, load, torque, forces, work, script_a, script_b):
    """
    Set A_j and B_j of (T29); return the moment of torque and forces about the shaft.

    dT/dq_i = sum_j Phi_ij A_j + Gamma_ij B_j, from (g1, g2) = K (a', b') and the rates of phi and
    gamma; centrifugal forces, which stiffen an arm that turns, are a part of it. The forces on
    carrier (T28) and tip (T32) act on C1, C2, which by (T24) gives a sum of the same form: A_j,
    B_j include it. The sum of its share in A_j is the moment.
    """
    to_centre, to_tip = as_vectors(tables.to_centre), as_vectors(tables.to_tip)
    rotation, shear = as_vectors(tables.rotation), as_vectors(tables.shear)
    a, b, cosine, sine, speed = work.a, work.b, work.cosine, work.sine, work.speed
    push_x, push_y, tip_x, tip_y = forces
    moment = 0.0
    for j in range(len(to_centre)):
        g1, g2 = _momenta_of_slopes(tables, work, j)
        turning = 0.0
        shearing = 0.0
        for i in range(len(speed)):
            turning += speed[i] * rotation[i, j]
            shearing += speed[i] * shear[i, j]
        along = cosine[j] * g1 + sine[j] * g2
        # The force against the slope: -Q_i of (T28), (T32) is the sum of its products with C_i.
        arm_x, arm_y = _push_on_slopes(tables, load, j)
        force_x = to_centre[j] * push_x - to_tip[j] * tip_x + arm_x
        force_y = to_centre[j] * push_y - to_tip[j] * tip_y + arm_y
        script_a[j] = force_x * b[j] - force_y * a[j]
        script_b[j] = force_x * sine[j] - force_y * cosine[j] - turning * along
        moment += script_a[j]
        script_a[j] -= turning * (a[j] * g1 + b[j] * g2) + shearing * along
    return torque + sum_of(moment, tables.to_centre)


@functions.rate.of(Tables)
def _rate(tables, state, load, out):
    """Write the state's rate less its linear part."""
    numbers = local_arrays(Work, tables)
    work = as_vectors(numbers)
    _set_slopes_of_state(tables, state, load, work)
    _set_speed(tables, state, load, numbers, work)
    rows, across = tables.rotation, tables.to_centre
    rotation, shear = as_vectors(rows), as_vectors(tables.shear)
    count, nodes = rotation.shape
    driven, half = count - len(tables.straight), half_length(tables)
    momenta = 2 * half - count
    coordinates = momenta - half

    # q' (T28) less that by the mass matrix of the straight arm, which is in the linear part.
    for i in range(driven, count):
        total = work.speed[i]
        for j in range(driven, count):
            total -= tables.straight[i - driven, j - driven] * state[momenta + j]
        out[coordinates + i] = total

    # p' (T28): the stiffness is in the linear part, and damping of the straight arm's speeds.
    forces = _translate(tables, state, load, work, out)
    place = _gear_place(tables)
    on_rotor = functions.rotor_torque(tables, load, work.speed[0], work.speed, place)
    torque = on_rotor - functions.coulomb(tables, 1, work.speed[0])
    for _ in range(len(tables.gear)):  # 0 or 1 gears: an `if` that LLVM decides, see `compiled`
        torque += load[SHAFT_FRICTION]
    for n in range(len(tables.spring)):  # the linear part has one that is relaxed at 0
        torque += tables.spring[n, 0] * tables.spring[n, 1]
    drag = _linear_drag(tables, work.speed, out, coordinates)
    script_a, script_b = as_vectors(local((across,))), as_vectors(local((across,)))
    moment = _set_moments(tables, load, torque + drag, forces, work, script_a, script_b)
    for i in range(driven, count - len(tables.linear_rate)):
        # Unless one axis is held, T does not depend on the shaft angle; that sum would only give
        # round-off and is left out.
        total = moment
        if i or len(tables.axes) == 1:
            done = 0.0
            for j in range(nodes):
                done += rotation[i, j] * script_a[j] + shear[i, j] * script_b[j]
            total = sum_of(done, across)
            if i == 0:
                total += torque + drag
        total += tables.tip_rotation[i] * load[TIP_TORQUE]
        out[momenta + i] = total - tables.damping[i] * out[coordinates + i]
    for n in range(len(tables.gear)):
        if place < count - len(tables.linear_rate):
            out[momenta + place] += (tables.gear[n, PER_COORDINATE] * (on_rotor + drag)
                                     + functions.missing_contact(
                                         tables, n, place, work.coordinate, work.speed))
    _add_rates_of_rates(tables, load, torque, on_rotor, forces, work, out)
    _subtract_part_of_band(tables, state, out)


# An elastic gear (T60) to (T62).

@inner
def _gear_place(tables):
    """Return the number of the gear's coordinate."""
    return len(tables.rotation) - len(tables.stretch) - 1


@inner
def _linear_drag(tables, speed, nonlinear_rate, coordinates):
    """
    Return the viscous friction of the rotor that the linear part has.

    The speed less the rate that is not in the linear part is what that one integrates.
    """
    drag = -0.0
    for n in range(len(tables.gear)):
        place = _gear_place(tables)
        drag = tables.gear[n, DRAG] * (
            speed[0] - nonlinear_rate[coordinates] + tables.gear[n, PER_COORDINATE] * (
                speed[place] - nonlinear_rate[coordinates + place]))
    return drag


@functions.observe.of(Tables)
def _observe(tables, state, load, out):
    """Write the motion of a state: the carrier's from the mass centre's (T25), and q'."""
    rows, across = tables.rotation, tables.to_centre
    numbers = local_arrays(Work, tables)
    work = as_vectors(numbers)
    _set_slopes_of_state(tables, state, load, work)
    _set_speed(tables, state, load, numbers, work)
    to_centre, half = as_vectors(across), len(out) // 2
    for i in range(len(rows)):
        out[2 + i] = work.coordinate[i]
        out[half + 2 + i] = work.speed[i]
    for axis in range(2):
        out[axis] = tables.held_position[axis]
        out[half + axis] = 0.0
    if len(tables.axes) < 2:
        functions.add_base(load, half, out)
    for k in range(len(tables.axes)):
        axis = tables.axes[k]
        slope, derivative = (work.a, work.c1) if axis == 0 else (work.b, work.c2)
        centre = 0.0
        for j in range(len(to_centre)):
            centre += to_centre[j] * slope[j]
        out[axis] = state[k] - sum_of(centre, across)
        out[half + axis] = carrier_speed(tables, state, k, derivative, work.speed)


@functions.joint_place.of(Tables, merge=True)
def _joint_place(tables, state, load, joint):
    """Return the place of a joint; the carrier's is by the mass centre (T25)."""
    count, axes = len(tables.rotation), len(tables.axes)
    driven, found = count - len(tables.straight), 0.0
    if joint >= 2:
        found = load[ANGLE] if driven else state[axes]
        if joint == 2:
            for n in range(len(tables.gear)):
                found += tables.gear[n, PER_COORDINATE] * state[
                    axes + _gear_place(tables) - driven]
    else:
        rotation, to_centre = as_vectors(tables.rotation), as_vectors(tables.to_centre)
        centre = 0.0
        for j in range(len(to_centre)):
            phi, gamma, strain = _fields(tables, state, axes - driven, driven, j)
            if driven:
                phi += load[ANGLE] * rotation[0, j]
            _, _, a, b = _slope(phi, gamma, strain)
            centre += to_centre[j] * (a if joint == 0 else b)
        for k in range(axes):
            if tables.axes[k] == joint:
                found = state[k] - sum_of(centre, tables.to_centre)
    return found


@inner
def _fields(tables, values, begin, first, j):
    """
    Return rotation, shear strain and axial strain at nodes j; of rates or accelerations theirs.

    `values[begin + i]` belongs to the i-th coordinate; coordinates before `first` do not count.
    """
    rotation, shear = as_vectors(tables.rotation), as_vectors(tables.shear)
    stretch = as_vectors(tables.stretch)
    count = len(rotation)
    axial = count - len(stretch)
    phi, gamma, strain = 0.0, 0.0, 0.0
    for i in range(first, count):
        phi += values[begin + i] * rotation[i, j]
        gamma += values[begin + i] * shear[i, j]
    for i in range(axial, count):
        strain += values[begin + i] * stretch[i - axial, j]
    return phi, gamma, strain


@inner
def _slope(phi, gamma, strain):
    """Return sine and cosine of phi, and the slope (a, b) (T23), (T34)."""
    sine, cosine = sincos(phi)
    return (sine, cosine, cosine - gamma * sine + strain * cosine,
            sine + gamma * cosine + strain * sine)


@inner
def _integral(tables, weights, motion):
    """Return the position of a point from the shaft, the integral of the slopes up to it."""
    to_point, along, across = as_vectors(weights), 0.0, 0.0
    for j in range(len(to_point)):
        phi, gamma, strain = _fields(tables, motion, 2, 1, j)
        _, _, a, b = _slope(phi, gamma, strain)
        along += a * to_point[j]
        across += b * to_point[j]
    return sum_of(along, tables.to_tip), sum_of(across, tables.to_tip)


@functions.tip.of(Tables)
def _tip(tables, motion, out):
    """Write the tip's position, and its rotation from the shaft."""
    out[0], out[1] = _integral(tables, tables.to_tip, motion)
    out[2] = 0.0
    for i in range(1, len(tables.rotation)):
        out[2] += motion[2 + i] * tables.tip_rotation[i]


@functions.place_point.of(Tables)
def _place_point(tables, outline, number, motion, out):
    """Write the position of a point."""
    out[0], out[1] = _integral(tables, outline.integral[number], motion)


@functions.tip_rate.of(Tables)
def _tip_rate(tables, motion, out):
    """Write the rate of the tip's place, the integral of the slopes' rates."""
    to_tip, rates = as_vectors(tables.to_tip), len(motion) // 2
    along = 0.0
    across = 0.0
    for j in range(len(to_tip)):
        phi, gamma, strain = _fields(tables, motion, 2, 1, j)
        sine, cosine, a, b = _slope(phi, gamma, strain)
        turning, shearing, stretching = _fields(tables, motion, rates + 2, 1, j)
        along += (cosine * stretching - b * turning - sine * shearing) * to_tip[j]
        across += (a * turning + cosine * shearing + sine * stretching) * to_tip[j]
    out[0] = sum_of(along, tables.to_tip)
    out[1] = sum_of(across, tables.to_tip)
    out[2] = 0.0
    for i in range(1, len(tables.rotation)):
        out[2] += motion[rates + 2 + i] * tables.tip_rotation[i]


# Momenta, forces of constraints (T44) and energy, outside the step. What momenta are by rates and
# slopes' rates a', b', forces are by accelerations and a'', b''.

@strict
def _add_slope_rates(rates, begin, c1, c2, a, b):
    """Add to slopes' rates what those of coordinates make of them, from rates[begin] on."""
    count, nodes = c1.shape
    for j in range(nodes):
        for i in range(count):
            a[j] += rates[begin + i] * c1[i, j]
            b[j] += rates[begin + i] * c2[i, j]


@strict
def _set_forces_of_slopes(tables, a, b, g1, g2):
    """Set (g1, g2) = K (a, b), vectors of single numbers."""
    kernel = as_vectors(tables.kernel)
    for j in range(len(g1)):
        total_1, total_2 = 0.0, 0.0
        for k in range(kernel.shape[1]):
            total_1 += a[k] * kernel[0, k, j]
            total_2 += b[k] * kernel[len(kernel) - 1, k, j]
        g1[j], g2[j] = total_1, total_2


@strict
def _momentum(tables, rates, begin, work, i):
    """Return the i-th of M q' = Xi q' + C1 g1 + C2 g2, with (g1, g2) = K (a', b')."""
    product = 0.0
    for j in range(len(work.g1)):
        product += work.c1[i, j] * work.g1[j] + work.c2[i, j] * work.g2[j]
    total = sum_of(product, tables.to_centre)
    for j in range(len(tables.rotary)):
        total += tables.rotary[i, j] * rates[begin + j]
    return total


@strict
def _dot(left, right):
    lefts, rights, total = as_vectors(left), as_vectors(right), 0.0
    for j in range(len(lefts)):
        total += lefts[j] * rights[j]
    return sum_of(total, left)


@strict
def _set_spins(tables, motion, rates, begin, numbers, work, out):
    """
    Write P (T27) and M q' of a motion, whose rates are those from rates[begin] on; set slopes.

    With accelerations in their place, from rates[0] on, these are the forces that those need.
    """
    a, b, half = work.image_1[0], work.image_2[0], len(motion) // 2
    for i in range(len(work.speed)):
        work.coordinate[i], work.speed[i] = motion[2 + i], motion[half + 2 + i]
    _set_slopes(tables, work)
    for j in range(len(a)):
        a[j], b[j], _ = _second_slopes(tables, work, j)
        if begin != 0:
            a[j], b[j] = 0.0 * work.a[j], 0.0 * work.b[j]
    _add_slope_rates(rates, begin + 2, work.c1, work.c2, a, b)
    _set_forces_of_slopes(tables, numbers.image_1[0], numbers.image_2[0], work.g1, work.g2)
    out[0] = tables.mass * (rates[begin] + _dot(tables.to_centre, a))
    out[1] = tables.mass * (rates[begin + 1] + _dot(tables.to_centre, b))
    for i in range(len(tables.rotary)):
        out[2 + i] = _momentum(tables, rates, begin + 2, work, i)


@strict
def _set_momenta(tables, motion, rates, begin, numbers, work, out):
    """
    Do so, and add the share of P that momenta about the shaft have of it.

    Along axes on which the carrier is held that is the share of m_t x': the kernel is that about
    the root (T30).
    """
    _set_spins(tables, motion, rates, begin, numbers, work, out)
    for axis in range(2):
        momentum = tables.mass * rates[begin + axis]
        for k in range(len(tables.axes)):
            if tables.axes[k] == axis:
                momentum = out[axis]
        derivative = work.c1 if axis == 0 else work.c2
        for i in range(len(tables.rotation)):
            out[2 + i] += momentum * _dot(tables.to_centre, derivative[i])


@functions.state_of.of(Tables, fast=False)
def _state_of(tables, motion, out):
    """Write mass centre (T25) and coordinates, then their momenta, or rates of the last (T35)."""
    numbers, momenta = local_arrays(Work, tables), local((motion,))
    work = as_vectors(numbers)
    _set_spins(tables, motion, motion, len(motion) // 2, numbers, work, momenta)
    count, axes, half = len(tables.rotation), len(tables.axes), half_length(tables)
    driven = count - len(tables.straight)
    for k in range(axes):
        axis = tables.axes[k]
        out[k] = motion[axis] + _dot(tables.to_centre, work.a if axis == 0 else work.b)
        out[half + k] = momenta[axis]
    for i in range(driven, count):
        place = axes + i - driven
        out[place], out[half + place] = motion[2 + i], momenta[2 + i]
        if i >= count - len(tables.linear_rate):
            out[half + place] = work.speed[i]


@functions.momenta.of(Tables, fast=False)
def _momenta(tables, motion, out):
    """Write momenta, those of coordinates about the shaft."""
    numbers = local_arrays(Work, tables)
    _set_momenta(tables, motion, motion, len(motion) // 2, numbers, as_vectors(numbers), out)


@functions.effort.of(Tables)
def _effort(tables, motion, accelerations, load, out):
    """Write the rates of momentum and spin less those by loads on tip and arm."""
    numbers, needed = local_arrays(Work, tables), local((motion,))
    work = as_vectors(numbers)
    _set_momenta(tables, motion, accelerations, 0, numbers, work, needed)
    sine, cosine = sincos(motion[2])
    tip_x = load[TIP_X] + cosine * load[TIP_I] - sine * load[TIP_II]
    tip_y = load[TIP_Y] + sine * load[TIP_I] + cosine * load[TIP_II]
    out[0], out[1] = needed[0] - tip_x, needed[1] - tip_y
    out[2] = (needed[2] - _dot(tables.to_tip, work.a) * tip_y + _dot(tables.to_tip, work.b) * tip_x
              - load[TIP_TORQUE])
    for k in range(len(tables.push)):
        out[0] -= load[PUSH_X]
        out[1] -= load[PUSH_Y]
        out[2] -= (_dot(tables.push[k], work.a) * load[PUSH_Y]
                   - _dot(tables.push[k], work.b) * load[PUSH_X])


@functions.energy.of(Tables)
def _energy(tables, motion, gravity):
    numbers, momenta = local_arrays(Work, tables), local((motion,))
    work = as_vectors(numbers)
    _set_momenta(tables, motion, motion, len(motion) // 2, numbers, work, momenta)
    x, y = motion[0] + _dot(tables.to_centre, work.a), motion[1] + _dot(tables.to_centre, work.b)
    return (functions.energy_of_momenta(tables, len(tables.stretch), motion, momenta)
            - tables.mass * (gravity[0] * x + gravity[1] * y))


# Axial strain (T34); these functions do nothing for an arm that does not stretch.

@inner
def _add_stretch_to_slopes(tables, work):
    """Add the axial strain to a, b (T23), C1 and C2 (T24)."""
    rotation, stretch = as_vectors(tables.rotation), as_vectors(tables.stretch)
    count, nodes = rotation.shape
    axial = count - len(stretch)
    if axial == count:
        return
    a, b, c1, c2, cosine, sine = work.a, work.b, work.c1, work.c2, work.cosine, work.sine
    for j in range(nodes):
        strain = 0.0
        for i in range(axial, count):
            strain += work.coordinate[i] * stretch[i - axial, j]
            c1[i, j] = cosine[j] * stretch[i - axial, j]
            c2[i, j] = sine[j] * stretch[i - axial, j]
        a[j] += strain * cosine[j]
        b[j] += strain * sine[j]
        for i in range(axial):
            c1[i, j] -= strain * sine[j] * rotation[i, j]
            c2[i, j] += strain * cosine[j] * rotation[i, j]


# Coordinates whose state is a rate, not a momentum (T35): the axial ones or, with one axis of the
# carrier held and no axial ones, all free ones.

@inner
def _take_rates_of_state(tables, state, mass, inverse, work):
    """Set the rates that are part of the state; copy L and 1/D of the mass matrix to `factors`."""
    if len(tables.linear_rate) == 0:
        return
    count = len(work.speed)
    rates_from = count - len(tables.linear_rate)
    for i in range(count - len(tables.straight), count):
        for j in range(i):
            work.factors[i, j] = mass[i, j]
        work.factors[i, i] = inverse[i]
    for i in range(rates_from, count):
        work.speed[i] = state[2 * half_length(tables) - count + i]
        for j in range(rates_from, i):
            mass[i, j] = 0.0  # the back substitution that follows must not change these rates


@inner
def _second_slopes(tables, work, j):
    """Return a_2, b_2 of (T35), slopes'' where q'' = 0, and the axial strain's rate at nodes j."""
    cosine, sine, slope_1, slope_2 = work.cosine[j], work.sine[j], 0.0, 0.0
    turning, shearing, stretching = _fields(tables, work.speed, 0, 0, j)
    for i in range(len(work.speed)):
        slope_1 += work.speed[i] * work.c1[i, j]
        slope_2 += work.speed[i] * work.c2[i, j]
    return (-turning * (slope_2 + cosine * shearing + sine * stretching),
            turning * (slope_1 - sine * shearing + cosine * stretching), stretching)


@inner
def _add_rates_of_rates(tables, load, torque, on_rotor, forces, work, out):
    """Add the terms of the axial strain to dT/dq (T29); write the accelerations (T35)."""
    if len(tables.linear_rate) == 0:
        return
    to_tip, to_centre, across = (
        as_vectors(tables.to_tip), as_vectors(tables.to_centre), tables.to_centre)
    rotation, factors, coordinate, speed = (
        as_vectors(tables.rotation), work.factors, work.coordinate, work.speed)
    count, nodes = rotation.shape
    driven, momenta = count - len(tables.straight), 2 * half_length(tables) - count
    rates_from = count - len(tables.linear_rate)
    push_x, push_y, tip_x, tip_y = forces
    # What is added to A_j of (T29), then slopes'' where q'' = 0.
    added, a_2, b_2 = (as_vectors(local((across,))), as_vectors(local((across,))),
                       as_vectors(local((across,))))
    for j in range(nodes):
        a_2[j], b_2[j], stretching = _second_slopes(tables, work, j)
        g1, g2 = _momenta_of_slopes(tables, work, j)
        added[j] = stretching * (work.cosine[j] * g2 - work.sine[j] * g1)
    # The right-hand side of (T35), all loads and a given q_0'' included.
    force = local((tables.rotation,))
    for i in range(driven, count):
        done = 0.0
        of_stretch = 0.0
        for j in range(nodes):
            of_stretch += rotation[i, j] * added[j]
            arm_x, arm_y = _push_on_slopes(tables, load, j)
            force_x = to_tip[j] * tip_x - to_centre[j] * push_x - arm_x
            force_y = to_tip[j] * tip_y - to_centre[j] * push_y - arm_y
            done += (force_x * work.c1[i, j] + force_y * work.c2[i, j]
                     - work.image_1[i, j] * a_2[j] - work.image_2[i, j] * b_2[j])
        # Unless one axis is held, T does not depend on the shaft angle.
        if i < rates_from and (i or len(tables.axes) == 1):
            out[momenta + i] += sum_of(of_stretch, across)
        total = (sum_of(done, across) + tables.tip_rotation[i] * load[TIP_TORQUE]
                 - tables.stiffness[i] * coordinate[i] - tables.damping[i] * speed[i])
        if i == 0:
            total += torque
        for j in range(driven):
            total -= factors[i, j] * load[ACCELERATION]
        force[i] = total
    for n in range(len(tables.gear)):
        place = _gear_place(tables)
        force[place] += (tables.gear[n, PER_COORDINATE] * on_rotor
                         + functions.missing_contact(tables, n, place, coordinate, speed))
    _solve(tables, factors, rates_from, force)
    for i in range(rates_from, count):
        total = force[i]
        for j in range(rates_from, count):
            total -= (tables.linear_rate[i - rates_from, 0, j - rates_from] * coordinate[j]
                      + tables.linear_rate[i - rates_from, 1, j - rates_from] * speed[j])
        out[momenta + i] = total


@inner
def _solve(tables, factors, first, vector):
    """Solve M x = vector for x from a first one on, in place; `factors` are L and 1/D of M."""
    count = len(vector)
    for i in range(count - len(tables.straight), count):
        for k in range(count - len(tables.straight), i):
            vector[i] -= factors[i, k] * vector[k]
    for i in range(count - 1, first - 1, -1):
        vector[i] *= factors[i, i]
        for k in range(i + 1, count):
            vector[i] -= factors[k, i] * vector[k]


# Linear parts by the angle and speed of the shaft, where one axis of the carrier is held (section
# 7): of sectors of its angle and, if the arm stretches, of bands of its speed.

SECTORS = 16  # number of sectors of half a turn
# Number of bands of the speed on either side of 0, and their width, as a share of the first
# angular frequency.
BANDS, BAND = 32, 0.25


@inner
def sector_of(angle):
    """Return the number of the sector in which a shaft angle lies."""
    number = floor(angle * (SECTORS / math.pi))
    return number - SECTORS * floor(number / SECTORS)


@inner
def band_of(speed, bands_per_speed):
    """Return the number of the band in which a speed lies."""
    number = floor(speed * bands_per_speed)
    return BANDS + where(number < -BANDS, -BANDS, where(number >= BANDS, BANDS - 1, number))


@functions.linear_part_is_valid.of(Tables)
def _linear_part_is_valid(tables, state, load):
    if tables.sector < 0:
        return True
    driven, axes = len(tables.rotation) > len(tables.straight), len(tables.axes)
    number = sector_of(load[ANGLE] if driven else state[axes])
    if len(tables.of_band):
        number += SECTORS * band_of(load[SPEED] if driven else state[half_length(tables) + axes],
                                    tables.bands_per_speed)
    return number == tables.sector


@inner
def _subtract_part_of_band(tables, state, out):
    """Subtract what the linear part has for the speed of a band."""
    for i in range(len(tables.of_band)):
        total = 0.0
        for j in range(len(tables.of_band)):
            total += tables.of_band[i, j] * state[j]
        out[i] -= total
