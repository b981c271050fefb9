# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Coulomb friction of the joints: of the carrier along world x and y, and of the shaft.

A joint either sticks, or its friction builds up over a speed.
"""

from typing import NamedTuple

import numpy as np

from timo_sim.compiled.constants import local, pack
from timo_sim.compiled.functions import entry_point, inlined, inner
from timo_sim.model.functions import holds, observe
from timo_sim.model.layout import AFTER, FORCE_X, FORCE_Y, LOADS, STAGES, TORQUE
from timo_sim.steps.etdrk4 import check, copy, is_finite, one_step
from timo_sim.steps.steps import Steps

# Coulomb friction within one step: speeds from event to event in the linear model of the step.
#
# At an event a joint comes to rest. Numbers (T..) are those of doc/theory.md. In the names of its
# (T39) and (T40): r, slope = R, R' and drift, bend = d, e of each joint; mobility, going, cross,
# bending = B, B_x, C, B_s; travel = Delta x / h.

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


# Dry friction of the joints: of the carrier along world x and y, and of the shaft.
#
# In each step the friction of a joint is a straight line in time, a mean R and a slope R', which
# is added to the load. It is found by trial steps, see doc/theory.md (T38)-(T40): one if all
# joints slide through the whole step, a few more if a joint comes to rest, is held or breaks away.
# No trial depends on earlier steps, so that it does not matter how many steps are done at once.

_HEAT = JOINTS  # place in `Steps.memory`, after the friction of each joint
# Most trial steps; the first and one for each joint identify the linear model.
_TRIALS = 12


@inlined
def _clear(mobility, going):
    """Set the linear model to zero, which stays so for joints without friction."""
    for i in range(JOINTS):
        for j in range(JOINTS):
            mobility[i, j] = going[i, j] = 0.0


@inlined
def _slide(joints, speed, r, slope, acting):
    """Set the friction of joints that slide through the whole step."""
    for i in range(JOINTS):
        r[i] = acting[i] = -joints.limit[i] * np.sign(speed[i])
        slope[i] = 0.0


@inlined
def _push(loads, r, slope, pushed):
    """Set the loads of a step with friction at its start, middle and end."""
    for j in range(STAGES):
        copy(loads[j], pushed[j])
        for i in range(JOINTS):
            pushed[j, COLUMNS[i]] += r[i] + 0.5 * (j - 1) * slope[i]


@inlined
def _learn(joints, trial, motion, place, speed, r, before, end, travel, mobility, going):
    """Set speeds and travels of a trial, and their change by r; return whether all joints slid."""
    rates, sliding = len(motion) // 2, True
    for i in range(JOINTS):
        if 0 < trial <= JOINTS:
            more = r[trial - 1] - before[trial - 1]
            mobility[i, trial - 1] = (motion[rates + i] - end[i]) / more
            going[i, trial - 1] = ((motion[i] - place[i]) / joints.step - travel[i]) / more
        end[i], travel[i] = motion[rates + i], (motion[i] - place[i]) / joints.step
        sliding = sliding and (joints.limit[i] == 0.0 or end[i] * speed[i] > 0.0)
    return sliding


@inlined
def _add_heat(joints, motion, place, speed, r, slope, friction):
    """Add the heat of friction in a step that ends with a motion."""
    rates = len(motion) // 2
    for i in range(JOINTS):
        friction[_HEAT] -= (r[i] * (motion[i] - place[i])
                            + slope[i] * joints.step * (motion[rates + i] - speed[i]) / 12.0)


@entry_point
def advance(tables, propagator, joints, friction, state, load, loads, first, sample_every, done,
            samples, heat):
    """
    Integrate over a run of equal steps with friction, as `etdrk4.advance` does without.

    Parameters
    ----------
    joints : packed constants
        Of `Joints`.
    friction : ndarray, shape (4,)
        Friction on carrier x, y [N] and shaft [N m] at the end of the last step; its heat [J].
        Advanced in place.
    heat : ndarray, shape (n,)
        Receives the heat with each sample.
    first : int
        Number of these steps that are done already; see `etdrk4.advance` for the others.

    """
    check(state, load, loads, propagator)
    size, three = propagator.whole, joints.limit
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    # Positions and speeds at the start of a step, speeds and travels / h at the end of a trial.
    place, speed, end, travel = local((three,)), local((three,)), local((three,)), local((three,))
    r, slope, acting, path = local((three,)), local((three,)), local((three,)), local((three,))
    before, sloping, last = local((three,)), local((three,)), local((three,))
    drift, bend, mobility = local((three,)), local((three,)), local((three, three))
    pull, turning, bending = local((three,)), local((three,)), local((three, three))
    going, cross = local((three, three)), local((three, three))
    passing, change, side = local((three,)), local((three,)), local((three,))
    room, turn = local((three,)), local((three,))
    motion, pushed = np.empty(samples.shape[1]), np.empty((STAGES, LOADS))
    _clear(mobility, going)
    copy(state, now)
    for k in range(first, len(loads) + 1):
        observe(tables, now, load, motion)
        if k > first:
            _add_heat(joints, motion, place, speed, r, slope, friction)
        for i in range(JOINTS):
            place[i], speed[i] = motion[i], motion[len(motion) // 2 + i]
        if sample_every and (done + k) % sample_every == 0:
            copy(motion, samples[(done + k) // sample_every])
            heat[(done + k) // sample_every] = friction[_HEAT]
        if k == len(loads) or k > first and not holds(tables, now, load):
            break

        for trial in range(_TRIALS):
            # Mean friction r of a trial: of sliding; changed for one joint; by the linear model.
            copy(r, before)
            if trial == 0:
                _slide(joints, speed, r, slope, acting)
            elif trial <= JOINTS:
                if joints.limit[trial - 1] == 0.0:
                    continue
                r[trial - 1] += joints.limit[trial - 1] * (1.0 if r[trial - 1] <= 0.0 else -1.0)
            else:
                fit(speed, end, travel, mobility, going, r, slope, drift, bend, cross, bending)
                if solve(joints, speed, drift, bend, mobility, cross, bending, before, pull,
                         turning, passing, change, room, turn, side, acting, last, r, slope,
                         sloping, path):
                    break
            _push(loads[k], r, slope, pushed)
            one_step(tables, propagator, now, pushed[0], pushed[1], pushed[2], half, following,
                     combined, rate_0, rate_a, rate_b, rate_c, stage)
            observe(tables, stage, pushed[2], motion)
            sliding = _learn(joints, trial, motion, place, speed, r, before, end, travel, mobility,
                             going)
            if trial == 0 and sliding:
                break
        if not is_finite(stage):
            copy(now, state)
            return k
        copy(stage, now)
        copy(acting, friction[:JOINTS])
        load = loads[k, AFTER]
    copy(now, state)
    return k


class FrictionSteps(Steps):
    """
    Steps of a model with dry friction in its joints.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]
    limit : ndarray, shape (3,)
        Largest friction of carrier x, y [N] and shaft [N m]; 0: none.

    """

    def __init__(self, model, step, limit):
        super().__init__(model, step)
        self._joints = pack(Joints(limit, step))
        self.memory = np.zeros(JOINTS + 1)

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [*super().constants, self._joints]

    @property
    def friction(self):
        """Friction on carrier x, y [N], shaft [N m] at the end of the last step, shape (3,)."""
        return self.memory[:JOINTS].copy()

    @property
    def heat(self):
        """Heat of Coulomb friction since the initial motion [J]."""
        return float(self.memory[_HEAT])

    def warm_up(self, state, load):
        """Compile, or load from disk, the functions that `motion` does not call."""
        # A step without friction, for rates.
        self._observe(state[np.newaxis], load[np.newaxis])

    def advance(self, state, load, loads, sample_every, sampled, motions, heat):
        """Integrate over equal steps, see `Steps.advance`."""
        return self._by_sectors(state, load, loads, lambda part, first, load: advance(
            part.packed, part.propagator, self._joints, self.memory, state, load, loads, first,
            sample_every, sampled, motions, heat))

    def acting(self, load):
        """Return a load plus the friction at the end of the last step, shape (LOADS,)."""
        load = load.copy()
        load[list(COLUMNS)] += self.friction
        return load


def steps_of(model, step, friction=None):
    """
    Return the time steps of a model.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]
    friction : ndarray, shape (3,), optional
        Largest dry friction of carrier x, y [N] and shaft [N m].

    Returns
    -------
    Steps

    """
    if friction is not None and friction.any():
        return FrictionSteps(model, step, friction)
    return Steps(model, step)
