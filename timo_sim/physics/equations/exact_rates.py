# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Additions to the compiled functions of `exact` for coordinates with rates in place of momenta.

These coordinates are the axial ones or, with one axis of the carrier held and no axial ones, all
free ones. Numbers (T..) are those of doc/theory.md, section 6.
"""

import math

from timo_sim.jit.constants import local
from timo_sim.jit.decorators import inner, optional
from timo_sim.physics.equations import functions
from timo_sim.physics.equations.exact_tables import (
    BANDS, RateTables, SECTORS, TurningTables)
from timo_sim.physics.equations.sincos import sincos
from timo_sim.physics.layout import ACCELERATION, ANGLE, SPEED, TIP_TORQUE


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


@functions.holds.of(RateTables, TurningTables)
def _holds(tables, state, load):
    if tables.sector < 0:
        return True
    driven = len(tables.rotation) > len(tables.straight)
    number = sector(load[ANGLE] if driven else state[len(tables.axes)])
    return number + SECTORS * band(tables, state, load) == tables.sector


@band.of(TurningTables)
def _band(tables, state, load):
    driven = len(tables.rotation) > len(tables.straight)
    speed = load[SPEED] if driven else state[len(state) // 2 + len(tables.axes)]
    return min(max(math.floor(speed * tables.pace), -BANDS), BANDS - 1) + BANDS


@leave_out_turning.of(TurningTables)
def _leave_out_turning(tables, state, out):
    for i in range(len(out)):
        total = 0.0
        for j in range(len(out)):
            total += tables.turning[i, j] * state[j]
        out[i] -= total


@stretch_slopes.of(RateTables, TurningTables)
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


@rated.of(RateTables, TurningTables)
def _rated(tables):
    return len(tables.linear_rate)


@known_rates.of(RateTables, TurningTables)
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


@stretch_forces.of(RateTables, TurningTables)
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
            work_x = tables.reach[j] * tip_x - lever[j] * push_x
            work_y = tables.reach[j] * tip_y - lever[j] * push_y
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


@stretch_tip.of(RateTables, TurningTables)
def _tip(tables, motion, out):
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
