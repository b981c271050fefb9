"""
The `newton` formulation: the paper's equations, projected on the modes.

Deflection and rotation are expanded, `w = sum W_n q_n`, `phi = sum Phi_n q_n` (36); a point of the
centre line is at (xi, w) in the turning axes, so its acceleration is (26), (27). Equations (28),
(29) are projected on the modes and the root reactions P(0), V(0), M(0) of (31)-(33) are integrals
of (30), (28), (29) over the arm. With M(xi), J(xi) of Remark 1 and

    a_n = int M W_n     b_n = int (M xi W_n + J Phi_n)     c_n = int M xi W_n
    G_nl = int M W_n W_l     s = int M xi     J_0 = J_m + int (M xi^2 + J)

this leaves, `alpha` and `beta` the carrier's acceleration along axes I and II,

    m_t alpha = F_I + theta'' a.q + 2 theta' a.q' + theta'^2 s
    m_t beta + s theta'' + a.q'' = F_II + theta'^2 a.q
    J_0 theta'' + s beta + b.q'' = tau + theta'^2 c.q
    q_n'' + b_n theta'' + a_n beta = theta'^2 (G q)_n - omega_n^2 q_n - 2 zeta_n omega_n q_n'

The first two say that the linear momentum changes by the force alone, so the mass centre
(X, Y) and its momentum P separate, beta is eliminated, and theta'', q'' have a constant mass
matrix M. The state is [X, Y, theta, q, P_x, P_y, theta', q'].
"""

from typing import NamedTuple

import numpy as np

from timo_sim.physics import etdrk4
from timo_sim.physics.compiled import inner
from timo_sim.physics.formulation import FORCE_I, FORCE_II, FORCE_X, FORCE_Y, Formulation, TORQUE


class Tables(NamedTuple):
    """Constants of the compiled functions, N modes."""

    mass: float            # m_t
    lever: float           # s
    moment: np.ndarray     # a_n, (N,)
    inverse: np.ndarray    # M^-1, (1 + N, 1 + N)
    softening: np.ndarray  # rows c - s a / m_t and G - a a^T / m_t, (1 + N, N)


class Space(NamedTuple):
    """Scratch arrays of the compiled functions."""

    force: np.ndarray  # (1 + N,)


@inner
def _dot(left, right):
    total = 0.0
    for j in range(len(left)):
        total += left[j] * right[j]
    return total


@etdrk4.rate.of(Tables)
def _rate(tables, state, load, space, out):
    """Write what the linear part leaves of the state's rate."""
    count = len(tables.moment)
    half = 3 + count
    q, omega = state[3:half], state[half + 2]
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    force_2 = cosine * load[FORCE_Y] - sine * load[FORCE_X] + load[FORCE_II]

    out[:half] = 0.0
    out[half] = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    out[half + 1] = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]

    force = space.force
    push = force_2 / tables.mass
    force[0] = load[TORQUE] + omega**2 * _dot(tables.softening[0], q) - push * tables.lever
    for n in range(count):
        force[1 + n] = omega**2 * _dot(tables.softening[1 + n], q) - push * tables.moment[n]
    for i in range(1 + count):
        out[half + 2 + i] = _dot(tables.inverse[i], force)


@etdrk4.observe.of(Tables)
def _observe(tables, state, space, out):
    """Write the motion of a state."""
    count = len(tables.moment)
    half = 3 + count
    out[2:half] = state[2:half]
    out[half + 2:] = state[half + 2:]
    centre_1 = tables.lever / tables.mass
    centre_2 = _dot(tables.moment, state[3:half]) / tables.mass
    omega = state[half + 2]
    rate_1 = -omega * centre_2
    rate_2 = omega * centre_1 + _dot(tables.moment, state[half + 3:]) / tables.mass
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    out[0] = state[0] - cosine * centre_1 + sine * centre_2
    out[1] = state[1] - sine * centre_1 - cosine * centre_2
    out[half] = state[half] / tables.mass - cosine * rate_1 + sine * rate_2
    out[half + 1] = state[half + 1] / tables.mass - sine * rate_1 - cosine * rate_2


class Newton(Formulation):
    """The `newton` formulation, see the module's text."""

    @staticmethod
    def node_count(count):
        """Return the number of quadrature nodes: only the tables need them, so they are many."""
        return 4 * count + 40

    def build(self):
        """Return the tables and the linear part."""
        body, modes, mass = self.manipulator, self.modes, self.point_mass
        xi, _, deflection, rotation = self.points
        lever = mass @ xi
        moment = deflection @ mass
        moment_about_root = deflection @ (mass * xi)
        gram = (deflection * mass) @ deflection.T

        matrix = np.eye(1 + len(modes))
        matrix[0, 0] = body.section_inertia + mass @ xi**2
        matrix[0, 1:] = matrix[1:, 0] = moment_about_root + rotation @ self.point_inertia
        column = np.append(lever, moment)
        matrix -= np.outer(column, column) / body.mass
        inverse = np.linalg.inv(matrix)
        softening = np.vstack([moment_about_root, gram]) - np.outer(column, moment) / body.mass

        half = self.size // 2
        linear = np.zeros((self.size, self.size))
        linear[:2, half:half + 2] = np.eye(2) / body.mass
        linear[2:half, half + 2:] = np.eye(1 + len(modes))
        linear[half + 2:, 2:half] = -inverse * np.append(0.0, modes.omega**2)
        linear[half + 2:, half + 2:] = -inverse * np.append(0.0, 2.0 * self.damping * modes.omega)
        return Tables(body.mass, lever, moment, inverse, softening), linear

    def scratch(self):
        """Return the scratch arrays of the compiled functions."""
        return Space(np.zeros(1 + len(self.modes)))

    def state(self, motion):
        """Return the state that belongs to a motion."""
        half, table = self.size // 2, self.tables
        theta, omega = motion[2], motion[half + 2]
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        across = table.moment @ motion[3:half]
        moment = np.array([table.lever, across])
        moment_rate = np.array([-omega * across,
                                omega * table.lever + table.moment @ motion[half + 3:]])
        return np.concatenate([
            motion[:2] + turn @ moment / table.mass, motion[2:half],
            table.mass * motion[half:half + 2] + turn @ moment_rate, motion[half + 2:]])

    def centre_line(self, q, points):
        """Return the points (xi, w)."""
        across = q @ points.deflection
        return np.stack([np.broadcast_to(points.xi, across.shape), across], axis=-1)

    def centre_line_rate(self, q, qdot, points):
        """Return the rates (0, w')."""
        across = qdot @ points.deflection
        return np.stack([np.zeros_like(across), across], axis=-1)
