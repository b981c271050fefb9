# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
First guesses from a record itself, however far the values of the scene are from the truth.

The arm of the model is driven by the measured angle of the shaft. What the outputs show then
depends on the arm alone, and the torque that moves the shaft so is linear in its inertia, friction
and motor. No error accumulates, as it does in a run of a free shaft, so few minima are wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
import math
import math
import math

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_lsq_spline
from scipy.optimize import least_squares

from timo_sim.fitting.problem import Problem, sensor_of
from timo_sim.fitting.record import Channel, DRIVE
from timo_sim.scene.parameters import ParameterError
from timo_sim.scene.scene import motor_constants
from timo_sim.simulation.snapshot import joints_of_run
from timo_sim.simulation.warnings import DivergenceError

_FACTORS = np.geomspace(0.1, 10.0, 15)  # of a parameter of the arm that are tried
_SHAFT = 'shaft', 'shaft_velocity'  # outputs that give the angle of the shaft
_PRIOR = 3.0  # standard deviation of guesses, in coordinates: holds what the record hardly shows
_DEVIATION = 0.1  # of residuals, relative to the standard deviation of what was measured
_EVERY = 4  # steps from one time at which the balance is taken to the next
_MAX_STEPS = 15  # of Gauss and Newton
_SLOW = 0.02  # part of the largest speed within which dry friction changes its sign
_KNOTS = 2.0**np.arange(1, 7)  # distances of knots of the shaft's angle that are tried, in samples


def from_record(problem: Problem, values: Mapping[str, float]) -> dict[str, float]:
    """
    Return values of the free parameters, by name, that the record itself suggests.

    Parameters of the arm are tried over two decades, one after the other. If the angle or speed of
    the shaft was measured, all are then fitted to what the arm shows on this shaft, and to the
    balance of the shaft. Others keep the values given.
    """
    arm = ArmOnShaft(problem)
    for free in problem.free:
        if free.log and free.name.startswith(('arm.', 'end_effector.')):
            tried = [{**values, free.name: value} for value in _FACTORS * values[free.name]
                     if free.low <= value <= free.high]
            values = min(tried, key=arm.misfit, default=values)
    if not arm.driven:
        return dict(values)
    start = np.array([free.coordinate(values[free.name]) for free in problem.free])
    bounds = [[free.coordinate(end) for free, end in zip(problem.free, ends)] for ends in (
        [free.low for free in problem.free], [free.high for free in problem.free])]
    found = least_squares(
        lambda x: np.append(arm.residuals(problem.values(x)), (x - start) / _PRIOR), start,
        bounds=bounds, x_scale='jac', max_nfev=_MAX_STEPS, ftol=1e-3, xtol=1e-3)
    return problem.values(found.x)


class ArmOnShaft:
    """The arm of a Problem on a shaft that follows its measured angle, if there is one."""

    def __init__(self, problem: Problem) -> None:
        self.driven, self._values = False, problem.scene.values
        record, scene, self._problem = problem.record, problem.scene, problem
        self._outputs, self._inputs = [*record.outputs], [
            name for name in ('torque', 'voltage') if name in record.inputs]
        shown = next((name for name in _SHAFT if name in record.outputs), None)
        if shown is None or scene.values['motor.shaft'] != 'free' or len(self._inputs) > 1:
            return
        t, angle, *_ = record.outputs[shown]
        if shown != 'shaft':
            angle = cumulative_trapezoid(angle, t, initial=0.0)
        inputs = {name: each for name, each in record.inputs.items() if name not in self._inputs}
        try:
            self._problem = Problem(
                scene.vary({'initial.shaft': 0.0, 'initial.shaft_velocity': 0.0,
                            'initial.equilibrium': False}),
                replace(record, inputs={DRIVE: _smooth(t, angle), **inputs}), ['arm.length'], {},
                problem.until)
        except ParameterError:  # such as samples that are too few: the shaft is not driven
            return
        self.driven, self._free = True, problem
        self._outputs = [name for name in record.outputs if name not in _SHAFT]

    @lru_cache(maxsize=1)
    def _run(self, values):
        """Return the Run for values, a tuple of pairs, and terms of the balance, shape (4, n)."""
        run = self._problem.run(dict(values), 0.0, self._problem.until)
        if not self.driven:
            return run, None
        speed = run.shaft_velocity
        some, acceleration = slice(None, None, _EVERY), np.gradient(speed, run.t)
        needed = joints_of_run(run.scene, run.model, run.values[some], run.loads()[some])
        arm = needed.reactions[:, 2] - self._values['motor.shaft_inertia'] * acceleration[some]
        slow = _SLOW * np.abs(speed).max() + 1e-300
        return run, np.stack([arm, acceleration[some], speed[some], np.tanh(speed[some] / slow)])

    def _predict(self, values):
        """Return pairs of measured and predicted outputs, times, and terms of the balance."""
        own = {name: value for name, value in values.items() if not (
            self.driven and (name.startswith(('motor.', 'initial.'))
                             or name.rpartition('.')[0] in self._inputs))}
        run, terms = self._run(tuple(
            (name, value) for name, value in own.items()
            if name.rpartition('.')[0] not in self._problem.record.outputs))
        predicted = self._problem.predictions(run, own, 0.0, self._problem.until)
        measured = self._problem.measurements(self._problem.windows[0])
        return [(measured[name], predicted[name][1]) for name in self._outputs], run.t[::_EVERY], terms

    def _given(self, t, delay=0.0):
        """Return the input of the shaft at times [s], zeros if the record has none."""
        if not self._inputs:
            return np.zeros(len(t))
        channel = self._free.record.inputs[self._inputs[0]]
        if channel.hold == 'linear':
            return np.interp(t, channel.t + delay, channel.values)
        place = np.searchsorted(channel.t + delay, t, 'right') - 1
        return channel.values[np.maximum(place, 0)]

    def misfit(self, values: Mapping[str, float]) -> float:
        """Return the sum of logarithms of what no gain, bias or motor explains of outputs."""
        try:
            pairs, t, terms = self._predict(values)
        except (DivergenceError, ParameterError):
            return math.inf
        pairs = [(measured, predicted[np.newaxis]) for measured, predicted in pairs]
        if self.driven:
            given = self._given(t)
            pairs.append((given, terms) if np.ptp(given) else (terms[0], terms[1:]))
        return sum(math.log(_unexplained(*pair)) for pair in pairs)

    def residuals(self, values: Mapping[str, float]) -> np.ndarray:
        """Return residuals of outputs and of the balance of a driven shaft, shape (n,)."""
        pairs, t, (arm, acceleration, speed, sign) = self._predict(values)
        motor = {**self._values, **values}
        constant, drag = motor_constants(motor)
        name = self._inputs[0] if self._inputs else 'torque'
        gain, bias, delay, _ = sensor_of(values, name)
        given = self._given(t, delay)
        torque = (arm + motor['motor.shaft_inertia'] * acceleration + (
            motor['motor.viscous_friction'] + drag) * speed + motor['motor.coulomb_friction'] * sign)
        needed = (torque / (constant if name == 'voltage' else 1.0) - bias) / gain
        pairs.append((given, needed))
        return np.concatenate([
            (predicted - measured) / (_DEVIATION * (np.std(measured) or np.std(predicted) or 1.0))
            for measured, predicted in pairs])


def _unexplained(measured, terms):
    """Return the part of the squares of (n,) that no sum of the terms, (k, n), explains."""
    columns = np.stack([*terms, np.ones(len(measured))])
    columns /= np.linalg.norm(columns, axis=1)[:, np.newaxis] + 1e-300
    left = measured - columns.T @ np.linalg.lstsq(columns.T, measured)[0]
    return max(float(left @ left / (np.var(measured) * len(measured) + 1e-300)), 1e-12)


def _smooth(t, angle):
    """Return a Channel of the angle with the knots that Schwarz's criterion prefers."""
    def criterion(knots):
        count = math.ceil((t[-1] - t[0]) / knots)
        inner = np.pad(np.linspace(t[0], t[-1], count + 1), 3, 'edge')
        left = angle - make_lsq_spline(t, angle, inner)(t)
        return len(t) * math.log(np.mean(left**2) + 1e-300) + count * math.log(len(t))

    tried = [each for each in _KNOTS * (t[-1] - t[0]) / len(t) if each < t[-1] - t[0]]
    return Channel(t, angle, knots=min(tried, key=criterion))
