# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Coulomb friction within one step: speeds from event to event in the linear model of the step.

An event is that a joint comes to rest. Numbers (T..) are those of doc/theory.md.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.jit.decorators import inlined, inner
from timo_sim.physics.integrate.etdrk4 import copy
from timo_sim.physics.layout import FORCE_X, FORCE_Y, TORQUE

COLUMNS = FORCE_X, FORCE_Y, TORQUE  # of a load, by joint
JOINTS = len(COLUMNS)
_SAME = 1e-12   # relative change of r treated as converged; speeds then end at zero to round-off
_STILL = 1e-12  # path treated as rest [m, rad]: what is at rest stays there to the last bit
# Rounds for mean and slope in the linear model, and sweeps over the joints in each.
_ROUNDS, _SWEEPS = 30, 200


class Joints(NamedTuple):
    """Constants of the compiled function."""

    limit: np.ndarray  # of carrier x, y [N] and shaft [N m]; 0: no friction; (3,)
    step: float  # [s]


@inner
def _hold(side, pull, mobility, room, r):
    """Set r of the joints that are at rest: what holds them against a pull, or all their room."""
    for _ in range(_SWEEPS):
        changed = False
        for i in range(JOINTS):
            if room[i] > 0.0 and side[i] == 0.0:
                change = pull[i]
                for j in range(JOINTS):
                    if j != i:
                        change += mobility[i, j] * r[j]
                last, r[i] = r[i], min(max(-change / mobility[i, i], -room[i]), room[i])
                changed = changed or abs(r[i] - last) > _SAME * room[i]
        if not changed:
            break


@inner
def _follow(joints, speed, drift, bend, mobility, bending, now, change, room, turn, side, r, mean,
            slope, path):
    """
    Follow speeds that are parabolas from event to event through a step, (T42).

    Receives mean and slope of r over the step, and each joint's path in steps as of speeds that
    are straight lines; r itself is left with what it is at the end.
    """
    for i in range(JOINTS):
        now[i], side[i] = speed[i], np.sign(speed[i])
        mean[i], slope[i], path[i], turn[i] = 0.0, 0.0, 0.0, 0.0
    left, part = 1.0, 1.0  # of the step, and of that until the next event
    for _ in range(JOINTS + 1):  # each comes to rest once
        for i in range(JOINTS):
            # What is held has no speed at the end.
            change[i] = drift[i] + 0.5 * (1.0 - left) * bend[i] + now[i] / left
            if side[i] != 0.0:
                r[i] = -joints.limit[i] * side[i]
        _hold(side, change, mobility, joints.limit, r)
        part, stops = left, -1
        for i in range(JOINTS):
            # From here on, change from now: `change` t + bend t^2 / 2.
            change[i] = drift[i] + (0.5 - left) * bend[i]
            for j in range(JOINTS):
                change[i] += mobility[i, j] * r[j]
            falling = np.sqrt(change[i]**2 - 2.0 * bend[i] * now[i]) - side[i] * change[i]
            until = 2.0 * side[i] * now[i] / falling
            if joints.limit[i] * abs(side[i]) > 0.0 and falling > 0.0 and until < part:
                part, stops = until, i
        for i in range(JOINTS):
            path[i] += part * (now[i] + part * (0.5 * change[i] + part * bend[i] / 6.0))
            now[i] += part * (change[i] + 0.5 * part * bend[i])
            mean[i] += part * r[i]
            slope[i] += 6.0 * part * (1.0 - 2.0 * left + part) * r[i]
        left -= part
        if stops < 0:
            break
        side[stops], now[stops] = 0.0, 0.0
    # What holds to the end is a straight line, too, within the limits.
    for i in range(JOINTS):
        room[i] = 2.0 * (joints.limit[i] - abs(r[i])) / part
    _hold(side, bend, bending, room, turn)
    for i in range(JOINTS):
        slope[i] += part**3 * turn[i]
        path[i] += bend[i] / 12.0
        r[i] += 0.5 * part * turn[i]


@inner
def same(joints, r, other):
    """Return whether two r are the same but for round-off."""
    for i in range(JOINTS):
        if abs(r[i] - other[i]) > _SAME * joints.limit[i]:
            return False
    return True


@inlined
def fit(speed, end, travel, mobility, going, r, slope, drift, bend, cross, bending):
    """Set the linear model of a step: drift and bend of the speeds without friction, (T43)."""
    for i in range(JOINTS):
        drift[i] = end[i] - speed[i]
        bend[i] = 6.0 * (speed[i] + end[i]) - 12.0 * travel[i]
        for j in range(JOINTS):
            cross[i, j] = going[i, j] - 0.5 * mobility[i, j]
            bending[i, j] = 6.4 * going[i, j] - 2.2 * mobility[i, j]
            drift[i] -= mobility[i, j] * r[j] + cross[i, j] * slope[j]
            bend[i] -= bending[i, j] * slope[j] - 12.0 * cross[i, j] * r[j]


@inlined
def solve(joints, speed, drift, bend, mobility, cross, bending, before, pull, turning, passing,
          change, room, turn, side, acting, last, r, slope, sloping, path):
    """
    Set mean and slope of r, of which one depends on the other, in the linear model.

    Returns whether they are those of the trial before, which is then the step.
    """
    copy(slope, sloping)
    for _ in range(_ROUNDS):
        for i in range(JOINTS):
            pull[i], turning[i] = drift[i], bend[i]
            for j in range(JOINTS):
                pull[i] += cross[i, j] * sloping[j]
                turning[i] -= 12.0 * cross[i, j] * r[j]
            if abs(turning[i]) * joints.step <= 12.0 * _STILL:
                turning[i] = 0.0
        copy(r, last)
        copy(before, acting)
        _follow(joints, speed, pull, turning, mobility, bending, passing, change, room,
                turn, side, acting, r, sloping, path)
        if same(joints, r, last):
            break
    solved = same(joints, r, before)
    if solved:
        copy(before, r)
    else:
        copy(sloping, slope)
    return solved
