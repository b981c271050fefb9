# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Base class of all formulations of the equations of motion: their interface, shared methods."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.compiled.blas import with_one_thread
from timo_sim.compiled.constants import pack, Packed
from timo_sim.model.bodies import Constraints, Manipulator, Quadrature
from timo_sim.model.functions import (
    coulomb, energies, Flow, gear_torque, Outline, rate_once, Root, sense, states, tips, within)
from timo_sim.model.layout import LINKS, LOADS, PUSH_X, PUSH_Y, rotate
from timo_sim.model.modes import axial_modes, JoinedModes, Modes, modes_of


DRAWN = 41  # points of the centre line that views draw


class Points(NamedTuple):
    """Points of the centre line, with the integration weights and mode shapes there."""

    xi: np.ndarray          # distance from the root [m], (p,)
    lever: np.ndarray       # distance from the shaft's axis, r_h + xi [m], (p,)
    integral: np.ndarray    # from nodal values to their integral from 0 [m], (n_g, p)
    deflection: np.ndarray  # W_n, (N, p)
    rotation: np.ndarray    # Phi_n, (N, p)
    displacement: np.ndarray  # along the arm, by the stretch of axial modes, (N, p)


class Sensed(NamedTuple):
    """Accelerations and forces in n motions."""

    specific: np.ndarray  # accelerations of the coordinates less gravity, (n, 3 + N)
    # Force on the carrier [N] and torque on the shaft [N m] that these need, loads, friction and
    # constraints included (T44), in world axes, (n, 3).
    needed: np.ndarray
    # Moment in the arm at its root [N m], strain of the outer fibre at the gauge, specific force
    # at the IMU along its axes [m/s2], (n, 4).
    shown: np.ndarray


_SLOW = 0.1  # least damping ratio of a mode that is slowed down


class Formulation(ABC):
    """
    Equations of motion of a manipulator in N assumed modes.

    Coordinates are x_c, y_c, theta and N modal ones: of modes in bending, then of the twist of an
    elastic gear (T60), then of axial modes if the arm stretches. A *motion* `[x_c, y_c, theta,
    q_1..q_N, d/dt of each]` of size 2 (3 + N) is the same for all formulations: carrier in world
    axes [m], shaft angle [rad], modal coordinates [m sqrt(kg)]. A *state* is what a formulation
    integrates: its free coordinates, then as many momenta or rates; size m.

    Parameters
    ----------
    manipulator : Manipulator
    count : int
        Number of assumed modes in bending; 0 is a rigid arm.
    damping : float or array_like
        Damping ratios zeta_n of the modes of the arm.
    constraints : Constraints
    nodes : int, optional
        Least number of quadrature nodes; by default that of `node_count`.
    static : tuple of str
        See `modes_of`.
    axial : int
        Number of axial modes; 0 for formulations other than `exact`.
    gravity : sequence of float
        Acceleration of free fall along world x and y [m/s2].
    basis : Manipulator, optional
        The same arm with another end effector, whose modes are assumed; by default its own.
    push : float
        Distance from the root to where the loads PUSH_X and PUSH_Y act [m]; 0: they do not.
    gauge, imu : float
        Distances from the root to the strain gauge, and to the IMU [m]; 0: that is at the tip.
    fastest : (float, float)
        Frequencies to which faster static shapes and axial modes are slowed down [rad/s], theory
        (T67).

    Attributes
    ----------
    rotor : ndarray, shape (3 + N,)
        Turn of the rotor, as seen from the shaft, per coordinate; without an elastic gear the
        shaft's.
    damping : ndarray, shape (N,)
        Modal damping ratios zeta_n, that of the gear included.
    modal_damping : ndarray, shape (N,)
        Coefficients 2 zeta_n omega_n [1/s], larger where a mode is slowed down (T67).
    axes : ndarray of int
        World axes along which the carrier is free, of 0 and 1.
    driven : int
        1 if the shaft is driven or locked, else 0: the first free one of theta, q_1..q_N.
    linear : ndarray, shape (m, m)
        Constant linear part of the state's rate; the compiled rate is the rest.
    tables, packed : NamedTuple, packed constants
        Constants of the compiled functions, and the same packed by the attribute `pack`.
    sectors : int
        Number of sectors of half a turn, each with its linear part, see `Exact.in_sector`; or 0.
    speed_limit : float
        Shaft speed above which the equations are unstable, whatever the step [rad/s].
    any_size : bool
        Whether `sense` is that of `of_any_size`.

    """

    sectors, speed_limit, any_size = 0, math.inf, False

    @with_one_thread
    def __init__(self, manipulator: Manipulator, count: int, damping: ArrayLike = 0.0,
                 constraints: Constraints = Constraints(), nodes: int | None = None,
                 static: tuple[str, ...] = (), axial: int = 0,
                 gravity: Sequence[float] = (0.0, 0.0), basis: Manipulator | None = None,
                 push: float = 0.0, gauge: float = 0.0, imu: float = 0.0,
                 fastest: tuple[float, float] = (math.inf, math.inf)) -> None:
        self.manipulator, self.constraints = manipulator, constraints
        self.gravity = np.array(gravity, dtype=float)
        basis = basis or manipulator
        self.modes: Modes = modes_of(basis.clamped, count, static)
        self.axial = axial
        self.gear: Any = manipulator.gear
        if self.gear:  # its mode turns the rotor against the shaft (T60)
            self.modes = JoinedModes(self.modes, Modes(np.array([
                math.sqrt(self.gear.stiffness / self.gear.inertia)])))
        # Modes are orthonormal only for the end effector that they were computed with.
        self.own_modes = basis == manipulator
        if axial:
            self.modes = JoinedModes(self.modes, axial_modes(basis, axial, constraints))
        # Static shapes follow the modes in bending, axial modes are the last; others stay as fast.
        self.slower = np.ones(len(self.modes))
        for part, limit in zip((slice(count, count + len(static)), slice(
                len(self.modes) - axial, None)), fastest):
            self.slower[part] = np.maximum(1.0, self.modes.omega[part] / limit)
        arm = len(self.modes) - bool(self.gear)
        self.damping = np.full(arm, damping, dtype=float)
        self.size = 2 * (3 + len(self.modes))
        self.rotor = np.zeros(self.size // 2)
        self.rotor[2] = 1.0
        if self.gear:
            ratio = 0.5 * self.gear.damping / math.sqrt(self.gear.stiffness * self.gear.inertia)
            self.damping = np.insert(self.damping, arm - axial, ratio)
            self.rotor[self.gear_place] = 1.0 / math.sqrt(self.gear.inertia)
        slow = np.maximum(self.damping, _SLOW * (self.slower > 1.0))
        self.modal_damping = 2.0 * slow * self.modes.omega * self.slower
        self.driven = int(constraints.driven)
        free = constraints.free_axes
        self.axes = np.array(free, dtype=np.int64)
        # Whether carrier x, carrier y and shaft are held, locked or driven.
        self.constrained = np.array([*(k not in free for k in (0, 1)), constraints.driven])
        self.held_position = np.array([position or 0.0 for position in constraints.carrier])
        # Three times the axial modes, so that their strains are resolved.
        self.quadrature = Quadrature(manipulator.arm.breaks,
                                     nodes or max(self.node_count(count, bool(static)),
                                                  self.node_count(3 * axial, True)))
        self.at_nodes = self.modes.fields(self.quadrature.nodes)
        # The points that carry mass, the last of which is the tip.
        masses = Quadrature(manipulator.arm.breaks, self.mass_count(len(self.quadrature.nodes)))
        self.points = self.at(masses.points)
        self.point_mass, self.point_inertia = manipulator.inertia(masses)
        self.centres = self._centres_of(self.points)
        self.arm_mass = self.point_mass.sum()
        self.mass = manipulator.base_mass + self.arm_mass
        self.push_point = self.at([push]) if push else None
        self.gauge, self.imu = gauge, imu
        self.tables, self.linear = self.build()
        self._linear_parts: dict[float, dict[int | None, Any]] = {}

    def __getstate__(self):
        return {**vars(self), '_linear_parts': {}}

    def __deepcopy__(self, memo):
        return self  # it does not change

    @property
    def joint_turns(self) -> np.ndarray:
        """Jacobian, (3 + N, 4), of carrier x, y, rotor and shaft by coordinate."""
        unit = np.eye(3, self.size // 2)
        return np.column_stack([*unit[:2], self.rotor, unit[2]])

    @property
    def gear_place(self) -> int:
        """Place of the gear's coordinate, its twist times `sqrt(J_r)`, in a motion (T60)."""
        return self.size // 2 - self.axial - 1

    @property
    def gear_row(self) -> np.ndarray:
        """What compiled functions need of an elastic gear (T60), shape (1, 3), else (0, 3)."""
        if not self.gear:
            return np.empty((0, 3))
        per_coordinate = self.rotor[self.gear_place]
        return np.array([[per_coordinate, self.gear.friction,
                          0.5 * self.gear.backlash / per_coordinate]])

    @property
    def rotor_matrix(self) -> np.ndarray:
        """Part of the mass matrix by the rotor of an elastic gear, (3 + N, 3 + N) [kg m2]."""
        return self.gear.inertia * np.outer(self.rotor, self.rotor)

    @cached_property
    def free_places(self) -> np.ndarray:
        """Places of the free coordinates and their rates in a motion, shape (m,)."""
        free = np.array([*self.axes, *range(2 + self.driven, self.size // 2)], dtype=np.int64)
        return np.concatenate([free, self.size // 2 + free])

    def linear_parts(self, step: float) -> dict[int | None, Any]:
        """Return the dict in which all `Steps` of a length [s] share their linear parts."""
        return self._linear_parts.setdefault(step, {})

    def sector(self, state: np.ndarray, load: np.ndarray,
               bands_per_speed: np.ndarray | None = None) -> Any:
        """
        Return the numbers of the sectors of states, (..., m), or None where there are no sectors.

        `load`, (..., LOADS), are the loads then; `bands_per_speed`, (...), is that of the tables.
        """
        return None

    def in_sector(self, number: int | None) -> tuple[Any, np.ndarray]:
        """Return the tables and the linear part of a sector; None: those of no sector."""
        return self.tables, self.linear

    @staticmethod
    def node_count(count: int, shapes: bool = False) -> int:
        """
        Return the number of quadrature nodes for N modes, with or without static shapes.

        A Gauss rule resolves a wave with pi nodes per wavelength, and mode N has about N/2
        wavelengths between two boundary layers. 3/2 N nodes are rounded up to multiples of four
        for vector code. Eight, a vector, do for six modes, where they add no more error than the
        modes have; with seven, or with static shapes, tips were off by centimetres. Frequencies do
        not depend on their number, see `at`.
        """
        if count == 6 and not shapes:
            return 8
        return 6 if count <= 3 else 4 * math.ceil((1.5 * count + 0.5) / 4.0)

    @staticmethod
    def mass_count(nodes: int) -> int:
        """Return the number of points that carry mass; products of two modes are integrated."""
        return 2 * nodes + 4

    @abstractmethod
    def build(self) -> tuple[Any, np.ndarray]:
        """Return the tables and the linear part."""

    @abstractmethod
    def tables_at(self, tip: Points) -> Any:
        """Return tables whose tip is at a point."""

    @abstractmethod
    def tables_of_masses(self) -> Any:
        """Return the tables with other masses at other points, of an arm without a base."""

    @cached_property
    def seen(self) -> 'Formulation':
        """The formulation with the IMU's place for a tip: what that shows is all it is for."""
        return self._with_tables(self.tables_at(self.imu_point)) if self.imu else self

    @cached_property
    @with_one_thread
    def beyond(self) -> 'Formulation':
        """The formulation with the masses beyond the gauge alone, whose `effort` they need."""
        if not self.gauge:
            return self
        part, body = copy(self), self.manipulator
        masses = Quadrature(np.union1d(body.arm.breaks, [self.gauge]),
                            self.mass_count(len(self.quadrature.nodes)))
        part.points, part.gear = self.at(masses.points), None
        part.centres = part._centres_of(part.points)
        part.point_mass, part.point_inertia = (
            np.where(masses.points > self.gauge, each, 0.0) for each in body.inertia(masses))
        part.mass = part.arm_mass = part.point_mass.sum() or np.finfo(float).tiny
        part.manipulator = replace(
            body, carrier_mass=0.0, motor_mass=0.0, shaft_inertia=0.0, gear=None)
        return self._with_tables(part.tables_of_masses())

    def _with_tables(self, tables):
        other = copy(self)
        other.tables, other.packed = tables, self.pack(tables)
        return other

    def state(self, motion: np.ndarray) -> np.ndarray:
        """Return the states that belong to motions, (..., 2 (3 + N)), shape (..., m)."""
        motions = np.ascontiguousarray(motion, dtype=float).reshape(-1, self.size)
        found = np.empty((len(motions), len(self.linear)))
        states.of(self.packed, any_size=True)(motions, len(motions), found)
        return found.reshape(*motion.shape[:-1], -1)

    @cached_property
    def tip_travel(self) -> np.ndarray:
        """Travel of the straight arm's tip per x_c, y_c, theta [m/rad] and q_n, (3 + N,)."""
        travel = np.abs(self.points.deflection[:, -1]) + np.abs(self.points.displacement[:, -1])
        return np.concatenate([[1.0, 1.0, self.points.lever[-1]], travel])

    @cached_property
    def packed(self) -> Packed:
        """The tables, packed."""
        return self.pack(self.tables)

    def pack(self, tables: Any, pad: bool = True) -> Packed:
        """Return tables packed for compiled functions, see `compiled.constants`."""
        return pack(tables, pad, motion=self.size, accelerations=self.size // 2,
                    state=len(self.linear))

    @cached_property
    def magnitude_bound(self) -> float:
        """Largest of the numbers from which an energy is computed."""
        body, points = self.manipulator, self.points
        length = body.hub_radius + body.arm.length + abs(body.end_effector_offset)
        numbers = ([body.base_mass, body.shaft_inertia, length], body.spring, points.deflection,
                   points.rotation, self.point_mass, self.point_inertia, self.modes.omega**2,
                   self.gravity, self.at_nodes[3])
        return np.abs(np.concatenate([np.ravel(each) for each in numbers])).max()

    @cached_property
    def section_turn_bound(self) -> np.ndarray:
        """Largest turn, shear and stretch of a section, or turn of the rotor, per q_n, (N,)."""
        _, rotation, _, shear, stretch, _ = self.modes.fields(self.points.xi)
        found = np.max(np.abs(rotation) + np.abs(shear) + np.abs(stretch), axis=0)
        return np.maximum(found, self.rotor[3:]) if self.gear else found

    def tip(self, motion: np.ndarray) -> np.ndarray:
        """Return the tip's position in the arm frame [m], rotation from the shaft [rad], (3,)."""
        return self.tips(motion[np.newaxis])[0]

    def tips(self, motions: np.ndarray) -> np.ndarray:
        """Return what `tip` returns for motions of shape (n, 2 (3 + N)), shape (n, 3)."""
        found = np.empty((len(motions), 3))
        tips(self.packed, np.ascontiguousarray(motions), len(motions), found)
        return found

    def rate(self, state: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return the rate of a state under a load, linear part included, shape (m,)."""
        rate = np.empty(len(state))
        rate_once.of(self.packed, any_size=True)(state, load, rate)
        return self.linear @ state + rate

    @cached_property
    def _sense(self):
        return sense.of(
            self.packed, self.beyond.packed, self.seen.packed,
            pack(Flow(self.linear, self.points.rotation)), pack(self.root),
            any_size=self.any_size)

    def of_any_size(self) -> 'Formulation':
        """Return the formulation with code that is not made for its size, for few calls."""
        other = copy(self)
        other.any_size = True
        other.__dict__.pop('_sense', None)
        return other

    def sense(self, motions: np.ndarray, states: np.ndarray, loads: np.ndarray) -> 'Sensed':
        """
        Return what is Sensed of forces in n motions with their states and loads that act.

        Shapes (n, 2 (3 + N)), (n, m) and (n, LOADS); see `functions.sense_forces`.
        """
        count = len(motions)
        found = Sensed(*(np.empty((count, size)) for size in (self.size // 2, 3, 4)))
        self._sense(self.gravity, *map(np.ascontiguousarray, (motions, states, loads)), count,
                    *found)
        return found

    @cached_property
    def tip_point(self) -> Points:
        """The tip, as `at` returns points."""
        return self.at([self.manipulator.arm.length])

    @cached_property
    def imu_point(self) -> Points:
        """The place of the IMU, as `at` returns points."""
        return self.at([self.imu]) if self.imu else self.tip_point

    @cached_property
    def link_ends(self) -> Points:
        """The root and the ends of LINKS links of the same length, as `at` returns points."""
        return self.at(np.linspace(0.0, self.manipulator.arm.length, LINKS + 1))

    def at(self, xi: ArrayLike) -> Points:
        """
        Return the points at distances xi from the root, shape (p,) [m].

        The polynomial through the nodal values does not integrate the slope of the highest mode
        well. Its integral is therefore corrected in the space of the modes' slopes, of which it
        becomes exact; frequencies of the straight arm are then those of the modes.
        """
        xi = np.asarray(xi, dtype=float)
        integral, (deflection, rotation, *_, displacement) = (
            self.quadrature.integrate_to(xi), self.modes.fields(xi))
        slope, share = self._slopes_at_nodes
        # The exact integrals of the slopes.
        missing = np.concatenate([xi[:, np.newaxis], deflection], axis=1) - integral @ slope
        missing[xi == 0.0] = 0.0  # the root stays where it is, to the last bit
        integral = (integral + missing @ share).T
        if self.manipulator.off_tip:  # one more node, for what is beyond the tip
            integral = np.vstack([integral, np.zeros_like(xi)])
        return Points(xi=xi, lever=self.manipulator.hub_radius + xi, integral=integral,
                      deflection=deflection.T, rotation=rotation.T, displacement=displacement.T)

    @cached_property
    def _slopes_at_nodes(self):
        # Slopes by a turn of the shaft and by the modes, and from nodal values to shares of these.
        _, rotation, _, shear, *_ = self.at_nodes
        slope = np.concatenate([np.ones((len(rotation), 1)), rotation + shear], axis=1)
        weights = np.sqrt(self.quadrature.weights)
        return slope, np.linalg.lstsq(weights[:, np.newaxis] * slope, np.diag(weights), 1e-15)[0]

    def _centres_of(self, points):
        # Centres of mass of the bodies at points: that at the tip may be beyond it.
        if not self.manipulator.off_tip:
            return points
        integral = points.integral.copy()
        integral[len(self.quadrature.nodes), -1] = self.manipulator.end_effector_offset
        lever, deflection = (self.manipulator.of_masses(*each) for each in (
            (points.lever, np.ones_like(points.xi)), (points.deflection.T, points.rotation.T)))
        return points._replace(lever=lever, integral=integral, deflection=deflection.T)

    def project_on_modes(self, deflection: Callable[[np.ndarray], ArrayLike],
                         rotation: Callable[[np.ndarray], ArrayLike]) -> np.ndarray:
        """
        Return the modal coordinates (or rates) of a deflection (or velocity) field, shape (N,).

        `q_n = int M W_n w + J Phi_n phi`, exact to first order in the fields w [m] and phi [rad]
        (or their rates), which are functions of the distance from the root, shape (p,) [m].
        """
        fine = Quadrature(self.manipulator.arm.breaks, 4 * len(self.modes) + 40)
        mass, inertia = self.manipulator.inertia(fine)
        xi, moved = fine.points, self.manipulator.of_masses
        bent, turned = (np.zeros_like(xi) + field(xi) for field in (deflection, rotation))
        across, own, *_ = self.modes.fields(xi)
        return mass * moved(bent, turned) @ moved(across, own) + inertia * turned @ own

    @abstractmethod
    def centre_line(self, q: np.ndarray, points: Points) -> np.ndarray:
        """
        Return the positions of points of the centre line, shape (n, p, 2) [m].

        From the shaft's axis along axes I and II, for modal coordinates q, shape (n, N).
        """

    @abstractmethod
    def centre_line_rate(self, q: np.ndarray, qdot: np.ndarray, points: Points) -> np.ndarray:
        """Return the rate of `centre_line`, components in the arm frame, shape (n, p, 2) [m/s]."""

    def section_rotation(self, q: np.ndarray, points: Points) -> np.ndarray:
        """Return section rotations from the shaft, shape (n, p) [rad]. Source: paper eq. (36)."""
        return q @ points.rotation

    def strain(self, motions: np.ndarray, xi: float) -> np.ndarray:
        """
        Return the strain of the outer fibre of a section, axial strain included, shape (n,).

        `xi` is its distance from the root along the undeformed arm [m]. It is that of the modes;
        that at the root by forces, `functions.root_strain`, converges faster with their number. An
        arm without axial modes has no axial strain.
        """
        return self._split(motions)[0] @ self._strains(np.array([xi]))

    def _strains(self, xi):
        height = np.ravel(self.manipulator.arm.at(xi).height)[0]
        return 0.5 * height * self.modes.curvature(xi)[0] + self.modes.stretch(xi)[0]

    @cached_property
    def root(self) -> Root:
        """The constants of `functions.root_forces` and `functions.root_strain`."""
        body, xi = self.manipulator, np.array([self.gauge])
        section, inboard = body.arm.at(xi), self.at(xi[xi > 0.0])
        acts = np.ones((len(inboard.xi), LOADS))
        if self.push_point and self.push_point.xi[0] < self.gauge:
            acts[:, [PUSH_X, PUSH_Y]] = 0.0
        height, stiffness, axial_stiffness = (float(np.ravel(value)[0]) for value in (
            section.height, section.bending_stiffness, section.axial_stiffness))
        rotor = [self.gear.inertia * self.rotor] if self.gear else []
        return Root(
            base_mass=body.base_mass, shaft_inertia=body.shaft_inertia, hub_radius=body.hub_radius,
            shaft_friction=body.shaft_friction, constrained=self.constrained,
            rotor=np.reshape(rotor, (-1, self.size // 2)),
            strain_of_moment=0.5 * height / stiffness,
            strain_of_force=1.0 / axial_stiffness if self.axial else 0.0,
            strain_of_rates=-self._strains(xi) * self.modal_damping / self.modes.omega**2,
            lever=inboard.lever, deflection=inboard.deflection, integral=inboard.integral.T,
            acts=acts, rotation=inboard.rotation.T)

    def world(self, motions: np.ndarray, points: Points) -> np.ndarray:
        """Return the world positions of points of the centre line, shape (n, p, 2) [m]."""
        along, across = np.moveaxis(self.centre_line(self._split(motions)[0], points), -1, 0)
        turned = np.stack(rotate(motions[..., 2, np.newaxis], along, across), axis=-1)
        return motions[..., np.newaxis, 0:2] + turned

    def shape(self, motions: np.ndarray, deflection_scale: float = 1.0) -> np.ndarray:
        """
        Return the line from the shaft's axis to the tip, to draw, world axes, (n, p, 2) [m].

        Its points are `deflection_scale` times as far from those of the straight arm as they are.
        """
        line = self.world(motions, self._drawn)
        if deflection_scale != 1.0:
            straight = motions.copy()
            straight[:, 3:self.size // 2] = 0.0
            line += (deflection_scale - 1.0) * (line - self.world(straight, self._drawn))
        if self.manipulator.hub_radius:
            line = np.concatenate([motions[:, np.newaxis, :2], line], axis=1)
        return line

    @property
    def outline(self) -> Outline:
        """The constants of `functions.place_point`, for the points that views draw."""
        return Outline(self._drawn.lever, self._drawn.deflection, self._drawn.integral.T)

    @cached_property
    def _drawn(self):
        return self.at(np.linspace(0.0, self.manipulator.arm.length, DRAWN))

    def energy(self, motions: np.ndarray) -> np.ndarray:
        """
        Return the energy of motions, shape (n, 2 (3 + N)), as shape (n,) [J].

        It is kinetic and strain energy, and the potential of gravity, which is 0 at the origin.
        """
        energy = np.empty(len(motions))
        energies(self.packed, np.ascontiguousarray(motions, dtype=float), self.gravity,
                 len(motions), energy)
        return energy

    def gear_torque(self, motions: np.ndarray) -> np.ndarray:
        """Return the torque of an elastic gear on the shaft in motions (T62), (n,) [N m]."""
        gear, place = self.gear, self.gear_place
        if gear is None:
            raise ValueError('the gear is rigid: motor.gear.stiffness is 0')
        twist, rate = (self.rotor[place] * motions[:, begin + place]
                       for begin in (0, self.size // 2))
        return gear_torque(gear.stiffness, gear.damping, 0.5 * gear.backlash, twist, rate)

    def dissipation(self, motions: np.ndarray) -> np.ndarray:
        """
        Return the power that modal damping and friction of the equations take, shape (n,) [W].

        That is the viscous one and the Coulomb friction that builds up over a speed; coordinates
        that are held, locked or driven have none.
        """
        gear, body, rates = self.gear, self.manipulator, motions[:, self.size // 2:]
        x, y, rotor, shaft = (rates @ self.joint_turns).T
        joints = [(body.carrier_friction, 0, x), (body.carrier_friction, 0, y),
                  (body.shaft_friction, 1, shaft)]
        taken = rates[:, 3:]**2 @ self.modal_damping
        if gear:  # its contacts, more than its modal damping
            twist, rate = (self.rotor[self.gear_place] * each[:, self.gear_place]
                           for each in (motions, rates))
            elastic = gear.stiffness * (twist - within(0.5 * gear.backlash, twist))
            taken += (self.gear_torque(motions) - elastic - gear.damping * rate) * rate
            joints.append((gear.friction, 2, rotor))
        for (viscous, joint, speed), held in zip(joints, [*self.constrained, False]):
            if not held:
                taken += (viscous * speed + coulomb(body, joint, speed)) * speed
        return taken

    def mass_matrix(self, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the mass matrix of all coordinates at a motion, and the tip's velocities.

        Shapes (3 + N, 3 + N) and (3, 3 + N); the latter is the tip's velocity in world axes, and
        its angular velocity, per rate.
        """
        half, body = self.size // 2, self.manipulator
        motions = np.tile(motion, (half, 1))
        motions[:, half:] = np.eye(half)
        velocity, turning = self.velocities(motions, self.centres)
        matrix = (np.einsum('kpi,p,lpi->kl', velocity, self.point_mass, velocity)
                  + (turning * self.point_inertia) @ turning.T)
        matrix[range(3), range(3)] += [body.base_mass, body.base_mass, body.shaft_inertia]
        matrix[range(3, half), range(3, half)] += self.slower**2 - 1.0
        if self.gear:
            matrix += self.rotor_matrix
        if self.centres is not self.points:
            velocity, turning = self.velocities(motions, self.tip_point)
        return matrix, np.vstack([velocity[:, -1].T, turning[:, -1]])

    def momentum(self, motions: np.ndarray) -> np.ndarray:
        """
        Return linear momentum in world axes and angular momentum about the world's origin.

        For n motions: shape (n, 3) [kg m/s], [kg m/s], [kg m2/s].
        """
        velocity, turning = self.velocities(motions, self.centres)
        base = motions[:, self.size // 2:][:, :3]
        body = self.manipulator
        position = self.world(motions, self.centres)
        linear = body.base_mass * base[:, :2] + np.einsum('p,npi->ni', self.point_mass, velocity)
        angular = (
            body.base_mass * (motions[:, 0] * base[:, 1] - motions[:, 1] * base[:, 0])
            + body.shaft_inertia * base[:, 2]
            + (position[..., 0] * velocity[..., 1] - position[..., 1] * velocity[..., 0])
            @ self.point_mass
            + turning @ self.point_inertia)
        if self.gear:
            angular += self.gear.inertia * (motions[:, self.size // 2:] @ self.rotor)
        return np.column_stack([linear, angular])

    def _split(self, motions):
        half = self.size // 2
        return motions[..., 3:half], motions[..., half + 3:]

    def velocities(self, motions: np.ndarray, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the velocities of points of the centre line and of the sections there.

        Velocity in world axes, shape (n, p, 2) [m/s], and angular velocity of the sections,
        shape (n, p) [rad/s].

        """
        half = self.size // 2
        q, qdot = self._split(motions)
        omega = motions[..., half + 2, np.newaxis]
        along, across = np.moveaxis(self.centre_line(q, points), -1, 0)
        rate_1, rate_2 = np.moveaxis(self.centre_line_rate(q, qdot, points), -1, 0)
        first, second = rate_1 - omega * across, rate_2 + omega * along
        turned = np.stack(rotate(motions[..., 2, np.newaxis], first, second), axis=-1)
        return (motions[..., np.newaxis, half:half + 2] + turned,
                omega + self.section_rotation(qdot, points))


class PointsOfArm:
    """Fields at points of the arm, for classes with a `model` and a `motion`; (n, ...) of many."""

    def position(self: Any, xi: ArrayLike | None = None) -> np.ndarray:
        """
        Return positions of points of the centre line in world axes, (n, 2) or (n, p, 2) [m].

        `xi`, a float or of shape (p,), is the distance from the root along the undeformed arm [m],
        by default that of the tip; outside of 0 to the arm's length it is a ValueError.
        """
        return self._pick(xi, self.model.world(self.motion.values, self._points(xi)))

    def deflection(self: Any, xi: ArrayLike | None = None) -> np.ndarray:
        """Return axial and transverse deflection in the arm frame, (n, 2) or (n, p, 2) [m]."""
        if xi is None:
            return self._tips()[..., :2] - [self.model.tip_point.lever[0], 0.0]
        points = self._points(xi)
        straight = np.column_stack([points.lever, np.zeros_like(points.xi)])
        return self._pick(xi, self.model.centre_line(self.motion.q, points) - straight)

    def rotation(self: Any, xi: ArrayLike | None = None) -> np.ndarray:
        """Return the rotation of sections relative to the shaft, (n,) or (n, p) [rad]."""
        if xi is None:
            return self._tips()[..., 2]
        return self._pick(xi, self.model.section_rotation(self.motion.q, self._points(xi)))

    def _tips(self: Any) -> np.ndarray:
        motions = self.motion.values
        return self.model.tips(np.atleast_2d(motions)).reshape(*motions.shape[:-1], 3)

    def _points(self: Any, xi: ArrayLike | None) -> Points:
        if xi is None:
            return self.model.tip_point
        length = self.model.manipulator.arm.length
        try:
            xi = np.atleast_1d(np.asarray(xi).astype(float, casting='same_kind'))
        except TypeError:
            raise ValueError(f'xi must be numbers, got {xi!r:.60}') from None
        if xi.ndim > 1:
            raise ValueError(f'xi must be a number or a list of them, got shape {xi.shape}')
        outside = xi[~((0.0 <= xi) & (xi <= length))]
        if len(outside):
            raise ValueError(f'xi must be between 0 and arm.length = {length} m, got {outside[0]}')
        return self.model.at(xi)

    def _pick(self: Any, xi: ArrayLike | None, values: np.ndarray) -> np.ndarray:
        one = xi is None or np.ndim(xi) == 0
        return np.take(values, 0, axis=self.motion.values.ndim - 1) if one else values


def clamped_ratios(model: Formulation, ratios: ArrayLike) -> np.ndarray:
    """
    Return the ratios of the clamped modes that give the manipulator's vibrations stated ratios.

    Let x_n be the modal coordinates of the manipulator's k-th undamped vibration, of unit modal
    mass and frequency Omega_k. Damping of the n-th clamped mode adds `2 zeta_n omega_n x_n^2` to
    `2 zeta_k Omega_k`. This gives as many equations as modes, right to first order in the ratios.

    The ratios are a float or (N,), by ascending frequency of the manipulator's vibrations; damping
    of the model itself is not used. An entry of the result, (N,), is negative if no positive
    damping of the clamped modes gives these ratios.
    """
    half, omega = len(model.linear) // 2, model.modes.omega
    squares, shapes = np.linalg.eig(-model.linear[:half, half:] @ model.linear[half:, :half])
    vibrating = np.argsort(squares.real)[half - len(omega):]
    frequency = np.sqrt(squares.real[vibrating])
    energy = omega[:, np.newaxis]**2 * shapes.real[half - len(omega):, vibrating]**2
    share = energy / energy.sum(axis=0)  # of the clamped modes in the strain energy, (N, N)
    # With x_n^2 = share frequency^2 / omega_n^2.
    matrix = (share / omega[:, np.newaxis]).T * frequency[:, np.newaxis]
    return np.linalg.solve(matrix, np.broadcast_to(ratios, omega.shape))
