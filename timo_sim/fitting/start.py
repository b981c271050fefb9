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

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_lsq_spline
from scipy.optimize import least_squares

from timo_sim.fitting.problem import loads_of, Problem, SENSOR
from timo_sim.fitting.record import Channel, DRIVE
from timo_sim.fitting.response import ResponseProblem
from timo_sim.model.layout import AFTER, TORQUE
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.parameters import ParameterError
from timo_sim.simulation.snapshot import add_bristles, Joints
from timo_sim.simulation.warnings import DivergenceError

_FACTORS = np.geomspace(0.1, 10.0, 15)  # of a parameter of the arm that are tried
_PRIOR = 3.0  # standard deviation of guesses, in coordinates: holds what the record hardly shows
_DEVIATION = 0.1  # of residuals, relative to the standard deviation of what they are residuals of
_SLOW = 0.02  # part of the largest speed within which dry friction changes its sign
_EVERY = 4  # steps from one time at which the balance is taken to the next
_KNOTS = 2.0**np.arange(1, 7)  # distances of knots of the shaft's angle that are tried, in samples
_TINY = 1e-300


def from_record(problem: Problem, values: Mapping[str, float]) -> dict[str, float]:
    """
    Return values of the free parameters, by name, that the record itself suggests.

    Parameters of the arm are tried over two decades, one after the other. If the angle or speed of
    the shaft was measured, all are then fitted to what the arm shows on this shaft, and to the
    balance of the shaft. Others keep the values given, as all of a frequency response do.
    """
    if isinstance(problem, ResponseProblem):
        return dict(values)
    try:
        arm = _ArmOnShaft(problem)
        for free in problem.free:
            if free.log and free.name.startswith(('arm.', 'end_effector.')):
                tried = [{**values, free.name: float(value)}
                         for value in _FACTORS**min(free.width, 1.0) * values[free.name]
                         if free.low <= value <= free.high]
                values = min(tried, key=arm.misfit, default=values)
        if arm.driven:
            start, low, high = np.array([
                [free.coordinate(each) for each in (values[free.name], free.low, free.high)]
                for free in problem.free]).T
            widths = np.minimum(_PRIOR, [free.width for free in problem.free])
            values = problem.values(least_squares(
                lambda x: np.append(arm.residuals(problem.values(x)), (x - start) / widths), start,
                bounds=(low, high), x_scale='jac', max_nfev=15, ftol=1e-3, xtol=1e-3).x)
    except (DivergenceError, ParameterError):  # as with too few samples of the shaft
        pass
    return dict(values)


class _ArmOnShaft:
    """The arm of a Problem on a shaft that follows its measured angle, if there is one."""

    def __init__(self, problem: Problem) -> None:
        self._free = self._seen = problem
        record, self.driven = problem.record, False
        shown = [name for name in ('shaft', 'shaft_velocity') if name in record.outputs]
        if shown and problem.scene.values['motor.shaft'] == 'free':
            t, angle, *_ = record.outputs[shown[0]]
            if shown[0] != 'shaft':
                angle = cumulative_trapezoid(angle, t, initial=0.0)
            inputs = {name: each for name, each in record.inputs.items()
                      if name not in ('torque', 'voltage')}
            scene = problem.scene.vary({'initial.shaft': 0.0, 'initial.shaft_velocity': 0.0,
                                        'initial.equilibrium': False})
            record = replace(record, inputs={DRIVE: _smooth(t, angle), **inputs})
            self._seen = Problem(scene, record, ['arm.length'], {}, problem.until)
            self._seen.deadline = problem.deadline
            self.driven = True
        measured = self._seen.measurements(self._seen.until)
        self._measured = {name: each for name, each in measured.items()
                          if not self.driven or name not in shown}

    @lru_cache(maxsize=1)
    def _run(self, arm):
        """Return the Run for an arm, pairs of names and values, and the terms of its balance."""
        run = self._seen.run(dict(arm), self._seen.until)
        some, speed = slice(1, None, _EVERY), run.shaft_velocity
        acceleration = np.gradient(speed, run.t)[some]
        loads = run.loads()[some]
        add_bristles(run.scene, run.model, run.values[some], loads)
        joints = Joints(run.model, run.values[some], loads)
        torque = joints.reactions[:, 2]  # without that of the shaft itself, it is that of the arm
        torque -= run.scene.values['motor.shaft_inertia'] * acceleration
        sign = np.tanh(speed / (_SLOW * np.abs(speed).max() + _TINY))
        return run, np.stack([torque, acceleration, speed[some], sign[some]])

    def _compare(self, values):
        """Return pairs of measured and predicted outputs, and applied and needed torques."""
        run, terms = self._run(tuple(
            (name, value) for name, value in values.items() if not self.driven or not (
                name.startswith(('motor.', 'initial.')) or name.rpartition('.')[2] in SENSOR)))
        predicted = self._seen.predicted(values, self._seen.until, run)
        scene = self._free.scene_of(values)
        applied = loads_of(self._free.record, scene, values).stages(
            0, len(run.t) - 1, run.scene.step)[::_EVERY, AFTER, TORQUE]
        applied = applied - scene.manipulator.excess(applied, terms[2])
        pairs = [(each, predicted[name]) for name, each in self._measured.items()]
        return pairs, applied, terms

    def misfit(self, values: Mapping[str, float]) -> float:
        """Return the sum of logarithms of what no gain, bias or motor explains of outputs."""
        try:
            pairs, applied, terms = self._compare(values)
        except (DivergenceError, ParameterError):
            return math.inf
        if self.driven:
            pairs.append((applied, terms) if np.ptp(applied) else (terms[0], terms[1:]))
        return sum(math.log(_unexplained(*pair)) for pair in pairs)

    def residuals(self, values: Mapping[str, float]) -> np.ndarray:
        """Return residuals of outputs and of the balance of a driven shaft, shape (n,)."""
        pairs, applied, (torque, acceleration, speed, sign) = self._compare(values)
        shaft = {**self._free.scene.values, **values}
        needed = torque + shaft['motor.shaft_inertia'] * acceleration + (
            shaft['motor.viscous_friction'] + motor_constants(shaft)[1]) * speed + (
            shaft['motor.coulomb_friction'] * sign)
        return np.concatenate([
            (predicted - measured) / (_DEVIATION * (np.std(measured) or np.std(predicted) or 1.0))
            for measured, predicted in [*pairs, (applied, needed)]])


def _unexplained(measured, terms):
    """Return the part of the squares of (n,) that no sum of terms, (n,) or (k, n), explains."""
    columns = np.vstack([terms, np.ones(len(measured))])
    columns /= np.linalg.norm(columns, axis=1)[:, np.newaxis] + _TINY
    left = measured - columns.T @ np.linalg.lstsq(columns.T, measured)[0]
    return max(float(left @ left / (np.var(measured) * len(measured) + _TINY)), 1e-12)


def _smooth(t, angle):
    """Return a Channel of an angle with the knots that Schwarz's criterion (BIC) prefers."""
    def criterion(knots):
        inner = np.pad(np.linspace(t[0], t[-1], math.ceil((t[-1] - t[0]) / knots) + 1), 3, 'edge')
        left = angle - make_lsq_spline(t, angle, inner)(t)
        return len(t) * math.log(np.mean(left**2) + _TINY) + len(inner) * math.log(len(t))

    return Channel(t, angle, knots=min(_KNOTS * (t[-1] - t[0]) / len(t), key=criterion))
