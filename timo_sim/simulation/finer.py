# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Finer scenes, from whose tip the error of a run is measured, and Simulators that run one.

A finer run has one or two more modes in bending and more axial modes, `exact` equations, and a
step of half the length, or less where it must resolve more. The distance between the tips of both
runs is the estimated error: nothing about the motion is assumed, so it also holds where errors
grow.

Axial vibrations are much faster than what a step resolves. The stretch that matters follows slow
forces, and a critically damped axial mode follows them in steps of any length: of a motion at the
frequency Omega its stretch is wrong by 2 Omega / omega of itself, a few per cent.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
import math
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from timo_sim.compiled.machine import telling
from timo_sim.model.formulation import Formulation
from timo_sim.model.modes import axial_modes
from timo_sim.scene.loads import on_boundaries
from timo_sim.scene.parameters import (
    checked, FLAG, FUNCTION, MODAL, ParameterError, PARAMETERS, WHOLE)
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.scene.static_shapes import (
    AXIAL_PHASE, MORE_MODES, needed_static_of_finer, one_more_does)
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.warnings import DivergenceError, inaccurate, NO_FINER_RUN, unseen_load
from timo_sim.steps.steps import CHUNK

_STRETCHES = 3  # they answer centrifugal forces, an acceleration, a force on the tip
PARTS = 2, 8, 32  # of a step, from which those of the finer run are chosen
_PARTS_OF_EVENTS = 4, 8, 32  # the same where errors of steps fall more slowly
# A pick-up excites all modes, and the error falls only as 1/N: there are more of them.
_MODES_OF_IMPACT, _MOST_MODES = 4, 40 + MORE_MODES
_MODES_OF_PUSH = 2  # a force within the arm makes a kink, whose error falls slowly, too
_TIMES = [name for name in PARAMETERS if name.endswith('.time')]
_MAX_PENDING_CALLS = 256  # most calls of `advance` that a finer run may be behind
# A finer run advances by at least so many steps at a time: the call itself costs as much.
STEPS_BEHIND = 8


def refine(scene: Scene, parts: int, modes: int | None = None, axial: int | None = None,
           same_equations: bool = False, like: Scene | None = None) -> Scene:
    """
    Return a finer scene, with `parts` steps for each step of the scene.

    It has so many further `modes` in bending, by default two, or one with half steps, the usual
    case, where `one_more_does`, or three times the present ones where loads are picked up; and
    so many further `axial` modes, by default one, or all that answer loads if the scene has some.
    The first axial mode is critically damped if its steps do not resolve it. Its formulation is
    `exact`, and it has the static shapes that loads on the tip need, unless it has the
    `same_equations`; modes and shapes may be those of another one, `like` it. Its space contains
    that of the scene.
    """
    values, static, one = scene.values, scene.static, False
    bending, stretching = values['model.modes'], values['model.axial_modes']
    if like is not None:
        modes, static = like.values['model.modes'] - bending, like.static
    elif modes is None:
        pushed = scene.load.terms['push_x'] or scene.load.terms['push_y']
        times = _MODES_OF_IMPACT if scene.payloads else _MODES_OF_PUSH if pushed else 1
        one = times == 1 and parts == PARTS[0] and one_more_does(
            scene.manipulator, bending, static)
        modes = 1 if one else min(times * bending + MORE_MODES, _MOST_MODES) - bending
    if axial is None:
        axial = max(_STRETCHES - stretching, 1) if stretching else 1
    if not bending:
        modes = axial = 0  # a rigid arm stays rigid
    if not same_equations and not one and like is None:
        static += tuple(load for load in needed_static_of_finer(
            scene.manipulator, bending + modes) if load not in static)
    if not scene.manipulator.arm.stretches:
        axial = 0
    # Further modes have the damping of the last one, in terms of those of the clamped arm.
    damping = tuple(scene.build().damping.tolist())
    bent, stretched = damping[:bending] or (0.0,), damping[len(damping) - stretching:]
    further = (stretched or bent)[-1:]
    resolved = not (axial or stretching) or _axial_phase(scene, scene.step / parts) <= AXIAL_PHASE
    if axial and not stretching and not resolved:
        further = (1.0,)
    finer = {**values, 'arm.damping_of': 'clamped', 'arm.damping_ratio': (
                 *bent[:bending], *modes * bent[-1:], *stretched, *axial * further),
             'model.accuracy': 0.0, 'model.modes': bending + modes,
             'model.axial_modes': stretching + axial, 'integrator.step': scene.step / parts}
    # What counts as a boundary between two steps is one between two finer steps, too.
    finer.update((name, tuple(on_boundaries(values[name], scene.step).tolist()))
                 for name in _TIMES if values[name])
    if not same_equations:
        finer['model.formulation'] = 'exact'
    # Bodies and constraints are the same, and checked. The vibration of axial modes is seen, or
    # critically damped.
    found = replace(scene, step=scene.step / parts, values=MappingProxyType(finer), static=static,
                    keeps_axial=resolved or not stretching)
    size, shapes = bending + modes + len(static), scene.build().modes
    for name in MODAL:
        if q := scene.modal(name):  # a static shape is a sum of finer modes and shapes
            across = found.build().project_on_modes(lambda xi: shapes.deflection(xi) @ q,
                                                    lambda xi: shapes.rotation(xi) @ q)
            finer[name] = (*across[:size].tolist(), *q[bending + len(scene.static):],
                           *axial * (0.0,))
    return found


def choose_parts(scene: Scene) -> tuple[int, ...]:
    """Return the parts of a step that may do for a finer run, a tuple of int, fewest first."""
    # Events of dry friction and contacts of a gear are found to lower orders of the step; where a
    # table or drive bends inside of a step, errors of steps fall more slowly, too.
    inside = any(abs(time / scene.step - round(time / scene.step)) > 1e-6
                 for name in _TIMES for time in scene.values[name])
    events = scene.has_dry_friction or scene.values['motor.gear.backlash']
    tried = _PARTS_OF_EVENTS if inside or events else PARTS
    least = next((parts for parts in tried if _resolves(scene, scene.step / parts)), PARTS[-1])
    return tuple(parts for parts in tried if parts >= least)


def _resolves(scene, step):
    # Whether steps see the loads and what static shapes answer, and axial vibrations if the arm
    # stretches or picks up loads.
    axial = scene.values['model.axial_modes'] or (
        scene.payloads and scene.values['model.modes'] and scene.manipulator.arm.stretches)
    finer = replace(scene, step=step)
    return unseen_load(finer) is None and finer.fastest_shape == math.inf and not (
        axial and _axial_phase(scene, step) > AXIAL_PHASE)


def _axial_phase(scene, step):
    # Of the first axial vibration in a step [rad].
    count = max(1, scene.values['model.axial_modes'])
    return step * axial_modes(scene.manipulator, count, scene.constraints).omega[0]


def tip_distances(model: Formulation, motions: np.ndarray, other: Formulation,
                  others: np.ndarray) -> tuple[float, float]:
    """
    Return the largest distances between the tips of two models in world and arm frame [m].

    Their motions have shapes (n, 2 (3 + N)) and (n, 2 (3 + M)) and are at the same times. The
    second distance is that of the deflections: the shaft's error is in it, too.
    """
    world, arm = distances(model, motions, other, others).max(axis=1, initial=0.0).tolist()
    return world, arm


def distances(model: Formulation, motions: np.ndarray, other: Formulation,
              others: np.ndarray) -> np.ndarray:
    """Return the distances of both kinds at each time, shape (2, n)."""
    tips = _complex(model.tips(motions)), _complex(other.tips(others))
    places = [_complex(values) + np.exp(1j * values[:, 2]) * tip
              for values, tip in zip((motions, others), tips)]
    return np.abs([places[0] - places[1], tips[0] - tips[1]])


def _complex(values):
    return np.ascontiguousarray(values[:, :2]).view(complex)[:, 0]  # x + iy


class _Call(NamedTuple):
    # A call of `advance` that the finer run has yet to follow; motions are those after each step.
    steps: int
    commanded: np.ndarray | None
    motions: np.ndarray

    def kind(self) -> bytes | None:
        # Calls of an equal kind can be done as one.
        return None if self.commanded is None else self.commanded.tobytes()


class EstimatingSimulator(Simulator):
    """
    A Simulator that advances a finer run beside its own, to estimate its error.

    doc/scene.md says what that costs. `set_motion` is refused: the error would be that of another
    run.

    Attributes
    ----------
    finer : Simulator
        The finer run, which may be behind.

    """

    def __init__(self, scene: SceneLike) -> None:
        scene = load_scene(scene)
        self._parts = choose_parts(scene)[0]
        self.finer = Simulator(refine(scene, self._parts))
        super().__init__(scene)

    def reset(self) -> None:
        """As that of Simulator; the error begins anew."""
        with self._lock:
            super().reset()
            self.finer.reset()
            self._behind: list[_Call] = []
            self._errors, self._is_known, self._is_commanded = (0.0, 0.0), True, False
            # The finer run has its own equilibrium: the runs differ already at the start.
            self._compare(self.motion.values[np.newaxis], self.finer.motion.values[np.newaxis])

    def change(self, scene: SceneLike) -> None:
        """As that of Simulator."""
        scene = load_scene(scene)
        with self._lock:
            self.measure_error()
            super().change(scene)
            self.finer.change(refine(self.scene, self._parts, like=self.finer.scene))

    @checked(tell=FUNCTION, messages=FLAG)
    def warm_up(self, tell: Callable[[str], object] | None = None, messages: bool = False) -> None:
        """As that of Simulator."""
        super().warm_up(tell, messages)
        self.finer.warm_up(tell)
        with telling(tell):
            for each in self, self.finer:
                each.model.tip(each.motion.values)

    def set_motion(self, motion: Any) -> None:
        """Raise ParameterError."""
        raise ParameterError('set_motion needs a simulator that does not estimate its error: '
                             'take Simulator(scene)')

    @property
    def estimated_error(self) -> float:
        """Estimated error of the tip so far [m]; NaN if it is not known."""
        with self._lock:
            self.measure_error()
            return self._errors[0]

    @property
    def estimated_deflection_error(self) -> float:
        """The same of its deflection [m], which has the error of the shaft's angle, too."""
        with self._lock:
            self.measure_error()
            return self._errors[1]

    @checked(steps=WHOLE)
    def measure_error(self, steps: int = 0) -> bool:
        """
        Advance the finer run, and measure how far apart the tips of both runs are.

        It is advanced by at least `steps` steps, if it is that far behind; with 0 to the present.
        Return whether it was advanced.
        """
        with self._lock:
            number, found = 0, 0
            while number < len(self._behind) and not 0 < steps <= found:
                found, number = found + self._behind[number].steps, number + 1
            if found < steps or not number:
                return False
            calls, self._behind = self._behind[:number], self._behind[number:]
            if self._is_known:
                self._measure(calls)
            return True

    def _measure(self, calls):
        try:
            # Calls that differ in nothing but their number are one for the finer run.
            others = [self.finer.advance(
                self._parts * sum(call.steps for call in alike), alike[0].commanded,
                self._parts)[0][1:]
                for alike in (list(group) for _, group in groupby(calls, _Call.kind))]
        except DivergenceError:
            self._errors, self._is_known = (math.nan, math.nan), False
            self.warning = self.warning or NO_FINER_RUN
            return
        self._compare(np.vstack([call.motions for call in calls]), np.vstack(others))

    def _compare(self, motions, others):
        place, bend = tip_distances(self.model, motions, self.finer.model, others)
        self._errors = max(self._errors[0], place), max(self._errors[1], bend)
        self.warning = self.warning or inaccurate(
            self.scene, *self._errors, commanded=self._is_commanded)

    def _advance(self, count, commanded, samples, advance=None):
        if not self._is_known or samples.every == 1:
            super()._advance(count, commanded, samples, advance)
            return
        # Tips are compared after each step: a vibration may have the rate of the samples.
        for first in range(0, max(1, count), CHUNK):
            part = self.integration.samples(min(CHUNK, count - first), 1)
            super()._advance(len(part.heat) - 1, commanded, part, advance)
            if every := samples.every:
                rows = slice(-(-first // every), (first + len(part.heat) - 1) // every + 1)
                samples.motions[rows] = part.motions[-first % every::every]
                samples.heat[rows] = part.heat[-first % every::every]

    def _note(self, count, commanded, samples):
        super()._note(count, commanded, samples)
        if count and self._is_known:
            self._is_commanded |= commanded is not None and bool(commanded.any())
            self._behind.append(_Call(count, None if commanded is None else commanded.copy(),
                                      samples.motions[1:].copy()))
            # Motions of long calls would fill the memory.
            if len(self._behind) >= _MAX_PENDING_CALLS or count == CHUNK:
                self.measure_error()
