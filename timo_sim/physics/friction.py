"""
Coulomb friction of the joints: of the carrier along world x and y, and of the shaft.

In each step the friction of a joint is a straight line in time, a mean r and a slope s, which is
added to the load. It is found by trial steps, see doc/theory.md (T33)-(T36): sliding through the
whole step takes one, and what comes to rest, is held or breaks away takes a few more. No trial
knows of the steps before, so that it does not matter how many steps are done at once.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.physics.compiled import entry_point, inner, local
from timo_sim.physics.etdrk4 import copy, is_finite, observe, one_step, STAGES
from timo_sim.physics.formulation import FORCE_X, FORCE_Y, LOADS, TORQUE

COLUMNS = FORCE_X, FORCE_Y, TORQUE  # of a load, by joint
_JOINTS = len(COLUMNS)
# What `advance` keeps: forces, heat, by how much each joint went astray.
HEAT, ASTRAY, KEPT = _JOINTS, _JOINTS + 1, 2 * _JOINTS + 1
# Change of r, as a part of the limit, that is none; with it, speeds end at zero to round-off.
_SAME = 1e-12
# Way that is none [m, rad]: what is at rest stays there to the last bit.
_STILL = 1e-12
# Trial steps at most, of which the first and one for each joint make the linear model; rounds for
# mean and slope in that model, and sweeps over the joints in each.
_TRIALS, _ROUNDS, _SWEEPS = 12, 30, 200


class Joints(NamedTuple):
    """Constants of the compiled function."""

    limit: np.ndarray  # of carrier x, y [N] and shaft [N m]; 0: no friction; (3,)
    step: float  # [s]


@inner
def _hold(side, pull, mobility, room, r):
    """Set r of the joints that are at rest: what holds them against a pull, or all their room."""
    for _ in range(_SWEEPS):
        changed = False
        for i in range(_JOINTS):
            if room[i] > 0.0 and side[i] == 0.0:
                change = pull[i]
                for j in range(_JOINTS):
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
    Follow speeds that are parabolas from event to event through a step, (T34).

    Receives mean and slope of r over the step, and each joint's path in steps as of speeds that
    are straight lines; r itself is left with what it is at the end.
    """
    for i in range(_JOINTS):
        now[i], side[i] = speed[i], np.sign(speed[i])
        mean[i], slope[i], path[i], turn[i] = 0.0, 0.0, 0.0, 0.0
    left, part = 1.0, 1.0  # of the step, and of that until the next event
    for _ in range(_JOINTS + 1):  # each comes to rest once
        for i in range(_JOINTS):
            # What is held has no speed at the end.
            change[i] = drift[i] + 0.5 * (1.0 - left) * bend[i] + now[i] / left
            if side[i] != 0.0:
                r[i] = -joints.limit[i] * side[i]
        _hold(side, change, mobility, joints.limit, r)
        part, stops = left, -1
        for i in range(_JOINTS):
            # From here on, change from now: `change` t + bend t^2 / 2.
            change[i] = drift[i] + (0.5 - left) * bend[i]
            for j in range(_JOINTS):
                change[i] += mobility[i, j] * r[j]
            falling = np.sqrt(change[i]**2 - 2.0 * bend[i] * now[i]) - side[i] * change[i]
            until = 2.0 * side[i] * now[i] / falling
            if joints.limit[i] * abs(side[i]) > 0.0 and falling > 0.0 and until < part:
                part, stops = until, i
        for i in range(_JOINTS):
            path[i] += part * (now[i] + part * (0.5 * change[i] + part * bend[i] / 6.0))
            now[i] += part * (change[i] + 0.5 * part * bend[i])
            mean[i] += part * r[i]
            slope[i] += 6.0 * part * (1.0 - 2.0 * left + part) * r[i]
        left -= part
        if stops < 0:
            break
        side[stops], now[stops] = 0.0, 0.0
    # What holds to the end is a straight line, too, within the limits.
    for i in range(_JOINTS):
        room[i] = 2.0 * (joints.limit[i] - abs(r[i])) / part
    _hold(side, bend, bending, room, turn)
    for i in range(_JOINTS):
        slope[i] += part**3 * turn[i]
        path[i] += bend[i] / 12.0
        r[i] += 0.5 * part * turn[i]


@inner
def _same(joints, r, other):
    """Return whether two r are the same but for round-off."""
    for i in range(_JOINTS):
        if abs(r[i] - other[i]) > _SAME * joints.limit[i]:
            return False
    return True


@entry_point
def advance(tables, propagator, joints, friction, state, load, loads, every, samples, heats):
    """
    Integrate over a run of equal steps with friction, as `etdrk4.advance` does without.

    Parameters
    ----------
    joints : record
        Of `Joints`.
    friction : ndarray, shape (7,)
        Forces of friction on carrier x, y [N] and its torque on the shaft [N m] at the end of the
        last step; the heat it has made [J]; how far joints that came to rest, turned round or were
        held went from where straight speeds lead, summed up over steps [m, m, rad]. Advanced in
        place.
    heats : ndarray, shape (1 + steps // every,)
        Receives the heat with each sample.

    """
    size, three, h = propagator.whole, joints.limit, joints.step
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    # Where the step begins and what a trial ends with; its travel is counted in steps.
    place, speed, end, travel = local((three,)), local((three,)), local((three,)), local((three,))
    r, slope, acting, path = local((three,)), local((three,)), local((three,)), local((three,))
    before, sloping, last = local((three,)), local((three,)), local((three,))
    drift, bend, mobility = local((three,)), local((three,)), local((three, three))
    pull, turning, bending = local((three,)), local((three,)), local((three, three))
    going, cross = local((three, three)), local((three, three))
    passing, change, side = local((three,)), local((three,)), local((three,))
    room, turn = local((three,)), local((three,))
    motion, pushed = np.empty(samples.shape[1]), np.empty((STAGES, LOADS))
    rates = len(motion) // 2
    for i in range(_JOINTS):
        for j in range(_JOINTS):
            mobility[i, j] = going[i, j] = 0.0
    copy(state, now)
    for k in range(len(loads) + 1):
        observe(tables, now, load, motion)
        for i in range(_JOINTS):
            if k > 0:
                friction[HEAT] -= (r[i] * (motion[i] - place[i])
                                   + slope[i] * h * (motion[rates + i] - speed[i]) / 12.0)
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
                    r[i] = acting[i] = -joints.limit[i] * np.sign(speed[i])
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
                        # (T36)
                        cross[i, j] = going[i, j] - 0.5 * mobility[i, j]
                        bending[i, j] = 6.4 * going[i, j] - 2.2 * mobility[i, j]
                        drift[i] -= mobility[i, j] * r[j] + cross[i, j] * slope[j]
                        bend[i] -= bending[i, j] * slope[j] - 12.0 * cross[i, j] * r[j]
                copy(slope, sloping)
                for _ in range(_ROUNDS):
                    for i in range(_JOINTS):
                        pull[i], turning[i] = drift[i], bend[i]
                        for j in range(_JOINTS):
                            pull[i] += cross[i, j] * sloping[j]
                            turning[i] -= 12.0 * cross[i, j] * r[j]
                        if abs(turning[i]) * h <= 12.0 * _STILL:
                            turning[i] = 0.0
                    copy(r, last)
                    copy(before, acting)
                    _follow(joints, speed, pull, turning, mobility, bending, passing, change, room,
                            turn, side, acting, r, sloping, path)
                    if _same(joints, r, last):
                        break
                if _same(joints, r, before):
                    copy(before, r)
                    break
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
                    more = r[trial - 1] - before[trial - 1]
                    mobility[i, trial - 1] = (motion[rates + i] - end[i]) / more
                    going[i, trial - 1] = ((motion[i] - place[i]) / h - travel[i]) / more
                end[i], travel[i] = motion[rates + i], (motion[i] - place[i]) / h
                sliding = sliding and (joints.limit[i] == 0.0 or end[i] * speed[i] > 0.0)
            if trial == 0 and sliding:
                break
        if not is_finite(stage):
            copy(now, state)
            return k
        if trial > 0:
            for i in range(_JOINTS):
                if joints.limit[i] > 0.0 and side[i] == 0.0:
                    friction[ASTRAY + i] += abs(travel[i] - path[i]) * h
        copy(stage, now)
        copy(acting, friction[:_JOINTS])
        load = loads[k, 2]
    copy(now, state)
    return len(loads)
