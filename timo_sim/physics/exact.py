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

where Q holds the shaft torque and the force on the carrier as seen from the mass centre. The
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
from timo_sim.physics.compiled import inner
from timo_sim.physics.formulation import (
    ANGLE, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, Formulation, SPEED, TORQUE)


class Tables(NamedTuple):
    """Constants of the compiled functions; N modes, n_g quadrature nodes, n free q_i."""

    mass: float            # m_t
    kernel: np.ndarray     # K for x and y, (2, n_g, n_g)
    lever: np.ndarray      # d, (n_g,)
    rotation: np.ndarray   # Phi_i at the nodes, (1 + N, n_g)
    shear: np.ndarray      # Gamma_i at the nodes, (1 + N, n_g)
    rotary: np.ndarray     # Xi_ij = int J Phi_i Phi_j, the shaft's J_m included, (1 + N, 1 + N)
    straight: np.ndarray   # M^-1 of the straight arm, (n, n)
    damping: np.ndarray    # 2 zeta_i omega_i, (1 + N,)
    axes: np.ndarray       # along which the carrier is free
    anchor: np.ndarray     # where it is held, (2,)
    first: int             # the first free q_i


class Space(NamedTuple):
    """Scratch arrays of the compiled functions."""

    node: np.ndarray        # fields at the nodes, (8, n_g)
    slope: np.ndarray       # C1_i, C2_i, (2, 1 + N, n_g)
    image: np.ndarray       # K C1_i, K C2_i, (2, 1 + N, n_g)
    matrix: np.ndarray      # M, then its Cholesky factor, (1 + N, 1 + N)
    coordinate: np.ndarray  # q_i, (1 + N,)
    speed: np.ndarray       # q_i', (1 + N,)
    push: np.ndarray        # force on the carrier, over m_t where it is free, (2,)


# Rows of Space.node.
COS, SIN, A, B, G1, G2, TURN, SHEAR = range(8)


@inner
def _set_slopes(state, load, tables, space):
    """Set q, cosine and sine of phi, a, b (T20), C1 and C2 (T21)."""
    node, slope, rotation, shear = space.node, space.slope, tables.rotation, tables.shear
    count, nodes = rotation.shape
    first, coordinate = tables.first, space.coordinate
    coordinate[0] = load[ANGLE]
    for i in range(first, count):
        coordinate[i] = state[len(tables.axes) + i - first]
    for j in range(nodes):
        node[TURN, j] = 0.0
        node[SHEAR, j] = 0.0
    for i in range(count):
        for j in range(nodes):
            node[TURN, j] += coordinate[i] * rotation[i, j]
            node[SHEAR, j] += coordinate[i] * shear[i, j]
    for j in range(nodes):
        node[COS, j] = np.cos(node[TURN, j])
        node[SIN, j] = np.sin(node[TURN, j])
        node[A, j] = node[COS, j] - node[SHEAR, j] * node[SIN, j]
        node[B, j] = node[SIN, j] + node[SHEAR, j] * node[COS, j]
    for i in range(count):
        for j in range(nodes):
            slope[0, i, j] = -node[B, j] * rotation[i, j] - node[SIN, j] * shear[i, j]
            slope[1, i, j] = node[A, j] * rotation[i, j] + node[COS, j] * shear[i, j]


@inner
def _set_speed(state, load, tables, space):
    """Set M (T23), the images of C1 and C2, and q' from the momenta (T28) by Cholesky."""
    slope, image, kernel, matrix = space.slope, space.image, tables.kernel, space.matrix
    rotary, speed, first = tables.rotary, space.speed, tables.first
    count, nodes = tables.rotation.shape
    for axis in range(2):
        for i in range(count):
            for j in range(nodes):
                total = 0.0
                for k in range(nodes):
                    total += slope[axis, i, k] * kernel[axis, j, k]
                image[axis, i, j] = total
    for i in range(first, count):
        for j in range(i + 1):
            total = rotary[i, j]
            for k in range(nodes):
                total += image[0, i, k] * slope[0, j, k] + image[1, i, k] * slope[1, j, k]
            for k in range(first, j):
                total -= matrix[i, k] * matrix[j, k]
            if j < first:
                matrix[i, j] = total
            else:
                matrix[i, j] = np.sqrt(total) if i == j else total / matrix[j, j]
    momenta = len(state) - count
    speed[0] = load[SPEED]
    for i in range(first, count):
        total = state[momenta + i]
        for k in range(i):
            total -= matrix[i, k] * speed[k]
        speed[i] = total / matrix[i, i]
    for i in range(count - 1, first - 1, -1):
        total = speed[i]
        for k in range(i + 1, count):
            total -= matrix[k, i] * speed[k]
        speed[i] = total / matrix[i, i]


@etdrk4.rate.of(Tables)
def _rate(tables, state, load, space, out):
    """Write what the linear part leaves of the state's rate."""
    _set_slopes(state, load, tables, space)
    _set_speed(state, load, tables, space)
    node, slope, image, speed = space.node, space.slope, space.image, space.speed
    rotation, shear, lever = tables.rotation, tables.shear, tables.lever
    count, nodes = rotation.shape
    first, axes, push = tables.first, tables.axes, space.push
    momenta, half = len(state) - count, len(state) // 2
    coordinates = momenta - half

    # Translation; X' = P / m_t is in the linear part.
    cosine, sine = np.cos(space.coordinate[0]), np.sin(space.coordinate[0])
    push[0] = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    push[1] = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]
    for k in range(len(axes)):
        out[k] = 0.0
        out[half + k] = push[axes[k]]
        push[axes[k]] /= tables.mass

    # q': what the mass matrix of the straight arm does not account for.
    for i in range(first, count):
        total = speed[i]
        for j in range(first, count):
            total -= tables.straight[i - first, j - first] * state[momenta + j]
        out[coordinates + i] = total

    # (T26): dT/dq_i = sum_j Phi_ij A_j + Gamma_ij B_j, from (g1, g2) = K (a', b') and the rates of
    # phi and gamma.
    for j in range(nodes):
        node[G1, j] = 0.0
        node[G2, j] = 0.0
        node[TURN, j] = 0.0
        node[SHEAR, j] = 0.0
    for i in range(count):
        for j in range(nodes):
            node[G1, j] += speed[i] * image[0, i, j]
            node[G2, j] += speed[i] * image[1, i, j]
            node[TURN, j] += speed[i] * rotation[i, j]
            node[SHEAR, j] += speed[i] * shear[i, j]
    for j in range(nodes):
        along = node[COS, j] * node[G1, j] + node[SIN, j] * node[G2, j]
        slanted = node[A, j] * node[G1, j] + node[B, j] * node[G2, j]
        node[G1, j] = -node[TURN, j] * slanted - node[SHEAR, j] * along  # A
        node[G2, j] = -node[TURN, j] * along                             # B

    for i in range(first, count):
        total = 0.0 if i else load[TORQUE]
        # Unless one axis is held, T does not depend on the shaft angle: left out, not summed to
        # round-off.
        if i or len(axes) == 1:
            for j in range(nodes):
                total += rotation[i, j] * node[G1, j] + shear[i, j] * node[G2, j]
        # (T22): the carrier is at the mass centre minus d . (a, b) / m_t.
        for k in range(len(axes)):
            axis = axes[k]
            moment = 0.0
            for j in range(nodes):
                moment += lever[j] * slope[axis, i, j]
            total -= push[axis] * moment
        out[momenta + i] = total - tables.damping[i] * out[coordinates + i]


@etdrk4.observe.of(Tables)
def _observe(tables, state, load, space, out):
    """Write the motion of a state."""
    _set_slopes(state, load, tables, space)
    _set_speed(state, load, tables, space)
    count, nodes = tables.rotation.shape
    half = len(out) // 2
    for i in range(count):
        out[2 + i] = space.coordinate[i]
        out[half + 2 + i] = space.speed[i]
    for axis in range(2):
        out[axis] = tables.anchor[axis]
        out[half + axis] = 0.0
    for k in range(len(tables.axes)):
        axis = tables.axes[k]
        centre = 0.0
        centre_rate = 0.0
        for j in range(nodes):
            centre += tables.lever[j] * space.node[A + axis, j]
            for i in range(count):
                centre_rate += tables.lever[j] * space.slope[axis, i, j] * space.speed[i]
        out[axis] = state[k] - centre / tables.mass
        out[half + axis] = (state[len(state) // 2 + k] - centre_rate) / tables.mass


class Exact(Formulation):
    """The `exact` formulation, see the module's text."""

    def build(self):
        """Return the tables and the linear part, that of the straight arm."""
        modes, nodes = self.modes, self.quadrature.nodes
        to_points = self.points.integral.T
        lever = to_points.T @ self.point_mass
        kernel = np.stack([to_points.T @ (self.point_mass[:, np.newaxis] * to_points)] * 2)
        kernel[self.axes] -= np.outer(lever, lever) / self.mass

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
        damping = np.append(0.0, 2.0 * self.damping * modes.omega)

        axes, half = len(self.axes), len(self.axes) + len(inverse)
        linear = np.zeros((2 * half, 2 * half))
        linear[:axes, half:half + axes] = np.eye(axes) / self.mass
        linear[axes:half, half + axes:] = inverse
        linear[half + axes:, axes:half] = -np.diag(stiffness[free])
        linear[half + axes:, half + axes:] = -damping[free, np.newaxis] * inverse
        tables = Tables(self.mass, kernel, lever, np.ascontiguousarray(rotation.T),
                        np.ascontiguousarray(shear.T), rotary, inverse, damping, self.axes,
                        self.anchor, self.first)
        return tables, linear

    def scratch(self):
        """Return the scratch arrays of the compiled functions."""
        count, nodes = self.tables.rotation.shape
        return Space(np.zeros((8, nodes)), np.zeros((2, count, nodes)),
                     np.zeros((2, count, nodes)), np.zeros((count, count)), np.zeros(count),
                     np.zeros(count), np.zeros(2))

    def state(self, motion):
        """Return the state that belongs to a motion."""
        half, table = self.size // 2, self.tables
        coordinates, speed = motion[2:half], motion[half + 2:]
        cosine, sine, a, b = self._slopes(coordinates)
        slope = np.stack([-b * table.rotation - sine * table.shear,
                          a * table.rotation + cosine * table.shear])
        matrix = table.rotary + sum(c @ kernel @ c.T for c, kernel in zip(slope, table.kernel))
        centre = motion[:2] + np.array([a, b]) @ table.lever / table.mass
        momentum = table.mass * motion[half:half + 2] + speed @ slope @ table.lever
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
