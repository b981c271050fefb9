# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The search for the parameters with the least squares of residuals in standard deviations."""

from collections.abc import Collection, Sequence
import math

import numpy as np
from scipy.linalg import matmul_toeplitz
from scipy.optimize import least_squares

from timo_sim.fitting.problem import initial_states, Problem, Window
from timo_sim.scene.parameters import ParameterError
from timo_sim.simulation.warnings import DivergenceError

WHITE = 0.01         # probability below which residuals do not count as white
NORMAL = 1.959964    # standard deviations of a 95 % interval
_LAGS = 20           # of the test for whiteness
_ORDER = 12          # largest of an autoregressive process
_NOTHING = 1e-30     # sensitivity of residuals that counts as none
_FAR = 1e3           # deviation of a combination on which residuals do not depend
_ROUND_OFF = 1e-9    # singular value, relative to the largest, below which it is that of noise
# Parts of the largest in a combination, above which a parameter is named: any, or one that is
# not identified.
_PART, _SMALL = 0.25, 0.02


def whiteness(residuals: np.ndarray) -> float:
    """
    Return the probability that white residuals are as correlated as these, by Ljung and Box.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
        Ascending in time.

    """
    from scipy.stats import chi2
    r = residuals - residuals.mean()
    n, lags = len(r), min(_LAGS, len(r) // 4)
    power = r @ r
    if not power:
        return 1.0
    lag = np.arange(1, lags + 1)
    correlation = np.array([r[k:] @ r[:-k] for k in lag]) / power
    return float(chi2.sf(n * (n + 2.0) * np.sum(correlation**2 / (n - lag)), lags))


def covariance(jacobians: Sequence[np.ndarray],
               residuals: Sequence[np.ndarray]) -> tuple[np.ndarray, bool]:
    """
    Return the covariance of parameters estimated by least squares.

    If the residuals of all outputs are white it is that of independent noise. Otherwise what the
    model lacks is in them, too, and each series counts as an autoregressive process, whose order
    minimises Schwarz's criterion (BIC). No combination of parameters is then taken to be more
    certain than with independent noise.

    Parameters
    ----------
    jacobians : list of ndarray, shape (n_i, p)
        Of the residuals of each series (an output in a window) by the parameters.
    residuals : list of ndarray, shape (n_i,)
        In standard deviations.

    Returns
    -------
    covariance : ndarray, shape (p, p)
    white : bool

    """
    whole = np.concatenate(jacobians)
    norms = np.maximum(np.linalg.norm(whole, axis=0), _NOTHING)
    u, s, vt = np.linalg.svd(whole / norms, full_matrices=False)
    root = vt.T / norms[:, np.newaxis]
    # Singular values below the errors of the derivatives may be zero.
    s = np.where(s < _ROUND_OFF * s[0], np.minimum(s, np.abs(root).max(axis=0) / _FAR), s)
    root /= np.maximum(s, _NOTHING)
    white = all(whiteness(each) >= WHITE for each in residuals if len(each) > 4)
    if not white:
        # It is computed for orthonormal columns, because for the parameters themselves round-off
        # may exceed its smallest eigenvalue.
        parts = np.split(u, np.cumsum([len(each) for each in residuals])[:-1])
        size, axes = np.linalg.eigh(sum(map(_of_sums, parts, residuals)))
        root = root @ (axes * np.sqrt(np.maximum(size, 1.0)))
    return root @ root.T, white


def _of_sums(columns, residuals):
    """Return the covariance, shape (p, p), of sums of residuals weighted by columns, (n, p)."""
    n = len(residuals)
    lags = range(min(_ORDER, n // 10) + 1)
    found = np.array([residuals[k:] @ residuals[:n - k] for k in lags]) / n
    # Levinson and Durbin: each order follows from the one before.
    past, rest, best = np.zeros(0), found[0], (np.inf, np.zeros(0), found[0])
    for order in lags:
        if order:
            last = (found[order] - past @ found[order - 1:0:-1]) / rest
            past = np.append(past - last * past[::-1], last)
            rest *= 1.0 - last**2
        if not rest > _ROUND_OFF * found[0]:
            break
        best = min(best, (n * np.log(rest) + order * np.log(n), past, rest), key=lambda it: it[0])
    _, past, rest = best
    response = np.fft.rfft(np.append(1.0, -past), 4 * n)
    covariances = np.fft.irfft(rest / np.abs(response)**2, 4 * n)[:n]
    return columns.T @ matmul_toeplitz(covariances, columns)


def unidentified_combinations(jacobian: np.ndarray, names: Sequence[str],
                              doubtful: Collection[str],
                              most: float = 1.0) -> list[dict[str, float]]:
    """
    Return the combinations of parameters on which the residuals hardly depend.

    Parameters
    ----------
    jacobian : ndarray, shape (n, p)
        Of all residuals in standard deviations, by coordinates of the fit.
    names : list of str, length p
    doubtful : set of str
        Those that are not identified; a combination has one of them.
    most : float
        Half of the 95 % interval of a combination from which on it counts as unknown.

    Returns
    -------
    list of dict
        For each such combination the part of each parameter that matters in it, by name.

    """
    _, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    found = []
    for value, parts in zip(s, vt):
        if value * most < NORMAL or value < _ROUND_OFF * s[0]:
            share = np.abs(parts) / np.abs(parts).max()
            large = (share > _PART) | (share > _SMALL) & [name in doubtful for name in names]
            sign = np.sign(parts[np.argmax(np.abs(parts))])
            found.append({name: float(sign * part)
                          for name, part, kept in zip(names, parts, large) if kept})
    return [parts for parts in found if not parts.keys().isdisjoint(doubtful)]


def r_squared(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Return the coefficient of determination R^2; NaN if nothing was measured to vary."""
    spread = np.sum((measured - measured.mean())**2)
    return float(1.0 - np.sum((measured - predicted)**2) / spread) if spread else np.nan


LOSSES = 'linear', 'soft_l1', 'huber', 'cauchy'
# Steps of differences in coordinates of the fit: one for the search, two for the intervals.
_FORWARD, _CENTRAL, _WIDE = 1e-6, 3e-4, 1e-3
_ROUGH = 0.3         # relative difference of derivatives by two steps, above which a run jumps
_FIRST = 0.25        # part of the record that is fitted first: early, runs are closer to it
_LEAST = 1e-5        # least standard deviation, relative to the first
_GUESS = 0.1         # first standard deviation, relative to that of an output's values
_LOOSE, _TIGHT = 1e-4, 1e-7      # relative changes of the sum of squares at which a search ends
_ROUNDS = 6          # most searches with standard deviations from the one before
_SETTLED = 0.01      # relative change of standard deviations that counts as none
_PRIOR = 10.0        # standard deviation of initial states of windows, in their scales
# Sizes of dry friction that are tried, as shares of the force that accelerates the free body.
_TRIED = 0.01, 0.1, 1.0
_MAD = 1.4826        # standard deviations in a median absolute deviation


class Search:
    """A search for the least sum of squares; x are the coordinates of all that is free."""

    def __init__(self, problem: Problem, loss: str) -> None:
        self.problem, self.loss, record = problem, loss, problem.record
        self.deviations = {
            name: channel.noise or _GUESS * float(np.std(
                channel.values[channel.t <= problem.until])) or 1.0
            for name, channel in record.outputs.items()}
        # Deviations have a lower bound: without noise they would fall until squares overflow.
        self._least = {name: _LEAST * each for name, each in self.deviations.items()}
        free = problem.free
        self.x = np.array([each.coordinate(each.start) for each in free])
        self._low = np.array([each.coordinate(each.low) for each in free])
        self._high = np.array([each.coordinate(each.high) for each in free])
        self._windows = problem.windows
        self._states = []  # of each window, the Free parameters of its initial state
        self.against = {}  # by output, its least correlation with the first run, at most 0
        self._prior = np.zeros(0)

    def run(self) -> None:
        """Find x and the standard deviations of the sensors."""
        self._check_start()
        whole = self.problem.windows
        if not whole[0].names:
            self._windows = [Window(0.0, _FIRST * self.problem.until, ())]
            self._solve(_LOOSE)
            self._windows = whole
            self._solve(_LOOSE)
        self._begin_windows()
        for _ in range(_ROUNDS):
            self._solve(_LOOSE)
            if self._estimate_deviations() < _SETTLED:
                break
        self._solve(_TIGHT)
        self._estimate_deviations()

    def _check_start(self):
        problem = self.problem
        values = problem.values(self.x)
        try:
            run = problem.run(values, 0.0, problem.until)
            self.against = _correlations(
                problem, problem.predictions(run, values, 0.0, problem.until))
        except (DivergenceError, ParameterError) as error:
            if isinstance(error, ParameterError) or not problem.windows[0].names:
                raise ParameterError('the record cannot be predicted with the first guess: '
                                     f'{error}') from None

    def _begin_windows(self):
        problem = self.problem
        if not problem.windows[0].names:
            return
        self._states = initial_states(problem, problem.values(self.x))
        every = [each for states in self._states for each in states]
        start = np.array([each.coordinate(each.start) for each in every])
        self.x, self._prior = np.concatenate([self.x, start]), start
        self._low = np.concatenate([self._low, np.full(len(every), -np.inf)])
        self._high = np.concatenate([self._high, np.full(len(every), np.inf)])

    def _solve(self, tolerance):
        found = least_squares(self._residuals, np.clip(self.x, self._low, self._high),
                              self._jacobian, (self._low, self._high), x_scale='jac',
                              loss=self.loss, ftol=tolerance, xtol=tolerance, gtol=1e-12,
                              max_nfev=60)
        self.x = found.x

    def _split(self, x):
        """Return the values of free parameters and those of the initial state of each window."""
        first, states = len(self.problem.free), []
        for every in self._states or [[]] * len(self._windows):
            states.append({each.name: each.value(part)
                           for each, part in zip(every, x[first:first + len(every)])})
            first += len(every)
        return self.problem.values(x), states

    def first_state(self) -> dict[str, float]:
        """Return the initial state of the first window by name, if windows have their own."""
        return self._split(self.x)[1][0]

    def _residuals(self, x, more=None):
        values, states = self._split(x)
        parts = [self.problem.residuals({**values, **(more or {})}, self.deviations, window, state)
                 for window, state in zip(self._windows, states)]
        return np.concatenate([*parts, self._prior_residuals(x)])

    def _prior_residuals(self, x):
        return (x[len(self.problem.free):] - self._prior) / _PRIOR

    def _jacobian(self, x, step=_FORWARD, central=False):
        """Return the derivatives of the residuals by x, from differences of runs."""
        problem = self.problem
        count, states = len(problem.free), self._split(x)[1]
        here = self._residuals(x)
        sizes = [sum(map(len, problem.measurements(window).values())) for window in self._windows]
        edges = np.concatenate([[0], np.cumsum(sizes)])
        found = np.zeros((len(here), len(x)))

        def difference(k, windows):
            size = step
            if central and k < count and problem.free[k].name.endswith('.delay'):
                # A delay is varied by whole steps: within a step the run depends on it only
                # through the interpolation of the load.
                size = problem.scene.step / problem.free[k].scale * (step / _CENTRAL)
            up = size if x[k] + size <= self._high[k] else -size
            ends = [(x + up * (np.arange(len(x)) == k), up)]
            down = x - up * (np.arange(len(x)) == k)
            if central and self._low[k] <= down[k] <= self._high[k]:
                ends.append((down, -up))
            for w in windows:
                rows = slice(edges[w], edges[w + 1])
                values = []
                for at, _ in ends:
                    free, own = self._split(at)
                    values.append(problem.residuals(free, self.deviations, self._windows[w],
                                                    own[w]))
                values.append(here[rows])
                found[rows, k] = (values[0] - values[1]) / (2.0 * up if len(ends) == 2 else up)

        for k in range(count):
            difference(k, range(len(self._windows)))
        k = count
        for w, every in enumerate(states):
            for _ in every:
                difference(k, [w])
                k += 1
        found[edges[-1]:, count:] = np.eye(len(x) - count) / _PRIOR
        return found

    def _estimate_deviations(self):
        """Estimate the standard deviations of the sensors; return the largest relative change."""
        values, states = self._split(self.x)
        apart = {name: [] for name in self.deviations}
        for window, state in zip(self._windows, states):
            residuals, first = self.problem.residuals(values, self.deviations, window, state), 0
            for name, measured in self.problem.measurements(window).items():
                apart[name].append(residuals[first:first + len(measured)])
                first += len(measured)
        change = 0.0
        for name, parts in apart.items():
            r = np.concatenate(parts)
            size = math.sqrt(np.mean(r**2)) if self.loss == 'linear' else (
                _MAD * float(np.median(np.abs(r))))
            known = self.problem.record.outputs[name].noise
            new = max(size * self.deviations[name], known or self._least[name])
            if not known or new > 1.5 * known:
                change = max(change, abs(new / self.deviations[name] - 1.0))
                self.deviations[name] = new
        return change

    def derivatives(self) -> tuple[list[np.ndarray], list[np.ndarray], list[str],
                                   dict[str, tuple[float, float]]]:
        """
        Return the derivatives at the end.

        Returns
        -------
        jacobians, residuals : list of ndarray, shapes (n_i, p + k), (n_i,)
            Of each output in each window, and of the prior of k initial states of windows. With a
            loss other than `linear` they have its weights.
        jumps : list of str
            Names of parameters on which runs depend in jumps.
        friction : dict
            By name of a parameter of dry friction that the scene has not got, the part of the
            squares of the residuals that it would explain, and its value.

        """
        jacobian, residuals = self._jacobian(self.x, _CENTRAL, True), self._residuals(self.x)
        wide, count = self._jacobian(self.x, _WIDE, True), len(self.problem.free)
        size, other = np.linalg.norm(jacobian, axis=0), np.linalg.norm(wide, axis=0)
        rough = np.linalg.norm(jacobian - wide, axis=0) > _ROUGH * np.minimum(size, other)
        # Where a run jumps, the smaller derivative is taken: it makes the interval wider.
        jacobian[:, rough & (other < size)] = wide[:, rough & (other < size)]
        jumps = [free.name for free, jumps in zip(self.problem.free, rough[:count]) if jumps]
        weight = {'linear': lambda z: np.ones_like(z), 'soft_l1': lambda z: (1.0 + z)**-0.5,
                  'huber': lambda z: np.where(z <= 1.0, 1.0, 1.0 / np.sqrt(np.maximum(z, 1.0))),
                  'cauchy': lambda z: 1.0 / (1.0 + z)}[self.loss](residuals**2)
        root, jacobians, parts, first = np.sqrt(weight), [], [], 0
        friction = self._friction(jacobian * root[:, np.newaxis], residuals, root)
        for window in self._windows:
            for measured in self.problem.measurements(window).values():
                rows = slice(first, first + len(measured))
                jacobians.append(jacobian[rows] * root[rows, np.newaxis])
                parts.append(residuals[rows] * root[rows])
                first += len(measured)
        if first < len(residuals):
            jacobians.append(jacobian[first:])
            parts.append(residuals[first:])
        return jacobians, parts, jumps, friction

    def _friction(self, jacobian, residuals, root):
        """Return what dry friction would explain beside all that is free, see `derivatives`."""
        problem, found = self.problem, {}
        values, states = self._split(self.x)
        scene = problem.scene_of(values, states[0])
        try:
            run = problem.run(values, 0.0, problem.until, states[0])
        except DivergenceError:
            return found
        motion = run.motion[:, run.motion.shape[1] // 2:][:, :3]
        needed = np.abs(np.diag(run.model.mass_matrix(run.motion[0])[0])[:3] * np.sqrt(
            np.mean(np.gradient(motion, run.t, axis=0)**2, axis=0)))
        free, _ = np.linalg.qr(jacobian)
        left = root * residuals
        left -= free @ (free.T @ left)
        for name, size in (('carrier.coulomb_friction', needed[:2].max()),
                           ('motor.coulomb_friction', needed[2])):
            if not size or scene.values[name]:
                continue
            for each in _TRIED:
                try:
                    scene.vary({name: each * size})
                except ParameterError:
                    continue
                changed = root * (self._residuals(self.x, {name: each * size}) - residuals)
                changed -= free @ (free.T @ changed)
                fall, power = -(changed @ left), changed @ changed
                if fall > 0.0 and fall**2 > found.get(name, (0.0, 0.0))[0] * power * (left @ left):
                    found[name] = fall**2 / (power * (left @ left)), fall / power * each * size
        return found


def _correlations(problem, predicted):
    """Return the correlations of outputs with a run, the least of all and of the first part."""
    found = {}
    for name, (t, values) in predicted.items():
        measured = problem.measurements(Window(0.0, problem.until, ()))[name]
        for part in (t <= problem.until, t <= _FIRST * problem.until):
            if part.sum() > 2 and np.ptp(values[part]) and np.ptp(measured[part]):
                each = float(np.corrcoef(values[part], measured[part])[0, 1])
                found[name] = min(each, found.get(name, 0.0))
    return found
