# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
What parameters a record allows: intervals and samples, also where squares are not quadratic.

The likelihood falls with the sum of squares. Where residuals are correlated a rise counts by the
ratio of the covariance for white ones to the one that allows for correlation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import NORMAL
from timo_sim.scene.numbers import overrides_of
from timo_sim.scene.parameters import Parameter, PARAMETERS
from timo_sim.scene.scene import Scene

_MAX_RATIO = 1.5  # of the rise of squares at the ends of an interval to the quadratic one
# Relative distances that count as none: of the end of an interval, of a rise that is foreseen.
_NEAR, _FORESEEN = 0.01, 0.1
_MAX_REFITS = 5  # for an end of a profile interval
_MAX_STEPS, _SETTLED = 3, 0.05  # of Gauss and Newton in a refit; fall of squares that ends it
_FREEDOM = 5.0  # degrees of freedom of Student's distribution from which weighted samples come
_MIN_DRAWS, _MAX_DRAWS = 100, 1000  # draws that are weighted by runs
_FAR = 3.0  # deviations up to which the volume of a draw is followed
_COUNT = Parameter('n', 1, '', '', low=1, high=10**7)


class Samples(NamedTuple):
    """
    Equally likely parameters of a fit.

    `values` has arrays, shape (n,), by name of a free parameter. `variations` are overrides of
    `Fit.scene`, for `simulate_many` and `Scene.vary`, without initial states and sensors, which
    are those of a record. `effective` is the number of independent samples that tell as much.
    """

    values: dict[str, np.ndarray]
    variations: list[dict[str, Any]]
    effective: float


@dataclass(frozen=True)
class Posterior:
    """The coordinates of an Objective that its records allow, around its minimum x."""

    objective: Objective
    x: np.ndarray          # (p,)
    jacobian: np.ndarray   # (n, p) of all weighted residuals
    residuals: np.ndarray  # these, (n,)
    spread: np.ndarray     # (p, p), covariance of the coordinates

    @cached_property
    def _root(self):
        return self.objective.weights(self.objective.residuals(self.x))

    @cached_property
    def _inverse(self):
        return np.linalg.pinv(self.jacobian)

    def _rows(self, x):
        return self._root * self.objective.residuals(x)

    def _settle(self, x, held=None, target=np.inf):
        """
        Follow the curved valley: return x' near x with the residuals of the linear model at x.

        With `held`, x[held] stays and the others are fitted (a profile). Also returns the rise of
        the squares, which is `target` if the linear model foresees that.
        """
        some = np.arange(len(x)) != held
        solve = self._inverse if held is None else np.linalg.pinv(self.jacobian[:, some])
        goal = self.residuals + (self.jacobian @ (x - self.x) if held is None else 0.0)
        rows = self._rows(x)
        for _ in range(_MAX_STEPS):
            move = np.zeros(len(x))
            move[some] = solve @ (goal - rows)
            better = self.objective.within(x + move)
            change = self.jacobian @ (better - x)
            rise = np.sum((rows + change)**2) - self.residuals @ self.residuals
            if change @ change < _SETTLED or abs(rise - target) < _FORESEEN * target:
                return better, rise
            found = self._rows(better)
            if not np.sum((found - goal)**2) < np.sum((rows - goal)**2):
                break
            x, rows = better, found
        return x, rows @ rows - self.residuals @ self.residuals

    def intervals(self, places: Iterable[int]) -> dict[int, tuple[float, float]]:
        """
        Return the 95 % intervals, in coordinates, that are not quadratic, by place.

        Others are fitted with one held where squares do not rise as they should, or at a bound.
        """
        found = {}
        for k in places:
            path = NORMAL * self.spread[:, k] / np.sqrt(self.spread[k, k])
            target = np.sum((self.jacobian @ path)**2)
            rises = [self._settle(self.objective.within(self.x + sign * path), k, target)[1]
                     for sign in (-1.0, 1.0)]
            if not all(target / _MAX_RATIO < rise < _MAX_RATIO * target for rise in rises):
                found[k] = self._end(k, -path, target), self._end(k, path, target)
        return found

    def _end(self, k, path, target):
        """Return the coordinate at which the least squares have risen by `target` on a side."""
        start, size = self.x, 1.0
        for _ in range(_MAX_REFITS):
            x, rise = self._settle(self.objective.within(start + size * path), k)
            factor = np.sqrt(target / max(rise, 1e-3 * target))
            stopped = x[k] in (self.objective.low[k], self.objective.high[k]) and factor > 1.0
            if stopped or abs(factor - 1.0) < _NEAR:
                break
            path = (x - start) / size  # the others follow
            size *= np.clip(factor, 0.3, 3.0)
        return float(x[k])

    def sample(self, n: int, seed: int, scene: Scene) -> Samples:
        """Return Samples, see `Fit.sample`."""
        n, objective = _COUNT.check(n), self.objective
        random, (size, axes) = np.random.default_rng(seed), np.linalg.eigh(self.spread)
        axes *= np.sqrt(np.maximum(size, 0.0))
        z = random.standard_normal((max(_MIN_DRAWS, min(n, _MAX_DRAWS)), len(size)))
        z *= np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, (len(z), 1)))
        moves, power = z @ axes.T, np.sum(z**2, axis=1)
        moved = [self._settle(self.x + each) for each in moves]
        x, rise = np.array([each for each, _ in moved]), np.array([each for _, each in moved])
        # log det of the map from z to x', quadratic through +-1 deviation on each axis.
        up, down = np.transpose([[self._volume(sign * axis) for sign in (1.0, -1.0)]
                                 for axis in axes.T])
        near = np.clip(z, -_FAR, _FAR)
        volume = near @ (0.5 * (up - down)) + near**2 @ (0.5 * (up + down))
        logarithm = (volume - 0.5 * rise * power / np.sum((moves @ self.jacobian.T)**2, axis=1)
                     + 0.5 * (_FREEDOM + len(size)) * np.log1p(power / _FREEDOM))
        logarithm[np.any((objective.low >= x) | (x >= objective.high), axis=1)] = -np.inf
        weights = np.exp(logarithm - logarithm.max())
        weights /= weights.sum()
        # Systematic resampling: each draw as often as its weight says, or once more.
        places = np.searchsorted(np.cumsum(weights), (np.arange(n) + random.random()) / n)
        x = random.permutation(x[places.clip(max=len(x) - 1)])
        values = {free.name: np.array([free.value(each) for each in column])
                  for free, column in zip(objective.free, x.T)}
        own = [free.name for free in objective.free if not free.is_own
               and free.name.partition('[')[0] in PARAMETERS]
        return Samples(values, [
            overrides_of(dict(zip(own, map(float, row))), scene)
            for row in zip(*(values[name] for name in own))], float(1.0 / np.sum(weights**2)))

    def _volume(self, move):
        """Return log det of the map from a move to the coordinates of `_settle`."""
        x, _ = self._settle(self.x + move)
        local = self._root[:, np.newaxis] * self.objective.jacobian(x, central=False)
        return -np.linalg.slogdet(self._inverse @ local)[1]
