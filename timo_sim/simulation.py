"""From a scene to a run: the integrator with its state, and the whole run at once."""

import math
import warnings

import numpy as np

from timo_sim.parameters import ParameterError, whole_ratio
from timo_sim.physics import etdrk4
from timo_sim.physics.compiled import compiling, record, size_mark
from timo_sim.physics.formulation import LOADS
from timo_sim.run import Run

# Steps whose loads are worked out at once: long enough to make that cheap, short enough for a
# progress bar.
_CHUNK, _FEW = 2048, 256
_NO_LOADS = np.zeros((0, etdrk4.STAGES, LOADS))


class DivergenceError(ArithmeticError):
    """The state stopped being finite; the text says when, and what to do."""


class ModelWarning(UserWarning):
    """A run left the region in which its equations hold; the text says which, and what to do."""


class Simulator:
    """
    A scene at a certain step: what both the node and `simulate` advance.

    Attributes
    ----------
    scene : Scene
    formulation : Formulation
    steps : int
        Steps done since the start; sim time is `steps * scene.step`.
    caution : str or None
        That the run has left the region in which its equations hold, and what to do.

    """

    def __init__(self, scene):
        self.scene = scene
        self.formulation = scene.build()
        self._propagator = record(etdrk4.propagator(self.formulation.linear, scene.step))
        self.steps = 0
        self.reset()

    def reset(self):
        """Return to the initial motion and the start of the loads; the count of steps goes on."""
        motion = self.scene.initial_motion()
        self._state = self.formulation.state(motion)
        # Without speeds, deflection, loads and drive nothing changes until the first command.
        self._resting = not (self.scene.load or self.scene.load.drive or motion[3:].any())
        self._origin = self.steps
        self._block = 0, _NO_LOADS
        self._load = self.scene.load.stages(0, 1, self.scene.step)[0, 0]
        self.caution = None

    @property
    def is_compiled(self):
        """Whether machine code for a formulation of this size is on disk."""
        mark = size_mark(self.formulation.packed, self._propagator)
        return mark is not None and mark.exists()

    def warm_up(self):
        """Compile, or load from disk, what `advance`, `motion` and `formulation.tip` call."""
        with compiling(self.formulation.packed, self._propagator):
            self.formulation.tip(self.motion())

    @property
    def nanoseconds(self):
        """Sim time [ns]."""
        return round(self.steps * self.scene.step * 1e9)

    def scene_loads(self, count):
        """Return the scene's own loads of the next steps, shape (count, 3, 8)."""
        first = self.steps - self._origin
        begin, block = self._block
        if not begin <= first <= first + count <= begin + len(block):
            # A node asks for few at a time.
            ahead = count if count >= _FEW else _CHUNK
            begin, block = first, self.scene.load.stages(first, ahead, self.scene.step)
            self._block = begin, block
        return block[first - begin:first - begin + count]

    def advance(self, loads, every=0):
        """
        Do as many steps as there are loads.

        Parameters
        ----------
        loads : ndarray, shape (steps, 3, 8)
            See `physics.etdrk4.advance`.
        every : int
            Steps between samples; 0: none are taken.

        Returns
        -------
        ndarray, shape (1 + steps // every, 2 (3 + N))
            Motions at the start and after each `every` steps; with every = 0 empty.

        Raises
        ------
        DivergenceError
            The state is then the last finite one.

        """
        if self._rests(loads):
            self.steps += len(loads)
            motions = np.empty((1 + len(loads) // every if every else 0, self.formulation.size))
            if every:
                motions[:] = self.motion()
            return motions
        done, motions = self.formulation.advance(self._propagator, self._state, self._load, loads,
                                                 every)
        self.steps += done
        if done:
            self._load = loads[done - 1, -1].copy()
        self._watch_speed(motions)
        if done < len(loads):
            raise DivergenceError(
                f'the state is not finite after t = {self.steps * self.scene.step:.6g} s '
                f'(step {self.steps}): ' + (self.caution or 'take fewer model.modes, a smaller '
                                            'integrator.step or model.formulation exact'))
        return motions

    def _rests(self, loads):
        # Whether these steps would leave the state as it is, to the last bit.
        self._resting = self._resting and not loads.any()
        return self._resting and len(loads) > 0

    def motion(self):
        """Return the motion now, shape (2 (3 + N),), see `physics.formulation`."""
        return self.formulation.advance(self._propagator, self._state, self._load, _NO_LOADS,
                                        every=1)[1][0]

    def _watch_speed(self, motions):
        limit, column = self.formulation.speed_limit, self.formulation.size // 2 + 2
        if math.isinf(limit) or self.caution:
            return
        speed = max(abs(self.motion()[column]), np.abs(motions[:, column]).max(initial=0.0))
        if speed > limit:
            self.caution = (
                f'at {speed:.3g} rad/s the shaft is faster than {limit:.3g} rad/s, where the arm '
                f'loses its stiffness in model.formulation '
                f'{self.scene.values["model.formulation"]}, which has no centrifugal stiffening: '
                'take model.formulation exact')


def simulate(scene, duration, every=1):
    """
    Simulate a scene under its own loads.

    On a terminal, a progress bar appears when the run takes more than a second.

    Parameters
    ----------
    scene : Scene
        With `model.accuracy`, modes and step are chosen first, see `settle`.
    duration : float
        [s], a whole multiple of the time step.
    every : int
        Steps between samples; divides the number of steps.

    Returns
    -------
    Run

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or `every` the number of steps.
    DivergenceError
        If the state stops being finite.

    Warns
    -----
    ModelWarning
        If the shaft becomes too fast for a formulation without centrifugal stiffening.

    """
    from tqdm import tqdm  # here: the node has no progress bar
    scene, steps = settled(scene, duration)
    if every < 1 or steps % every:
        raise ParameterError(f'every = {every} must divide the number of steps, {steps}')
    with tqdm(total=steps, unit='step', unit_scale=True, delay=1.0, disable=None,
              leave=False) as bar:
        run, caution = sampled_run(scene, steps, every, bar.update)
    if caution:
        warnings.warn(caution, ModelWarning, stacklevel=2)
    return run


def settled(scene, duration):
    """
    Return the scene with modes and step chosen if it asks for that, and its number of steps.

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or no choice is good enough.

    """
    if scene.values['model.accuracy']:
        from timo_sim.accuracy import settle  # which simulates, with what is in this module
        scene = settle(scene, duration).scene
    return scene, whole_ratio('duration', duration, 'integrator.step', scene.step)


def sampled_run(scene, steps, every=1, report=lambda count: None):
    """
    Do what `simulate` does, without bar and warning.

    Parameters
    ----------
    scene : Scene
    steps, every : int
    report : function(int)
        Receives how many further steps are done.

    Returns
    -------
    Run
    caution : str or None
        See `Simulator`.

    """
    simulator = Simulator(scene)
    simulator.warm_up()
    motion = np.empty((steps // every + 1, simulator.formulation.size))
    chunk = max(1, _CHUNK // every) * every
    for first in range(0, max(1, steps), chunk):
        count = min(chunk, steps - first)
        motion[first // every:(first + count) // every + 1] = simulator.advance(
            simulator.scene_loads(count), every)
        report(count)
    t = np.arange(0, steps + 1, every) * scene.step
    return Run(scene, simulator.formulation, t, motion), simulator.caution
