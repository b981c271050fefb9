# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Which effect, missing in the scene, the residuals of a fit look like.

A run of the fitted scene with some of an effect, less that without, is the direction in which the
effect moves the residuals. What a change of the free parameters would do as well is taken out; the
share of the squares of the residuals along the rest is what the effect would explain, to first
order. Effects whose share is close to the largest are then fitted, together with the free
parameters, to two thirds of what is fitted: their share is that by which the squares of the rest,
which they predict, are less than without them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from functools import lru_cache, partial
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import DIVERGED, limit_inputs
from timo_sim.fitting.record import DRIVE
from timo_sim.model.differences import differences
from timo_sim.model.layout import INPUTS
from timo_sim.runs.modes import frequencies_in_motion
from timo_sim.scene.numbers import initial_scale
from timo_sim.scene.parameters import ParameterError, PARAMETERS

_FRICTION = 0.01, 0.1, 1.0  # sizes that are tried, of the force that accelerates the free body
_ASYMMETRY, _MOST = 0.2, 0.99
_PRESLIDING, _LEAST = (0.02, 0.2), 0.1  # way over `coulomb_speed` [s], and least factor of it
_BACKLASH = 0.003, 0.01, 0.03  # [rad]
_GRAVITY = 0.5, 5.0  # [m/s2]
_DELAYS = 1, 5  # steps
_EXCESS = 0.1, 0.4, 1.0  # of the largest value of an input over its limit, relative to this
_REST = 0.02, 0.1, 0.5  # speeds over which friction builds up, of that of the body
_FACTORS = -5.0, 5.0  # logarithms of factors of such a speed, to which they are tried
_STIFF = 5.0  # compliance of a gear that is tried, in step**2 / inertia of the shaft
_BESIDE = 0.1  # relative distance of a resonance from the modes of the model
_RESONANCES, _DAMPING = 60, 0.02  # how many frequencies are tried, and their damping ratio
_INNER = 2.0 / 3.0  # part of what is fitted to which suspects are fitted; the rest judges them
BETTER = 0.9  # ratio of errors there, below which a suspect predicts better
_FINE = 1e-3  # error, of the spread of an output, below which others count for more
_WORTHWHILE = 0.5  # share, relative to the largest, from which on an effect is fitted
_STEP, _TOLERANCE, _MAX_RUNS = 1e-3, 1e-3, 25  # of these fits, as of `least_squares`
_GEAR = 'motor.rotor.inertia', 'motor.gear.stiffness', 'motor.gear.damping'
_MOVING = 'initial.modal_coordinates[0]', 'initial.modal_rates[0]'
_TILTED = 'gravity[0]', 'gravity[1]'
_ALIKE = 1.5  # ratio of what suspects leave to what the first leaves, up to which they are named


class Suspect(NamedTuple):
    """An effect that a scene may lack."""

    name: str
    share: float   # of the squares of the residuals that it explains, or predicts if it was fitted
    advice: str
    ratio: float = math.inf  # of errors with it and without, see `predict`, if it was fitted
    change: Callable[..., dict[str, Any]] | None = None  # of the scene, by its values
    free: Sequence[str] = ()   # what it makes free


class _Effect(NamedTuple):
    """An effect to try; `change(values, *sizes, *shape)` returns what differs in the scene."""

    name: str
    advice: str     # with a place for the first size
    change: Callable[..., dict[str, Any]]
    trials: Sequence[Sequence[float]]   # sizes that are tried; each of them alone moves a run
    low: float = 0.0    # least factor of sizes: 0, -inf for both signs, 1 for all or nothing
    shape: Sequence[float] = ()     # further arguments, which are fitted with the sizes
    free: Sequence[str] = ()        # names that a fit with it has besides
    bends: bool = False             # whether its first order tells little


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
             residuals: np.ndarray, most: int = 0, error: float = 0.0) -> list[Suspect]:
    """
    Return the Suspects of a fit that has ended at x, that of the largest share first.

    `jacobian`, (n, p), and `residuals`, (n,), are weighted ones there. The likely ones, or as many
    as `most`, are fitted; `error` is that without them, see `predict`, if it is known.
    """
    if np.any(np.abs(here := objective.residuals(x)) >= DIVERGED):
        return []
    (free, _), root = np.linalg.qr(jacobian), objective.weights(here)
    left = residuals - free @ (free.T @ residuals)

    def explain(columns, low=-np.inf):
        """Return the share and the factors of columns."""
        columns = np.column_stack(columns)
        columns = root[:, np.newaxis] * np.pad(
            columns, ((0, len(root) - len(columns)), (0, 0)))  # guesses are not concerned
        columns -= free @ (free.T @ columns)
        factors, *_ = np.linalg.lstsq(columns, -left, rcond=1e-9)
        rest = left + columns @ factors
        return (0.0 if low >= 0.0 and factors[0] < 0.0
                else float(1.0 - (rest @ rest) / (left @ left))), factors

    def without(effect, sizes):
        """Return the residuals with nothing of an effect, for which mostly no run is needed."""
        nothing = 0.0 * sizes
        if all(values.get(name, 0.0) == value for values in _values(objective, x)
               for name, value in effect.change(values, *nothing).items()):
            return here
        return _with_effect(objective, x, effect, nothing).residuals(x)

    share, frequency = max(((explain(columns)[0], frequency) for frequency, columns
                            in _resonances(objective, x)), default=(0.0, 0.0))
    found = [Suspect(
        f'a resonance at {frequency:.3g} Hz, which no mode of the model has', share,
        'look for what vibrates beside the arm, and try other first guesses', 0.0)]
    tried: list[Any] = []
    for effect in _effects(objective, x):
        of_trials = []
        for sizes in map(np.array, effect.trials):
            runs = [without(effect, sizes), *(_with_effect(objective, x, effect, each).residuals(x)
                                              for each in np.diag(sizes))]
            if all(np.all(np.abs(run) < DIVERGED) for run in runs):
                share, factors = explain([run - runs[0] for run in runs[1:]], effect.low)
                of_trials.append((share, effect, np.append(
                    np.maximum(factors, effect.low) * sizes, effect.shape)))
        tried += sorted(of_trials, key=lambda each: -each[0])[:1]
    tried.sort(key=lambda each: -each[0])
    for rank, (share, effect, sizes) in enumerate(tried):
        # What is all or nothing has no first order. Tilted planes explain a little of anything.
        worth = (rank < most or effect.bends) and effect.free[:1] != _TILTED[:1] if most else (
            share > _WORTHWHILE * max(tried[0][0], found[0].share) or effect.low == 1.0)
        suspect = Suspect(effect.name, share, '', free=effect.free)
        if worth:
            error = error or predict(objective, x)[0]
            with_it, sizes = predict(objective, x, effect, sizes)
            suspect = suspect._replace(
                share=max(0.0, 1.0 - (with_it / error)**2), ratio=with_it / error,
                change=partial(_change, effect.change, sizes))
        found.append(suspect._replace(advice=effect.advice.format(sizes[0])))
    return sorted((each for each in found if each.share), key=lambda each: -each.share)


def _change(change, sizes, values):
    return change(values, *sizes)


def predict(objective: Objective, x: np.ndarray, effect: _Effect | None = None,
            sizes: Any = ()) -> tuple[float, np.ndarray]:
    """
    Return the error of the last third of the records, and sizes, of a fit to the rest, near x.

    It is the geometric mean of rms errors of outputs, each over its spread.
    """
    part, terms = copy(objective), []
    part.ends = [_INNER * end for end in objective.ends]
    x, fitted = _fit(part, x, effect, sizes)
    whole = _with_effect(objective, x, effect, fitted) if effect else objective
    for (k, name, measured), rows in zip(objective.series(), whole.split(whole.residuals(x))):
        late = objective.problems[k].record.outputs[name].t[:len(rows)] > part.ends[k]
        size = (objective.deviations[k][name] / (np.std(measured) or 1.0))**2
        terms.append(np.log(np.mean(rows[late]**2) * size + _FINE**2))
    return float(np.exp(0.5 * np.mean(terms))), fitted


def _fit(objective, x, effect, sizes):
    """Return x and the arguments of an effect, or of none, of a fit with it."""
    count, first = len(x), np.asarray(sizes)
    start = np.ones(len(first) * (effect is not None and effect.low < 1.0))  # their factors

    @lru_cache(maxsize=1)
    def changed(*factors):
        return objective if effect is None else _with_effect(
            objective, x, effect, np.array(factors) * first if factors else first)

    def residuals(z):
        return changed(*z[count:]).residuals(z[:count])

    def jacobian(z):
        by_x = changed(*z[count:]).jacobian(z[:count], _STEP, False)
        return np.hstack([by_x, differences(lambda shifts: np.array([
            residuals(np.append(z[:count], z[count:] + shift)) for shift in shifts]),
            _STEP * start, 1).slope])

    low = np.zeros(len(start))
    low[:len(start) - len(effect.shape if effect else ())] = effect.low if effect else 0.0
    z = least_squares(
        residuals, np.append(x, start), jacobian,
        (np.append(objective.low, low), np.append(objective.high, np.inf * start)),
        x_scale='jac', loss=objective.loss, ftol=_TOLERANCE, max_nfev=_MAX_RUNS).x
    return z[:count], z[count:] * first if len(start) else first


def name_suspects(found: list[Suspect]) -> Iterator[str]:
    """Yield a text that names the likely Suspects, which predict better, if there are any."""
    better = [each for each in found if each.ratio < BETTER and each.share > 1.0 - BETTER**2]
    likely = [each for each in better if 1.0 - each.share <= _ALIKE * (1.0 - better[0].share)]
    if likely:
        yield 'the residuals look like ' + ', or '.join(
            f'{each.name} ({100.0 * each.share:.0f} % of their squares: {each.advice})'
            for each in likely)


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
                lambda _, size, name=name: {name: size}, [[part * force] for part in _FRICTION],
                free=[name])
        elif force and rest not in values:
            yield _Effect(
                f'another friction of the {body} near rest', f'set {rest}, and free it',
                lambda own, size, name=rest: {
                    name: own[name] * np.exp(np.clip(size, *_FACTORS)) or size},
                [[1.0]] if own[rest] else [[part * speed] for part in _REST],
                both if own[rest] else 0.0, free=[rest])
        if own[name] and own[rest] and not own[way := f'{body}.coulomb_presliding']:
            yield _Effect(
                name=f'presliding of the {body}, which rests as on a spring',
                advice=f'set {way} to about {{:.2g}} and {body}.coulomb_static to 0.5, and free '
                       'both', change=lambda _, size, part=0.5, name=way: {
                           name: size, name.replace('presliding', 'static'): part} if size else {},
                trials=[[part * own[rest]] for part in _PRESLIDING], low=_LEAST, shape=[0.5],
                free=[way, f'{body}.coulomb_static'], bends=True)
    for name in (name for name in PARAMETERS if name.endswith('.coulomb_asymmetry')):
        if own[name.replace('asymmetry', 'friction')] and not own[name]:
            yield _Effect('friction that depends on the direction',
                          f'set {name}, and free it',
                          lambda _, size, name=name: {name: np.clip(size, -_MOST, _MOST)},
                          [[_ASYMMETRY]], both, free=[name])
    if own['motor.shaft'] == 'free' and not own['motor.gear.backlash']:
        stiff = _STIFF / own['motor.shaft_inertia'] * step**2
        if not own['motor.gear.stiffness']:
            yield _Effect('an elastic gear', 'set motor.gear.stiffness and motor.rotor.inertia, '
                          'and free them', _gear, [[stiff]], shape=[0.1, 1.0], free=_GEAR,
                          bends=True)
        yield _Effect(
            'backlash of the gear', 'set motor.gear.backlash to about {:.2g}',
            lambda own, size: {**({} if own['motor.gear.stiffness'] else _gear(own, stiff)),
                               'motor.gear.backlash': size}, [[play] for play in _BACKLASH],
            free=['motor.gear.backlash', *([] if own['motor.gear.stiffness'] else _GEAR)])
    if not any(own['gravity']):
        yield _Effect('gravity, as of a tilted plane', 'free gravity[0] and gravity[1]',
                      lambda _, x, y: {'gravity[0]': x, 'gravity[1]': y},
                      [[size, size] for size in _GRAVITY], both, free=_TILTED)
    late = {name for name in problem.record.outputs if f'{name}.delay' in values}
    for name, channel in {**problem.record.inputs, **problem.record.outputs}.items():
        # Delays of all outputs are those of the input.
        for kind, advice, trials, low in (
                ('delay', 'a delay of', [[count * step] for count in _DELAYS], 0.0),
                ('lag', 'a lag of', [[count * step] for count in _DELAYS], 0.0),
                ('bias', 'an offset of', [[np.std(channel.values) or 1.0]], both)):
            late_by = f'{name}.{kind}'
            if late_by not in values and name != DRIVE and (
                    kind == 'bias' or late < {*problem.record.outputs}):
                yield _Effect(f'{advice} {name}', f'free {late_by}, about {{:.2g}}',
                              lambda _, size, name=late_by: {name: size}, trials, low,
                              free=[late_by])
    if 'initial.modal_coordinates[0]' not in values and own['model.modes']:
        first = initial_scale('initial.modal_coordinates[0]', problem.scene)
        yield _Effect(
            'an arm that moves at the beginning', 'free initial.modal_coordinates[0] and '
            'initial.modal_rates[0]', lambda _, *both: dict(zip(_MOVING, both)),
            [[first, initial_scale('initial.modal_rates[0]', problem.scene)]], both, free=_MOVING)
    if own['motor.shaft'] == 'free' and 'initial.shaft' not in values:
        yield _Effect('another angle of the shaft at the beginning',
                      f'free initial.shaft, about {own["initial.shaft"]:.2g} + {{:.2g}} rad',
                      lambda own, size: {'initial.shaft': own['initial.shaft'] + size},
                      [[0.1]], both, free=['initial.shaft'])
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
