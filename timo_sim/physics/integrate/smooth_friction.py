# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""
Coulomb friction of joints that builds up over a speed: `-limit tanh(v / speed)`.

It is part of n(y, t) at each stage of a step, see doc/theory.md, section 8, so that the step keeps
its order; no joint sticks. What makes it depend on the state is done here, not in the
formulations, so that models without it cost and compute what they did.
"""

import math
from typing import NamedTuple

import numpy as np

from timo_sim.jit.constants import local, pack
from timo_sim.jit.decorators import entry_point, inlined
from timo_sim.physics.equations.functions import holds, observe, rate
from timo_sim.physics.integrate.etdrk4 import (
    add_product, check, copy, is_finite, product)
from timo_sim.physics.integrate.friction_events import COLUMNS, JOINTS
from timo_sim.physics.integrate.steps import Steps
from timo_sim.physics.layout import AFTER, END, LOADS, MIDDLE, START

_HEAT = JOINTS  # place in `Steps.memory`, after the friction of each joint


class SmoothJoints(NamedTuple):
    """Constants of the compiled function, for carrier x, y and shaft."""

    limit: np.ndarray  # [N], [N], [N m]; 0: no friction; (3,)
    slow: np.ndarray   # speeds over which it builds up [m/s], [m/s], [rad/s], (3,)
    step: float        # [s]


@inlined
def _rubbed(tables, joints, state, load, motion, pushed, out):
    """Write n of a state under a load and its friction; return the power that this takes [W]."""
    observe(tables, state, load, motion)
    copy(load, pushed)
    power = 0.0
    for i in range(JOINTS):
        speed = motion[len(motion) // 2 + i]
        friction = -joints.limit[i] * math.tanh(speed / joints.slow[i])
        pushed[COLUMNS[i]] += friction
        power -= friction * speed
    rate(tables, state, pushed, out)
    return power


@inlined
def _keep(tables, joints, state, load, motion, memory):
    """Keep the friction of a state for what asks for it after the steps."""
    observe(tables, state, load, motion)
    for i in range(JOINTS):
        speed = motion[len(motion) // 2 + i]
        memory[i] = -joints.limit[i] * math.tanh(speed / joints.slow[i])


@entry_point
def advance(tables, propagator, joints, memory, state, load, loads, sample_every, done, samples,
            heat, remainder):
    """
    Integrate over some equal steps with friction, as `etdrk4.advance` does without.

    Parameters
    ----------
    joints : packed constants
        Of `SmoothJoints`.
    memory : ndarray, shape (4,)
        Friction on carrier x, y [N] and shaft [N m] at the end of the last step; its heat [J].
        Advanced in place.
    heat : ndarray, shape (n,)
        Receives the heat with each sample.

    """
    check(state, load, loads, propagator)
    size = propagator.whole
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    motion, pushed = np.empty(samples.shape[1]), np.empty(LOADS)
    copy(state, now)
    for k in range(len(loads) + 1):
        if sample_every and (done + k) % sample_every == 0:
            observe(tables, now, load, samples[(done + k) // sample_every])
            heat[(done + k) // sample_every] = memory[_HEAT]
        if k == len(loads) or k and not holds(tables, now, load):
            break
        start, middle, end = loads[k, START], loads[k, MIDDLE], loads[k, END]
        # The stages of `etdrk4.one_step`, with friction.
        power = _rubbed(tables, joints, now, start, motion, pushed, rate_0)
        product(propagator.half, now, half)
        copy(half, stage)
        add_product(propagator.half_weight, rate_0, stage)
        power += 2.0 * _rubbed(tables, joints, stage, middle, motion, pushed, rate_a)
        product(propagator.half, stage, following)
        copy(half, stage)
        add_product(propagator.half_weight, rate_a, stage)
        power += 2.0 * _rubbed(tables, joints, stage, middle, motion, pushed, rate_b)
        for i in range(len(size)):
            combined[i] = 2.0 * rate_b[i] - rate_0[i]
        add_product(propagator.half_weight, combined, following)
        power += _rubbed(tables, joints, following, end, motion, pushed, rate_c)
        for i in range(len(size)):
            combined[i] = rate_a[i] + rate_b[i]
        product(propagator.whole, now, stage)
        add_product(propagator.first, rate_0, stage)
        add_product(propagator.middle, combined, stage)
        add_product(propagator.last, rate_c, stage)
        if not is_finite(stage):
            break
        memory[_HEAT] += joints.step * power / 6.0
        copy(rate_0, remainder)
        copy(stage, now)
        load = loads[k, AFTER]
    if k:
        _keep(tables, joints, now, load, motion, memory)
    copy(now, state)
    return k


class SmoothFrictionSteps(Steps):
    """
    Steps of a model with Coulomb friction that builds up over a speed.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]
    limit, slow : ndarray, shape (3,)
        Largest friction of carrier x, y [N] and shaft [N m], and the speeds over which it builds
        up [m/s], [m/s], [rad/s].

    """

    def __init__(self, model, step, limit, slow):
        super().__init__(model, step)
        self._limit, self._slow = limit, np.where(limit > 0.0, slow, 1.0)
        self._joints = pack(SmoothJoints(self._limit, self._slow, self.step))
        self.memory = np.zeros(JOINTS + 1)

    @property
    def constants(self):
        """The packed constants for whose sizes machine code is needed, a list."""
        return [*super().constants, self._joints]

    def advance(self, state, load, loads, sample_every, sampled, motions, heat):
        """Integrate over equal steps, see `Steps.advance`."""
        return self._by_sectors(state, load, loads, lambda part, first, load: first + advance(
            part.packed, part.propagator, self._joints, self.memory, state, load, loads[first:],
            sample_every, sampled + first, motions, heat, self._remainder))

    @property
    def friction(self):
        """Friction on carrier x, y [N], shaft [N m] at the end of the last step, shape (3,)."""
        return self.memory[:JOINTS].copy()

    def acting(self, load):
        """Return a load plus the friction at the end of the last step, shape (14,)."""
        load = load.copy()
        load[list(COLUMNS)] += self.friction
        return load

    @property
    def heat(self):
        """Heat of Coulomb friction since the initial motion [J]."""
        return float(self.memory[JOINTS])
