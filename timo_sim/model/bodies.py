# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The bodies of the manipulator, constants of the equations that follow from them, quadrature."""

from bisect import insort
from dataclasses import dataclass, fields
import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array
from timo_sim.model.functions import motor_effort, motor_torque
from timo_sim.model.layout import MOTOR_FRICTION, TORQUE

SHAPES = 'rectangle', 'round', 'tube', 'box', 'i'


@dataclass(frozen=True)
class Section:
    """
    A cross-section of the arm, or arrays of them: a shape of a material, or measured values.

    Measured values take the place of those of shape and material; 0 stands for none, an infinite
    axial stiffness for one that is not known. Sources:
    paper, section 2.1 and Table 1; shear coefficients of G. R. Cowper, J. Appl. Mech. 33 (1966)
    335-340, those of box and I for thin walls.
    """

    width: float             # size normal to the plane of motion [m]; not of round and tube
    height: float            # size in the plane of motion, the direction of bending [m]
    density: float           # [kg/m3]
    young_modulus: float     # [Pa]
    shear_modulus: float     # [Pa]
    shear_correction: float  # factor kappa of a rectangle, paper eq. (37)
    shape: str = 'rectangle'  # of SHAPES
    wall: float = 0.0        # thickness of the wall of tube and box, of the flanges of i [m]
    web: float = 0.0         # thickness of the web of i [m]
    measured_mass_per_length: float = 0.0    # [kg/m]
    measured_rotary_inertia: float = 0.0     # [kg m]
    measured_bending_stiffness: float = 0.0  # [N m2]
    measured_shear_stiffness: float = 0.0    # [N]
    measured_axial_stiffness: float = 0.0    # [N]

    def _measured(self, name, computed):
        found = getattr(self, name)
        return computed if isinstance(found, float) and found == 0.0 else found

    @property
    def _sizes(self):
        # Width and height of the section and of what is cut out of it, whether they are diameters.
        inner = self.height - 2.0 * self.wall
        if self.shape in ('round', 'tube'):
            return self.height, self.height, *2 * (inner * (self.shape == 'tube'),), True
        across = {'box': 2.0 * self.wall, 'i': self.web}.get(self.shape, self.width)
        return self.width, self.height, self.width - across, inner, False

    @property
    def area(self) -> float:
        """Section area A [m2]."""
        width, height, cut_width, cut_height, is_round = self._sizes
        return (width * height - cut_width * cut_height) * (0.25 * math.pi if is_round else 1.0)

    @property
    def second_moment(self) -> float:
        """Second moment of the section about its neutral axis, I [m4]."""
        width, height, cut_width, cut_height, is_round = self._sizes
        return (width * height**3 - cut_width * cut_height**3) / (
            64.0 / math.pi if is_round else 12.0)

    @property
    def shear_coefficient(self) -> float:
        """Shear correction factor kappa: Cowper's, but for a rectangle the given one."""
        width, height, cut, _, is_round = self._sizes
        nu = 0.5 * self.young_modulus / self.shear_modulus - 1.0  # Poisson's ratio
        if is_round:
            square = (cut / height)**2
            return 6.0 * (1.0 + nu) * (1.0 + square)**2 / (
                (7.0 + 6.0 * nu) * (1.0 + square)**2 + (20.0 + 12.0 * nu) * square)
        if self.shape == 'rectangle':
            return self.shear_correction
        # Sizes of the centre lines; m is the area of the flanges over that of the webs.
        depth, box = height - self.wall, self.shape == 'box'
        n = (width - self.wall if box else width) / depth
        m = n if box else 2.0 * n * self.wall / self.web
        flanges = (10.0 * n**2 * ((3.0 + nu) * m + 3.0 * m**2) if box else
                   30.0 * n**2 * (m + m**2) + 5.0 * nu * n**2 * (8.0 * m + 9.0 * m**2))
        return 10.0 * (1.0 + nu) * (1.0 + 3.0 * m)**2 / (
            12.0 + 72.0 * m + 150.0 * m**2 + 90.0 * m**3
            + nu * (11.0 + 66.0 * m + 135.0 * m**2 + 90.0 * m**3) + flanges)

    @property
    def mass_per_length(self) -> float:
        """Mass per length rho A [kg/m]."""
        return self._measured('measured_mass_per_length', self.density * self.area)

    @property
    def inertia_per_length(self) -> float:
        """Rotary inertia per length rho I [kg m]."""
        return self._measured('measured_rotary_inertia', self.density * self.second_moment)

    @property
    def bending_stiffness(self) -> float:
        """Bending stiffness E I [N m2]."""
        return self._measured('measured_bending_stiffness',
                              self.young_modulus * self.second_moment)

    @property
    def axial_stiffness(self) -> float:
        """Axial stiffness E A [N]."""
        return self._measured('measured_axial_stiffness', self.young_modulus * self.area)

    @property
    def shear_stiffness(self) -> float:
        """Shear stiffness kappa G A [N]."""
        return self._measured('measured_shear_stiffness',
                              self.shear_coefficient * self.shear_modulus * self.area)

    @property
    def ratios(self) -> tuple[float, float]:
        """Rotary inertia over mass [m2]; bending over shear stiffness, over the former."""
        square = self.inertia_per_length / self.mass_per_length
        return square, self.bending_stiffness / (self.shear_stiffness * square)


@dataclass(frozen=True)
class Beam:
    """
    A Timoshenko beam: the arm.

    The fields of the section are floats, or tuples of values at `positions`, with linear
    interpolation. At a position given twice the section jumps.
    """

    length: float  # [m]
    section: Section
    positions: tuple = ()  # distances from the root, from 0 to `length` [m]; empty: uniform
    # Rotational stiffnesses of its clamp, one or, if that does not give, none [N m/rad].
    root: tuple = ()

    @property
    def uniform(self) -> bool:
        """Whether the section is the same all along the arm."""
        return not self.positions

    @property
    def stretches(self) -> bool:
        """Whether its axial stiffness is known."""
        return bool(np.isfinite(self.section.measured_axial_stiffness).all())

    @property
    def breaks(self) -> np.ndarray:
        """Ends of the spans on which the section is smooth, from 0 to the length [m]."""
        if self.uniform:
            return np.array([0.0, self.length])
        return np.unique([0.0, *self.positions, self.length])

    def at(self, xi: np.ndarray) -> Section:
        """Return the sections at distances xi from the root, not at jumps, shape (p,) [m]."""
        if self.uniform:
            return self.section
        values: dict[str, Any] = {
            field.name: getattr(self.section, field.name) for field in fields(Section)}
        for name, value in values.items():
            if np.ndim(value):
                values[name] = np.interp(xi, self.positions, value)
        return Section(**values)


MOST_PLACES = 50  # of a profile; more would cost much and change frequencies by some 1e-6
SAME_PROFILE = 1e-7  # relative difference of profiles that counts as none


@functools.lru_cache(maxsize=8)
def thinned(positions: tuple, profiles: tuple) -> tuple[tuple, tuple, float]:
    """
    Return at most MOST_PLACES positions of profiles, their values there, and what that changes.

    That is the largest relative difference from a value given. Positions ascend, one given twice
    is a jump; each of `profiles` has a value > 0 for each. The positions are those at which linear
    interpolation between earlier ones differs most, so that jumps and kinks stay; the values are
    those of least squares, so that noise is averaged.
    """
    if len(positions) <= MOST_PLACES:
        return positions, profiles, 0.0
    x, given, number = np.array(positions), np.array(profiles).T, np.arange(len(positions))
    chosen, furthest = [0, len(x) - 1], 0
    while True:
        begin = np.clip(np.searchsorted(chosen, number, 'right') - 1, 0, len(chosen) - 2)
        low, high = np.array(chosen)[[begin, begin + 1]]
        share = ((x - x[low]) / np.maximum(x[high] - x[low], np.finfo(float).tiny))[:, np.newaxis]
        distance = np.abs(given[low] * (1.0 - share) + given[high] * share - given) / given
        furthest = int(distance.max(axis=1).argmax())
        if distance[furthest].max() < SAME_PROFILE or len(chosen) == MOST_PLACES:
            break
        insort(chosen, furthest)
    shape = np.zeros((len(x), len(chosen)))
    shape[number, begin], shape[number, begin + 1] = 1.0 - share[:, 0], share[:, 0]
    # What a value stands for is half of the way to its neighbours, or nearly nothing at jumps.
    length = np.convolve(np.diff(x), [0.5, 0.5]) + 1e-9 * x[-1] / len(x)
    values = np.linalg.solve(shape.T @ (shape * length[:, np.newaxis]),
                             shape.T @ (given * length[:, np.newaxis]))
    values = np.clip(values, given.min(axis=0), given.max(axis=0))
    change = np.abs(shape @ values - given) / given
    return tuple(x[chosen].tolist()), tuple(map(tuple, values.T.tolist())), float(change.max())


class Gear(NamedTuple):
    """An elastic gear between rotor and shaft (T60); all values are as seen from the shaft."""

    stiffness: float  # k_g [N m/rad]
    damping: float    # c_g [N m s/rad]
    backlash: float   # the whole play [rad]
    inertia: float    # of the rotor, J_r [kg m2]
    friction: float   # viscous, of the rotor, c_r [N m s/rad]


@dataclass(frozen=True)
class Manipulator:
    """
    Rigid carrier, motor, elastic arm and end effector.

    Source: paper, section 3.1 and Table 1.
    """

    arm: Beam
    carrier_mass: float          # m_c [kg]; carrier and motor only translate
    motor_mass: float            # m_m [kg]
    shaft_inertia: float         # J_m [kg m2]
    end_effector_mass: float     # m_e, at the arm's tip [kg]
    end_effector_inertia: float  # J_e [kg m2]
    carrier_friction: float = 0.0  # viscous, along either axis, c_c [N s/m]
    shaft_friction: float = 0.0    # viscous, c_s [N m s/rad]
    # Mean limits of the Coulomb friction of carrier [N], shaft and rotor [N m] that builds up over
    # a speed, each with this speed [m/s], [rad/s] and its asymmetry (T63).
    coulomb: tuple = 3 * ((0.0, 1.0, 0.0),)
    hub_radius: float = 0.0  # from the shaft's axis to the root of the arm, r_h [m]
    end_effector_offset: float = 0.0  # of its centre of mass, beyond the tip along the arm [m]
    off_tip: bool = False  # whether this centre, or that of a later load, is not at the tip
    spring: tuple = ()  # at most one row, stiffness [N m/rad] and relaxed angle of the shaft [rad]
    gear: Gear | None = None  # None: the rotor is part of the shaft
    # At most one row, of a DC motor with a limit of its current, seen from the shaft: the largest
    # torque [N m], and the viscous friction by its back-EMF [N m s/rad] (T66).
    motor_limit: tuple = ()

    @functools.cached_property
    def clamped(self) -> 'Manipulator':
        """That of the same arm and end effector alone, on which modes depend."""
        return Manipulator(
            arm=self.arm, carrier_mass=0.0, motor_mass=0.0, shaft_inertia=0.0,
            end_effector_mass=self.end_effector_mass,
            end_effector_inertia=self.end_effector_inertia,
            end_effector_offset=self.end_effector_offset)

    @property
    def base_mass(self) -> float:
        """Mass at the root of the arm, m_c + m_m [kg]."""
        return self.carrier_mass + self.motor_mass

    def excess(self, torque: Any, speed: Any) -> Any:
        """Return what of a torque of loads [N m] a limit takes at a speed of the motor (T66)."""
        return torque - motor_torque(self, {TORQUE: torque, MOTOR_FRICTION: 0.0}, speed)

    def effort(self, torque: Any, speed: Any) -> Any:
        """Return the effort [N m] of a torque of loads at a speed of the motor (T66)."""
        return motor_effort(self, {TORQUE: torque, MOTOR_FRICTION: 0.0}, speed)

    def inertia(self, quadrature: 'Quadrature') -> tuple[np.ndarray, np.ndarray]:
        """
        Return M(xi) and J(xi) of the paper's Remark 1, times the weights of an integral.

        At the p nodes, then those of the end effector at the tip: two arrays of shape (p + 1,)
        [kg], [kg m2].
        """
        section, weights = self.arm.at(quadrature.nodes), quadrature.weights
        return (np.concatenate([weights * section.mass_per_length, [self.end_effector_mass]]),
                np.concatenate([weights * section.inertia_per_length,
                                [self.end_effector_inertia]]))

    def of_masses(self, deflection: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """
        Return deflections of the masses of `inertia`, given those of the arm and its rotations.

        Shapes (p + 1, ...); they differ where the end effector's centre of mass is off the tip.
        """
        if not self.end_effector_offset:
            return deflection
        return np.concatenate([deflection[:-1], (
            deflection[-1] + self.end_effector_offset * rotation[-1])[np.newaxis]])


@dataclass(frozen=True)
class Constraints:
    """Degrees of freedom that are removed from the state; no stiff springs are used."""

    # Positions at which the carrier is held, x and y in world axes [m]; None: it is free there.
    carrier: tuple = (None, None)
    # Whether the shaft follows an angle that is given in the load, instead of a torque.
    driven: bool = False
    locked: float | None = None  # angle of a driven shaft that never moves [rad]

    @property
    def free_axes(self) -> list[int]:
        """Axes along which the carrier moves, of 0 (x) and 1 (y)."""
        return [axis for axis in range(2) if self.carrier[axis] is None]


_LEAST_NODES = 4  # in a span


def legendre_values(x: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the Legendre polynomials of degrees below `count`, and their integrals from -1.

    At points in [-1, 1], shape (n,); both have shape (n, count).
    """
    values, integrals = np.empty((2, len(x), count))
    set_legendre(np.ascontiguousarray(x, dtype=float), len(x), count, values.ravel(),
                 integrals.ravel())
    return values, integrals


@entry_point(x=Array((None,)), points=int, count=int, values=Array((None,)),
             integrals=Array((None,)))
def set_legendre(x, points, count, values, integrals):
    """Write what `legendre_values` returns."""
    for i in range(points):
        place, before, value = i * count, 0.0, 1.0
        for n in range(count):
            after = (x[i] * value * (2 * n + 1) - before * n) / (n + 1)
            values[place + n] = value
            integrals[place + n] = (after - before) / (2 * n + 1) if n else x[i] + 1.0
            before, value = value, after


@functools.lru_cache(maxsize=64)
def _rule(count):
    # Nodes, weights, and the matrix from nodal values to Legendre coefficients, in [-1, 1].
    x, weights = legendre.leggauss(count)
    values, _ = legendre_values(x, count)
    to_coefficients = (np.arange(count) + 0.5)[:, np.newaxis] * values.T * weights
    for constant in (x, weights, to_coefficients):
        constant.flags.writeable = False
    return x, weights, to_coefficients


@functools.lru_cache(maxsize=128)
def _matrices(spans, xi):
    # From nodal values to integrals from 0 to points, and to values there; cached, since arms that
    # differ only in section or end effector share them.
    points, past, integrate, interpolate = np.array(xi), np.zeros(len(xi), dtype=bool), [], []
    for start, stop, count in spans:
        x = 2.0 * (points - start) / (stop - start) - 1.0
        here = (x <= 1.0) & ~past if stop < spans[-1][1] else ~past
        # A clipped point left of the span gives 0, one right of it the integral over the span.
        values, integrals = legendre_values(np.clip(x, -1.0, 1.0), count)
        # Not by BLAS, whose threads would change last bits of so large a product.
        integrals, values = np.einsum('apk,kn->apn', np.stack([
            0.5 * (stop - start) * integrals, here[:, np.newaxis] * values]), _rule(count)[2])
        integrate.append(integrals)
        interpolate.append(values)
        past |= here
    matrices = np.hstack(integrate), np.hstack(interpolate)
    for matrix in matrices:
        matrix.flags.writeable = False
    return matrices


@functools.lru_cache(maxsize=64)
def _spanned(ends, count, extra):
    # Spans, nodes, weights and points of a Quadrature; cached as `_matrices` are.
    shares = np.diff(ends) / ends[-1]
    # 1e-9: round-off must not raise a share that is a whole number.
    counts = np.maximum(np.ceil(count * shares - 1e-9).astype(int), _LEAST_NODES) + extra
    spans = tuple(zip(ends, ends[1:], counts.tolist()))
    nodes = np.concatenate([start + 0.5 * (stop - start) * (_rule(n)[0] + 1.0)
                            for start, stop, n in spans])
    weights = np.concatenate([0.5 * (stop - start) * _rule(n)[1] for start, stop, n in spans])
    points = np.append(nodes, ends[-1])
    for constant in (nodes, weights, points):
        constant.flags.writeable = False
    return spans, nodes, weights, points


class Quadrature:
    """
    Gauss-Legendre quadrature on the spans of an arm, whose ends, `breaks`, ascend from 0 [m].

    It has at least `count` nodes, distributed by length, at least four in each span, and `extra`
    further ones in each. Nodal values stand for the polynomial through them in each span. `nodes`
    and `weights`, (n,), and `points`, (n + 1,), the nodes and the tip, are in [m].
    """

    def __init__(self, breaks: ArrayLike, count: int, extra: int = 0) -> None:
        self._spans, self.nodes, self.weights, self.points = _spanned(
            tuple(np.asarray(breaks, dtype=float).tolist()), count, extra)

    def integrate_to(self, xi: ArrayLike) -> np.ndarray:
        """Return the matrix from nodal values to integrals from 0 to points, shape (p, n) [m]."""
        return _matrices(self._spans, tuple(np.asarray(xi, dtype=float).tolist()))[0]

    def interpolate_to(self, xi: ArrayLike) -> np.ndarray:
        """Return the matrix from nodal values to values at the given points, shape (p, n)."""
        return _matrices(self._spans, tuple(np.asarray(xi, dtype=float).tolist()))[1]
