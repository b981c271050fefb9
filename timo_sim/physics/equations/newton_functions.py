# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Constants and compiled functions of `newton` and of the formulations derived from it.

Numbers (T..) are those of doc/theory.md, section 3; the text of `newton` has the equations.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.jit.choices import some
from timo_sim.jit.constants import local
from timo_sim.jit.decorators import inlined, inner
from timo_sim.physics.equations import functions
from timo_sim.physics.equations.sincos import sincos
from timo_sim.physics.layout import (
    ACCELERATION, ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, SPEED, TIP_I, TIP_II,
    TIP_TORQUE, TIP_X, TIP_Y, TORQUE)


class Tables(NamedTuple):
    """Constants of the compiled functions, from `newton.Laws`; N modes, n free of theta, q."""

    base_mass: float            # m_c + m_m
    arm_mass: float             # m_a
    lever: float                # s_a
    inverse: np.ndarray         # A^-1 of the free rows, (n, n)
    coupling: np.ndarray        # A_i0 of a driven shaft, (1 + N,)
    response: np.ndarray        # v = A^-1 c, (1 + N,)
    across: float               # m_V - h.v: V(0) per beta
    swing: np.ndarray           # theta'' per k_n, (N,)
    reaction: np.ndarray        # V(0) per k_n at beta = 0, (N,)
    in_linear: float            # beta per V(0) of the modal stress in the linear part, or 0
    softening: np.ndarray       # S, (1 + N, N)
    shear_row: np.ndarray       # h, (1 + N,)
    shear_softening: np.ndarray  # U, (N,)
    axial: np.ndarray           # e, (N,)
    stiffness: np.ndarray       # omega_n^2, (N,)
    damping: np.ndarray         # 2 zeta_n omega_n, (N,)
    drag: np.ndarray            # c_c of the carrier, c_s of the shaft, (2,)
    coulomb: np.ndarray         # `Manipulator.coulomb`, (2, 2)
    axes: np.ndarray            # axes along which the carrier is free
    anchor: np.ndarray          # position at which it is held, (2,)
    length: float               # l
    tip_share: float            # share of a load on the tip, see `Laws`
    sway: np.ndarray            # W_n at the tip, (N,)
    turn: np.ndarray            # Phi_n at the tip, (N,)
    gravity: np.ndarray         # g along world x and y, (2,)


@inner
def _dot(left, right):
    total = 0.0
    for j in range(len(left)):
        total += left[j] * right[j]
    return total


@inlined
def _resistance(tables, joint, speed):
    """Return the friction against a speed of the carrier, joint 0, or of the shaft, 1."""
    return tables.drag[joint] * speed + functions.coulomb(tables, joint, speed)


@inlined
def _set_z_0(tables, q, theta_rate, load, tip_2, tip_moment, force, z):
    """Set z_0: theta'' and q'' at beta = 0, without the modal stress (in the linear part)."""
    inverse, softening = tables.inverse, tables.softening
    rows, count = softening.shape
    first = rows - len(inverse)
    for i in range(first, rows):
        if i:
            force[i] = tables.sway[i - 1] * tip_2 + tables.turn[i - 1] * load[TIP_TORQUE]
        else:
            force[i] = load[TORQUE] - _resistance(tables, 1, theta_rate) + tip_moment
        for n in range(count):
            force[i] += theta_rate**2 * softening[i, n] * q[n]
        if first == 1:
            force[i] -= tables.coupling[i] * load[ACCELERATION]
    z[0] = load[ACCELERATION]
    for i in range(first, rows):
        total = 0.0
        for j in range(first, rows):
            total += inverse[i - first, j - first] * force[j]
        z[i] = total


@inlined
def _set_carrier(tables, state, load, cosine, sine, axial, shear, tilt, out):
    """Write the carrier's acceleration in world axes, (T16); return beta."""
    axes, half = tables.axes, len(state) // 2
    force_x = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    force_y = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]
    for k in range(len(axes)):
        if axes[k] == 0:
            force_x -= _resistance(tables, 0, state[half + k])
        else:
            force_y -= _resistance(tables, 0, state[half + k])
    beta = 0.0
    if len(axes) == 2:
        force_1 = cosine * force_x + sine * force_y
        force_2 = cosine * force_y - sine * force_x
        beta = (force_2 + shear) / (tables.base_mass + tables.across)
        alpha = (force_1 + axial - tilt * beta) / (tables.base_mass + tables.arm_mass)
        out[half] = cosine * alpha - sine * beta
        out[half + 1] = sine * alpha + cosine * beta
    elif len(axes) == 1:
        push, along, across = (force_x, cosine, -sine) if axes[0] == 0 else (force_y, sine, cosine)
        inertia = (tables.base_mass + along**2 * tables.arm_mass + along * across * tilt
                   + across**2 * tables.across)
        out[half] = (push + along * axial + across * shear) / inertia
        beta = across * out[half]
    return beta


@inlined
def _fall(tables, cosine, sine, tilt, out):
    """
    Add what gravity does, see doc/theory.md, section 10.

    Seen by who falls, a carrier that is held is accelerated against gravity, alpha and beta.
    """
    axes, half, gravity = tables.axes, len(out) // 2, tables.gravity
    held_x = 0.0 if len(axes) == 2 or len(axes) == 1 and axes[0] == 0 else -gravity[0]
    held_y = 0.0 if len(axes) == 2 or len(axes) == 1 and axes[0] == 1 else -gravity[1]
    alpha, beta = cosine * held_x + sine * held_y, cosine * held_y - sine * held_x
    if len(axes) == 1:
        along, across = (cosine, -sine) if axes[0] == 0 else (sine, cosine)
        inertia = (tables.base_mass + along**2 * tables.arm_mass + along * across * tilt
                   + across**2 * tables.across)
        pulled = -(along * (tables.arm_mass * alpha + tilt * beta)
                   + across * tables.across * beta) / inertia
        out[half] += pulled
        beta += across * pulled
    for k in range(len(axes)):
        out[half + k] += gravity[axes[k]]
    free = len(tables.inverse)
    for i in range(free):
        out[len(out) - free + i] -= tables.response[len(tables.response) - free + i] * beta


@functions.rate.of(Tables)
def _rate(tables, state, load, out):
    """Write the state's rate less its linear part."""
    rows, count = tables.softening.shape
    first, half = rows - len(tables.inverse), len(state) // 2
    modal = half - count
    q, qdot = local((tables.axial,)), local((tables.axial,))
    for n in range(count):
        q[n] = state[modal + n]
        qdot[n] = state[half + modal + n]
    if first == 0:
        theta, omega = state[modal - 1], state[half + modal - 1]
    else:
        theta, omega = load[ANGLE], load[SPEED]

    # Force on the tip in axes I, II; moment of the tip's load about the shaft.
    sine, cosine = sincos(theta)
    tip_1 = load[TIP_I] + cosine * load[TIP_X] + sine * load[TIP_Y]
    tip_2 = load[TIP_II] - sine * load[TIP_X] + cosine * load[TIP_Y]
    tip_moment = tables.tip_share * (
        load[TIP_TORQUE] + tables.length * tip_2 - _dot(tables.sway, q) * tip_1)
    force, z = local((tables.softening,)), local((tables.softening,))
    _set_z_0(tables, q, omega, load, tip_2, tip_moment, force, z)

    # P(0) and V(0) at alpha = beta = 0.
    swing = z[0]
    linear_shear = 0.0
    for n in range(count):
        stress = tables.stiffness[n] * q[n] + tables.damping[n] * qdot[n]
        swing += tables.swing[n] * stress
        linear_shear += tables.reaction[n] * stress
    bent = _dot(tables.axial, q)
    axial = (bent * swing + 2.0 * omega * _dot(tables.axial, qdot) + omega**2 * tables.lever
             + tip_1)
    shear = (linear_shear - _dot(tables.shear_row, z) + omega**2 * _dot(tables.shear_softening, q)
             + tables.tip_share * tip_2)
    tilt = bent * tables.response[0]  # -P(0) per beta
    beta = _set_carrier(tables, state, load, cosine, sine, axial, shear, tilt, out)

    for i in range(half):
        out[i] = 0.0
    beta -= tables.in_linear * linear_shear
    for i in range(first, rows):
        out[half + modal - 1 + i] = z[i] - tables.response[i] * beta
    if some((tables.gravity[0] != 0.0) | (tables.gravity[1] != 0.0)):
        _fall(tables, cosine, sine, tilt, out)


@functions.observe.of(Tables)
def _observe(tables, state, load, out):
    """Write the motion of a state."""
    parts = (0, 0), (len(state) // 2, len(out) // 2)
    for k in range(2):
        source, goal = parts[k]
        for axis in range(2):
            out[goal + axis] = 0.0 if k else tables.anchor[axis]
        for j in range(len(tables.axes)):
            out[goal + tables.axes[j]] = state[source + j]
        out[goal + 2] = load[SPEED] if k else load[ANGLE]
        first = len(tables.softening) - len(tables.inverse)
        for i in range(first, len(tables.softening)):
            out[goal + 2 + i] = state[source + len(tables.axes) + i - first]


@functions.tip.of(Tables)
def _tip(tables, motion, out):
    """Write the tip's position (l, w), and its rotation."""
    out[0] = tables.length
    out[1] = 0.0
    out[2] = 0.0
    for n in range(len(tables.sway)):
        out[1] += motion[3 + n] * tables.sway[n]
        out[2] += motion[3 + n] * tables.turn[n]
