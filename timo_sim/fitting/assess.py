# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The result of a search: how certain the parameters are, what they predict, and doubts."""

import math

import numpy as np

from timo_sim.fitting.result import Errors, Estimate, Fit
from timo_sim.fitting.statistics import covariance, NORMAL, r_squared, unknown, whiteness
from timo_sim.scene.parameter import ParameterError
from timo_sim.simulation.model_warnings import DivergenceError

_AT_BOUND = 1e-3     # distance from a bound, in coordinates of the fit, that counts as none
_FEWEST = 10         # samples of a part whose errors are worth a number
_FINER = 2           # modes and parts of a step more in the run that tells the numerical error
_AGAINST = -0.5      # correlation below which a sign may be the other one
_POOR = 0.5          # R^2 below which an output is not predicted
_EXACT = 1e-9        # 1 - R^2 below which what is left is of numbers alone
_EXPLAINED = 0.2     # part of the squares of residuals from which on its cause is named
_NOISY = 2.0         # residual, in known noise, from which on it is told
_MOST_NUMERICAL = 0.2    # part of a residual that may be numerical error


def result_of(problem, x, initial, deviations, derivatives, against, seconds):
    """
    Return the Fit for coordinates of the free parameters.

    Parameters
    ----------
    problem : Problem
    x : ndarray, shape (p,)
    initial : dict
        The initial state of the first window, if windows have their own.
    deviations : dict of float
        Standard deviations of the sensors, by output.
    derivatives : tuple
        See `Search.derivatives`.
    against : dict of float
        By output, its least correlation with a run of the first guess.
    seconds : float
        Wall time of the search [s].

    """
    names, count = [free.name for free in problem.free], len(problem.free)
    jacobians, residuals, jumps, friction = derivatives
    spread, white = covariance(jacobians, residuals)
    spread = spread[:count, :count]
    sigma = np.sqrt(np.diag(spread))
    estimates = {}
    for free, at, deviation in zip(problem.free, x, sigma):
        value, half = free.value(at), NORMAL * deviation
        identified = bool(half < (1.0 if free.log else max(1.0, abs(at))))
        edges = free.coordinate(free.low), free.coordinate(free.high)
        bound = next((name for name, edge in zip(('low', 'high'), edges)
                      if abs(at - edge) < _AT_BOUND), '')
        low, high = ((free.value(at - half), free.value(at + half)) if identified
                     else (math.nan, math.nan))
        estimates[free.name] = Estimate(
            value if identified else math.nan, low, high,
            deviation * (value if free.log else free.scale) if identified else math.nan,
            free.start, free.unit, identified, bound)
    values = problem.values(x)
    scene, doubts = problem.scene_of(values, initial), _rough(jumps, problem.scene)
    run, predicted = None, {}
    try:
        run = problem.run(values, scene=scene)
        predicted = {name: found for name, (_, found) in
                     problem.predictions(run, values).items()}
    except DivergenceError as error:
        doubts.append(f'one run of the whole record diverges: {error}')
    errors = _errors(problem, predicted, residuals, deviations)
    doubts += _suspects(errors, against, {} if white else friction)
    doubts += _doubts(problem, scene, estimates, errors, values, run, predicted)
    parts = unknown(_without_others(np.concatenate(jacobians), count), names, {
        name for name, each in estimates.items() if not each.identified})
    correlation = np.clip(spread / np.outer(sigma, sigma), -1.0, 1.0)  # but for round-off
    return Fit(scene, problem.record, estimates, correlation, parts, errors, run, predicted,
               problem.until, white, doubts, seconds)


def _rough(names, scene):
    cause = ', as with dry friction' if scene.friction.any() else ''
    return [f'the run depends on {", ".join(names)} in jumps{cause}, so the intervals '
            'may be too small: try a shorter window, or friction with a coulomb_speed'
            ] if names else []


def _suspects(errors, against, friction):
    """Yield what may be wrong with a record or a scene that do not agree."""
    if not all(each.r_squared > _POOR for each in errors.values()):
        for name, correlation in against.items():
            if correlation < _AGAINST:
                yield (f'{name} is anticorrelated with a run of the first guess '
                       f'({correlation:.2f}): its sign, or that of an input, may be the other one '
                       '(scale: -1 in the mapping)')
    for name, (share, value) in friction.items():
        if share > _EXPLAINED and any(1.0 - each.r_squared > _EXACT for each in errors.values()):
            yield (f'dry friction, which the scene has not got, would explain {100.0 * share:.0f} '
                   f'% of the squares of the residuals: set {name} to about {value:.2g}, and free '
                   'it')


def _finer(scene):
    """Return a scene with half the step and, unless its lists are by mode, more modes."""
    values, finer = scene.values, {'integrator.step': scene.step / _FINER}
    if len(values['arm.damping_ratio']) < 2 and not values['model.axial_modes']:
        finer['model.modes'] = values['model.modes'] + _FINER
        for name in ('initial.modal_coordinates', 'initial.modal_rates'):
            if values[name]:
                finer[name] = (*values[name], *_FINER * (0.0,))
    return scene.vary(finer)


def _without_others(jacobian, count):
    """Return the derivatives by the first columns that the others cannot make up for."""
    own, others = jacobian[:, :count], jacobian[:, count:]
    if not others.shape[1]:
        return own
    q, _ = np.linalg.qr(others)
    return own - q @ (q.T @ own)


def _errors(problem, predicted, residuals, deviations):
    found, outputs = {}, [*problem.record.outputs]
    for place, name in enumerate(outputs):
        channel = problem.record.outputs[name]
        parts = []
        for part in (channel.t <= problem.until, channel.t > problem.until):
            enough = part.sum() >= _FEWEST and name in predicted
            measured = channel.values[part]
            parts += [float(np.sqrt(np.mean((predicted[name][part] - measured)**2))),
                      r_squared(measured, predicted[name][part])] if enough else [math.nan] * 2
        own = residuals[place:len(problem.windows) * len(outputs):len(outputs)]
        size = math.sqrt(np.mean(np.concatenate(own)**2))
        found[name] = Errors(parts[0], parts[1], parts[2], parts[3], deviations[name] * size,
                             min(whiteness(each) for each in own if len(each) > 4))
    return found


def _doubts(problem, scene, estimates, errors, values, run, predicted):
    at_bound = [name for name, each in estimates.items() if each.bound]
    if at_bound:
        yield f'at a bound, so that intervals do not hold: {", ".join(at_bound)}'
    lost = [name for name, each in estimates.items() if not each.identified]
    if lost:
        yield (f'{", ".join(lost)} cannot be identified from this record: fix some of them, or '
               'record more outputs or another motion')
    for name, each in errors.items():
        noise = problem.record.outputs[name].noise
        if noise and each.residual_rms > _NOISY * noise:
            yield (f'{name} is off by {each.residual_rms / noise:.1f} times its noise: the model '
                   'lacks something, or this is not the best minimum: try other first guesses')
    if run is None:
        return
    try:
        again = problem.predictions(problem.run(values, scene=_finer(scene)), values)
    except (DivergenceError, ParameterError) as error:
        yield f'the numerical error is not known: {error}'
        return
    for name, (_, found) in again.items():
        apart = float(np.sqrt(np.mean((found - predicted[name])**2)))
        if apart > _MOST_NUMERICAL * errors[name].rms:
            yield (f'{name} differs by {apart:.2g} from that of a run with more modes and half '
                   f'the step, a large part of its error of {errors[name].rms:.2g}: take more '
                   'model.modes or a smaller integrator.step')
