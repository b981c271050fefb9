# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The function `simulate`; the error of its runs, and modes and step for a stated error."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
import sys
from typing import NamedTuple

import numpy as np

from timo_sim.runs.run import Run, run_scene
from timo_sim.scene.parameters import (
    checked, FLAG, FUNCTION, Parameter, ParameterError, PARAMETERS, steps_in, warn)
from timo_sim.scene.scene import load_scene, Scene, scene_from, SceneLike
from timo_sim.simulation.finer import measure, Motions, refine
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.warnings import DivergenceError, unseen_load

SIZES = (3, 5, 8, 12)  # numbers of modes to choose from
STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # to choose from [s]
GRID = 0.02            # multiple of all steps, time between positions that are compared [s]
HORIZON = 10.0         # sim time that is compared by default [s]
MAX_STEPS = 200_000   # most steps of a run that is compared
MARGIN = 2.0           # least ratio of the stated error to the estimate of the choice
_ENOUGH_COMPARED = 500  # samples at which the tips of two runs are compared, if there are more
_LONGEST = 0.01         # time between samples of `thin` at most [s]
_MOST_SAMPLES = 1_000_000  # of a run to be thinned, if more are not needed for 100 Hz
_BESIDE = 0.01          # most distance of a curve from lines between samples [ranges of the curve]
_SEEN = 1e-6            # least travel that lines between samples show [arm lengths]
_STILL = 1e-13         # travel of a tip that only round-off moves [arm lengths]


def measure_error(run: Run, find_remedy: bool = True) -> Run:
    """
    Return a run of `run_scene` with its measured error, and the warning that this calls for.

    `estimated_tip_error_m` and `estimated_deflection_error_m` are in its `stats`, see
    `simulation.finer.measure`, which has `find_remedy`, too.
    """
    if len(run.t) < 2:
        return run
    # Tips of a long run are compared at some of its samples, each of which takes a quarter step.
    samples = len(run.t) - 1
    seen = _thin(run, max(k for k in range(1, 1 + max(1, samples // _ENOUGH_COMPARED))
                          if samples % k == 0))
    errors, warning = measure(Motions(run.scene, seen.values, run.stats['steps']), run.warning,
                              find_remedy)
    return replace(run, stats={**run.stats, 'estimated_tip_error_m': errors[0],
                               'estimated_deflection_error_m': errors[1]}, warning=warning)


class Resolution(NamedTuple):
    """
    A scene with its modes and step chosen.

    `estimate` is the tip error [m] until the sim time `looked_at` [s]; it reaches the stated one
    at `until` [s], if it grows linearly. `warning` is that of an error that modes and steps do not
    reduce, or None.
    """

    scene: Scene
    estimate: float
    looked_at: float
    until: float
    warning: str | None

    def __str__(self) -> str:
        values, model = self.scene.values, self.scene.build()
        return (f'N = {values["model.modes"]} modes, n_g = {len(model.quadrature.nodes)} '
                f'nodes, h = {1e3 * self.scene.step:g} ms: estimated tip error '
                f'{self.estimate:.1e} m, from a run of {self.looked_at:g} s; below the stated one '
                f'until about {self.until:.2g} s' + (f'; {self.warning}' if self.warning else ''))


@checked(fits=FUNCTION)
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
        Sim time of the run, of which 200 000 steps at most are compared; 0: 10 s [s].
    fits : function(float) -> bool
        Returns whether a step [s] suits the caller.

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
    scene = load_scene(scene)
    goal, duration = scene.values['model.accuracy'], PARAMETERS['duration'].check(duration)
    if not goal:
        raise ParameterError('model.accuracy must be > 0 m for a choice of modes and step, got 0')
    stated = f'model.accuracy = {goal:g} m'
    steps, best = list(filter(fits, STEPS)), (np.inf, '')
    for modes in SIZES:
        while steps:
            run = _run_trial(scene, modes, steps[0], duration or HORIZON)
            fine = run and run.alike(refine(run.scene, 2, axial=0, same_equations=True))
            if fine is None:
                steps.pop(0)
                continue
            moved = fine.distances(fine._replace(values=fine.values[:1]))
            if max(moved) < _STILL * scene.manipulator.arm.length:
                raise ParameterError(f'{stated} needs a scene that moves by its own loads or '
                                     'initial motion')
            difference = max(run.distances(fine))
            # Modes may converge as slowly as 1/N^2; the finer run has a part of the error.
            estimate = difference / (1.0 - (modes / fine.scene.values['model.modes'])**2)
            if MARGIN * estimate <= goal:
                looked_at = run.steps * run.scene.step
                return Resolution(run.scene, estimate, looked_at,
                                  looked_at * goal / estimate if estimate else np.inf,
                                  _stretch_warning(fine, goal))
            halves = run.alike(refine(run.scene, 2, 0, 0, same_equations=True))
            by_steps = halves is None or 2.0 * max(run.distances(halves)) > difference
            best = min(best, (estimate, f'N = {modes} and h = {1e3 * steps[0]:g} ms: the '
                                        f'{"steps" if by_steps else "modes"} limit it'))
            if not by_steps:
                break
            steps.pop(0)
    error, size = best
    if np.isinf(error):
        raise ParameterError(
            f'{stated} needs a step from {STEPS[-1]:g} to {STEPS[0]:g} s of which times of jumps '
            'and the duration are multiples, and with which no run diverges')
    raise ParameterError(f'{stated} is not reached, but {MARGIN * error:.1e} m is, with {size}')


def _run_trial(scene, modes, step, duration):
    """Return Motions that are GRID apart; None if the step does not suit the loads."""
    samples = min(max(1, round(duration / GRID)), int(MAX_STEPS * step / GRID))
    every = round(GRID / step)
    try:
        scene = scene_from({**scene.values, 'model.accuracy': 0.0, 'model.modes': modes,
                            'integrator.step': step})
        if unseen_load(scene):
            return None
        motions = Simulator(scene).advance(samples * every, sample_every=every)[0]
        return Motions(scene, motions, samples * every)
    except (ParameterError, DivergenceError):  # such as a load that jumps inside of a step
        return None


def _stretch_warning(run, goal):
    if (run.scene.values['model.formulation'] != 'exact' or run.scene.values['model.axial_modes']
            or not run.scene.manipulator.arm.stretches):
        return None
    # An arm that stretches may need shorter steps than one that does not.
    stretched = (run.alike(refine(run.scene, parts, 0, 1, True)) for parts in (1, 4))
    off = next((max(run.distances(each)) for each in stretched if each is not None), 0.0)
    if off <= goal:
        return None
    end = run.steps * run.scene.step
    return (f'the tip is {off:.1e} m from that of an arm that stretches by t = {end:g} s, more '
            'than the stated model.accuracy: take model.axial_modes 1')


def resolve(scene: Scene, duration: float, tell: Callable[[str], object] | None = None,
            check_step: Callable[[float], object] = lambda step: None) -> tuple[Scene, int]:
    """
    Return the scene, with modes and step chosen if it states an error, and its number of steps.

    `tell` is called with the choice; without it a ModelWarning is given if the choice has a
    warning. `check_step` raises ParameterError for a step [s] that does not suit the caller.
    Raises ParameterError if the duration does not fit the step, or no choice is accurate enough.
    """
    def fits(step):
        try:
            check_step(step)
            return steps_in(duration, step) >= 0
        except ParameterError:
            return False

    goal = scene.values['model.accuracy']
    if goal:
        choice = choose_resolution(scene, duration, fits)
        if tell:
            tell(f'model.accuracy = {goal:g} m: {choice}')
        elif choice.warning:
            warn(choice.warning)
        scene = choice.scene
    return scene, steps_in(duration, scene.step)


_EVERY = Parameter('sample_every', 1, '', 'steps between samples', low=1)
_LEAST_COMPARED = 200  # the same, if there are fewer


@checked(estimate=FLAG)
def simulate(scene: SceneLike, duration: float, sample_every: int = 1,
             estimate: bool = True) -> Run:
    """
    Simulate a scene under its own loads.

    On a terminal, a progress bar appears when the run takes more than a second.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
        With `model.accuracy`, modes and step are chosen first, see `choose_resolution`.
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
    if estimate:  # samples of a short run are closer, so that enough are compared
        least = -(-_LEAST_COMPARED * sample_every // max(1, steps))
        parts = next(k for k in range(min(least, sample_every), sample_every + 1)
                     if sample_every % k == 0)
    with _progress(steps) as report:
        try:
            run = run_scene(scene, steps, sample_every // parts, report, _say)
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


@contextmanager
def _progress(steps):
    if not (sys.stderr and sys.stderr.isatty()):
        yield lambda count: None
        return
    from tqdm import tqdm  # which takes longer to import than a short run
    with tqdm(total=steps, unit='step', unit_scale=True, delay=1.0, leave=False) as bar:
        yield bar.update


def _say(text):
    notebook = 'ipykernel' in sys.modules  # which shows what goes to stderr as an error
    print(f'timo_sim: {text}', file=sys.stdout if notebook else sys.stderr, flush=True)


def _thin(run, every):
    return replace(run, t=run.t[::every], values=run.values[::every],
                   friction_heat=run.friction_heat[::every])


def closest_samples(steps: int, step: float) -> int:
    """Return the steps between samples of a run to be thinned: one, if it is not very long."""
    most = max(1, round(_LONGEST / step))
    first = min(max(1, steps // _MOST_SAMPLES), most)
    return next((every for every in range(first, most + 1) if steps % every == 0), 1)


def thin(run: Run) -> Run:
    """
    Return a run with as few of its samples, evenly spaced, as show what moves.

    Straight lines between them are within a hundredth of its range of each curve: place of the
    carrier, shaft angle, deflection. That takes 16 samples a period of a vibration that is alone.
    There are 100 a second at least, if the number of samples has such a divisor.
    """
    samples, length = len(run.t) - 1, run.scene.manipulator.arm.length
    curves = [run.carrier, length * run.shaft[:, np.newaxis], run.deflection()]
    limits = [max(_BESIDE * np.ptp(curve, axis=0).max(), _SEEN * length) for curve in curves]

    def show(every):
        for curve, limit in zip(curves, limits):
            step = np.diff(curve[::every], axis=0)
            for k in range(1, every):
                line = curve[:-1:every] + k / every * step
                if np.abs(curve[k::every] - line).max() > limit:
                    return False
        return True
    most = round(_LONGEST / run.t[1]) if samples else 1
    return _thin(run, next((every for every in range(most, 1, -1)
                            if samples % every == 0 and show(every)), 1))
