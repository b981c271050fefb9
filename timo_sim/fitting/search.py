# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The search for the parameters with the least sum of squares, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from timo_sim.fitting.problem import (
    Free, initial_states, Problem, TimeIsUp, WHITE, whiteness, Window)
from timo_sim.fitting.start import from_record
from timo_sim.scene.parameters import ParameterError
from timo_sim.simulation.warnings import DivergenceError

LOSSES = 'linear', 'soft_l1', 'huber', 'cauchy'
_CENTRAL, _WIDE = 3e-4, 1e-3  # steps of differences in coordinates of the fit, for intervals
_MAX_DIFFERENCE = 0.3  # relative difference of derivatives by two steps, above which a run jumps
# Part of the record, and of its motion, that is fitted first: early, runs are closer to it.
_FIRST_PART, _COARSE = 0.25, 200  # this motion is seen at so many points
_MIN_DEVIATION = 1e-5  # least standard deviation, relative to the first
_FIRST_DEVIATION = 0.1  # first standard deviation, relative to that of an output's values


class _Accuracy(NamedTuple):
    ftol: float    # relative change of the sum of squares at which a search ends
    xtol: float    # the same of x
    max_nfev: int  # most evaluations, since a jagged sum never settles
    step: float    # of differences; a wide one does not see how dry friction makes the sum jagged


# Starts are only tried: the best one is followed.
_TRY, _LOOSE = _Accuracy(1e-2, 1e-4, 12, 1e-3), _Accuracy(1e-4, 1e-4, 60, 1e-3)
_TIGHT = _Accuracy(1e-7, 1e-7, 60, 1e-6)
_MAX_KNOWN = 4  # residuals that are kept, since searches ask for some again
_MAX_SEARCHES = 6  # most searches with standard deviations from the one before
_SETTLED_CHANGE = 0.01  # relative change of standard deviations that counts as none
_PRIOR_DEVIATION = 10.0  # standard deviation of initial states of windows, in their scales
_SAME = 0.01  # relative difference of sums of squares below which they are the same
_ALIKE = 0.05  # the same, of starts that are only tried
_WORTHWHILE = 3.0  # ratio to the least, below which a minimum of the first part is followed
NUMERICAL = 1e-9  # 1 - R^2 below which only numerical errors are left
_HARDLY_WHITE = 1e-6  # probability of residuals as correlated, above which a minimum is good
# 1 - R^2 above which other starts are tried, if one, two or three starts have led to a minimum.
_MAX_UNEXPLAINED = 0.05, 0.2, 0.5, math.inf
_MAX_STARTS = 16
_NEAR = 0.1  # distance in coordinates of the fit within which two ends are one
_SPREAD = 6.0  # factor by which starts differ from what the record suggests
_MAD = 1.4826  # standard deviations in a median absolute deviation


class Search:
    """
    A search for the least sum of squares of several problems; x are the coordinates of all `free`.

    Problems share these, but biases and initial states, which each has of its own:
    `places` has for each problem where its `free` are in x. `deviations` and `against` have for
    each problem, by output, the standard deviation of the sensor, and the least correlation with
    the first run. `tried` starts led to x and to `others` that fit as well, values by name;
    `stopped` says what ended the search before its end, if anything did, and x are then the best
    so far. `tell` is called with a text for each start and search.
    """

    def __init__(self, problems: Sequence[Problem], loss: str,
                 tell: Callable[[str], object] = lambda text: None) -> None:
        self.problems, self.loss, self._tell = [*problems], loss, tell
        names = [[f'{free.name} (record {k})' if free.is_own and len(problems) > 1 else free.name
                  for free in each.free] for k, each in enumerate(problems, 1)]
        found: dict[str, Free] = {}
        for problem, own in zip(problems, names):
            for free, name in zip(problem.free, own):
                found.setdefault(name, replace(free, name=name))
        self.free, order = [*found.values()], [*found]
        self.places = [np.array([order.index(name) for name in own]) for own in names]
        self.deviations = [{
            name: channel.noise or _FIRST_DEVIATION * float(np.std(
                channel.values[channel.t <= problem.until])) or 1.0
            for name, channel in problem.record.outputs.items()} for problem in problems]
        # Deviations have a lower bound: without noise they would fall until squares overflow.
        self._least = [{name: _MIN_DEVIATION * each for name, each in deviations.items()}
                       for deviations in self.deviations]
        self.x = np.array([each.coordinate(each.start) for each in self.free])
        self.low = np.array([each.coordinate(each.low) for each in self.free])
        self.high = np.array([each.coordinate(each.high) for each in self.free])
        self.windows = [(k, window) for k, each in enumerate(problems) for window in each.windows]
        # Of each window, the Free parameters of its initial state.
        self._states: list[list[Free]] = [[] for _ in self.windows]
        self.against = [self._check_start(k, problem) for k, problem in enumerate(problems)]
        self._prior = np.zeros(0)
        self._known: dict[tuple[Any, ...], tuple[np.ndarray, bool]] = {}
        self._fails = False
        self._whole = self.windows
        # Of all runs of the whole record: minus the logarithm of the likelihood, and coordinates.
        self._best = math.inf, self.x
        self.stopped, self.interrupted = '', False
        self.others: list[dict[str, float]] = []
        self.tried = 1

    def __getstate__(self):
        return {**vars(self), '_tell': None}  # a copy, as that of a Fit, searches no more

    def run(self, starts: int | None) -> None:
        """
        Find x and the standard deviations of the sensors; `starts` is as for `fit`.

        Where it ends early x are the best so far.
        """
        try:
            self._run(starts)
            if not self._failing(self.x):
                return
            self.stopped = 'it ended where no run is possible'
        except (KeyboardInterrupt, TimeIsUp) as stop:
            self.stopped, self.interrupted = reason_of(stop), isinstance(stop, KeyboardInterrupt)
        except (ArithmeticError, ValueError) as error:  # of parameters, or of linear algebra
            if math.isinf(self._best[0]):
                raise
            self.stopped = f'it failed: {error}'
        finally:
            self.set_deadline(math.inf)
        self.windows, self.x, self.others = self._whole, self._best[1], []
        self._estimate_deviations()

    def set_deadline(self, deadline: float) -> None:
        """Let runs after a time of `time.monotonic` raise TimeIsUp."""
        for problem in self.problems:
            problem.deadline = deadline

    def _run(self, starts):
        ends, guess = [], self.x
        if not self.windows[0][1].names:
            ends = self._try_starts(starts)
        else:
            self._states = [states for k, problem in enumerate(self.problems)
                            for states in initial_states(problem, self.values(self.x, k))]
            every = [each for states in self._states for each in states]
            start = np.array([each.coordinate(each.start) for each in every])
            self.x, self._prior = np.concatenate([self.x, start]), start
            self._best = math.inf, self.x
            self.low = np.concatenate([self.low, np.full(len(every), -np.inf)])
            self.high = np.concatenate([self.high, np.full(len(every), np.inf)])
        for number in range(1, _MAX_SEARCHES + 1):
            self._solve(_LOOSE)
            change = self._estimate_deviations()
            self._tell(f'search {number} of up to {_MAX_SEARCHES} with the deviations of the '
                       f'sensors that it finds: they change by {change:.2g}')
            if change < _SETTLED_CHANGE:
                break
        self._tell('last search, with tight tolerances')
        found = [(self._solve(_TIGHT, x), self.x) for x in [self.x, *ends]]
        least, self.x = min(found, key=lambda end: end[0])
        if not self._states[0] and not self.is_white() and not self._is_doubtful(1):
            # A first part may have led away from a guess that is good.
            self._solve(_LOOSE, guess)
            found.append((self._solve(_TIGHT), self.x))
            self._tell(f'from the first guess without a first part: {found[-1][0] / least:.3g} '
                       'times the squares')
            least, self.x = min(found, key=lambda end: end[0])
        minima = [self.x]
        for cost, x in found:
            if cost - least < _SAME * least and all(
                    self._is_apart(x, each, least) for each in minima):
                minima.append(x)
        self.others = [{free.name: free.value(at) for free, at in zip(self.free, x)}
                       for x in minima[1:]]
        self._estimate_deviations()

    def _is_apart(self, x, other, least):
        """Return whether x differs from another minimum in a direction that the record sees."""
        linear = self.jacobian(other, _WIDE, False) @ (x - other)
        return 0.5 * linear @ linear > _SAME * least

    def _try_starts(self, starts):
        """Move x to the best minimum from several starts; return the others that are as good."""
        whole, parts, costs, reached, ends = self._whole, [], [], [], []
        first = [(k, Window(0.0, first_part(self.problems[k]), ())) for k, _ in whole]
        most = f'{starts}' if starts else f'up to {_MAX_STARTS}'
        for self.tried, x in enumerate(self._starts(starts or _MAX_STARTS), 1):
            self.windows, cost = first, math.inf
            begun, part = self._rms(x), self._solve(_LOOSE, x)
            text = (f'start {self.tried} of {most}: rms residual {begun:.3g} -> '
                    f'{self._rms(self.x):.3g} deviations in the first part')
            self.windows, reached = whole, [*reached, self.x]
            # Where the arm hardly moves at first, all starts fit that part equally well: their
            # ends are compared, not their costs.
            known = [old for old, each in zip(costs, reached) if np.allclose(
                self.x, each, 0.0, _NEAR)]
            if known:
                cost = known[0]
            elif part <= _WORTHWHILE * min(parts, default=math.inf):
                cost = self._solve(_TRY, self.x)
                ends.append((cost, self.x))
                text += f', {self._rms(self.x):.3g} in all'
            self._tell(text)
            parts.append(part)
            costs.append(cost)
            best, self.x = min(ends, key=lambda end: end[0])
            found = sum(each <= (1.0 + _ALIKE) * best for each in costs)
            if starts is None and not self._is_doubtful(found):
                break
        return [x for cost, x in ends if x is not self.x and cost <= (1.0 + _SAME) * best]

    def is_white(self) -> bool:
        """Return whether the residuals of all outputs in all windows are white."""
        return all(whiteness(r) >= WHITE for r, _ in zip(
            self._split_rows(self.residuals(self.x)), self.series()))

    def _is_doubtful(self, found):
        """Return whether x, which some starts have `found`, may not be the best minimum."""
        most = _MAX_UNEXPLAINED[min(found, len(_MAX_UNEXPLAINED)) - 1]
        return any(
            np.mean((r * self.deviations[k][name])**2) > most * np.var(measured)
            and whiteness(r) < _HARDLY_WHITE for r, (k, name, measured) in zip(
                self._split_rows(self.residuals(self.x)), self.series()))

    def _starts(self, count):
        """Yield x of the first guess, of what records suggest, and of points around that."""
        guess = around = self.x
        yield guess
        for k, problem in enumerate(self.problems[:count - 1]):
            around = guess.copy()
            found = from_record(problem, self.values(guess, k))
            for free, place in zip(problem.free, self.places[k]):
                around[place] = self.free[place].coordinate(found[free.name])
            yield around
        # A Latin hypercube: each parameter has each of its values once.
        random, grid = np.random.default_rng(0), np.linspace(
            -math.log(_SPREAD), math.log(_SPREAD), max(count - 1 - len(self.problems), 0))
        for shift in np.stack([random.permutation(grid) for _ in guess], axis=1):
            yield around + np.where([free.log for free in self.free], shift, 0.0)

    def _check_start(self, k, problem):
        values, against = self.values(self.x, k), {}
        try:
            run = problem.run(values, 0.0, problem.until)
            predicted = problem.predictions(run, values, 0.0, problem.until)
            every = problem.measurements(Window(0.0, problem.until, ()))
            # The least correlation of all samples and of those of the first part.
            for name, (t, seen) in predicted.items():
                for part in (t <= problem.until, t <= first_part(problem)):
                    if part.sum() > 2 and np.ptp(seen[part]) and np.ptp(every[name][part]):
                        each = float(np.corrcoef(seen[part], every[name][part])[0, 1])
                        against[name] = min(each, against.get(name, 0.0))
        except (DivergenceError, ParameterError) as error:
            if isinstance(error, ParameterError) or not problem.windows[0].names:
                raise ParameterError('the record cannot be predicted with the first guess: '
                                     f'{error}') from None
        return against

    def _rms(self, x):
        return math.sqrt(np.mean(self.residuals(self.within(x))**2))

    def within(self, x: np.ndarray) -> np.ndarray:
        """Return the coordinates within bounds that are nearest to some."""
        return np.clip(x, self.low, self.high)

    def _solve(self, accuracy, x=None):
        """Move x to the minimum nearest to itself, or to a given x; return half its squares."""
        found = least_squares(
            self.residuals, self.within(self.x if x is None else x),
            lambda x: self.jacobian(x, accuracy.step, False), (self.low, self.high), x_scale='jac',
            loss=self.loss, ftol=accuracy.ftol, xtol=accuracy.xtol, gtol=1e-12,
            max_nfev=accuracy.max_nfev)
        self.x = found.x
        return found.cost

    def values(self, x: np.ndarray, k: int) -> dict[str, float]:
        """Return the values of the free parameters of problem `k`, by the problem's names."""
        return {free.name: self.free[place].value(x[place])
                for free, place in zip(self.problems[k].free, self.places[k])}

    def states(self, x: np.ndarray) -> list[dict[str, float]]:
        """Return the values of the initial state of each window, by name."""
        coordinates = iter(x[len(self.free):])
        return [{each.name: each.value(next(coordinates)) for each in every}
                for every in self._states]

    def series(self) -> list[tuple[int, str, np.ndarray]]:
        """Return the series of residuals: problem, output, and what was measured."""
        return [(k, name, measured) for k, window in self.windows
                for name, measured in self.problems[k].measurements(window).items()]

    def _residuals_of(self, x, w):
        k, window = self.windows[w]
        try:
            return self.problems[k].residuals(
                self.values(x, k), self.deviations[k], window, self.states(x)[w])
        except (DivergenceError, ParameterError):
            self._fails = True
            return self.problems[k].residuals_of_none(self.deviations[k], window)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return all residuals, shape (n,)."""
        return self._residuals(x)[0].copy()  # robust losses scale them

    def _failing(self, x):
        return self._residuals(x)[1]

    def _residuals(self, x):
        """Return all residuals, and whether a run has failed."""
        key = x.tobytes(), *self.problems, *self.windows, repr(self.deviations)
        if key not in self._known:
            self._fails = False
            parts = [self._residuals_of(x, w) for w in range(len(self.windows))]
            rows = np.concatenate([*parts, (x[len(self.free):] - self._prior) / _PRIOR_DEVIATION])
            self._known[key] = rows, self._fails
            self._known = dict([*self._known.items()][-_MAX_KNOWN:])
            if self.windows is self._whole and not self._fails:
                unlikely = 0.5 * np.sum((self.weights(rows) * rows)**2) + sum(
                    len(measured) * math.log(self.deviations[k][name])
                    for k, name, measured in self.series())
                self._best = min(self._best, (unlikely, x.copy()), key=lambda each: each[0])
        return self._known[key]

    def jacobian(self, x: np.ndarray, step: float = _CENTRAL, central: bool = True) -> np.ndarray:
        """Return the derivatives of the residuals by x, from differences of runs."""
        count, here = len(self.free), self.residuals(x)
        sizes = [sum(map(len, self.problems[k].measurements(window).values()))
                 for k, window in self.windows]
        edges = np.concatenate([[0], np.cumsum(sizes)])
        found = np.zeros((len(here), len(x)))
        # All windows of a problem depend on its parameters, and one on its initial state.
        windows = [[w for w, (k, _) in enumerate(self.windows) if place in self.places[k]]
                   for place in range(count)] + [
            [w] for w, state in enumerate(self._states) for _ in state]
        for k in range(len(x)):
            size = step
            if central and k < count and '.delay' in self.free[k].name:
                # A delay is varied by whole steps: within a step the run depends on it only
                # through the interpolation of the load.
                size = self.problems[0].scene.step / self.free[k].scale * (step / _CENTRAL)
            size = size if x[k] + size <= self.high[k] else -size
            shift = size * (np.arange(len(x)) == k)
            two_sided = central and self.low[k] <= x[k] - size <= self.high[k]
            for w in windows[k]:
                rows = slice(edges[w], edges[w + 1])
                found[rows, k] = self._difference(x, shift, w, here[rows], two_sided) / size
        found[edges[-1]:, count:] = np.eye(len(x) - count) / _PRIOR_DEVIATION
        return found

    def _difference(self, x, shift, w, here, two_sided):
        """Return how a shift changes the residuals of a window, by runs that do not fail."""
        k, window = self.windows[w]
        lost = np.array_equal(here, self.problems[k].residuals_of_none(self.deviations[k], window))
        changes = []
        for sign in (1.0, -1.0):
            if two_sided or not changes:
                self._fails = False
                change = sign * (self._residuals_of(x + sign * shift, w) - here)
                if lost or not self._fails:
                    changes.append(change)
        return np.mean(changes, axis=0) if changes else np.zeros(len(here))

    def _split_rows(self, rows):
        """Return the rows of each output in each window, and those of the initial states."""
        return np.split(rows, np.cumsum([len(measured) for *_, measured in self.series()]))

    def _estimate_deviations(self):
        """Estimate the standard deviations of the sensors; return the largest relative change."""
        rows, change = self._split_rows(self.residuals(self.x)), 0.0
        of_sensor = {}
        for (k, name, _), r in zip(self.series(), rows):
            of_sensor.setdefault((k, name), []).append(r)
        for (k, name), parts in of_sensor.items():
            r, deviation = np.concatenate(parts), self.deviations[k][name]
            size = math.sqrt(np.mean(r**2)) if self.loss == 'linear' else (
                _MAD * float(np.median(np.abs(r))))
            known = self.problems[k].record.outputs[name].noise
            new = max(size * deviation, known or self._least[k][name])
            if not known or new > 1.5 * known:
                change = max(change, abs(new / deviation - 1.0))
                self.deviations[k][name] = new
        return change

    def derivatives(self) -> tuple[list[np.ndarray], list[str]]:
        """
        Return the derivatives of `parts` at the end, (n_i, p + k), and jumps.

        There are k initial states of windows; `jumps` names parameters on which runs depend in
        jumps.
        """
        jacobian = self.jacobian(self.x)
        wide, count = self.jacobian(self.x, _WIDE), len(self.free)
        size, other = np.linalg.norm(jacobian, axis=0), np.linalg.norm(wide, axis=0)
        rough = np.linalg.norm(jacobian - wide, axis=0) > _MAX_DIFFERENCE * np.minimum(size, other)
        # Where a run jumps, the smaller derivative is taken: it makes the interval wider.
        jacobian[:, rough & (other < size)] = wide[:, rough & (other < size)]
        jumps = [free.name for free, jumps in zip(self.free, rough[:count]) if jumps]
        return self._weighted(jacobian), jumps

    def parts(self) -> list[np.ndarray]:
        """
        Return the residuals at the end, (n_i,), of each output in each window, and of the prior.

        With a loss other than `linear` they have its weights.
        """
        return self._weighted(self.residuals(self.x))

    def _weighted(self, rows):
        parts = self._split_rows((self.weights(self.residuals(self.x)) * rows.T).T)
        return parts[:len(parts) - (not len(self._prior))]

    def weights(self, residuals: np.ndarray) -> np.ndarray:
        """Return the roots of the weights that the loss gives to residuals, shape (n,)."""
        weight = {'linear': lambda z: np.ones_like(z), 'soft_l1': lambda z: (1.0 + z)**-0.5,
                  'huber': lambda z: np.where(z <= 1.0, 1.0, 1.0 / np.sqrt(np.maximum(z, 1.0))),
                  'cauchy': lambda z: 1.0 / (1.0 + z)}[self.loss](residuals**2)
        weight[len(weight) - len(self._prior):] = 1.0  # the prior has no weights
        return np.sqrt(weight)


def reason_of(stop: BaseException) -> str:
    """Return what ended a search or what follows it, a KeyboardInterrupt or TimeIsUp, as text."""
    return 'its time was up' if isinstance(stop, TimeIsUp) else 'it was interrupted'


def first_part(problem: Problem) -> float:
    """Return when a quarter of the time is over, and of the motion of an output [s]."""
    t, ends = np.linspace(0.0, problem.until, _COARSE), []
    for channel in problem.record.outputs.values():
        motion = np.cumsum(np.diff(np.interp(t, channel.t, channel.values))**2)
        ends.append(t[1 + np.searchsorted(motion, _FIRST_PART * motion[-1])])
    return float(max(_FIRST_PART * problem.until, min(ends)))
