# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The search for the parameters with the least sum of squares, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import math
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import TimeIsUp, whiteness
from timo_sim.model.differences import Secants

_WIDE = 1e-3  # step of differences beside CENTRAL
_MAX_DIFFERENCE = 0.3  # relative difference of derivatives by two steps, above which a run jumps


class Accuracy(NamedTuple):
    """When a search by `least_squares` ends, and its derivatives."""

    ftol: float    # relative change of the sum of squares at which a search ends
    xtol: float    # the same of x
    max_nfev: int  # most evaluations, since a jagged sum never settles
    step: float    # of differences; a wide one does not see how friction makes the sum jagged


# Starts are only tried: the best one is followed.
_TRY = Accuracy(ftol=1e-2, xtol=1e-4, max_nfev=12, step=1e-3)
_LOOSE = Accuracy(ftol=1e-4, xtol=1e-4, max_nfev=60, step=1e-3)
_ROUGH = Accuracy(ftol=1e-3, xtol=1e-4, max_nfev=25, step=1e-3)  # as trials of effects
_TIGHT = Accuracy(ftol=1e-7, xtol=1e-7, max_nfev=60, step=1e-6)
_ENDS = [_TIGHT._replace(step=1e-3), _TIGHT._replace(step=1e-5)] * 2  # one after the other
_FLAT = 1e-4  # part of the squares: a gradient that foresees a lower fall is none
_MAX_SEARCHES = 6  # most searches with standard deviations from the one before
# Relative change of standard deviations that counts as none, at the end and for effects.
_SETTLED_CHANGE, _SETTLED_ENOUGH = 0.01, 0.2
_SAME = 0.01  # relative difference of sums of squares below which they are the same
_ALIKE = 0.05  # the same, of starts that are only tried
_WORTHWHILE = 3.0  # ratio to the least, below which a minimum of the first part is followed
NUMERICAL = 1e-9  # 1 - R^2 below which only numerical errors are left
_HARDLY_WHITE = 1e-6  # probability of residuals as correlated, above which a minimum is good
# 1 - R^2 above which other starts are tried, if one, two or three starts have led to a minimum.
_MAX_UNEXPLAINED = 0.05, 0.2, 0.5, math.inf
_MAX_STARTS, _FEW_STARTS = 16, 2
_NEAR = 0.1  # distance in coordinates of the fit within which two ends are one
_SPREAD = 6.0  # factor by which starts differ from the first guess
INTERRUPTED = 'it was interrupted'


class Minimum(NamedTuple):
    """Where a search has ended, half the squares there, and by what part they may still fall."""

    cost: float
    x: np.ndarray
    fall: float


class Search:
    """
    A search for the least sum of squares of an Objective, `first` from some values by name.

    `tried` starts led to x and to `others` that fit as well, values by name; `stopped` says what
    ended the search early. `tell` is called with a text for each start and search, and `secants`
    is the most in a row: fewer runs, but another minimum where squares are jagged.
    """

    def __init__(self, objective: Objective, tell: Callable[[str], object] = lambda text: None,
                 first: Mapping[str, float] = MappingProxyType({}), secants: int = 8) -> None:
        self.objective, self._tell, self._secants = objective, tell, secants
        self.first = objective.within(np.array([
            free.coordinate(first.get(free.name, free.start)) for free in objective.free]))
        self.x, self.others, self.tried = self.first, list[dict[str, float]](), 1
        self.stopped, self.interrupted = '', False
        self._best = math.inf, self.first  # of all runs: `Objective.unlikelihood`, and x

    def run(self, starts: int | None) -> None:
        """
        Find x and the standard deviations of the sensors; `starts` is as for `fit`, or 0.

        With 0 it goes on from `first`. Where it ends early x are the best so far.
        """
        objective = self.objective
        try:
            if self.interrupted:
                raise KeyboardInterrupt
            self.x, self.others = self._run(starts)
            if not objective.evaluate(self.x)[1]:
                return
            self.stopped = 'it ended where no run is possible'
        except KeyboardInterrupt as stop:
            self.stopped = str(stop) or INTERRUPTED
            self.interrupted = not isinstance(stop, TimeIsUp)
        except (ArithmeticError, ValueError) as error:  # of parameters, or of linear algebra
            if math.isinf(self._best[0]):
                raise
            self.stopped = f'it failed: {error}'
        finally:
            self.set_deadline(math.inf)
        self.x, self.others = self._best[1], []
        objective.estimate_deviations(self.x)

    def set_deadline(self, deadline: float) -> None:
        """Let runs after a time of `time.monotonic` raise TimeIsUp."""
        for problem in self.objective.problems:
            problem.deadline = deadline

    def _run(self, starts):
        """Return x and others that fit as well."""
        objective = self.objective
        x, *others = self._try_starts(starts) if starts != 0 else [self.first]
        x = self._settle(x)
        self._tell('last search, with tight tolerances')
        minima = [self._end(each) for each in [x, *others]]
        best = min(minima, key=lambda each: each.cost)
        if starts != 0 and not objective.is_white(best.x) and not self._is_doubtful(best.x, 1):
            # A first part may have led away from a guess that is good.
            again = self._end(self._solve(_LOOSE, self.first).x)
            self._tell(f'fitted all records at once from the first guess: the squares are '
                       f'{again.cost / best.cost:.3g} times as large')
            minima.append(again)
            best = min(best, again, key=lambda each: each.cost)
        apart = [best.x]
        for cost, x, _ in minima:
            if cost - best.cost < _SAME * best.cost and all(
                    self._is_apart(x, other, best.cost) for other in apart):
                apart.append(x)
        objective.estimate_deviations(best.x)
        return best.x, [{free.name: free.value(at) for free, at in zip(objective.free, x)}
                        for x in apart[1:]]

    @property
    def best(self) -> dict[str, float]:
        """The best values so far, by name."""
        return {free.name: free.value(at) for free, at in zip(self.objective.free, self._best[1])}

    def settle(self, starts: int | None = None, anew: bool = False,
               until: float = math.inf) -> np.ndarray:
        """
        Return x and find deviations roughly: from the first, or from few starts.

        After `until`, a time of `time.monotonic`, x are the best so far, and it is `stopped`.
        """
        self.set_deadline(until)
        try:
            return self._settle(self._try_starts(starts, _FEW_STARTS, _ROUGH)[0] if anew
                                else self.first, _SETTLED_ENOUGH, _ROUGH)
        except TimeIsUp as stop:
            self.stopped = str(stop)
        finally:
            self.set_deadline(math.inf)
        self.objective.estimate_deviations(self._best[1])
        return self._best[1]

    def _settle(self, x, enough=_SETTLED_CHANGE, accuracy=_LOOSE):
        """Return the minimum near x, with the deviations of the sensors that it finds."""
        for number in range(1, _MAX_SEARCHES + 1):
            x = self._solve(accuracy, x).x
            change = self.objective.estimate_deviations(x)
            self._tell(f'search {number} of up to {_MAX_SEARCHES}: its residuals change the '
                       f'standard deviations of the sensors by {100.0 * change:.2g} %')
            if change < enough:
                break
        return x

    def _end(self, x):
        """Return the Minimum near x, where the gradient foresees no lower squares."""
        best = self._solve(_TIGHT, x)
        for accuracy in _ENDS:
            if best.fall < _FLAT:
                break
            again, before = self._solve(accuracy, best.x), best
            self._tell(f'the gradient predicted squares lower by {best.fall:.1g} of them; the '
                       f'next search found {again.cost / best.cost:.6g} times as large ones')
            best = min(again, before, key=lambda each: each.cost)
            if best.cost > (1.0 - _FLAT) * before.cost and accuracy.step < _WIDE:
                break  # nor did a wide step find it, as where friction makes squares jagged
        return best

    def _is_apart(self, x, other, least):
        """Return whether x differs from another minimum in a direction that the record sees."""
        linear = self.objective.jacobian(other, _WIDE, False) @ (x - other)
        return 0.5 * linear @ linear > _SAME * least

    def _try_starts(self, starts, limit=_MAX_STARTS, accuracy=_LOOSE):
        """Return the best x from several starts, then others that are as good."""
        objective, part = self.objective, self.objective.of_first_parts()
        most = f'{starts}' if starts else f'up to {limit}'
        firsts: list[Minimum] = []   # of the first part, from each start
        costs: list[float] = []      # of all, from each of these; infinite if it was not followed
        followed: list[Minimum] = []

        def rms(x, some=part):
            return math.sqrt(np.mean(some.residuals(some.within(x))**2))

        for start in self._starts(starts or limit):
            self.tried = len(firsts) + 1
            first = self._solve(accuracy, start, part)
            text = (f'start {self.tried} of {most}: rms residual {rms(start):.3g} -> '
                    f'{rms(first.x):.3g} deviations in the first part')
            # Where the arm hardly moves at first, all starts fit that part equally well: their
            # ends are compared, not their costs.
            known = [cost for cost, other in zip(costs, firsts)
                     if np.allclose(first.x, other.x, 0.0, _NEAR)]
            cost = known[0] if known else math.inf
            if not known and first.cost <= _WORTHWHILE * min(
                    (other.cost for other in firsts), default=math.inf):
                followed.append(self._solve(_TRY, first.x))
                cost = followed[-1].cost
                text += f', {rms(followed[-1].x, objective):.3g} in all'
            self._tell(text)
            firsts.append(first)
            costs.append(cost)
            best = min(followed, key=lambda each: each.cost)
            alike = sum(cost <= (1.0 + _ALIKE) * best.cost for cost in costs)
            if starts is None and not self._is_doubtful(best.x, alike):
                break
        return [best.x, *(other.x for other in followed if other is not best
                          and other.cost <= (1.0 + _SAME) * best.cost)]

    def _is_doubtful(self, x, count):
        """Return whether x, to which so many starts have led, may not be the best minimum."""
        most, objective = _MAX_UNEXPLAINED[min(count, len(_MAX_UNEXPLAINED)) - 1], self.objective
        return any(
            np.mean((r * objective.deviations[k][name])**2) > most * np.var(measured)
            and whiteness(r) < _HARDLY_WHITE for r, (k, name, measured) in zip(
                objective.split(objective.residuals(x)), objective.series()))

    def _starts(self, count: int) -> Iterator[np.ndarray]:
        """Yield x of the first guess, and of points around it."""
        objective = self.objective
        yield self.first
        # A Latin hypercube: each parameter has each of its values once.
        random = np.random.default_rng(0)
        grid = np.linspace(-math.log(_SPREAD), math.log(_SPREAD), count - 1)
        for shift in np.stack([random.permutation(grid) for _ in self.first], axis=1):
            yield self.first + np.where([free.log for free in objective.free], shift, 0.0) * (
                np.minimum(objective.widths, 1.0))

    def _solve(self, accuracy, x, objective=None):
        """Return the Minimum nearest to x, of the whole objective or of a part of it."""
        some = objective or self.objective

        def residuals(x):
            rows, fails = some.evaluate(x)
            if objective is None and not fails:
                self._best = min(self._best, (some.unlikelihood(rows), x.copy()),
                                 key=lambda each: each[0])
            return rows

        jac = Secants(some.residuals, lambda x: some.jacobian(x, accuracy.step, False),
                      self._secants)
        end = least_squares(
            residuals, some.within(x), jac, (some.low, some.high), x_scale='jac', loss=some.loss,
            ftol=accuracy.ftol, xtol=accuracy.xtol, gtol=1e-12, max_nfev=accuracy.max_nfev)
        if jac.count > 1 and (left := accuracy.max_nfev - end.nfev) and (
                accuracy.ftol <= _TIGHT.ftol):  # it ends by differences
            return self._solve(accuracy._replace(max_nfev=left), end.x, objective)
        inside = end.active_mask == 0
        size = np.linalg.norm(end.jac, axis=0)[inside] + 1e-300
        jacobian, slope = end.jac[:, inside] / size, end.grad[inside] / size
        fall = slope @ np.linalg.lstsq(jacobian.T @ jacobian, slope)[0]
        return Minimum(end.cost, end.x, float(fall) / (2.0 * end.cost or 1.0))

    def derivatives(self) -> tuple[np.ndarray, list[str]]:
        """Return the weighted derivatives of all residuals at the end, (n, p), and what jumps."""
        objective, x = self.objective, self.x
        jacobian = objective.jacobian(x)
        for central in False, True:  # one side does where nothing jumps
            wide = objective.jacobian(x, _WIDE, central)
            size, other, apart = (
                np.linalg.norm(each, axis=0) for each in (jacobian, wide, jacobian - wide))
            rough = apart > _MAX_DIFFERENCE * np.minimum(size, other)
            if not rough.any():
                break
        # Where a run jumps, the smaller derivative is taken: it makes the interval wider.
        jacobian[:, rough & (other < size)] = wide[:, rough & (other < size)]
        return (objective.weights(objective.residuals(x))[:, np.newaxis] * jacobian,
                [free.name for free, jumps in zip(objective.free, rough) if jumps])
