# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The function `simulate`; the error of its runs, and modes and step for a stated error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
import sys

import numpy as np

from timo_sim.runs.run import Run, run_scene
from timo_sim.scene.parameters import (
    checked, FLAG, Parameter, ParameterError, PARAMETERS, steps_in, warn)
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.scene.static_shapes import MORE_MODES, needed_static
from timo_sim.simulation.finer import choose_parts, distances, refine, tip_distances
from timo_sim.simulation.warnings import (
    DivergenceError, inaccurate, more_axial, MOST_APART, NO_FINER_RUN, unseen_load)

_MOST_RUNS = 5         # whose errors are measured for a choice of modes and step
_HORIZON = 10.0        # their sim time by default [s]
_MAX_STEPS = 200_000   # most steps of one
_MARGIN = 2.0          # least ratio of the stated error to that of the choice
_COMPARED = 200_000    # steps at whose ends tips are compared, if there are more: for memory
_MOST_SAMPLES = 20_000  # of a run whose rate of samples is not given
_SHORTER_STEPS, _MORE_OF_MODES = 'a smaller integrator.step', 'more model.modes'
_BEGUN = 0.1           # share of the distance that a warning needs, at which remedies are judged
_STILL = 1e-13         # travel of a tip that only round-off moves [arm lengths]


def measure_error(run: Run, with_remedy: bool = True) -> Run:
    """
    Return a run of `run_scene` with its measured error, and the warning that this calls for.

    `estimated_tip_error_m` and `estimated_deflection_error_m` are in its `stats`. If a finer run
    diverges or is far off, others with shorter steps are tried; errors are NaN if all diverge.
    With `with_remedy` the warning of a large error names what moves the tip most, by up to four
    more runs, otherwise all remedies. What comes after the first finer run is judged by the part
    of the run until the error is a tenth of that which a warning needs, so that it costs little.
    """
    if len(run.t) < 2:
        return run
    errors, warning = _error(run, with_remedy)
    return replace(run, stats={**run.stats, 'estimated_tip_error_m': errors[0],
                               'estimated_deflection_error_m': errors[1]}, warning=warning)


def _error(run, with_remedy):
    samples, scene = len(run.t) - 1, run.scene
    run = _thin(run, max(k for k in range(1, 1 + max(1, samples // _COMPARED))
                         if samples % k == 0))
    scenes = (refine(scene, parts) for parts in choose_parts(scene))
    fine = next((each for each in (_alike(run, finer) for finer in scenes) if each), None)
    if fine is None:
        return (math.nan, math.nan), run.warning or NO_FINER_RUN
    errors, limit = _apart(run, fine), MOST_APART * scene.manipulator.arm.length
    part = _until_apart(run, fine, _BEGUN * limit) if max(errors) > limit else run
    while errors[0] > limit and (shorter := next(scenes, None)):
        # If shorter steps of the finer run mend most of the distance, it was not that of the run.
        begun = _alike(part, shorter)
        if begun is None or _apart(part, begun)[0] > 0.5 * _apart(part, fine)[0] or (
                found := _alike(run, shorter)) is None:
            break
        fine, errors = found, _apart(run, found)
    # In `exact` the finer run shows already what loads that are too fast for the steps do: its own
    # warning counts. In `newton` both runs may stay on a motion that is unstable in truth.
    earlier = (unseen_load(fine.scene) if scene.values['model.formulation'] == 'exact'
               else run.warning)
    remedy = (_find_remedy(part, round(scene.step / fine.scene.step), _apart(part, fine),
                           _BEGUN * limit)
              if with_remedy and max(errors) > limit else None)
    found = [inaccurate(scene, errors[0], errors[1], remedy), earlier]
    return errors, '; '.join(filter(None, found)) or None


def _alike(run, scene):
    # The run of another scene with samples at the same times; None if it diverges.
    steps = round(run.t[-1] / scene.step)
    try:
        return run_scene(scene, steps, steps // (len(run.t) - 1))
    except DivergenceError:
        return None


def _apart(run, other):
    # Largest distances between the tips of two runs, of which the second may be longer.
    return tip_distances(run.model, run.values, other.model, other.values[:len(run.t)])


def _until_apart(run, other, limit):
    # The part of a run until the tips are so far apart [m], or all.
    far = (distances(run.model, run.values, other.model, other.values) > limit).any(axis=0)
    return _part(run, slice(1 + max(1, int(np.argmax(far))))) if far.any() else run


def _find_remedy(run, parts, errors, limit):
    """
    Return a change of the scene that mends most of its error, or of that of its deflection.

    Of steps, modes and equations, it is the first one that moves the tip by half of the error,
    else the one that moves it most; it is '' if none moves it by a tenth. Axial modes move it,
    too, if the steps do not resolve them: they are last. `parts` of a step take its place. The
    error of the place counts if it is above the limit [m].
    """
    scene = run.scene
    changes = {_SHORTER_STEPS: (parts, 0, 0, True), _MORE_OF_MODES: (1, None, 0, True)}
    if not {*needed_static(scene.manipulator, scene.values['model.modes'])} <= {*scene.static}:
        changes = {'model.static_modes auto': (1, 0, 0, False), **changes}
    exact, stretches = (scene.values['model.formulation'] == 'exact',
                        scene.manipulator.arm.stretches)
    if exact and stretches:
        changes[more_axial(scene)] = 1, 0, 1, True
    elif not exact:
        changes['model.formulation exact'] = 1, 0, 0, False
    moved, place = {}, errors[0] <= limit
    for text, change in changes.items():
        other = _alike(run, refine(scene, *change))
        moved[text] = 0.0 if other is None else _apart(run, other)[place]
        if moved[text] > 0.5 * errors[place]:
            return text
    most = max(moved, key=lambda text: moved[text])
    return most if moved[most] > 0.1 * errors[place] else ''


@checked()
def choose_resolution(scene: SceneLike, duration: float = 0.0) -> Run:
    """
    Return a run with modes and step for the tip error that a scene states in `model.accuracy`.

    The scene is run with its own modes and step, and the errors of its tip are measured, see
    `Run.stats`. As long as one is more than half the stated error, the step is made shorter or
    modes, bending or axial ones, are added, whatever moves the tip most, in five runs at most. The
    choice, the `scene` of the run, holds for the scene's own motion: if commands will act, its
    loads should be as rough as the commands.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    duration : float
        Sim time of the run, which has 200 000 steps at most; 0: 10 s [s].

    Raises
    ------
    ParameterError
        If the scene states no error, is at rest, or no choice is accurate enough.

    Examples
    --------
    >>> import timo_sim
    >>> scene = timo_sim.load_scene('paper', {'model.accuracy': 1e-3})
    >>> timo_sim.choose_resolution(scene, duration=1.0).scene.values['model.modes']
    3

    """
    scene, duration = load_scene(scene), PARAMETERS['duration'].check(duration)
    goal = scene.values['model.accuracy']
    if not goal:
        raise ParameterError('model.accuracy must be > 0 m for a choice of modes and step, got 0')
    stated, best = f'model.accuracy = {goal:g} m', 'every run diverges'
    least, change = math.inf, {'model.accuracy': 0.0}
    for _ in range(_MOST_RUNS):
        scene = scene.vary(change)
        modes, step = scene.values['model.modes'], scene.step
        steps = min(max(1, round((duration or _HORIZON) / step)), _MAX_STEPS)
        change = {'integrator.step': 0.5 * step}
        try:
            run = run_scene(scene, steps)
        except DivergenceError:
            continue
        moved = tip_distances(run.model, run.values, run.model, run.values[:1])
        if max(moved) < _STILL * scene.manipulator.arm.length:
            raise ParameterError(
                f'{stated} needs a scene that moves by its own loads or initial motion')
        run = measure_error(run, with_remedy=False)
        errors = run.stats['estimated_tip_error_m'], run.stats['estimated_deflection_error_m']
        ratio = _MARGIN * max(errors) / goal
        if ratio <= 1.0:
            return _thin(run, enough_samples(steps))
        if math.isnan(ratio):
            continue
        remedy = _find_remedy(run, 2, errors, goal / _MARGIN)
        if max(errors) < least:
            least = max(errors)
            best = (f'{_MARGIN * least:.1e} m is, with N = {modes} and h = {1e3 * step:g} ms' + (
                f': take {remedy}' if remedy else ''))
        if remedy == _MORE_OF_MODES:
            change = {'model.modes': max(modes + MORE_MODES, 5 * modes // 3)}
        elif remedy in (_SHORTER_STEPS, ''):  # whose errors are of fourth order
            change['integrator.step'] = step / 2**min(3, math.ceil(math.log2(ratio) / 4.0))
        elif remedy == more_axial(scene):
            change = {'model.axial_modes': scene.values['model.axial_modes'] + 1}
        else:  # equations or shapes, which the scene states
            break
    raise ParameterError(f'{stated} is not reached: {best}')


def resolve(scene: Scene, duration: float,
            tell: Callable[[str], object] = lambda text: None) -> tuple[Scene, int]:
    """
    Return the scene, with modes and step chosen if it states an error, and its number of steps.

    `tell` is called with the choice. Raises ParameterError if the duration does not fit the step,
    or no choice is accurate enough.
    """
    goal = scene.values['model.accuracy']
    if goal:
        run = choose_resolution(scene, duration)
        scene = run.scene
        tell(f'model.accuracy = {goal:g} m: N = {scene.values["model.modes"]} modes and h = '
             f'{1e3 * scene.step:g} ms: {run.message}')
    return scene, steps_in(duration, scene.step)


_EVERY = Parameter('sample_every', 1, '', 'steps between samples', low=1)


@checked(estimate=FLAG)
def simulate(scene: SceneLike, duration: float, sample_every: int = 1,
             estimate: bool = True) -> Run:
    """
    Simulate a scene under its own loads.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
        With `model.accuracy`, modes and step are refined first, see `choose_resolution`.
    duration : float
        Sim time [s], a whole multiple of the time step.
    sample_every : int
        Steps between samples; divides the number of steps.
    estimate : bool
        Whether the error of the tip is measured by a finer run, see `Run.stats`; doc/scene.md says
        what that costs.

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or `sample_every` the number of steps.
    DivergenceError
        If the state is no longer finite, or the arm is bent by more than ten times its length;
        `error.run` is the run so far.
    MemoryError
        If the samples do not fit into memory.

    Warns
    -----
    ModelWarning
        With the text of `Run.warning`, if there is one: the error is large, the shaft is too fast
        for the formulation, or a harmonic load is too fast for the step.

    Examples
    --------
    >>> import timo_sim
    >>> run = timo_sim.simulate('paper', duration=1.0)
    >>> run.deflection().shape
    (1001, 2)

    """
    scene, steps = resolve(load_scene(scene), duration)
    sample_every = _EVERY.check(sample_every)
    if steps % sample_every:
        raise ParameterError(
            f'sample_every = {sample_every} must divide the number of steps, {steps}')
    parts = 1
    if estimate:  # at samples alone, a vibration with their rate would always show the same error
        least = -(-_COMPARED * sample_every // max(1, steps))
        parts = next(k for k in range(min(least, sample_every), sample_every + 1)
                     if sample_every % k == 0)
    try:
        run = run_scene(scene, steps, sample_every // parts, _say)
    except DivergenceError as error:
        error.run = _thin(error.run, parts)
        raise
    except MemoryError:
        raise MemoryError(f'{1 + steps // sample_every} samples do not fit into memory: take '
                          f'sample_every > {sample_every}') from None
    run = _thin(measure_error(run) if estimate else run, parts)
    if run.warning:
        warn(run.warning)
    return run


def _say(text):
    notebook = 'ipykernel' in sys.modules  # which shows what goes to stderr as an error
    print(f'timo_sim: {text}', file=sys.stdout if notebook else sys.stderr, flush=True)


def _thin(run, every):
    return run if every == 1 else _part(run, slice(None, None, every))


def _part(run, samples):
    return replace(run, t=run.t[samples], values=run.values[samples],
                   friction_heat=run.friction_heat[samples])


def enough_samples(steps: int) -> int:
    """
    Return the steps between samples of a run: one, or more for one of more than 20 000 steps.

    They divide the number of steps. If no such divisor leaves a tenth of 20 000 samples or more,
    there are more than 20 000.
    """
    first = max(1, -(-steps // _MOST_SAMPLES))
    return next(every for every in (*range(first, 10 * first), *range(first - 1, 0, -1))
                if steps % every == 0)
