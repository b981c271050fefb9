# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""An observer: an extended Kalman filter whose model and noise are those of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgeqrf

from timo_sim.model.differences import differences
from timo_sim.model.formulation import PointsOfArm
from timo_sim.model.layout import INPUTS, Motion
from timo_sim.runs.linear import difference_steps, state_names
from timo_sim.scene.parameters import (
    checked, MAPPING, Parameter, ParameterError, short, TEXTS, warn, whole_ratio)
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.simulation.derivatives import unit_loads
from timo_sim.simulation.loads import ARGUMENTS, check_arguments
from timo_sim.simulation.simulator import Simulator, Stateful
from timo_sim.simulation.snapshot import joints_of_run, variance
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.topics.outputs import SENSORS

_SENSORS = {sensor.name: sensor for sensor in SENSORS}
# Of a disturbance that is not given: the strain at the root by it, and the part of dry friction.
_STRAIN, _OF_FRICTION = 1e-5, 0.5
_FIRST_ANGLE = 0.01    # deviation of shaft and sections at first [rad]
_OF_RIGID_ARM = 10.0   # frequency in place of that of the first mode [rad/s]
# Root of the mean square of normalised innovations that is a warning, over how many numbers the
# mean is taken, and as what larger ones count.
_INCONSISTENT, _MEMORY, _OUTLIER = 2.0, 200.0, 10.0
_NAME = Parameter('', '', '', '', choices=(*_SENSORS,))
_READING = Parameter('measured', (), '', '', alone=True)
_DT = Parameter('dt', 0.0, 's', '', low=0.0)
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
    disturbance : ndarray, shape (k,)
        The last of these.
    innovation, normalised_innovation : ndarray, shape (y,)
        Of the last update, what was measured less what was expected; the second is whitened by its
        covariance: independent and standard normal if the model is right.
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
        noisy = [name for name, sensor in _SENSORS.items() if variance(scene.values, name)
                 and (model.gear or not sensor.of_gear)]
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
        self._inputs, self._unit = [*pairs], unit_loads(scene.values, pairs)
        self._deviations, self._times = np.repeat([*pairs.values()], [*map(len, columns)], 0).T
        self._places = model.free_places
        # Of differences; loads act linearly.
        self._steps = np.append(difference_steps(model)[self._places], np.ones(len(self._times)))
        self.states = (*state_names(model), *(
            f'disturbance_{INPUTS[column].column}' for column in np.concatenate(columns)))
        # A factor of the covariance.
        self._root = np.diag([*_first_deviations(model)[self._places], *self._deviations])
        self.simulator, self.model = Simulator(scene), model
        self.disturbance = np.zeros(len(self._times))
        self.innovation = self.normalised_innovation = np.zeros(0)
        self._square, self.warning = 1.0, self.simulator.warning

    @property
    def motion(self) -> Motion:
        """The estimated motion."""
        return self.simulator.motion

    @property
    def covariance(self) -> np.ndarray:
        """
        Covariance of `states`, shape (m, m); it may be set.

        At first deviations are 1 % of the arm's length for the carrier, 0.01 rad for shaft and, by
        the first mode, sections, that times the first frequency for rates; higher modes have the
        same rates, and bend less by their frequencies.
        """
        return self._root @ self._root.T

    @covariance.setter
    def covariance(self, values: ArrayLike) -> None:
        try:
            root = np.linalg.cholesky(np.reshape(values, self._root.shape))
            if not np.allclose(values, np.transpose(values), 1e-9, 0.0):
                raise ValueError
        except ValueError:  # of which that of cholesky is one
            raise ParameterError('covariance must be a symmetric and positive definite matrix of '
                                 f'{len(self.states)} rows') from None
        self._root = root

    @property
    def consistency(self) -> float:
        """Root of the mean square of some 200 last normalised innovations; 1 if all is right."""
        return float(np.sqrt(self._square))

    @property
    def deflection_deviation(self) -> np.ndarray:
        """Standard deviations of `deflection()`: axial and transverse, shape (2,) [m]."""
        q, last = self.motion.q, len(self._places) // 2
        slope = self.model.centre_line_rate(
            np.tile(q, (len(q), 1)), np.eye(len(q)), self.model.tip_point)[:, 0]
        return np.linalg.norm(slope.T @ self._root[last - len(q):last], axis=1)

    def expected(self, sensor: str) -> np.ndarray:
        """Return what any sensor of the arm should show now, without noise, shape (axes,)."""
        replace(_NAME, name='expected').check(sensor)
        return self._readings([sensor], self.motion.values[np.newaxis],
                              self.disturbance[np.newaxis])[0]

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
            As by `Simulator.step`, or if the estimate is not finite.

        """
        shown = {name: self._checked(name, value) for name, value in measured.items()}
        step = self.simulator.scene.step
        dt = step if dt is None else _DT.check(dt)
        change = None  # of the estimated motion, which is set once: that takes longest
        if whole_ratio('dt', dt, 'integrator.step', step):
            change = self._predict(dt, command or {})
        if shown or change is not None:
            motion = self.motion.values
            if change is not None:
                motion[self._places] += change
            if shown:
                motion[self._places] += self._correct(shown, motion)
            if not np.isfinite(motion).all():
                raise DivergenceError(
                    f'the estimate is not finite at t = {self.simulator.t:g} s')
            self.simulator.set_motion(motion)
        return self.motion

    def _checked(self, name, value):
        self._name.check(name)
        rule, count = self._rules[name], len(_SENSORS[name].columns)
        numbers = np.array(rule.check(value))
        if len(numbers) != count:
            raise ParameterError(f'{rule.name} must have {count} number(s), got {short(value)}')
        return numbers

    def _predict(self, dt, command):
        """Go on by a time; return the change of free coordinates by disturbances, (m - k,)."""
        found = self.simulator.step_derivatives(self._inputs, duration=dt, **command)
        with np.errstate(divide='ignore'):  # a time of 0 means another value in each update
            fade = np.exp(-dt / self._times)
        places, count = self._places, len(fade)
        by_input = np.vstack([found.by_input[places], np.eye(count)])
        change = by_input @ (fade * self.disturbance)
        change[-count:] -= self.disturbance
        root = by_input @ (fade[:, np.newaxis] * self._root[-count:])
        root[:-count] += found.by_motion[np.ix_(places, places)] @ self._root[:-count]
        noise = by_input * self._deviations * np.sqrt(1.0 - fade**2)
        self._root = _lower(np.hstack([root, noise]))
        self.disturbance = self.disturbance + change[-count:]
        return change[:-count]

    def _correct(self, shown, motion):
        """Take what was measured in a motion; return the change of free coordinates, (m - k,)."""
        known, size = len(self._places), len(self.states)

        def moved(shifts):
            motions = np.tile(motion, (len(shifts), 1))
            motions[:, self._places] += shifts[:, :known]
            return self._readings(shown, motions, self.disturbance + shifts[:, known:])
        expected, slope, _ = differences(moved, self._steps)
        noise = np.concatenate([np.full(len(values), np.sqrt(variance(self._values, name)))
                                for name, values in shown.items()])
        # A factor of the joint covariance of readings and states (T58).
        root = _lower(np.block([
            [np.diag(noise), slope @ self._root], [np.zeros((size, len(noise))), self._root]]))
        self.innovation = np.concatenate([*shown.values()]) - expected
        own, gain, self._root = (root[:len(noise), :len(noise)], root[len(noise):, :len(noise)],
                                 root[len(noise):, len(noise):])
        self.normalised_innovation = np.linalg.solve(own, self.innovation)
        change = gain @ self.normalised_innovation
        self.disturbance = self.disturbance + change[known:]
        for number in self.normalised_innovation:
            self._square += (min(number**2, _OUTLIER**2) - self._square) / _MEMORY
        if self.consistency > _INCONSISTENT and not self.warning:
            self.warning = (
                f'measurements differ {self.consistency:.1f} times as much from expected ones as '
                'the covariance says: the model, the noise of sensors or the disturbance is wrong')
            warn(self.warning)
        return change[:known]

    def _readings(self, names, motions, disturbances):
        """Return what sensors should show in motions with disturbances, (n, size), (n, k)."""
        model, sensors = self.model, [_SENSORS[name] for name in names]
        if all(sensor.of_motion for sensor in sensors):
            shown = [sensor.of_motion(model, motions)[:, np.newaxis] for sensor in sensors]
        else:
            acting = self.simulator.integration.acting(self.simulator.load)
            joints = joints_of_run(model, motions, acting + disturbances @ self._unit)
            shown = [sensor.of_joints(joints) for sensor in sensors]
        return np.hstack([each + self._values[f'sensor.{name}.bias']
                          for name, each in zip(names, shown)])


def _lower(root):
    # The lower triangular factor, (m, m), of the covariance of which (m, n) is a factor.
    return np.tril(dgeqrf(root.T)[0][:len(root)].T)


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
