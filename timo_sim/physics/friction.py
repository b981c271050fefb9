"""
Coulomb friction of the joints: of the carrier along world x and y, and of the shaft.

In each step the friction of a joint is one constant r, at most `limit` in size, which is added to
the load. It is found by trial steps, see doc/theory.md (T33)-(T35): sliding through the whole step
takes one, and what comes to rest, is held or breaks away takes a few more. No trial knows of the
steps before, so that it does not matter how many steps are done at once.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.physics.compiled import entry_point, inner, local
from timo_sim.physics.etdrk4 import copy, is_finite, observe, one_step, STAGES
from timo_sim.physics.formulation import FORCE_X, FORCE_Y, LOADS, TORQUE

COLUMNS = FORCE_X, FORCE_Y, TORQUE  # of a load, by joint
_JOINTS = len(COLUMNS)
HEAT = _JOINTS  # its place behind the forces, see `advance`
# Change of r, as a part of the limit, that is none; with it, speeds end at zero to round-off.
_SAME = 1e-12
# Trial steps at most, of which the first and one for each joint make the linear model, and sweeps
# over the joints in that model.
_TRIALS, _SWEEPS = 12, 200
# The slope of r is left as it is after so many trials, so that its mean converges.
_SLOPED = _JOINTS + 3


class Joints(NamedTuple):
    """Constants of the compiled function."""

    limit: np.ndarray  # of carrier x, y [N] and shaft [N m]; 0: no friction; (3,)
    step: float  # [s]


@inner
def _hold(joints, side, drift, mobility, r):
    """Set r of the joints that are at rest: what holds them, or the limit."""
    for _ in range(_SWEEPS):
        changed = False
        for i in range(_JOINTS):
            limit = joints.limit[i]
            if limit > 0.0 and side[i] == 0.0:
                pull = drift[i]
                for j in range(_JOINTS):
                    if j != i:
                        pull += mobility[i, j] * r[j]
                last, r[i] = r[i], min(max(-pull / mobility[i, i], -limit), limit)
                changed = changed or abs(r[i] - last) > _SAME * limit
        if not changed:
            break


@inner
def _follow(joints, speed, drift, bend, mobility, now, change, side, r, mean, slope):
    """
    Set mean and slope of r over a step in which speeds are straight lines from event to event.

    From `speed` they change by drift + mobility r per step (T34). The straight line of r has the
    impulse and the first moment of its pieces; r itself is left with what it is at the end.
    """
    for i in range(_JOINTS):
        now[i], side[i], mean[i], slope[i] = speed[i], np.sign(speed[i]), 0.0, 0.0
    left = 1.0  # of the step
    for _ in range(_JOINTS + 1):  # each comes to rest once
        for i in range(_JOINTS):
            if side[i] != 0.0:
                r[i] = -joints.limit[i] * side[i]
        _hold(joints, side, drift, mobility, r)
        part, stops = left, -1
        for i in range(_JOINTS):
            change[i] = drift[i]
            for j in range(_JOINTS):
                change[i] += mobility[i, j] * r[j]
            until = -now[i] / change[i]
            if joints.limit[i] * side[i] * change[i] < 0.0 and until < part:
                part, stops = until, i
        for i in range(_JOINTS):
            now[i] += part * change[i]
            mean[i] += part * r[i]
            slope[i] += 6.0 * part * (1.0 - 2.0 * left + part) * r[i]
        left -= part
        if stops < 0:
            break
        side[stops] = 0.0
    for i in range(_JOINTS):
        now[i] = 0.0
    for _ in range(_SWEEPS):
        changed = False
        for i in range(_JOINTS):
            if side[i] == 0.0 and abs(r[i]) < joints.limit[i]:
                pull = bend[i]
                for j in range(_JOINTS):
                    if j != i:
                        pull += mobility[i, j] * now[j]
                last, now[i] = now[i], -pull / mobility[i, i]
                changed = changed or abs(now[i] - last) > _SAME * joints.limit[i]
        if not changed:
            break
    for i in range(_JOINTS):
        slope[i] += part**3 * now[i]
        r[i] = min(max(r[i] + 0.5 * part * now[i], -joints.limit[i]), joints.limit[i])


@entry_point
def advance(tables, propagator, joints, friction, state, load, loads, every, samples, heats):
    """
    Integrate over a run of equal steps with friction, as `etdrk4.advance` does without.

    Parameters
    ----------
    joints : record
        Of `Joints`.
    friction : ndarray, shape (4,)
        Forces of friction on carrier x, y [N], its torque on the shaft [N m] in the last step, and
        the heat it has made [J]; advanced in place.
    heats : ndarray, shape (1 + steps // every,)
        Receives the heat with each sample.

    """
    size, three = propagator.whole, joints.limit
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    place, speed, end, drift = local((three,)), local((three,)), local((three,)), local((three,))
    r, before, mobility = local((three,)), local((three,)), local((three, three))
    passing, change = local((three,)), local((three,))
    side, acting, slope, sloping = (
        local((three,)), local((three,)), local((three,)), local((three,)))
    bend, travel = local((three,)), local((three,))
    motion, pushed = np.empty(samples.shape[1]), np.empty((STAGES, LOADS))
    rates = len(motion) // 2
    for i in range(_JOINTS):
        for j in range(_JOINTS):
            mobility[i, j] = 0.0
    copy(state, now)
    for k in range(len(loads) + 1):
        observe(tables, now, load, motion)
        for i in range(_JOINTS):
            if k > 0:
                friction[HEAT] -= (r[i] * (motion[i] - place[i]) + slope[i] * joints.step
                                   * (motion[rates + i] - speed[i]) / 12.0)
            place[i], speed[i] = motion[i], motion[rates + i]
        if every and k % every == 0:
            copy(motion, samples[k // every])
            heats[k // every] = friction[HEAT]
        if k == len(loads):
            break

        for trial in range(_TRIALS):
            # The r of a trial: that of sliding, one that differs for one joint, the solution.
            copy(r, before)
            if trial == 0:
                for i in range(_JOINTS):
                    acting[i] = r[i] = -joints.limit[i] * np.sign(speed[i])
                    slope[i] = 0.0
            elif trial <= _JOINTS:
                i = trial - 1
                if joints.limit[i] == 0.0:
                    continue
                r[i] += joints.limit[i] if r[i] <= 0.0 else -joints.limit[i]
            else:
                for i in range(_JOINTS):
                    drift[i] = end[i] - speed[i]
                    bend[i] = 6.0 * (speed[i] + end[i]) - 12.0 * travel[i]
                    for j in range(_JOINTS):
                        drift[i] -= mobility[i, j] * before[j]
                        bend[i] -= mobility[i, j] * slope[j]
                copy(before, acting)
                _follow(joints, speed, drift, bend, mobility, passing, change, side, acting, r,
                        sloping)
                same = True
                for i in range(_JOINTS):
                    same = same and abs(r[i] - before[i]) <= _SAME * joints.limit[i]
                if same:
                    copy(before, r)
                    break
                if trial <= _SLOPED:
                    copy(sloping, slope)
            for j in range(STAGES):
                copy(loads[k, j], pushed[j])
                for i in range(_JOINTS):
                    pushed[j, COLUMNS[i]] += r[i] + 0.5 * (j - 1) * slope[i]
            one_step(tables, propagator, now, pushed[0], pushed[1], pushed[2], half, following,
                     combined, rate_0, rate_a, rate_b, rate_c, stage)
            observe(tables, stage, pushed[2], motion)
            sliding = True
            for i in range(_JOINTS):
                if 0 < trial <= _JOINTS:
                    mobility[i, trial - 1] = (
                        (motion[rates + i] - end[i]) / (r[trial - 1] - before[trial - 1]))
                end[i] = motion[rates + i]
                travel[i] = (motion[i] - place[i]) / joints.step
                sliding = sliding and (joints.limit[i] == 0.0 or end[i] * speed[i] > 0.0)
            if trial == 0 and sliding:
                break
        if not is_finite(stage):
            copy(now, state)
            return k
        copy(stage, now)
        copy(acting, friction[:_JOINTS])
        load = loads[k, 2]
    copy(now, state)
    return len(loads)
