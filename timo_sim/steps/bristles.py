# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Presliding: dry friction as that of bristles, which bend before a joint slides (T64).

The deflection of a bristle follows its joint within +-`reach`, and its force is a function of it.
In a step this force is part of the load of the three stages. A joint's place in a step is the
cubic through place and speed at both ends, of which those at the end are found in rounds (T65).
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.functions import inner, square_root
from timo_sim.model.layout import (
    FORCE_X, FORCE_Y, LOADS, MOTOR_FRICTION, SHAFT_FRICTION, STAGES, TORQUE)

# Columns of a load, by bristle: of carrier x, y, of the shaft or, with an elastic gear, the rotor,
# and of the shaft of an elastic gear.
COLUMNS = FORCE_X, FORCE_Y, TORQUE, SHAFT_FRICTION
BRISTLES = len(COLUMNS)
# What one of the friction of each adds to a load, (BRISTLES, LOADS).
UNITS = np.eye(LOADS)[list(COLUMNS)]
UNITS[2, MOTOR_FRICTION] = 1.0
# What steps hand on: dry friction by column at the end of the last step, the energy that it has
# taken [J], deflections of bristles.
HEAT, DEFLECTION = BRISTLES, BRISTLES + 1
MEMORY = DEFLECTION + BRISTLES
# Steps that are tried. An odd number of rounds takes energy from vibrations, an even one gives.
ROUNDS = 3
FORWARD, BACKWARD, REACH = range(3)  # columns of `Joints.bristles`


class Bristles(NamedTuple):
    """Work arrays by bristle: joints at the start of a step, and deflections at its stages."""

    place: Annotated[np.ndarray, BRISTLES]
    speed: Annotated[np.ndarray, BRISTLES]
    deflection: Annotated[np.ndarray, STAGES, BRISTLES]


@inner
def _at(joints, motion, number, begin):
    """Return the place of a bristle's joint or, from the half of the motion on, its speed."""
    found = motion[begin + min(number, 2)]
    if number == 2:
        for n in range(len(joints.gear)):
            found += joints.gear[n] * motion[begin + joints.place]
    return found


@inner
def _limit(joints, number, deflection):
    return joints.bristles[number, FORWARD if deflection > 0.0 else BACKWARD]


@inner
def _force(joints, number, deflection):
    """Return the friction of a bristle, against its deflection."""
    return -_limit(joints, number, deflection) * deflection / joints.bristles[number, REACH]


@inner
def _within(reach, deflection):
    return min(max(deflection, -reach), reach)


@inner
def _turn(start_speed, end_speed, way):
    """
    Return time and way to where a joint turns round in a step, or 0; speeds are per step.

    The root of the cubic's rate is the one at which the rate changes its sign.
    """
    time, found = 0.0, 0.0
    if start_speed * end_speed < 0.0:
        second = 3.0 * way - 2.0 * start_speed - end_speed
        third = start_speed + end_speed - 2.0 * way
        root = square_root(max(second * second - 3.0 * third * start_speed, 0.0))
        time = -start_speed / (second - root if start_speed > 0.0 else second + root)
        found = time * (start_speed + time * (second + time * third))
    return time, found


@inner
def guess(joints, bristles):
    """Set deflections in a step as if speeds stayed."""
    for i in range(len(joints.bristles)):
        for j in range(1, STAGES):
            bristles.deflection[j, i] = _within(
                joints.bristles[i, REACH],
                bristles.deflection[0, i] + 0.5 * j * joints.step * bristles.speed[i])


@inner
def add_bristles(joints, bristles, loads):
    """Add the friction of bristles to the loads of the stages."""
    for i in range(len(joints.bristles)):
        if joints.bristles[i, REACH] > 0.0:
            for j in range(STAGES):
                loads[j, COLUMNS[i]] += _force(joints, i, bristles.deflection[j, i])


@inner
def bend(joints, motion, bristles):
    """Set deflections in a step that ends with a motion; return whether they are as before."""
    same = True
    for i in range(len(joints.bristles)):
        reach, start = joints.bristles[i, REACH], bristles.deflection[0, i]
        if reach > 0.0:
            speed = joints.step * bristles.speed[i]
            end_speed = joints.step * _at(joints, motion, i, len(motion) // 2)
            way = _at(joints, motion, i, 0) - bristles.place[i]
            time, turn = _turn(speed, end_speed, way)
            half = 0.5 * way + 0.125 * (speed - end_speed)
            first = turn if time < 0.5 else 0.0
            middle = _within(reach, _within(reach, start + first) + (half - first))
            end = _within(reach, _within(reach, start + turn) + (way - turn))
            same = same and (middle == bristles.deflection[1, i]
                             and end == bristles.deflection[2, i])
            bristles.deflection[1, i], bristles.deflection[2, i] = middle, end
    return same


@inner
def start_bristles(joints, motion, moved, bristles, memory):
    """
    Begin a step with a motion, by `memory`; if a step has `moved` joints to it, note that first.

    Bristles take the energy of their slides, by limits of friction, and what their springs hold.
    """
    for i in range(len(joints.bristles)):
        place, speed = _at(joints, motion, i, 0), _at(joints, motion, i, len(motion) // 2)
        if moved and joints.bristles[i, REACH] > 0.0:
            start, way = bristles.deflection[0, i], place - bristles.place[i]
            _, turn = _turn(joints.step * bristles.speed[i], joints.step * speed, way)
            end = start
            for part in range(2):
                full = end + (way - turn if part else turn)
                end = _within(joints.bristles[i, REACH], full)
                memory[HEAT] += _limit(joints, i, end) * abs(full - end)
            memory[HEAT] += 0.5 * (_force(joints, i, start) * start - _force(joints, i, end) * end)
            memory[i] += _force(joints, i, end)
            memory[DEFLECTION + i] = end
        bristles.place[i], bristles.speed[i] = place, speed
        bristles.deflection[0, i] = memory[DEFLECTION + i]
