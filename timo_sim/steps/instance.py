# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
An instance of an exported arm: a block of memory, and the compiled functions that work on it.

They are what a C library needs besides the step itself: loads of a step, commands, outputs and
saved states, see `export`. All return one of `Code`.
"""

from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.functions import (
    Array, Constants, entry_point, floor, inner, local, magnitude, square_root, strict)
from timo_sim.model.functions import (
    effort, energy, linear_part_is_valid, observe, rate, sincos, tanh, tip, tip_rate)
from timo_sim.model.layout import (
    ACCELERATION, AFTER, ANGLE, END, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, LOADS, MIDDLE, SPEED,
    STAGES, START, STEP_LOADS, TORQUE, VOLTAGE)


class Code(IntEnum):
    """What a function of the library returns."""

    OK = 0
    NULL_POINTER = 1
    BAD_MEMORY = 2
    NOT_CREATED = 3
    UNKNOWN_NUMBER = 4
    NOT_FINITE = 5
    NEGATIVE_STEPS = 6
    BAD_STATE = 7
    DIVERGED = 8


_OK, _UNKNOWN, _NOT_FINITE, _BAD_STATE, _DIVERGED = (int(code) for code in (
    Code.OK, Code.UNKNOWN_NUMBER, Code.NOT_FINITE, Code.BAD_STATE, Code.DIVERGED))

# Places in `Instance.mark`: what shows that the memory is an instance, steps done, number of the
# linear part, which `Instance.outputs` are those of now (0: none, 1: those of the motion, 2: all),
# whether the finer run diverged, and the step at which lines towards commands began.
MARK, STEPS, PART, KNOWN, LOST, SINCE = range(6)
MAGIC = 0x74696d6f5f73696d  # 'timo_sim'
_MOST_STEPS = 2.0**53  # to which steps are counted in a saved state
_NEAR = 1e-6  # [steps] distance from a step boundary that counts as on it, as in `scene.loads`
_NODE = 0.5773502691896257  # of Gauss's rule with two nodes


class Instance(NamedTuple):
    """The memory of an instance; its functions change it."""

    mark: Annotated[np.ndarray, int, 6]
    inputs: Annotated[np.ndarray, LOADS]  # commands
    goal: Annotated[np.ndarray, LOADS]    # the same within their limits
    origin: Annotated[np.ndarray, LOADS]  # where lines towards the goal began
    load: Annotated[np.ndarray, LOADS]    # at the end of the last step
    acting: Annotated[np.ndarray, LOADS]  # the same with dry friction
    friction: Annotated[np.ndarray, 4]    # of `friction.advance`: what steps hand on
    friction_before: Annotated[np.ndarray, 4]  # the same before the last step
    heat: Annotated[np.ndarray, 1]        # room for its sample
    error: Annotated[np.ndarray, 1]       # estimated error of the tip [m]
    state: Annotated[np.ndarray, 'state']
    before: Annotated[np.ndarray, 'state']     # the state before the last step
    remainder: Annotated[np.ndarray, 'state']  # room for a step
    loads: Annotated[np.ndarray, STEP_LOADS, LOADS]  # those of a step
    motion: Annotated[np.ndarray, 'motion']
    accelerations: Annotated[np.ndarray, 'motion']  # 3 + N of them
    early: Annotated[np.ndarray, 'motion']  # shortly before and after now
    late: Annotated[np.ndarray, 'motion']
    tip: Annotated[np.ndarray, 3]    # of `model.functions.tip`
    place: Annotated[np.ndarray, 3]  # tip in world axes [m], rotation of the end effector [rad]
    outputs: Annotated[np.ndarray, 'outputs']


class Plant(NamedTuple):
    """Constants of a model and of its start."""

    step: float  # [s]
    length: float  # of the arm [m]
    most_bent: float  # deflection beyond which a run counts as diverged [m]
    travel: Annotated[np.ndarray, 'modes']        # of the tip by each modal coordinate
    tip_rotation: Annotated[np.ndarray, 'modes']  # of the end effector by each
    points_rotation: Annotated[np.ndarray, 'modes', 'points']  # of sections by each
    gravity: Annotated[np.ndarray, 2]  # along world x and y [m/s2]
    linear: Annotated[np.ndarray, 'state', 'state']  # L of the straight arm
    constrained: Annotated[np.ndarray, int, 3]  # whether carrier x, y and shaft are
    shaft_inertia: float  # [kg m2]
    shaft_friction: Annotated[np.ndarray, 3]  # viscous; Coulomb and the speed of its build-up
    # Strain of the outer fibre at the root per moment there, modal coordinate and modal rate.
    strain_of_moment: float
    strain_of_modes: Annotated[np.ndarray, 'modes']
    strain_of_rates: Annotated[np.ndarray, 'modes']
    start: Annotated[np.ndarray, 'state']  # the initial state
    first_load: Annotated[np.ndarray, LOADS]  # the scene's own at its beginning


class SceneLoads(NamedTuple):
    """
    Loads of a scene over time, as in `scene.loads`, and what its actuators make of commands.

    Pieces and tables are parts, from `begin` to `end`, of the same arrays.
    """

    step: float  # [s]
    gain: float  # torque per voltage [N m/V]
    limit: Annotated[np.ndarray, LOADS]  # of commands
    rate: Annotated[np.ndarray, LOADS]   # limit of their rate, or 0: they act at once
    harmonic_column: Annotated[np.ndarray, int, 'harmonics']
    amplitude: Annotated[np.ndarray, 'harmonics']
    frequency: Annotated[np.ndarray, 'harmonics']
    phase: Annotated[np.ndarray, 'harmonics']
    piece_column: Annotated[np.ndarray, int, 'pieces']
    piece_begin: Annotated[np.ndarray, int, 'pieces']
    piece_end: Annotated[np.ndarray, int, 'pieces']
    jump_step: Annotated[np.ndarray, 'jumps']  # from which the value acts
    jump_value: Annotated[np.ndarray, 'jumps']
    table_column: Annotated[np.ndarray, int, 'tables']
    table_begin: Annotated[np.ndarray, int, 'tables']
    table_end: Annotated[np.ndarray, int, 'tables']
    knot: Annotated[np.ndarray, 'knots']  # [s]
    knot_value: Annotated[np.ndarray, 'knots']
    # The drive: its points [s], and coefficients of the polynomial from each, constant first; that
    # from the last point is a straight line.
    drive_time: Annotated[np.ndarray, 'points']
    drive: Annotated[np.ndarray, 'points', 6]
    # What the moments of a step with a kink inside add to its stages, see `scene.loads`.
    kink_step: Annotated[np.ndarray, 'kinks']
    kink_column: Annotated[np.ndarray, int, 'kinks']
    kink_change: Annotated[np.ndarray, 'kinks', STAGES]


@entry_point(plant=Constants(), instance=Constants())
def reset(plant, instance):
    """Return to the start; commands are 0."""
    for k in range(len(instance.mark)):
        instance.mark[k] = 0
    instance.mark[MARK] = MAGIC
    instance.error[0] = 0.0
    for k in range(LOADS):
        instance.inputs[k] = instance.goal[k] = instance.origin[k] = 0.0
        instance.load[k] = plant.first_load[k]
    for k in range(len(instance.state)):
        instance.state[k] = plant.start[k]
    for k in range(len(instance.friction)):
        instance.friction[k] = 0.0
    return _OK


@strict
def _finite(value):
    return value - value == 0.0


@entry_point(instance=Constants(), column=int, value=float)
def set_input(instance, column, value):
    """Set a command by its column of the load."""
    if not _finite(value):
        return _NOT_FINITE
    instance.inputs[column] = value
    return _OK


@entry_point(instance=Constants(), column=int, value=Array((1,)))
def get_input(instance, column, value):
    """Write a command by its column of the load."""
    value[0] = instance.inputs[column]
    return _OK


@entry_point(tables=Constants(), instance=Constants())
def is_valid(tables, instance):
    """Return whether the linear part of the tables is the one for the state."""
    return 1 if linear_part_is_valid(tables, instance.state, instance.load) else 0


@entry_point(loads=Constants(), instance=Constants(), inputs=Array((LOADS,)))
def prepare(loads, instance, inputs):
    """Write the loads of the next step under commands; keep the state."""
    _write_scene_loads(loads, instance.mark[STEPS], instance.loads)
    _command(loads, instance, inputs)
    _add_commands(loads, instance, instance.loads)
    for k in range(len(instance.state)):
        instance.before[k] = instance.state[k]
    for k in range(len(instance.friction)):
        instance.friction_before[k] = instance.friction[k]
    return _OK


# Without fast math: Python computes the same numbers.

@strict
def _write_scene_loads(loads, number, out):
    for column in range(LOADS):
        for stage in range(STAGES):
            out[stage, column] = 0.0
    for stage in range(STAGES):
        time = 0.5 * (2 * number + stage) * loads.step
        for i in range(len(loads.amplitude)):
            sine, _ = sincos(2.0 * np.pi * loads.frequency[i] * time + loads.phase[i])
            out[stage, loads.harmonic_column[i]] += loads.amplitude[i] * sine
        for i in range(len(loads.piece_column)):
            begin = loads.piece_begin[i]
            found = _count(loads.jump_step, begin, loads.piece_end[i], 1.0 * number, True)
            if found > begin:
                out[stage, loads.piece_column[i]] += loads.jump_value[found - 1]
        for i in range(len(loads.table_column)):
            out[stage, loads.table_column[i]] += _at(
                loads, loads.table_begin[i], loads.table_end[i], time, stage != END)
        _write_drive(loads, time, out, stage)
    for column in range(LOADS):
        out[AFTER, column] = out[END, column]
    kink = _count(loads.kink_step, 0, len(loads.kink_step), 1.0 * number, False)
    while kink < len(loads.kink_step) and loads.kink_step[kink] == number:
        for stage in range(STAGES):
            out[stage, loads.kink_column[kink]] += loads.kink_change[kink, stage]
        kink += 1


@strict
def _count(values, begin, end, value, equal):
    """Return the place, from `begin` to `end`, before which ascending values are smaller."""
    while begin < end:
        middle = (begin + end) // 2
        if values[middle] < value or equal and values[middle] == value:
            begin = middle + 1
        else:
            end = middle
    return begin


@strict
def _at(loads, begin, end, time, equal):
    right = _count(loads.knot, begin, end, time, equal)
    low, high = max(right - 1, begin), min(right, end - 1)
    span = loads.knot[high] - loads.knot[low]
    share = 0.0
    if span > 0.0:
        share = (time - loads.knot[low]) / span
    return loads.knot_value[low] + share * (loads.knot_value[high] - loads.knot_value[low])


@strict
def _write_drive(loads, time, out, stage):
    if len(loads.drive_time):
        point = max(_count(loads.drive_time, 0, len(loads.drive_time), time, True) - 1, 0)
        since = time - loads.drive_time[point]
        angle, speed, acceleration = 0.0, 0.0, 0.0
        for j in range(6):
            # Horner's scheme, with the halves of second derivatives.
            acceleration = acceleration * since + speed
            speed = speed * since + angle
            angle = angle * since + loads.drive[point, 5 - j]
        out[stage, ANGLE] += angle
        out[stage, SPEED] += speed
        out[stage, ACCELERATION] += 2.0 * acceleration


# Actuators, as in `simulation.loads`.

@strict
def _command(loads, instance, inputs):
    """Take the commands of a step: a new goal begins new lines towards it."""
    changed = False
    for column in range(LOADS):
        value = min(max(inputs[column], -loads.limit[column]), loads.limit[column])
        changed = changed or value != instance.goal[column]
    if changed:
        number = instance.mark[STEPS]
        elapsed = (number - instance.mark[SINCE]) * loads.step
        for column in range(LOADS):
            instance.origin[column] = _reached(loads, instance, column, elapsed)
        for column in range(LOADS):
            instance.goal[column] = min(max(inputs[column], -loads.limit[column]),
                                        loads.limit[column])
        instance.mark[SINCE] = number


@strict
def _reached(loads, instance, column, elapsed):
    """Return what acts of a command some time after the lines began."""
    goal, origin = instance.goal[column], instance.origin[column]
    most = elapsed * loads.rate[column]
    value = goal
    if loads.rate[column] > 0.0 and not magnitude(goal - origin) <= most:
        value = origin + most if goal > origin else origin - most
    return value


@strict
def _next_end(loads, instance, after, before):
    """Return where the next line reaches its goal between two positions, counted in steps."""
    for column in range(LOADS):
        if loads.rate[column] > 0.0:
            end = magnitude(instance.goal[column] - instance.origin[column]) / (
                loads.rate[column] * loads.step)
            whole = floor(end + 0.5)
            if magnitude(end - whole) > _NEAR and after < end and end < before:
                before = end
    return before


@strict
def _add_commands(loads, instance, out):
    begin = 1.0 * (instance.mark[STEPS] - instance.mark[SINCE])
    bent = _next_end(loads, instance, begin, begin + 1.0) < begin + 1.0
    for column in range(LOADS):
        motor = 0.0
        if column == TORQUE:
            motor = loads.gain * instance.goal[VOLTAGE]
        if loads.rate[column] == 0.0:
            for row in range(STEP_LOADS):
                out[row, column] += instance.goal[column] + motor
        else:
            for row in range(STEP_LOADS):
                value = 0.0
                if bent and row < STAGES:
                    value = _parabola(loads, instance, column, begin, row)
                else:
                    position = begin + (0.5 * row if row < AFTER else 1.0)
                    value = _reached(loads, instance, column, position * loads.step)
                out[row, column] += value + motor


@strict
def _parabola(loads, instance, column, begin, row):
    """Return a stage of a step in which a line ends, from its moments, see `scene.loads`."""
    moment_0, moment_1, moment_2 = 0.0, 0.0, 0.0
    low = begin
    while low < begin + 1.0:
        high = _next_end(loads, instance, low, begin + 1.0)
        for k in range(2):
            node = -_NODE if k == 0 else _NODE
            at = low + (high - low) * (0.5 + 0.5 * node)
            share, s = 0.5 * (high - low), at - begin
            value = _reached(loads, instance, column, at * loads.step)
            moment_0 += share * value
            moment_1 += share * s * value
            moment_2 += share * (s * s) * value
        low = high
    if row == START:
        return 9.0 * moment_0 - 36.0 * moment_1 + 30.0 * moment_2
    if row == MIDDLE:
        return -1.5 * moment_0 + 15.0 * moment_1 - 15.0 * moment_2
    return 3.0 * moment_0 - 24.0 * moment_1 + 30.0 * moment_2


@entry_point(plant=Constants(), instance=Constants(), done=int)
def finish(plant, instance, done):
    """Accept a step that was done, or return to the state before it."""
    bend, half = 0.0, len(instance.state) // 2
    for k in range(len(plant.travel)):
        coordinate = instance.state[half - len(plant.travel) + k]
        bend += max(coordinate, -coordinate) * plant.travel[k]
    if done != 1 or not bend <= plant.most_bent:
        for k in range(len(instance.state)):
            instance.state[k] = instance.before[k]
        for k in range(len(instance.friction)):
            instance.friction[k] = instance.friction_before[k]
        return _DIVERGED
    instance.mark[STEPS] += 1
    instance.mark[KNOWN] = 0
    for k in range(LOADS):
        instance.load[k] = instance.loads[AFTER, k]
    return _OK


@entry_point(instance=Constants())
def set_place(instance):
    """Write the place of the tip in the world, from the motion and `tip`."""
    motion, tip = instance.motion, instance.tip
    sine, cosine = sincos(motion[2])
    instance.place[0] = motion[0] + (cosine * tip[0] - sine * tip[1])
    instance.place[1] = motion[1] + (sine * tip[0] + cosine * tip[1])
    instance.place[2] = motion[2] + tip[2]
    return _OK


@entry_point(instance=Constants(), other=Array((3,)))
def compare(instance, other):
    """Note the distance from the tip of the finer run."""
    x, y = instance.place[0] - other[0], instance.place[1] - other[1]
    distance = square_root(x * x + y * y)
    if not distance <= instance.error[0]:
        instance.error[0] = distance
    return _OK


@entry_point(instance=Constants())
def lose(instance):
    """Note that the finer run diverged."""
    instance.mark[LOST] = 1
    instance.error[0] = np.nan
    return _OK


# Rates and forces are differences of motions shortly before and after now, as in `etdrk4.flow`.

_TURN = 1e-4  # largest turn of a section between now and then [rad]
# Numbers of the first output of rates and forces, and of the first one of a modal coordinate.
FORCES, MODAL = 13, 20


@entry_point(tables=Constants(), plant=Constants(), instance=Constants())
def set_rates(tables, plant, instance):
    """Write the accelerations, and the specific force at the tip to the outputs."""
    state, load, motion = instance.state, instance.acting, instance.motion
    for column in range(LOADS):
        load[column] = instance.load[column]
    load[FORCE_X] += instance.friction[0]
    load[FORCE_Y] += instance.friction[1]
    load[TORQUE] += instance.friction[2]
    half, size = len(motion) // 2, plant.linear.shape[0]
    slope, moved = local((plant.linear,)), local((plant.linear,))
    rate(tables, state, load, slope)
    for i in range(size):
        for j in range(size):
            slope[i] += plant.linear[i, j] * state[j]
    turning = 0.0
    for p in range(plant.points_rotation.shape[1]):
        here = motion[half + 2]
        for n in range(plant.points_rotation.shape[0]):
            here += plant.points_rotation[n, p] * motion[half + 3 + n]
        turning = max(turning, magnitude(here))
    time = _TURN / (_TURN + turning)
    drift = instance.loads[START]
    for k in range(2):
        sign = time if k else -time
        for i in range(size):
            moved[i] = state[i] + sign * slope[i]
        for column in range(LOADS):
            drift[column] = load[column]
        drift[ANGLE] += sign * load[SPEED]
        drift[SPEED] += sign * load[ACCELERATION]
        if k:
            observe(tables, moved, drift, instance.late)
        else:
            observe(tables, moved, drift, instance.early)
    for k in range(half):
        instance.accelerations[k] = (instance.late[half + k] - instance.early[half + k]) / (
            2.0 * time)
    before_x, before_y = _tip_speed(tables, instance, instance.early)
    after_x, after_y = _tip_speed(tables, instance, instance.late)
    x = (after_x - before_x) / (2.0 * time) - plant.gravity[0]
    y = (after_y - before_y) / (2.0 * time) - plant.gravity[1]
    sine, cosine = sincos(instance.place[2])
    instance.outputs[13] = cosine * x + sine * y
    instance.outputs[14] = cosine * y - sine * x
    return _OK


@inner
def _tip_speed(tables, instance, motion):
    """Return the velocity of the tip in world axes."""
    half, place, speed = len(motion) // 2, instance.loads[START], instance.loads[MIDDLE]
    tip(tables, motion, place)
    tip_rate(tables, motion, speed)
    along = speed[0] - motion[half + 2] * place[1]
    across = speed[1] + motion[half + 2] * place[0]
    sine, cosine = sincos(motion[2])
    return (motion[half] + (cosine * along - sine * across),
            motion[half + 1] + (sine * along + cosine * across))


@entry_point(tables=Constants(), plant=Constants(), instance=Constants())
def set_forces(tables, plant, instance):
    """Write strain, efforts and energy to the outputs."""
    load, motion, accelerations = instance.load, instance.motion, instance.accelerations
    out, half, needed = instance.outputs, len(motion) // 2, instance.loads[START]
    root = accelerations[2] * plant.shaft_inertia
    for axis in range(2):
        accelerations[axis] -= plant.gravity[axis]
    effort(tables, motion, accelerations, load, needed)
    sine, cosine = sincos(motion[2])
    out[16] = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    out[17] = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]
    out[18] = load[TORQUE]
    if plant.constrained[2] != 0:
        root -= needed[2]
    else:
        speed = motion[half + 2]
        root += plant.shaft_friction[0] * speed - instance.acting[TORQUE]
        if plant.shaft_friction[1] != 0.0:
            root += plant.shaft_friction[1] * tanh(speed / plant.shaft_friction[2])
    for joint in range(3):
        if plant.constrained[joint] != 0:
            out[16 + joint] = needed[joint] - out[16 + joint]
    out[15] = plant.strain_of_moment * root
    for n in range(len(plant.travel)):
        out[15] += (plant.strain_of_modes[n] * motion[3 + n]
                    + plant.strain_of_rates[n] * motion[half + 3 + n])
    out[19] = energy(tables, motion, plant.gravity)
    instance.mark[KNOWN] = 2
    return _OK


@entry_point(plant=Constants(), instance=Constants())
def set_outputs(plant, instance):
    """Write the outputs from the motion and the place of the tip."""
    motion, out, half = instance.motion, instance.outputs, len(instance.motion) // 2
    out[0] = instance.mark[STEPS] * plant.step
    for k in range(3):
        out[1 + k] = motion[k]
        out[4 + k] = motion[half + k]
        out[7 + k] = instance.place[k]
    out[10] = instance.tip[0] - plant.length
    out[11] = instance.tip[1]
    turning = motion[half + 2]
    modes = len(plant.travel)
    for k in range(modes):
        turning += plant.tip_rotation[k] * motion[half + 3 + k]
        out[MODAL + k] = motion[3 + k]
        out[MODAL + modes + k] = motion[half + 3 + k]
    out[12] = turning
    out[MODAL + 2 * modes] = instance.error[0]
    instance.mark[KNOWN] = 1
    return _OK


@entry_point(instance=Constants(), number=int, value=Array((1,)))
def get_output(instance, number, value):
    """Write an output."""
    value[0] = instance.outputs[number]
    return _OK


@entry_point(instance=Constants(), count=int, values=Array((None,)))
def get_outputs(instance, count, values):
    """Write the first outputs."""
    for k in range(count):
        values[k] = instance.outputs[k]
    return _OK


# A saved state: steps, since when lines go to commands, whether the finer run diverged, error,
# commands, goals, origins of lines, load, friction; then the state.
_FRICTION = 4 + 4 * LOADS
SAVED = _FRICTION + 4


@entry_point(instance=Constants(), values=Array((None,)))
def get_state(instance, values):
    """Write what `set_state` takes."""
    values[0] = 1.0 * instance.mark[STEPS]
    values[1] = 1.0 * instance.mark[SINCE]
    values[2] = 1.0 * instance.mark[LOST]
    values[3] = instance.error[0]
    for k in range(LOADS):
        values[4 + k] = instance.inputs[k]
        values[4 + LOADS + k] = instance.goal[k]
        values[4 + 2 * LOADS + k] = instance.origin[k]
        values[4 + 3 * LOADS + k] = instance.load[k]
    for k in range(len(instance.friction)):
        values[_FRICTION + k] = instance.friction[k]
    for k in range(len(instance.state)):
        values[SAVED + k] = instance.state[k]
    return _OK


@entry_point(instance=Constants(), values=Array((None,)))
def check_state(instance, values):
    """Return whether `set_state` may take these values."""
    steps, since, lost = values[0], values[1], values[2]
    if not 0.0 <= steps <= _MOST_STEPS or steps != floor(steps):
        return _BAD_STATE
    if not 0.0 <= since <= steps or since != floor(since):
        return _BAD_STATE
    if lost != 0.0 and lost != 1.0:
        return _BAD_STATE
    if lost == 0.0 and not 0.0 <= values[3]:
        return _BAD_STATE
    for k in range(4, SAVED + len(instance.state)):
        if not _finite(values[k]):
            return _NOT_FINITE
    return _OK


@entry_point(instance=Constants(), values=Array((None,)))
def set_state(instance, values):
    """Go on from a saved state, which was checked."""
    instance.mark[STEPS] = int(values[0])
    instance.mark[SINCE] = int(values[1])
    instance.mark[LOST] = int(values[2])
    instance.mark[KNOWN] = 0
    instance.mark[PART] = 0
    instance.error[0] = values[3]
    for k in range(LOADS):
        instance.inputs[k] = values[4 + k]
        instance.goal[k] = values[4 + LOADS + k]
        instance.origin[k] = values[4 + 2 * LOADS + k]
        instance.load[k] = values[4 + 3 * LOADS + k]
    for k in range(len(instance.friction)):
        instance.friction[k] = values[_FRICTION + k]
    for k in range(len(instance.state)):
        instance.state[k] = values[SAVED + k]
    return _OK
