# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The `exact` formulation: geometrically exact kinematics on assumed strain modes.

Numbers (T..) are those of doc/theory.md, section 6.

Section rotation and shear strain are expanded in the modes. The arm is inextensible unless it has
axial modes; `exact_code` has the terms that they add (T34), (T35). With the
shaft angle as coordinate q_0 (`Phi_0 = 1`, `Gamma_0 = 0`) and `Gamma_n = W_n' - Phi_n`,

    phi = sum Phi_i q_i     gamma = sum Gamma_i q_i     i = 0..N                (T22)

are the rotation in world axes and the shear strain of a section. The slope (a, b) of the centre
line in world axes and its derivative with respect to q_i follow without approximation:

    a = cos phi - gamma sin phi     C1_i = -b Phi_i - sin(phi) Gamma_i          (T23)
    b = sin phi + gamma cos phi     C2_i =  a Phi_i + cos(phi) Gamma_i          (T24)

The equations are Hamilton's. With the mass centre (X, Y) in place of the carrier, translation
separates from the coordinates q_i and their momenta p_i = M_ij q_j', with
`M_ij = Xi_ij + C1_i K C1_j + C2_i K C2_j` (T26):

    X'   = P_x / m_t         P_x' = F_x          (the same in y)                (T27)
    q_i' = (M^-1 p)_i        p_i' = dT/dq_i - omega_i^2 q_i - 2 zeta_i omega_i q_i' + Q_i  (T28)

Q_i is the generalised force of the shaft torque, of the forces on carrier and tip about the mass
centre, and of the torque on the tip times `Phi_i(l)`; F is the sum of both forces (T32). Viscous
friction of the carrier is a force on it; the coefficient of the shaft's friction takes the place
of `2 zeta_0 omega_0`. Coulomb friction that builds up over a speed is part of the force on the
carrier and of the shaft torque (T33). The momenta of a free manipulator, P and p_0 (spin about the
mass centre), are constant by construction. Nodal values enter through two constant arrays:
`d = D^T m`, and for either axis a kernel, `K = D^T diag(m) D - d d^T / m_t` of the masses about
their centre.

Along an axis on which the carrier is held, the mass centre's coordinate and momentum are removed,
and the kernel is the one about the root, without `d d^T / m_t` (T30). With one axis held the
kernels differ, T depends on the shaft angle too, and the state has rates q_i' in place of momenta
(T35). For a driven shaft q_0 and q_0' are given: p_0 is removed, and the other momenta keep their
share `M_i0 q_0'` (T31); its acceleration is needed only where the state has rates.
"""

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.compiled.blas import with_one_thread
from timo_sim.model.differences import differences
from timo_sim.model.exact_code import BAND, band_of, BANDS, sector_of, SECTORS, Tables
from timo_sim.model.formulation import Formulation, Points
from timo_sim.model.layout import ANGLE, LOADS, SPEED


class Exact(Formulation):
    """The `exact` formulation, see the module's text."""

    def build(self) -> tuple[Any, np.ndarray]:
        """Return the tables and the linear part, that of the straight arm."""
        modes, (to_centre, kernel, at_points, rotary) = self.modes, self._masses()

        # Fields of the coordinates q_i, i = 0 is the shaft (T22), and Xi_ij (T26).
        _, rotation, _, shear, stretch, _ = self.at_nodes
        rotation, shear = self._with_shaft(1.0, rotation), self._with_shaft(0.0, shear)
        self._stretch = self._with_shaft(0.0, stretch).T
        rotary[0, 0] += self.manipulator.shaft_inertia
        if self.gear:  # (T60)
            rotary += self.rotor_matrix[2:, 2:]
        damping = np.concatenate([[self.manipulator.shaft_friction], self.modal_damping])
        rotary.flat[len(rotary) + 1::len(rotary) + 1] += self.slower**2 - 1.0  # (T67)

        one_axis = len(self.axes) == 1
        # Number of last coordinates whose rates, not momenta, are in the state.
        self._rate_count = self.axial or one_axis * (len(rotary) - self.driven)
        locked = self.constraints.locked
        self.sectors = SECTORS if one_axis and self._rate_count and locked is None else 0
        self._kernel, self._slope = kernel, rotation + shear
        spring = np.reshape(self.manipulator.spring, (-1, 2))
        push = self.push_point.integral.T if self.push_point else np.empty((0, len(rotation)))
        tables = Tables(
            mass=self.mass, kernel=kernel if one_axis else kernel[:1], to_centre=to_centre,
            rotation=rotation.T, shear=shear.T, rotary=rotary, straight=np.empty((0, 0)),
            damping=damping, carrier_friction=self.manipulator.carrier_friction,
            coulomb=np.array(self.manipulator.coulomb),
            motor_limit=np.reshape(self.manipulator.motor_limit, (-1, 2)), axes=self.axes,
            held_position=self.held_position, to_tip=self.points.integral[:, -1],
            tip_rotation=at_points[-1], weight=self.mass * self.gravity, push=push,
            stretch=self._stretch[len(self._stretch) - self.axial:],
            stiffness=np.append(spring[:, 0].sum(), modes.omega**2), spring=spring,
            linear_rate=np.empty((0, 2, 0)), sector=-1,
            bands_per_speed=0.0, of_band=np.empty((0, 0)), gear=self.gear_row)
        tables, linear = self._with_linear_part(tables, locked if one_axis else None)
        if self.sectors and self.axial:
            self._band = BAND * modes.omega[0]
            inertia = 1.0 if self.driven else tables.rotary[0, 0] + kernel.mean(axis=0).sum()
            tables = tables._replace(bands_per_speed=1.0 / (self._band * inertia),
                                     of_band=np.zeros_like(linear))
        return tables, linear

    def _masses(self):
        # D integrates slopes at the nodes to the points of mass; d / m_t, and K (T26) or, along an
        # axis on which the carrier is held, the kernel about the root (T30); Phi_i there, Xi_ij.
        to_points = self.centres.integral.T
        to_centre = to_points.T @ self.point_mass / self.mass
        about_root = to_points.T @ (self.point_mass[:, np.newaxis] * to_points)
        about_centre = about_root - self.mass * (to_centre[:, np.newaxis] * to_centre)
        kernel = np.array([about_root if held else about_centre
                           for held in self.constrained[:2].tolist()])
        one = np.ones((len(self.points.xi), 1))
        at_points = np.concatenate([one, self.points.rotation.T], axis=1)
        return to_centre, kernel, at_points, at_points.T @ (
            self.point_inertia[:, np.newaxis] * at_points)

    def tables_at(self, tip: Points) -> Any:
        """Return tables whose tip is at a point."""
        return self.tables._replace(to_tip=tip.integral[:, 0],
                                    tip_rotation=np.append(1.0, tip.rotation[:, 0]))

    def tables_of_masses(self) -> Any:
        """Return the tables with other masses at other points, of an arm without a base."""
        to_centre, kernel, _, rotary = self._masses()
        return self.tables._replace(mass=self.mass, kernel=kernel[:len(self.tables.kernel)],
                                    to_centre=to_centre, rotary=rotary)

    def at(self, xi: ArrayLike) -> Points:
        """Return points at distances xi from the root; the hub is one more node (T50)."""
        points, radius = super().at(xi), self.manipulator.hub_radius
        return points._replace(integral=np.vstack([
            points.integral, np.full_like(points.xi, radius)])) if radius else points

    def _with_shaft(self, of_shaft, values):
        # A field of the shaft and the modes at the nodes, (n_g, 1 + N); no mode bends the hub.
        values = np.concatenate([np.full((len(values), 1), of_shaft), values], axis=1)
        if self.manipulator.off_tip:  # what is beyond the tip turns with it
            tip = np.append(1.0, self.points.rotation[:, -1])
            values = np.concatenate([values, of_shaft * tip[np.newaxis]])
        if self.manipulator.hub_radius:
            values = np.concatenate([values, [[of_shaft] + len(self.modes) * [0.0]]])
        return values

    def _with_linear_part(self, tables, angle):
        # Returns the tables and the linear part of the straight arm, whose C is E along the arm
        # and Phi + Gamma across it. Without an angle both axes have the mean of the kernels.
        slope, stretch, kernel = self._slope.T, self._stretch, self._kernel
        if angle is None:
            mean = 0.5 * (kernel[0] + kernel[1])
            matrix = tables.rotary + slope @ mean @ slope.T
            if self.axial:
                matrix += stretch @ mean @ stretch.T
        else:
            cosine, sine = np.cos(angle), np.sin(angle)
            x, y = cosine * stretch - sine * slope, sine * stretch + cosine * slope
            matrix = tables.rotary + x @ kernel[0] @ x.T + y @ kernel[1] @ y.T
        matrix = matrix[self.driven:, self.driven:]
        inverse = straight = np.linalg.inv(matrix)
        stiffness, damping = tables.stiffness, tables.damping
        if self._rate_count:
            # The state has the rates of the last coordinates, and momenta of those before: q' is
            # these rates, and M^-1 (p - M q') for the others (T35).
            last = slice(len(matrix) - self._rate_count, None)
            others = slice(len(matrix) - self._rate_count)
            straight = np.eye(len(matrix))
            straight[others, others] = np.linalg.inv(matrix[others, others])
            straight[others, last] = -straight[others, others] @ matrix[others, last]

        # L by blocks: X' = P / m_t, q' = M^-1 p, p' = -omega^2 q - 2 zeta omega q' (T27), (T28).
        axes, half = len(self.axes), len(self.axes) + len(straight)
        linear = np.zeros((2 * half, 2 * half))
        linear[:axes, half:half + axes] = np.eye(axes) / self.mass
        linear[axes:half, half + axes:] = straight
        linear[half + axes:, axes:half] = -np.diag(stiffness[self.driven:])
        linear[half + axes:, half + axes:] = -damping[self.driven:, np.newaxis] * straight
        drag = np.zeros_like(matrix)
        if self.gear:
            drag = self.gear.friction * np.outer(*2 * (self.rotor[2 + self.driven:],))
            linear[half + axes:, half + axes:] -= drag @ straight
        tables = tables._replace(straight=straight)
        if self._rate_count:
            # q'' of the last coordinates, by their own q and q' (T35).
            last = slice(-self._rate_count, None)
            rate = -inverse[last, last] * [[stiffness[last]], [damping[last]]]
            rate[1] -= inverse[last, last] @ drag[last, last]
            linear[last] = 0.0
            linear[last, half - self._rate_count:half], linear[last, last] = rate
            tables = tables._replace(linear_rate=rate.transpose(1, 0, 2))
        return tables, linear

    def centre_line(self, q: np.ndarray, points: Points) -> np.ndarray:
        """Return the integral of the slopes from the shaft's axis."""
        a, b = self._slopes(q)[2:]
        return np.stack([a @ points.integral, b @ points.integral], axis=-1)

    def centre_line_rate(self, q: np.ndarray, qdot: np.ndarray, points: Points) -> np.ndarray:
        """Return the integral of the slopes' rates."""
        cosine, sine, a, b = self._slopes(q)
        turning, shearing, stretching = (qdot @ field[1:] for field in (
            self.tables.rotation, self.tables.shear, self._stretch))
        return np.stack([
            (-b * turning - sine * shearing + cosine * stretching) @ points.integral,
            (a * turning + cosine * shearing + sine * stretching) @ points.integral], axis=-1)

    def _slopes(self, q):
        # Cosine and sine of phi, and a, b, from the shaft at the nodes, shape (..., n_g) each.
        phi, gamma, stretch = (q @ field[1:] for field in (
            self.tables.rotation, self.tables.shear, self._stretch))
        cosine, sine = np.cos(phi), np.sin(phi)
        return (cosine, sine, cosine - gamma * sine + stretch * cosine,
                sine + gamma * cosine + stretch * sine)

    def sector(self, state: np.ndarray, load: np.ndarray,
               bands_per_speed: np.ndarray | None = None) -> Any:
        """Return the numbers of the sectors of the shaft angle and of the bands of its speed."""
        if not self.sectors:
            return None
        axes = len(self.axes)
        angle = load[..., ANGLE] if self.driven else state[..., axes]
        speed = load[..., SPEED] if self.driven else state[..., state.shape[-1] // 2 + axes]
        good = np.isfinite(angle) & np.isfinite(speed)  # of a run that diverges any will do
        found = sector_of(np.where(good, angle, 0.0))
        if self.axial:
            bands = self.tables.bands_per_speed if bands_per_speed is None else bands_per_speed
            found = found + SECTORS * band_of(np.where(good, speed, 0.0), bands)
        return found.astype(int) if state.ndim > 1 else int(found)

    @with_one_thread
    def in_sector(self, number: int | None) -> tuple[Any, np.ndarray]:
        """Return tables and linear part of the straight arm in the middle of a sector, a band."""
        if number is None:
            return super().in_sector(None)
        band, sector = divmod(number, SECTORS)
        angle = (sector + 0.5) * np.pi / SECTORS
        tables, linear = self._with_linear_part(self.tables, angle)
        if self.axial:
            of_band = self._at_speed(angle, (band - BANDS + 0.5) * self._band) - linear
            of_band[:, len(self.axes)] *= self.driven  # the angle itself is not bounded
            linear += of_band
            tables = tables._replace(of_band=of_band)
        return tables._replace(sector=number), linear

    def _at_speed(self, angle, speed):
        # The rate's derivatives by the state of a straight arm that turns. Without backlash and
        # friction that builds up it is quadratic in speeds and momenta; other differences are good
        # to 1e-8.
        model = copy(self)
        model.packed = model.pack(self.tables._replace(
            coulomb=np.zeros((3, 3)), motor_limit=self.tables.motor_limit * [1.0, 0.0],
            gear=self.tables.gear * [1.0, 1.0, 0.0]))
        motion, load = np.zeros(self.size), np.zeros(LOADS)
        motion[2] = load[ANGLE] = angle
        motion[self.size // 2 + 2] = load[SPEED] = speed
        state, shift = self.state(motion), np.ones(len(self.linear))
        half = len(state) // 2
        shift[len(self.axes):half] = (
            1e-4 / np.append(1.0, self.section_turn_bound)[self.driven:])
        return differences(lambda shifts: np.array([
            model.rate(state + change, load) for change in shifts]), shift)[1]
