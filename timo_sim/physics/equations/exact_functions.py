# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Compiled functions of the `exact` formulation.

Numbers (T..) are those of doc/theory.md, section 6; the text of `exact` has the equations.
"""

from timo_sim.jit.choices import some
from timo_sim.jit.constants import local
from timo_sim.jit.decorators import inlined, inner
from timo_sim.physics.equations import functions
from timo_sim.physics.equations.exact_rates import (
    known_rates, leave_out_turning, rated, stretch_forces, stretch_slopes, stretch_tip)
from timo_sim.physics.equations.exact_tables import RateTables, Tables, TurningTables
from timo_sim.physics.equations.sincos import sincos
from timo_sim.physics.layout import (
    ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, SPEED, TIP_I, TIP_II, TIP_TORQUE,
    TIP_X, TIP_Y, TORQUE)


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
    rubs = some((tables.drag != 0.0) | (tables.coulomb[0, 0] != 0.0))
    for k in range(len(axes)):
        if axes[k] == 0:
            push_x = load[FORCE_X] + turned_x * load[FORCE_I] - turned_y * load[FORCE_II] + tip_x
            if rubs:
                push_x -= _resistance(tables, _carrier_rate(tables, state, k, c1, speed))
        else:
            push_y = load[FORCE_Y] + turned_y * load[FORCE_I] + turned_x * load[FORCE_II] + tip_y
            if rubs:
                push_y -= _resistance(tables, _carrier_rate(tables, state, k, c2, speed))
        out[k] = 0.0  # X' = P / m_t is in the linear part
        out[half + k] = push_x + weight[0] if axes[k] == 0 else push_y + weight[1]
    return push_x, push_y, tip_x, tip_y


@inlined
def _set_moments(tables, torque, forces, cosine, sine, a, b, image_1, image_2, speed, script_a,
                 script_b):
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
        work_x = lever[j] * push_x - reach[j] * tip_x
        work_y = lever[j] * push_y - reach[j] * tip_y
        script_a[j] = work_x * b[j] - work_y * a[j]
        script_b[j] = work_x * sine[j] - work_y * cosine[j] - turning * along
        moment += script_a[j]
        script_a[j] -= turning * (a[j] * g1 + b[j] * g2) + shearing * along
    return moment


@functions.rate.of(Tables, RateTables, TurningTables)
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
    moment = _set_moments(tables, torque, forces, cosine, sine, a, b, image_1, image_2, speed,
                          script_a, script_b)
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


@functions.observe.of(Tables, RateTables, TurningTables)
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


@functions.tip.of(Tables, RateTables, TurningTables)
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
