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
from timo_sim.model.differences import differences
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import (
    ANGLE, INPUTS, LOADS, Motion, PUSH_X, PUSH_Y, rotate, TIP_TORQUE, TIP_X, TIP_Y, VOLTAGE)
from timo_sim.model.modes import compliance
from timo_sim.scene.loads import CHANNELS
from timo_sim.scene.parameters import (
    checked, CONTACT, did_you_mean, numbers, NUMBERS, Parameter, ParameterError, TEXTS, warn)
from timo_sim.scene.scene import load_scene, Scene, scene_from, SceneLike
from timo_sim.simulation.loads import unit_loads_of
from timo_sim.simulation.snapshot import Joints
from timo_sim.steps.bristles import COLUMNS, REACH
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
    bend : ndarray, shape (m,), or None
        Deflection of the tip per state, in lengths of the arm.

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
    bend: np.ndarray | None = None

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
        motion = numbers('motion', motion, (*np.shape(motion)[:-1], len(self.equilibrium)))
        return (motion - self.equilibrium)[..., self.places]

    @checked(x=NUMBERS)
    def to_motion(self, x: ArrayLike) -> Motion:
        """Return the Motion of states `x`, shape (..., m); other coordinates are at rest."""
        x = numbers('x', x, (*np.shape(x)[:-1], len(self.places)))
        values = np.broadcast_to(self.equilibrium, (*x.shape[:-1], len(self.equilibrium))).copy()
        values[..., self.places] += x
        return Motion(values)

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
        from scipy.linalg import expm  # scipy.signal would take a quarter of a second to import
        if self.dt is not None:
            raise ParameterError('to_discrete needs a model of continuous time, got one of '
                                 f'dt = {self.dt:g} s')
        dt = _PERIOD.check(dt)
        states, inputs = self.B.shape
        a, b = np.hsplit(expm(dt * np.vstack([  # commands are further states, which stay
            np.hstack([self.A, self.B]), np.zeros((inputs, states + inputs))]))[:states], [states])
        return replace(self, A=a, B=b, dt=dt)

    @checked(frequency=NUMBERS)
    def frequency_response(self, frequency: Any) -> np.ndarray:
        """Return outputs per input at frequencies, shape (n,) [Hz], complex, (n, y, u)."""
        s = 2j * np.pi * np.ravel(frequency).astype(float)[:, np.newaxis, np.newaxis]
        if self.dt is not None:
            s = np.exp(s * self.dt)  # z on the unit circle
        try:
            states = np.linalg.solve(s * np.eye(len(self.A)) - self.A, self.B[np.newaxis])
        except np.linalg.LinAlgError:
            raise ParameterError('frequency must be none of a pole, where responses are infinite, '
                                 'such as 0 Hz of a free joint') from None
        return self.C @ states + self.D

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
_INPUTS = [*CHANNELS.values(), VOLTAGE]  # columns of a load
# Largest rate of a state that counts as an equilibrium [1/s].
_MAX_RATE = 1e-9
_ROUND_OFF = 1e-12  # of matrices, relative to what cancels in them
_UNLOADED = 1e-9  # torque of a gear that is not loaded, relative to stiffness times backlash
_LEFT_OUT = 0.02  # largest share of a static response that rates may lack without a warning


@checked(contact=CONTACT, inputs=TEXTS, outputs=TEXTS)
def linearize(scene: SceneLike, at: np.ndarray | None = None, contact: str = '',
              inputs: Sequence[str] | None = None,
              outputs: Sequence[str] | None = None) -> LinearModel:
    """
    Return the linear model of a scene about a state of rest.

    Friction that builds up over a speed is viscous about rest: its limit over that speed. Dry
    friction is the spring of its presliding: its limit over that way. A gear with backlash is in
    contact where the equilibrium loads it; elsewhere `contact` chooses. States are free
    coordinates, then their rates. Inputs are forces on carrier, tip and arm in world axes, torques
    on shaft and tip, the voltage at a DC motor; without those that have no effect. Outputs are
    carrier and shaft, tip in world axes, deflection and rotation of the tip, its angle
    as seen from the root, strain at the root, rates of carrier and shaft, angle and speed of the
    rotor of an elastic gear, and what an IMU at the tip measures: angular velocity, and specific
    force along (`..._along_...`) and across the tip.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    at : Motion or ndarray, shape (2 (3 + N),), optional
        A motion, see `model.layout`; by default the scene's initial one. A shaft that is
        driven or locked stays where it is. The scene's loads of t = 0 act with
        `initial.equilibrium`, otherwise none.
    contact : str
        Of a gear with backlash that the equilibrium does not load: 'closed', as if it had no
        backlash, or 'open', for motions within it.
    inputs, outputs : sequences of str, optional
        Those wanted, in the order given, with units; by default all.

    Raises
    ------
    ParameterError
        If the motion is no equilibrium, the gear's contact is not known, or the model does not
        have a name of `inputs` or `outputs`.

    Warns
    -----
    ModelWarning
        If friction builds up over a speed or a way, since the model holds for smaller motions
        alone; if a wanted rate or acceleration of the tip lacks more than 2 % of the static
        response to a wanted input.

    Examples
    --------
    >>> import timo_sim
    >>> model = timo_sim.linearize({'model.modes': 3}, inputs=['torque_N_m'])
    >>> model.A.shape, model.B.shape
    ((12, 12), (12, 1))

    """
    scene = load_scene(scene)
    start = scene.initial_motion()
    at = start if at is None else numbers('at', at, start.shape).copy()
    half = len(at) // 2
    at[half:half + 2][scene.build().constrained[:2]] = 0.0  # in axes of a driven carrier
    load = scene.load_at_start() if scene.values['initial.equilibrium'] else np.zeros(LOADS)
    load[ANGLE] = at[2]
    # Small changes about an equilibrium do not reach the limit of the motor's current. A step of 0
    # resolves all axial vibrations and static shapes.
    scene = replace(scene_from({**scene.values, 'motor.dc.current_limit': math.inf}, scene.static),
                    step=0.0)
    formulation = scene.build()
    state = formulation.state(at)
    moving, rate = at[half:], np.abs(formulation.rate(state, load))
    round_off = _MAX_RATE * (1.0 + np.abs(formulation.linear) @ np.abs(state))
    if moving.any() or not (rate <= round_off).all():
        raise ParameterError(
            'a scene is linearised about an equilibrium, where nothing moves; got speeds of up to '
            f'{np.abs(moving).max():.3g} and rates of the state of up to {rate.max():.3g}: set '
            'initial.equilibrium, or give another motion as `at`')
    equilibrium = at
    formulation, at = in_contact(scene, formulation, at, contact)
    formulation = formulation.of_any_size()
    state = formulation.state(at)
    warn_of_friction(scene, formulation)
    a, to_state, places = state_matrix(formulation, at, load, scene.bristles)

    # A rate is linear in a load.
    units = {INPUTS[column].column: unit
             for column, unit in zip(_INPUTS, unit_loads_of(scene.values, _INPUTS))}
    rates = {name: formulation.rate(state, load + unit) - formulation.rate(state, load)
             for name, unit in units.items()}
    rates = {name: per_load for name, per_load in rates.items() if per_load.any()}
    b = _solve(to_state, np.reshape([*rates.values()], (len(rates), len(a))).T)

    names = tuple(_outputs(formulation, at, load))

    def shown(motion, load):
        return np.array([*_outputs(formulation, motion, load).values()])

    still = shown(at, load)
    c = _jacobian(formulation, lambda motion: shown(motion, load), at, places)
    # They are linear in a load. What acts on the arm also bends it beyond its modes.
    residual, lacking = _residual(formulation, at, names)
    d = np.stack([shown(at, load + units[name]) - still + residual @ units[name]
                  for name in rates], axis=-1)
    for unit, spring in _springs(formulation, scene.bristles, places):
        c[:, :len(spring)] -= np.outer(
            shown(at, load + unit) - still + residual @ unit, spring)
    bend = c[names.index('tip_transverse_m')] / formulation.manipulator.arm.length
    model = LinearModel(A=a, B=b, C=c, D=d, states=state_names(formulation), inputs=tuple(rates),
                        outputs=names, equilibrium=equilibrium, places=places,
                        bend=bend).select(inputs, outputs)
    if found := [(share, effect, name) for name in model.inputs for effect in model.outputs
                 if (share := lacking[names.index(effect)] @ units[name]) > _LEFT_OUT]:
        share, effect, name = max(found)
        warn(f'{effect} of the linear model lacks {100.0 * share:.0f} % of the static response '
             f'to {name}: name the load in model.static_modes, or take more model.modes')
    return model


def in_contact(scene: Scene, model: Formulation, at: np.ndarray,
               contact: str) -> tuple[Formulation, np.ndarray]:
    """
    Return the model for small motions about rest of a scene's gear, and the motion at rest in it.

    Where the gear has backlash, the model of its contact has none, and the motion, (2 (3 + N),),
    is moved by it. `contact` and errors are as of `linearize`.
    """
    gear = model.gear
    backlash = gear.backlash if gear else 0.0
    torque = float(model.gear_torque(at[np.newaxis])[0]) if backlash else math.inf
    loaded = abs(torque) > _UNLOADED * (gear.stiffness * backlash if gear else 0.0)
    if loaded and contact == 'open':
        raise ParameterError('contact must be closed where the gear '
                             + (f'is loaded, by {torque:g} N m' if backlash else 'has no backlash')
                             + ', got open')
    if not loaded and not contact:
        raise ParameterError(
            f'contact must be closed or open with motor.gear.backlash = {backlash:g} rad, because '
            'nothing loads the gear at rest: closed is for motions that are large beside the '
            'backlash, open for motions within it; or load the gear by initial.equilibrium and '
            'load.torque')
    if not backlash:
        return model, at
    place, at = model.gear_place, at.copy()
    play = 0.5 * backlash / model.rotor[place]
    at[place] = 0.0 if contact == 'open' else at[place] - np.clip(at[place], -play, play)
    if contact == 'open':
        return model, at
    body = replace(model.manipulator, gear=gear._replace(backlash=0.0))
    return replace(scene, manipulator=body).build(), at


def warn_of_friction(scene: Scene, model: Formulation) -> None:
    """Warn of friction of which a linear model has the limit of small motions."""
    # By columns x, y, shaft, and rotor.
    steep = np.array(model.manipulator.coulomb)[[0, 0, 1, 2], 0] > 0.0
    free = [*(k in model.axes for k in (0, 1)), not model.driven, bool(model.gear)]
    if (steep & free).any():
        warn('the linear model has the viscous friction of speeds well below coulomb_speed: for '
             'faster motions linearise without Coulomb friction')
    if scene.bristles[:, REACH].any():
        warn('the linear model has the spring of motions within coulomb_presliding: for larger '
             'motions linearise without Coulomb friction')


def _springs(model, bristles, places):
    """Yield springs of `Scene.bristles` about rest: unit of load, (LOADS,), and its row of A."""
    turns = model.joint_turns[places[:len(places) // 2]]
    for column, turn, (forward, backward, reach, more, _) in zip(COLUMNS, turns.T, bristles):
        if reach:
            spring = 0.5 * (forward + backward) * (1.0 + more) / reach
            yield np.eye(LOADS)[column], spring * turn


def state_matrix(model: Formulation, at: np.ndarray, load: np.ndarray,
                 bristles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return A of `x' = A x` (T49) about a motion, (2 (3 + N),), in which no state changes.

    `x` are the free coordinates and their rates; `bristles` are those of the scene, which are
    springs about rest. Also returns the derivatives of the state by them, and their places in a
    motion; shapes (m, m), (m, m), (m,).
    """
    places = model.free_places
    to_state = _jacobian(model, model.state, at, places)
    rest = _jacobian(model, lambda motion: model.rate(model.state(motion), load)
                     - model.linear @ model.state(motion), at, places)
    flow, state = model.linear @ to_state + rest, model.state(at)
    flow[np.abs(flow) < _ROUND_OFF * (np.abs(model.linear) @ np.abs(to_state))] = 0.0
    a = _solve(to_state, flow)
    for unit, spring in _springs(model, bristles, places):
        a[:, :len(spring)] -= np.outer(_solve(
            to_state, model.rate(state, load + unit) - model.rate(state, load)), spring)
    return a, to_state, places


def _solve(to_state, rates):
    # What is but round-off is 0, so that a rotor within its play moves nothing else.
    found = np.linalg.solve(to_state, rates)
    found[np.abs(found) < _ROUND_OFF * (np.abs(np.linalg.inv(to_state)) @ np.abs(rates))] = 0.0
    return found


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
    def moved(shifts):
        motions = np.tile(at, (len(shifts), 1))
        motions[:, columns] += shifts
        return np.array([function(motion) for motion in motions])
    return differences(moved, difference_steps(model)[columns], 4)[1]


def _outputs(model, motion, load):
    """Return the outputs of linear models by name with unit, in a motion under a load."""
    motions, half = motion[np.newaxis], len(motion) // 2
    joints, q, tip = Joints(model, motions, load[np.newaxis]), motions[:, 3:half], model.tip_point
    along, across = model.centre_line(q, tip)[0, 0] - [model.manipulator.hub_radius, 0.0]
    x, y = model.world(motions, tip)[0, 0]
    # Sensors that the motion alone determines, but the encoder's shaft angle.
    sensors = {sensor.output: sensor.of_motion(model, motions)[0] for sensor in SENSORS
               if sensor.of_motion and sensor.output != 'shaft_rad'
               and (model.gear or not sensor.of_gear)}
    rotor = {'rotor_velocity_rad_per_s': motion[half:] @ model.rotor} if model.gear else {}
    specific = joints.tip_acceleration[0]
    return {
        'carrier_x_m': motion[0], 'carrier_y_m': motion[1], 'shaft_rad': motion[2],
        'tip_x_m': x, 'tip_y_m': y, 'tip_axial_m': along, 'tip_transverse_m': across,
        'tip_rotation_rad': model.section_rotation(q, tip)[0, 0],
        'tip_angle_rad': np.arctan2(across, along), 'root_strain': joints.root_strain[0],
        'carrier_x_velocity_m_per_s': motion[half],
        'carrier_y_velocity_m_per_s': motion[half + 1],
        'shaft_velocity_rad_per_s': motion[half + 2], **sensors, **rotor,
        'gyro_rad_per_s': joints.tip_turning[0],
        'tip_acceleration_along_m_per_s2': specific[0],
        'tip_acceleration_m_per_s2': specific[1]}


def _residual(model, at, names):
    """
    Return the static response of outputs, (names, LOADS), of what modes leave out of the tip.

    It is that of the straight arm in axes of the tip and of the point that is pushed, see
    doc/theory.md, section 2. What of it is in rates, which have no direct feedthrough, is
    returned as a share of the whole response, of the same shape.
    """
    body, modes, tip, half = model.manipulator, model.modes, model.tip_point, len(at) // 2
    found, lacking = np.zeros((2, len(names), LOADS))
    if len(modes) == model.axial + bool(model.gear):  # an arm without modes is rigid on purpose
        return found, lacking
    q = at[3:half]
    pushed = model.push_point.xi[0] if model.push_point else body.arm.length
    whole, shapes = compliance(body, modes, pushed, bool(model.axial))
    nodes = model.quadrature.nodes  # less than those of the integral, which has one in a hub
    shapes[[1, 4]] = [each.integral[:len(nodes), 0] @ modes.stretch(nodes)  # as the model has them
                      for each in (tip, model.push_point or tip)]
    residual = whole - shapes / modes.omega**2 @ shapes.T
    ends = np.array([body.arm.length, pushed])
    # Those loads per load; the tip's outputs per its deflection across and along, and rotation.
    loads, shifts = np.zeros((5, LOADS)), np.zeros((len(names), 3))
    turned = at[2] + modes.rotation(ends) @ q
    for angle, rows, columns in zip(turned, ([0, 1], [3, 4]), ([TIP_X, TIP_Y], [PUSH_X, PUSH_Y])):
        loads[np.ix_(rows, columns)] = [-np.sin(angle), np.cos(angle)], [np.cos(angle),
                                                                         np.sin(angle)]
    loads[2, TIP_TORQUE] = 1.0
    directions = loads[:2, [TIP_X, TIP_Y]].T
    shifts[3:7, :2] = *directions, *rotate(-at[2], *directions)
    place = model.centre_line(q, tip)[0] - [body.hub_radius, 0.0]
    shifts[8] = (place[0] * shifts[6] - place[1] * shifts[5]) / (place @ place)
    shifts[7, 2] = 1.0
    # The tip turns, and moves across itself.
    for name, row in ('gyro_rad_per_s', 2), ('tip_acceleration_m_per_s2', 0):
        response = np.abs(whole[row])
        share = np.divide(np.abs(residual[row]), response, where=response > 0.0, out=np.zeros(5))
        lacking[names.index(name)] = (share[:, np.newaxis] * (loads != 0.0)).max(axis=0)
    return shifts @ residual[:3] @ loads, lacking


def state_names(model: Formulation) -> tuple[str, ...]:
    """Return the names of the states of linear models, with units."""
    names = [('carrier_x', 'm'), ('carrier_y', 'm')]
    named = [names[axis] for axis in model.axes] + [('shaft', 'rad')] * (not model.driven) + [
        (f'mode_{n}', 'm_sqrt_kg') for n in range(1, len(model.modes) + 1)]
    return (*(f'{name}_{unit}' for name, unit in named),
            *(f'{name}_rate_{unit}_per_s' if name.startswith('mode') else
              f'{name}_velocity_{unit}_per_s' for name, unit in named))
