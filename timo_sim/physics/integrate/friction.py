# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Dry friction of the joints: of the carrier along world x and y, and of the shaft.

In each step the friction of a joint is a straight line in time, a mean R and a slope R', which is
added to the load. It is found by trial steps, see doc/theory.md (T38)-(T40): one if all joints
slide through the whole step, a few more if a joint comes to rest, is held or breaks away. No trial
depends on earlier steps, so that it does not matter how many steps are done at once.
"""

import numpy as np

from timo_sim.jit.constants import local, pack
from timo_sim.jit.decorators import entry_point, inlined
from timo_sim.physics.equations.functions import holds, observe
from timo_sim.physics.integrate.etdrk4 import check, copy, is_finite, one_step
from timo_sim.physics.integrate.friction_events import (
    COLUMNS, fit, JOINTS, Joints, solve)
from timo_sim.physics.integrate.steps import Steps
from timo_sim.physics.layout import AFTER, LOADS, STAGES

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
        """Return a load plus the friction at the end of the last step, shape (14,)."""
        load = load.copy()
        load[list(COLUMNS)] += self.friction
        return load
