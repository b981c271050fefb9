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

from timo_sim.compiled.blas import with_one_thread
from timo_sim.compiled.constants import pack, Packed
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, Constants, magnitude, square_root, strict
from timo_sim.model.bodies import Constraints, Manipulator, Quadrature


class Modes:
    """
    Mode shapes, mass-normalised as in doc/theory.md (T3); those of this class do not move the arm.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular frequencies [rad/s].

    """

    def __init__(self, omega: np.ndarray) -> None:
        self.omega = omega

    def __len__(self) -> int:
        return len(self.omega)

    def fields(self, xi: np.ndarray) -> Sequence[np.ndarray]:
        """Return all that follow, in this order."""
        return 6 * [np.zeros((len(xi), len(self)))]

    def deflection(self, xi: np.ndarray) -> np.ndarray:
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        return self.fields(xi)[0]

    def rotation(self, xi: np.ndarray) -> np.ndarray:
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self.fields(xi)[1]

    def curvature(self, xi: np.ndarray) -> np.ndarray:
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        return self.fields(xi)[2]

    def shear(self, xi: np.ndarray) -> np.ndarray:
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self.fields(xi)[3]

    def stretch(self, xi: np.ndarray) -> np.ndarray:
        """Return the axial strain E_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self.fields(xi)[4]

    def displacement(self, xi: np.ndarray) -> np.ndarray:
        """Return the integral of E_n from the root to xi, shape (len(xi), N) [1/sqrt(kg)]."""
        return self.fields(xi)[5]


class JoinedModes(Modes):
    """Modes of one set, followed by those of another."""

    def __init__(self, *parts: Modes) -> None:
        super().__init__(np.concatenate([part.omega for part in parts]))
        self._parts = parts

    def fields(self, xi: np.ndarray) -> Sequence[np.ndarray]:
        """Return all fields, see `Modes`."""
        return [np.concatenate(each, axis=1) for each in zip(*(
            part.fields(xi) for part in self._parts))]


@functools.lru_cache(maxsize=16)
@with_one_thread
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
        self._arm, known = _found(manipulator)
        omega, shape = known[0]
        if len(omega) < count:
            omega, shape = (np.resize(each, (count, *each.shape[1:])) for each in known[0])
            found = lowest_modes(self._arm, omega, shape, len(known[0][0]), count, *_GAUSS)
            if found < count:
                raise ValueError(f'mode {found + 1} of the arm is not found above the one before: '
                                 'its numbers are too large or too small together')
            known[0] = omega, shape
        super().__init__(omega[:count])
        self._shape = shape[:count]

    def fields(self, xi: np.ndarray) -> Sequence[np.ndarray]:
        """Return all fields, see `Modes`."""
        xi, count = np.array(xi, dtype=float), len(self)
        values, none = np.empty((len(xi) * count, 4)), np.zeros((len(xi), count))
        set_fields(self._arm, self.omega, count, self._shape, xi, len(xi), values)
        return [*values.reshape(len(xi), count, 4).transpose(2, 0, 1), none, none]


@functools.lru_cache(maxsize=16)
def _found(manipulator: Manipulator) -> tuple[Packed, list[tuple[np.ndarray, np.ndarray]]]:
    # Returns the packed UniformArm, and a list of what is known of its lowest modes: frequencies
    # and shapes. A mode does not depend on how many are asked for, so each is found once, for a
    # run, the check of its scene and its finer run.
    section = manipulator.arm.section
    return pack(UniformArm(
        manipulator.arm.length, section.mass_per_length, section.bending_stiffness,
        section.shear_stiffness, *section.ratios,
        end_effector_mass=manipulator.end_effector_mass,
        end_effector_inertia=manipulator.end_effector_inertia,
        end_effector_offset=manipulator.end_effector_offset,
        root=sum(section.bending_stiffness / each for each in manipulator.arm.root))), [
            (np.empty(0), np.empty((0, 4)))]


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
    end_effector_offset: float
    root: float             # bending stiffness over that of the clamp [m]; 0: it does not give


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
    """
    Return deflection, rotation, curvature and shear strain of the four waves.

    The last is computed as -nu G, since the difference W' - Phi would lose seven digits on a
    slender arm.
    """
    first, second, nu = _wave_numbers(arm, omega)
    g_0, integral_0, g_1, integral_1 = _standing(first, xi)
    if second * arm.length * arm.length > 1.0:
        beta = square_root(second)
        g_2, g_3 = math.exp(-beta * xi), math.exp(-beta * (arm.length - xi))
        integral_2, integral_3 = -g_2 / beta, g_3 / beta
    else:
        g_2, integral_2, g_3, integral_3 = _standing(second, xi)
    deflection, integral = (g_0, g_1, g_2, g_3), (integral_0, integral_1, integral_2, integral_3)
    factors = (first + nu, first + nu, second + nu, second + nu)
    return (deflection, _scaled(integral, factors), _scaled(deflection, factors),
            _scaled(integral, (-nu, -nu, -nu, -nu)))


@strict
def _minors(one, two):
    """Return the minors of two rows, for columns 01, 02, 03, 23, 31, 12: complements three on."""
    return (one[0] * two[1] - one[1] * two[0], one[0] * two[2] - one[2] * two[0],
            one[0] * two[3] - one[3] * two[0], one[2] * two[3] - one[3] * two[2],
            one[3] * two[1] - one[1] * two[3], one[1] * two[2] - one[2] * two[1])


@strict
def _determinant(upper, lower):
    """Return the determinant of four rows, given the minors of the first and the last two."""
    return (upper[0] * lower[3] + upper[1] * lower[4] + upper[2] * lower[5]
            + upper[3] * lower[0] + upper[4] * lower[1] + upper[5] * lower[2])


@strict
def _plus(row, share, other):
    return (row[0] + share * other[0], row[1] + share * other[1],
            row[2] + share * other[2], row[3] + share * other[3])


@strict
def _scaled(row, factors):
    return (row[0] * factors[0], row[1] * factors[1], row[2] * factors[2], row[3] * factors[3])


@strict
def _at_root(arm, omega):
    """Return deflection, rotation, that against a clamp which gives, and curvature at the root."""
    deflection, rotation, curvature, _ = _waves(arm, omega, 0.0)
    return deflection, rotation, _plus(rotation, -arm.root, curvature), curvature


@strict
def _at_tip(arm, omega):
    """
    Return deflection, rotation and curvature of the four waves at the tip, and what is left there.

    The last two are the balances of force and moment with the end effector, over stiffnesses.
    """
    deflection, rotation, curvature, shear = _waves(arm, omega, arm.length)
    centre, square = _plus(deflection, arm.end_effector_offset, rotation), omega * omega
    force = _plus(shear, -arm.end_effector_mass * square / arm.shear_stiffness, centre)
    moment = _plus(curvature, -arm.end_effector_inertia * square / arm.bending_stiffness, rotation)
    moment = _plus(moment, -arm.end_effector_mass * arm.end_effector_offset * square
                   / arm.bending_stiffness, centre)
    return deflection, rotation, curvature, force, moment


@strict
def _cofactors(row, minors):
    """Return the vector that is orthogonal to a row and to the two rows of minors."""
    return (row[1] * minors[3] + row[2] * minors[4] + row[3] * minors[5],
            -row[0] * minors[3] + row[2] * minors[2] - row[3] * minors[1],
            -row[0] * minors[4] - row[1] * minors[2] + row[3] * minors[0],
            -row[0] * minors[5] + row[1] * minors[1] - row[2] * minors[0])


@strict
def _dot(one, two):
    return one[0] * two[0] + one[1] * two[1] + one[2] * two[2] + one[3] * two[3]


@strict
def _differ(one, other):
    return 1 if (one < 0.0) != (other < 0.0) else 0


@strict
def _modes_below(arm, omega):
    """
    Return the number of eigenfrequencies below a frequency.

    Modes of the arm pinned at both ends are sines, so that their number is known. A constraint
    that is added takes a mode from below if the dynamic stiffness there is negative, one that is
    released, or a body that is added, gives one. Such a stiffness is a ratio of determinants: of
    the arm pinned, clamped at the root, held by a clamp that gives, clamped at the tip, too, then
    with the inertia and the mass of the end effector there.

    Source: Wittrick and Williams, Q. J. Mech. Appl. Math. 24 (1971) 263-284.
    """
    first, second, _ = _wave_numbers(arm, omega)
    count = math.floor(square_root(-first) * arm.length / math.pi)
    if second < 0.0:
        count += 1 + math.floor(square_root(-second) * arm.length / math.pi)
    deflection, rotation, given, curvature = _at_root(arm, omega)
    stiff, pinned = _minors(deflection, rotation), _minors(curvature, deflection)
    clamped = _minors(deflection, given)
    deflection, rotation, curvature, force, moment = _at_tip(arm, omega)
    both_pinned = _determinant(pinned, _minors(deflection, curvature))
    root_stiff = _determinant(stiff, _minors(deflection, curvature))
    root_clamped = _determinant(clamped, _minors(deflection, curvature))
    both_clamped = _determinant(clamped, _minors(deflection, rotation))
    with_inertia = _determinant(clamped, _minors(deflection, moment))
    return (count - _differ(both_pinned, root_stiff) + _differ(root_stiff, root_clamped)
            - _differ(root_clamped, both_clamped) + _differ(both_clamped, with_inertia)
            + _differ(with_inertia, _determinant(clamped, _minors(force, moment))))


@strict
def _set_shape(arm, omega, shape):
    """Write the shares of the waves in a mode, the null vector of its boundary conditions (T7)."""
    deflection, _, rotation, curvature = _at_root(arm, omega)
    force, moment = _at_tip(arm, omega)[3:]
    minors = _minors(deflection, rotation)
    one, other = _cofactors(force, minors), _cofactors(moment, minors)
    if _dot(one, one) * _dot(moment, moment) < _dot(other, other) * _dot(force, force):
        one = other
    factor = (1.0 if _dot(one, curvature) > 0.0 else -1.0) / square_root(_dot(one, one))
    for j in range(4):
        shape[j] = factor * one[j]


@strict
def _modal_mass(arm, omega, shape, spans, nodes, weights):
    """Return the modal mass of a mode (T3), by a Gauss rule in each of equal spans of the arm."""
    waves, half = _waves(arm, omega, arm.length), 0.5 * arm.length / spans
    centre = _plus(waves[0], arm.end_effector_offset, waves[1])
    total = (arm.end_effector_mass * _square(_dot(shape, centre))
             + arm.end_effector_inertia * _square(_dot(shape, waves[1])))
    for span in range(spans):
        for i in range(_NODES):
            waves = _waves(arm, omega, half * (2 * span + 1 + nodes[i]))
            total += half * weights[i] * arm.mass_per_length * (
                _square(_dot(shape, waves[0])) + arm.radius2 * _square(_dot(shape, waves[1])))
    return total


_HIGHEST = 1e100  # frequency whose square does not overflow [rad/s]
_NODES = 16  # of the rule for modal masses, in each of two spans more than the mode has waves
_GAUSS = np.polynomial.legendre.leggauss(_NODES)
_SEPARATE = 1e-12  # relative distance of two modes whose shapes are told apart: 5000 last places


@entry_point(arm=Constants(), omega=Array((None,)), shape=Array((None, 4)), known=int, count=int,
             nodes=Array((_NODES,)), weights=Array((_NODES,)))
def lowest_modes(arm, omega, shape, known, count, nodes, weights):
    """
    Write the eigenfrequencies [rad/s] to the last bit, and shapes, of `count` modes but the known.

    Shapes, the shares of waves, are those of unit modal masses, which a Gauss rule integrates.
    Return how many modes are found before one that is not above the one before.
    """
    least = square_root(arm.bending_stiffness / arm.mass_per_length) / (arm.length * arm.length)
    for n in range(known, count):
        low = omega[n - 1] if n else 0.0
        high = max(2.0 * low, least)
        while _modes_below(arm, high) <= n:
            low, high = high, 2.0 * high
            if not 0.0 < high < _HIGHEST:
                return n
        while True:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            if _modes_below(arm, middle) > n:
                high = middle
            else:
                low = middle
        omega[n] = high
        if n and not high > omega[n - 1] * (1.0 + _SEPARATE):
            return n
        _set_shape(arm, high, shape[n])
        root = square_root(_modal_mass(arm, high, shape[n], n + 2, nodes, weights))
        for j in range(4):
            shape[n, j] /= root
    return count


@entry_point(arm=Constants(), omega=Array((None,)), count=int, shape=Array((None, 4)),
             xi=Array((None,)), points=int, out=Array((None, 4)))
def set_fields(arm, omega, count, shape, xi, points, out):
    """
    Write the fields of `count` modes at points [m], as rows of `out`, those of a point together.

    They are those of `_waves`; `shape` has the share of each wave in each mode.
    """
    for n in range(count):
        for i in range(points):
            waves = _waves(arm, omega[n], xi[i])
            for field in range(4):
                out[i * count + n, field] = _dot(shape[n], waves[field])


class StrainModes(Modes):
    """
    Modes given by strains at the nodes of a quadrature.

    Rows of `strains`, (2 n_g or one more, N), are curvature, then shear strain at the nodes, then
    rotations of a clamp that gives. They are polynomials in each span on which the section is
    smooth; rotation and deflection are their integrals from the root, so they are continuous where
    spans meet. The slope is integrated by its values at the nodes of `fine`, by default those of
    the strains.
    """

    def __init__(self, omega: np.ndarray, rule: Quadrature, strains: np.ndarray,
                 fine: Quadrature | None = None) -> None:
        super().__init__(omega)
        nodes, self._rule, self._fine = len(rule.nodes), rule, fine or rule
        self._curvature, self._shear, root = np.split(strains, [nodes, 2 * nodes])
        self._root = root.sum(axis=0)
        self._slope = rule.integrate_to(self._fine.nodes) @ self._curvature + self._root + (
            rule.interpolate_to(fine.nodes) @ self._shear if fine else self._shear)

    def fields(self, xi: np.ndarray) -> Sequence[np.ndarray]:
        """Return all fields, see `Modes`."""
        value, integral = self._rule.interpolate_to(xi), self._rule.integrate_to(xi)
        return [self._fine.integrate_to(xi) @ self._slope, integral @ self._curvature + self._root,
                value @ self._curvature, value @ self._shear, *super().fields(xi)[4:]]


class AxialModes(Modes):
    """Modes of stretch alone, given by axial strains at the nodes of a quadrature, (n_g, N)."""

    def __init__(self, omega: np.ndarray, rule: Quadrature, stretch: np.ndarray) -> None:
        super().__init__(omega)
        self._rule, self._stretch = rule, stretch

    def fields(self, xi: np.ndarray) -> Sequence[np.ndarray]:
        """Return all fields, see `Modes`."""
        return [*super().fields(xi)[:4], self._rule.interpolate_to(xi) @ self._stretch,
                self._rule.integrate_to(xi) @ self._stretch]


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
        rule, fine, scale, deflection, rotation = _of_arm(manipulator.arm, 2 * count + 30)
        mass, inertia = (np.sqrt(values)[:, np.newaxis] for values in manipulator.inertia(fine))
        _, singular, rows = np.linalg.svd(np.concatenate([
            mass * manipulator.of_masses(deflection, rotation), inertia * rotation]),
            full_matrices=False)
        omega = 1.0 / singular[:count]
        strains = rows[:count].T * omega * scale[:, np.newaxis]
        super().__init__(omega, rule, _upward(rule, strains), fine)


def _upward(rule, strains):
    # Strains with signs for which the curvature is positive at the root.
    return strains * np.sign(rule.interpolate_to(np.zeros(1)) @ strains[:len(rule.nodes)])


@functools.lru_cache(maxsize=8)
def _of_arm(arm, terms):
    # Returns the nodes of the strains, the finer nodes and points of the fields, factors from
    # scaled to nodal strains of bending and shear and to the turn of a clamp, and matrices from
    # scaled strains to deflections and rotations of the points of mass. Three more nodes in a span
    # integrate the product of two fields and a cubic section exactly. Cached, since manipulators
    # often differ in the end effector alone.
    rule, fine = Quadrature(arm.breaks, terms), Quadrature(arm.breaks, terms, extra=3)
    integrate, section = rule.integrate_to(fine.points), arm.at(rule.nodes)
    bend = 1.0 / np.sqrt(rule.weights * section.bending_stiffness)
    shear = 1.0 / np.sqrt(rule.weights * section.shear_stiffness)
    root = 1.0 / np.sqrt(np.array(arm.root, dtype=float))
    turn = np.ones((len(integrate), len(root))) * root
    slope = np.hstack([integrate[:-1] * bend, rule.interpolate_to(fine.nodes) * shear, turn[:-1]])
    return (rule, fine, np.concatenate([bend, shear, root]),
            fine.integrate_to(fine.points) @ slope,
            np.hstack([integrate * bend, np.zeros_like(integrate), turn]))


class StaticModes(JoinedModes):
    """
    Eigenmodes, then residual static shapes, all normalised as in doc/theory.md (T3).

    A residual is a static shape less its share in the eigenmodes. It is orthogonal to them in mass
    and stiffness, and therefore a further mode with the frequency of Rayleigh's quotient (T9).
    `loads` are of 'force', 'torque', 'weight', and 'shear', a constant shear force without moment.
    """

    def __init__(self, manipulator: Manipulator, modes: Modes, loads: Sequence[str]) -> None:
        arm, root = manipulator.arm, np.zeros(1)
        rule = Quadrature(arm.breaks, 4 * len(modes) + 40)
        section, none = arm.at(rule.nodes), np.zeros_like(rule.nodes)
        found = _outboard(manipulator, rule)
        moment, force = np.moveaxis(np.array([found[load] for load in loads]), 0, -1)
        # Rows are those of `StrainModes`: at the nodes, and of a clamp that gives.
        clamped = np.repeat(rule.interpolate_to(root), len(arm.root), axis=0) @ moment
        stiffness = np.concatenate([
            none + section.bending_stiffness, none + section.shear_stiffness, arm.root])
        strains = np.concatenate([moment, force, clamped]) / stiffness[:, np.newaxis]
        own = np.concatenate([*modes.fields(rule.nodes)[2:4],
                              np.repeat(modes.rotation(root), len(arm.root), axis=0)])
        stiffness = (stiffness * np.concatenate([
            rule.weights, rule.weights, np.ones(len(arm.root))]))[:, np.newaxis]
        for _ in range(2):  # twice, since cancellation is strong beside many modes
            share = own.T @ (stiffness * strains) / modes.omega[:, np.newaxis]**2
            strains = strains - own @ share
        # The residuals of two loads are also uncoupled from each other, and normalised.
        residuals = StrainModes(np.zeros(len(loads)), rule, strains)
        mass, inertia = manipulator.inertia(rule)
        deflection, rotation, *_ = residuals.fields(rule.points)
        deflection = manipulator.of_masses(deflection, rotation)
        kinetic = (deflection.T * mass) @ deflection + (rotation.T * inertia) @ rotation
        inverse = np.linalg.inv(np.linalg.cholesky(strains.T @ (stiffness * strains)))
        squares, vectors = np.linalg.eigh(inverse @ kinetic @ inverse.T)
        vectors = (inverse.T @ vectors / np.sqrt(squares))[:, ::-1]
        super().__init__(modes, StrainModes(1.0 / np.sqrt(squares[::-1]), rule, _upward(
            rule, strains @ vectors)))


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
    at_root = np.array([length, 0.0, 1.0, pushed, 0.0])  # moments there
    whole += sum(np.outer(at_root, at_root) / each for each in manipulator.arm.root)
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
            'weight': ((rule.integrate_to(rule.points[-1:]) - inner) @ weight
                       + mass[-1] * manipulator.end_effector_offset, weight)}


@functools.lru_cache(maxsize=16)
@with_one_thread
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
    lever = manipulator.hub_radius + manipulator.of_masses(fine.points, np.ones_like(mass))
    centre = free * (mass @ lever) / (manipulator.base_mass + mass.sum())
    scale = 1.0 / np.sqrt(strains.weights * section.axial_stiffness)
    root_mass = np.sqrt(mass)
    matrix = root_mass[:, np.newaxis] * strains.integrate_to(fine.points) * scale
    loads = [matrix.T @ (root_mass * (lever - centre)), matrix.T @ root_mass,
             strains.integrate_to(breaks[-1:])[0] * scale]
    basis = (loads[0] / math.sqrt(loads[0] @ loads[0]))[:, np.newaxis]
    for number in range(1, count):
        loads.append(matrix.T @ (matrix @ basis[:, -1]))
        basis = np.linalg.qr(np.column_stack([basis, loads[number]]))[0]
    _, singular, rows = np.linalg.svd(matrix @ basis, full_matrices=False)
    stretch = scale[:, np.newaxis] * (basis @ (rows.T / singular))
    stretch *= np.sign(stretch[0])
    return AxialModes(1.0 / singular, strains, stretch)
