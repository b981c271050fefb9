# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""An observer: an extended Kalman filter whose model and noise are those of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.compiled.constants import pack
from timo_sim.model.formulation import Formulation, PointsOfArm
from timo_sim.model.functions import Flow
from timo_sim.model.layout import AFTER, INPUTS, Motion
from timo_sim.runs.linear import state_names
from timo_sim.scene.parameters import (
    checked, MAPPING, Parameter, ParameterError, PARAMETERS, short, TEXTS, warn, whole_ratio)
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.simulation.loads import (
    ARGUMENTS, check_arguments, commanded_load, unit_loads)
from timo_sim.simulation.simulator import Simulator, Stateful
from timo_sim.simulation.snapshot import FIRST_AXES, Joints
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.steps.derivatives import entry_for
from timo_sim.steps.kalman import Filter, SENSED, UPDATES
from timo_sim.topics.outputs import SENSORS

_SENSORS = {sensor.name: sensor for sensor in SENSORS}
# Of a disturbance that is not given: the strain at the root by it, and the part of dry friction.
_STRAIN, _OF_FRICTION = 1e-5, 0.5
_FIRST_ANGLE = 0.01    # deviation of shaft and sections at first [rad]
_OF_RIGID_ARM = 10.0   # frequency in place of that of the first mode [rad/s]
_INCONSISTENT = 2.0    # root of the mean square of normalised innovations that is a warning
_NAME = Parameter('', '', '', '', choices=(*_SENSORS,))
_READING = Parameter('measured', (), '', '', alone=True)
_DT = Parameter('dt', 0.0, 's', '', low=0.0, high=PARAMETERS['duration'].high)
_PAIR = Parameter('deviation and correlation time of a disturbance', (), '', '', low=0.0)


class Observer(Stateful, PointsOfArm):
    """
    An extended Kalman filter that estimates the motion of an arm from what its sensors show.

    The steps of a Simulator predict the motion, their exact derivatives the covariance, see
    doc/theory.md, section 13. `timo_sim.observer(scene, ...)` makes one. `position()`,
    `deflection()` and `rotation()` are those of the estimate.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
        The model, the first motion, and bias, noise and resolution of the sensors.
    sensors : sequence of str, optional
        Names of `topics.outputs.SENSORS`, such as encoder, root_strain, gyro; by default those
        with noise or a resolution.
    disturbance : mapping of str to (float, float), optional
        What acts and the model does not know, such as wrong friction, by name of a command of
        `Simulator.step`: standard deviation (N, N m or V) and correlation time [s]. It is
        estimated, too. By default a torque on a free shaft and forces on a free carrier: the load
        that strains the root by 1e-5 and half of the dry friction, and the first period of the
        clamped arm.

    Attributes
    ----------
    simulator : Simulator
        Its motion is the estimate; `set_motion` sets it.
    sensors : tuple of str
    states : tuple of str
        Names of the m estimated numbers with units: free coordinates, their rates, disturbances.
    warning : str or None
        Why the estimate should not be trusted; given as a ModelWarning, too, once.

    Raises
    ------
    ParameterError
        If a sensor is unknown or has neither noise nor resolution, or a disturbance breaks its
        rule.

    Examples
    --------
    >>> import timo_sim
    >>> scene = timo_sim.load_scene({'carrier.held': 'both', 'sensor.encoder.noise': 1e-4})
    >>> observer = timo_sim.observer(scene, sensors=['encoder'])
    >>> estimate = observer.update({'encoder': 0.7855}, {'torque': 1.0}, 0.002)
    >>> observer.states[0], observer.deflection().shape
    ('shaft_rad', (2,))

    """

    @checked(sensors=TEXTS, disturbance=MAPPING)
    def __init__(self, scene: SceneLike, sensors: Sequence[str] | None = None,
                 disturbance: Mapping[str, Sequence[float]] | None = None) -> None:
        scene = load_scene(scene)
        self._values, model = dict(scene.values), scene.build()
        errors = scene.sensor_errors
        noise = np.sqrt(errors.noise**2 + errors.resolution**2 / 12.0)[:SENSED]
        noisy = [name for name, axis in FIRST_AXES.items() if axis < SENSED and noise[axis]
                 and (model.gear or not _SENSORS[name].of_gear)]
        self.sensors = tuple(noisy if sensors is None else sensors)
        for name in self.sensors:
            replace(_NAME, name='sensors').check(name)
        # Of what is measured.
        self._name = replace(_NAME, name='measured', choices=self.sensors)
        self._rules = {name: replace(_READING, name=f'measured {name}') for name in self.sensors}
        if not self.sensors or not {*self.sensors} <= {*noisy}:
            raise ParameterError(
                'an observer needs sensors whose sensor.NAME.noise or .resolution is > 0, here '
                f'{", ".join(noisy) or "none"}, got {short(sensors or "none")}')
        given = _usual_disturbance(scene.values, model) if disturbance is None else disturbance
        check_arguments(given, 'disturbance')
        pairs = {name: _PAIR.check(pair) for name, pair in given.items()}
        if {*map(len, pairs.values())} != {2}:
            raise ParameterError("disturbance must be such as {'tip_force': (0.1, 0.2)}, got "
                                 f'{short(given)}; where only the arm moves it must be given')
        columns = [np.ravel(ARGUMENTS[name]) for name in pairs]
        deviations, times = np.repeat([*pairs.values()], [*map(len, columns)], 0).T
        with np.errstate(divide='ignore'):  # a time of 0 means another value in each update
            fade = np.exp(-scene.step / times)
        self._places = model.free_places
        self.states = (*state_names(model), *(
            f'disturbance_{INPUTS[column].column}' for column in np.concatenate(columns)))
        count, inputs = len(self.states), len(deviations)
        readings = sum(len(_SENSORS[name].columns) for name in self.sensors)
        room = np.zeros(2 * [count + max(readings, inputs)])
        self._known = pack(Filter(
            motion=np.zeros(model.size), gravity=model.gravity, places=self._places,
            unit=unit_loads(scene.values, pairs), deviation=deviations, fade=fade,
            disturbance=np.zeros(inputs),
            root=np.diag([*_first_deviations(model)[self._places], *deviations]),
            noise=noise, bias=errors.bias[:SENSED], axis=np.zeros(readings, dtype=int),
            shown=np.zeros(readings), expected=np.zeros(readings),
            slope=np.zeros((readings, count)), normalised=np.zeros(readings),
            square=np.ones(1), joint=room, lower=room,
            found=np.zeros((model.size + inputs, model.size))))
        self.simulator = Simulator(scene)
        # The compiled updates by these steps, by sector; and how many numbers the last one took.
        self._updates: tuple[Any, dict] = None, {}
        self._taken, self.warning = 0, self.simulator.warning

    def __getstate__(self):
        return {**super().__getstate__(), '_updates': (None, {})}

    @property
    def motion(self) -> Motion:
        """The estimated motion."""
        return self.simulator.motion

    @property
    def model(self) -> Formulation:
        """The equations of motion, with the present load at the tip."""
        return self.simulator.model

    @property
    def disturbance(self) -> np.ndarray:
        """The last of `states`, shape (k,)."""
        with self._lock:
            return self._known.disturbance.copy()

    @property
    def _root(self):
        return self._known.root[:, :len(self.states)]

    @property
    def covariance(self) -> np.ndarray:
        """
        Covariance of `states`, shape (m, m); it may be set.

        At first deviations are 1 % of the arm's length for the carrier, 0.01 rad for shaft and, by
        the first mode, sections, that times the first frequency for rates; higher modes have the
        same rates, and bend less by their frequencies.
        """
        with self._lock:
            return self._root @ self._root.T

    @covariance.setter
    def covariance(self, values: ArrayLike) -> None:
        try:
            root = np.linalg.cholesky(np.reshape(values, 2 * [len(self.states)]))
            if not np.allclose(values, np.transpose(values), 1e-9, 0.0):
                raise ValueError
        except ValueError:  # of which that of cholesky is one
            raise ParameterError('covariance must be a symmetric and positive definite matrix of '
                                 f'{len(self.states)} rows') from None
        with self._lock:
            self._root[:] = root

    @property
    def innovation(self) -> np.ndarray:
        """Of the last update, what was measured less what was expected, shape (y,)."""
        with self._lock:
            return (self._known.shown - self._known.expected)[:self._taken]

    @property
    def normalised_innovation(self) -> np.ndarray:
        """The same, whitened: independent and standard normal if the model is right."""
        with self._lock:
            return self._known.normalised[:self._taken].copy()

    @property
    def consistency(self) -> float:
        """Root of the mean square of some 200 last normalised innovations; 1 if all is right."""
        return float(np.sqrt(self._known.square[0]))

    @property
    def deflection_deviation(self) -> np.ndarray:
        """Standard deviations of `deflection()`: axial and transverse, shape (2,) [m]."""
        with self._lock:
            q, last = self.motion.q, len(self._places) // 2
            slope = self.model.centre_line_rate(
                np.tile(q, (len(q), 1)), np.eye(len(q)), self.model.tip_point)[:, 0]
            return np.linalg.norm(slope.T @ self._root[last - len(q):last], axis=1)

    def expected(self, sensor: str) -> np.ndarray:
        """Return what any sensor of the arm should show now, without noise, shape (axes,)."""
        replace(_NAME, name='expected').check(sensor)
        with self._lock:
            load = self.simulator.integration.acting(self.simulator.load)
            joints = Joints(self.model, self.motion.values[np.newaxis],
                            (load + self.disturbance @ self._known.unit)[np.newaxis])
        return self._values[f'sensor.{sensor}.bias'] + _SENSORS[sensor].of_joints(joints)[0]

    @checked(measured=MAPPING, command=MAPPING)
    def update(self, measured: Mapping[str, Any], command: Mapping[str, Any] | None = None,
               dt: float | None = None) -> Motion:
        """
        Go on by a time under commands, then take what was measured at its end.

        Parameters
        ----------
        measured : mapping of str to float or sequence of float
            By name of `sensors`; those that have no measurement at that time are left out.
        command : mapping of str to float or sequence of float, optional
            What acted since the last update, as in `Simulator.step`; by default nothing.
        dt : float, optional
            Time since the last update [s], a whole multiple of the time step, by default one step;
            0 for measurements at the same time, or at the start.

        Raises
        ------
        ParameterError
            If an argument breaks its rule; the estimate is then as before.
        DivergenceError
            As by `Simulator.step`, or if what was measured is so far off that the estimate is not
            finite. The estimate then leaves out what was measured.

        """
        shown = {}  # by axis
        for name, value in measured.items():
            shown.update(enumerate(self._checked(name, value), FIRST_AXES[name]))
        simulator, known = self.simulator, self._known
        count = 1 if dt is None else whole_ratio(
            'dt', _DT.check(dt), 'integrator.step', simulator.scene.step)
        commanded = commanded_load(self._values, **(command or {}))
        with self._lock:
            parts = known.root, known.disturbance, known.square, simulator._state
            before = [each.copy() for each in parts]
            try:
                simulator._advance_with(partial(self._advance, count, shown), count, commanded)
            except DivergenceError as error:
                for part, each in zip(parts, before):
                    part[:] = each
                raise DivergenceError(f'{error}; or leave out what was measured, if it is far '
                                      'from what was expected') from None
            motion = Motion(known.motion.copy())
        if known.square[0] > _INCONSISTENT**2 and not self.warning:
            self.warning = (
                f'measurements differ {self.consistency:.1f} times as much from expected ones as '
                'the covariance says: the model, the noise of sensors or the disturbance is wrong')
            warn(self.warning)
        return motion

    def _checked(self, name, value):
        if name not in self._rules:
            self._name.check(name)
        rule, count = self._rules[name], len(_SENSORS[name].columns)
        numbers = rule.check(value)
        if len(numbers) != count:
            raise ParameterError(f'{rule.name} must have {count} number(s), got {short(value)}')
        return numbers

    def _advance(self, steps, shown, state, load, loads, _, since):
        """Do what `Steps.advance` does; after all `steps` take what was shown."""
        done, readings, simulator, known = 0, 0, self.simulator, self._known
        if since + len(loads) == steps and shown:
            readings = self._taken = len(shown)
            for k, (axis, value) in enumerate(shown.items()):
                known.axis[k], known.shown[k] = axis, value
        while True:
            following = loads[done:] if done else loads
            reached = self._update(self.model.sector(state, load))(
                state, simulator.integration.memory, load, following, len(following), readings)
            if not steps and not (
                    reached == 0 and abs(state).dot(simulator._travel) <= simulator._most_bent):
                raise DivergenceError(f'the estimate is not finite at t = {simulator.t:g} s: '
                                      'take a shorter integrator.step')
            done += reached
            if reached < 0 or done == len(loads):
                return done
            load = loads[done - 1, AFTER]  # the shaft has turned into another sector

    def _update(self, sector):
        """Return the compiled update by the present steps, in a sector."""
        steps, calls = self._updates
        if steps is not self.simulator.integration:
            steps, calls = self._updates = self.simulator.integration, {}
        if sector not in calls:
            model, (_, linear) = steps.model, steps.model.in_sector(sector)
            calls[sector] = entry_for(model, UPDATES).of(
                *steps.part(sector), steps.bristles, model.beyond.packed, model.seen.packed,
                pack(Flow(linear, model.points.rotation)), pack(model.root), self._known)
        return calls[sector]


def _first_frequency(model):
    return model.modes.omega.min() if len(model.modes.omega) else _OF_RIGID_ARM


def _usual_disturbance(values, model):
    section = model.manipulator.arm.at(np.zeros(1))
    largest = _STRAIN * float(
        2.0 * np.ravel(section.bending_stiffness)[0] / np.ravel(section.height)[0])
    return {name: (load + _OF_FRICTION * values[f'{joint}.coulomb_friction'],
                   2.0 * np.pi / _first_frequency(model))
            for name, load, joint, free in (
                ('torque', largest, 'motor', not model.driven),
                ('force', largest / model.tip_point.lever[0], 'carrier', len(model.axes))) if free}


def _first_deviations(model):
    length, first = model.manipulator.arm.length, _first_frequency(model)
    share = first / model.modes.omega  # by which all modes have the same rates
    places = np.concatenate([[length, length, 1.0], share / model.section_turn_bound])
    rates = first * np.concatenate([places[:3], places[3:] / share])
    return _FIRST_ANGLE * np.concatenate([places, rates])


observer = Observer  # `timo_sim.observer`
