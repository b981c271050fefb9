"""From a scene to a run: the integrator with its state, and the whole run at once."""

import warnings

import numpy as np

from timo_sim.actuators import Actuators
from timo_sim.cautions import after_steps, divergence, unseen_load, wrong_step
from timo_sim.parameters import ParameterError, whole_ratio
from timo_sim.physics import etdrk4, friction
from timo_sim.physics.compiled import compiling, record, size_mark
from timo_sim.physics.formulation import LOADS
from timo_sim.run import Run
from timo_sim.step_control import StepControl

# Steps whose loads are worked out at once: enough to make that cheap.
_CHUNK, _FEW = 512, 256
# The error of a step is looked at at the start, after so many steps, twice as many, and so on up
# to each chunk: what begins wildly calms down, as a rule.
_FIRST_LOOK = 128
# Deflection that is no arm's any more, in arm lengths.
_MOST_BENT = 10.0
_NO_LOADS = np.zeros((0, etdrk4.STAGES, LOADS))


class DivergenceError(ArithmeticError):
    """The state stops being that of an arm, or finite; the text says when, and what to do."""


class ModelWarning(UserWarning):
    """A run left the region in which its equations hold; the text says which, and what to do."""


class Simulator:
    """
    A scene at a certain step: what both the node and `simulate` advance.

    Attributes
    ----------
    scene : Scene
    formulation : Formulation
    control : StepControl
    steps : int
        Steps done since the start; sim time is `steps * scene.step`.
    caution : str or None
        That the run has left the region in which its equations hold, and what to do.

    """

    def __init__(self, scene):
        self.scene = scene
        self.formulation = scene.build()
        self.control = StepControl(scene, self.formulation)
        limits = scene.friction
        self._joints = record(friction.Joints(limits, scene.step)) if limits.any() else None
        self.steps = 0
        self.reset()

    def reset(self):
        """Return to the initial motion and the start of the loads; the count of steps goes on."""
        motion = self.scene.initial_motion()
        self._state = self.formulation.state(motion)
        self._friction = np.zeros(friction.KEPT)
        # Without speeds, deflection, loads and drive nothing changes until the first command.
        self._resting = not (self.scene.load or self.scene.load.drive or motion[3:].any())
        self._origin = self.steps
        self._next_look = self.steps
        self._block = 0, _NO_LOADS
        self._actuators = Actuators(self.scene.values)
        self._load = self.scene.load.stages(0, 1, self.scene.step)[0, 0]
        self.caution = unseen_load(self.scene)

    def change(self, scene):
        """
        Go on with another scene: other loads, damping, viscous friction or limits.

        Parameters
        ----------
        scene : Scene
            Of the same bodies, modes and time step.

        """
        first = self.steps - self._origin
        self._actuators = Actuators(scene.values, first, self._actuators.reached(first))
        self.scene, self.formulation = scene, scene.build()
        self.control = self.control.following(scene, self.formulation)
        self._resting = self._resting and not scene.load
        self._block = 0, _NO_LOADS
        self.caution = unseen_load(self.scene)

    @property
    def is_compiled(self):
        """Whether machine code for a formulation of this size is on disk."""
        mark = size_mark(*self._sizes())
        return mark is not None and mark.exists()

    def warm_up(self):
        """
        Compile, or load from disk, what `advance`, `motion` and `formulation.tip` call.

        What sensors call besides is compiled, too, but loaded only when one is asked.
        """
        with compiling(*self._sizes()):
            self.formulation.tip(self.motion())
            if self._joints is not None:  # the looks at the error of a step leave it out
                self.formulation.observe(self._state, self._load)
            if not self.is_compiled:
                self.formulation.rate(self._state, self._load)
            if self.control.tolerance:
                self.control.advance(self._state, self._load, _NO_LOADS, 0, None, 0)

    def _sizes(self):
        sizes = [self.formulation.packed, self.control.propagator()]
        if self._joints is not None:
            sizes.append(self._joints)
        # With a tolerance another function is compiled, of two propagators.
        return sizes + [self.control.propagator(1)] if self.control.tolerance else sizes

    @property
    def nanoseconds(self):
        """Sim time [ns]."""
        return round(self.steps * self.scene.step * 1e9)

    def scene_loads(self, count):
        """Return the scene's own loads of the next steps, shape (count, 3, 14)."""
        first = self.steps - self._origin
        begin, block = self._block
        if not begin <= first <= first + count <= begin + len(block):
            # A node asks for few at a time.
            ahead = count if count >= _FEW else _CHUNK
            begin, block = first, self.scene.load.stages(first, ahead, self.scene.step)
            self._block = begin, block
        return block[first - begin:first - begin + count]

    def advance(self, steps, held=None, every=0, heats=None):
        """
        Do some steps.

        Parameters
        ----------
        steps : int
        held : ndarray, shape (14,), optional
            What is commanded during all of them, see `physics.formulation`; it acts besides the
            scene's own loads, as the actuators let it.
        every : int
            Steps between samples; 0: none are taken.
        heats : ndarray, shape (1 + steps // every,), optional
            Receives `heat` at the samples.

        Returns
        -------
        ndarray, shape (1 + steps // every, 2 (3 + N))
            Motions at the start and after each `every` steps; with every = 0 empty.

        Raises
        ------
        DivergenceError
            The state is then that before the first step that fails.

        """
        if self._rests(steps, held):
            self.steps += steps
            motions = np.empty((1 + steps // every if every else 0, self.formulation.size))
            if every:
                motions[:] = self.motion()
            return motions
        before = self._state.copy(), self._friction.copy()
        first = self.steps - self._origin
        actuators = None
        if held is not None:
            actuators = self._actuators
            actuators.command(held, first)
        if self.control.tolerance:
            loads = self.control.loads(first, steps, actuators, 1)
            done, motions = self.control.advance(
                self._state, self._load, loads, first, actuators, every)
        else:
            loads = self.scene_loads(steps)
            if actuators:
                loads = loads + actuators.loads(first, steps)
            self._watch_error(loads)
            done, motions = self._integrate(loads, every, heats)
        if done < steps or not self._bent() <= _MOST_BENT * self.scene.manipulator.arm.length:
            self._give_up(before, steps, held)
        self.steps += steps
        if steps:
            self._load = loads[-1, -1].copy()
        self.caution = self.caution or after_steps(self, motions)
        return motions

    def _integrate(self, loads, every, heats=None):
        # As `Formulation.advance`, with friction if there is any.
        rest = self._state, self._load, loads, every
        if self._joints is None:
            return self.formulation.advance(self.control.propagator(), *rest)
        motions = np.empty((1 + len(loads) // every if every else 0, self.formulation.size))
        heats = np.empty(len(motions)) if heats is None else heats
        done = friction.advance(self.formulation.packed, self.control.propagator(), self._joints,
                                self._friction, *rest, motions, heats)
        return done, motions

    def _rests(self, steps, held):
        # Whether these steps would leave the state as it is, to the last bit.
        self._resting = self._resting and (held is None or not held.any())
        return self._resting and steps > 0

    @property
    def spacing(self):
        """Steps from one look at the error of a step to the next."""
        return min(max(self.steps - self._origin, _FIRST_LOOK), _CHUNK)

    def tip_acceleration(self):
        """Return the tip's acceleration in world axes at the last step's end, (2,) [m/s2]."""
        load = self._load
        if self._joints is not None:
            load = load.copy()
            load[list(friction.COLUMNS)] += self.friction
        return self.formulation.tip_acceleration(self._state, load)

    @property
    def load(self):
        """Load at the end of the last step, shape (14,), see `physics.formulation`."""
        return self._load

    def motion(self):
        """Return the motion now, shape (2 (3 + N),), see `physics.formulation`."""
        return self._integrate(_NO_LOADS, every=1)[1][0]

    @property
    def friction(self):
        """Coulomb friction on carrier x, y [N], shaft [N m] at the last step's end, shape (3,)."""
        return self._friction[:friction.HEAT].copy()

    @property
    def heat(self):
        """What Coulomb friction has made of work since the initial motion [J]."""
        return float(self._friction[friction.HEAT])

    @property
    def astray(self):
        """How far joints went astray in steps with friction, summed up, as at the tip [m]."""
        if self._joints is None:
            return 0.0
        length = self.scene.manipulator.arm.length
        return float(self._friction[friction.ASTRAY:] @ [1.0, 1.0, length])

    def _watch_error(self, loads):
        # Now and then, at the first of some steps.
        if self.caution or not len(loads) or self.steps < self._next_look:
            return
        self._next_look = self.steps + self.spacing
        error, alarming = self.control.look_ahead(self._state, loads[:1])
        if alarming:
            self.caution = wrong_step(self, error)

    def _bent(self):
        # Deflection by all modes together [m].
        modes = self.formulation.reach[3:]
        half = len(self._state) // 2
        return np.abs(self._state[half - len(modes):half]) @ modes

    def _give_up(self, before, steps, held):
        # Go to the last good state and say what it is.
        self._state, self._friction = before
        if steps > 1:
            for part in (steps // 2, steps - steps // 2):
                self.advance(part, held)
        raise DivergenceError(divergence(self, self._bent()))


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
        If the state stops being that of an arm, or finite.

    Warns
    -----
    ModelWarning
        If the shaft becomes too fast for a formulation without centrifugal stiffening, or steps
        are too long for what happens or for a harmonic load.

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
    motion[0], heat = simulator.motion(), np.zeros(len(motion))
    while simulator.steps < steps:
        first = simulator.steps
        count = min(max(1, simulator.spacing // every) * every, steps - first)
        samples = slice(first // every, (first + count) // every + 1)
        motion[samples] = simulator.advance(count, every=every, heats=heat[samples])
        report(count)
    t = np.arange(0, steps + 1, every) * scene.step
    return Run(scene, simulator.formulation, t, motion, heat), simulator.caution
