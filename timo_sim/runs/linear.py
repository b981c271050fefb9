# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Linear models of a scene about an equilibrium, continuous or discrete in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.extras import optional
from timo_sim.model.bodies import Quadrature
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import (
    ANGLE, INPUTS, LOADS, Motion, rotate, TIP_TORQUE, TIP_X, TIP_Y, TORQUE, VOLTAGE)
from timo_sim.scene.loads import CHANNELS
from timo_sim.scene.parameters import (
    checked, did_you_mean, NUMBERS, Parameter, ParameterError, TEXTS, warn)
from timo_sim.scene.scene import load_scene, motor_constants, SceneLike
from timo_sim.simulation.snapshot import Joints
from timo_sim.steps.bristles import COLUMNS
from timo_sim.topics.outputs import SENSORS

_PERIOD = Parameter('dt', 1.0, 's', 'period', low=0.0, open_low=True)


@dataclass(frozen=True, repr=False)
class LinearModel:
    """
    `x' = A x + B u`, `y = C x + D u`: deviations from an equilibrium.

    Attributes
    ----------
    A, B, C, D : ndarray, shapes (m, m), (m, u), (y, m), (y, u)
    states, inputs, outputs : tuple of str
        Names with units.
    equilibrium : ndarray, shape (2 (3 + N),)
        The motion from which `x` is the deviation.
    places : ndarray of int, shape (m,)
        Where the states are in a motion.
    dt : float or None
        Period of a discrete-time model [s], `x+ = A x + B u`; None: continuous time.

    Examples
    --------
    >>> import timo_sim
    >>> model = timo_sim.linearize(timo_sim.load_scene({'model.modes': 3}))
    >>> model.select(['torque_N_m'], ['shaft_rad']).to_discrete(0.002).D.shape
    (1, 1)

    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple
    inputs: tuple
    outputs: tuple
    equilibrium: np.ndarray
    places: np.ndarray
    dt: float | None = None

    def __repr__(self):
        time = 'continuous time' if self.dt is None else f'dt = {self.dt:g} s'
        return (f'<LinearModel: {len(self.states)} states, inputs {", ".join(self.inputs)}, '
                f'outputs {", ".join(self.outputs)}, {time}>')

    @checked(inputs=TEXTS, outputs=TEXTS)
    def select(self, inputs: Sequence[str] | None = None,
               outputs: Sequence[str] | None = None) -> LinearModel:
        """
        Return the model with some inputs and outputs, in the order given.

        Raises ParameterError if a name is none of the model's.
        """
        u = _indices(self.inputs, inputs, 'input')
        y = _indices(self.outputs, outputs, 'output')
        return replace(self, B=self.B[:, u], C=self.C[y], D=self.D[np.ix_(y, u)],
                       inputs=tuple(self.inputs[place] for place in u),
                       outputs=tuple(self.outputs[place] for place in y))

    @checked(motion=NUMBERS)
    def state(self, motion: Motion | ArrayLike) -> np.ndarray:
        """Return the states `x` of motions, shape (..., 2 (3 + N)), shape (..., m)."""
        return (np.asarray(motion) - self.equilibrium)[..., self.places]

    @checked(x=NUMBERS)
    def to_motion(self, x: ArrayLike) -> Motion:
        """Return the Motion of states `x`, shape (..., m); other coordinates are at rest."""
        x = np.asarray(x, dtype=float)
        values = np.broadcast_to(self.equilibrium, (*x.shape[:-1], len(self.equilibrium))).copy()
        values[..., self.places] += x
        return Motion(values)

    def state_space(self) -> Any:
        """Return the model as a `scipy.signal.StateSpace`."""
        from scipy.signal import StateSpace
        time = {} if self.dt is None else {'dt': self.dt}
        return StateSpace(self.A, self.B, self.C, self.D, **time)

    def to_control(self) -> Any:
        """Return the model as a `control.StateSpace` of python-control, names included."""
        with optional():
            from control import ss
        return ss(self.A, self.B, self.C, self.D, self.dt or 0, states=list(self.states),
                  inputs=list(self.inputs), outputs=list(self.outputs))

    def to_discrete(self, dt: float) -> LinearModel:
        """
        Return the model at the instants of a controller that holds its commands for dt [s].

        It is exact: `x` after a period is `A x + B u`. Raises ParameterError if the period is not
        > 0, or the model is of discrete time already.
        """
        from scipy.signal import cont2discrete
        if self.dt is not None:
            raise ParameterError(f'the model is of discrete time already, dt = {self.dt:g} s')
        dt = _PERIOD.check(dt)
        a, b, c, d, _ = cont2discrete((self.A, self.B, self.C, self.D), dt, method='zoh')
        return replace(self, A=a, B=b, C=c, D=d, dt=dt)

    @checked(frequency=NUMBERS)
    def frequency_response(self, frequency: Any) -> np.ndarray:
        """Return outputs per input at frequencies, shape (n,) [Hz], complex, (n, y, u)."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)[:, np.newaxis, np.newaxis]
        if self.dt is not None:
            s = np.exp(s * self.dt)  # z on the unit circle
        return self.C @ np.linalg.solve(s * np.eye(len(self.A)) - self.A,
                                        self.B[np.newaxis]) + self.D

    def poles(self) -> np.ndarray:
        """
        Return the poles by magnitude, shape (m,) [1/s].

        The poles s of a discrete-time model belong to its eigenvalues `z = exp(s dt)`.
        """
        poles = np.linalg.eigvals(self.A)
        if self.dt is not None:
            poles = np.log(poles.astype(complex)) / self.dt
        return poles[np.lexsort((poles.imag, np.abs(poles).round(9)))]


def _indices(names, chosen, kind):
    if chosen is None:
        return list(range(len(names)))
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ParameterError(f'{kind} {unknown[0]!r} is none of {", ".join(names)}'
                             f'{did_you_mean(unknown[0], names)}')
    return [names.index(name) for name in chosen]


# Step of the fourth-order differences: part of the arm's length, or angle of the section that
# turns most [rad]. The tip's deflection is no measure, since a heavy tip hardly moves.
_DIFFERENCE = 1e-3
_STENCIL = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))
_INPUTS = [*CHANNELS.values(), VOLTAGE]  # columns of a load
# Largest rate of a state that counts as an equilibrium [1/s].
_MAX_RATE = 1e-9


@checked(at=NUMBERS)
def linearize(scene: SceneLike, at: np.ndarray | None = None) -> LinearModel:
    """
    Return the linear model of a scene about a state of rest, without dry friction that sticks.

    Friction that builds up over a speed is viscous about rest: its limit over that speed. With
    presliding it is a spring: its limit over that way. States
    are free coordinates, then their rates. Inputs are forces on carrier, tip and arm in world
    axes, torques on shaft and tip, the voltage at a DC motor; without those that have no effect.
    Outputs are carrier and shaft, tip in world axes, deflection and rotation of the tip, its angle
    as seen from the root, strain at the root, rates of carrier and shaft, the angle of the rotor
    of an elastic gear, and what an IMU at the tip measures: angular velocity, and specific force
    along (`..._along_...`) and across the tip.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    at : Motion or ndarray, shape (2 (3 + N),), optional
        A motion, see `model.layout`; by default the scene's initial one. A shaft that is
        driven or locked stays where it is. The scene's loads of t = 0 act with
        `initial.equilibrium`, otherwise none.

    Raises
    ------
    ParameterError
        If the motion is no equilibrium.

    Warns
    -----
    ModelWarning
        If friction builds up over a speed or a way, since the model holds for smaller motions
        alone.

    Examples
    --------
    >>> import timo_sim
    >>> model = timo_sim.linearize(timo_sim.load_scene({'model.modes': 3}))
    >>> model.A.shape
    (12, 12)

    """
    scene = load_scene(scene)
    at = scene.initial_motion() if at is None else np.array(at, dtype=float)
    half = len(at) // 2
    load = scene.load_at_start() if scene.values['initial.equilibrium'] else np.zeros(LOADS)
    load[ANGLE] = at[2]
    # Small changes about an equilibrium do not reach the limit of the motor's current.
    scene = scene.vary({'motor.dc.current_limit': math.inf})
    formulation = scene.build()
    state = formulation.state(at)
    moving, rate = at[half:], np.abs(formulation.rate(state, load))
    round_off = _MAX_RATE * (1.0 + np.abs(formulation.linear) @ np.abs(state))
    if moving.any() or not (rate <= round_off).all():
        raise ParameterError(
            'a scene is linearised about an equilibrium, where nothing moves; got speeds of up to '
            f'{np.abs(moving).max():.3g} and rates of the state of up to {rate.max():.3g}: set '
            'initial.equilibrium, or give another motion as `at`')
    # By columns x, y, shaft, and rotor.
    steep = np.array(formulation.manipulator.coulomb)[[0, 0, 1, 2], 0] > 0.0
    free = [*(k in formulation.axes for k in (0, 1)), not formulation.driven,
            bool(formulation.gear)]
    if (steep & free).any():
        warn('the linear model has the viscous friction of speeds well below coulomb_speed: for '
             'faster motions linearise without Coulomb friction')
    if scene.bristles.any():
        warn('the linear model has the spring of motions within coulomb_presliding: for larger '
             'motions linearise without Coulomb friction')
    a, to_state, places = state_matrix(formulation, at, load)

    # A rate is linear in a load. That of a voltage is the torque of the motor.
    units = {INPUTS[column].column: np.eye(LOADS)[column] for column in _INPUTS}
    units[INPUTS[VOLTAGE].column] = np.eye(LOADS)[TORQUE] * motor_constants(scene.values)[0]
    inputs = {name: formulation.rate(state, load + unit) - formulation.rate(state, load)
              for name, unit in units.items()}
    inputs = {name: per_load for name, per_load in inputs.items() if per_load.any()}
    b = np.linalg.solve(to_state, np.reshape([*inputs.values()], (len(inputs), len(a))).T)

    still = _outputs(formulation, at, load)
    c = _jacobian(formulation, lambda motion: _outputs(formulation, motion, load), at, places)
    # They are linear in a load. What acts at the tip also bends the arm beyond its modes.
    residual = _residual(formulation, at)
    d = np.stack([_outputs(formulation, at, load + units[name]) - still + residual @ units[name]
                  for name in inputs], axis=-1)
    # About rest bristles are springs at their joints.
    turns = np.column_stack([formulation.driven_turns, np.eye(half)[2]])[places[:len(a) // 2]]
    for column, turn, (forward, backward, reach) in zip(COLUMNS, turns.T, scene.bristles):
        if reach:
            unit, spring = np.eye(LOADS)[column], 0.5 * (forward + backward) / reach * turn
            a[:, :len(turn)] -= np.outer(np.linalg.solve(to_state, formulation.rate(
                state, load + unit) - formulation.rate(state, load)), spring)
            c[:, :len(turn)] -= np.outer(
                _outputs(formulation, at, load + unit) - still + residual @ unit, spring)
    return LinearModel(a, b, c, d, state_names(formulation), tuple(inputs),
                       _output_names(formulation), at, places)


def state_matrix(model: Formulation, at: np.ndarray,
                 load: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return A of `x' = A x` (T49) about a motion, (2 (3 + N),), in which no state changes.

    `x` are the free coordinates and their rates. Also returns the derivatives of the state by
    them, and their places in a motion; shapes (m, m), (m, m), (m,).
    """
    places = state_places(model)
    to_state = _jacobian(model, model.state, at, places)
    rest = _jacobian(model, lambda motion: model.rate(model.state(motion), load)
                     - model.linear @ model.state(motion), at, places)
    return np.linalg.solve(to_state, model.linear @ to_state + rest), to_state, places


def state_places(model: Formulation) -> np.ndarray:
    """Return the places of the states of linear models in a motion, shape (m,)."""
    free = np.array([*model.axes, *range(2 + model.driven, model.size // 2)], dtype=int)
    return np.concatenate([free, model.size // 2 + free])


def difference_steps(model: Formulation) -> np.ndarray:
    """Return steps of differences by each number of a motion, shape (2 (3 + N),)."""
    length = model.manipulator.arm.length
    steps = np.tile(_DIFFERENCE * np.concatenate(
        [[length, length, 1.0], 1.0 / model.section_turn_bound]), 2)
    # Coulomb friction must be linear within the differences of speeds, and a gear within its play.
    joints, slow = model.size // 2 + np.arange(3), np.array(model.manipulator.coulomb)[:, 1]
    steps[joints] = np.minimum(steps[joints], _DIFFERENCE * slow[[0, 0, 1]])
    if model.gear:
        rates = slice(model.size // 2 + 2, None)
        turns = np.where(model.rotor[2:] > 0.0, model.rotor[2:], np.nan)
        steps[rates] = np.fmin(steps[rates], _DIFFERENCE * slow[2] / turns)
        play, place = 0.5 * model.gear.backlash or 1.0, model.gear_place
        steps[place] = min(steps[place], _DIFFERENCE * play / model.rotor[place])
    return steps


def _jacobian(model, function, at, columns):
    """Return the derivatives of a function of motions, shape (k, len(columns))."""
    steps, found = difference_steps(model), []
    for column in columns:
        shift = np.zeros_like(at)
        shift[column] = steps[column]
        found.append(sum(weight * function(at + number * shift) for number, weight in _STENCIL)
                     / steps[column])
    return np.stack(found, axis=-1)


def _of_motion(model):
    # Sensors that the motion alone determines, but the encoder's shaft angle.
    return {sensor.output: sensor.of_motion for sensor in SENSORS
            if sensor.of_motion and sensor.output != 'shaft_rad'
            and (model.gear or not sensor.of_gear)}


def _output_names(model):
    return ('carrier_x_m', 'carrier_y_m', 'shaft_rad', 'tip_x_m', 'tip_y_m',
            'tip_axial_m', 'tip_transverse_m', 'tip_rotation_rad', 'tip_angle_rad', 'root_strain',
            'carrier_x_velocity_m_per_s', 'carrier_y_velocity_m_per_s',
            'shaft_velocity_rad_per_s', *_of_motion(model),
            'gyro_rad_per_s', 'tip_acceleration_along_m_per_s2', 'tip_acceleration_m_per_s2')


def _outputs(model, motion, load):
    """Return the values of `_output_names` in a motion under a load."""
    motions, loads, half = motion[np.newaxis], load[np.newaxis], len(motion) // 2
    accelerations, at_tip = model.accelerations(motions, model.state(motions), loads)
    joints = Joints(model, motions, accelerations, loads, at_tip)
    q, tip = motions[:, 3:half], model.tip_point
    along, across = model.centre_line(q, tip)[0, 0] - [model.manipulator.hub_radius, 0.0]
    return np.concatenate([
        motion[:3], model.world(motions, tip)[0, 0], [along, across],
        model.section_rotation(q, tip)[0], [np.arctan2(across, along)],
        joints.root_strain, motion[half:half + 3],
        *(read(model, motions) for read in _of_motion(model).values()),
        motion[half + 2] + model.section_rotation(motions[:, half + 3:], tip)[0],
        joints.tip_acceleration[0]])


def _residual(model, at):
    """
    Return the static response, (outputs, LOADS), of what modes leave out of the tip.

    It is that of the straight arm in axes of the tip, see doc/theory.md, section 2.
    """
    body, modes, tip = model.manipulator, model.modes, model.tip_point
    count = len(_output_names(model))
    found = np.zeros((count, LOADS))
    if len(modes) == model.axial + bool(model.gear):  # an arm without modes is rigid on purpose
        return found
    rule = Quadrature(body.arm.breaks, 4 * len(modes) + 40)
    section = body.arm.at(rule.nodes)
    # Curvature and shear strain by a force across the tip and by a torque.
    lever = np.stack([body.arm.length - rule.nodes, np.ones_like(rule.nodes)])
    compliance = lever * rule.weights / section.bending_stiffness @ lever.T
    compliance[0, 0] += np.sum(rule.weights / section.shear_stiffness)
    shapes = np.vstack([tip.deflection[:, 0], tip.rotation[:, 0]])
    compliance -= shapes / modes.omega**2 @ shapes.T
    # Force and torque per load, and the tip's outputs per deflection and rotation.
    angle = at[2] + at[3:len(at) // 2] @ tip.rotation[:, 0]
    across = np.array([-np.sin(angle), np.cos(angle)])
    loads, shifts = np.zeros((2, LOADS)), np.zeros((count, 2))
    loads[0, [TIP_X, TIP_Y]], loads[1, TIP_TORQUE] = across, 1.0
    along, sideways = model.centre_line(at[3:len(at) // 2], tip)[0]
    shifts[3:7, 0] = *across, *rotate(-at[2], *across)
    shifts[8, 0] = (along * shifts[6, 0] - sideways * shifts[5, 0]) / (along**2 + sideways**2)
    shifts[7, 1] = 1.0
    return shifts @ compliance @ loads


def state_names(model: Formulation) -> tuple[str, ...]:
    """Return the names of the states of linear models, with units."""
    names = [('carrier_x', 'm'), ('carrier_y', 'm')]
    named = [names[axis] for axis in model.axes] + [('shaft', 'rad')] * (not model.driven) + [
        (f'mode_{n}', 'm_sqrt_kg') for n in range(1, len(model.modes) + 1)]
    return (*(f'{name}_{unit}' for name, unit in named),
            *(f'{name}_rate_{unit}_per_s' if name.startswith('mode') else
              f'{name}_velocity_{unit}_per_s' for name, unit in named))
