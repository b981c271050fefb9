# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Loads of coming steps: the scene's own, what actuators make of commands, the load at the tip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
import math
from typing import Any

import numpy as np

from timo_sim.compiled.constants import pack
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import INPUTS, LOADS, START, STEP_LOADS
from timo_sim.model.statics import pick_up
from timo_sim.scene.parameters import did_you_mean, ParameterError, short
from timo_sim.scene.scene import motor_constants, Scene
from timo_sim.steps import loads as steps_loads
from timo_sim.steps.steps import NO_LOADS

# Columns of a load that each argument of `Simulator.step` sets: one, or a list of two.
ARGUMENTS: dict[str, Any] = {}
for _column, _input in enumerate(INPUTS):
    if _input.argument in ARGUMENTS:
        ARGUMENTS[_input.argument] = [ARGUMENTS[_input.argument], _column]
    elif _input.argument:
        ARGUMENTS[_input.argument] = _column


def check_arguments(names: Iterable[str], source: str) -> None:
    """Raise ParameterError unless all are names of ARGUMENTS; `source` is what has them."""
    for name in names:
        if name not in ARGUMENTS:
            raise ParameterError(f'{source} has {short(name, str)}, which is none of '
                                 f'{", ".join(ARGUMENTS)}{did_you_mean(name, ARGUMENTS)}')


def commanded_load(values: Mapping[str, Any], many: tuple[int, ...] = (),
                   **commands: Any) -> np.ndarray:
    """
    Return commands as a load, or as many loads.

    Parameters
    ----------
    values : mapping
        By name the parameters that inputs need, see `Input.needs`; arrays of shape `many`.
    many : tuple of int
        Shape of the array of loads; the same shape precedes that of commands of their own.
    **commands : float or sequence of float
        By name of ARGUMENTS, see `Simulator.step`.

    Returns
    -------
    ndarray, shape (*many, LOADS)

    Raises
    ------
    ParameterError
        If a name is unknown, a command has not the right number of finite values, or a parameter
        that an input needs is 0: a voltage needs a DC motor.

    """
    check_arguments(commands, 'step')
    load = np.zeros((*many, LOADS))
    for name, given in commands.items():
        columns = ARGUMENTS[name]
        if isinstance(given, (int, float)) and isinstance(columns, int) and (
                math.isfinite(given) and not INPUTS[columns].needs):  # the most frequent case
            load[..., columns] = given
            continue
        shape = np.shape(columns)
        try:
            numbers = np.asarray(given, dtype=float)
            good = numbers.shape in (shape, (*many, *shape)) and np.isfinite(numbers).all()
        except (TypeError, ValueError):
            good = False
        if not good:
            kind = 'two finite numbers' if shape else 'a finite number'
            kind += f', or an array of them of shape {(*many, *shape)}' if many else ''
            raise ParameterError(f'{name} must be {kind}, got {short(given)}')
        load[..., columns] = numbers
        for column in columns if shape else [columns]:
            each, numbers = INPUTS[column], load[..., column]
            if each.needs:
                lacking = numbers[(numbers != 0.0) & (np.asarray(values[each.needs]) == 0.0)]
                if lacking.size:
                    raise ParameterError(f'{each.name} = {lacking.flat[0]:g} {each.unit} needs '
                                         f'{each.needs} > 0, got 0')
    return load


# Parameters from which actuators follow, beside the time step.
ACTUATOR_VALUES = [*{name for each in INPUTS for name in (each.limit, each.rate_limit)} - {''},
                   'motor.dc.resistance', 'motor.dc.torque_constant', 'motor.dc.gear_ratio']


class Actuators:
    """
    The actuators of a scene, which turn commands into loads; the scene's own loads bypass them.

    The goal of a force or torque is its command, clipped at its limit. With a limit of its rate it
    moves to the goal on a straight line that begins at the step at which the goal changed, so that
    what acts in a step does not depend on how many steps are done at once.

    Parameters
    ----------
    values : dict
        The scene's parameters, by name.
    first : int, optional
        Step from which they act.

    Attributes
    ----------
    packed : packed constants
        Of the compiled functions, with the memory of the actuators, see `steps.loads.Actuators`.
    limit : ndarray, shape (LOADS,)
        Limits of commands.
    slow : ndarray of int
        Columns of a load with a limit of their rate.
    gain : float
        Torque per voltage [N m/V].

    """

    def __init__(self, values: Mapping[str, Any], first: int = 0) -> None:
        limit = np.array([values[each.limit] if each.limit else np.inf for each in INPUTS])
        rate = np.array([values[each.rate_limit] if each.rate_limit else np.inf
                         for each in INPUTS])
        self.gain, _ = motor_constants(values)
        self.packed = pack(steps_loads.Actuators(
            values['integrator.step'], self.gain, limit, rate, np.zeros(LOADS), np.zeros(LOADS),
            np.array([first])))
        self.limit, self.slow = self.packed.limit, np.flatnonzero(np.isfinite(rate))

    def warm_up(self) -> None:
        """Compile, or load from disk, what loads and commands of all kinds need."""
        steps_loads.add_scene_loads.of()
        for entry in (steps_loads.add_commands, steps_loads.restart):
            entry.of(self.packed)

    def changed(self, values: Mapping[str, Any], first: int) -> Actuators:
        """Return actuators with other limits, which go on from what acts at step `first`."""
        found = Actuators(values, first)
        steps_loads.restart(self.packed, first)
        for name in ('goal', 'origin'):
            getattr(found.packed, name)[:] = getattr(self.packed, name)
        return found

    @cached_property
    def _add(self):
        return steps_loads.add_commands.of(self.packed)

    def add(self, commanded: np.ndarray, first: int, loads: np.ndarray) -> None:
        """Add what acts of commands from step `first` on to loads of steps, (count, 4, LOADS)."""
        self._add(commanded, first, len(loads), loads)


_AHEAD = 256  # least number of steps that are tabulated at once
_FEW = 8  # most steps whose loads are copied: compiled functions take the same array faster again


class LoadTable:
    """
    Loads of steps; the steps are counted from the start of the scene's own loads.

    Parameters
    ----------
    scene : Scene
    actuators : Actuators

    """

    def __init__(self, scene: Scene, actuators: Actuators) -> None:
        self._load, self._step, self.actuators = scene.load, scene.step, actuators
        self._begin, self._block, self._room, self._sums = 0, NO_LOADS, NO_LOADS, NO_LOADS

    def at_start(self) -> np.ndarray:
        """Return the scene's own load at its beginning, shape (LOADS,)."""
        return self._load.stages(0, 1, self._step)[0, START]

    def stages(self, first: int, count: int, commanded: np.ndarray | None = None) -> np.ndarray:
        """
        Return the loads of steps.

        Parameters
        ----------
        first, count : int
            Number of the first step, and number of steps.
        commanded : ndarray, shape (LOADS,), optional
            Commands from the first step on, whose loads are added.

        Returns
        -------
        ndarray, shape (count, 4, LOADS)
            Valid until the next call.

        """
        begin, block = self._begin, self._block
        if not begin <= first <= first + count <= begin + len(block):
            # A node asks for a few steps at a time, so more are tabulated ahead.
            ahead = max(count, _AHEAD)
            if len(self._room) < ahead:
                self._room = np.empty((ahead, STEP_LOADS, LOADS))
            begin, block = first, self._load.stages(first, ahead, self._step, self._room)
            self._begin, self._block = begin, block
        loads = block[first - begin:first - begin + count]
        if commanded is None and count > _FEW:
            return loads
        if len(self._sums) != count:
            self._sums = np.empty((count, STEP_LOADS, LOADS))
        self._sums[:] = loads
        if commanded is not None:
            self.actuators.add(commanded, first, self._sums)
        return self._sums


class TipLoad:
    """
    Mass and inertia at the tip; the modes stay those of the end effector of the first scene.

    Sections keep place and velocity, since the modes do; a load that is picked up from rest
    changes velocities, see `model.statics`.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    tip : tuple of float
        Mass [kg] and inertia [kg m2] now.
    lost : float
        Energy lost in plastic impacts since the initial motion [J].

    """

    def __init__(self, scene: Scene) -> None:
        self._first = self.tip = _own(scene)
        self._payloads, self._next, self.lost = scene.payloads, 0, 0.0

    def reset(self, scene: Scene) -> bool:
        """Return to the end effector of a scene, and whether that is another one than now."""
        before, self.tip, self._next, self.lost = self.tip, _own(scene), 0, 0.0
        return self.tip != before

    @property
    def next_step(self) -> float:
        """Number of the step at which the scene changes the load next; infinite: never."""
        return self._payloads[self._next][0] if self._next < len(self._payloads) else math.inf

    def take_next(self) -> tuple[float, float]:
        """Return mass and inertia from `next_step` on, and go to the change after it."""
        self._next += 1
        return self._payloads[self._next - 1][1:]

    def of_change(self, before: Scene, scene: Scene) -> tuple[float, float]:
        """Return mass and inertia after a change of the scene: its own, if it changes them."""
        return self.tip if _own(scene) == _own(before) else _own(scene)

    def add(self, tip: tuple[float, float]) -> list[float] | None:
        """Set mass and inertia; return what is added of each, or None if nothing changes."""
        before, self.tip = self.tip, tip
        return None if tip == before else [now - then for now, then in zip(tip, before)]

    def model(self, scene: Scene) -> Formulation:
        """Return the formulation of a scene with this load."""
        mass, inertia = self._first
        return scene.build(replace(scene.manipulator, end_effector_mass=mass,
                                   end_effector_inertia=inertia), self.tip)

    def picked_up(self, scene: Scene, model: Formulation, motion: np.ndarray,
                  added: Sequence[float]) -> np.ndarray:
        """Return the motion after mass and inertia are added."""
        taken = [max(change, 0.0) for change in added]
        if scene.values['end_effector.pick_up'] == 'at_rest' and any(taken):
            motion, lost = pick_up(model, motion, *taken)
            self.lost += lost
        return motion


def pieces(scene: Scene, steps: np.ndarray,
           payloads: Sequence[tuple[int, float, float]]) -> list[tuple[Formulation, slice]]:
    """
    Return the formulations of a run whose load at the tip changes, and their samples.

    Parameters
    ----------
    scene : Scene
    steps : ndarray of int, shape (n,)
        Of the samples, ascending; one at the step of a change is from before it. If there are
        several, which a reset divides, the last is from after it.
    payloads : sequence of (int, float, float)
        Step, mass [kg] and inertia [kg m2] from then on, ascending.

    Returns
    -------
    list of (Formulation, slice)

    """
    first, last = (np.searchsorted(steps, [step for step, *_ in payloads], side)
                   for side in ('left', 'right'))
    bounds = [0, *(last - (last - first > 1)), len(steps)]
    tips = [None, *((mass, inertia) for _, mass, inertia in payloads)]
    return [(scene.build(scene.manipulator, tip), slice(first, last))
            for tip, first, last in zip(tips, bounds, bounds[1:]) if first < last]


def _own(scene):
    return scene.manipulator.end_effector_mass, scene.manipulator.end_effector_inertia
