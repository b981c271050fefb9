# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Linear models of a scene about an equilibrium, continuous or discrete in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from timo_sim.extras import optional
from timo_sim.model.bodies import Quadrature
from timo_sim.model.layout import ANGLE, INPUTS, LOADS, rotate, TIP_TORQUE, TIP_X, TIP_Y
from timo_sim.scene.files import html_table
from timo_sim.scene.loads import CHANNELS
from timo_sim.scene.parameters import did_you_mean, Parameter, ParameterError
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.simulation.snapshot import Joints
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
    dt: float | None = None

    def __repr__(self):
        time = 'continuous time' if self.dt is None else f'dt = {self.dt:g} s'
        return (f'<LinearModel: {len(self.states)} states, inputs {", ".join(self.inputs)}, '
                f'outputs {", ".join(self.outputs)}, {time}>')

    def _repr_html_(self):
        return html_table('LinearModel', {
            'states': ', '.join(self.states), 'inputs': ', '.join(self.inputs),
            'outputs': ', '.join(self.outputs),
            'frequencies [Hz]': ', '.join(f'{each:.4g}' for each in self.frequencies()),
            'time': 'continuous' if self.dt is None else f'dt = {self.dt:g} s'})

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

    def frequencies(self) -> np.ndarray:
        """Return the natural frequencies of the oscillating poles, ascending [Hz]."""
        poles = self.poles()
        return np.abs(poles[poles.imag > 1e-3]) / (2.0 * np.pi)


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
_INPUTS = {INPUTS[column].column: column for column in CHANNELS.values()}
# Largest rate of a state that counts as an equilibrium [1/s].
_MAX_RATE = 1e-9


def linearize(scene: SceneLike, at: np.ndarray | None = None) -> LinearModel:
    """
    Return the linear model of a scene about a state of rest, without its dry friction.

    Friction that builds up over a speed is viscous about rest: its limit over that speed. States
    are free coordinates, then their rates. Inputs are forces on carrier and tip in world axes,
    torques on shaft and tip; without those that have no effect. Outputs are carrier and shaft, tip
    in world axes, deflection and rotation of the tip, strain at the root, rates of carrier and
    shaft, acceleration of the tip across the arm, which is that also in gravity, while the sensor
    of that name measures specific force.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    at : ndarray, shape (2 (3 + N),), optional
        A motion, see `model.layout`; by default the scene's initial one. A shaft that is
        driven or locked stays where it is. The scene's loads of t = 0 act with
        `initial.equilibrium`, otherwise none.

    Raises
    ------
    ParameterError
        If the motion is no equilibrium.

    Examples
    --------
    >>> import timo_sim
    >>> model = timo_sim.linearize(timo_sim.load_scene({'model.modes': 3}))
    >>> len(model.frequencies())
    3

    """
    scene = load_scene(scene)
    formulation = scene.build()
    at = scene.initial_motion() if at is None else np.asarray(at, dtype=float)
    half, axes, driven = formulation.size // 2, list(formulation.axes), formulation.driven
    load = scene.load_at_start() if scene.values['initial.equilibrium'] else np.zeros(LOADS)
    load[ANGLE] = at[2]
    state = formulation.state(at)
    moving, rate = at[half:], np.abs(formulation.rate(state, load))
    round_off = _MAX_RATE * (1.0 + np.abs(formulation.linear) @ np.abs(state))
    if moving.any() or not (rate <= round_off).all():
        raise ParameterError(
            'a scene is linearised about an equilibrium, where nothing moves; got speeds of up to '
            f'{np.abs(moving).max():.3g} and rates of the state of up to {rate.max():.3g}: set '
            'initial.equilibrium, or give another motion as `at`')
    free = np.array([*axes, *range(2 + driven, half)], dtype=int)
    free, half = np.concatenate([free, half + free]), len(free)
    length = formulation.manipulator.arm.length
    steps = np.tile(_DIFFERENCE * np.concatenate(
        [[length, length, 1.0], 1.0 / formulation.section_turn_bound]), 2)
    # Coulomb friction must be linear within the differences of speeds.
    joints = formulation.size // 2 + np.arange(3)
    speeds = np.array(formulation.manipulator.coulomb)[[0, 0, 1], 1]
    steps[joints] = np.minimum(steps[joints], _DIFFERENCE * speeds)

    def jacobian(function):
        return _jacobian(function, at, steps, free)

    # x holds coordinates and rates; the formulation integrates state(x).
    to_state = jacobian(formulation.state)
    rest = jacobian(lambda motion: formulation.rate(formulation.state(motion), load)
                    - formulation.linear @ formulation.state(motion))
    a = np.linalg.solve(to_state, formulation.linear @ to_state + rest)

    # A rate is linear in a load.
    inputs = {name: formulation.rate(state, load + np.eye(LOADS)[column])
              - formulation.rate(state, load) for name, column in _INPUTS.items()}
    inputs = {name: per_load for name, per_load in inputs.items() if per_load.any()}
    b = np.linalg.solve(to_state, np.reshape([*inputs.values()], (len(inputs), len(a))).T)

    outputs = _Outputs(formulation, load)
    c = jacobian(outputs.values)
    columns = [_INPUTS[name] for name in inputs]
    # What acts at the tip also bends the arm beyond its modes.
    d = outputs.residual(at)[:, columns]
    # Root strain and tip acceleration depend on loads, and on accelerations: rows of A and B.
    strain = outputs.strain_per(at, accelerations=np.eye(formulation.size // 2)[free[:half]])
    c[outputs.root_strain] += strain @ a[half:]
    d[outputs.root_strain] = strain @ b[half:] + outputs.strain_per(
        at, loads=np.eye(LOADS)[columns])
    # The accelerometer turns with the tip, and gravity with respect to it.
    angle = outputs.tip_angle(at)
    across = jacobian(lambda motion: outputs.across(motion, angle))[:, :half]
    turning = (formulation.gravity @ [np.cos(angle), np.sin(angle)]) * jacobian(
        lambda motion: outputs.tip_angle(motion)[np.newaxis])
    c = np.vstack([c, across @ a[half:] + turning])
    d = np.vstack([d, across @ b[half:]])
    return LinearModel(a, b, c, d, _state_names(axes, driven, len(formulation.modes)),
                       tuple(inputs), (*outputs.names, 'tip_acceleration_m_per_s2'))


def _jacobian(function, at, steps, columns):
    """Return the derivatives of a function of motions, shape (k, len(columns))."""
    found = []
    for column in columns:
        shift = np.zeros_like(at)
        shift[column] = steps[column]
        found.append(sum(weight * function(at + number * shift) for number, weight in _STENCIL)
                     / steps[column])
    return np.stack(found, axis=-1)


_NAMES = ('carrier_x_m', 'carrier_y_m', 'shaft_rad', 'tip_x_m', 'tip_y_m',
          'tip_axial_m', 'tip_transverse_m', 'tip_rotation_rad', 'root_strain',
          'carrier_x_velocity_m_per_s', 'carrier_y_velocity_m_per_s',
          'shaft_velocity_rad_per_s')
# Sensors that the motion alone determines, unless they are among these.
_OF_MOTION = {sensor.output: sensor.of_motion for sensor in SENSORS
              if sensor.of_motion and sensor.output not in _NAMES}


class _Outputs:
    """The outputs of the linear model as functions of a motion."""

    names = (*_NAMES, *_OF_MOTION)
    root_strain = names.index('root_strain')

    def __init__(self, formulation, load):
        self._formulation, self._half, self._load = formulation, formulation.size // 2, load
        self._tip = formulation.at([formulation.manipulator.arm.length])

    def values(self, motion):
        """Return the values of `names` in a motion, where nothing accelerates."""
        base, rates = motion[:3], motion[self._half:self._half + 3]
        q = motion[np.newaxis, 3:self._half]
        return np.concatenate([
            base, self._world(motion), self._formulation.centre_line(q, self._tip)[0, 0],
            self._formulation.section_rotation(q, self._tip)[0],
            self._strain(motion, np.zeros((1, self._half)), self._load[np.newaxis]), rates,
            *(read(self._formulation, motion[np.newaxis]) for read in _OF_MOTION.values())])

    def strain_per(self, motion, accelerations=None, loads=None):
        """Return the strain at the root per each of k accelerations, or k loads, shape (k,)."""
        count = len(loads if accelerations is None else accelerations)
        accelerations = np.zeros((count, self._half)) if accelerations is None else accelerations
        loads = self._load + (np.zeros((count, LOADS)) if loads is None else loads)
        still = self._strain(motion, np.zeros((1, self._half)), self._load[np.newaxis])
        return self._strain(motion, accelerations, loads) - still

    def _strain(self, motion, accelerations, loads):
        return Joints(self._formulation, np.tile(motion, (len(loads), 1)), accelerations,
                      loads).root_strain

    def residual(self, at):
        """
        Return the static response, (outputs, LOADS), of what modes leave out of the tip.

        It is that of the straight arm in axes of the tip, see doc/theory.md, section 2.
        """
        body, modes = self._formulation.manipulator, self._formulation.modes
        found = np.zeros((len(self.names), LOADS))
        if len(modes) == self._formulation.axial:  # an arm without modes is rigid on purpose
            return found
        rule = Quadrature(body.arm.breaks, 4 * len(modes) + 40)
        section = body.arm.at(rule.nodes)
        # Curvature and shear strain by a force across the tip and by a torque.
        lever = np.stack([body.arm.length - rule.nodes, np.ones_like(rule.nodes)])
        compliance = lever * rule.weights / section.bending_stiffness @ lever.T
        compliance[0, 0] += np.sum(rule.weights / section.shear_stiffness)
        tip = np.vstack([self._tip.deflection[:, 0], self._tip.rotation[:, 0]])
        compliance -= tip / modes.omega**2 @ tip.T
        # Force and torque per load, and the tip's outputs per deflection and rotation.
        angle, loads = self.tip_angle(at), np.zeros((2, LOADS))
        across = np.array([-np.sin(angle), np.cos(angle)])
        loads[0, [TIP_X, TIP_Y]], loads[1, TIP_TORQUE] = across, 1.0
        shifts = np.zeros((len(self.names), 2))
        shifts[3:7, 0] = *across, *rotate(-at[2], *across)
        shifts[7, 1] = 1.0
        return shifts @ compliance @ loads

    def tip_angle(self, motion):
        """Return the angle of the section at the tip in world axes [rad]."""
        return motion[2] + self._formulation.section_rotation(
            motion[np.newaxis, 3:self._half], self._tip)[0, 0]

    def across(self, motion, angle):
        """Return where the tip is along axis II of axes at an angle, shape (1,) [m]."""
        return np.array([-np.sin(angle), np.cos(angle)]) @ self._world(motion)[:, np.newaxis]

    def _world(self, motion):
        return self._formulation.world(motion[np.newaxis], self._tip)[0, 0]


def _state_names(axes, driven, count):
    names = [('carrier_x', 'm'), ('carrier_y', 'm')]
    named = [names[axis] for axis in axes] + [('shaft', 'rad')] * (not driven) + [
        (f'mode_{n}', 'm_sqrt_kg') for n in range(1, count + 1)]
    return (*(f'{name}_{unit}' for name, unit in named),
            *(f'{name}_rate_{unit}_per_s' if name.startswith('mode') else
              f'{name}_velocity_{unit}_per_s' for name, unit in named))
