"""
The `exact` formulation: geometrically exact kinematics on assumed strain modes.

Numbers (T..) are those of doc/theory.md, section 6.

Section rotation and shear strain are expanded in the modes and the arm is inextensible. With the
shaft angle as coordinate q_0 (`Phi_0 = 1`, `Gamma_0 = 0`) and `Gamma_n = W_n' - Phi_n`,

    phi = sum Phi_i q_i     gamma = sum Gamma_i q_i     i = 0..N                (T19)

are the rotation in world axes and the shear strain of a section. The slope (a, b) of the centre
line in world axes and its derivative with respect to q_i follow without approximation:

    a = cos phi - gamma sin phi     C1_i = -b Phi_i - sin(phi) Gamma_i          (T20)
    b = sin phi + gamma cos phi     C2_i =  a Phi_i + cos(phi) Gamma_i          (T21)

The equations are Hamilton's. With the mass centre (X, Y) in place of the carrier, translation
separates; what is left are the coordinates q_i and their momenta p_i = M_ij q_j', with
`M_ij = Xi_ij + C1_i K C1_j + C2_i K C2_j` (T23):

    X'   = P_x / m_t         P_x' = F_x          (the same in y)                (T24)
    q_i' = (M^-1 p)_i        p_i' = dT/dq_i - omega_i^2 q_i - 2 zeta_i omega_i q_i' + Q_i  (T25)

where Q holds the shaft torque and the forces on carrier and tip as seen from the mass centre, and
the torque on the tip, `Phi_i(l)` of it; F is the sum of both forces (T30). Viscous friction of
the carrier is a force on it, that of the shaft stands for `2 zeta_0 omega_0` (T32). The
momenta of a free manipulator, P and p_0 (spin about the mass centre), are constant by
construction. Nodal values act through two constant arrays: `d = D^T m`, and for either
axis a kernel, `K = D^T diag(m) D - d d^T / m_t` of the masses about their centre.

A carrier held along an axis takes the mass centre's place there: its coordinate and momentum are
struck out, and the kernel is the one about the root, without `d d^T / m_t` (T27). With one axis
held the kernels differ, and T depends on the shaft angle too. Of a driven shaft q_0 and q_0' are
given: p_0 is struck out, and the other momenta keep their share `M_i0 q_0'` (T28); its
acceleration is not needed.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.physics import etdrk4
from timo_sim.physics.compiled import inner, local
from timo_sim.physics.formulation import (
    ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, Formulation, SPEED, TIP_I, TIP_II, TIP_TORQUE,
    TIP_X, TIP_Y, TORQUE)
from timo_sim.physics.sincos import sincos


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
    axes: np.ndarray       # along which the carrier is free
    anchor: np.ndarray     # where it is held, (2,)
    reach: np.ndarray      # from nodal values to their integral over the arm, (n_g,)
    turn: np.ndarray       # Phi_i at the tip, (1 + N,)


@inner
def _set_slopes(tables, state, load, coordinate, cosine, sine, a, b, c1, c2):
    """Set q, cosine and sine of phi, a, b (T20), C1 and C2 (T21)."""
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


@inner
def _set_speed(tables, state, load, c1, c2, image_1, image_2, speed):
    """Set the images K C1, K C2 and q', the solution of M q' = p (T23), (T28)."""
    kernel, rotary = tables.kernel, tables.rotary
    count, nodes = c1.shape
    first = count - len(tables.straight)
    for i in range(count):
        for j in range(nodes):
            total_1 = 0.0
            total_2 = 0.0
            for k in range(nodes):
                # K is symmetric. Read down a column, this loop is unrolled and that over j becomes
                # vector code; where it is too long for that, it becomes vector code itself.
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
    for k in range(count - 1, first - 1, -1):
        for i in range(first, k):
            speed[i] -= mass[k, i] * speed[k]


@inner
def _carrier_rate(tables, state, k, slope_rates, speed):
    """Return the carrier's speed along its k-th free axis, with C1 or C2 of that axis."""
    rate = state[len(state) // 2 + k] / tables.mass
    for j in range(len(tables.lever)):
        for i in range(len(speed)):
            rate -= tables.lever[j] * slope_rates[i, j] * speed[i]
    return rate


@etdrk4.rate.of(Tables)
def _rate(tables, state, load, out):
    """Write what the linear part leaves of the state's rate."""
    rotation, shear, axes = tables.rotation, tables.shear, tables.axes
    lever, reach = tables.lever, tables.reach
    count, nodes = rotation.shape
    first = count - len(tables.straight)
    coordinate, speed = local((rotation,)), local((rotation,))
    cosine, sine, a, b = local((lever,)), local((lever,)), local((lever,)), local((lever,))
    c1, c2 = local((rotation, lever)), local((rotation, lever))
    image_1, image_2 = local((rotation, lever)), local((rotation, lever))
    _set_slopes(tables, state, load, coordinate, cosine, sine, a, b, c1, c2)
    _set_speed(tables, state, load, c1, c2, image_1, image_2, speed)
    momenta, half = len(state) - count, len(state) // 2
    coordinates = momenta - half

    # q': what the mass matrix of the straight arm does not account for.
    for i in range(first, count):
        total = speed[i]
        for j in range(first, count):
            total -= tables.straight[i - first, j - first] * state[momenta + j]
        out[coordinates + i] = total

    # Translation; X' = P / m_t is in the linear part.
    push_x, push_y = 0.0, 0.0
    turned_y, turned_x = sincos(coordinate[0])
    tip_x = load[TIP_X] + turned_x * load[TIP_I] - turned_y * load[TIP_II]
    tip_y = load[TIP_Y] + turned_y * load[TIP_I] + turned_x * load[TIP_II]
    for k in range(len(axes)):
        if axes[k] == 0:
            push_x = load[FORCE_X] + turned_x * load[FORCE_I] - turned_y * load[FORCE_II] + tip_x
            if tables.drag != 0.0:
                push_x -= tables.drag * _carrier_rate(tables, state, k, c1, speed)
        else:
            push_y = load[FORCE_Y] + turned_y * load[FORCE_I] + turned_x * load[FORCE_II] + tip_y
            if tables.drag != 0.0:
                push_y -= tables.drag * _carrier_rate(tables, state, k, c2, speed)
        out[k] = 0.0
        out[half + k] = push_x if axes[k] == 0 else push_y

    # (T26): dT/dq_i = sum_j Phi_ij A_j + Gamma_ij B_j, from (g1, g2) = K (a', b') and the rates of
    # phi and gamma. The forces do their work on C1, C2: the same sum.
    moment = load[TORQUE]
    script_a, script_b = local((lever,)), local((lever,))
    for j in range(nodes):
        g1 = 0.0
        g2 = 0.0
        turning = 0.0
        shearing = 0.0
        for i in range(count):
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
    for i in range(first, count):
        # Unless one axis is held, T does not depend on the shaft angle: left out, not summed to
        # round-off.
        total = moment
        if i or len(axes) == 1:
            total = 0.0 if i else load[TORQUE]
            for j in range(nodes):
                total += rotation[i, j] * script_a[j] + shear[i, j] * script_b[j]
        total += tables.turn[i] * load[TIP_TORQUE]
        out[momenta + i] = total - tables.damping[i] * out[coordinates + i]


@etdrk4.observe.of(Tables)
def _observe(tables, state, load, out):
    """Write the motion of a state."""
    rotation, lever = tables.rotation, tables.lever
    count, nodes = rotation.shape
    coordinate, speed = local((rotation,)), local((rotation,))
    cosine, sine, a, b = local((lever,)), local((lever,)), local((lever,)), local((lever,))
    c1, c2 = local((rotation, lever)), local((rotation, lever))
    image_1, image_2 = local((rotation, lever)), local((rotation, lever))
    _set_slopes(tables, state, load, coordinate, cosine, sine, a, b, c1, c2)
    _set_speed(tables, state, load, c1, c2, image_1, image_2, speed)
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


@etdrk4.tip.of(Tables)
def _tip(tables, motion, out):
    """Write where the tip is: the slopes' integral, as seen from the shaft."""
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


class Exact(Formulation):
    """The `exact` formulation, see the module's text."""

    def build(self):
        """Return the tables and the linear part, that of the straight arm."""
        modes, nodes = self.modes, self.quadrature.nodes
        to_points = self.points.integral.T
        lever = to_points.T @ self.point_mass / self.mass
        about_root = to_points.T @ (self.point_mass[:, np.newaxis] * to_points)
        about_centre = about_root - self.mass * np.outer(lever, lever)
        kernel = np.stack([about_centre if axis in self.axes else about_root for axis in range(2)])

        rotation = np.column_stack([np.ones_like(nodes), modes.rotation(nodes)])
        shear = np.column_stack([np.zeros_like(nodes), modes.shear(nodes)])
        at_points = np.column_stack([np.ones_like(self.points.xi), self.points.rotation.T])
        rotary = at_points.T @ (self.point_inertia[:, np.newaxis] * at_points)
        rotary[0, 0] += self.manipulator.shaft_inertia

        # Straight arm: C along the arm is 0, across it Phi + Gamma; along which axis it lies is
        # not known, so the mean kernel stands for both.
        slope, free = rotation + shear, slice(self.first, None)
        inverse = np.linalg.inv((rotary + slope.T @ kernel.mean(axis=0) @ slope)[free, free])
        stiffness = np.append(0.0, modes.omega**2)
        damping = np.append(self.manipulator.shaft_friction, 2.0 * self.damping * modes.omega)

        axes, half = len(self.axes), len(self.axes) + len(inverse)
        linear = np.zeros((2 * half, 2 * half))
        linear[:axes, half:half + axes] = np.eye(axes) / self.mass
        linear[axes:half, half + axes:] = inverse
        linear[half + axes:, axes:half] = -np.diag(stiffness[free])
        linear[half + axes:, half + axes:] = -damping[free, np.newaxis] * inverse
        if axes != 1:
            kernel = kernel[:1]
        return Tables(self.mass, kernel, lever, rotation.T, shear.T, rotary, inverse, damping,
                      self.manipulator.carrier_friction, self.axes, self.anchor,
                      self.points.integral[:, -1], at_points[-1]), linear

    def state(self, motion):
        """Return the state that belongs to a motion."""
        half, table = self.size // 2, self.tables
        coordinates, speed = motion[2:half], motion[half + 2:]
        cosine, sine, a, b = self._slopes(coordinates)
        slope = np.stack([-b * table.rotation - sine * table.shear,
                          a * table.rotation + cosine * table.shear])
        matrix = table.rotary + np.sum(slope @ table.kernel @ slope.transpose(0, 2, 1), axis=0)
        centre = motion[:2] + np.array([a, b]) @ table.lever
        momentum = table.mass * (motion[half:half + 2] + speed @ slope @ table.lever)
        return np.concatenate([centre[self.axes], coordinates[self.first:],
                               momentum[self.axes], (matrix @ speed)[self.first:]])

    def centre_line(self, q, points):
        """Return the integral of the slopes from the root."""
        _, _, a, b = self._slopes(self._relative(q))
        return np.stack([a @ points.integral, b @ points.integral], axis=-1)

    def centre_line_rate(self, q, qdot, points):
        """Return the integral of the slopes' rates."""
        cosine, sine, a, b = self._slopes(self._relative(q))
        turning = self._relative(qdot) @ self.tables.rotation
        shearing = self._relative(qdot) @ self.tables.shear
        return np.stack([(-b * turning - sine * shearing) @ points.integral,
                         (a * turning + cosine * shearing) @ points.integral], axis=-1)

    @staticmethod
    def _relative(q):
        # Coordinates as seen from the shaft.
        return np.column_stack([np.zeros(len(q)), q])

    def _slopes(self, coordinates):
        # Cosine and sine of phi, and a, b, at the nodes, shape (..., n_g) each.
        phi, gamma = coordinates @ self.tables.rotation, coordinates @ self.tables.shear
        cosine, sine = np.cos(phi), np.sin(phi)
        return cosine, sine, cosine - gamma * sine, sine + gamma * cosine
