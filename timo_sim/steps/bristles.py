# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Presliding: dry friction as that of bristles, which bend before a joint slides, (T64) and (T65).

The deflection z of a bristle follows its joint within +-`reach`, and its force is a function of
z. Within a step z follows from the joint's place since the start, so that friction is a part of
the rate at each stage.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from timo_sim.compiled.functions import declare, inner, square_root
from timo_sim.model.functions import copy, observe, rate
from timo_sim.model.layout import FORCE_X, FORCE_Y, LOADS, SHAFT_FRICTION, TORQUE

# Columns of a load, by bristle: of carrier x, y, of the shaft or, with an elastic gear, the rotor,
# and of the shaft of an elastic gear.
COLUMNS = FORCE_X, FORCE_Y, TORQUE, SHAFT_FRICTION
BRISTLES = len(COLUMNS)
# What steps hand on: dry friction by column at the end of the last step, the energy that it has
# taken [J], deflections of bristles.
HEAT, DEFLECTION = BRISTLES, BRISTLES + 1
MEMORY = DEFLECTION + BRISTLES


class Joints(NamedTuple):
    """Constants of dry friction: of joints that stick, and of joints with bristles."""

    limit: Annotated[np.ndarray, 3]  # of carrier x, y [N] and rotor [N m]; 0: it does not stick
    step: float  # [s]
    # Turn of the rotor per coordinate of an elastic gear, and the coordinate's place in a motion.
    gear: Annotated[np.ndarray, 'gears']
    place: int
    # Friction in forward and in backward motion [N, N m], and reach [m, rad], 0: no bristle.
    bristles: Annotated[np.ndarray, BRISTLES, 3]


class BristledJoints(Joints):
    """The same, where a joint has a bristle: their kind chooses the code."""


class Bristles(NamedTuple):
    """Work arrays of bristles: the start of a step, and room for a stage."""

    start: Annotated[np.ndarray, BRISTLES]       # place of the joint
    speed: Annotated[np.ndarray, BRISTLES]       # of the joint
    deflection: Annotated[np.ndarray, BRISTLES]
    load: Annotated[np.ndarray, LOADS]
    motion: Annotated[np.ndarray, 'motion']


class Bristled(NamedTuple):
    """What stands for the tables of a model in a step with bristles."""

    tables: Any
    joints: Any
    bristles: Any


@inner
def _at(joints, motion, number, begin):
    """Return the place of a bristle's joint or, from the half of the motion on, its speed."""
    found = motion[begin + min(number, 2)]
    if number == 2:
        for n in range(len(joints.gear)):
            found += joints.gear[n] * motion[begin + joints.place]
    return found


@inner
def _within(reach, deflection):
    return min(max(deflection, -reach), reach)


@inner
def _limit(joints, number, deflection):
    return joints.bristles[number, 0] if deflection > 0.0 else joints.bristles[number, 1]


@rate.of(Bristled)
def _rate(bristled, state, load, out):
    """Write the rate under a load and the friction of bristles (T64)."""
    joints, bristles = bristled.joints, bristled.bristles
    observe(bristled.tables, state, load, bristles.motion)
    copy(load, bristles.load)
    for i in range(BRISTLES):
        reach = joints.bristles[i, 2]
        if reach > 0.0:
            deflection = _within(reach, bristles.deflection[i]
                                 + (_at(joints, bristles.motion, i, 0) - bristles.start[i]))
            bristles.load[COLUMNS[i]] -= _limit(joints, i, deflection) * deflection / reach
    rate(bristled.tables, state, bristles.load, out)


@inner
def _turn(start_speed, end_speed, way):
    """
    Return the way to where a joint turns round in a step, 0 if it does not.

    Its place is the cubic through place and speed at both ends; speeds are per step.
    """
    found = 0.0
    if start_speed * end_speed < 0.0:
        second = 3.0 * way - 2.0 * start_speed - end_speed
        third = start_speed + end_speed - 2.0 * way
        root = square_root(max(second * second - 3.0 * third * start_speed, 0.0))
        time = -start_speed / (second - root if start_speed > 0.0 else second + root)
        found = time * (start_speed + time * (second + time * third))
    return found


@declare
def follow(joints, tables, motion, moved, bristles, memory):
    """
    Let bristles follow to a motion; return what stands for the tables in a step from there.

    Unless `moved` it is the motion that `memory` belongs to.
    """


@follow.of(Joints)
def _follow_none(joints, tables, motion, moved, bristles, memory):
    return tables


@follow.of(BristledJoints)
def _follow(joints, tables, motion, moved, bristles, memory):
    """Also add friction and the energy that it takes to `memory` (T65)."""
    for i in range(BRISTLES):
        reach = joints.bristles[i, 2]
        place, speed = _at(joints, motion, i, 0), _at(joints, motion, i, len(motion) // 2)
        if moved and reach > 0.0:
            way = place - bristles.start[i]
            turn = _turn(joints.step * bristles.speed[i], joints.step * speed, way)
            before = deflection = bristles.deflection[i]
            for part in range(2):
                full = deflection + (way - turn if part else turn)
                deflection = _within(reach, full)
                memory[HEAT] += _limit(joints, i, deflection) * abs(full - deflection)
            # What the springs of the bristle hold is part of the energy.
            force = _limit(joints, i, deflection) * deflection / reach
            memory[HEAT] += 0.5 * (
                force * deflection - _limit(joints, i, before) * before * before / reach)
            memory[i] -= force
            memory[DEFLECTION + i] = deflection
        bristles.start[i], bristles.speed[i] = place, speed
        bristles.deflection[i] = memory[DEFLECTION + i]
    return Bristled(tables, joints, bristles)
