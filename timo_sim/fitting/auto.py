# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Which effects a scene shall have: the first suspects are tried, and that which predicts best."""

from __future__ import annotations

from collections.abc import Callable
import math
import time
from typing import Any, NamedTuple

import numpy as np

from timo_sim.fitting.look import GAUGES
from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import Free, split_guess, TimeIsUp, vary
from timo_sim.fitting.record import DRIVE, Record
from timo_sim.fitting.search import INTERRUPTED, Search
from timo_sim.fitting.suspects import (
    BETTER, errors_of, MOVING, predict, SPRING, Suspect, suspects, TILTED)
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.numbers import overrides_of
from timo_sim.scene.parameters import StepError
from timo_sim.scene.scene import Scene

_SUSPECTS = 6  # that are tried at a time
_GAIN = -math.log(BETTER)  # of an error that is better, in logarithms
# Most parts of the time that is left: for the plain arm, for a fit with an effect, which is judged
# after that, and for trials of further ones if one of them is better.
_PLAIN, _FIT, _TRIALS = 1.0 / 3.0, 0.6, 0.5
_DELAY = 0.05  # [s] width of delays: of drives, buses and filters
_DRY, _NEAR_REST = 0.05, 0.05  # friction and its speed, of the largest torque and a usual speed
_BODIES = {'motor': ('shaft', 'torque', 'voltage'), 'carrier': ('carrier_x', 'force_x', '')}


class Choice(NamedTuple):
    """
    A scene, what is free in it as texts for `fit`, values by name, and how it was found.

    `weighs` is the Objective of that, with the deviations of outputs that it has found.
    """

    scene: Scene
    free: list[str]
    values: dict[str, float]
    ladder: list[str]
    weighs: Objective | None = None
    interrupted: bool = False


def plain(scene: Scene, record: Record) -> tuple[Scene, list[str]]:
    """Return a scene and what is free of it at first: arm, drive, gains, and the first angle."""
    values, changes = scene.values, dict[str, Any]()
    stiff = 'arm.section.bending_stiffness'
    free = [stiff if values[stiff] else 'arm.young_modulus', 'arm.damping_ratio[0]',
            *(f'{name}.gain' for name in record.inputs if name != DRIVE)]
    if not any(values['arm.damping_ratio']):
        changes['arm.damping_ratio'] = (0.01,)
    for body, (joint, *inputs) in _BODIES.items():
        drives = [np.abs(record.inputs[name].values).max() * (
            motor_constants(values)[0] if name == 'voltage' else 1.0)
            for name in inputs if name in record.inputs]
        if joint not in record.outputs or not drives:
            continue
        shown = record.outputs[joint]
        t = np.linspace(0.0, record.duration, 200)
        speed = float(np.std(np.gradient(np.interp(t, shown.t, shown.values), t))) or 1.0
        usual = {'viscous_friction': _DRY * max(drives) / speed,
                 'coulomb_friction': _DRY * max(drives), 'coulomb_speed': _NEAR_REST * speed}
        changes |= {f'{body}.{kind}': float(value) for kind, value in usual.items()
                    if not values[f'{body}.{kind}']}
        free += [f'{body}.{kind}' for kind in usual]
        if body == 'motor':
            free += ['motor.shaft_inertia', 'initial.shaft', *(
                ['motor.dc.torque_constant~20%'] if 'voltage' in record.inputs else [])]
    seen = [name for name in record.outputs if name in GAUGES]
    free += [f'{name}.{kind}' for name in seen for kind in ('gain', 'bias')]
    # Every rig has delays. They bend no run, and without them all else stands for them.
    late = [name for name in record.inputs if name != DRIVE]
    alone = bool(late) and len(seen) == len(record.outputs)  # one delay is that of the input
    free += [f'{name}.delay~{_DELAY}' for name in late + seen[alone:]]
    free += [*MOVING] if values['model.modes'] else []
    try:
        return scene.vary(changes), free
    except StepError as error:  # friction that is added builds up as fast as the steps allow
        slower = {name: scene.step / error.longest * value for name, value in changes.items()
                  if name.endswith('coulomb_speed')}
        return scene.vary({**changes, **slower}), free


def _with(suspect, choice):
    """Return a Choice with one more effect, from the values of its trial."""
    own, names = choice.scene.values, [split_guess(each)[0] for each in choice.free]
    values = dict(zip(choice.values, map(Free.value, choice.weighs.free, suspect.x)))
    changes: dict[str, Any] = suspect.effect.changes({**own, **values}, *suspect.sizes)
    moved = 'motor.rotor.inertia' in changes
    return choice._replace(
        values={**values, **changes},
        scene=vary(choice.scene, overrides_of({
            name: value for name, value in changes.items() if name.partition('[')[0] in own},
            choice.scene)),
        free=[name.replace('motor.', 'motor.rotor.')
              if moved and name.startswith('motor.coulomb_') else each
              for name, each in zip(names, choice.free)] + [
                  name for name in suspect.effect.free if name not in names])


def choose(scene: Scene, free: list[str], objective_of: Callable[..., Objective],
           say: Callable[[str], object], keep: Callable[[Scene, str], object],
           deadline: float, starts: int | None = None) -> Choice:
    """
    Return the Choice of effects with which the ends of what is fitted are predicted best.

    If the fit with an effect is not a tenth better, as its trial was, the next best is tried.
    `keep` is called with each scene that is the best so far, and the values found. Each fit has a
    part of the time until the `deadline`, so that what was tried is fitted before it is kept.
    """
    def until(part):
        return (now := time.monotonic()) + part * (deadline - now)

    def search_of(choice):
        return Search(objective_of(choice.scene, choice.free, choice.weighs),
                      first=choice.values, secants=0)

    def settled(search, part, anew=False):
        x = search.settle(starts, anew, until(part))
        return x, float(np.mean(errors_of(search.objective, x)))

    def kept(choice, objective, x, line):
        return Choice(
            objective.problems[0].scene_of(objective.values(x, 0)),
            [*{each.name: each.text for problem in objective.problems
               for each in problem.free}.values()],
            {free.name: free.value(at) for free, at in zip(objective.free, x)},
            [*choice.ladder, line], objective)

    sure, waiting = Choice(scene, free, {}, []), list[Suspect]()
    least, most, hope = np.array(math.inf), math.inf, None  # logarithms of errors
    tried: Suspect | None = None
    try:
        while True:
            best = _with(tried, sure) if tried else sure
            search = search_of(best)
            x, in_all = settled(search, _FIT if tried else _PLAIN, not tried)
            plane = next((each for each in waiting if each.effect.free == TILTED), None)
            if plane and tried and tried.effect.free == SPRING:
                # Where the record is not, a plane's torque is bounded, and a spring's is not.
                rival = search_of(_with(plane, sure))
                end, error = settled(rival, _FIT)
                if error < in_all + _GAIN:
                    sure.ladder.append(f'    {tried.name}: hardly better in all than {plane.name}')
                    best, search, x, in_all = _with(plane, sure), rival, end, error
                    waiting[waiting.index(plane)], tried = tried, plane
            name, objective = tried.name if tried else 'the plain arm', search.objective
            hope = kept(best, objective, x, f'{name}: better where it was tried, and in all')
            search.set_deadline(deadline)
            predicted = [predict(objective, x, first=each) for each in (False, True)]
            errors, hope = np.array([each.errors for each in predicted]), None
            ends = np.exp(errors.mean(axis=1))
            line = f'{name}: {ends[0]:.2%} and {ends[1]:.2%}' + bool(search.stopped) * (
                ', at the best so far of its search, whose part of the time was up')
            say(f'error of the last and the first third, each predicted by the rest, {line}')
            last, first = (least - errors).mean(axis=1)  # gains, however good its trial was
            if max(last, 0.5 * (last + first)) > _GAIN and min(last, first) > -_GAIN:
                sure, least, most = kept(best, objective, x, line), errors, in_all
                keep(sure.scene, str(sure.values))
                own = {**sure.scene.values, **sure.values}
                found = [each for each in suspects(  # an effect may vanish as it is fitted
                    objective, x, _SUSPECTS, predicted[0], until(_TRIALS))
                    if each.ratio < math.inf and each.effect.changes(own, *each.sizes)]
                lines = [f'    with {each.name}: {each.ratio * ends[0]:.2%}' for each in found]
                say('\n'.join(['tried', *lines]))
                sure.ladder.extend(lines)
                # What is further off than the mean predicts nothing, however much better it is.
                waiting = [each for each in found[::-1] if each.ratio < min(BETTER, 1.0 / ends[0])]
            else:
                sure.ladder.append(f'    {line}')
            if not waiting:
                return sure
            tried = waiting.pop()
    except KeyboardInterrupt as stop:
        reason = str(stop) or INTERRUPTED
        if not sure.values:
            sure = sure._replace(values=search.best)
        elif hope and isinstance(stop, TimeIsUp):  # two fits of three say what is better
            sure = hope if in_all < most - _GAIN else sure._replace(
                ladder=[*sure.ladder, f'    {name}: not better in all'])
        sure = sure._replace(interrupted=not isinstance(stop, TimeIsUp))
    except (ArithmeticError, ValueError) as error:  # of parameters, or of linear algebra
        reason = str(error)
    say(line := f'no {"more effects were" if sure.ladder else "effect was"} tried: {reason}')
    return sure._replace(ladder=[*sure.ladder, line])
