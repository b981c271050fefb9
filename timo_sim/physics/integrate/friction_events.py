# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Coulomb friction within one step: speeds from event to event in the linear model of the step.

At an event a joint comes to rest. Numbers (T..) are those of doc/theory.md. In the names of its
(T39) and (T40): r, slope = R, R' and drift, bend = d, e of each joint; mobility, going, cross,
bending = B, B_x, C, B_s; travel = Delta x / h.
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
# Most rounds for mean and slope in the linear model; most sweeps over the joints in `_hold`.
_ROUNDS, _SWEEPS = 30, 200


class Joints(NamedTuple):
    """Constants of the compiled function."""

    limit: np.ndarray  # of carrier x, y [N] and shaft [N m]; 0: no friction; (3,)
    step: float  # [s]


@inner
def _hold(side, pull, mobility, room, r):
    """Set r of the joints at rest by Gauss-Seidel: it cancels their pull within +-room."""
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
    Follow speeds that are parabolas from event to event through a step, (T39).

    Sets mean and slope of r over the step, r to its value at the end, and `path`: each joint's
    travel / h if speeds were straight lines between events.
    """
    for i in range(JOINTS):
        now[i], side[i] = speed[i], np.sign(speed[i])
        mean[i], slope[i], path[i], turn[i] = 0.0, 0.0, 0.0, 0.0
    left, part = 1.0, 1.0  # what remains of the step, and the part until the next event
    for _ in range(JOINTS + 1):  # each joint comes to rest once at most
        for i in range(JOINTS):
            # The pull on a joint at rest, including what brings its speed to zero at the end.
            change[i] = drift[i] + 0.5 * (1.0 - left) * bend[i] + now[i] / left
            if side[i] != 0.0:
                r[i] = -joints.limit[i] * side[i]
        _hold(side, change, mobility, joints.limit, r)
        part, stops = left, -1
        for i in range(JOINTS):
            # From here on the speed is now + change t + bend t^2 / 2.
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
    # Joints held to the end have friction with a slope, too, within the limits.
    for i in range(JOINTS):
        room[i] = 2.0 * (joints.limit[i] - abs(r[i])) / part
    _hold(side, bend, bending, room, turn)
    for i in range(JOINTS):
        slope[i] += part**3 * turn[i]
        path[i] += bend[i] / 12.0
        r[i] += 0.5 * part * turn[i]


@inner
def same(joints, r, other):
    """Return whether two values of r are equal but for round-off."""
    for i in range(JOINTS):
        if abs(r[i] - other[i]) > _SAME * joints.limit[i]:
            return False
    return True


@inlined
def fit(speed, end, travel, mobility, going, r, slope, drift, bend, cross, bending):
    """Set the linear model of a step: its matrices, drift and bend without friction (T40)."""
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
    Set mean and slope of r by the linear model, in rounds because each depends on the other.

    Return whether r is that of the last trial, which then is the step.
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
