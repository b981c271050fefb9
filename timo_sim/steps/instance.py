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

from timo_sim.compiled.functions import Array, Constants, entry_point, floor, square_root, strict
from timo_sim.model.functions import linear_part_is_valid, sincos
from timo_sim.model.layout import (
    ACCELERATION, AFTER, ANGLE, END, LOADS, SPEED, STAGES, STEP_LOADS, TORQUE, VOLTAGE)


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
# linear part, whether `Instance.outputs` are those of now, and whether the finer run diverged.
MARK, STEPS, PART, KNOWN, LOST = range(5)
MAGIC = 0x74696d6f5f73696d  # 'timo_sim'
_MOST_STEPS = 2.0**53  # to which steps are counted in a saved state


class Instance(NamedTuple):
    """The memory of an instance; its functions change it."""

    mark: Annotated[np.ndarray, int, 5]
    inputs: Annotated[np.ndarray, LOADS]  # commands
    load: Annotated[np.ndarray, LOADS]    # at the end of the last step
    error: Annotated[np.ndarray, 1]       # estimated error of the tip [m]
    state: Annotated[np.ndarray, 'state']
    before: Annotated[np.ndarray, 'state']     # the state before the last step
    remainder: Annotated[np.ndarray, 'state']  # room for a step
    loads: Annotated[np.ndarray, STEP_LOADS, LOADS]  # those of a step
    motion: Annotated[np.ndarray, 'motion']
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
        instance.inputs[k] = 0.0
        instance.load[k] = plant.first_load[k]
    for k in range(len(instance.state)):
        instance.state[k] = plant.start[k]
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
    _add_commands(loads, inputs, instance.loads)
    for k in range(len(instance.state)):
        instance.before[k] = instance.state[k]
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


@strict
def _add_commands(loads, inputs, out):
    for column in range(LOADS):
        value = min(max(inputs[column], -loads.limit[column]), loads.limit[column])
        if column == TORQUE:
            voltage = min(max(inputs[VOLTAGE], -loads.limit[VOLTAGE]), loads.limit[VOLTAGE])
            value = value + loads.gain * voltage
        for row in range(STEP_LOADS):
            out[row, column] += value


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
        out[13 + k] = motion[3 + k]
        out[13 + modes + k] = motion[half + 3 + k]
    out[12] = turning
    out[13 + 2 * modes] = instance.error[0]
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


# A saved state: steps, error, whether the finer run diverged, commands, load, state.
SAVED = 3 + 2 * LOADS


@entry_point(instance=Constants(), values=Array((None,)))
def get_state(instance, values):
    """Write what `set_state` takes."""
    values[0] = 1.0 * instance.mark[STEPS]
    values[1] = 1.0 * instance.mark[LOST]
    values[2] = instance.error[0]
    for k in range(LOADS):
        values[3 + k] = instance.inputs[k]
        values[3 + LOADS + k] = instance.load[k]
    for k in range(len(instance.state)):
        values[SAVED + k] = instance.state[k]
    return _OK


@entry_point(instance=Constants(), values=Array((None,)))
def check_state(instance, values):
    """Return whether `set_state` may take these values."""
    steps, lost = values[0], values[1]
    if not 0.0 <= steps <= _MOST_STEPS or steps != floor(steps):
        return _BAD_STATE
    if lost != 0.0 and lost != 1.0:
        return _BAD_STATE
    if lost == 0.0 and not 0.0 <= values[2]:
        return _BAD_STATE
    for k in range(3, SAVED + len(instance.state)):
        if not _finite(values[k]):
            return _NOT_FINITE
    return _OK


@entry_point(instance=Constants(), values=Array((None,)))
def set_state(instance, values):
    """Go on from a saved state, which was checked."""
    instance.mark[STEPS] = int(values[0])
    instance.mark[LOST] = int(values[1])
    instance.mark[KNOWN] = 0
    instance.mark[PART] = 0
    instance.error[0] = values[2]
    for k in range(LOADS):
        instance.inputs[k] = values[3 + k]
        instance.load[k] = values[3 + LOADS + k]
    for k in range(len(instance.state)):
        instance.state[k] = values[SAVED + k]
    return _OK
