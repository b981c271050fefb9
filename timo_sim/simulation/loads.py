# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Loads of coming steps: the scene's own, what actuators make of commands, the load at the tip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
import math
from typing import Any, NamedTuple

import numpy as np

from timo_sim.compiled.constants import pack, Packed
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import (
    INPUTS, LOADS, rotate, STEP_LOADS, TIP_I, TIP_II, TORQUE, VOLTAGE)
from timo_sim.model.statics import pick_up
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.parameters import did_you_mean, numbers, ParameterError, short
from timo_sim.scene.scene import Scene
from timo_sim.steps import loads as steps_loads
from timo_sim.steps.steps import NO_LOADS
from timo_sim.topics.commands import has_tip_force

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
    Return commands, by name of ARGUMENTS, as a load or many loads, shape (*many, LOADS).

    `values` has carrier.held and what `Input.needs` names, as arrays of shape `many`.
    Commands are for all loads, or have an element for each. Raises ParameterError if a name is
    unknown, a command has not the right number of finite values, or an input has no effect: a
    voltage needs a DC motor, an acceleration a carrier that is held.
    """
    check_arguments(commands, 'step')
    load = np.zeros((*many, LOADS))
    for name, given in commands.items():
        columns = ARGUMENTS[name]
        if isinstance(given, (int, float)) and isinstance(columns, int) and (
                abs(given) < 1e300 and not INPUTS[columns].needs):  # the most frequent case
            load[..., columns] = given
            continue
        shape = np.shape(columns)
        load[..., columns] = numbers(name, given, *dict.fromkeys([shape, (*many, *shape)]))
        for column in columns if shape else [columns]:
            each, found = INPUTS[column], load[..., column]
            if each.needs:
                idle, what = np.asarray(values[each.needs]) == 0.0, f'{each.needs} > 0, got 0'
            elif each.group == 'base':
                idle = ~np.isin(values['carrier.held'], (each.name[-1], 'both'))
                what = f'a carrier that is held along {each.name[-1]}'
            else:
                continue
            if (lacking := found[(found != 0.0) & idle]).size:
                raise ParameterError(
                    f'{each.name} = {lacking.flat[0]:g} {each.unit} needs {what}')
    return load


def unit_loads(values: Mapping[str, Any], inputs: Iterable[str]) -> np.ndarray:
    """Return what one of each input adds to a load, shape (k, LOADS); the names are ARGUMENTS."""
    inputs = list(inputs)
    check_arguments(inputs, 'inputs')
    columns = [column for name in inputs for column in np.ravel(ARGUMENTS[name])]
    for each in (INPUTS[column] for column in columns):
        if each.needs and not values[each.needs]:
            raise ParameterError(f'input {each.name} needs {each.needs} > 0, got 0')
    return unit_loads_of(values, columns)


def unit_loads_of(values: Mapping[str, Any], columns: Sequence[int]) -> np.ndarray:
    """Return what one in each of some columns adds to a load; a voltage adds its torque, too."""
    unit = np.zeros((len(columns), LOADS))
    unit[range(len(columns)), columns] = 1.0
    unit[:, TORQUE] += motor_constants(values)[0] * unit[:, VOLTAGE]
    return unit


def whole_load(commanded: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """Return commands, an array of one of some shapes, or raise ParameterError; fast if right."""
    if isinstance(commanded, np.ndarray) and commanded.shape in shapes and (
            commanded.dtype.kind == 'f'):
        return commanded
    return numbers('commanded', commanded, *shapes)


def limits_of(values: Mapping[str, Any]) -> list[list[float]]:
    """Return the limits of commands and of their rates, infinite without, shape (2, LOADS)."""
    return [[values[name] if name else math.inf for name in names]
            for names in zip(*((each.limit, each.rate_limit) for each in INPUTS))]


class Actuators:
    """
    The actuators of a scene, which turn commands into loads; the scene's own loads bypass them.

    The goal of a force or torque is its command, clipped at its limit. With a limit of its rate it
    moves to the goal on a straight line that begins at the step at which the goal changed, so that
    what acts in a step does not depend on how many steps are done at once. They act from step
    `first` on; `values` are the scene's parameters.
    """

    def __init__(self, values: Mapping[str, Any], first: int = 0) -> None:
        self._constants = values['integrator.step'], motor_constants(values)[0], limits_of(values)
        self._first, self._commanded = first, np.zeros(LOADS)

    @cached_property
    def packed(self) -> Packed:
        """The constants with the memory of the actuators, see `steps.loads.Actuators`."""
        step, gain, limits = self._constants
        limit, rate = np.array(limits)
        return pack(steps_loads.Actuators(
            step=step, gain=gain, limit=limit, rate=rate, goal=np.zeros(LOADS),
            origin=np.zeros(LOADS), since=np.array([self._first])))

    @property
    def slow(self) -> np.ndarray:
        """Columns of a load with a limit of their rate."""
        return np.flatnonzero(np.isfinite(self.packed.rate))

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
        self._commanded[:] = commanded  # callers may free the memory of theirs
        self._add(self._commanded, first, len(loads), loads)


_AHEAD = 256  # least number of steps that are tabulated at once
_FEW = 8  # most steps whose loads are copied: compiled functions take the same array faster again


class LoadTable:
    """Loads of steps; the steps are counted from the start of the scene's own loads."""

    def __init__(self, scene: Scene, actuators: Actuators) -> None:
        self._load, self._step, self.actuators = scene.load, scene.step, actuators
        self._begin, self._block, self._room, self._sums = 0, NO_LOADS, NO_LOADS, NO_LOADS

    def stages(self, first: int, count: int, commanded: np.ndarray | None = None) -> np.ndarray:
        """
        Return the loads of steps, shape (count, 4, LOADS), valid until the next call.

        They include those of `commanded`, shape (LOADS,), commands from step `first` on.
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


class TipLoad(NamedTuple):
    """
    Mass and inertia at the tip; the modes stay those of the end effector of the first scene.

    `tip` is mass [kg], inertia [kg m2] and offset [m] now, `lost` the energy lost in plastic
    impacts since the initial motion [J], `changes` how many changes that the scene prescribes are
    made.
    """

    tip: tuple[float, ...]
    lost: float = 0.0
    changes: int = 0

    def replaced(self, tip: tuple[float, ...], scene: Scene, model: Formulation,
                 motion: np.ndarray) -> tuple[TipLoad, np.ndarray]:
        """
        Return the TipLoad with other mass and inertia, and the motion (2 (3 + N),) after that.

        `scene` and `model` are those with the new load. Sections keep place and velocity, since
        the modes do; a load that is picked up from rest changes velocities, see `model.statics`.
        """
        load = added_load(self.tip, tip)
        if scene.values['end_effector.pick_up'] != 'at_rest' or not any(load[:2]):
            return self._replace(tip=tip), motion
        motion, lost = pick_up(model, motion, *load)
        return self._replace(tip=tip, lost=self.lost + lost), motion


def added_load(before: Sequence[float], tip: Sequence[float]) -> tuple[float, float, float]:
    """Return mass [kg], inertia about its centre [kg m2] and offset [m] of what a tip picks up."""
    (mass_before, inertia_before, offset_before), (mass, inertia, offset) = before, tip
    added, own, place = max(mass - mass_before, 0.0), inertia - inertia_before, 0.0
    if added:
        place = (mass * offset - mass_before * offset_before) / added
        own += mass * offset**2 - mass_before * offset_before**2 - added * place**2
    return added, max(own, 0.0), place


def tip_of(scene: Scene) -> tuple[float, float, float]:
    """Return mass [kg], inertia [kg m2] and offset [m] of a scene's end effector."""
    body = scene.manipulator
    return body.end_effector_mass, body.end_effector_inertia, body.end_effector_offset


def pieces(scene: Scene, steps: np.ndarray,
           payloads: Sequence[tuple[Any, ...]]) -> list[tuple[Formulation, slice]]:
    """
    Return the formulations of a run whose load at the tip changes, each with its samples.

    `steps`, shape (n,), are those of the samples, ascending; a sample at the step of a change is
    from before it. If there are several, which a reset divides, the last is from after it.
    `payloads` are the changes: step, then mass [kg], inertia [kg m2] and offset [m], ascending.
    """
    first, last = (np.searchsorted(steps, [step for step, *_ in payloads], side)
                   for side in ('left', 'right'))
    bounds = [0, *(last - (last - first > 1)), len(steps)]
    tips = [None, *(tuple(tip) for _, *tip in payloads)]
    return [(scene.build(tip), slice(first, last))
            for tip, first, last in zip(tips, bounds, bounds[1:]) if first < last]


def load_of_commands(commanded: np.ndarray, simulator: Any) -> np.ndarray:
    """
    Return the load, (LOADS,), of commanded values, (COMMANDED,), in a Simulator's next step.

    A force in the axes of the tip takes their direction in the middle of the step, extrapolated
    from the motion at its start: the error is of second order in the step.
    """
    if not has_tip_force(commanded):
        return commanded[:LOADS]
    load, motion, model = commanded[:LOADS].copy(), simulator.motion, simulator.model
    middle = motion.q + 0.5 * simulator.scene.step * motion.qdot
    rotation = model.section_rotation(middle, model.tip_point)[0]
    load[[TIP_I, TIP_II]] += rotate(float(rotation), *commanded[LOADS:])
    return load
