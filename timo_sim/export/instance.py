# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
An instance of an exported arm: a block of memory, and the compiled functions that work on it.

They are what a C library needs besides the step itself: loads of a step, outputs and saved states,
see `export`. All return one of `Code`.
"""

from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import (
    Array, Constants, floor, inner, square_root, strict, WIDTH)
from timo_sim.model.functions import (
    copy, energy, linear_part_is_valid, motor_effort, place_point, rotor_turn, sense_forces,
    sincos, spring_torque, state_of)
from timo_sim.model.layout import (
    AFTER, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, LOADS, START, STEP_LOADS)
from timo_sim.steps.bristles import add_friction, MEMORY
from timo_sim.steps.loads import add_commands, add_scene_loads, restart
from timo_sim.steps.sensors import reading


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
    NOT_POSITIVE = 9
    TIP_CHANGES = 10


_OK, _UNKNOWN, _NOT_FINITE, _BAD_STATE, _DIVERGED, _NOT_POSITIVE = (int(code) for code in (
    Code.OK, Code.UNKNOWN_NUMBER, Code.NOT_FINITE, Code.BAD_STATE, Code.DIVERGED,
    Code.NOT_POSITIVE))

# Places in `Instance.mark`: what shows that the memory is an instance, steps done, number of the
# linear part, which `Instance.outputs` are those of now (0: none, 1: those of the motion, 2: all),
# whether the finer run diverged, and how often the load at the tip has changed.
MARK, STEPS, PART, KNOWN, LOST, TIP = range(6)
MAGIC = 0x74696d6f5f73696d  # 'timo_sim'
_LARGEST = 1e12  # of a number of a saved motion; from some 1e18 on outputs are not finite
_MOST_STEPS = 2.0**53  # to which steps are counted in a saved state


class Instance(NamedTuple):
    """The memory of an instance; its functions change it."""

    mark: Annotated[np.ndarray, int, 6]
    inputs: Annotated[np.ndarray, LOADS]  # commands
    load: Annotated[np.ndarray, LOADS]    # at the end of the last step
    acting: Annotated[np.ndarray, LOADS]  # the same with dry friction
    friction: Annotated[np.ndarray, MEMORY]    # what steps hand on
    friction_before: Annotated[np.ndarray, MEMORY]  # the same before the last step
    heat: Annotated[np.ndarray, 1]        # room for its sample
    error: Annotated[np.ndarray, 1]       # estimated error of the tip [m]
    state: Annotated[np.ndarray, 'state']
    before: Annotated[np.ndarray, 'state']     # the state before the last step
    loads: Annotated[np.ndarray, 1, STEP_LOADS, LOADS]  # those of a step
    sines: Annotated[np.ndarray, WIDTH]    # room for those of loads
    motion: Annotated[np.ndarray, 'motion']
    accelerations: Annotated[np.ndarray, 'motion']  # 3 + N of them
    tip: Annotated[np.ndarray, 3]    # of `model.functions.tip`
    place: Annotated[np.ndarray, 3]  # tip in world axes [m], rotation of the end effector [rad]
    outputs: Annotated[np.ndarray, 'outputs']
    # Readings of the last steps, in turn; none if sensors are exact.
    late: Annotated[np.ndarray, 'late', 'sensor_axes']


class Plant(NamedTuple):
    """Constants of a model, with one of its loads at the tip, and of its start."""

    step: float  # [s]
    length: float  # from the shaft's axis to the tip of the straight arm [m]
    most_bent: float  # deflection beyond which a run counts as diverged [m]
    travel: Annotated[np.ndarray, 'modes']        # of the tip by each modal coordinate
    imu_rotation: Annotated[np.ndarray, 'modes']  # of the section with the IMU by each
    points_rotation: Annotated[np.ndarray, 'modes', 'points']  # of sections by each
    gravity: Annotated[np.ndarray, 2]  # along world x and y [m/s2]
    linear: Annotated[np.ndarray, 'state', 'state']  # L of the straight arm
    start: Annotated[np.ndarray, 'state']  # the initial state
    first_load: Annotated[np.ndarray, LOADS]  # the scene's own at its beginning
    first_friction: Annotated[np.ndarray, MEMORY]  # what the first step begins with
    changes: Annotated[np.ndarray, int, 'changes']  # steps before which the load at the tip does
    added: Annotated[np.ndarray, 'changes', 3]  # what each picks up at rest, see `impact`
    columns: Annotated[np.ndarray, int, 'inputs']  # of a load, by the number of an input
    # By the number of a parameter: whether it limits rates, the columns from the first one to
    # before the last one.
    limits: Annotated[np.ndarray, int, 'parameters', 3]


@entry_point(plant=Constants(), actuators=Constants(), instance=Constants())
def reset(plant, actuators, instance):
    """Return to the start; commands are 0."""
    for k in range(len(instance.mark)):
        instance.mark[k] = 0
    instance.mark[MARK] = MAGIC
    instance.error[0] = 0.0
    actuators.since[0] = 0
    for k in range(LOADS):
        instance.inputs[k] = actuators.goal[k] = actuators.origin[k] = 0.0
    copy(plant.first_load, instance.load)
    copy(plant.start, instance.state)
    copy(plant.first_friction, instance.friction)
    return _OK


@strict
def _finite(value):
    return value - value == 0.0


@entry_point(plant=Constants(), instance=Constants(), number=int, value=float)
def set_input(plant, instance, number, value):
    """Set a command."""
    if not 0 <= number < len(plant.columns):
        return _UNKNOWN
    if not _finite(value):
        return _NOT_FINITE
    instance.inputs[plant.columns[number]] = value
    return _OK


@entry_point(plant=Constants(), instance=Constants(), number=int, value=Array((1,)))
def get_input(plant, instance, number, value):
    """Write a command."""
    if not 0 <= number < len(plant.columns):
        return _UNKNOWN
    value[0] = instance.inputs[plant.columns[number]]
    return _OK


@entry_point(plant=Constants(), actuators=Constants(), instance=Constants(), number=int,
             value=float)
def set_parameter(plant, actuators, instance, number, value):
    """Set a limit of commands, or of their rates."""
    if not 0 <= number < len(plant.limits):
        return _UNKNOWN
    if not value > 0.0:
        return _NOT_POSITIVE
    restart(actuators, instance.mark[STEPS])
    for column in range(plant.limits[number, 1], plant.limits[number, 2]):
        if plant.limits[number, 0] != 0:
            actuators.rate[column] = value
        else:
            actuators.limit[column] = value
    return _OK


@entry_point(plant=Constants(), actuators=Constants(), number=int, value=Array((1,)))
def get_parameter(plant, actuators, number, value):
    """Write a limit of commands, or of their rates."""
    if not 0 <= number < len(plant.limits):
        return _UNKNOWN
    column = plant.limits[number, 1]
    value[0] = actuators.rate[column] if plant.limits[number, 0] != 0 else actuators.limit[column]
    return _OK


@entry_point(tables=Constants(), instance=Constants())
def is_valid(tables, instance):
    """Return whether the linear part of the tables is the one for the state."""
    return 1 if linear_part_is_valid(tables, instance.state, instance.load) else 0


@entry_point(loads=Constants(), actuators=Constants(), instance=Constants(),
             inputs=Array((LOADS,)))
def prepare(loads, actuators, instance, inputs):
    """Write the loads of the next step under commands; keep the state."""
    number, out = instance.mark[STEPS], instance.loads
    for row in range(STEP_LOADS):
        for column in range(LOADS):
            out[0, row, column] = 0.0
    add_scene_loads(
        loads.step, loads.harmonics, len(loads.harmonics), loads.curves, len(loads.curves),
        loads.pieces, number, 1, out, instance.sines)
    add_commands(actuators, inputs, number, 1, out)
    copy(instance.state, instance.before)
    copy(instance.friction, instance.friction_before)
    return _OK


@entry_point(plant=Constants(), instance=Constants())
def tip_is_due(plant, instance):
    """Return whether the load at the tip changes before the next step."""
    made = instance.mark[TIP]
    due = made < len(plant.changes) and plant.changes[made] <= instance.mark[STEPS]
    return 1 if due else 0


@entry_point(plant=Constants(), instance=Constants(), added=Array((3,)))
def change_tip(plant, instance, added):
    """Note the change of the load at the tip; return whether something is `added` at rest."""
    copy(plant.added[instance.mark[TIP]], added)
    instance.mark[TIP] += 1
    return 1 if added[0] != 0.0 or added[1] != 0.0 else 0


@entry_point(tables=Constants(), instance=Constants())
def take_motion(tables, instance):
    """Go on from the motion, with the present load at the tip."""
    state_of(tables, instance.motion, instance.state)
    return _OK


@inner
def _find_tip(plant, instance):
    """Note how often the load at the tip has changed when so many steps are done."""
    instance.mark[TIP] = 0
    for k in range(len(plant.changes)):
        if plant.changes[k] < instance.mark[STEPS]:
            instance.mark[TIP] = k + 1


@entry_point(plant=Constants(), instance=Constants(), done=int)
def finish(plant, instance, done):
    """Accept a step that was done, or return to the state before it."""
    bend, half = 0.0, len(instance.state) // 2
    for k in range(len(plant.travel)):
        coordinate = instance.state[half - len(plant.travel) + k]
        bend += max(coordinate, -coordinate) * plant.travel[k]
    if done != 1 or not bend <= plant.most_bent:
        copy(instance.before, instance.state)
        copy(instance.friction_before, instance.friction)
        instance.mark[KNOWN] = 0
        _find_tip(plant, instance)
        return _DIVERGED
    instance.mark[STEPS] += 1
    instance.mark[KNOWN] = 0
    copy(instance.loads[0, AFTER], instance.load)
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


@entry_point(instance=Constants(), values=Array((9,)))
def get_finer(instance, values):
    """Write carrier x, y and shaft angle, their rates, and the place of the tip."""
    half = len(instance.motion) // 2
    for k in range(3):
        values[k] = instance.motion[k]
        values[3 + k] = instance.motion[half + k]
        values[6 + k] = instance.place[k]
    return _OK


@entry_point(tables=Constants(), outline=Constants(), instance=Constants(),
             values=Array((None, 2)))
def get_shape(tables, outline, instance, values):
    """Write the places of points of the arm in the world, from the motion."""
    motion = instance.motion
    sine, cosine = sincos(motion[2])
    for number in range(len(outline.lever)):
        place_point(tables, outline, number, motion, values[number])
        along, across = values[number, 0], values[number, 1]
        values[number, 0] = motion[0] + (cosine * along - sine * across)
        values[number, 1] = motion[1] + (sine * along + cosine * across)
    return _OK


@entry_point(instance=Constants(), lost=int, other=Array((3,)))
def compare(instance, lost, other):
    """Note the distance from the tip of the finer run, or that it diverged."""
    x, y = instance.place[0] - other[0], instance.place[1] - other[1]
    distance = square_root(x * x + y * y)
    if lost != 0:
        instance.mark[LOST] = 1
        instance.error[0] = np.nan
    elif not distance <= instance.error[0]:
        instance.error[0] = distance
    return _OK


# Numbers of the first output of rates and forces, and of the first one of a modal coordinate.
FORCES, MODAL = 15, 22
SENSED = 17, 15, 16, 12, 13, 14  # numbers of the axes of SENSORS


@entry_point(tables=Constants(), beyond=Constants(), seen=Constants(), plant=Constants(),
             root=Constants(), instance=Constants())
def set_forces(tables, beyond, seen, plant, root, instance):
    """Write the specific force, strain, efforts and energy to the outputs."""
    load, acting, motion, out = instance.load, instance.acting, instance.motion, instance.outputs
    half, needed = len(motion) // 2, instance.loads[0, START]
    copy(load, acting)
    add_friction(instance.friction, acting)
    _, out[17], out[15], out[16] = sense_forces(
        tables, beyond, seen, plant, root, plant.gravity, motion, instance.state, acting,
        instance.accelerations, needed)
    sine, cosine = sincos(motion[2])
    out[18] = load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II]
    out[19] = load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II]
    out[20] = motor_effort(tables, load, rotor_turn(root, motion, half))
    for joint in range(3):
        if root.constrained[joint] != 0:
            out[18 + joint] = needed[joint] - out[18 + joint]
    if root.constrained[2] != 0:
        out[20] -= spring_torque(tables, motion[2])
    out[21] = energy(tables, motion, plant.gravity)
    instance.mark[KNOWN] = 2
    return _OK


@entry_point(plant=Constants(), root=Constants(), instance=Constants())
def set_outputs(plant, root, instance):
    """Write the outputs from the motion and the place of the tip."""
    motion, out, half = instance.motion, instance.outputs, len(instance.motion) // 2
    out[0] = instance.mark[STEPS] * plant.step
    for k in range(3):
        out[1 + k] = motion[k]
        out[4 + k] = motion[half + k]
        out[7 + k] = instance.place[k]
    out[10] = instance.tip[0] - plant.length
    out[11] = instance.tip[1]
    turn, turning = motion[2], motion[half + 2]
    modes = len(plant.travel)
    for k in range(modes):
        turn += plant.imu_rotation[k] * motion[3 + k]
        turning += plant.imu_rotation[k] * motion[half + 3 + k]
        out[MODAL + k] = motion[3 + k]
        out[MODAL + modes + k] = motion[half + 3 + k]
    out[12] = turning
    out[13] = motion[2]
    out[14] = rotor_turn(root, motion, 0)
    out[MODAL + 2 * modes] = turn
    if MODAL + 2 * modes + 1 < len(out):
        out[MODAL + 2 * modes + 1] = instance.error[0]
    instance.mark[KNOWN] = 1
    return _OK


@entry_point(errors=Constants(), instance=Constants(), begin=int, end=int)
def measure(errors, instance, begin, end):
    """Turn some outputs into readings that arrive now; until one does, the first."""
    now, late, out = instance.mark[STEPS], instance.late, instance.outputs
    for axis in range(len(SENSED)):
        if begin <= SENSED[axis] < end:
            late[now % len(late), axis] = reading(errors, axis, now, out[SENSED[axis]])
            seen = max(now - errors.delay[axis], 0)
            out[SENSED[axis]] = late[seen % len(late), axis]
    return _OK


@entry_point(instance=Constants(), number=int, value=Array((1,)))
def get_output(instance, number, value):
    """Write an output."""
    if not 0 <= number < len(instance.outputs):
        return _UNKNOWN
    value[0] = instance.outputs[number]
    return _OK


@entry_point(instance=Constants(), values=Array((None,)))
def get_outputs(instance, values):
    """Write all outputs."""
    for k in range(len(instance.outputs)):
        values[k] = instance.outputs[k]
    return _OK


# A saved state: steps, since when lines go to commands, whether the finer run diverged, error,
# commands, goals, origins of lines, load, limits of commands, limits of their rates, friction;
# then the state, and late readings.
_LIMITS = 4 + 4 * LOADS
_FRICTION = _LIMITS + 2 * LOADS
SAVED = _FRICTION + MEMORY


@inner
def _exchange(array, values, begin, saving):
    for k in range(len(array)):
        if saving:
            values[begin + k] = array[k]
        else:
            array[k] = values[begin + k]


@inner
def _exchange_all(actuators, instance, values, saving):
    """Save all arrays, or restore them."""
    _exchange(instance.inputs, values, 4, saving)
    _exchange(actuators.goal, values, 4 + LOADS, saving)
    _exchange(actuators.origin, values, 4 + 2 * LOADS, saving)
    _exchange(instance.load, values, 4 + 3 * LOADS, saving)
    _exchange(actuators.limit, values, _LIMITS, saving)
    _exchange(actuators.rate, values, _LIMITS + LOADS, saving)
    _exchange(instance.friction, values, _FRICTION, saving)
    _exchange(instance.state, values, SAVED, saving)
    late = instance.late
    for row in range(len(late)):
        _exchange(late[row], values, SAVED + len(instance.state) + row * late.shape[1], saving)


@entry_point(actuators=Constants(), instance=Constants(), values=Array((None,)))
def get_state(actuators, instance, values):
    """Write what `set_state` takes."""
    values[0] = 1.0 * instance.mark[STEPS]
    values[1] = 1.0 * actuators.since[0]
    values[2] = 1.0 * instance.mark[LOST]
    values[3] = instance.error[0]
    _exchange_all(actuators, instance, values, True)
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
    late = instance.late
    end = SAVED + len(instance.state)
    for k in range(4, end + len(late) * late.shape[1]):
        if _LIMITS <= k and k < _FRICTION:
            if not values[k] > 0.0:
                return _BAD_STATE
        elif not _finite(values[k]):
            return _NOT_FINITE
        elif _FRICTION <= k and k < end and not -_LARGEST <= values[k] <= _LARGEST:
            return _BAD_STATE
    return _OK


@entry_point(plant=Constants(), actuators=Constants(), instance=Constants(),
             values=Array((None,)))
def set_state(plant, actuators, instance, values):
    """Go on from a saved state, which was checked."""
    instance.mark[STEPS] = int(values[0])
    actuators.since[0] = int(values[1])
    instance.mark[LOST] = int(values[2])
    instance.mark[KNOWN] = 0
    instance.mark[PART] = 0
    instance.error[0] = values[3]
    _find_tip(plant, instance)
    _exchange_all(actuators, instance, values, False)
    return _OK
