# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Which effect, missing in the scene, the residuals of a fit look like.

A run of the fitted scene with some of an effect, less that without, is the direction in which the
effect moves the residuals. What a change of the free parameters would do as well is taken out; the
share of the squares of the residuals along the rest is what the effect would explain, to first
order. Effects whose share is close to the largest are then fitted, together with the free
parameters: what these explain is what the squares have fallen by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import DIVERGED, limit_inputs, WHITE, whiteness
from timo_sim.model.differences import differences
from timo_sim.model.layout import INPUTS
from timo_sim.runs.modes import frequencies_in_motion
from timo_sim.scene.parameters import ParameterError, PARAMETERS

_FRICTION = 0.01, 0.1, 1.0  # sizes that are tried, of the force that accelerates the free body
_ASYMMETRY, _MOST = 0.2, 0.99
_PRESLIDING, _LEAST = 0.2, 0.1  # way over `coulomb_speed` [s], and least factor of it
_BACKLASH = 0.003, 0.01, 0.03  # [rad]
_GRAVITY = 0.5, 5.0  # [m/s2]
_DELAYS = 1, 5  # steps
_EXCESS = 0.1, 0.4, 1.0  # of the largest value of an input over its limit, relative to this
_REST = 0.02, 0.1, 0.5  # speeds over which friction builds up, of that of the body
_FACTORS = -5.0, 5.0  # logarithms of factors of such a speed, to which they are tried
_STIFF = 5.0  # compliance of a gear that is tried, in step**2 / inertia of the shaft
_BESIDE = 0.1  # relative distance of a resonance from the modes of the model
_RESONANCES, _DAMPING = 60, 0.02  # how many frequencies are tried, and their damping ratio
_ANTICORRELATED = -0.5  # correlation with the first guess below which a sign may be wrong
_WORTHWHILE = 0.5  # share, relative to the largest, from which on an effect is fitted
_STEP, _TOLERANCE, _MAX_RUNS = 1e-3, 1e-3, 25  # of these fits, as of `least_squares`
_MIN_SHARE = 0.2  # share from which on a suspect is named
_MIN_SHARE_WHITE = 0.02  # the same, if what is left would be white
_ALIKE = 1.5  # ratio of what suspects leave to what the first leaves, up to which they are named


class Suspect(NamedTuple):
    """An effect that a scene may lack."""

    name: str
    share: float   # of the squares of the residuals that it explains
    white: bool    # whether the rest of the residuals would be white
    advice: str


class _Effect(NamedTuple):
    """An effect to try; `change(values, *sizes, *shape)` returns what differs in the scene."""

    name: str
    advice: str     # with a place for the first size
    change: Callable[..., dict[str, Any]]
    trials: Sequence[Sequence[float]]   # sizes that are tried; each of them alone moves a run
    low: float = 0.0    # least factor of sizes: 0, -inf for both signs, 1 for all or nothing
    shape: Sequence[float] = ()     # further arguments, which are fitted with the sizes


def _values(objective, x):
    """Return the values of the scene of each record, and of its sensors."""
    return [{**problem.scene.values, **objective.values(x, k)}
            for k, problem in enumerate(objective.problems)]


def _with_effect(objective, x, effect, arguments):
    """Return an objective whose scenes have an effect, with these arguments."""
    def change(values):
        return effect.change(values, *arguments)

    problems = []
    for problem, values in zip(objective.problems, _values(objective, x)):
        problem = copy(problem)
        problem.record = limit_inputs(problem.record, {
            **values, **change(values),
            **{each.rate_limit: np.inf for each in INPUTS}})  # rates are limited already
        problems.append(problem)
    return objective.of_changed(problems, change)


def suspects(objective: Objective, x: np.ndarray, jacobian: np.ndarray,
             residuals: np.ndarray) -> list[Suspect]:
    """
    Return the Suspects of a fit that has ended at x, that of the largest share first.

    `jacobian`, (n, p), and `residuals`, (n,), are weighted ones there.
    """
    if np.any(np.abs(here := objective.residuals(x)) >= DIVERGED):
        return []
    (free, _), root = np.linalg.qr(jacobian), objective.weights(here)
    left = residuals - free @ (free.T @ residuals)

    def is_white(rest):
        return all(whiteness(each) >= WHITE for each in objective.split(rest))

    def explain(columns, low=-np.inf):
        """Return share, whether the rest is white, and the factors of the columns."""
        columns = root[:, np.newaxis] * np.column_stack(columns)
        columns -= free @ (free.T @ columns)
        factors, *_ = np.linalg.lstsq(columns, -left, rcond=1e-9)
        if low >= 0.0 and factors[0] < 0.0:
            return 0.0, False, factors
        rest = left + columns @ factors
        return float(1.0 - (rest @ rest) / (left @ left)), is_white(rest), factors

    def without(effect, sizes):
        """Return the residuals with nothing of an effect, for which mostly no run is needed."""
        nothing = 0.0 * sizes
        if all(values.get(name, 0.0) == value for values in _values(objective, x)
               for name, value in effect.change(values, *nothing).items()):
            return here
        return _with_effect(objective, x, effect, nothing).residuals(x)

    share, white, frequency = max(
        ((*explain(columns)[:2], frequency) for frequency, columns
         in _resonances(objective, x)), default=(0.0, False, 0.0))
    found = [*_signs(objective), Suspect(
        f'a resonance at {frequency:.3g} Hz, which no mode of the model has', share, white,
        'look for what vibrates beside the arm, and try other first guesses')]
    tried = []
    for effect in _effects(objective, x):
        of_trials = []
        for sizes in map(np.array, effect.trials):
            runs = [without(effect, sizes), *(_with_effect(objective, x, effect, each).residuals(x)
                                              for each in np.diag(sizes))]
            if all(np.all(np.abs(run) < DIVERGED) for run in runs):
                share, white, factors = explain([run - runs[0] for run in runs[1:]], effect.low)
                of_trials.append((share, white, np.maximum(factors, effect.low) * sizes))
        if of_trials:
            tried.append((effect, *max(of_trials, key=lambda each: each[0])))
    largest = max(share for _, share, *_ in [*found, *tried])
    for effect, share, white, sizes in tried:
        # What is all or nothing has no first order.
        if share > _WORTHWHILE * largest or effect.low == 1.0:
            rest, fitted, count = _fit(objective, x, effect, sizes)
            # As Schwarz's criterion (BIC) weighs further parameters.
            left_over = (rest @ rest) * len(rest)**(count / len(rest))
            explained = float(1.0 - left_over / (residuals @ residuals))
            # Where friction turns, runs bend, and a fit may end where it begins.
            if explained > share:
                share, white, sizes = explained, is_white(rest), fitted
        found.append(Suspect(effect.name, share, white, effect.advice.format(sizes[0])))
    return sorted((each for each in found if each.share), key=lambda each: -each.share)


def _fit(objective, x, effect, sizes):
    """Return residuals, (n,), of a fit with an effect, its arguments, and how many are free."""
    count, first = len(x), np.append(sizes, effect.shape)
    start = np.ones(len(first) * (effect.low < 1.0))  # factors of the arguments

    @lru_cache(maxsize=1)
    def changed(*factors):
        return _with_effect(objective, x, effect, np.array(factors) * first if factors else first)

    def residuals(z):
        return changed(*z[count:]).residuals(z[:count])

    def jacobian(z):
        by_x = changed(*z[count:]).jacobian(z[:count], _STEP, False)
        return np.hstack([by_x, differences(lambda shifts: np.array([
            residuals(np.append(z[:count], z[count:] + shift)) for shift in shifts]),
            _STEP * start, 1).slope])

    low = np.where(np.arange(len(start)) < len(sizes), effect.low, 0.0)
    z = least_squares(
        residuals, np.append(x, start), jacobian,
        (np.append(objective.low, low), np.append(objective.high, np.inf * start)),
        x_scale='jac', loss=objective.loss, ftol=_TOLERANCE, max_nfev=_MAX_RUNS).x
    rest = residuals(z)
    return (rest * objective.weights(rest),
            z[count:] * first if len(start) else first, len(start))


def name_suspects(found: list[Suspect]) -> Iterator[str]:
    """Yield a text that names the likely ones of some Suspects, if there are any."""
    likely = [each for each in found if 1.0 - each.share <= _ALIKE * (1.0 - found[0].share) and (
        each.share > _MIN_SHARE or each.white and each.share > _MIN_SHARE_WHITE)]
    if likely:
        yield 'the residuals look like ' + ', or '.join(
            f'{each.name} ({100.0 * each.share:.0f} % of their squares: {each.advice})'
            for each in likely)


def _signs(objective):
    """Yield Suspects of wrong signs, by the correlation with the run of the first guess."""
    for problem, against, deviations in zip(
            objective.problems, objective.against, objective.deviations):
        shares = {name: 1.0 - (1.0 - correlation**2) * np.var(
            problem.record.outputs[name].values) / deviations[name]**2
            for name, correlation in against.items() if correlation < _ANTICORRELATED}
        if len(shares) == len(deviations):  # one wrong sign is more likely than several
            least = min(shares.values())
            shares = {**dict.fromkeys(problem.record.inputs, least), **(
                shares if len(shares) == 1 else {})}
        for name, share in shares.items():
            yield Suspect(f'the sign of {name}', max(share, 0.0), False,
                          'scale: -1 in the mapping')


def _effects(objective: Objective, x: np.ndarray) -> Iterator[_Effect]:
    """Yield the effects that a scene lacks."""
    problem, both = objective.problems[0], -np.inf
    values, step = objective.values(x, 0), problem.scene.step
    run = problem.run(values, problem.until)
    own: Mapping[str, Any] = run.scene.values
    rates = run.values[:, run.values.shape[1] // 2:][:, :3]
    speeds, accelerations = (np.sqrt(np.mean(each**2, axis=0)) for each in (
        rates, np.gradient(rates, step, axis=0)))
    forces = np.diag(run.model.mass_matrix(run.values[0])[0])[:3] * accelerations
    for body, force, speed in (('carrier', forces[:2].max(), speeds[:2].max()),
                               ('motor', forces[2], speeds[2])):
        name, rest = f'{body}.coulomb_friction', f'{body}.coulomb_speed'
        if force and not own[name]:
            yield _Effect(
                f'dry friction of the {body}', f'set {name} to about {{:.2g}}, and free it',
                lambda _, size, name=name: {name: size}, [[part * force] for part in _FRICTION])
        elif force and rest not in values:
            yield _Effect(
                f'another friction of the {body} near rest', f'set {rest}, and free it',
                lambda own, size, name=rest: {
                    name: own[name] * np.exp(np.clip(size, *_FACTORS)) or size},
                *([[[1.0]], both] if own[rest] else [[[part * speed] for part in _REST]]))
        if own[name] and own[rest] and not own[way := f'{body}.coulomb_presliding']:
            yield _Effect(
                name=f'presliding of the {body}, which rests as on a spring',
                advice=f'set {way} to about {{:.2g}} and {body}.coulomb_static to 0.5, and free '
                       'both', change=lambda _, size, part=0.5, name=way: {
                           name: size, name.replace('presliding', 'static'): part} if size else {},
                trials=[[_PRESLIDING * own[rest]]], low=_LEAST, shape=[0.5])
    for name in (name for name in PARAMETERS if name.endswith('.coulomb_asymmetry')):
        if own[name.replace('asymmetry', 'friction')] and not own[name]:
            yield _Effect('friction that depends on the direction',
                          f'set {name}, and free it',
                          lambda _, size, name=name: {name: np.clip(size, -_MOST, _MOST)},
                          [[_ASYMMETRY]], both)
    if own['motor.shaft'] == 'free' and not own['motor.gear.backlash']:
        stiff = _STIFF / own['motor.shaft_inertia'] * step**2
        if not own['motor.gear.stiffness']:
            yield _Effect('an elastic gear', 'set motor.gear.stiffness and motor.rotor.inertia, '
                          'and free them', _gear, [[stiff]], shape=[0.1, 1.0])
        yield _Effect(
            'backlash of the gear', 'set motor.gear.backlash to about {:.2g}',
            lambda own, size: {**({} if own['motor.gear.stiffness'] else _gear(own, stiff)),
                               'motor.gear.backlash': size}, [[play] for play in _BACKLASH])
    if not any(own['gravity']):
        yield _Effect('gravity, as of a tilted plane', 'free gravity[0] and gravity[1]',
                      lambda _, x, y: {'gravity[0]': x, 'gravity[1]': y},
                      [[size, size] for size in _GRAVITY], both)
    late = {name for name in problem.record.outputs if f'{name}.delay' in values}
    for name in (*problem.record.inputs, *problem.record.outputs):
        # Delays of all outputs are those of the input.
        if f'{name}.delay' not in values and late < {*problem.record.outputs}:
            yield _Effect(f'a delay of {name}', f'free {name}.delay, about {{:.2g}} s',
                          lambda _, size, name=f'{name}.delay': {name: size},
                          [[count * step] for count in _DELAYS])
    for name, channel in problem.record.outputs.items():
        if f'{name}.bias' not in values:
            yield _Effect(f'an offset of {name}', f'free {name}.bias, about {{:.2g}}',
                          lambda _, size, name=f'{name}.bias': {name: size},
                          [[np.std(channel.values)]], both)
    if own['motor.shaft'] == 'free' and 'initial.shaft' not in values:
        yield _Effect('another angle of the shaft at the beginning',
                      f'free initial.shaft, about {own["initial.shaft"]:.2g} + {{:.2g}} rad',
                      lambda own, size: {'initial.shaft': own['initial.shaft'] + size},
                      [[0.1]], both)
    for each in INPUTS:
        if each.name in problem.record.inputs and each.limit and not np.isfinite(own[each.limit]):
            most = np.abs(problem.record.inputs[each.name].values).max()
            yield _Effect(f'a limit of the {each.name}', f'set {each.limit}, below {most:.2g}',
                          lambda _, cut, name=each.limit, most=most: {name: most / (1.0 + cut)},
                          [[cut] for cut in _EXCESS])
    yield _Effect('one more mode', f'set model.modes to {own["model.modes"] + 1}',
                  lambda own, on: {'model.modes': own['model.modes'] + bool(on)}, [[1.0]], 1.0)


def _gear(own, compliance, damping=0.1, inertias=1.0):
    """Return values of a gear, by its damping ratio and the inertia before it over that after."""
    if not compliance:
        return {}
    after, turns = own['motor.shaft_inertia'] / (1.0 + inertias), own['motor.dc.gear_ratio']
    before = inertias * after
    mean = before / (1.0 + inertias)
    changes = {'motor.shaft_inertia': after, 'motor.rotor.inertia': before / turns**2,
               'motor.gear.stiffness': 1.0 / compliance,
               'motor.gear.damping': 2.0 * damping * np.sqrt(mean / compliance)}
    for name, factor in (('friction', 1.0 / turns), ('speed', turns), ('presliding', turns),
                         ('asymmetry', 1.0), ('static', 1.0)):  # it goes to the rotor
        shaft = f'motor.coulomb_{name}'
        changes |= {shaft: PARAMETERS[shaft].default,
                    f'motor.rotor.coulomb_{name}': factor * own[shaft]}
    return changes


def _resonances(objective, x):
    """Yield frequencies beside those of the model, and columns, (n,), of such a resonance."""
    problem = objective.problems[0]
    try:
        own = frequencies_in_motion(problem.scene_of(objective.values(x, 0)))
    except ParameterError:  # as where more modes need shorter steps
        return
    highest = 0.2 / problem.record.period
    if not problem.record.inputs or not len(own) or own[0] >= highest:
        return
    step, series = problem.scene.step, objective.series()
    driven = []
    for each in objective.problems:
        t = step * np.arange(round(each.record.duration / step) + 1)
        driven.append((each.record, each.until, t, sum(
            np.interp(t, given.t, given.values) - given.values[0]
            for given in each.record.inputs.values())))
    for frequency in np.geomspace(own[0], highest, _RESONANCES):
        if np.abs(frequency / own - 1.0).min() < _BESIDE:
            continue
        # The bilinear transform of 1 / (s^2 + 2 zeta s + 1), s in terms of the frequency.
        s, columns = 1.0 / (np.pi * frequency * step), []
        damped = 2.0 * _DAMPING * s
        system = [s**2 + damped + 1.0, 2.0 - 2.0 * s**2, s**2 - damped + 1.0]
        for which in ([1.0, 2.0, 1.0], [s, 0.0, -s]):  # its position and its speed
            parts = []
            for record, until, t, given in driven:
                shown = lfilter(which, system, given)
                parts += [np.interp(each.t[each.t <= until], t, shown)
                          for each in record.outputs.values()]
            columns += [np.concatenate([
                part * (name == each) for part, (_, each, _) in zip(parts, series)])
                for name in problem.record.outputs]
        yield frequency, columns
