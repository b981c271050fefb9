# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Steps with Coulomb friction of the joints that stick: carrier along world x and y, and shaft.

Joints with presliding have that of `bristles` instead, which is a part of the step.

With an elastic gear the third joint is the rotor: the torque on it is the one that loads have.

In each step the friction of a joint is a straight line in time, with a mean R and a slope R' over
the step, which is added to the load. Trial steps find it, see doc/theory.md (T40) to (T42): one if
all joints slide through the whole step, a few more if a joint comes to rest, is held or breaks
away. No trial depends on earlier steps, so that it does not matter how many steps are done at
once. Time in a step runs from 0 to 1 here, so that the rate of a speed has its unit.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays, pack
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, Constants, inner, local, square_root
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import copy, linear_part_is_valid, observe
from timo_sim.model.layout import AFTER, LOADS, MOTOR_FRICTION, STAGES, STEP_LOADS, TORQUE
from timo_sim.steps.bristles import (
    Bent, BRISTLES, COLUMNS, HEAT, MEMORY, start_bristles)
from timo_sim.steps.etdrk4 import is_finite, one_step, Work
from timo_sim.steps.steps import Steps

JOINTS = 3  # of `COLUMNS`
_SAME = 1e-12   # relative change of R treated as converged; speeds then end at zero to round-off
_STILL = 1e-12  # path treated as rest [m, rad]: what is at rest stays there to the last bit
_TRIALS = 12    # most trial steps; the first and one for each joint identify the linear model
_ROUNDS = 30    # most rounds for mean and slope in the linear model
_SWEEPS = 200   # most sweeps over the joints in `_hold`


class Joints(NamedTuple):
    """Constants of the compiled function."""

    # Friction of carrier x, y [N] and rotor [N m] that sticks; 0: none.
    limit: Annotated[np.ndarray, 3]
    step: float  # [s]
    # Turn of the rotor per coordinate of an elastic gear, and the coordinate's place in a motion.
    gear: Annotated[np.ndarray, 'gears']
    place: int


class _Room(NamedTuple):
    """Work arrays: the loads of a step with friction, and a motion."""

    pushed: Annotated[np.ndarray, STAGES, LOADS]
    motion: Annotated[np.ndarray, 'motion']


class FrictionSteps(Steps):
    """
    Steps of a model with dry friction in its joints that sticks.

    `limit` is the largest friction of carrier x, y [N] and shaft [N m] that stick, (3,); 0: none.
    """

    def __init__(self, model: Formulation, step: float, limit: np.ndarray,
                 bristles: np.ndarray) -> None:
        super().__init__(model, step, bristles)
        place, self._has_friction = model.gear_place, True
        self.joints = pack(Joints(limit, step, model.rotor[[place] * bool(model.gear)], place))

    def _compiled(self, part):
        return advance.of(*part, self.bristles, self.joints)


def steps_of(model: Formulation, step: float, limit: np.ndarray, bristles: np.ndarray) -> Steps:
    """Return equal steps [s] of a model, with dry friction if it has any, see FrictionSteps."""
    if limit.any():
        return FrictionSteps(model, step, limit, bristles)
    return Steps(model, step, bristles)


class Trial(NamedTuple):
    """Work arrays of a step by joint: its start, and its end in the last trial."""

    start: Annotated[np.ndarray, 3]         # position at the start
    speed: Annotated[np.ndarray, 3]         # speed at the start
    end_speed: Annotated[np.ndarray, 3]
    travel: Annotated[np.ndarray, 3]        # way over the duration of the step
    mean: Annotated[np.ndarray, 3]          # R of the friction
    slope: Annotated[np.ndarray, 3]         # R'
    tried: Annotated[np.ndarray, 3]         # R of the trial before
    end_friction: Annotated[np.ndarray, BRISTLES]  # friction at the end of the step, by column


class StepModel(NamedTuple):
    """Work arrays of the linear model of a step (T42): how its end depends on the friction."""

    drift: Annotated[np.ndarray, 3]               # d
    bend: Annotated[np.ndarray, 3]                # e, of a speed that is a parabola in time
    speed_per_mean: Annotated[np.ndarray, 3, 3]   # B, the speed at the end of the step per R
    travel_per_mean: Annotated[np.ndarray, 3, 3]  # B_x
    speed_per_slope: Annotated[np.ndarray, 3, 3]  # C, the same speed per R'
    bend_per_slope: Annotated[np.ndarray, 3, 3]   # B_s


@inner
def _turn_rotor(joints, motion):
    """Add the twist of an elastic gear, and its rate, to those of the shaft in a motion."""
    half = len(motion) // 2
    for n in range(len(joints.gear)):
        motion[2] += joints.gear[n] * motion[joints.place]
        motion[half + 2] += joints.gear[n] * motion[half + joints.place]


@inner
def _sign(value):
    return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0


@inner
def _hold(direction, pull, mobility, room, friction):
    """
    Set the friction of joints at rest such that it cancels their pull, within +-room.

    Where room is too small, friction is at its end and the joint breaks away. Both together are a
    linear complementarity problem with a positive definite matrix; projected Gauss-Seidel
    converges to its one solution.
    """
    for _ in range(_SWEEPS):
        changed = False
        for i in range(JOINTS):
            if room[i] > 0.0 and direction[i] == 0.0:
                change = pull[i]
                for j in range(JOINTS):
                    if j != i:
                        change += mobility[i, j] * friction[j]
                last, friction[i] = friction[i], min(
                    max(-change / mobility[i, i], -room[i]), room[i])
                changed = changed or abs(friction[i] - last) > _SAME * room[i]
        if not changed:
            break


@inner
def _follow(joints, model, start_speed, drift, bend, friction, mean, slope):
    """
    Follow speeds that are parabolas from event to event through a step, (T41).

    An event is that a joint comes to rest. `drift` and `bend` are d and e of (T41). `mean` and
    `slope` receive R and R' of the friction over the step, `friction` its value at the end.
    """
    three = joints.limit
    speed, direction, pull = local((three,)), local((three,)), local((three,))
    rate, room, held_slope = local((three,)), local((three,)), local((three,))
    for i in range(JOINTS):
        speed[i], direction[i] = start_speed[i], _sign(start_speed[i])
        mean[i], slope[i], held_slope[i] = 0.0, 0.0, 0.0
    left, span = 1.0, 1.0  # what remains of the step, and the time to the next event
    for _ in range(JOINTS + 1):  # each joint comes to rest once at most
        # The friction of sliding joints, and of joints at rest: held or breaking away.
        for i in range(JOINTS):
            # The pull on a joint at rest, including what brings its speed to zero at the end.
            pull[i] = drift[i] + 0.5 * (1.0 - left) * bend[i] + speed[i] / left
            if direction[i] != 0.0:
                friction[i] = -joints.limit[i] * direction[i]
        _hold(direction, pull, model.speed_per_mean, joints.limit, friction)

        # The first zero of a sliding joint's speed, speed + rate t + bend t^2 / 2, from now on; it
        # is written without the cancellation of a nearly straight parabola.
        span, stops = left, -1
        for i in range(JOINTS):
            rate[i] = drift[i] + (0.5 - left) * bend[i]
            for j in range(JOINTS):
                rate[i] += model.speed_per_mean[i, j] * friction[j]
            root = square_root(rate[i] * rate[i] - 2.0 * bend[i] * speed[i])
            falling = root - direction[i] * rate[i]
            until = 2.0 * direction[i] * speed[i] / falling
            if joints.limit[i] * abs(direction[i]) > 0.0 and falling > 0.0 and until < span:
                span, stops = until, i

        # Until then friction is constant. Its share of R' is that of its first moment.
        for i in range(JOINTS):
            speed[i] += span * (rate[i] + 0.5 * span * bend[i])
            mean[i] += span * friction[i]
            slope[i] += 6.0 * span * (1.0 - 2.0 * left + span) * friction[i]
        left -= span
        if stops < 0:
            break
        direction[stops], speed[stops] = 0.0, 0.0

    # Joints held to the end have friction with a slope, too, which cancels the bend of their speed
    # within the limits. It acts over the last span only.
    for i in range(JOINTS):
        room[i] = 2.0 * (joints.limit[i] - abs(friction[i])) / span
    _hold(direction, bend, model.bend_per_slope, room, held_slope)
    for i in range(JOINTS):
        slope[i] += span * span * span * held_slope[i]
        friction[i] += 0.5 * span * held_slope[i]


@inner
def _same(joints, mean, other):
    """Return whether two values of R are equal but for round-off."""
    for i in range(JOINTS):
        if abs(mean[i] - other[i]) > _SAME * joints.limit[i]:
            return False
    return True


@inner
def _fit_model(trial, model):
    """Set the rest of the linear model (T42) from the last trial, whose friction was R, R'."""
    for i in range(JOINTS):
        model.drift[i] = trial.end_speed[i] - trial.speed[i]
        model.bend[i] = 6.0 * (trial.speed[i] + trial.end_speed[i]) - 12.0 * trial.travel[i]
        for j in range(JOINTS):
            speed_per_mean, travel_per_mean = (
                model.speed_per_mean[i, j], model.travel_per_mean[i, j])
            model.speed_per_slope[i, j] = travel_per_mean - 0.5 * speed_per_mean
            model.bend_per_slope[i, j] = 6.4 * travel_per_mean - 2.2 * speed_per_mean
            model.drift[i] -= (speed_per_mean * trial.mean[j]
                               + model.speed_per_slope[i, j] * trial.slope[j])
            model.bend[i] -= (model.bend_per_slope[i, j] * trial.slope[j]
                              - 12.0 * model.speed_per_slope[i, j] * trial.mean[j])


@inner
def _solve_model(joints, model, trial):
    """
    Set R and R' by the linear model, in rounds because each depends on the other.

    Return whether R is `tried`, that of the last trial, which then is the step.
    """
    three, mean, tried = joints.limit, trial.mean, trial.tried
    drift, bend = local((three,)), local((three,))
    next_slope, last = local((three,)), local((three,))
    copy(trial.slope, next_slope)
    for _ in range(_ROUNDS):
        # (T42) has R' in the speed at the end, and R in the bend; (T41) has them in d and e.
        for i in range(JOINTS):
            drift[i], bend[i] = model.drift[i], model.bend[i]
            for j in range(JOINTS):
                drift[i] += model.speed_per_slope[i, j] * next_slope[j]
                bend[i] -= 12.0 * model.speed_per_slope[i, j] * mean[j]
            if abs(bend[i]) * joints.step <= 12.0 * _STILL:
                bend[i] = 0.0
        copy(mean, last)
        copy(tried, trial.end_friction)
        _follow(joints, model, trial.speed, drift, bend, trial.end_friction, mean, next_slope)
        if _same(joints, mean, last):
            break
    solved = _same(joints, mean, tried)
    if solved:
        copy(tried, mean)
    else:
        copy(next_slope, trial.slope)
    return solved


@inner
def _let_slide(joints, trial):
    """Set the friction of joints that slide through the whole step."""
    for i in range(JOINTS):
        trial.mean[i] = trial.end_friction[i] = -joints.limit[i] * _sign(trial.speed[i])
        trial.slope[i] = 0.0


@inner
def _add_friction(loads, trial, pushed):
    """Set the loads of a step with friction at its start, middle and end."""
    for j in range(STAGES):
        copy(loads[j], pushed[j])
        for i in range(JOINTS):
            pushed[j, COLUMNS[i]] += trial.mean[i] + 0.5 * (j - 1) * trial.slope[i]


@inner
def _note_trial(joints, model, trial, number, motion):
    """
    Set speeds and travels of a trial, by whose motion it ends; return whether all joints slid.

    Trials 1 to 3 changed R of one joint: their differences to the trial before are the columns of
    B and B_x.
    """
    rates, sliding = len(motion) // 2, True
    for i in range(JOINTS):
        end_speed = motion[rates + i]
        travel = (motion[i] - trial.start[i]) / joints.step
        if 0 < number <= JOINTS:
            more = trial.mean[number - 1] - trial.tried[number - 1]
            model.speed_per_mean[i, number - 1] = (end_speed - trial.end_speed[i]) / more
            model.travel_per_mean[i, number - 1] = (travel - trial.travel[i]) / more
        trial.end_speed[i], trial.travel[i] = end_speed, travel
        sliding = sliding and (joints.limit[i] == 0.0 or end_speed * trial.speed[i] > 0.0)
    return sliding


@inner
def _add_heat(joints, motion, trial, memory):
    """Add the heat of friction in a step that ends with a motion."""
    rates = len(motion) // 2
    for i in range(JOINTS):
        memory[HEAT] -= (
            trial.mean[i] * (motion[i] - trial.start[i])
            + trial.slope[i] * joints.step * (motion[rates + i] - trial.speed[i]) / 12.0)


@entry_point(tables=Constants(), propagator=Constants(), bristles=Constants(),
             joints=Constants(), memory=Array((MEMORY,), own=True),
             state=Array(('state',), own=True), load=Array((LOADS,), own=True),
             loads=Array((None, STEP_LOADS, LOADS), own=True), count=int, sample_every=int,
             since=int, samples=Array((None, 'motion'), own=True), heat=Array((None,), own=True))
def advance(tables, propagator, bristles, joints, memory, state, load, loads, count, sample_every,
            since, samples, heat):
    """
    Integrate over a run of equal steps with friction, as `etdrk4.advance` does without.

    `memory`, see `bristles`, is advanced in place. `heat` receives that with each sample.
    """
    work, trial = local_arrays(Work, propagator), local_arrays(Trial, joints)
    now, following, model = work.now, work.following, local_arrays(StepModel, joints)
    pushed, motion = local_arrays(_Room, tables)
    bent = local_arrays(Bent, bristles)
    for i in range(BRISTLES):
        trial.end_friction[i] = 0.0
    for i in range(JOINTS):
        for j in range(JOINTS):
            # They stay zero for joints without friction.
            model.speed_per_mean[i, j] = model.travel_per_mean[i, j] = 0.0
    copy(state, now)
    k = 0
    while True:
        observe(tables, now, load, motion)
        sampled = sample_every != 0 and (since + k) % sample_every == 0
        if sampled:
            copy(motion, samples[(since + k) // sample_every])
        start_bristles(tables, bristles, now, load, motion, k > 0, bent, memory)
        _turn_rotor(joints, motion)
        if k > 0:
            _add_heat(joints, motion, trial, memory)
        for i in range(JOINTS):
            trial.start[i], trial.speed[i] = motion[i], motion[len(motion) // 2 + i]
        if sampled:
            heat[(since + k) // sample_every] = memory[HEAT]
        if k == count or k > 0 and not linear_part_is_valid(tables, now, load):
            break

        for number in range(_TRIALS):
            # R of a trial is that of sliding, then changed for one joint, then of the model.
            copy(trial.mean, trial.tried)
            if number == 0:
                _let_slide(joints, trial)
            elif number <= JOINTS:
                joint = number - 1
                if joints.limit[joint] == 0.0:
                    continue
                trial.mean[joint] += joints.limit[joint] * (
                    1.0 if trial.mean[joint] <= 0.0 else -1.0)
            else:
                _fit_model(trial, model)
                if _solve_model(joints, model, trial):
                    break
            _add_friction(loads[k], trial, pushed)
            for j in range(STAGES):
                pushed[j, MOTOR_FRICTION] = pushed[j, TORQUE] - loads[k, j, TORQUE]
            one_step(propagator, tables, bristles, bent, pushed[0], pushed[1], pushed[2], work)
            observe(tables, following, pushed[2], motion)
            _turn_rotor(joints, motion)
            sliding = _note_trial(joints, model, trial, number, motion)
            if number == 0 and sliding:
                break
        if not is_finite(following):
            break
        copy(following, now)
        copy(trial.end_friction, memory)
        load = loads[k, AFTER]
        k += 1
    copy(now, state)
    return k
