# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Eigenfrequencies and mode shapes of the arm, clamped at its root, with the end effector.

Bending modes are sums of waves for a uniform arm and found by the Legendre-Galerkin method for
any other; static shapes and axial modes can follow them. The order is that of doc/theory.md,
section 2: closed form (T5) to (T7), Legendre-Galerkin (T8), static shapes (T9); axial modes (T34).
"""

from collections.abc import Sequence
import functools
import math
from typing import NamedTuple

import numpy as np

from timo_sim.compiled.constants import pack
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, Constants, magnitude, square_root, strict
from timo_sim.model.bodies import Constraints, Gear, Manipulator, Quadrature


class Modes:
    """
    Mode shapes, mass-normalised as in doc/theory.md (T3); a field that is not defined is zero.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular frequencies [rad/s].

    """

    omega: np.ndarray

    def __len__(self) -> int:
        return len(self.omega)

    def _field(self, name: str, xi: np.ndarray) -> np.ndarray:
        return np.zeros((len(xi), len(self)))

    def deflection(self, xi: np.ndarray) -> np.ndarray:
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        return self._field('deflection', xi)

    def rotation(self, xi: np.ndarray) -> np.ndarray:
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._field('rotation', xi)

    def curvature(self, xi: np.ndarray) -> np.ndarray:
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        return self._field('curvature', xi)

    def shear(self, xi: np.ndarray) -> np.ndarray:
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._field('shear', xi)

    def stretch(self, xi: np.ndarray) -> np.ndarray:
        """Return the axial strain E_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._field('stretch', xi)

    def displacement(self, xi: np.ndarray) -> np.ndarray:
        """Return the integral of E_n from the root to xi, shape (len(xi), N) [1/sqrt(kg)]."""
        return self._field('displacement', xi)


class JoinedModes(Modes):
    """Modes of one set, followed by those of another."""

    def __init__(self, *parts: Modes) -> None:
        self._parts = parts
        self.omega = np.concatenate([part.omega for part in parts])

    def _field(self, name, xi):
        return np.hstack([getattr(part, name)(xi) for part in self._parts])


class GearMode(Modes):
    """The rotor turns against the shaft, held by its gear (T60); the arm stays as it is."""

    def __init__(self, gear: Gear) -> None:
        self.omega = np.array([math.sqrt(gear.stiffness / gear.inertia)])


@functools.lru_cache(maxsize=16)
def modes_of(manipulator: Manipulator, count: int, static: tuple[str, ...] = ()) -> Modes:
    """
    Return the lowest modes of a manipulator's arm, both spectra together.

    They are cached, because the check of a scene and its run ask for the same modes. Those of a
    uniform arm have a closed form. `static` are loads, 'force' or 'torque' on the tip or 'weight',
    whose static shapes follow the modes.
    """
    if count and static:
        return StaticModes(manipulator, modes_of(manipulator, count), static)
    if manipulator.arm.uniform:
        return UniformModes(manipulator, count)
    return GalerkinModes(manipulator, count)


class UniformModes(Modes):
    """
    The lowest modes of a uniform arm in closed form, mass-normalised.

    Each is the sum of four waves, see `_waves`. The curvature of a mode is positive at the root.

    `omega` is ascending. Source: paper eqs. (8)-(19), (23). Raises ValueError if two
    eigenfrequencies are too close to be separated.
    """

    def __init__(self, manipulator: Manipulator, count: int) -> None:
        section = manipulator.arm.section
        self._arm = pack(UniformArm(
            manipulator.arm.length, section.mass_per_length, section.bending_stiffness,
            section.shear_stiffness, *section.ratios,
            end_effector_mass=manipulator.end_effector_mass,
            end_effector_inertia=manipulator.end_effector_inertia))
        self._compute_fields, self._known = fields.of(self._arm), {}
        self.omega = self._roots(manipulator, count)
        # The shares of the waves in a mode are the null vector of its boundary conditions (T7).
        matrices, scales = np.empty((count, 4, 4)), np.empty((count, 4))
        conditions = boundary_conditions.of(self._arm)
        for omega, matrix, scale in zip(self.omega, matrices, scales):
            conditions(omega, matrix, scale)
        self._shape = np.linalg.svd(matrices)[2][:, -1] / scales
        fine = Quadrature(manipulator.arm.breaks, 4 * count + 40)
        mass, inertia = manipulator.inertia(fine)
        deflection, rotation, _, _ = self._fields(fine.points)
        modal_mass = mass @ deflection**2 + inertia @ rotation**2
        sign = np.sign(self.curvature(np.zeros(1))[0])
        self._shape *= (sign / np.sqrt(modal_mass))[:, np.newaxis]
        self._known = {}

    def _field(self, name, xi):
        known = 'deflection', 'rotation', 'curvature', 'shear'
        return self._fields(xi)[known.index(name)] if name in known else super()._field(name, xi)

    def _fields(self, xi):
        # A formulation asks for several fields at the same points, which are computed together.
        xi = np.ascontiguousarray(xi, dtype=float)
        found = self._known.get(key := xi.tobytes())
        if found is None:
            values = np.empty((len(xi) * len(self), 4))
            self._compute_fields(self.omega, len(self), self._shape, xi, len(xi), values)
            values.flags.writeable = False
            found = values.reshape(len(xi), len(self), 4).transpose(2, 0, 1)
            self._known = {**dict([*self._known.items()][-1:]), key: found}
        return found

    def _roots(self, manipulator, count):
        omega = np.zeros(count)
        if count == 0:
            return omega
        guesses = frequencies(manipulator, count + 1)
        # One Galerkin frequency lies between two limits, so the determinant of the boundary
        # conditions must change sign there. The limits are rounded, because the last bits of the
        # guesses depend on the number of BLAS threads, and those of the frequencies should not.
        limits = np.append(0.5 * guesses[0], np.sqrt(guesses[:-1] * guesses[1:]))
        limits = limits.astype(np.float32).astype(float)
        found = bisect(self._arm, limits, omega, count, np.empty((4, 4)), np.empty(4))
        if found < count:
            raise ValueError(f'mode {found + 1} of the arm is not separate from its neighbours')
        return omega


# Waves of a uniform arm, whose sums are its mode shapes: boundary conditions and fields, compiled.
#
# The characteristic equation (8) has two roots s: one is `-alpha^2`, the other `beta^2` below the
# cut-off frequency and `-beta'^2` above it. With `g'' = s g` and `g = G'` the field equations (1),
# (2) have the solutions
#
#     W = g     Phi = (s + nu) G     W' - Phi = -nu G     nu = rho A omega^2 / (kappa G A)
#
# A mode is the sum of four, two for each root. For s = -k^2 the pairs (g, G) are (cos, sin / k)
# and (-k sin, cos) of k xi; for a small s > 0 the same with cosh and sinh, so that nothing is
# singular at the cut-off; for a larger s exponentials that decay from either end, because sinh and
# cosh of beta xi, as printed in (18), cancel beyond the twelfth mode.
#
# Source: paper eqs. (8)-(19), with the corrections listed in doc/paper.md; doc/theory.md (T5),
# (T6), and (T7) for the boundary conditions.

class UniformArm(NamedTuple):
    """A uniform arm and the body at its tip, for the compiled functions."""

    length: float
    mass_per_length: float
    bending_stiffness: float
    shear_stiffness: float
    radius2: float          # rotary inertia over mass, I / A [m2]
    ratio: float            # bending over shear stiffness and radius2, E / (kappa G)
    end_effector_mass: float
    end_effector_inertia: float


@strict
def _square(value):
    return value * value


@strict
def _wave_numbers(arm, omega):
    """Return both roots s of the characteristic equation (8), and nu of (T5)."""
    k2 = omega * square_root(arm.mass_per_length / arm.bending_stiffness)
    root = square_root(_square(0.5 * (1.0 - arm.ratio) * arm.radius2 * k2) + 1.0)
    mean = 0.5 * (1.0 + arm.ratio) * arm.radius2 * k2
    # root - mean, written without the cancellation near the cut-off, where it changes sign.
    second = k2 * (1.0 - arm.ratio * _square(arm.radius2 * k2)) / (root + mean)
    return -k2 * (root + mean), second, arm.mass_per_length / arm.shear_stiffness * omega * omega


@strict
def _standing(s, xi):
    """Return two pairs g, G (T6): cos, sin / k, -k sin, cos of k xi; hyperbolic for s > 0."""
    k = square_root(magnitude(s))
    if s > 0.0:
        even, odd = math.cosh(k * xi), math.sinh(k * xi)
    else:
        even, odd = math.cos(k * xi), math.sin(k * xi)
    integral = odd / k if k > 0.0 else xi
    return even, integral, s * integral, even


@strict
def _waves(arm, omega, xi):
    """Return g, G, s of the four waves, and nu."""
    first, second, nu = _wave_numbers(arm, omega)
    g_0, integral_0, g_1, integral_1 = _standing(first, xi)
    if second * arm.length * arm.length > 1.0:
        beta = square_root(second)
        g_2, g_3 = math.exp(-beta * xi), math.exp(-beta * (arm.length - xi))
        integral_2, integral_3 = -g_2 / beta, g_3 / beta
    else:
        g_2, integral_2, g_3, integral_3 = _standing(second, xi)
    return ((g_0, g_1, g_2, g_3), (integral_0, integral_1, integral_2, integral_3),
            (first, first, second, second), nu)


@entry_point(arm=Constants(), omega=float, matrix=Array((4, 4)), scale=Array((4,)))
def boundary_conditions(arm, omega, matrix, scale):
    """
    Write the boundary conditions of a `UniformArm` at a frequency [rad/s].

    `matrix` receives W(0), Phi(0), shear force and moment balance of the end effector as rows, one
    column for each wave; first rows, then columns are scaled to length 1. `scale` receives the
    lengths of the columns.
    """
    g_root, integral_root, s, nu = _waves(arm, omega, 0.0)
    g_tip, integral_tip, _, _ = _waves(arm, omega, arm.length)
    for j in range(4):
        matrix[0, j] = g_root[j]
        matrix[1, j] = (s[j] + nu) * integral_root[j]
        matrix[2, j] = (-arm.shear_stiffness * nu * integral_tip[j]
                        - arm.end_effector_mass * omega * omega * g_tip[j])
        matrix[3, j] = (s[j] + nu) * (arm.bending_stiffness * g_tip[j]
                                      - arm.end_effector_inertia * omega * omega * integral_tip[j])
    for i in range(4):
        length = square_root(_square(matrix[i, 0]) + _square(matrix[i, 1])
                             + _square(matrix[i, 2]) + _square(matrix[i, 3]))
        for j in range(4):
            matrix[i, j] /= length
    for j in range(4):
        scale[j] = square_root(_square(matrix[0, j]) + _square(matrix[1, j])
                               + _square(matrix[2, j]) + _square(matrix[3, j]))
        for i in range(4):
            matrix[i, j] /= scale[j]


@strict
def _minor(matrix, i, j, k):
    """Return the minor of rows i, i + 1 and columns j, k."""
    return matrix[i, j] * matrix[i + 1, k] - matrix[i, k] * matrix[i + 1, j]


# Columns of a minor of the first two rows, and of the last two in the order that gives the sign.
_LAPLACE = ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 2, 0), (2, 3, 0, 1))


@strict
def _determinant(arm, omega, matrix, scale):
    """Return the determinant of the boundary conditions at a frequency."""
    boundary_conditions(arm, omega, matrix, scale)
    total = 0.0
    for j, k, m, n in _LAPLACE:  # a loop, because numba would compile each call by its columns
        total += _minor(matrix, 0, j, k) * _minor(matrix, 2, m, n)
    return total


@entry_point(arm=Constants(), limits=Array((None,)), omega=Array((None,)), count=int,
             matrix=Array((4, 4)), scale=Array((4,)))
def bisect(arm, limits, omega, count, matrix, scale):
    """
    Find one eigenfrequency between each two of `count + 1` ascending limits, to the last bit.

    Return how many are found, in `omega` [rad/s], before a pair of limits between which the
    determinant of the boundary conditions does not change sign. `matrix` and `scale` are room for
    `boundary_conditions`.
    """
    for n in range(count):
        low, high = limits[n], limits[n + 1]
        at_low = at_high = 0.0
        point = low
        # The determinant has one place in this loop, because it is compiled for each place.
        while True:
            value = _determinant(arm, point, matrix, scale)
            if at_low == 0.0:
                at_low, point = value, high
                if value == 0.0:
                    return n
                continue
            if at_high == 0.0:
                at_high = value
                if not at_low * value < 0.0:
                    return n
            elif at_low * value > 0.0:
                low = point
            else:
                high = point
            point = 0.5 * (low + high)
            if not low < point < high:
                break
        omega[n] = point
    return count


@entry_point(arm=Constants(), omega=Array((None,)), count=int, shape=Array((None, 4)),
             xi=Array((None,)), points=int, out=Array((None, 4)))
def fields(arm, omega, count, shape, xi, points, out):
    """
    Write the fields of `count` modes at points [m], as rows of `out`, those of a point together.

    They are deflection, rotation, curvature and shear strain. The last is computed as -nu G, since
    the difference W' - Phi would lose seven digits on a slender arm. `shape` has the share of each
    wave in each mode.
    """
    for n in range(count):
        for i in range(points):
            row = i * count + n
            for field in range(4):
                out[row, field] = 0.0
            g, integral, s, nu = _waves(arm, omega[n], xi[i])
            for j in range(4):
                out[row, 0] += shape[n, j] * g[j]
                out[row, 1] += shape[n, j] * (s[j] + nu) * integral[j]
                out[row, 2] += shape[n, j] * (s[j] + nu) * g[j]
                out[row, 3] -= shape[n, j] * nu * integral[j]


class StrainModes(Modes):
    """
    Bending modes given by their curvature and shear strain at the nodes of a quadrature.

    Strains are polynomials in each span on which the section is smooth; rotation and deflection
    are their integrals from the clamped root, so they are continuous where spans meet. The slope
    is integrated by its values at the nodes of `fine`, by default those of the strains.
    """

    def __init__(self, omega: np.ndarray, strains: Quadrature, curvature: np.ndarray,
                 shear: np.ndarray, fine: Quadrature | None = None) -> None:
        self.omega, self._strains, self._fine = omega, strains, fine
        self._curvature, self._shear = curvature, shear

    def deflection(self, xi: np.ndarray) -> np.ndarray:
        """Return W_n(xi), see `Modes`."""
        fine = self._fine or self._strains
        shear = self.shear(fine.nodes) if self._fine else self._shear
        return fine.integrate_to(xi) @ (self.rotation(fine.nodes) + shear)

    def rotation(self, xi: np.ndarray) -> np.ndarray:
        """Return Phi_n(xi), see `Modes`."""
        return self._strains.integrate_to(xi) @ self._curvature

    def curvature(self, xi: np.ndarray) -> np.ndarray:
        """Return Phi_n'(xi), see `Modes`."""
        return self._strains.interpolate_to(xi) @ self._curvature

    def shear(self, xi: np.ndarray) -> np.ndarray:
        """Return (W_n' - Phi_n)(xi), see `Modes`."""
        return self._strains.interpolate_to(xi) @ self._shear


class GalerkinModes(StrainModes):
    """
    The lowest modes, mass-normalised, of an arm whose section may vary along it.

    With the strain energy `|c|^2 / 2` of scaled nodal strains c and the kinetic energy
    `|G c'|^2 / 2`, the singular values of G are 1/omega_n. Round-off of the largest costs omega_n
    a factor omega_n / omega_1 in relative accuracy; eigenvalues of G^T G would cost its square.
    The curvature of a mode is positive at the root; `omega` is ascending.

    Source: weak form of the paper's (1), (2) with M, J of its Remark 1; doc/theory.md (T8).
    """

    def __init__(self, manipulator: Manipulator, count: int) -> None:
        # Two nodes for each mode give 1e-12 at the fortieth mode of a slender arm; the others are
        # a margin for a heavy tip or a strong taper.
        terms = 2 * count + 30
        strains, fine = _operators(tuple(manipulator.arm.breaks.tolist()), terms)[:2]
        (_, singular, rows), bend, shear = _strain_modes(manipulator, terms)
        omega = 1.0 / singular[:count]
        scaled = rows[:count].T * omega
        super().__init__(omega, strains, scaled[:len(bend)] * bend[:, np.newaxis],
                         scaled[len(bend):] * shear[:, np.newaxis], fine)
        sign = np.sign(self.curvature(np.zeros(1))[0])
        self._curvature *= sign
        self._shear *= sign


@functools.lru_cache(maxsize=8)
def _operators(breaks, terms):
    # Returns the nodes of the strains, the finer nodes and points of the fields, and three
    # matrices: from nodal strains to integrals at the points, from nodal strains to values at the
    # fine nodes, and from these to integrals at the points. Three more nodes in a span integrate
    # the product of two fields and a cubic section exactly.
    nodes, fine = Quadrature(breaks, terms), Quadrature(breaks, terms, extra=3)
    return (nodes, fine, nodes.integrate_to(fine.points), nodes.interpolate_to(fine.nodes),
            fine.integrate_to(fine.points))


@functools.lru_cache(maxsize=8)
def _of_arm(arm, terms):
    # Factors from scaled to nodal strains of bending and shear, and the matrices from scaled
    # strains to deflections and rotations of the points of mass; cached, since manipulators often
    # differ in the end effector alone.
    nodes, _, integrate, interpolate, integrate_fine = _operators(
        tuple(arm.breaks.tolist()), terms)
    section = arm.at(nodes.nodes)
    bend = 1.0 / np.sqrt(nodes.weights * section.bending_stiffness)
    shear = 1.0 / np.sqrt(nodes.weights * section.shear_stiffness)
    slope = np.hstack([integrate[:-1] * bend, interpolate * shear])
    return bend, shear, integrate_fine @ slope, np.hstack(
        [integrate * bend, np.zeros_like(integrate)])


def _strain_modes(manipulator, terms, vectors=True):
    # Returns the singular value decomposition of G, see `GalerkinModes`, and the factors from
    # scaled to nodal strains of bending and shear.
    arm = manipulator.arm
    fine = _operators(tuple(arm.breaks.tolist()), terms)[1]
    bend, shear, deflection, rotation = _of_arm(arm, terms)
    mass, inertia = (np.sqrt(values)[:, np.newaxis] for values in manipulator.inertia(fine))
    matrix = np.concatenate([mass * deflection, inertia * rotation])
    return np.linalg.svd(matrix, full_matrices=False, compute_uv=vectors), bend, shear


def frequencies(manipulator: Manipulator, count: int) -> np.ndarray:
    """
    Return the lowest eigenfrequencies of an arm, ascending, shape (count,) [rad/s].

    With fewer terms than `GalerkinModes` they are within 1e-6 for slender and thick arms with
    0.001 to 1000 times the arm's mass at the tip, which is enough to separate the modes.
    """
    return 1.0 / _strain_modes(manipulator, 2 * count + 8, vectors=False)[0][:count]


class StaticModes(JoinedModes):
    """
    Eigenmodes, then residual static shapes, all normalised as in doc/theory.md (T3).

    A residual is a static shape less its share in the eigenmodes. It is orthogonal to them in mass
    and stiffness, and therefore a further mode with the frequency of Rayleigh's quotient (T9).
    `loads` are of 'force', 'torque', 'weight', and 'shear', a constant shear force without moment.
    """

    def __init__(self, manipulator: Manipulator, modes: Modes, loads: Sequence[str]) -> None:
        arm = manipulator.arm
        rule = Quadrature(arm.breaks, 4 * len(modes) + 40)
        section = arm.at(rule.nodes)
        bending, shearing = (np.broadcast_to(stiffness, rule.nodes.shape)[:, np.newaxis]
                             for stiffness in (section.bending_stiffness, section.shear_stiffness))
        found = _outboard(manipulator, rule)
        moment, force = np.moveaxis(np.array([found[load] for load in loads]), 0, -1)
        curvature, shear = moment / bending, force / shearing
        weights = rule.weights[:, np.newaxis]
        bent, sheared = modes.curvature(rule.nodes), modes.shear(rule.nodes)
        for _ in range(2):  # twice, since cancellation is strong beside many modes
            share = (bent.T @ (weights * bending * curvature)
                     + sheared.T @ (weights * shearing * shear)) / modes.omega[:, np.newaxis]**2
            curvature, shear = curvature - bent @ share, shear - sheared @ share
        # The residuals of two loads are also uncoupled from each other, and normalised.
        residuals = StrainModes(np.zeros(len(loads)), rule, curvature, shear)
        mass, inertia = manipulator.inertia(rule)
        deflection, rotation = residuals.deflection(rule.points), residuals.rotation(rule.points)
        kinetic = (deflection.T * mass) @ deflection + (rotation.T * inertia) @ rotation
        strain = (curvature.T @ (weights * bending * curvature)
                  + shear.T @ (weights * shearing * shear))
        inverse = np.linalg.inv(np.linalg.cholesky(strain))
        squares, vectors = np.linalg.eigh(inverse @ kinetic @ inverse.T)
        omega = 1.0 / np.sqrt(squares[::-1])
        vectors = (inverse.T @ vectors / np.sqrt(squares))[:, ::-1]
        vectors *= np.sign((rule.interpolate_to(np.zeros(1)) @ curvature @ vectors)[0])
        super().__init__(modes, StrainModes(omega, rule, curvature @ vectors, shear @ vectors))


def compliance(manipulator: Manipulator, modes: Modes, pushed: float,
               stretches: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """
    Return static responses of a straight arm to loads at two points, and its modes there.

    Rows are deflection across and along the tip [m], its rotation [rad], and deflection across and
    along the point at `pushed` from the root [m]; columns of the first, (5, 5), are the forces and
    the torque that work on these [N], [N m], and of the second, (5, N), the modes, which have
    `shapes / omega**2 @ shapes.T` of the responses. It is stiff along unless it `stretches`.

    Source: doc/theory.md, section 2, after (T9).
    """
    length = manipulator.arm.length
    rule = Quadrature(np.union1d(manipulator.arm.breaks, pushed), 4 * len(modes) + 40)
    section, xi = manipulator.arm.at(rule.nodes), rule.nodes
    none, inboard = np.zeros_like(xi), (xi < pushed).astype(float)
    moment = np.stack([length - xi, none, none + 1.0, inboard * (pushed - xi), none])
    shear = np.stack([none + 1.0, none, none, inboard, none])
    axial = stretches * np.stack([none, none + 1.0, none, none, inboard])
    whole = sum(force * rule.weights / stiffness @ force.T for force, stiffness in (
        (moment, section.bending_stiffness), (shear, section.shear_stiffness),
        (axial, section.axial_stiffness)))
    ends = np.array([length, pushed])
    (across, other), (along, beside) = modes.deflection(ends), modes.displacement(ends)
    return whole, np.stack([across, along, modes.rotation(ends)[0], other, beside])


def _outboard(manipulator, rule):
    """Return bending moment and shear force at the nodes of a rule by load, shape (n_g,) each."""
    distance = manipulator.arm.length - rule.nodes
    mass, _ = manipulator.inertia(rule)
    inner = rule.integrate_to(rule.nodes)
    weight = mass.sum() - inner @ (mass[:-1] / rule.weights)
    return {'force': (distance, np.ones_like(distance)),
            'torque': (np.ones_like(distance), np.zeros_like(distance)),
            'shear': (np.zeros_like(distance), np.ones_like(distance)),
            'weight': ((rule.integrate_to(rule.points[-1:]) - inner) @ weight, weight)}


class _Stretches(Modes):
    # Modes given by their axial strain at the nodes of a quadrature.

    def __init__(self, omega, strains, stretch):
        self.omega, self._strains, self._stretch = omega, strains, stretch

    def stretch(self, xi):
        return self._strains.interpolate_to(xi) @ self._stretch

    def displacement(self, xi):
        return self._strains.integrate_to(xi) @ self._stretch


@functools.lru_cache(maxsize=16)
def axial_modes(manipulator: Manipulator, count: int, constraints: Constraints) -> Modes:
    """
    Return axial modes of a manipulator's arm with its end effector; they are cached.

    They have no deflection, rotation or shear, as bending modes have no stretch. The first
    eigenmode of the rod misses 1.4 % of the lengthening of a uniform arm that turns. The axial
    modes therefore span the responses to loads: to centrifugal forces, to an acceleration along
    the arm, then to the inertia of earlier responses. They are orthogonal and normalised as
    bending modes are (T3), and in ascending order.

    The constraints set the centre of rotation for the centrifugal forces: the shaft's axis if the
    carrier is held, the mass centre if it is free, the point half-way between if one axis is held.

    Source: load-dependent Ritz vectors, Wilson, Yuan and Dickens, Earthquake Eng. Struct. Dyn. 10
    (1982) 813-821; strains at Gauss nodes and singular values as in `GalerkinModes`.
    """
    terms, breaks = 2 * count + 30, manipulator.arm.breaks
    strains, fine = Quadrature(breaks, terms), Quadrature(breaks, terms, extra=3)
    mass, section = manipulator.inertia(fine)[0], manipulator.arm.at(strains.nodes)
    free = 0.5 * len(constraints.free_axes)
    lever = manipulator.hub_radius + fine.points
    centre = free * (mass @ lever) / (manipulator.base_mass + mass.sum())
    scale = 1.0 / np.sqrt(strains.weights * section.axial_stiffness)
    root_mass = np.sqrt(mass)
    matrix = root_mass[:, np.newaxis] * strains.integrate_to(fine.points) * scale
    basis = np.empty((len(scale), 0))
    loads = [matrix.T @ (root_mass * (lever - centre)), matrix.T @ root_mass,
             strains.integrate_to(breaks[-1:])[0] * scale]
    for number in range(count):
        basis = np.linalg.qr(np.column_stack([basis, loads[number]]))[0]
        loads.append(matrix.T @ (matrix @ basis[:, number]))
    _, singular, rows = np.linalg.svd(matrix @ basis, full_matrices=False)
    stretch = scale[:, np.newaxis] * (basis @ (rows.T / singular))
    stretch *= np.sign(strains.interpolate_to([0.0]) @ stretch)
    return _Stretches(1.0 / singular, strains, stretch)
