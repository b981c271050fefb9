# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The `newton` formulation: the paper's equations, projected on the modes.

Numbers (T..) are those of doc/theory.md, section 3; plain ones are the paper's.

Deflection and rotation are expanded, `w = sum W_n q_n`, `phi = sum Phi_n q_n` (36); a point of the
centre line is at (xi, w) in the turning axes, so its acceleration is (26), (27). With M(xi), J(xi)
of Remark 1 and

    a_n = int M W_n     b_n = int (M xi W_n + J Phi_n)     c_n = int M xi W_n
    G_nl = int M W_n W_l    s_a = int M xi    J_0 = J_m + int (M xi^2 + J)     m_a = int M

let `alpha` and `beta` be the carrier's acceleration along axes I and II, and
`k_n = omega_n^2 q_n + 2 zeta_n omega_n q_n'` the modal stress. Then (33) and the projections of
(28), (29) on the modes are

    J_0 theta'' + b.q'' + s_a beta = tau + theta'^2 c.q                  (T15)
    q_n'' + b_n theta'' + a_n beta = theta'^2 (G q)_n - k_n              (T11)

and the reactions of the root on the carrier, in (31), (32), are integrals over the arm:

    P(0) = -m_a alpha + theta'' a.q + 2 theta' a.q' + theta'^2 s_a       (T12)
    V(0) = -m_a beta - s_a theta'' - a.q'' + theta'^2 a.q                (T13)

A force (F_1, F_2) and a torque tau_e on the tip add `l F_2 - w(l) F_1 + tau_e` to the first row,
`W_n(l) F_2 + Phi_n(l) tau_e` to the others, F_1 to P(0) and F_2 to V(0) (T17).

A hub of radius r_h puts `r_h + xi`, the lever of a point, in place of xi in these integrals, and
`r_h + l` in place of l (doc/theory.md, section 11).

The formulations derived from this one change coefficients of these equations, see `Laws`. (T15)
and (T11) have a constant matrix A for z = (theta'', q''). It is inverted once, so that
`z = z_0 - v beta`. beta follows from (31), (32), without the rows of axes along which the carrier
is held. A driven shaft has no row, since its theta'' is given. The state is the motion without the
coordinates that are held or driven.
"""

from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from timo_sim.compiled.functions import inner, local
from timo_sim.model import functions
from timo_sim.model.formulation import Formulation, Points
from timo_sim.model.functions import copy, DRAG, PER_COORDINATE, sincos
from timo_sim.model.layout import (
    ACCELERATION, ACCELERATION_X, ACCELERATION_Y, ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y,
    PUSH_X, PUSH_Y, rotate, SHAFT_FRICTION, SPEED, TIP_I, TIP_II, TIP_TORQUE, TIP_X, TIP_Y)


class Laws(NamedTuple):
    """
    Coefficients of the equations of motion, i, j = 0..N with the shaft first, n = 1..N.

    A_ij z_j + c_i beta = tau_i + theta'^2 S_in q_n - R_in k_n
    V(0) = -m_V beta - h_i z_i + theta'^2 U_n q_n + Y_n k_n
    P(0) = -m_a alpha + theta'' e.q + 2 theta' e.q' + theta'^2 s_a
    """

    matrix: np.ndarray          # A, (1 + N, 1 + N)
    column: np.ndarray          # c, (1 + N,)
    softening: np.ndarray       # S, (1 + N, N)
    stress: np.ndarray          # R, (1 + N, N)
    shear_mass: float           # m_V
    shear_row: np.ndarray       # h, (1 + N,)
    shear_softening: np.ndarray  # U, (N,)
    shear_stress: np.ndarray    # Y, (N,)
    axial: np.ndarray           # e, (N,)


class Newton(Formulation):
    """The `newton` formulation, see the module's text."""

    @staticmethod
    def node_count(count: int, shapes: bool = False) -> int:
        """Return the number of quadrature nodes; they are many, since no step evaluates them."""
        return 4 * count + 40

    @staticmethod
    def mass_count(nodes: int) -> int:
        """Return the number of points that carry mass, that of the nodes."""
        return nodes

    @property
    def first_moment(self) -> float:
        """First moment of the arm's mass about the shaft's axis, s_a [kg m]."""
        return self.point_mass @ self.centres.lever

    @property
    def modal_moments(self) -> np.ndarray:
        """Integrals a_n of mass times deflection, shape (N,)."""
        return self.centres.deflection @ self.point_mass

    @property
    def deflection_mass(self) -> np.ndarray:
        """Mass matrix of the deflection alone, G_nl, shape (N, N)."""
        return (self.centres.deflection * self.point_mass) @ self.centres.deflection.T

    @property
    def turning_mass(self) -> np.ndarray:
        """Mass matrix of shaft and modes at a straight arm, shape (1 + N, 1 + N)."""
        lever, mass, inertia = self.centres.lever, self.point_mass, self.point_inertia
        deflection, rotation = self.centres.deflection, self.points.rotation
        matrix = np.empty((1 + len(self.modes), 1 + len(self.modes)))
        matrix[1:, 1:] = self.deflection_mass + (rotation * inertia) @ rotation.T
        matrix[0, 0] = self.manipulator.shaft_inertia + mass @ lever**2 + inertia.sum()
        matrix[0, 1:] = matrix[1:, 0] = deflection @ (mass * lever) + rotation @ inertia
        return matrix + self.rotor_matrix[2:, 2:] if self.gear else matrix  # (T60)

    def laws(self) -> Laws:
        """Return the coefficients of the equations of motion."""
        count, matrix = len(self.modes), self.turning_mass
        about_shaft = self.centres.deflection @ (self.point_mass * self.centres.lever)
        if self.own_modes:
            matrix[1:, 1:] = np.eye(count)
        column = np.append(self.first_moment, self.modal_moments)
        return Laws(matrix=matrix, column=column,
                    softening=np.vstack([about_shaft, self.deflection_mass]),
                    stress=np.vstack([np.zeros(count), np.eye(count)]), shear_mass=self.arm_mass,
                    shear_row=column, shear_softening=self.modal_moments,
                    shear_stress=np.zeros(count), axial=self.modal_moments)

    def build(self) -> tuple[Any, np.ndarray]:
        """Return the tables and the linear part; set the speed limit."""
        if len(self.modes) > bool(self.gear):
            # (T19): theta'^2 w acts as a negative stiffness, and the tension that would counter
            # it is not in the equations.
            weak = self.deflection_mass / np.outer(self.modes.omega, self.modes.omega)
            self.speed_limit = 1.0 / np.sqrt(np.linalg.eigvalsh(weak)[-1])
        laws, base_mass = self.laws(), self.manipulator.base_mass
        deflection, rotation = self.points.deflection, self.points.rotation
        turning_mass = self.turning_mass
        stiffness, damping = self.modes.omega**2, 2.0 * self.damping * self.modes.omega
        free, axes = slice(self.driven, None), len(self.axes)
        inverse = np.linalg.inv(laws.matrix[free, free])
        response, per_stress = np.zeros_like(laws.column), np.zeros_like(laws.stress)
        response[free] = inverse @ laws.column[free]
        per_stress[free] = -inverse @ laws.stress[free]
        mass_across = laws.shear_mass - laws.shear_row @ response
        shear_per_stress = laws.shear_stress - laws.shear_row @ per_stress
        # With one axis held beta per stress depends on the shaft angle: not in the linear part.
        linear_beta = 1.0 / (base_mass + mass_across) if axes == 2 else 0.0

        # L by blocks: z by the modal stresses k_n = omega_n^2 q_n + 2 zeta_n omega_n q_n'.
        half, modal = axes + len(inverse), axes + len(inverse) - len(stiffness)
        rate = (per_stress - linear_beta * np.outer(response, shear_per_stress))[free]
        linear = np.zeros((2 * half, 2 * half))
        linear[:half, half:] = np.eye(half)
        linear[half + axes:, modal:half] = rate * stiffness
        linear[half + axes:, half + modal:] = rate * damping
        gear, drag = self.gear_row, np.empty((0, 2))
        if self.gear:  # the viscous friction of the rotor
            turns = self.rotor[2:]
            slowing = -self.gear.friction * inverse @ turns
            shear = -laws.shear_row @ slowing
            linear[half + axes:, half + axes:] += np.outer(
                slowing - linear_beta * response * shear, turns)
            drag = np.array([[slowing[0], shear]])
        spring = np.zeros((len(self.manipulator.spring), 4))
        spring[:, :2] = np.reshape(self.manipulator.spring, (-1, 2))
        if len(spring) and not self.driven:
            turned = -spring[0, 0] * inverse[:, 0]
            spring[0, 2:] = turned[0], -laws.shear_row @ turned
            linear[half + axes:, axes] += turned - linear_beta * response * spring[0, 3]
        tables = Tables(
            **self._of_masses(laws), base_mass=base_mass, inverse=inverse,
            coupling=laws.matrix[:, 0], response=response, mass_across=mass_across,
            shaft_per_stress=per_stress[0], shear_per_stress=shear_per_stress,
            linear_beta=linear_beta, stiffness=stiffness, damping=damping,
            viscous_friction=np.array(
                [self.manipulator.carrier_friction, self.manipulator.shaft_friction]),
            coulomb=np.array(self.manipulator.coulomb),
            motor_limit=np.reshape(self.manipulator.motor_limit, (-1, 2)), axes=self.axes,
            places=self.free_places, held_position=self.held_position,
            length=self.points.lever[-1], tip_deflection=deflection[:, -1],
            tip_rotation=rotation[:, -1], gravity=self.gravity,
            push_place=self.push_point.lever[0] if self.push_point else 0.0,
            push_deflection=self.push_point.deflection.T if self.push_point else (
                np.empty((0, len(stiffness)))),
            gear=gear, rotor_drag=drag, spring=spring, inertia=turning_mass[0, 0],
            moments=self.modal_moments, about_root=turning_mass[0, 1:],
            deflection_mass=self.deflection_mass, modal_mass=turning_mass[1:, 1:])
        return tables, linear

    def tables_at(self, tip: Points) -> Any:
        """Return tables whose tip is at a point."""
        return self.tables._replace(length=tip.lever[0], tip_deflection=tip.deflection[:, 0],
                                    tip_rotation=tip.rotation[:, 0])

    def tables_of_masses(self) -> Any:
        """Return the tables with other masses at other points, of an arm without a base."""
        return self.tables._replace(**self._of_masses(Newton.laws(self)), base_mass=0.0)

    def _of_masses(self, laws):
        return {'arm_mass': self.arm_mass, 'first_moment': self.first_moment,
                'softening': laws.softening, 'shear_row': laws.shear_row, 'axial': laws.axial,
                'shear_mass': laws.shear_mass, 'shear_softening': laws.shear_softening,
                'shaft_row': laws.matrix[0], 'shaft_column': laws.column[0],
                'shaft_stress': laws.stress[0], 'shear_stress': laws.shear_stress}

    @cached_property
    def _tension(self):
        # Geometric stiffness of the first mode per axial force on the tip and on the arm, per
        # alpha, and per squared shaft speed.
        _, rotation, _, shear, *_ = self.at_nodes
        slope = np.append(rotation[:, 0] + shear[:, 0], self.points.rotation[0, -1])[
            :len(self.points.integral)]
        inboard = self.centres.integral.T @ slope**2
        mass, pull = self.point_mass, self.points.integral[:, -1] @ slope**2
        push = self.push_point.integral[:, 0] @ slope**2 if self.push_point else 0.0
        return np.array([pull, push, -mass @ inboard, (mass * self.centres.lever) @ inboard])

    def axial_share(self, state: np.ndarray, load: np.ndarray) -> float:
        """
        Return the geometric stiffness that the equations lack, over that of the first mode (T18).

        It is the stiffness by the axial force at a state and a load that acts, negative in
        compression; below -1 the arm would buckle.
        """
        half, axes = len(state) // 2, list(self.axes)
        angle, speed = (load[ANGLE], load[SPEED]) if self.driven else (
            state[len(axes)], state[half + len(axes)])
        acceleration = load[[ACCELERATION_X, ACCELERATION_Y]]
        acceleration[axes] = self.rate(state, load)[half:half + len(axes)]
        alpha, _ = rotate(-angle, *(acceleration - self.gravity))
        pull, _ = rotate(-angle, load[TIP_X], load[TIP_Y])
        push, _ = rotate(-angle, load[PUSH_X], load[PUSH_Y])
        return float(self._tension @ [load[TIP_I] + pull, push, alpha, speed**2]
                     / self.modes.omega[0]**2)

    def centre_line(self, q: np.ndarray, points: Points) -> np.ndarray:
        """Return the points (r_h + xi, w)."""
        deflection = q @ points.deflection
        return np.stack([np.broadcast_to(points.lever, deflection.shape), deflection], axis=-1)

    def centre_line_rate(self, q: np.ndarray, qdot: np.ndarray, points: Points) -> np.ndarray:
        """Return the rates (0, w')."""
        rate = qdot @ points.deflection
        return np.stack([np.zeros_like(rate), rate], axis=-1)


# Compiled functions. A driven or locked shaft, `driven` = 1, has no equation of its own: the rows
# begin at q_1.

class Tables(NamedTuple):
    """
    Constants of the compiled functions, from `newton.Laws`.

    Sizes: N `modes`, 1 + N `coordinates`, of which n are `free`; `axes` along which the carrier is
    free; `pushes` is 1 if a force may act on the arm, else 0, `limits` if the motor's current has
    a limit, `springs` if one holds the shaft, and `gears` if the gear is elastic, whose coordinate
    is the last one.
    """

    base_mass: float     # m_c + m_m
    arm_mass: float      # m_a
    first_moment: float  # s_a
    inverse: Annotated[np.ndarray, 'free', 'free']         # A^-1 of the free rows
    coupling: Annotated[np.ndarray, 'coordinates']         # A_i0 of a driven shaft
    response: Annotated[np.ndarray, 'coordinates']         # v = A^-1 c
    mass_across: float   # m_V - h.v: -V(0) per beta
    shaft_per_stress: Annotated[np.ndarray, 'modes']       # theta'' per k_n
    shear_per_stress: Annotated[np.ndarray, 'modes']       # V(0) per k_n at beta = 0
    linear_beta: float   # beta per V(0) of the modal stress in the linear part, or 0
    softening: Annotated[np.ndarray, 'coordinates', 'modes']  # S
    shear_row: Annotated[np.ndarray, 'coordinates']        # h
    shear_softening: Annotated[np.ndarray, 'modes']        # U
    axial: Annotated[np.ndarray, 'modes']                  # e
    stiffness: Annotated[np.ndarray, 'modes']              # omega_n^2
    damping: Annotated[np.ndarray, 'modes']                # 2 zeta_n omega_n
    viscous_friction: Annotated[np.ndarray, 2]             # c_c of the carrier, c_s of the shaft
    coulomb: Annotated[np.ndarray, 3, 3]                   # `Manipulator.coulomb`
    motor_limit: Annotated[np.ndarray, 'limits', 2]        # `Manipulator.motor_limit`
    axes: Annotated[np.ndarray, int, 'axes']               # axes along which the carrier is free
    places: Annotated[np.ndarray, int, 'state']            # `Formulation.free_places`
    held_position: Annotated[np.ndarray, 2]                # of a carrier that is held
    length: float        # r_h + l
    tip_deflection: Annotated[np.ndarray, 'modes']         # W_n at the tip
    tip_rotation: Annotated[np.ndarray, 'modes']           # Phi_n at the tip
    gravity: Annotated[np.ndarray, 2]                      # g along world x and y
    push_place: float    # distance from the shaft's axis to where a force acts on the arm
    push_deflection: Annotated[np.ndarray, 'pushes', 'modes']  # W_n there
    gear: Annotated[np.ndarray, 'gears', 3]                # `Formulation.gear_row`
    # theta'' and V(0) per speed of the rotor, by its viscous friction
    rotor_drag: Annotated[np.ndarray, 'gears', 2]
    # `Manipulator.spring`, then theta'' and V(0) per angle
    spring: Annotated[np.ndarray, 'springs', 4]
    # For forces of constraints and energy alone:
    inertia: float       # about the shaft's axis, with the shaft's and the rotor's
    shear_mass: float    # m_V
    shaft_row: Annotated[np.ndarray, 'coordinates']        # A_0j
    shaft_column: float  # c_0
    shaft_stress: Annotated[np.ndarray, 'modes']           # R_0n
    shear_stress: Annotated[np.ndarray, 'modes']           # Y
    moments: Annotated[np.ndarray, 'modes']                # a_n
    about_root: Annotated[np.ndarray, 'modes']             # b_n
    deflection_mass: Annotated[np.ndarray, 'modes', 'modes']  # G
    modal_mass: Annotated[np.ndarray, 'modes', 'modes']    # G and the rotary inertia


# A force on the arm. Without one it is -0.0, the neutral element of addition, so that LLVM removes
# the additions.

@inner
def _push(tables, q, load, cosine, sine):
    """Return the force on the arm along axes I, II, and its moment about the shaft."""
    along, across, moment = -0.0, -0.0, -0.0
    if len(tables.push_deflection):
        along = cosine * load[PUSH_X] + sine * load[PUSH_Y]
        across = cosine * load[PUSH_Y] - sine * load[PUSH_X]
        moment = tables.push_place * across - _dot(tables.push_deflection[0], q) * along
    return along, across, moment


@inner
def _dot(left, right):
    total = 0.0
    for j in range(len(left)):
        total += left[j] * right[j]
    return total


@inner
def _resistance(tables, joint, speed):
    """Return the friction against a speed of the carrier, joint 0, or of the shaft, 1."""
    return tables.viscous_friction[joint] * speed + functions.coulomb(tables, joint, speed)


@inner
def _rotor_speed(tables, n, theta_rate, qdot):
    return theta_rate + tables.gear[n, PER_COORDINATE] * qdot[len(qdot) - 1]


@inner
def _set_z_0(tables, q, qdot, theta_rate, load, tip_2, push_2, moment, force, z):
    """Set z_0: theta'' and q'' at beta = 0, less what is in the linear part by itself."""
    inverse, softening = tables.inverse, tables.softening
    rows, count = softening.shape
    driven = rows - len(inverse)
    on_rotor = functions.rotor_torque(tables, load, theta_rate, qdot, count - 1)
    for n in range(len(tables.gear)):
        on_rotor += tables.gear[n, DRAG] * _rotor_speed(tables, n, theta_rate, qdot)
    for i in range(driven, rows):
        if i:
            force[i] = (tables.tip_deflection[i - 1] * tip_2
                        + tables.tip_rotation[i - 1] * load[TIP_TORQUE])
            for k in range(len(tables.push_deflection)):
                force[i] += tables.push_deflection[k, i - 1] * push_2
        else:
            force[i] = on_rotor - _resistance(tables, 1, theta_rate) + moment
            for _ in range(len(tables.gear)):
                force[i] += load[SHAFT_FRICTION]
            for n in range(len(tables.spring)):
                force[i] += tables.spring[n, 0] * tables.spring[n, 1]
        for n in range(count):
            force[i] += theta_rate * theta_rate * softening[i, n] * q[n]
        if driven:
            force[i] -= tables.coupling[i] * load[ACCELERATION]
    for n in range(len(tables.gear)):  # (T61), (T62)
        force[count] += tables.gear[n, PER_COORDINATE] * on_rotor + functions.missing_contact(
            tables, n, count - 1, q, qdot)
    z[0] = load[ACCELERATION]
    for i in range(driven, rows):
        total = 0.0
        for j in range(driven, rows):
            total += inverse[i - driven, j - driven] * force[j]
        z[i] = total


@inner
def _set_carrier(tables, state, load, cosine, sine, axial, shear, tilt, out):
    """
    Write the carrier's acceleration in world axes, (T16); return beta.

    Forces are those at alpha = beta = 0. In a freely falling frame gravity vanishes, see
    doc/theory.md, section 10: beta is seen there, and a held carrier accelerates by a - g.
    """
    axes, half, gravity = tables.axes, len(tables.places) // 2, tables.gravity
    force_x = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    force_y = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]
    held_x, held_y = load[ACCELERATION_X] - gravity[0], load[ACCELERATION_Y] - gravity[1]
    for k in range(len(axes)):
        if axes[k] == 0:
            force_x -= _resistance(tables, 0, state[half + k])
            held_x = 0.0
        else:
            force_y -= _resistance(tables, 0, state[half + k])
            held_y = 0.0
    if len(axes) == 2:
        force_1 = cosine * force_x + sine * force_y
        force_2 = cosine * force_y - sine * force_x
        beta = (force_2 + shear) / (tables.base_mass + tables.mass_across)
        alpha = (force_1 + axial - tilt * beta) / (tables.base_mass + tables.arm_mass)
        out[half] = cosine * alpha - sine * beta
        out[half + 1] = sine * alpha + cosine * beta
    else:
        alpha, beta = cosine * held_x + sine * held_y, cosine * held_y - sine * held_x
    if len(axes) == 1:
        along, across = (cosine, -sine) if axes[0] == 0 else (sine, cosine)
        inertia = (tables.base_mass + along * along * tables.arm_mass + along * across * tilt
                   + across * across * tables.mass_across)
        push = force_x if axes[0] == 0 else force_y
        out[half] = (push + along * (axial - tables.arm_mass * alpha - tilt * beta)
                     + across * (shear - tables.mass_across * beta)) / inertia
        beta += across * out[half]
    for k in range(len(axes)):
        out[half + k] += gravity[axes[k]]
    return beta


@functions.rate.of(Tables, merge=True)
def _rate(tables, state, load, out):
    """Write the state's rate less its linear part."""
    rows, count = tables.softening.shape
    driven, half = rows - len(tables.inverse), len(tables.places) // 2
    modal = half - count
    q, qdot = local((tables.axial,)), local((tables.axial,))
    for n in range(count):
        q[n] = state[modal + n]
        qdot[n] = state[half + modal + n]
    if driven == 0:
        theta, omega = state[modal - 1], state[half + modal - 1]
    else:
        theta, omega = load[ANGLE], load[SPEED]

    # Force on the tip in axes I, II; moment of the tip's load about the shaft.
    sine, cosine = sincos(theta)
    tip_1 = load[TIP_I] + cosine * load[TIP_X] + sine * load[TIP_Y]
    tip_2 = load[TIP_II] - sine * load[TIP_X] + cosine * load[TIP_Y]
    tip_moment = load[TIP_TORQUE] + tables.length * tip_2 - _dot(tables.tip_deflection, q) * tip_1
    push_1, push_2, push_moment = _push(tables, q, load, cosine, sine)
    force, z = local((tables.softening,)), local((tables.softening,))
    _set_z_0(tables, q, qdot, omega, load, tip_2, push_2, tip_moment + push_moment, force, z)

    # P(0) (T12) and V(0) (T13) at alpha = beta = 0; theta'' with the modal stress.
    theta_acceleration = z[0]
    linear_shear = 0.0
    for n in range(count):
        stress = tables.stiffness[n] * q[n] + tables.damping[n] * qdot[n]
        theta_acceleration += tables.shaft_per_stress[n] * stress
        linear_shear += tables.shear_per_stress[n] * stress
    for n in range(len(tables.gear)):
        rotor = _rotor_speed(tables, n, omega, qdot)
        theta_acceleration += tables.rotor_drag[n, 0] * rotor
        linear_shear += tables.rotor_drag[n, 1] * rotor
    for n in range(len(tables.spring)):
        theta_acceleration += tables.spring[n, 2] * theta
        linear_shear += tables.spring[n, 3] * theta
    bent = _dot(tables.axial, q)
    axial = (bent * theta_acceleration + 2.0 * omega * _dot(tables.axial, qdot)
             + omega * omega * tables.first_moment + tip_1 + push_1)
    shear = (linear_shear - _dot(tables.shear_row, z)
             + omega * omega * _dot(tables.shear_softening, q) + tip_2 + push_2)
    tilt = bent * tables.response[0]  # -P(0) per beta
    beta = _set_carrier(tables, state, load, cosine, sine, axial, shear, tilt, out)

    for i in range(half):
        out[i] = 0.0
    beta -= tables.linear_beta * linear_shear
    for i in range(driven, rows):
        out[half + modal - 1 + i] = z[i] - tables.response[i] * beta


@functions.linear_part_is_valid.of(Tables)
def _linear_part_is_valid(tables, state, load):
    return True


@functions.observe.of(Tables)
def _observe(tables, state, load, out):
    """Write the motion of a state."""
    half = len(out) // 2
    for i in range(len(out)):
        out[i] = 0.0
    copy(tables.held_position, out)
    out[2], out[half + 2] = load[ANGLE], load[SPEED]
    if len(tables.axes) < 2:
        functions.add_base(load, half, out)
    for i in range(len(tables.places)):
        out[tables.places[i]] = state[i]


@functions.state_of.of(Tables)
def _state_of(tables, motion, out):
    """Write the motion's free coordinates and their rates."""
    for i in range(len(tables.places)):
        out[i] = motion[tables.places[i]]


@functions.joint_place.of(Tables, merge=True)
def _joint_place(tables, state, load, joint):
    """Return the place of a joint, a number of the state if it is free."""
    found = 0.0
    if joint >= 2:
        found = (load[ANGLE] if len(tables.softening) > len(tables.inverse)
                 else state[len(tables.axes)])
        if joint == 2:
            for n in range(len(tables.gear)):
                found += tables.gear[n, PER_COORDINATE] * state[len(tables.places) // 2 - 1]
    else:
        for k in range(len(tables.axes)):
            if tables.axes[k] == joint:
                found = state[k]
    return found


@functions.effort.of(Tables)
def _effort(tables, motion, accelerations, load, out):
    """Write what (T15) and (T16) need, with P(0), V(0) of this formulation (T44)."""
    rates, count = len(motion) // 2, len(tables.axial)
    sine, cosine = sincos(motion[2])
    omega, turn = motion[rates + 2], accelerations[2]
    alpha = cosine * accelerations[0] + sine * accelerations[1]
    beta = cosine * accelerations[1] - sine * accelerations[0]
    tip_1 = load[TIP_I] + cosine * load[TIP_X] + sine * load[TIP_Y]
    tip_2 = load[TIP_II] + cosine * load[TIP_Y] - sine * load[TIP_X]
    axial = tip_1 - tables.arm_mass * alpha + omega * omega * tables.first_moment
    shear = tip_2 - tables.shear_mass * beta - turn * tables.shear_row[0]
    torque = turn * tables.shaft_row[0] + tables.shaft_column * beta
    bent = 0.0
    for n in range(count):
        q, qdot = motion[3 + n], motion[rates + 3 + n]
        stress = tables.stiffness[n] * q + tables.damping[n] * qdot
        axial += tables.axial[n] * (turn * q + 2.0 * omega * qdot)
        shear += (tables.shear_stress[n] * stress - tables.shear_row[1 + n] * accelerations[3 + n]
                  + omega * omega * tables.shear_softening[n] * q)
        torque += (tables.shaft_row[1 + n] * accelerations[3 + n] + tables.shaft_stress[n] * stress
                   - omega * omega * tables.softening[0, n] * q)
        bent += tables.tip_deflection[n] * q
    out[0] = tables.base_mass * accelerations[0] - (cosine * axial - sine * shear)
    out[1] = tables.base_mass * accelerations[1] - (sine * axial + cosine * shear)
    out[2] = torque - (load[TIP_TORQUE] + tables.length * tip_2 - bent * tip_1)
    for k in range(len(tables.push_deflection)):
        along, across = tables.push_place, 0.0
        for n in range(count):
            across += tables.push_deflection[k, n] * motion[3 + n]
        x, y = cosine * along - sine * across, sine * along + cosine * across
        out[0] -= load[PUSH_X]
        out[1] -= load[PUSH_Y]
        out[2] -= x * load[PUSH_Y] - y * load[PUSH_X]


@functions.energy.of(Tables)
def _energy(tables, motion, gravity):
    momenta, mass = local((motion,)), tables.base_mass + tables.arm_mass
    _momenta(tables, motion, momenta)
    sine, cosine = sincos(motion[2])
    moment = 0.0  # of the mass across the arm
    for n in range(len(tables.moments)):
        moment += tables.moments[n] * motion[3 + n]
    return functions.energy_of_momenta(tables, 0, motion, momenta) - (
        gravity[0] * (mass * motion[0] + cosine * tables.first_moment - sine * moment)
        + gravity[1] * (mass * motion[1] + sine * tables.first_moment + cosine * moment))


@functions.momenta.of(Tables)
def _momenta(tables, motion, out):
    """Write the derivatives of the kinetic energy by the rates."""
    rates, count = len(motion) // 2, len(tables.axial)
    sine, cosine = sincos(motion[2])
    mass, omega = tables.base_mass + tables.arm_mass, motion[rates + 2]
    x, y = motion[rates], motion[rates + 1]
    along, across = cosine * x + sine * y, cosine * y - sine * x
    moment, moment_rate = 0.0, 0.0  # of the mass across the arm
    spin = omega * tables.inertia + across * tables.first_moment
    for n in range(count):
        q, qdot = motion[3 + n], motion[rates + 3 + n]
        moment += tables.moments[n] * q
        moment_rate += tables.moments[n] * qdot
        spin += tables.about_root[n] * qdot
        out[3 + n] = omega * tables.about_root[n] + across * tables.moments[n]
        for k in range(count):
            spin += omega * q * tables.deflection_mass[n, k] * motion[3 + k]
            out[3 + n] += tables.modal_mass[n, k] * motion[rates + 3 + k]
    out[2] = spin - along * moment
    along, across = (mass * along - omega * moment,
                     mass * across + moment_rate + omega * tables.first_moment)
    out[0], out[1] = cosine * along - sine * across, sine * along + cosine * across


@inner
def _bend(tables, values, begin, out):
    """Write deflection and rotation of the tip by modal coordinates, or rates."""
    out[1], out[2] = 0.0, 0.0
    for n in range(len(tables.tip_deflection)):
        out[1] += values[begin + n] * tables.tip_deflection[n]
        out[2] += values[begin + n] * tables.tip_rotation[n]


@functions.tip_rate.of(Tables)
def _tip_rate(tables, motion, out):
    """Write the rate of the tip's place and rotation."""
    out[0] = 0.0
    _bend(tables, motion, len(motion) // 2 + 3, out)


@functions.tip.of(Tables)
def _tip(tables, motion, out):
    """Write the tip's position (r_h + l, w), and its rotation."""
    out[0] = tables.length
    _bend(tables, motion, 3, out)


@functions.place_point.of(Tables)
def _place_point(tables, outline, number, motion, out):
    """Write the position of a point, (r_h + xi, w)."""
    out[0] = outline.lever[number]
    out[1] = 0.0
    for n in range(len(outline.deflection)):
        out[1] += motion[3 + n] * outline.deflection[n, number]
