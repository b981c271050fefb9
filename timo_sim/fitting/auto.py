# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Which effects a scene shall have: the first suspects are tried, and that which predicts best."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, NamedTuple

import numpy as np

from timo_sim.fitting.look import GAUGES
from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import Free, split_guess, TimeIsUp, vary
from timo_sim.fitting.record import DRIVE, Record
from timo_sim.fitting.search import INTERRUPTED, Search
from timo_sim.fitting.suspects import BETTER, MOVING, predict, Suspect, suspects
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.numbers import overrides_of
from timo_sim.scene.parameters import ParameterError
from timo_sim.scene.scene import Scene

_SUSPECTS = 6  # that are tried at a time
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
    return scene.vary(changes), free


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


def choose(scene: Scene, free: list[str], objective_of: Callable[[Scene, list[str]], Objective],
           say: Callable[[str], object], keep: Callable[[Scene, str], object],
           deadline: float, starts: int | None = None) -> Choice:
    """
    Return the Choice of effects with which the end of what is fitted is predicted best.

    If the fit with an effect is not a tenth better, as its trial was, the next best is tried.
    `keep` is called with each scene that is the best so far, and the values found.
    """
    best, line, waiting = Choice(scene, free, {}, []), '', list[Suspect]()
    search, sure, least = Search(objective_of(scene, free)), best, math.inf
    try:
        while True:
            objective = objective_of(best.scene, best.free)
            objective.weigh_as(best.weighs)
            search = Search(objective, first=best.values)
            search.set_deadline(deadline)
            x = search.settle(starts, anew=not line)
            predicted = predict(objective, x)
            error = math.exp(np.mean(predicted.errors))
            line = f'{line or "the plain arm"}: {error:.2%}'
            say(f'error of the end of what is fitted, which was held out, {line}')
            if error < BETTER * least:  # than without it, however good its trial was
                values = {free.name: free.value(at) for free, at in zip(objective.free, x)}
                sure, least = Choice(  # if a fit with an effect is not possible
                    objective.problems[0].scene_of(objective.values(x, 0)),
                    [*{each.name: each.text for problem in objective.problems
                       for each in problem.free}.values()], values, [*best.ladder, line],
                    objective), error
                best = sure
                keep(sure.scene, str(values))
                own = {**sure.scene.values, **values}
                found = [each for each in suspects(  # an effect may vanish as it is fitted
                    objective, x, _SUSPECTS, predicted)
                    if each.ratio < math.inf and each.effect.changes(own, *each.sizes)]
                tried = [f'    with {each.name}: {each.ratio * error:.2%}' for each in found]
                say('\n'.join(['tried', *tried]))
                sure = sure._replace(ladder=[*sure.ladder, *tried])
                # What is further off than the mean predicts nothing, however much better it is.
                waiting = sorted((each for each in found if each.ratio < min(BETTER, 1.0 / error)),
                                 key=lambda each: -each.ratio)
            else:
                sure = sure._replace(ladder=[*sure.ladder, f'    {line}'])
            best = sure
            if not waiting:
                return sure
            line = waiting[-1].name
            best = _with(waiting.pop(), sure)
    except KeyboardInterrupt as stop:
        reason = str(stop) or INTERRUPTED
        if best is not sure:  # it was better where it was tried
            best.ladder.append(f'{line}: taken as it was tried')
        best = best._replace(values=best.values or search.best,
                             interrupted=not isinstance(stop, TimeIsUp))
    except (ArithmeticError, ParameterError) as error:
        best, reason = sure, str(error)
    what = 'no more effects were' if best.ladder else 'no effect was'
    say(line := f'{what} tried: {reason}')
    return best._replace(ladder=[*best.ladder, line])
