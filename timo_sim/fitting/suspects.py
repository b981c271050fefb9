# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Which effect, missing in the scene, the residuals of a fit look like.

A run of the fitted scene with some of an effect, less that without, is the direction in which the
effect moves the residuals. What a change of the free parameters would do as well is taken out; the
share of the squares of the residuals along the rest is what the effect would explain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import bilinear, lfilter

from timo_sim.fitting.problem import DIVERGED, is_within, limit_inputs, WHITE, whiteness
from timo_sim.fitting.search import Search
from timo_sim.model.layout import INPUTS
from timo_sim.runs.modes import modes
from timo_sim.scene.parameters import ParameterError, PARAMETERS

_FRICTION = 0.01, 0.1, 1.0  # sizes that are tried, of the force that accelerates the free body
_ASYMMETRY = 0.2
_BACKLASH = 0.003, 0.01, 0.03  # [rad]
_GRAVITY = 0.5, 5.0  # [m/s2]
_DELAYS = 1, 5  # steps
_LIMITS = 0.9, 0.7, 0.5  # of the largest value of an input
_STIFF = 0.9  # phase in a step of the vibration of a gear that is tried
_BESIDE = 0.1  # relative distance of a resonance from the modes of the model
_RESONANCES, _DAMPING = 60, 0.02  # how many frequencies are tried, and their damping ratio
_ANTICORRELATED = -0.5  # correlation with the first guess below which a sign may be wrong
_MIN_SHARE = 0.2  # share from which on a suspect is named
_MIN_SHARE_WHITE = 0.02  # the same, if what is left would be white
_ALIKE = 0.6  # share, relative to the first, from which on another suspect is named, too


class Suspect(NamedTuple):
    """An effect that a scene may lack."""

    name: str
    share: float   # of the squares of the residuals that it would explain
    white: bool    # whether the rest of the residuals would be white
    advice: str


def suspects(search: Search, jacobian: np.ndarray, residuals: np.ndarray) -> list[Suspect]:
    """
    Return the Suspects of a fit, that of the largest share first.

    `jacobian`, (n, p), and `residuals`, (n,), are those of `Search.derivatives`.
    """
    if np.any(np.abs(here := search.residuals(search.x)) >= DIVERGED):
        return []
    (free, _), root = np.linalg.qr(jacobian), search.weights(here)
    left = residuals - free @ (free.T @ residuals)
    edges = np.cumsum([len(measured) for *_, measured in search.series()])

    def explain(columns, positive):
        """Return share, whether the rest is white, and the factor of the first column."""
        columns = root[:, np.newaxis] * np.column_stack(columns)
        columns -= free @ (free.T @ columns)
        factors, *_ = np.linalg.lstsq(columns, -left, rcond=1e-9)
        if positive and factors[0] < 0.0:
            return 0.0, False, 0.0
        rest = left + columns @ factors
        white = all(whiteness(each) >= WHITE for each in np.split(rest, edges)[:-1])
        return float(1.0 - (rest @ rest) / (left @ left)), white, float(factors[0])

    found = [*_signs(search)]
    for name, advice, positive, trials in _effects(search):
        best = 0.0, False, 0.0
        for size, base, changes in trials:
            runs = [_residuals(search, {**base, **each}) for each in ({}, *changes)]
            if all(run is not None for run in runs):
                share, white, factor = explain([run - runs[0] for run in runs[1:]], positive)
                best = max(best, (share, white, factor * size))
        found.append(Suspect(name, *best[:2], advice.format(best[2])))
    best = max(((*explain(columns, False)[:2], frequency) for frequency, columns
                in _resonances(search, len(left))), default=(0.0, False, 0.0))
    found.append(Suspect(f'a resonance at {best[2]:.3g} Hz, which no mode of the model has',
                         *best[:2], 'look for what vibrates beside the arm'))
    return sorted((each for each in found if each.share), key=lambda each: -each.share)


def name_suspects(found: list[Suspect]) -> Iterator[str]:
    """Yield a text that names the likely ones of some Suspects, if there are any."""
    likely = [each for each in found if each.share > _ALIKE * found[0].share and (
        each.share > _MIN_SHARE or each.white and each.share > _MIN_SHARE_WHITE)]
    if likely:
        yield 'the residuals look like ' + ', or '.join(
            f'{each.name} ({100.0 * each.share:.0f} % of their squares: {each.advice})'
            for each in likely)


def _signs(search):
    """Yield Suspects of wrong signs, by the correlation with the run of the first guess."""
    for problem, against, deviations in zip(search.problems, search.against, search.deviations):
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


def _residuals(search, more):
    """Return the residuals with more values by name, or None if there is no such run."""
    searched, more = search, dict(more)
    limits = {name: more.pop(name) for name in [*more] if name.endswith('_limit')}
    if limits:
        searched = copy(search)
        searched.problems = [copy(problem) for problem in search.problems]
        for problem in searched.problems:
            problem.record = limit_inputs(problem.record, {**problem.scene.values, **limits})
    try:
        for k, problem in enumerate(search.problems):
            problem.scene_of({**search.values(search.x, k), **more})
    except ParameterError:
        return None
    found = searched.residuals(search.x, more)
    return None if np.any(np.abs(found) >= DIVERGED) else found


def _effects(search: Search) -> Iterator[tuple[str, str, bool, list[Any]]]:
    """
    Yield name, advice, whether an effect has one sign only, and trials.

    A trial has the size for a factor of one, values by name of the run to compare with, and a list
    of further values, each of a run with the effect.
    """
    problem, values = search.problems[0], search.values(search.x, 0)
    window, state = problem.windows[0], search.states(search.x)[0]
    run, step = problem.run(values, window.begin, window.end, state), problem.scene.step
    own: Mapping[str, Any] = run.scene.values
    rates = run.values[:, run.values.shape[1] // 2:][:, :3]
    forces = np.diag(run.model.mass_matrix(run.values[0])[0])[:3] * np.sqrt(
        np.mean(np.gradient(rates, step, axis=0)**2, axis=0))
    for body, size in (('carrier', forces[:2].max()), ('motor', forces[2])):
        if size and not own[name := f'{body}.coulomb_friction']:
            yield (f'dry friction of the {body}', f'set {name} to about {{:.2g}}, and free it',
                   True, [(part * size, {}, [{name: part * size}]) for part in _FRICTION])
    for name in (name for name in PARAMETERS if name.endswith('.coulomb_asymmetry')):
        if own[name.replace('asymmetry', 'friction')] and not own[name]:
            yield ('friction that depends on the direction', f'set {name} to about {{:.2g}}, and '
                   'free it', False, [(_ASYMMETRY, {}, [{name: _ASYMMETRY}])])
    if own['motor.shaft'] == 'free' and not own['motor.gear.backlash']:
        gear = {} if own['motor.gear.stiffness'] else _gear(own, step)
        if gear:
            yield ('an elastic gear', 'set motor.gear.stiffness and motor.rotor.inertia, and free '
                   'them', True, [(1.0, {}, [gear])])
        yield ('backlash of the gear', 'set motor.gear.backlash to about {:.2g}', True,
               [(play, gear, [{'motor.gear.backlash': play}]) for play in _BACKLASH])
    if not any(own['gravity']):
        yield ('gravity, as of a tilted plane', 'set gravity', False,
               [(size, {}, [{'gravity[0]': size}, {'gravity[1]': size}]) for size in _GRAVITY])
    for name in (*problem.record.inputs, *problem.record.outputs):
        if f'{name}.delay' not in values:
            yield (f'a delay of {name}', f'free {name}.delay, about {{:.2g}} s', False,
                   [(count * step, {}, [{f'{name}.delay': count * step}]) for count in _DELAYS])
    for each in INPUTS:
        if each.name in problem.record.inputs and each.limit and not np.isfinite(own[each.limit]):
            most = np.abs(problem.record.inputs[each.name].values).max()
            yield (f'a limit of the {each.name}', f'set {each.limit}, below {most:.2g}', True,
                   [(part * most, {}, [{each.limit: part * most}]) for part in _LIMITS])
    yield ('one more mode', f'set model.modes to {own["model.modes"] + 1}', True,
           [(1.0, {}, [{'model.modes': own['model.modes'] + 1}])])


def _gear(own, step):
    """Return a stiff gear that has half of the inertia of the shaft before it."""
    half, turns = 0.5 * own['motor.shaft_inertia'], own['motor.dc.gear_ratio']
    return {'motor.shaft_inertia': half, 'motor.rotor.inertia': half / turns**2,
            'motor.gear.stiffness': 0.5 * half * (_STIFF / step)**2,
            'motor.gear.damping': 0.1 * half * _STIFF / step,
            'motor.coulomb_friction': 0.0, 'motor.coulomb_speed': 0.0,
            'motor.rotor.coulomb_friction': own['motor.coulomb_friction'] / turns,
            'motor.rotor.coulomb_speed': turns * own['motor.coulomb_speed']}


def _resonances(search, size):
    """Yield frequencies beside those of the model, and columns, (size,), of such a resonance."""
    problem = search.problems[0]
    try:
        own = modes(problem.scene_of(search.values(search.x, 0))).frequency
    except ParameterError:  # as where more modes need shorter steps
        return
    highest = 0.2 / problem.record.period
    if not problem.record.inputs or not len(own) or own[0] >= highest:
        return
    step, series = problem.scene.step, search.series()
    for frequency in np.geomspace(own[0], highest, _RESONANCES):
        if np.abs(frequency / own - 1.0).min() < _BESIDE:
            continue
        omega, columns = 2.0 * np.pi * frequency, []
        for which in ([omega**2], [omega, 0.0]):  # its position and its speed
            system = bilinear(which, [1.0, 2.0 * _DAMPING * omega, omega**2], 1.0 / step)
            parts = []
            for k, window in search.windows:
                record, until = search.problems[k].record, search.problems[k].until
                t = step * np.arange(round(record.duration / step) + 1)
                shown = sum(lfilter(*system, np.interp(t, each.t, each.values) - each.values[0])
                            for each in record.inputs.values())
                parts += [np.interp(each.t[is_within(each.t, window.begin, window.end, until)],
                                    t, shown) for each in record.outputs.values()]
            columns += [np.concatenate([
                part * (name == each) for part, (_, each, _) in zip(parts, series)])
                for name in problem.record.outputs]
        yield frequency, [np.pad(column, (0, size - len(column))) for column in columns]
