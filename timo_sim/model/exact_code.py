# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Constants and compiled functions of the `exact` formulation.

Numbers (T..) are those of doc/theory.md, section 6; the text of `exact` has the equations.
"""

from collections import namedtuple
import math
from typing import Any, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local
from timo_sim.compiled.functions import inlined, inner, optional
from timo_sim.compiled.lanes import some
from timo_sim.model import functions
from timo_sim.model.functions import sincos
from timo_sim.model.layout import (
    ACCELERATION, ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, PUSH_X, PUSH_Y, SPEED, TIP_I,
    TIP_II, TIP_TORQUE, TIP_X, TIP_Y, TORQUE)


class Tables(NamedTuple):
    """Constants of the compiled functions; N modes, n_g quadrature nodes, n free q_i."""

    mass: float            # m_t
    kernel: np.ndarray     # K for x and for y, (2, n_g, n_g), or for both, (1, n_g, n_g)
    lever: np.ndarray      # d / m_t, (n_g,)
    rotation: np.ndarray   # Phi_i at the nodes, (1 + N, n_g)
    shear: np.ndarray      # Gamma_i at the nodes, (1 + N, n_g)
    rotary: np.ndarray     # Xi_ij = int J Phi_i Phi_j, the shaft's J_m included, (1 + N, 1 + N)
    straight: np.ndarray   # M^-1 of the straight arm, (n, n)
    damping: np.ndarray    # c_s, then 2 zeta_i omega_i, (1 + N,)
    drag: float            # c_c
    coulomb: np.ndarray    # `Manipulator.coulomb`, (2, 2)
    axes: np.ndarray       # axes along which the carrier is free
    anchor: np.ndarray     # position at which it is held, (2,)
    reach: np.ndarray      # from nodal values to their integral over the arm, (n_g,)
    turn: np.ndarray       # Phi_i at the tip, (1 + N,)
    weight: np.ndarray     # m_t g along world x and y, (2,)


# Number of sectors of half a turn with a linear part each, if one axis of the carrier is held.
SECTORS = 16

# Constants where the last R coordinates have rates in place of momenta (T35). In addition:
# - stretch: E_i of the last A coordinates, the axial ones, at the nodes, (A, n_g);
# - stiffness: omega_i^2, (1 + N,);
# - linear_rate: linear part of the last accelerations per q_i and per q_i', (R, 2, R);
# - sector: number of the sector for which the linear part is, -1: any.
RateTables = namedtuple(  # type: ignore[misc]
    'RateTables', (*Tables._fields, 'stretch', 'stiffness', 'linear_rate', 'sector'))

# Number of bands of the speed with a linear part each, on either side of 0, and their width, as a
# share of the first angular frequency.
BANDS, BAND = 32, 0.25

# Constants of an arm that stretches, with one axis of the carrier held. In addition:
# - pace: bands per p_0, or per q_0' of a driven shaft;
# - turning: what the linear part has for the speed of the band, (m, m). `sector` counts both:
#   SECTORS times the number of the band, plus that of the sector.
TurningTables = namedtuple(  # type: ignore[misc]
    'TurningTables', (*RateTables._fields, 'pace', 'turning'))

# Constants for a force on the arm, PUSH_X and PUSH_Y of a load. In addition:
# - push: from nodal values to their integral from the root to where it acts, (n_g,).
PUSHED: dict[type, Any] = {
    kind: namedtuple(f'Pushed{kind.__name__}', (*kind._fields, 'push'))
    for kind in (Tables, RateTables, TurningTables)}
_TURNING = TurningTables, PUSHED[TurningTables]
_RATED = RateTables, PUSHED[RateTables], *_TURNING
_ALL = Tables, PUSHED[Tables], *_RATED


# Additions to the compiled functions of `exact` for coordinates with rates in place of momenta.
#
# These coordinates are the axial ones or, with one axis of the carrier held and no axial ones, all
# free ones. Numbers (T..) are those of doc/theory.md, section 6.

@inner
def sector(angle):
    """Return the number of the sector in which a shaft angle lies."""
    number = math.floor(angle * (SECTORS / math.pi))
    return number - SECTORS * math.floor(number / SECTORS)


@optional
def band(tables, state, load):
    """Return the number of the band in which the speed lies."""
    return 0


@optional
def leave_out_turning(tables, state, out):
    """Subtract what the linear part has for the speed of a band."""


@optional
def stretch_slopes(tables, coordinate, cosine, sine, a, b, c1, c2):
    """Add the axial strain to a, b (T23), C1 and C2 (T24)."""


@optional
def known_rates(tables, state, mass, inverse, speed, factors):
    """Set the rates that are part of the state; copy L and 1/D of the mass matrix to `factors`."""


@optional
def rated(tables):
    """Return the number of last coordinates that have rates in place of momenta."""
    return 0


@optional
def stretch_forces(tables, load, torque, forces, cosine, sine, c1, c2, image_1, image_2,
                   coordinate, speed, factors, out):
    """Add the terms of the axial strain to dT/dq (T29); write the accelerations (T35)."""


@optional
def stretch_tip(tables, motion, out):
    """Add the displacement by axial strain to the tip's position from the shaft."""


# x + -0.0 is x, for every x: where there is no push the compiler removes these sums.
@optional
def push_force(tables, load):
    """Return x, y of the force on the arm."""
    return -0.0, -0.0


@optional
def push_work(tables, load, j):
    """Return what this force adds to the work of the others per slope at node j, in x and y."""
    return -0.0, -0.0


@push_force.of(*PUSHED.values())
def _push_force(tables, load):
    return load[PUSH_X], load[PUSH_Y]


@push_work.of(*PUSHED.values())
def _push_work(tables, load, j):
    return -tables.push[j] * load[PUSH_X], -tables.push[j] * load[PUSH_Y]


@functions.holds.of(*_RATED)
def _holds(tables, state, load):
    if tables.sector < 0:
        return True
    driven = len(tables.rotation) > len(tables.straight)
    number = sector(load[ANGLE] if driven else state[len(tables.axes)])
    return number + SECTORS * band(tables, state, load) == tables.sector


@band.of(*_TURNING)
def _band(tables, state, load):
    driven = len(tables.rotation) > len(tables.straight)
    speed = load[SPEED] if driven else state[len(state) // 2 + len(tables.axes)]
    return min(max(math.floor(speed * tables.pace), -BANDS), BANDS - 1) + BANDS


@leave_out_turning.of(*_TURNING)
def _leave_out_turning(tables, state, out):
    for i in range(len(out)):
        total = 0.0
        for j in range(len(out)):
            total += tables.turning[i, j] * state[j]
        out[i] -= total


@stretch_slopes.of(*_RATED)
def _slopes(tables, coordinate, cosine, sine, a, b, c1, c2):
    rotation, stretch = tables.rotation, tables.stretch
    count, nodes = rotation.shape
    axial = count - len(stretch)
    if axial == count:
        return
    for j in range(nodes):
        strain = 0.0
        for i in range(axial, count):
            strain += coordinate[i] * stretch[i - axial, j]
            c1[i, j] = cosine[j] * stretch[i - axial, j]
            c2[i, j] = sine[j] * stretch[i - axial, j]
        a[j] += strain * cosine[j]
        b[j] += strain * sine[j]
        for i in range(axial):
            c1[i, j] -= strain * sine[j] * rotation[i, j]
            c2[i, j] += strain * cosine[j] * rotation[i, j]


@rated.of(*_RATED)
def _rated(tables):
    return len(tables.linear_rate)


@known_rates.of(*_RATED)
def _rates(tables, state, mass, inverse, speed, factors):
    count = len(speed)
    rates_from = count - len(tables.linear_rate)
    for i in range(count - len(tables.straight), count):
        for j in range(i):
            factors[i, j] = mass[i, j]
        factors[i, i] = inverse[i]
    for i in range(rates_from, count):
        speed[i] = state[len(state) - count + i]
        for j in range(rates_from, i):
            mass[i, j] = 0.0  # the back substitution that follows must not change these rates


@stretch_forces.of(*_RATED)
def _forces(tables, load, torque, forces, cosine, sine, c1, c2, image_1, image_2, coordinate,
            speed, factors, out):
    rotation, shear, stretch, lever = tables.rotation, tables.shear, tables.stretch, tables.lever
    count, nodes = rotation.shape
    first, axial, momenta = count - len(tables.straight), count - len(stretch), len(out) - count
    rates_from = count - len(tables.linear_rate)
    push_x, push_y, tip_x, tip_y = forces
    across, bent_1, bent_2 = local((lever,)), local((lever,)), local((lever,))
    for j in range(nodes):
        g_across = 0.0
        turning = 0.0
        shearing = 0.0
        slope_1 = 0.0
        slope_2 = 0.0
        for i in range(count):
            g_across += speed[i] * (cosine[j] * image_2[i, j] - sine[j] * image_1[i, j])
            slope_1 += speed[i] * c1[i, j]
            slope_2 += speed[i] * c2[i, j]
            turning += speed[i] * rotation[i, j]
            shearing += speed[i] * shear[i, j]
        stretching = 0.0
        for i in range(axial, count):
            stretching += speed[i] * stretch[i - axial, j]
        across[j] = stretching * g_across
        bent_1[j] = -turning * (slope_2 + cosine[j] * shearing + sine[j] * stretching)
        bent_2[j] = turning * (slope_1 - sine[j] * shearing + cosine[j] * stretching)
    force = local((rotation,))
    for i in range(first, count):
        total = 0.0
        added = 0.0
        for j in range(nodes):
            added += rotation[i, j] * across[j]
            added_x, added_y = push_work(tables, load, j)
            work_x = tables.reach[j] * tip_x - lever[j] * push_x - added_x
            work_y = tables.reach[j] * tip_y - lever[j] * push_y - added_y
            total += (work_x * c1[i, j] + work_y * c2[i, j] - image_1[i, j] * bent_1[j]
                      - image_2[i, j] * bent_2[j])
        # Unless one axis is held, T does not depend on the shaft angle.
        if i < rates_from and (i or len(tables.axes) == 1):
            out[momenta + i] += added
        total += (tables.turn[i] * load[TIP_TORQUE] - tables.stiffness[i] * coordinate[i]
                  - tables.damping[i] * speed[i])
        if i == 0:
            total += torque
        for j in range(first):
            total -= factors[i, j] * load[ACCELERATION]
        force[i] = total
    # Solve M q'' = force for the last q'', with M = L D L^T of `_set_speed`.
    for k in range(first, count):
        for i in range(k + 1, count):
            force[i] -= factors[i, k] * force[k]
    for k in range(count - 1, rates_from - 1, -1):
        force[k] *= factors[k, k]
        for i in range(k + 1, count):
            force[k] -= factors[i, k] * force[i]
    for i in range(rates_from, count):
        total = force[i]
        for j in range(rates_from, count):
            total -= (tables.linear_rate[i - rates_from, 0, j - rates_from] * coordinate[j]
                      + tables.linear_rate[i - rates_from, 1, j - rates_from] * speed[j])
        out[momenta + i] = total


@stretch_tip.of(*_RATED)
def _tip_with_rates(tables, motion, out):
    rotation, stretch, reach = tables.rotation, tables.stretch, tables.reach
    count, nodes = rotation.shape
    axial = count - len(stretch)
    if axial == count:
        return
    for j in range(nodes):
        phi = 0.0
        for i in range(1, axial):
            phi += motion[2 + i] * rotation[i, j]
        sine, cosine = sincos(phi)
        for i in range(axial, count):
            strain = motion[2 + i] * stretch[i - axial, j]
            out[0] += strain * cosine * reach[j]
            out[1] += strain * sine * reach[j]


@inner
def _set_slopes(tables, state, load, coordinate, cosine, sine, a, b, c1, c2):
    """Set q, cosine and sine of phi, a, b (T23), C1 and C2 (T24)."""
    rotation, shear = tables.rotation, tables.shear
    count, nodes = rotation.shape
    first = count - len(tables.straight)
    coordinate[0] = load[ANGLE]
    for i in range(first, count):
        coordinate[i] = state[len(tables.axes) + i - first]
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
    stretch_slopes(tables, coordinate, cosine, sine, a, b, c1, c2)


@inner
def _set_speed(tables, state, load, c1, c2, image_1, image_2, speed, factors):
    """Set the images K C1, K C2 and q', the solution of M q' = p (T26), (T31)."""
    kernel, rotary = tables.kernel, tables.rotary
    count, nodes = c1.shape
    first = count - len(tables.straight)
    for i in range(count):
        for j in range(nodes):
            total_1 = 0.0
            total_2 = 0.0
            for k in range(nodes):
                # K is symmetric. Up to 16 nodes it is read down a column, so that this loop is
                # unrolled and the one over j is vector code; beyond, this loop is vector code.
                row, column = (k, j) if nodes <= 16 else (j, k)
                total_1 += c1[i, k] * kernel[0, row, column]
                total_2 += c2[i, k] * kernel[len(kernel) - 1, row, column]
            image_1[i, j] = total_1
            image_2[i, j] = total_2
    mass = local((rotary, rotary))
    for i in range(first, count):
        for j in range(i + 1):
            total = rotary[i, j]
            for k in range(nodes):
                total += image_1[i, k] * c1[j, k] + image_2[i, k] * c2[j, k]
            mass[i, j] = total

    # M = L D L^T, column by column, and L^-1 p.
    momenta = len(state) - count
    speed[0] = load[SPEED]
    for i in range(first, count):
        speed[i] = state[momenta + i]
        for j in range(first):
            speed[i] -= mass[i, j] * speed[j]
    factor, inverse = local((rotary,)), local((rotary,))
    for k in range(first, count):
        inverse[k] = 1.0 / mass[k, k]
        for i in range(k + 1, count):
            factor[i] = mass[i, k] * inverse[k]
            speed[i] -= factor[i] * speed[k]
        for i in range(k + 1, count):
            for j in range(k + 1, i + 1):
                mass[i, j] -= factor[i] * mass[j, k]
        for i in range(k + 1, count):
            mass[i, k] = factor[i]
    for i in range(first, count):
        speed[i] *= inverse[i]
    known_rates(tables, state, mass, inverse, speed, factors)
    for k in range(count - 1, first - 1, -1):
        for i in range(first, k):
            speed[i] -= mass[k, i] * speed[k]


@inner
def _carrier_rate(tables, state, k, slope_rates, speed):
    """Return the carrier's speed along its k-th free axis; `slope_rates` is C1 or C2 there."""
    rate = state[len(state) // 2 + k] / tables.mass
    for j in range(len(tables.lever)):
        for i in range(len(speed)):
            rate -= tables.lever[j] * slope_rates[i, j] * speed[i]
    return rate


@inlined
def _resistance(tables, speed):
    """Return the friction against a speed of the carrier."""
    return tables.drag * speed + functions.coulomb(tables, 0, speed)


@inlined
def _translate(tables, state, load, angle, c1, c2, speed, out):
    """
    Write the rates of the mass centre; return x, y of the force on the carrier and of the tip's.

    A carrier that is held in gravity is pushed against it, which bends the arm (T44).
    """
    axes, half, weight = tables.axes, len(state) // 2, tables.weight
    push_x, push_y = 0.0 - weight[0], 0.0 - weight[1]
    turned_y, turned_x = sincos(angle)
    tip_x = load[TIP_X] + turned_x * load[TIP_I] - turned_y * load[TIP_II]
    tip_y = load[TIP_Y] + turned_y * load[TIP_I] + turned_x * load[TIP_II]
    arm_x, arm_y = push_force(tables, load)
    rubs = some((tables.drag != 0.0) | (tables.coulomb[0, 0] != 0.0))
    for k in range(len(axes)):
        if axes[k] == 0:
            push_x = (load[FORCE_X] + turned_x * load[FORCE_I] - turned_y * load[FORCE_II]
                      + tip_x + arm_x)
            if rubs:
                push_x -= _resistance(tables, _carrier_rate(tables, state, k, c1, speed))
        else:
            push_y = (load[FORCE_Y] + turned_y * load[FORCE_I] + turned_x * load[FORCE_II]
                      + tip_y + arm_y)
            if rubs:
                push_y -= _resistance(tables, _carrier_rate(tables, state, k, c2, speed))
        out[k] = 0.0  # X' = P / m_t is in the linear part
        out[half + k] = push_x + weight[0] if axes[k] == 0 else push_y + weight[1]
    return push_x, push_y, tip_x, tip_y


@inlined
def _set_moments(tables, load, torque, forces, cosine, sine, a, b, image_1, image_2, speed,
                 script_a, script_b):
    """
    Set A_j and B_j of (T29); return the moment of torque and forces about the shaft.

    dT/dq_i = sum_j Phi_ij A_j + Gamma_ij B_j, from (g1, g2) = K (a', b') and the rates of phi and
    gamma. The forces act on C1, C2, which gives a sum of the same form: A_j, B_j include it.
    """
    lever, reach, rotation, shear = tables.lever, tables.reach, tables.rotation, tables.shear
    push_x, push_y, tip_x, tip_y = forces
    moment = torque
    for j in range(len(lever)):
        g1 = 0.0
        g2 = 0.0
        turning = 0.0
        shearing = 0.0
        for i in range(len(speed)):
            g1 += speed[i] * image_1[i, j]
            g2 += speed[i] * image_2[i, j]
            turning += speed[i] * rotation[i, j]
            shearing += speed[i] * shear[i, j]
        along = cosine[j] * g1 + sine[j] * g2
        added_x, added_y = push_work(tables, load, j)
        work_x = lever[j] * push_x - reach[j] * tip_x + added_x
        work_y = lever[j] * push_y - reach[j] * tip_y + added_y
        script_a[j] = work_x * b[j] - work_y * a[j]
        script_b[j] = work_x * sine[j] - work_y * cosine[j] - turning * along
        moment += script_a[j]
        script_a[j] -= turning * (a[j] * g1 + b[j] * g2) + shearing * along
    return moment


@functions.rate.of(*_ALL)
def _rate(tables, state, load, out):
    """Write the state's rate less its linear part."""
    rotation, shear, lever = tables.rotation, tables.shear, tables.lever
    count, nodes = rotation.shape
    first = count - len(tables.straight)
    coordinate, speed = local((rotation,)), local((rotation,))
    cosine, sine, a, b = local((lever,)), local((lever,)), local((lever,)), local((lever,))
    c1, c2 = local((rotation, lever)), local((rotation, lever))
    image_1, image_2 = local((rotation, lever)), local((rotation, lever))
    factors = local((rotation, rotation))
    _set_slopes(tables, state, load, coordinate, cosine, sine, a, b, c1, c2)
    _set_speed(tables, state, load, c1, c2, image_1, image_2, speed, factors)
    momenta, half = len(state) - count, len(state) // 2
    coordinates = momenta - half

    # q' less that by the mass matrix of the straight arm, which is in the linear part.
    for i in range(first, count):
        total = speed[i]
        for j in range(first, count):
            total -= tables.straight[i - first, j - first] * state[momenta + j]
        out[coordinates + i] = total

    forces = _translate(tables, state, load, coordinate[0], c1, c2, speed, out)
    torque = load[TORQUE] - functions.coulomb(tables, 1, speed[0])
    script_a, script_b = local((lever,)), local((lever,))
    moment = _set_moments(tables, load, torque, forces, cosine, sine, a, b, image_1, image_2,
                          speed, script_a, script_b)
    for i in range(first, count - rated(tables)):
        # Unless one axis is held, T does not depend on the shaft angle; that sum would only give
        # round-off and is left out.
        total = moment
        if i or len(tables.axes) == 1:
            total = 0.0 if i else torque
            for j in range(nodes):
                total += rotation[i, j] * script_a[j] + shear[i, j] * script_b[j]
        total += tables.turn[i] * load[TIP_TORQUE]
        out[momenta + i] = total - tables.damping[i] * out[coordinates + i]
    stretch_forces(tables, load, torque, forces, cosine, sine, c1, c2, image_1, image_2,
                   coordinate, speed, factors, out)
    leave_out_turning(tables, state, out)


@functions.observe.of(*_ALL)
def _observe(tables, state, load, out):
    """Write the motion of a state."""
    rotation, lever = tables.rotation, tables.lever
    count, nodes = rotation.shape
    coordinate, speed = local((rotation,)), local((rotation,))
    cosine, sine, a, b = local((lever,)), local((lever,)), local((lever,)), local((lever,))
    c1, c2 = local((rotation, lever)), local((rotation, lever))
    image_1, image_2 = local((rotation, lever)), local((rotation, lever))
    factors = local((rotation, rotation))
    _set_slopes(tables, state, load, coordinate, cosine, sine, a, b, c1, c2)
    _set_speed(tables, state, load, c1, c2, image_1, image_2, speed, factors)
    half = len(out) // 2
    for i in range(count):
        out[2 + i] = coordinate[i]
        out[half + 2 + i] = speed[i]
    for axis in range(2):
        out[axis] = tables.anchor[axis]
        out[half + axis] = 0.0
    for k in range(len(tables.axes)):
        axis = tables.axes[k]
        slope, derivative = (a, c1) if axis == 0 else (b, c2)
        out[axis] = state[k]
        for j in range(nodes):
            out[axis] -= lever[j] * slope[j]
        out[half + axis] = _carrier_rate(tables, state, k, derivative, speed)


@functions.tip.of(*_ALL)
def _tip(tables, motion, out):
    """Write the tip's position, the integral of the slopes, and rotation from the shaft."""
    rotation, shear, reach = tables.rotation, tables.shear, tables.reach
    count, nodes = rotation.shape
    for k in range(3):
        out[k] = 0.0
    for j in range(nodes):
        phi = 0.0
        gamma = 0.0
        for i in range(1, count):
            phi += motion[2 + i] * rotation[i, j]
            gamma += motion[2 + i] * shear[i, j]
        sine, cosine = sincos(phi)
        out[0] += (cosine - gamma * sine) * reach[j]
        out[1] += (sine + gamma * cosine) * reach[j]
    for i in range(1, count):
        out[2] += motion[2 + i] * tables.turn[i]
    stretch_tip(tables, motion, out)
