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
from timo_sim.model.modes import modes_of

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
MORE_MODES = 2  # of a finer run
_FEW_MODES, _LEFT_OF_IT = (3, 4, 5), 0.2  # see `one_more_does`


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
    return (*shapes, 'shear') if count and _of_tip(body.arm)[1] else shapes


@lru_cache(maxsize=64)
def _of_tip(arm: Beam) -> tuple[np.ndarray, bool]:
    # Returns deflection and rotation of the tip by force and torque on it, (2, 2), and whether
    # the arm is soft in shear.
    rule = Quadrature(arm.breaks, 40)
    section, lever = arm.at(rule.nodes), arm.length - rule.nodes
    # The root of a clamp that gives turns like a point of the arm that bends.
    lever = np.append(lever, len(arm.root) * [arm.length])
    bent = np.append(rule.weights / section.bending_stiffness, [1.0 / each for each in arm.root])
    sheared = np.sum(rule.weights / section.shear_stiffness)
    across, both = lever**2 @ bent + sheared, lever @ bent
    return np.array([[across, both], [both, bent.sum()]]), bool(
        sheared > _SOFT_IN_SHEAR * across)


@lru_cache(maxsize=64)
def _left_out(body, count):
    # Returns what so many modes leave out of the tip's responses, (2, 2).
    modes = modes_of(body, count)
    shapes = np.concatenate(modes.fields(np.array([body.arm.length]))[:2])
    return _of_tip(body.arm)[0] - shapes / modes.omega**2 @ shapes.T


def _missing(body, count, static):
    # Returns what modes and static shapes leave out of these, relative, (2, 2). A shape is all
    # that is left of the response to its load, and answers other loads by their work on it.
    left = _left_out(body.clamped, count)
    for index, load in enumerate(STATIC['both']):
        if load in static and left[index, index] > 0.0:
            left = left - np.outer(left[index], left[index]) / left[index, index]
    return np.abs(left / _of_tip(body.arm)[0])


def _needed(body, count, left_out, further):
    for static in (), ('torque',):
        for more in further if count else ():  # few modes are found sooner
            if (_missing(body, count + more, static) < np.transpose([left_out])).all():
                return static
    return STATIC['both'] if count else ()


def one_more_does(body: Manipulator, count: int, static: tuple[str, ...]) -> bool:
    """
    Return whether one more mode, without further shapes, is enough for a finer run.

    Of three to five modes it shows half of an error that falls as 1/N^4. Of what modes and shapes
    leave out of the tip's responses it must leave a fifth, or what `needed_static_of_finer` does.
    """
    if count not in _FEW_MODES or _of_tip(body.arm)[1]:
        return False
    least = np.transpose([_LEFT_OUT_BY_FINER])
    return bool((_missing(body, count + 1, static) < np.maximum(
        least, _LEFT_OF_IT * _missing(body, count, static))).all())


def fastest_shape(body: Manipulator, count: int, static: tuple[str, ...], step: float) -> float:
    """Return the frequency to which faster shapes of an arm soft in shear are slowed [rad/s]."""
    if not static or not step or not _of_tip(body.arm)[1]:
        return math.inf
    limit, goal = (_SHEAR_PHASE, _SHEAR_PHASE) if 'shear' in static else (AXIAL_PHASE, SLOWED)
    omega = modes_of(body.clamped, count, static).omega[-1]
    return goal / step if step * omega > limit else math.inf


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
    phase = step * modes_of(body.clamped, count, static).omega[count:]
    ratios[count:count + shapes] += _STATIC_DAMPING * (
        phase > (_SHEAR_PHASE if 'shear' in static else _STATIC_PHASE))
    return ratios
