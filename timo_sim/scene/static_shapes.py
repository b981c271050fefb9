# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Static shapes: which of them a scene needs beside its modes, and how its steps treat them.

A shape is the deflection by a load on the tip, less what the modes have of it, see doc/theory.md
(T9). Steps slow down or damp shapes that vibrate too fast for them (T67).
"""

from functools import lru_cache
import math

import numpy as np

from timo_sim.model.bodies import Beam, Manipulator, Quadrature
from timo_sim.model.modes import compliance, modes_of

# The argument `static` of a Formulation, by `model.static_modes`.
STATIC = {'none': (), 'force': ('force',), 'torque': ('torque',), 'both': ('force', 'torque'),
          'weight': ('weight',)}
# Phases in a step [rad] of axial vibrations and shapes: above which a finer run has them
# critically damped, and to which they are slowed down.
AXIAL_PHASE, SLOWED = 4.0, 0.5
# A static shape is damped by so much more if its phase in a step is above [rad].
_STATIC_PHASE, _STATIC_DAMPING = 1.0, 1.0
# The same, and the phase to which it is slowed, if one is of shear: it resonates with stretch.
_SHEAR_PHASE = 0.2
# Of the tip's static deflection and rotation, what the modes of a finer run may leave out before a
# scene needs shapes, and before the finer run does: more than those of a tip as heavy as its arm.
_LEFT_OUT, _LEFT_OUT_BY_FINER = (1e-4, 1e-2), (3e-6, 3e-6)
# Share of shear in the deflection by a force above which axial forces, which turn it, matter.
_SOFT_IN_SHEAR = 0.03
_BENDING = 0, 2  # deflection and rotation of the tip among rows of `compliance`
MORE_MODES = 2  # of a finer run


def needed_static(body: Manipulator, count: int) -> tuple[str, ...]:
    """
    Return the loads on the tip whose static shapes follow so many modes.

    Of the responses to others, two more modes miss at most 1e-4 of the tip's deflection and 1e-2
    of its rotation, so that a finer run sees what the modes miss. Whether a scene has such loads
    does not count: a command may be one.
    """
    return _needed(body, count, _LEFT_OUT, (0, MORE_MODES))


def needed_static_of_finer(body: Manipulator, count: int) -> tuple[str, ...]:
    """
    Return the loads on the tip whose static shapes follow so many modes of a finer run.

    It leaves out at most 3e-6 of deflection and rotation; if the arm is soft in shear, it has a
    shape of shear alone besides, which no mode has.
    """
    shapes = _needed(body, count, _LEFT_OUT_BY_FINER, (0,))
    return (*shapes, 'shear') if _soft_in_shear(body.arm) else shapes


@lru_cache(maxsize=64)
def _soft_in_shear(arm: Beam) -> bool:
    rule = Quadrature(arm.breaks, 40)
    section = arm.at(rule.nodes)
    bent = rule.weights @ ((arm.length - rule.nodes)**2 / section.bending_stiffness)
    bent += sum(arm.length**2 / each for each in arm.root)
    sheared = np.sum(rule.weights / section.shear_stiffness)
    return bool(sheared > _SOFT_IN_SHEAR * (bent + sheared))


@lru_cache(maxsize=64)
def _needed(body, count, left_out, further):
    if not count:
        return ()
    for static in (), ('torque',):
        for more in further:  # few modes are found sooner
            modes = modes_of(body, count + more, static)
            whole, shapes = compliance(body, modes, body.arm.length)
            whole, shapes = whole[np.ix_(_BENDING, _BENDING)], shapes[[*_BENDING]]
            seen = shapes / modes.omega**2 @ shapes.T
            if (np.abs(1.0 - seen / whole) < np.transpose([left_out])).all():
                return static
    return STATIC['both']


def fastest_shape(body: Manipulator, count: int, static: tuple[str, ...], step: float) -> float:
    """Return the frequency to which faster shapes of an arm soft in shear are slowed [rad/s]."""
    if not static or not step or not _soft_in_shear(body.arm):
        return math.inf
    limit, goal = (_SHEAR_PHASE, _SHEAR_PHASE) if 'shear' in static else (AXIAL_PHASE, SLOWED)
    return goal / step if step * modes_of(body, count, static).omega[-1] > limit else math.inf


def with_shapes(ratios: np.ndarray, body: Manipulator, count: int, axial: int,
                static: tuple[str, ...], step: float) -> np.ndarray:
    """
    Return damping ratios, one or one for each mode of the arm, with those of its static shapes.

    A shape has the ratio of the mode before it. One that the step does not resolve follows its
    load, without resonance.
    """
    arm, shapes = count + axial, len(static)
    if ratios.size in (1, arm):
        ratios = np.insert(np.broadcast_to(ratios, (arm,)), count, shapes * [
            np.ravel(ratios)[min(count, ratios.size) - 1]])
    phase = step * modes_of(body, count, static).omega[count:]
    ratios[count:count + shapes] += _STATIC_DAMPING * (
        phase > (_SHEAR_PHASE if 'shear' in static else _STATIC_PHASE))
    return ratios
