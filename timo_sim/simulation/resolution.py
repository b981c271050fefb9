# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Choice of the resolution, modes and step, for a stated tip error."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from timo_sim.physics.layout import Motion
from timo_sim.scene.parameter import ParameterError, warn
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.scene.values import steps_in
from timo_sim.scene.scene import load_scene, Scene, scene_from, SceneLike
from timo_sim.simulation.model_warnings import DivergenceError
from timo_sim.simulation.simulator import Simulator

SIZES = (3, 5, 8, 10, 12)      # numbers of modes; few, because each has to be compiled once
STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # to choose from [s]
REFERENCE_STEPS = STEPS[3:]    # to choose from for the reference [s]
GRID, PERIOD = 0.02, 0.001     # multiple of all steps; least time between samples [s]
HORIZON, LONGEST = 10.0, 30.0  # sim time that is compared: by default, and at most [s]
MARGIN, AGREEMENT = 2.0, 20.0  # least ratio of the stated error to the choice's, the reference's
LEAST_GROWTH, MOST_GROWTH = 0.5, 2.0  # bounds of the power of time with which errors grow
MOST_STEPS = 200000            # most steps of a longer run that are compared with halves
_BLOCK = 1024                  # samples per call of the simulator


class Resolution(NamedTuple):
    """
    A scene with its modes and step chosen.

    Attributes
    ----------
    scene : Scene
    estimate : float
        Estimated tip error until the end of the run [m].
    looked_at : float
        Sim time that was compared; beyond it the error is extrapolated [s].
    until : float
        Sim time at which the error reaches the stated one, if it grows at least linearly [s].
    warning : str or None
        Warning of errors that modes and steps do not reduce.

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


class _Path(NamedTuple):
    """Tip of a run: positions in the world and in the arm frame at samples after the start."""

    tip: np.ndarray       # (n, 2, 2) [m]
    stride: int           # PERIODs between samples
    rest: np.ndarray      # largest deflection of the tip by modes n, n + 1, ..., (N,) [m]
    error: float          # of steps and friction, as the run estimates it [m]
    simulator: Simulator


def choose_resolution(scene: SceneLike, duration: float = 0.0,
                      fits: Callable[[float], bool] = lambda step: True) -> Resolution:
    """
    Choose modes and step of a scene for the tip error that it states in `model.accuracy`.

    The scene's own motion is compared with a reference of 12 modes, whose step gives a result
    within a twentieth of the stated error from that of the next larger step. If no step does, the
    reference has fewer modes. The choice is the least N, and the largest h for it, with which the
    tip's position in the world and its deflection in the arm frame stay within half the stated
    error and the run gives no warning, unless the reference does. The choice holds for that
    motion: if commands will act, the scene's own loads should be as rough as the commands. Errors
    of the formulation are not part of it.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    duration : float
        Sim time of the run, of which at most 30 s are compared; 0: 10 s are compared [s].
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
    span = max(1, round(min(duration or HORIZON, LONGEST) / GRID))
    longer = max(1.0, duration / LONGEST)
    most, reference, reference_error = _reference(scene, span, goal / AGREEMENT / longer)
    sizes, best, limited_by = SIZES[:SIZES.index(most)], (np.inf, 0, 0.0), {}
    # If the tip's deflection by higher modes exceeds the error, a size is too small to be tried.
    for modes in [size for size in sizes if reference.rest[size] <= goal] or sizes[-1:]:
        limited_by[modes], before = 'the steps', None
        for step in filter(fits, STEPS):
            path = _path(scene, modes, step, span)
            if path is None:
                continue
            (apart, growth), run = _apart(path, reference), path
            # If modes converge as slowly as 1/N^2, the reference has (N/N_r)^2 of this error.
            estimate = (apart / (1.0 - (modes / most)**2) + reference_error) * longer**growth
            enough = MARGIN * estimate <= goal
            if enough and longer > 1.0:  # a mode may grow that is still too small to be seen
                whole = round(min(duration, MOST_STEPS * step) / GRID)
                runs = [_path(scene, modes, step, whole, parts) for parts in (1, 2)]
                run, estimate = runs[0] or path, estimate + (
                    _apart(*runs)[0] if all(runs) else np.inf)
            error = max(MARGIN * estimate, run.error)
            if error <= goal and (reference.simulator.warning or not run.simulator.warning):
                until = max(span * GRID, duration) * (goal / estimate)**(1.0 / max(growth, 1.0))
                return Resolution(run.simulator.scene, estimate, span * GRID, until,
                                  _of_stretch(run.simulator, goal))
            best = min(best, (error, modes, step))
            if not enough and before and _apart(path, before)[0] < 0.25 * apart:
                limited_by[modes] = 'the modes'
                break
            before = path
    error, modes, step = best
    if not modes:
        raise _refused(scene, f'needs a step of at most {STEPS[0]:g} s, of which times of jumps '
                       'and the duration are multiples, and with which no run diverges')
    more = '' if most == SIZES[-1] else (
        f', and with more than {most} modes no steps down to {1e3 * STEPS[-1]:g} ms agree')
    raise _refused(scene, f'is not reached, but {error:.1e} m is, with N = {modes} and '
                   f'h = {1e3 * step:g} ms: {limited_by[modes]} limit it{more}')


def resolved(scene, duration, tell=None):
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


def _reference(scene, span, agreement):
    # Returns the reference: its number of modes, its path and the error of its steps [m].
    closest = np.inf
    for modes in SIZES[:0:-1]:
        before = None
        for step in REFERENCE_STEPS:
            path = _path(scene, modes, step, span)
            if path and not np.ptp(path.tip, axis=0).any():
                raise _refused(scene, 'needs a scene that moves by its own loads or initial '
                               'motion')
            if path and before:
                apart, _ = _apart(path, before)
                if apart <= agreement:
                    return modes, path, apart / 3.0  # errors fall at least with h^2
                closest = min(closest, apart)
            before = path
    raise _refused(scene, 'needs a reference, but with steps down to '
                   f'{1e3 * STEPS[-1]:g} ms all runs diverge' + (
                       '' if np.isinf(closest) else f' or differ by {closest:.1e} m'))


def _refused(scene, why):
    return ParameterError(f'model.accuracy = {scene.values["model.accuracy"]:g} m {why}')


def _path(scene, modes, step, span, parts=1):
    # Returns None if the scene cannot have this size and step, or its run diverges.
    try:
        scene = scene_from({**scene.values, 'model.accuracy': 0.0, 'model.modes': modes,
                            'integrator.step': step / parts})
    except ParameterError:  # a load that jumps inside such a step
        return None
    simulator, stride = Simulator(scene), max(1, round(step / PERIOD))
    if simulator.warning:  # a harmonic load that is too fast for such steps
        return None
    simulator.warm_up()
    model, every = simulator.model, round(stride * PERIOD / step) * parts
    tip, count = model.tip_point, round(span * GRID / PERIOD) // stride
    path, rest = np.empty((count, 2, 2)), np.zeros(len(model.modes))
    try:
        for k in range(0, count, _BLOCK):
            size = min(_BLOCK, count - k)
            motions = simulator.advance(size * every, sample_every=every)[0][1:]
            q = Motion(motions).q
            path[k:k + size, 0] = model.world(motions, tip)[:, 0]
            path[k:k + size, 1] = model.centre_line(q, tip)[:, 0]
            shares = np.cumsum((q * tip.deflection[:, 0])[:, ::-1], axis=1)[:, ::-1]
            rest = np.maximum(rest, np.abs(shares).max(axis=0))
    except DivergenceError:
        return None
    # Only of steps and friction: a smaller step does not reduce errors by stretch and modes.
    error = simulator.estimated_error - simulator.stretch.tip - (
        simulator.integration.errors.modes.tip)
    return _Path(path, stride, rest, error, simulator)


def _apart(one, other):
    # Largest distance of two tips [m], and the power of time with which it grows.
    common = math.lcm(one.stride, other.stride)
    first, second = (path.tip[common // path.stride - 1::common // path.stride]
                     for path in (one, other))
    apart = np.linalg.norm(first - second, axis=2).max(axis=1)
    early, late = apart[:(len(apart) + 1) // 2].max(), apart.max()
    growth = math.log2(late / early) if early > 0.0 else 0.0
    return float(late), min(max(growth, LEAST_GROWTH), MOST_GROWTH)


def _of_stretch(simulator, goal):
    off, scene = simulator.stretch.tip, simulator.scene
    if off <= goal:
        return None
    exact = scene.values['model.formulation'] == 'exact'
    return (f'the tip is {off:.1e} m from that of an arm that stretches by t = {simulator.t:g} s, '
            'more than the stated model.accuracy: take '
            f'{"" if exact else "model.formulation exact with "}model.axial_modes 1')
