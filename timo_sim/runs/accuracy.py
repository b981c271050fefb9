# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Resolution for a stated tip error, and the error of a run by its distance from a finer one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from timo_sim.compiled.constants import of_any_size
from timo_sim.model.layout import Motion
from timo_sim.runs.run import run_scene
from timo_sim.scene.parameters import ParameterError, PARAMETERS, steps_in, warn
from timo_sim.scene.scene import load_scene, Scene, scene_from, SceneLike
from timo_sim.simulation.finer import can_refine, choose_parts, refine, tip_distance
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.warnings import (
    DivergenceError, inaccurate, MOST_APART, NO_FINER_RUN, unseen_load)

SIZES = (3, 5, 8, 12)  # numbers of modes to choose from
STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # to choose from [s]
GRID = 0.02            # multiple of all steps, time between positions that are compared [s]
HORIZON = 10.0         # sim time that is compared by default [s]
MOST_STEPS = 200_000   # most steps of a run that is compared
MARGIN = 2.0           # least ratio of the stated error to the estimate of the choice
FURTHER_MODES = 3         # further modes of the finer run, whose step is half as long
_STILL = 1e-13         # travel of a tip that only round-off moves [arm lengths]
_BLOCK = 1024          # samples per call of the simulator


class Resolution(NamedTuple):
    """
    A scene with its modes and step chosen.

    Attributes
    ----------
    scene : Scene
    estimate : float
        Estimated tip error until `looked_at` [m].
    looked_at : float
        Sim time that was compared [s].
    until : float
        Sim time at which the error reaches the stated one, if it grows linearly [s].
    warning : str or None
        Warning of an error that modes and steps do not reduce.

    """

    scene: Scene
    estimate: float
    looked_at: float
    until: float
    warning: str | None

    def __str__(self):
        values, model = self.scene.values, self.scene.build()
        return (f'N = {values["model.modes"]} modes, n_g = {len(model.quadrature.nodes)} '
                f'nodes, h = {1e3 * self.scene.step:g} ms: estimated tip error '
                f'{self.estimate:.1e} m, from a run of {self.looked_at:g} s; below the stated one '
                f'until about {self.until:.2g} s' + (f'; {self.warning}' if self.warning else ''))


def choose_resolution(scene: SceneLike, duration: float = 0.0,
                      fits: Callable[[float], bool] = lambda step: True) -> Resolution:
    """
    Choose modes and step of a scene for the tip error that it states in `model.accuracy`.

    The scene is run with three modes and the longest step, and compared with a run that has three
    more modes and half the step. As long as the tip's positions, in the world and in the arm
    frame, differ by more than half the stated error, the step is halved or modes are added,
    whichever moves the tip more. The choice holds for the scene's own motion: if commands will
    act, its loads should be as rough as the commands. Errors of the formulation are not part of
    it. An arm that does not stretch is also compared with one that does; if they differ by more
    than the stated error, the choice has a warning.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    duration : float
        Sim time of the run, which is compared to its end, but for 200 000 steps at most; 0: 10 s
        are compared [s].
    fits : function(float) -> bool
        Returns whether a step [s] suits the caller.

    Returns
    -------
    Resolution

    Raises
    ------
    ParameterError
        If the scene states no error, is at rest, or no choice is accurate enough; the text says
        why.

    Examples
    --------
    >>> import timo_sim
    >>> scene = timo_sim.load_scene('paper', {'model.accuracy': 1e-3})
    >>> timo_sim.choose_resolution(scene, duration=1.0).scene.values['model.modes']
    3

    """
    scene = load_scene(scene)
    goal, duration = scene.values['model.accuracy'], PARAMETERS['duration'].check(duration)
    if not goal:
        raise ParameterError('model.accuracy must be > 0 m for a choice of modes and step, got 0')
    span = max(1, round((duration or HORIZON) / GRID))
    steps, best = list(filter(fits, STEPS)), (np.inf, 'no step suits')
    for modes in SIZES:
        while steps:
            step = steps[0]
            looked_at = min(span, int(MOST_STEPS * step / GRID))
            path = _path(scene, modes, step, looked_at)
            finer = None if path is None else _path(
                scene, modes + FURTHER_MODES, step / 2, looked_at)
            if finer is None:
                steps.pop(0)
                continue
            if np.ptp(finer, axis=0).max() < _STILL * scene.manipulator.arm.length:
                raise _refused(scene, 'needs a scene that moves by its own loads or initial '
                               'motion')
            # Modes may converge as slowly as 1/N^2; the finer run has a part of the error.
            estimate = _apart(path, finer) / (1.0 - (modes / (modes + FURTHER_MODES))**2)
            if MARGIN * estimate <= goal:
                return Resolution(
                    _resolved(scene, modes, step), estimate, looked_at * GRID,
                    looked_at * GRID * goal / estimate if estimate else np.inf,
                    _stretch_warning(scene, modes, step, looked_at, finer, goal))
            halves = _path(scene, modes, step / 2, looked_at)
            of_steps = halves is None or 2.0 * _apart(path, halves) > _apart(path, finer)
            best = min(best, (estimate, f'N = {modes} and h = {1e3 * step:g} ms: the '
                                        f'{"steps" if of_steps else "modes"} limit it'))
            if not of_steps:
                break
            steps.pop(0)
    error, size = best
    if np.isinf(error):
        raise _refused(scene, f'needs a step from {STEPS[-1]:g} to {STEPS[0]:g} s of which times '
                       'of jumps and the duration are multiples, and with which no run diverges')
    raise _refused(scene, f'is not reached, but {MARGIN * error:.1e} m is, with {size}')


def resolve(scene, duration, tell=None):
    """
    Return the scene, with modes and step chosen if it states an error, and its number of steps.

    `tell`, a function(str), is called with the choice; without it a ModelWarning is given if the
    choice has a warning.

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or no choice is accurate enough.

    """
    goal = scene.values['model.accuracy']
    if goal:
        choice = choose_resolution(scene, duration, lambda step: _fits(duration, step))
        if tell:
            tell(f'model.accuracy = {goal:g} m: {choice}')
        elif choice.warning:
            warn(choice.warning)
        scene = choice.scene
    return scene, steps_in(duration, scene.step)


def _fits(duration, step):
    try:
        return steps_in(duration, step) >= 0
    except ParameterError:
        return False


def _refused(scene, why):
    return ParameterError(f'model.accuracy = {scene.values["model.accuracy"]:g} m {why}')


def _resolved(scene, modes, step, axial=0):
    axial = max(axial, scene.values['model.axial_modes'])
    return scene_from({**scene.values, 'model.accuracy': 0.0, 'model.modes': modes,
                       'model.axial_modes': axial, 'integrator.step': step})


def _path(scene, modes, step, span, axial=0):
    """
    Return positions of the tip in the world and in the arm frame, shape (span, 2, 2) [m].

    They are GRID apart. The result is None if the scene cannot have this size and step, a harmonic
    load is too fast for the step, or the run diverges. No code is compiled for each size.
    """
    try:
        simulator = Simulator(_resolved(scene, modes, step, axial), pack=of_any_size)
    except ParameterError:  # a load that jumps inside such a step
        return None
    if simulator.warning:
        return None
    model, every, path = simulator.model, round(GRID / step), np.empty((span, 2, 2))
    try:
        for k in range(0, span, _BLOCK):
            size = min(_BLOCK, span - k)
            motions = simulator.advance(size * every, sample_every=every)[0][1:]
            path[k:k + size, 0] = model.world(motions, model.tip_point)[:, 0]
            path[k:k + size, 1] = model.centre_line(Motion(motions).q, model.tip_point)[:, 0]
    except DivergenceError:
        return None
    return path


def _apart(one, other):
    return float(np.linalg.norm(one - other, axis=2).max())


def _stretch_warning(scene, modes, step, span, finer, goal):
    exact = scene.values['model.formulation'] == 'exact'
    if not exact or scene.values['model.axial_modes']:
        return None
    # Steps of axial vibrations may have to be shorter than those of the arm that does not stretch.
    paths = (_path(scene, modes + FURTHER_MODES, step / parts, span, 1) for parts in (2, 8))
    off = next((_apart(path, finer) for path in paths if path is not None), 0.0)
    if off <= goal:
        return None
    return (f'the tip is {off:.1e} m from that of an arm that stretches by t = {span * GRID:g} s, '
            'more than the stated model.accuracy: take model.axial_modes 1')


_POINTS = 200  # least number of samples at which the tips of two runs are compared


def samples_between(steps, sample_every):
    """Return into how many parts samples are divided, so that a comparison has enough of them."""
    parts = -(-_POINTS * sample_every // max(1, steps))
    return next(k for k in range(min(parts, sample_every), sample_every + 1)
                if sample_every % k == 0)


def measure_error(run):
    """
    Return a run with its measured error, and the warning that this calls for.

    If a finer run diverges, one with shorter steps is tried.

    Parameters
    ----------
    run : Run
        Of `run_scene`.

    Returns
    -------
    Run
        With `estimated_tip_error_m` in `stats`, unless the scene has no finer one or all diverge.

    """
    scene = run.scene
    if not can_refine(scene) or len(run.t) < 2:
        return run
    for parts in choose_parts(scene):
        fine = refine(scene, parts)
        error = _distance(run, fine, parts)
        if error is not None:
            break
    else:
        return replace(run, warning=run.warning or NO_FINER_RUN)
    # The finer run has seen a load that is too fast for the steps of the run. What `newton` leaves
    # out may make a motion unstable that both runs do not leave.
    earlier = run.warning if scene.values['model.formulation'] != 'exact' else unseen_load(fine)
    large = error > MOST_APART * scene.manipulator.arm.length
    remedy = _remedy(run, parts, error) if large else None
    return replace(run, stats={**run.stats, 'estimated_tip_error_m': error},
                   warning=earlier or inaccurate(scene, error, remedy))


def _distance(run, fine, parts):
    # The distance of a run's tip from that of a finer scene [m], or None if this diverges.
    steps = parts * run.stats['steps']
    try:
        other = run_scene(fine, steps, steps // (len(run.t) - 1), pack=of_any_size)
    except DivergenceError:
        return None
    return tip_distance(run.model, run.values, other.model, other.values)


def _remedy(run, parts, error):
    """
    Return a change of the scene that mends most of its error.

    Of steps, modes and equations, in this order, the first one that moves the tip by half of the
    error, else the one that moves it most: axial modes that the steps do not resolve would move
    it, too.
    """
    scene = run.scene
    own = scene.values['model.formulation']
    changes = {'a smaller integrator.step': (parts, 0, 0, own),
               'more model.modes': (1, None, 0, own)}
    if own == 'exact':
        changes['model.axial_modes 1'] = 1, 0, 1, own
    else:
        changes['model.formulation exact'] = 1, 0, 0, 'exact'
    moved = {}
    for text, change in changes.items():
        moved[text] = _distance(run, refine(scene, *change), change[0]) or 0.0
        if moved[text] > 0.5 * error:
            return text
    return max(moved, key=lambda text: moved[text])
