# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The simulator: a scene advanced in time, with tables of loads, time steps and warnings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
import math
import os
import threading
from typing import Any, NamedTuple
import weakref

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.compiled.machine import telling
from timo_sim.model.formulation import PointsOfArm
from timo_sim.model.layout import AFTER, LOADS, Motion
from timo_sim.scene.parameters import (
    check_runtime, checked, FLAG, FUNCTION, numbers, Parameter, ParameterError, steps_in,
    TEXTS)
from timo_sim.scene.scene import load_scene, scene_from, SceneLike
from timo_sim.simulation import warnings
from timo_sim.simulation.loads import (
    Actuators, commanded_load, LoadTable, tip_of, TipLoad, unit_loads, whole_load)
from timo_sim.simulation.snapshot import Sensors, Snapshot
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.steps.derivatives import step_derivatives
from timo_sim.steps.sensors import add_errors
from timo_sim.steps.steps import CHUNK, NO_LOADS, Samples, Steps

# Deflection beyond which the run counts as diverged, in arm lengths.
MOST_BENT = 10.0
COUNT = Parameter('count', 1, '', 'number of steps', low=0, high=2**53)
SAMPLE_EVERY = replace(COUNT, name='sample_every', meaning='steps between samples, 0: none')
_STEPS_A_CHECK = 8  # single steps from one check for warnings to the next


_locks: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()  # the oldest first
_forking = threading.local()  # the locks that a thread which forks has taken


def new_lock() -> Any:
    """Return a lock of the steps of a run, for which a fork waits."""
    lock = threading.RLock()
    _locks[lock] = None
    return lock


# A fork waits for the steps of other threads: in the child these would never end. A run is older
# than its finer run, whose lock it takes while it holds its own.
def _before_fork():
    _forking.locks = list(_locks)
    for lock in _forking.locks:
        lock.acquire()


def _after_fork():
    for lock in _forking.locks:
        lock.release()


os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork)


class Stateful:
    """What has a state: each copy, by `copy` or `pickle`, has its own; threads take turns."""

    _lock: Any

    def __new__(cls, *args, **keywords):
        made = super().__new__(cls)
        made._lock = new_lock()  # a diverged advance calls another
        return made

    def __getstate__(self):
        with self._lock:
            return deepcopy({name: each for name, each in vars(self).items() if name != '_lock'})


class StepDerivatives(NamedTuple):
    """
    Derivatives of the motion after some steps, see `Simulator.step_derivatives`.

    `by_motion`[i, j], (2 (3 + N), 2 (3 + N)), is that of its number i by number j of the motion
    before them, `by_input`, (2 (3 + N), k), are by the inputs, each constant during the steps.
    """

    by_motion: np.ndarray
    by_input: np.ndarray


class Simulator(Stateful, PointsOfArm):
    """
    A scene at a certain time step, advanced by the node, `simulate` or a controller's loop.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes

    Attributes
    ----------
    scene : Scene
    model : Formulation
    integration : Steps
        The time steps of the model.
    steps : int
        Steps done since the start; sim time is `steps * scene.step`.
    tip_load : TipLoad
        Mass and inertia at the tip now, and the energy lost in plastic impacts.
    warning : str or None
        Why the results should not be trusted, and the remedy.

    Examples
    --------
    >>> import timo_sim
    >>> simulator = timo_sim.Simulator(timo_sim.load_scene('paper'))
    >>> motion = simulator.step(torque=1.0, duration=0.002)
    >>> simulator.steps
    2

    """

    def __init__(self, scene: SceneLike) -> None:
        self.steps, scene = 0, load_scene(scene)
        self._first_tip = tip_of(scene)
        self.tip_load = TipLoad(self._first_tip)
        self._take(scene, scene.build())
        self._ends = self.integration.samples(1, 1)[1:]  # room for the samples of `step`
        self.reset()

    def _take(self, scene, model):
        self.scene, self.model = scene, model
        self.integration = Steps(self.model, scene.step, scene.bristles)
        travel = model.tip_travel[3:]
        self._travel = np.zeros(len(model.linear))  # of the tip by each number of the state
        self._travel[len(self._travel) // 2 - len(travel):len(self._travel) // 2] = travel
        self._most_bent = MOST_BENT * model.manipulator.arm.length

    def __repr__(self):
        return f'<Simulator at t = {self.t:.6g} s (step {self.steps}) of {self.scene!r}>'

    @property
    def t(self) -> float:
        """Sim time [s]."""
        return self.steps * self.scene.step

    @property
    def estimated_error(self) -> float:
        """NaN: an `EstimatingSimulator` estimates the error of the tip [m]."""
        return math.nan

    @property
    def estimated_deflection_error(self) -> float:
        """NaN, as well."""
        return math.nan

    @property
    def nanoseconds(self) -> int:
        """Sim time [ns]."""
        return round(self.steps * self.scene.step * 1e9)

    @property
    def load(self) -> np.ndarray:
        """Load at the end of the last step, or the start, shape (LOADS,), see `model.layout`."""
        return self._load.copy()

    @property
    def motion(self) -> Motion:
        """The motion now, see `Motion`."""
        with self._lock:
            return Motion(self.integration.motion(self._state, self._load))

    @property
    def sensors(self) -> Sensors:
        """What the sensors read now: encoder, root_strain, tip_acceleration, gyro."""
        return Sensors(self.snapshot())

    @property
    def effort(self) -> np.ndarray:
        """Efforts of carrier x, y [N] and shaft [N m], shape (3,), see `Snapshot.effort`."""
        return np.array(self.snapshot().effort)

    def snapshot(self) -> Snapshot:
        """Return a Snapshot of now, of one step also while another thread advances."""
        with self._lock:
            return Snapshot(scene=self.scene, model=self.model, step=self.steps,
                            motion=self.motion.values, load=self._load.tolist(),
                            acts=(self._state.copy(), self.integration.acting(self.load)))

    def reset(self) -> None:
        """Return to the initial motion and the start of the loads; the count of steps goes on."""
        with self._lock:
            tip, self.tip_load = self.tip_load.tip, TipLoad(tip_of(self.scene))
            if tip != self.tip_load.tip:
                self._take(self.scene, self.scene.build(self.tip_load.tip, self._first_tip))
            motion = self.scene.initial_motion(self.model)
            self._state = self.model.state(motion)
            self.integration.reset(motion)
            self._origin = self.steps
            self._table = LoadTable(self.scene, Actuators(self.scene.values))
            self._load = self.scene.load_at_start()
            self.warning = warnings.unseen_load(self.scene)

    def change(self, scene: SceneLike) -> None:
        """
        Go on with another scene: other loads, damping, viscous friction, limits or end effector.

        Raises ParameterError if parameters differ that cannot be set while it runs.
        """
        scene = load_scene(scene)
        check_runtime(self.scene.values, scene.values)
        scene = scene_from(scene.values, self.scene.static)  # whatever its end effector needs
        with self._lock:
            first = self.steps - self._origin
            actuators = self._table.actuators.changed(scene.values, first)
            changed = tip_of(scene) != tip_of(self.scene)
            self._continue_with(scene, tip_of(scene) if changed else self.tip_load.tip)
            self._table = LoadTable(scene, actuators)
            self.warning = warnings.unseen_load(scene)

    def _continue_with(self, scene, tip):
        # Go on with another scene, and a mass and inertia at the tip.
        earlier, motion = self.integration, self.motion.values
        self._take(scene, scene.build(tip, self._first_tip))
        self.integration.continue_from(earlier)
        if tip != self.tip_load.tip:
            self.tip_load, motion = self.tip_load.replaced(tip, scene, self.model, motion)
            self._state = self.model.state(motion)

    @checked(tell=FUNCTION, messages=FLAG)
    def warm_up(self, tell: Callable[[str], object] | None = None, messages: bool = False) -> None:
        """
        Compile, or load from disk, the functions that `advance` calls.

        With `messages`, also those that messages, sensors and commands need. `tell` is called with
        a text before a compilation, which takes a second or two.
        """
        with telling(tell):
            motion = self.motion.values
            if self.model.speed_limit < math.inf:  # for warnings
                self.model.rate(self._state, self._load)
            if messages:
                self.model.tip(motion)
                self._table.actuators.warm_up()
                add_errors.of(self.scene.sensor_errors)
                self.model.energy(motion[np.newaxis])
                self.snapshot().joints.reactions

    def step(self, *, duration: float | None = None, **commands: Any) -> Motion:
        """
        Advance under constant commands; the scene's own loads act as well.

        Parameters
        ----------
        duration : float, optional
            [s], a whole multiple of the time step; by default one step.
        **commands : float or sequence of float
            On the shaft `torque` [N m]; on the carrier `force`, on the tip `tip_force` and on the
            arm at `push.position` `push`, world x and y [N]; on the end effector `tip_torque`
            [N m]; at a DC motor `voltage` [V]; by default 0. They are those of
            `model.layout.INPUTS`.

        Returns
        -------
        Motion
            At the end.

        Raises
        ------
        ParameterError
            If a command is unknown, is not finite or has another shape, or the duration does not
            fit the step.
        DivergenceError
            As `advance` does.

        """
        commanded = commanded_load(self.scene.values, **commands)
        count = 1 if duration is None else steps_in(duration, self.scene.step)
        if not count:
            return self.motion
        with self._lock:
            self._advance(count, commanded, Samples(count, *self._ends))
            return Motion(self._ends[0][-1].copy())

    @checked(inputs=TEXTS)
    def step_derivatives(self, inputs: Sequence[str] = ('force', 'torque'), *,
                         duration: float | None = None, **commands: Any) -> StepDerivatives:
        """
        Advance as `step` does, and return the derivatives of the motion at the end.

        They are exact, through the stages of each step. Where something changes its course, as a
        gear in its play or a current at its limit does, they are those of the side that is taken.
        They are by what acts of commands: limits, also of rates, are not differentiated. How far
        dry friction is in its presliding at the start stays as it is. Rows and columns of
        coordinates that are held, locked or driven are 0.

        `inputs` are names of commands; those with two numbers give two columns. Raises
        ParameterError if an input is unknown or a load is picked up at rest in these steps, and
        the errors of `step`.

        Examples
        --------
        >>> import timo_sim
        >>> simulator = timo_sim.Simulator('paper')
        >>> found = simulator.step_derivatives(['torque'], duration=0.02, torque=1.0)
        >>> found.by_motion.shape, found.by_input.shape
        ((12, 12), (12, 1))

        """
        unit = unit_loads(self.scene.values, inputs)
        commanded = commanded_load(self.scene.values, **commands)
        count = 1 if duration is None else steps_in(duration, self.scene.step)
        found: Any = None

        def advance(state, load, loads, *others):
            nonlocal found
            found = step_derivatives(self.integration, state, load, loads, unit, found)
            return self.integration.advance(state, load, loads, *others)
        self._advance_with(advance, count, commanded)
        return StepDerivatives(*np.split(found[0], [self.model.size], axis=1))

    def _advance_with(self, advance: Callable[..., int], count: int,
                      commanded: np.ndarray) -> None:
        """
        Advance by `count` steps, or none, by a function that takes the place of `Steps.advance`.

        It needs derivatives: raises ParameterError if a load is picked up at rest in these steps.
        """
        with self._lock:
            if (self._next_tip < self.steps - self._origin + count
                    and self.scene.values['end_effector.pick_up'] == 'at_rest'):
                raise ParameterError(
                    'derivatives of steps need end_effector.pick_up = moving, but a load is '
                    f'picked up at rest at step {self._next_tip}')
            self._advance(count, commanded, self.integration.samples(0, 0), advance)

    def set_motion(self, motion: Motion | ArrayLike) -> None:
        """
        Go on from another motion, (2 (3 + N),), such as one that was measured or is to be tried.

        Coordinates that are held, locked or driven keep their own. Raises ParameterError if it has
        another shape or is not finite.
        """
        values = numbers('motion', motion, (self.model.size,))
        with self._lock:
            self._state = self.model.state(values)

    def advance(self, count: int, commanded: np.ndarray | None = None,
                sample_every: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """
        Advance by `count` steps.

        `commanded`, shape (LOADS,), are commands during all of them, see `model.layout`, which act
        besides the scene's loads. Samples are taken each `sample_every` steps, with 0 none.

        Returns
        -------
        motions : ndarray, shape (1 + count // sample_every, 2 (3 + N))
            At the start and after each `sample_every` steps; with sample_every = 0 empty.
        heat : ndarray, shape (1 + count // sample_every,)
            Energy that dry friction has taken since the initial motion, at the samples [J].

        Raises
        ------
        DivergenceError
            If the state is not finite or the arm bent by more than ten lengths; the simulator is
            then at the last good step.
        ParameterError
            If `count` or `sample_every` is negative or no whole number, or `commanded` has
            another shape.

        """
        if not type(count) is type(sample_every) is int or (count | sample_every) >> 53:
            count, sample_every = COUNT.check(count), SAMPLE_EVERY.check(sample_every)
        if commanded is not None:
            commanded = whole_load(commanded, (LOADS,))
        with self._lock:
            samples = self.integration.samples(count, sample_every)
            self._advance(count, commanded, samples)
            return samples.motions, samples.heat

    def _advance(self, count, commanded, samples, advance=None):
        # After a DivergenceError the samples have what they should until the last good step.
        if not count:  # no step samples the start, if it is to be sampled
            (advance or self.integration.advance)(
                self._state, self._load, NO_LOADS, samples, 0)
        before = (self._state.copy(), self._load.copy(), self.integration.memory.copy(),
                  self.tip_load, self.model, self.integration)
        first, done, change = self.steps - self._origin, 0, self._next_tip
        while done < count:
            number, sample = first + done, None
            if change <= number:
                sample, change = self._change_tip(number), self._next_tip
            part = min(count - done, CHUNK, change - number)
            loads = self._table.stages(number, part, commanded)
            reached = (advance or self.integration.advance)(
                self._state, self._load, loads, samples, done)
            if sample is not None and samples.every and done % samples.every == 0:
                samples.motions[done // samples.every] = sample  # that before the load changes
            self._load[:] = loads[-1, AFTER]
            done += reached
            bend = abs(self._state).dot(self._travel)
            if reached < part or not bend <= self._most_bent:
                self._give_up(before, count, commanded)
        self.steps += count
        self._note(count, commanded, samples)

    def _note(self, count, commanded, samples):
        # Check for warnings. This costs many steps: it is done after every 8th of single steps.
        if self.model.speed_limit < math.inf and (count > 1 or self.steps % _STEPS_A_CHECK == 1):
            seen = np.vstack([samples.motions, self.motion.values])
            share = self.model.axial_share(self._state, self.integration.acting(self._load))
            self.warning = self.warning or warnings.after_steps(
                self.scene, self.model, share, self.t, seen)

    @property
    def _next_tip(self):
        # Step at which the scene changes the load at the tip next; infinite: never.
        payloads, changes = self.scene.payloads, self.tip_load.changes
        return payloads[changes][0] if changes < len(payloads) else math.inf

    def _change_tip(self, number):
        # Make the changes of the load at the tip that are due; return the motion before.
        before = self.motion.values
        while self._next_tip <= number:
            changes = self.tip_load.changes
            self._continue_with(self.scene, self.scene.payloads[changes][1:])
            self.tip_load = self.tip_load._replace(changes=changes + 1)
        return before

    def _give_up(self, before, count, commanded):  # return to the last good state and raise
        self._state, self._load, memory, tip_load, self.model, self.integration = before
        self.integration.memory, self.tip_load = memory, tip_load
        if count > 1:  # to find the step: one half diverges again, and raises
            for part in (count // 2, count - count // 2):
                self.advance(part, commanded)
        raise DivergenceError(warnings.divergence(
            self.scene, self.model, self.steps, self.motion.values, self.warning))
