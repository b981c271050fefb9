# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The resolution, modes and step, that a stated tip error needs."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from timo_sim.physics.layout import Motion
from timo_sim.scene.parameter import ParameterError, whole_ratio
from timo_sim.scene.scene import Scene, scene_from
from timo_sim.simulation.model_warnings import DivergenceError
from timo_sim.simulation.simulator import Simulator

STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # to choose from [s]
PERIOD = 0.02                      # of the samples that are compared [s]
HORIZON, LONGEST = 10.0, 60.0      # sim time looked at, if none is said, and at most [s]
RICH_MODES, RICH_STEP = 12, 0.0005  # what stands for the truth
MOST_MODES = 8                     # with up to these, the truth is much closer to itself
MARGIN = 2.0                       # of the choice to the stated error


class Resolution(NamedTuple):
    """A scene with its modes and step chosen, and the estimated tip error [m]."""

    scene: Scene
    estimate: float

    def __str__(self):
        values, model = self.scene.values, self.scene.build()
        return (f'N = {values["model.modes"]} modes, n_g = {len(model.quadrature.nodes)} '
                f'nodes, h = {1e3 * self.scene.step:g} ms: estimated tip error '
                f'{self.estimate:.1e} m')


def choose_resolution(scene: Scene, duration: float = 0.0,
                      fits: Callable[[float], bool] = lambda step: True) -> Resolution:
    """
    Choose modes and step of a scene for the tip error that it states in `model.accuracy`.

    The scene's own motion is simulated with many modes and small steps. The choice is the least
    N, and the largest h for it, with which the tip's position in the world and its deflection in
    the arm frame stay within half the stated error of that run. It holds for that motion;
    where commands follow, the scene's own loads should be as rough as they are. What a
    formulation itself leaves out is not part of it.

    Parameters
    ----------
    scene : Scene
    duration : float
        Sim time to look at; 0: 10 s; at most 60 s are [s].
    fits : function(float) -> bool
        Whether a step [s] suits the caller.

    Returns
    -------
    Resolution

    Raises
    ------
    ParameterError
        If the scene is at rest, or no choice reaches the stated error.

    Examples
    --------
    >>> import timo_sim
    >>> scene = timo_sim.load_scene('paper', {'model.accuracy': 1e-3})
    >>> timo_sim.choose_resolution(scene, duration=1.0).scene.values['model.modes']
    2

    """
    goal = scene.values['model.accuracy']
    span = max(1, round(min(duration or HORIZON, LONGEST) / PERIOD))
    shares, truth = _tip(_with(scene, RICH_MODES, RICH_STEP), span)
    if truth is None or np.ptp(truth, axis=1).max() == 0.0:
        raise ParameterError(f'model.accuracy = {goal:g} m needs a scene that moves by its own '
                             'loads or initial motion, and stays finite')
    best = np.inf
    for modes in range(_enough(shares, goal), MOST_MODES + 1):
        for step in STEPS:
            if not fits(step):
                continue
            try:
                choice = _with(scene, modes, step)
            except ParameterError:  # a load that jumps inside such a step
                continue
            _, ours = _tip(choice, span)
            error = np.inf if ours is None else np.linalg.norm(ours - truth, axis=2).max()
            best = min(best, error)
            if error <= goal / MARGIN:
                return Resolution(choice, float(error))
            if step <= 0.001 and error > goal:  # of the modes: smaller steps will not help
                break
    raise ParameterError(f'model.accuracy = {goal:g} m is not reached, but {MARGIN * best:.1e} m '
                         f'is, with up to {MOST_MODES} modes')


def resolved(scene, duration):
    """
    Return the scene, with modes and step chosen if it asks for that, and its number of steps.

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or no choice is good enough.

    """
    if scene.values['model.accuracy']:
        scene = choose_resolution(scene, duration).scene
    return scene, whole_ratio('duration', duration, 'integrator.step', scene.step)


def _with(scene, modes, step):
    return scene_from({**scene.values, 'model.accuracy': 0.0, 'model.modes': modes,
                       'integrator.step': step})


def _tip(scene, span):
    # The modes' shares in the tip deflection, shape (n, N) [m], and the tip in the world and
    # in the arm frame, shape (2, n, 2) [m], or None if the run diverges.
    simulator, sample_every = Simulator(scene), round(PERIOD / scene.step)
    simulator.warm_up()
    model = simulator.model
    try:
        motions = simulator.advance(span * sample_every, sample_every=sample_every)[0]
    except DivergenceError:
        return None, None
    tip, q = model.tip_point, Motion(motions).q
    return q * tip.deflection[:, 0], np.stack([model.world(motions, tip)[:, 0],
                                               model.centre_line(q, tip)[:, 0]])


def _enough(shares, goal):
    # The first N without whose rest of the modes the deflection is within the goal: a guess that
    # spares the trial of fewer.
    rest = np.abs(np.cumsum(shares[:, ::-1], axis=1)).max(axis=0)[::-1]
    return min(int(np.argmax(np.append(rest, 0.0) <= goal)), MOST_MODES)
