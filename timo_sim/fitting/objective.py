# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What a fit minimises: residuals of records in standard deviations, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
import math
from typing import Any

import numpy as np

from timo_sim.fitting.look import noise_of
from timo_sim.fitting.problem import alike, Free, Problem, spread_of, WHITE, whiteness
from timo_sim.model.differences import differences
from timo_sim.scene.parameters import ParameterError
from timo_sim.simulation.warnings import DivergenceError

LOSSES = 'linear', 'soft_l1', 'huber', 'cauchy'
CENTRAL = 3e-4  # step of differences in coordinates of the fit, for intervals
# Part of the record, and of its motion, that is fitted first: early, runs are closer to it.
_FIRST_PART, _COARSE = 0.25, 200  # this motion is seen at so many points
_MIN_DEVIATION = 1e-5  # least standard deviation, relative to the first
_FIRST_DEVIATION = 0.1  # first standard deviation, relative to that of an output's values
MANY = 5.0  # ratio of residuals to noise, above which the model is wrong
_MAD = 1.4826  # standard deviations in a median absolute deviation
# Residual of a run that fails, in standard deviations of the sensor, and in ranges of what it
# measured, whichever is more: searches must not prefer it to a run that is far off.
DIVERGED, _FAR_OFF = 1e3, 1e2


class Objective:
    """
    The residuals of several problems by x, the coordinates of all `free`.

    Behind those of the records are those of first guesses with a width, for the most likely x.
    Where residuals of records are correlated they tell less, and the guesses count for more.

    Problems share parameters, but biases and initial states: `places` has for each problem where
    its `free` are in x, `ends` until when its record is fitted [s], `deviations` those of sensors,
    by output, at first those of `like`, another Objective of the same records, if it is given.
    `start`, `low` and `high` are first values and bounds of x.
    """

    def __init__(self, problems: Sequence[Problem], loss: str = 'linear',
                 like: Objective | None = None) -> None:
        self.problems, self.loss = [*problems], loss
        self._change: Callable[..., Mapping[str, Any]] | None = None
        names = [[f'{free.name} (record {k})' if free.is_own and len(problems) > 1 else free.name
                  for free in each.free] for k, each in enumerate(problems, 1)]
        named: dict[str, Free] = {}
        for problem, own in zip(problems, names):
            for free, name in zip(problem.free, own):
                named.setdefault(name, replace(free, name=name))
        self.free, order = [*named.values()], [*named]
        self.places = [np.array([order.index(name) for name in own]) for own in names]
        self.deviations = [{
            name: channel.noise or _FIRST_DEVIATION * spread_of(
                channel.values[channel.t <= problem.until]) or 1.0
            for name, channel in problem.record.outputs.items()} for problem in problems]
        # Deviations have a lower bound: without noise they would fall until squares overflow.
        self._first = [{**each} for each in self.deviations]
        self.start, self.low, self.high = (
            np.array([free.coordinate(getattr(free, kind)) for free in self.free])
            for kind in ('start', 'low', 'high'))
        self.widths = np.array([free.width for free in self.free])
        self._alike = 1.0  # residuals that tell as much as one, since they are correlated
        if like:
            self.deviations, self._alike = [{**each} for each in like.deviations], like._alike
        self.ends = [problem.until for problem in problems]
        try:
            for k, problem in enumerate(self.problems):
                problem.predicted(self.values(self.start, k), problem.until)
        except (DivergenceError, ParameterError) as error:
            raise ParameterError('the record cannot be predicted with the first guess: '
                                 f'{error}') from None

    def of_first_parts(self) -> Objective:
        """Return that of a quarter of the time of each record, and of the motion of an output."""
        part = copy(self)
        part.ends = [max(_FIRST_PART * each.until, min(times_of_motion(each, _FIRST_PART)))
                     for each in self.problems]
        return part

    def with_effect(self, change: Callable[..., Mapping[str, Any]], sizes: Any,
                    low: Any = -np.inf) -> Objective:
        """
        Return that of scenes which `change`, a function of their values and sizes, also changes.

        Behind the coordinates of what is free, x has factors of the sizes, `low` at least.
        """
        found = copy(self)
        found._change = lambda values, factors: change(values, *(factors * np.array(sizes)))
        ones = np.ones(len(sizes))
        for name, each in ('start', 1.0), ('low', low), ('high', np.inf), ('widths', np.inf):
            setattr(found, name, np.append(getattr(self, name), each * ones))
        return found

    def within(self, x: np.ndarray) -> np.ndarray:
        """Return the coordinates within bounds that are nearest to some."""
        return np.clip(x, self.low, self.high)

    def values(self, x: np.ndarray, k: int) -> dict[str, float]:
        """Return the values of the free parameters of problem `k`, by the problem's names."""
        problem = self.problems[k]
        own = {free.name: self.free[place].value(x[place])
               for free, place in zip(problem.free, self.places[k])}
        return own if self._change is None else {
            **own, **self._change({**problem.scene.values, **own}, x[len(self.free):])}

    def series(self) -> list[tuple[int, str, np.ndarray]]:
        """Return the series of residuals: problem, output, and what was measured."""
        return [(k, name, measured) for k, (problem, end) in enumerate(zip(
            self.problems, self.ends)) for name, measured in problem.measurements(end).items()]

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, bool]:
        """Return all residuals, (n,), large ones of runs that fail, and whether one has failed."""
        parts, fails = [], False
        for k, (problem, end) in enumerate(zip(self.problems, self.ends)):
            try:
                predicted = problem.predicted(self.values(x, k), end)
            except (DivergenceError, ParameterError):
                predicted, fails = {}, True
            for name, channel in problem.record.outputs.items():
                measured, deviation = channel.values[channel.t <= end], self.deviations[k][name]
                far = max(DIVERGED, _FAR_OFF * np.ptp(channel.values) / deviation)
                parts.append((predicted[name] - measured) / deviation if predicted
                             else np.full(len(measured), far))
        guesses = math.sqrt(self._alike) * ((x - self.start) / self.widths)
        return np.concatenate([*parts, guesses[np.isfinite(self.widths)]]), fails

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return all residuals, shape (n,)."""
        return self.evaluate(x)[0]

    def jacobian(self, x: np.ndarray, step: float = CENTRAL, central: bool = True) -> np.ndarray:
        """Return the derivatives of the residuals by x, (n, len(x)), from differences of runs."""
        here = self.residuals(x)
        steps = np.full(len(x), step)
        if central:
            # A delay is varied by whole steps: within a step the run depends on it only through
            # the interpolation of the load.
            late = ['.delay' in free.name for free in self.free]
            steps[late] *= [self.problems[0].scene.step / free.scale / CENTRAL
                            for free, is_late in zip(self.free, late) if is_late]
        steps = np.where(x + steps <= self.high, steps, -steps)

        def rows(shift):
            inside = np.array_equal(self.within(x + shift), x + shift)
            shown, fails = self.evaluate(x + shift) if inside else (here, True)
            return np.full(len(here), np.nan) if fails else shown

        return np.nan_to_num(differences(lambda shifts: np.array([
            rows(shift) if shift.any() else here for shift in shifts]), steps,
            2 if central else 1).slope)

    def split(self, rows: np.ndarray) -> list[np.ndarray]:
        """Return the rows of each output of each problem, without those of guesses."""
        return np.split(rows, np.cumsum([len(measured) for *_, measured in self.series()]))[:-1]

    def weights(self, residuals: np.ndarray) -> np.ndarray:
        """Return the roots of the weights that the loss gives to residuals, shape (n,)."""
        weight = {'linear': lambda z: np.ones_like(z), 'soft_l1': lambda z: (1.0 + z)**-0.5,
                  'huber': lambda z: np.where(z <= 1.0, 1.0, 1.0 / np.sqrt(np.maximum(z, 1.0))),
                  'cauchy': lambda z: 1.0 / (1.0 + z)}[self.loss]
        return np.sqrt(weight(residuals**2))

    def unlikelihood(self, rows: np.ndarray) -> float:
        """Return minus the logarithm of the likelihood of residuals, but for a constant."""
        return 0.5 * np.sum((self.weights(rows) * rows)**2) + sum(
            len(measured) * math.log(self.deviations[k][name])
            for k, name, measured in self.series())

    def is_white(self, x: np.ndarray) -> bool:
        """Return whether the residuals of all outputs are white."""
        return all(whiteness(r) >= WHITE for r in self.split(self.residuals(x)))

    def estimate_deviations(self, x: np.ndarray) -> float:
        """
        Estimate the standard deviations of residuals; return the largest relative change.

        Residuals far above the noise are errors of the model. These outputs share a part of their
        spread: by deviations of its own, one that is fitted well outweighs one that is hardly.
        """
        change, series, sizes = 0.0, self.split(self.residuals(x)), []
        self._alike = float(np.average([*map(alike, series)], weights=[*map(len, series)]))
        for (k, name, measured), r in zip(self.series(), series):
            size = self.deviations[k][name] * (math.sqrt(np.mean(r**2)) if self.loss == 'linear'
                                               else _MAD * float(np.median(np.abs(r))))
            channel = self.problems[k].record.outputs[name]
            wrong = not channel.noise and size > MANY * noise_of(channel)
            sizes.append((size, spread_of(measured) if wrong else 0.0))
        parts = [(size / spread)**2 for size, spread in sizes if spread]
        for (k, name, _), (size, spread) in zip(self.series(), sizes):
            known = self.problems[k].record.outputs[name].noise
            new = max(spread * math.sqrt(np.mean(parts)) if spread else size,
                      known or _MIN_DEVIATION * self._first[k][name])
            new = known if known and new <= 1.5 * known else new
            change = max(change, abs(new / self.deviations[k][name] - 1.0))
            self.deviations[k][name] = new
        return change


def times_of_motion(problem: Problem, part: float) -> list[float]:
    """Return when a part of the motion of each output that is fitted is over [s]."""
    t = np.linspace(0.0, problem.until, _COARSE)
    motions = [np.cumsum(np.diff(np.interp(t, channel.t, channel.values))**2)
               for channel in problem.record.outputs.values()]
    return [float(t[1 + np.searchsorted(each, part * each[-1])]) for each in motions]
