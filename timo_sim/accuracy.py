"""From a stated tip error to the fewest modes and the largest step that keep it."""

from typing import NamedTuple

import numpy as np

from timo_sim.parameters import ParameterError
from timo_sim.scene import Scene, scene_from
from timo_sim.simulation import DivergenceError, Simulator

STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # to choose from [s]
PERIOD = 0.02                      # of the samples that are compared [s]
HORIZON, LONGEST = 10.0, 60.0      # sim time looked at, if none is said, and at most [s]
RICH_MODES, RICH_STEP = 12, 0.0005  # what stands for the truth
MOST_MODES = 8                     # with up to these, the truth is much closer to itself
MARGIN = 2.0


class Settled(NamedTuple):
    """A scene with its modes and step chosen, and the estimated tip error [m]."""

    scene: Scene
    estimate: float

    def __str__(self):
        values, formulation = self.scene.values, self.scene.build()
        return (f'N = {values["model.modes"]} modes, n_g = {len(formulation.quadrature.nodes)} '
                f'nodes, h = {1e3 * self.scene.step:g} ms: estimated tip error '
                f'{self.estimate:.1e} m')


def settle(scene, duration=0.0, fits=lambda step: True):
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
    Settled

    Raises
    ------
    ParameterError
        If the scene is at rest, or no choice reaches the stated error.

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
                return Settled(choice, float(error))
            if step <= 0.001 and error > goal:  # of the modes: smaller steps will not help
                break
    raise ParameterError(f'model.accuracy = {goal:g} m is not reached, but {MARGIN * best:.1e} m '
                         f'is, with up to {MOST_MODES} modes')


def _with(scene, modes, step):
    return scene_from({**scene.values, 'model.accuracy': 0.0, 'model.modes': modes,
                       'integrator.step': step})


def _tip(scene, span):
    # The modes' shares in the tip deflection, shape (n, N) [m], and the tip in the world and
    # in the arm frame, shape (2, n, 2) [m], or None if the run diverges.
    simulator, every = Simulator(scene), round(PERIOD / scene.step)
    simulator.warm_up()
    formulation = simulator.formulation
    try:
        motions = simulator.advance(span * every, every=every)
    except DivergenceError:
        return None, None
    tip = formulation.at([scene.manipulator.arm.length])
    q = motions[:, 3:3 + len(formulation.modes)]
    return q * tip.deflection[:, 0], np.stack([formulation.world(motions, tip)[:, 0],
                                               formulation.centre_line(q, tip)[:, 0]])


def _enough(shares, goal):
    # The first N without whose rest of the modes the deflection is within the goal: a guess that
    # spares the trial of fewer.
    rest = np.abs(np.cumsum(shares[:, ::-1], axis=1)).max(axis=0)[::-1]
    return min(int(np.argmax(np.append(rest, 0.0) <= goal)), MOST_MODES)
