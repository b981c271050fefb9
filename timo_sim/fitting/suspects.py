# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Which effect, missing in the scene, the residuals of a fit look like.

A run of the fitted scene with some of an effect, less that without, is the direction in which the
effect moves the residuals. What free parameters would do as well is taken out; the share of the
squares along the rest is what the effect would explain, to first order. Effects whose share is
close to the largest are then fitted with what is free to the first two thirds of the motion: their
share is that by which the squares of the rest, which they predict, are less than without them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
import math
import time
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from timo_sim.fitting.objective import DIVERGED, Objective, times_of_motion
from timo_sim.fitting.problem import free_parameters, kinds_of, Problem, spread_of, TimeIsUp
from timo_sim.fitting.record import DRIVE
from timo_sim.model.layout import INPUTS
from timo_sim.scene.numbers import INITIAL, initial_scale
from timo_sim.scene.parameters import ParameterError, PARAMETERS
from timo_sim.topics.commands import JOINTS

_FRICTION = 0.01, 0.1, 1.0  # sizes that are tried, of the force that accelerates the free body
_ASYMMETRY, _MOST = 0.2, 0.99
_PRESLIDING, _LEAST = (0.005, 0.05), 0.1  # ways, of the spread of a motion, and their least factor
_HOLDS = 0.3  # `coulomb_static` that is tried: from more, fits end where the joint hardly rests
_BACKLASH = 0.003, 0.01, 0.03  # [rad]
_GRAVITY = 0.5, 5.0  # [m/s2]
_DELAYS = 1, 5  # steps
_EXCESS = 0.1, 0.4, 1.0  # of the largest value of an input over its limit, relative to this
_REST = 0.02, 0.1, 0.5  # speeds over which friction builds up, of that of the body
_FACTORS = -5.0, 5.0  # logarithms of factors of such a speed, to which they are tried
_STIFF = 5.0  # compliance of a gear that is tried, in step**2 / inertia of the shaft
_INNER = 2.0 / 3.0  # part of what is fitted to which suspects are fitted; the rest judges them
BETTER = 0.9  # ratio of errors there, below which a suspect predicts better
_FINE = 1e-3  # error, of the spread of an output, below which others count for more
_WORTHWHILE, _BENT = 0.5, 0.2  # share, of the largest, above which effects are fitted
_STEP, _TOLERANCE, _MAX_RUNS = 1e-3, 1e-3, 25  # of differences and fits, see `least_squares`
_STAGES, _WORTH_ANOTHER = 3, 0.95  # of fits for a choice; ratio of squares after one and before it
_STRETCHED, _CLAMP, _DEAD = (0.1, 1.0), (0.1, 0.5), (0.02, 0.1)  # of usual sizes
_HELD, _HELD_MOST, _HELD_FITS = 0.01, math.log(3.0), 4  # logarithms of factors; fits
_NEARLY, _LITTLE = 3.0, 0.1  # what a held value leaves, to first order, up to which it is fitted
_GEAR = 'motor.rotor.inertia', 'motor.gear.stiffness', 'motor.gear.damping'
MOVING = 'initial.modal_coordinates[0]', 'initial.modal_rates[0]'
TILTED = 'gravity[0]', 'gravity[1]'
SPRING = 'motor.spring.stiffness', 'motor.spring.rest'
_TO_A_SIDE, _WAYS = ('.coulomb_asymmetry', '.bias', '.spring.stiffness', 'gravity[0]'), 50
_ALIKE = 1.5  # ratio of what suspects leave to what the first leaves, up to which they are named


class _Effect(NamedTuple):
    """
    An effect to try; `change(values, *sizes, *shape)` returns what differs in the scene.

    By default sizes and shape are the values of what is `free`.
    """

    name: str
    free: Sequence[str]     # what a fit with it has besides
    trials: Sequence[Sequence[float]]   # sizes that are tried; each of them alone moves a run
    low: float = 0.0    # least factor of sizes: 0, -inf for both signs, 1 for all or nothing
    change: Callable[..., dict[str, Any]] | None = None
    shape: Sequence[float] = ()     # further arguments, which are fitted with the sizes
    bends: bool = False             # whether its first order tells little
    width: float = math.inf         # of a value that is held, see `Free`

    def changes(self, values: Mapping[str, Any], *sizes: float) -> dict[str, Any]:
        """Return what differs in a scene with these values."""
        return self.change(values, *sizes) if self.change else dict(zip(self.free, sizes))

    def advice(self, own: Mapping[str, Any], sizes: Sequence[float]) -> str:
        """Return what to give to a fit of a scene with values of its `own`."""
        new = {name: f'{name}={value:.2g}' for name, value in self.changes(own, *sizes).items()
               if value != own.get(name)}
        fixed = [text for name, text in new.items()
                 if name not in self.free or own.get(name) == math.inf]
        return ' and '.join([f'set {" ".join(fixed)}'] * bool(fixed) + [
            'free ' + ','.join(new.get(name, name) for name in self.free)] * bool(self.free))


class Suspect(NamedTuple):
    """An effect that a scene may lack."""

    name: str
    share: float   # of the squares of the residuals that it explains, or predicts if it was fitted
    advice: str
    ratio: float = math.inf  # of errors with it and without, see `predict`, if it was fitted
    effect: Any = None           # the _Effect; a Fit has it not
    sizes: Sequence[float] = ()  # of that
    x: Any = None                # where a fit with it to the first two thirds ended, if there was


def suspects(objective: Objective, x: np.ndarray, most: int = 0,
             plain: Any = None, until: float = math.inf) -> list[Suspect]:
    """
    Return the Suspects of a fit that has ended at x, that of the largest share first.

    The likely ones, or as many as `most`, are fitted; `plain` is what `predict` finds without
    them, if it is known. After `until`, a time of `time.monotonic`, no more are, if one is better.
    """
    problem = objective.problems[0]
    if np.any(np.abs(here := objective.residuals(x)) >= DIVERGED):
        return []
    root = objective.weights(here)
    free, _ = np.linalg.qr(root[:, np.newaxis] * objective.jacobian(x, _STEP, False))
    left = root * here - free @ (free.T @ (root * here))
    found, tried = list[Suspect](), list[Any]()
    sided = most and moves_one_way(problem)  # then what pushes to a side looks like others
    for effect in (*_effects(objective, x), *([] if most else _held_values(
            problem, objective.values(x, 0)))):
        of_trials, guesses = [], len(effect.shape) > 0 and len(effect.trials) > 1
        if sided and effect.free and effect.free[0].endswith(_TO_A_SIDE) and (
                effect.free[0].rpartition('.')[0] not in problem.record.outputs):
            continue
        for sizes in np.array(effect.trials):
            having = objective.with_effect(effect.changes, np.append(sizes, effect.shape))
            runs = [having.residuals(np.append(x, [*each, *np.ones(len(effect.shape))]))
                    for each in np.eye(len(sizes))]
            if all(np.all(np.abs(run) < DIVERGED) for run in runs):
                columns = root[:, np.newaxis] * (np.column_stack(runs) - here[:, np.newaxis])
                columns -= free @ (free.T @ columns)
                factors, *_ = np.linalg.lstsq(columns, -left, rcond=1e-9)
                if effect.width < math.inf:
                    factors = np.clip(factors, -_HELD_MOST / sizes, _HELD_MOST / sizes)
                rest, possible = left + columns @ factors, effect.low < 0.0 or factors[0] >= 0.0
                share = float(1.0 - (rest @ rest) / (left @ left)) if possible else 0.0
                of_trials.append((share, effect, np.append(
                    sizes if guesses else np.maximum(factors, effect.low) * sizes, effect.shape)))
        # The first order does not tell the size of what bends and has a shape, as presliding: a
        # fit begins at each of its trials.
        tried += sorted(of_trials, key=lambda each: -each[0])[:None if guesses else 1]
    # A tilted plane explains a little of anything: it is the rival of a spring alone.
    spring = max((each[0] for each in tried if each[1].free == SPRING), default=-math.inf)
    tried.sort(key=lambda each: -(spring if most and each[1].free == TILTED else each[0]))
    own = {**problem.scene.values, **objective.values(x, 0)}
    # Of held values that explain about as much, as a length and a stiffness do, a few are fitted.
    held = [each for each in tried if each[1].width < math.inf]
    near = [each for each in held if 1.0 - each[0] <= max(_LITTLE, _NEARLY * (1.0 - held[0][0]))]
    likely = [each[1] for each in (*held[:_HELD_FITS // 2], *sorted(
        near, key=lambda each: abs(each[2][0]) / each[1].width)[:_HELD_FITS])]
    for rank, (share, effect, sizes) in enumerate(tried):
        # What is all or nothing has no first order.
        worth = (any(each.effect.free == SPRING and each.ratio < BETTER for each in found)
                 if effect.free == TILTED else rank < most or effect.bends) if most else (
            share > (_BENT if effect.bends else _WORTHWHILE) * tried[0][0] or effect.low == 1.0)
        worth &= effect.width == math.inf or effect in likely
        ratio, end = math.inf, None
        if worth:
            better = any(each.ratio < BETTER for each in found)
            if better and time.monotonic() > until:
                break
            try:
                plain = plain or predict(objective, x, stages=1)
                with_it = predict(objective, plain.x if most else x, effect, sizes,
                                  _STAGES if most else 1)
            except TimeIsUp:
                if not most or not better:
                    raise
                break
            rise, sizes, end = with_it.errors - plain.errors, with_it.sizes, with_it.x
            # What betters some at the cost of another betters nothing.
            ratio = math.exp(np.mean(rise) if max(rise) < -math.log(BETTER) else max(rise))
            share = max(0.0, 1.0 - ratio**2)
        found.append(Suspect(effect.name, share, effect.advice(own, sizes), ratio=ratio,
                             effect=effect, sizes=sizes, x=end))
    best = {each.name: each for each in sorted(
        found, key=lambda each: (-each.ratio, each.share)) if each.share}
    return sorted(best.values(), key=lambda each: -each.share)


def moves_one_way(problem):
    """Return whether what is fitted goes back by less than a quarter of all its ways."""
    t = np.linspace(0.0, problem.until, _WAYS)
    ways = [np.diff(np.interp(t, each.t, each.values))
            for name, each in problem.record.outputs.items() if name in JOINTS]
    return any(abs(each.sum()) > 0.5 * np.abs(each).sum() for each in ways)


class Predicted(NamedTuple):
    """A third of what is fitted, by a fit to the rest."""

    errors: np.ndarray  # logarithms of the rms errors of outputs, each over its spread
    x: np.ndarray       # where that fit ended, (p,)
    sizes: Any          # of its effect


def predict(objective: Objective, x: np.ndarray, effect: _Effect | None = None, sizes: Any = (),
            stages: int = _STAGES, first: bool = False) -> Predicted:
    """
    Return what is Predicted of the last or `first` third of the motion by a fit to the rest.

    It begins at x, and ends with the first of some `stages`, but for the first, that lowers
    squares by < 5 %. The first third begins as it did at x, which the rest does not show.
    """
    whole, varied = objective, []
    if effect:
        low = np.where(np.arange(len(sizes)) < len(effect.trials[0]), effect.low, 0.0)
        varied = [] if effect.low == 1.0 else sizes
        whole = objective.with_effect(lambda own, *some: effect.changes(
            own, *(some or sizes)), varied, low[:len(varied)])
    times = [float(np.mean(times_of_motion(each, 1.0 - _INNER if first else _INNER)))
             for each in objective.problems]
    late = np.concatenate([objective.problems[k].record.outputs[name].t[:len(measured)] > times[k]
                           for k, name, measured in objective.series()])
    part, x, cost = copy(whole), np.append(x, np.ones(len(varied))), math.inf
    guesses = np.ones(np.isfinite(part.widths).sum(), bool)
    fitted = np.append(late, guesses) if first else slice(None)
    part.ends = part.ends if first else times
    varies = [not (first and each.name.startswith(INITIAL)) for each in objective.free]
    varies += [True] * len(varied)
    for _ in range(stages):
        end = least_squares(
            lambda x: part.residuals(x)[fitted], part.within(x),
            lambda x: part.jacobian(x, _STEP, False)[fitted] * varies, (part.low, part.high),
            x_scale='jac', loss=part.loss, ftol=_TOLERANCE, max_nfev=_MAX_RUNS // stages)
        x, cost, before = end.x, end.cost, cost
        if cost > _WORTH_ANOTHER * before:
            break
    errors = errors_of(whole, x, ~late if first else late)
    x, factors = np.split(x, [len(objective.free)])
    return Predicted(errors, x, factors * varied if len(varied) else sizes)


def errors_of(objective: Objective, x: np.ndarray, which: Any = None) -> np.ndarray:
    """Return logarithms of rms errors of outputs, over their spreads, in some rows or all."""
    rows = objective.residuals(x)
    counts = objective.split(np.ones(len(rows), bool) if which is None else which)
    return np.array([0.5 * np.log(r[own] @ r[own] / max(1, np.sum(own)) * (
        objective.deviations[k][name] / (spread_of(measured) or 1.0))**2 + _FINE**2)
        for (k, name, measured), r, own in zip(objective.series(), objective.split(rows), counts)])


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
    for body, force, speed, spread in (
            ('carrier', forces[:2].max(), speeds[:2].max(), run.carrier.std(axis=0).max()),
            ('motor', forces[2], speeds[2], run.shaft.std())):
        name, rest = f'{body}.coulomb_friction', f'{body}.coulomb_speed'
        if force and not own[name]:
            yield _Effect(f'dry friction of the {body}', [name],
                          [[part * force] for part in _FRICTION])
        elif force and rest not in values:
            yield _Effect(
                f'another friction of the {body} near rest', [rest],
                [[1.0]] if own[rest] else [[part * speed] for part in _REST],
                both if own[rest] else 0.0, lambda own, size, name=rest: {
                    name: own[name] * np.exp(np.clip(size, *_FACTORS)) or size})
        if own[name] and own[rest] and not own[way := f'{body}.coulomb_presliding']:
            yield _Effect(
                f'presliding of the {body}, which rests as on a spring',
                [way, f'{body}.coulomb_static'], [[part * spread] for part in _PRESLIDING],
                _LEAST, shape=[_HOLDS], bends=True)
    for name in (name for name in PARAMETERS if name.endswith('.coulomb_asymmetry')):
        if own[name.replace('asymmetry', 'friction')] and not own[name]:
            yield _Effect(
                'friction that depends on the direction', [name], [[_ASYMMETRY]], both,
                lambda _, size, name=name: {name: np.clip(size, -_MOST, _MOST)})
    if own['motor.shaft'] == 'free' and not own['motor.gear.backlash']:
        stiff = _STIFF / own['motor.shaft_inertia'] * step**2
        if not own['motor.gear.stiffness']:
            yield _Effect('an elastic gear', _GEAR, [[stiff]], change=_gear, shape=[0.1, 1.0],
                          bends=True)
        yield _Effect(
            'backlash of the gear',
            ['motor.gear.backlash', *([] if own['motor.gear.stiffness'] else _GEAR)],
            [[play] for play in _BACKLASH],
            change=lambda own, size: {**({} if own['motor.gear.stiffness'] else _gear(own, stiff)),
                                      'motor.gear.backlash': size})
    if forces[2] and not own['motor.spring.stiffness']:
        yield _Effect(
            'a spring on the shaft, as of a cable', SPRING,
            [[part * float(forces[2] / run.shaft.std())] for part in _STRETCHED],
            change=lambda own, size: dict(zip(SPRING, (size, own['initial.shaft']))))
    # With one mode it is no other than a softer arm.
    if own['arm.root_stiffness'] == math.inf and own['model.modes'] > 1:
        arm = run.model.manipulator.arm
        yield _Effect(
            'a clamp that gives', ['arm.root_stiffness'],
            [[part * arm.length / float(np.mean(arm.section.bending_stiffness))]
             for part in _CLAMP],
            _LEAST, lambda _, size: {'arm.root_stiffness': 1.0 / size}, bends=True)
    if not any(own['gravity']):
        yield _Effect('gravity, as of a tilted plane', TILTED,
                      [[size, size] for size in _GRAVITY], both)
    channels = {**problem.record.inputs, **problem.record.outputs}
    early = {each for each in channels if each != DRIVE and f'{each}.delay' not in values}
    for name, channel in channels.items():
        steps, size = [[count * step] for count in _DELAYS], np.abs(channel.values).max()
        for kind, text, trials, low in (
                ('delay', 'a delay of', steps, 0.0), ('lag', 'a lag of', steps, 0.0),
                ('bias', 'an offset of', [[spread_of(channel.values) or 1.0]], both),
                ('dead_zone', 'a dead zone of', [[part * size] for part in _DEAD], 0.0)):
            # One of all is the clock of the others.
            if f'{name}.{kind}' not in values and kind in kinds_of(problem.record, name) and (
                    name != DRIVE) and (kind in ('bias', 'dead_zone') or early != {name}):
                yield _Effect(f'{text} {name}', [f'{name}.{kind}'], trials, low)
    if 'initial.modal_coordinates[0]' not in values and own['model.modes']:
        yield _Effect('an arm that moves at the beginning', MOVING,
                      [[initial_scale(name, problem.scene) for name in MOVING]], both)
    for each in INPUTS:
        if each.name in problem.record.inputs and each.limit and not np.isfinite(own[each.limit]):
            most = values.get(f'{each.name}.gain', 1.0) * np.abs(channels[each.name].values).max()
            yield _Effect(
                f'a limit of the {each.name}', [], [[cut] for cut in _EXCESS],
                change=lambda _, cut, name=each.limit, most=most: {name: most / (1.0 + cut)})
    yield _Effect('one more mode', [], [[1.0]], 1.0,
                  lambda own, on: {'model.modes': own['model.modes'] + bool(on)})


def _held_values(problem: Problem, values: Mapping[str, float]) -> Iterator[_Effect]:
    """Yield another value for each that is not free, and of which a fit would know a width."""
    free = {name.partition('[')[0] for name in values}
    channels = [*problem.record.inputs, *problem.record.outputs]
    numbers = [name for name in problem.scene.values if not name.startswith(INITIAL)]
    for name in (*numbers, *(f'{each}.gain' for each in channels)):
        try:
            each, = free_parameters([name], {}, problem.scene, problem.record)
        except ParameterError:  # no number, or 0, which an effect would be
            continue
        if name not in free and each.log and not name.endswith('coulomb_speed'):
            yield _Effect(
                f'another value of {name} than {each.start:.4g} {each.unit}'.strip(), [name],
                [[_HELD]], -np.inf, lambda _, size, name=name, start=each.start: {
                    name: start * np.exp(np.clip(size, *_FACTORS))}, width=each.width)


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
