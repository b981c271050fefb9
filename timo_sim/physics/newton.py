"""
The `newton` formulation: the paper's equations, projected on the modes.

Numbers (T..) are those of doc/theory.md, section 3; plain ones are the paper's.

Deflection and rotation are expanded, `w = sum W_n q_n`, `phi = sum Phi_n q_n` (36); a point of the
centre line is at (xi, w) in the turning axes, so its acceleration is (26), (27). With M(xi), J(xi)
of Remark 1 and

    a_n = int M W_n     b_n = int (M xi W_n + J Phi_n)     c_n = int M xi W_n
    G_nl = int M W_n W_l     s = int M xi     J_0 = J_m + int (M xi^2 + J)     m_a = int M

(28), (29) projected on the modes and (33) are, with `alpha` and `beta` the carrier's acceleration
along axes I and II, and the modal stress `r_n = omega_n^2 q_n + 2 zeta_n omega_n q_n'`,

    J_0 theta'' + b.q'' + s beta = tau + theta'^2 c.q                    (T14)
    q_n'' + b_n theta'' + a_n beta = theta'^2 (G q)_n - r_n              (T10)

and the reactions of the root on the carrier, in (31), (32), are integrals over the arm:

    P(0) = -m_a alpha + theta'' a.q + 2 theta' a.q' + theta'^2 s         (T11)
    V(0) = -m_a beta - s theta'' - a.q'' + theta'^2 a.q                  (T12)

A force (F_1, F_2) and a torque T on the tip add `l F_2 - w(l) F_1 + T` to the first row,
`W_n(l) F_2 + Phi_n(l) T` to the others, F_1 to P(0) and F_2 to V(0) (T31).

The formulations derived from this one change rows of these tables, see `Laws`. The first two rows
have a constant matrix A for z = (theta'', q''). It is inverted once and leaves `z = z_0 - v beta`;
beta follows from (31), (32), of which the rows of the axes along which the carrier is held are
left out. Of a driven shaft theta'' is given, and its row is left out too. The state is the motion,
without what is held or driven.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.physics import etdrk4
from timo_sim.physics.compiled import inner, local
from timo_sim.physics.formulation import (
    ACCELERATION, ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, Formulation, SPEED, TIP_I, TIP_II,
    TIP_TORQUE, TIP_X, TIP_Y, TORQUE)
from timo_sim.physics.sincos import sincos


class Laws(NamedTuple):
    """
    Coefficients of the equations of motion, i, j = 0..N with the shaft first, n = 1..N.

    A_ij z_j + c_i beta = tau_i + theta'^2 S_in q_n - R_in r_n
    V(0) = -m_V beta - h_i z_i + theta'^2 U_n q_n + Y_n r_n
    P(0) = -m_a alpha + theta'' e.q + 2 theta' e.q' + theta'^2 s
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
    tip_share: float = 1.0      # of a load on the tip that shaft and V(0) see besides the modes


class Tables(NamedTuple):
    """Constants of the compiled functions, from `Laws`; N modes, n free of theta, q."""

    base_mass: float            # m_c + m_m
    arm_mass: float             # m_a
    lever: float                # s
    inverse: np.ndarray         # A^-1 of the free rows, (n, n)
    coupling: np.ndarray        # A_i0 of a driven shaft, (1 + N,)
    response: np.ndarray        # v = A^-1 c, (1 + N,)
    across: float               # m_V - h.v: V(0) per beta
    swing: np.ndarray           # theta'' per r_n, (N,)
    reaction: np.ndarray        # V(0) per r_n at beta = 0, (N,)
    in_linear: float            # share of beta per r_n that the linear part accounts for
    softening: np.ndarray       # S, (1 + N, N)
    shear_row: np.ndarray       # h, (1 + N,)
    shear_softening: np.ndarray  # U, (N,)
    axial: np.ndarray           # e, (N,)
    stiffness: np.ndarray       # omega_n^2, (N,)
    damping: np.ndarray         # 2 zeta_n omega_n, (N,)
    drag: np.ndarray            # c_c of the carrier, c_s of the shaft, (2,)
    axes: np.ndarray            # along which the carrier is free
    anchor: np.ndarray          # where it is held, (2,)
    length: float               # l
    tip_share: float            # of a load on the tip, see `Laws`
    sway: np.ndarray            # W_n at the tip, (N,)
    turn: np.ndarray            # Phi_n at the tip, (N,)


@inner
def _dot(left, right):
    total = 0.0
    for j in range(len(left)):
        total += left[j] * right[j]
    return total


@etdrk4.rate.of(Tables)
def _rate(tables, state, load, out):
    """Write what the linear part leaves of the state's rate."""
    axes, inverse, softening = tables.axes, tables.inverse, tables.softening
    rows, count = softening.shape
    first, half = rows - len(inverse), len(state) // 2
    modal = half - count
    q, qdot = local((tables.axial,)), local((tables.axial,))
    for n in range(count):
        q[n] = state[modal + n]
        qdot[n] = state[half + modal + n]
    if first == 0:
        theta, omega = state[modal - 1], state[half + modal - 1]
    else:
        theta, omega = load[ANGLE], load[SPEED]

    # A load on the tip, in turning axes, and its moment about the shaft.
    sine, cosine = sincos(theta)
    tip_1 = load[TIP_I] + cosine * load[TIP_X] + sine * load[TIP_Y]
    tip_2 = load[TIP_II] - sine * load[TIP_X] + cosine * load[TIP_Y]
    tip_moment = tables.tip_share * (
        load[TIP_TORQUE] + tables.length * tip_2 - _dot(tables.sway, q) * tip_1)

    # z_0, without the modal stress, which is in the linear part.
    force, z = local((softening,)), local((softening,))
    for i in range(first, rows):
        if i:
            force[i] = tables.sway[i - 1] * tip_2 + tables.turn[i - 1] * load[TIP_TORQUE]
        else:
            force[i] = load[TORQUE] - tables.drag[1] * omega + tip_moment
        for n in range(count):
            force[i] += omega**2 * softening[i, n] * q[n]
        if first == 1:
            force[i] -= tables.coupling[i] * load[ACCELERATION]
    z[0] = load[ACCELERATION]
    for i in range(first, rows):
        total = 0.0
        for j in range(first, rows):
            total += inverse[i - first, j - first] * force[j]
        z[i] = total

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

    # (T15), solved for the carrier's acceleration in world axes.
    tilt = bent * tables.response[0]  # -P(0) per beta
    force_x = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    force_y = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]
    for k in range(len(axes)):
        if axes[k] == 0:
            force_x -= tables.drag[0] * state[half + k]
        else:
            force_y -= tables.drag[0] * state[half + k]
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

    for i in range(half):
        out[i] = 0.0
    beta -= tables.in_linear * linear_shear
    for i in range(first, rows):
        out[half + modal - 1 + i] = z[i] - tables.response[i] * beta


@etdrk4.observe.of(Tables)
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


@etdrk4.tip.of(Tables)
def _tip(tables, motion, out):
    """Write where the tip is: at (l, w)."""
    out[0] = tables.length
    out[1] = 0.0
    out[2] = 0.0
    for n in range(len(tables.sway)):
        out[1] += motion[3 + n] * tables.sway[n]
        out[2] += motion[3 + n] * tables.turn[n]


class Newton(Formulation):
    """The `newton` formulation, see the module's text."""

    @staticmethod
    def node_count(count):
        """Return the number of quadrature nodes: only the tables need them, so they are many."""
        return 4 * count + 40

    @property
    def lever(self):
        """Static moment of the arm about its root, s [kg m]."""
        return self.point_mass @ self.points.xi

    @property
    def moment(self):
        """Modal static moments a_n, shape (N,)."""
        return self.points.deflection @ self.point_mass

    @property
    def gram(self):
        """Mass matrix of the deflection alone, G_nl, shape (N, N)."""
        return (self.points.deflection * self.point_mass) @ self.points.deflection.T

    def laws(self):
        """Return the coefficients of the equations of motion."""
        xi, mass, count = self.points.xi, self.point_mass, len(self.modes)
        about_root = self.points.deflection @ (mass * xi)
        matrix = np.eye(1 + count)
        matrix[0, 0] = (self.manipulator.shaft_inertia + mass @ xi**2 + self.point_inertia.sum())
        matrix[0, 1:] = matrix[1:, 0] = about_root + self.points.rotation @ self.point_inertia
        column = np.append(self.lever, self.moment)
        return Laws(matrix, column, np.vstack([about_root, self.gram]),
                    np.vstack([np.zeros(count), np.eye(count)]), self.arm_mass, column,
                    self.moment, np.zeros(count), self.moment)

    def build(self):
        """Return the tables and the linear part; set the speed limit."""
        if len(self.modes):
            # (T16): theta'^2 w acts as a negative stiffness, and the tension that would counter
            # it is not in the equations.
            weak = self.gram / np.outer(self.modes.omega, self.modes.omega)
            self.speed_limit = 1.0 / np.sqrt(np.linalg.eigvalsh(weak)[-1])
        laws, base_mass = self.laws(), self.manipulator.base_mass
        stiffness, damping = self.modes.omega**2, 2.0 * self.damping * self.modes.omega
        free, axes = slice(self.first, None), len(self.axes)
        inverse = np.linalg.inv(laws.matrix[free, free])
        response, per_stress = np.zeros_like(laws.column), np.zeros_like(laws.stress)
        response[free] = inverse @ laws.column[free]
        per_stress[free] = -inverse @ laws.stress[free]
        across = laws.shear_mass - laws.shear_row @ response
        reaction = laws.shear_stress - laws.shear_row @ per_stress
        # With one axis held, beta per stress depends on the shaft angle.
        in_linear = 1.0 / (base_mass + across) if axes == 2 else 0.0

        half, modal = axes + len(inverse), axes + len(inverse) - len(stiffness)
        rate = (per_stress - in_linear * np.outer(response, reaction))[free]
        linear = np.zeros((2 * half, 2 * half))
        linear[:half, half:] = np.eye(half)
        linear[half + axes:, modal:half] = rate * stiffness
        linear[half + axes:, half + modal:] = rate * damping
        tables = Tables(
            base_mass, self.arm_mass, self.lever, inverse, laws.matrix[:, 0], response,
            across, per_stress[0], reaction, in_linear, laws.softening, laws.shear_row,
            laws.shear_softening, laws.axial, stiffness, damping,
            np.array([self.manipulator.carrier_friction, self.manipulator.shaft_friction]),
            self.axes, self.anchor, self.manipulator.arm.length, laws.tip_share,
            self.points.deflection[:, -1], self.points.rotation[:, -1])
        return tables, linear

    def state(self, motion):
        """Return the state that belongs to a motion."""
        half = self.size // 2
        free = np.concatenate([self.axes, np.arange(2 + self.first, half)])
        return np.concatenate([motion[free], motion[half + free]])

    def centre_line(self, q, points):
        """Return the points (xi, w)."""
        across = q @ points.deflection
        return np.stack([np.broadcast_to(points.xi, across.shape), across], axis=-1)

    def centre_line_rate(self, q, qdot, points):
        """Return the rates (0, w')."""
        across = qdot @ points.deflection
        return np.stack([np.zeros_like(across), across], axis=-1)
