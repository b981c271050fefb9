# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Finer runs of a scene, from whose tip the error of a run is measured.

A finer run has two more modes in bending and more axial modes, `exact` equations, and a step
of half the length, or less where it must resolve more. The distance between the tips of both runs
is the estimated error: nothing about the motion is assumed, so it also holds where errors grow.

Axial vibrations are much faster than what a step resolves. The stretch that matters follows slow
forces, and a critically damped axial mode follows them in steps of any length: of a motion at the
frequency Omega its stretch is wrong by 2 Omega / omega of itself, a few per cent.
"""

from dataclasses import replace
from functools import partial
import math
from typing import Any

import numpy as np

from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import rotate
from timo_sim.model.modes import axial_modes
from timo_sim.scene.loads import on_boundaries
from timo_sim.scene.scene import AXIAL_PHASE, MORE_MODES, needed_static, Scene, scene_from
from timo_sim.simulation.warnings import unseen_load

_STRETCHES = 3  # they answer centrifugal forces, an acceleration, a force on the tip
PARTS = 2, 8, 32  # of a step, from which those of the finer run are chosen
# A load that is picked up excites modes without end: there the error falls as 1/N.
_MODES_OF_IMPACT, _MOST_MODES = 4, 40 + MORE_MODES
_MODES_OF_PUSH = 2  # a force within the arm makes a kink, whose error falls slowly, too
_LISTS = 'initial.modal_coordinates', 'initial.modal_rates'


def refine(scene: Scene, parts: int, modes: int | None = None, axial: int | None = None,
           same_equations: bool = False) -> Scene:
    """
    Return a finer scene, with `parts` steps for each step of the scene.

    It has so many further `modes` in bending, by default two, or three times the present ones
    where loads are picked up, too; and so many further `axial` modes, by default one, or all that
    answer loads if the scene has some. The first axial mode is critically damped if its steps do
    not resolve it. Its formulation is `exact`, and it has the
    static shapes that loads on the tip need, unless it has the `same_equations`. Its space
    contains that of the scene.
    """
    values, static = scene.values, scene.static
    bending, stretching = values['model.modes'], values['model.axial_modes']
    if modes is None:
        pushed = scene.load.terms['push_x'] or scene.load.terms['push_y']
        times = _MODES_OF_IMPACT if scene.payloads else _MODES_OF_PUSH if pushed else 1
        modes = min(times * bending + MORE_MODES, _MOST_MODES) - bending
    if axial is None:
        axial = max(_STRETCHES - stretching, 1) if stretching else 1
    if not bending:
        modes = axial = 0  # a rigid arm stays rigid
    if not same_equations:
        static += tuple(load for load in needed_static(scene, bending + modes)
                        if load not in static)
    if not scene.manipulator.arm.stretches:
        axial = 0
    own, shapes = len(scene.static), len(static)
    lists: dict[str, Any] = {}
    initial = {name: scene.modal(name) for name in _LISTS if values[name]}
    for name, given in initial.items():
        across, along = given[:bending], given[bending + own:]
        lists[name] = [*across, *(modes + shapes) * [0.0], *along, *axial * [0.0]]
    # Further modes have the damping of the last one, in terms of those of the clamped arm.
    damping = scene.build().damping.tolist()
    bent, stretched = damping[:bending] or [0.0], damping[len(damping) - stretching:]
    further = (stretched or bent)[-1:]
    resolved = not (axial or stretching) or _axial_phase(scene, scene.step / parts) <= AXIAL_PHASE
    if axial and not stretching and not resolved:
        further = [1.0]
    keeps_axial = resolved or not stretching  # their vibration is seen, or critically damped
    lists['arm.damping_ratio'] = [*bent[:bending], *modes * bent[-1:], *stretched,
                                  *axial * further]
    lists['arm.damping_of'] = 'clamped'
    # What counts as a boundary between two steps is one between two finer steps, too.
    lists.update((name, tuple(on_boundaries(value, scene.step).tolist()))
                 for name, value in values.items() if name.endswith('.time'))
    equations = {} if same_equations else {'model.formulation': 'exact'}
    found = scene_from({**values, **lists, **equations, 'model.accuracy': 0.0,
                        'model.modes': bending + modes, 'model.axial_modes': stretching + axial,
                        'integrator.step': scene.step / parts}, static, keeps_axial)
    if any(any(given[bending:bending + own]) for given in initial.values()):
        # A static shape of the scene is a sum of modes and static shapes of the finer one.
        of, size = scene.build().modes, bending + modes + shapes
        for name, given in initial.items():
            fields = [partial(_field, each, np.array(given))
                      for each in (of.deflection, of.rotation)]
            lists[name][:size] = found.build().project_on_modes(*fields)[:size].tolist()
        found = scene_from({**found.values, **lists}, static, keeps_axial)
    return found


def _field(shapes, q, xi):
    return shapes(xi) @ q


def choose_parts(scene: Scene) -> tuple[int, ...]:
    """Return the parts of a step that may do for a finer run, a tuple of int, fewest first."""
    # Events of dry friction and contacts of a gear are found to lower orders of the step; where a
    # table or drive bends inside of a step, errors of steps fall more slowly, too.
    inside = any(abs(time / scene.step - round(time / scene.step)) > 1e-6
                 for name, times in scene.values.items() if name.endswith('.time')
                 for time in times)
    events = scene.has_dry_friction or scene.values['motor.gear.backlash']
    tried = PARTS[1:] if inside or events else PARTS
    least = next((parts for parts in tried if _resolves(scene, scene.step / parts)), PARTS[-1])
    return tuple(parts for parts in PARTS if parts >= least)


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
    tips = model.tips(motions)[:, :2].T, other.tips(others)[:, :2].T
    places = [np.array(each[:, :2].T + rotate(each[:, 2], *tip))
              for each, tip in zip((motions, others), tips)]
    world, arm = (float(np.hypot(*(a - b)).max(initial=0.0)) for a, b in (places, tips))
    return world, arm
