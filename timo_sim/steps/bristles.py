# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Dry friction, as that of bristles, which bend before a joint slides (T64).

The deflection of a bristle follows its joint within +-`reach`, and its force is a function of it
and, with the effect of Stribeck (T41), of the joint's speed.
Within a step it is a function of the joint's place, by what the joint and its bristle were at the
start of the step: friction is part of the rate at each stage of `etdrk4.one_step`. At the end of a
step deflections are set once, by the cubic through place and speed at both ends (T65). Nothing
here branches on a float, so that the same text serves lanes.
"""

from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.functions import inner, magnitude, square_root, where
from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import copy, joint_place, within
from timo_sim.model.layout import (
    FORCE_X, FORCE_Y, LOADS, MOTOR_FRICTION, SHAFT_FRICTION, TORQUE)

# Columns of a load, by joint: of carrier x, y, of the shaft or, with an elastic gear, the rotor,
# and of the shaft of an elastic gear.
COLUMNS = FORCE_X, FORCE_Y, TORQUE, SHAFT_FRICTION
BRISTLES = len(COLUMNS)
ROTOR = 2
# What one of the friction of each adds to a load, (BRISTLES, LOADS).
UNITS = np.eye(LOADS)[list(COLUMNS)]
UNITS[ROTOR, MOTOR_FRICTION] = 1.0
# What steps hand on: dry friction by column at the end of the last step, the energy that it has
# taken [J], deflections of bristles.
HEAT, DEFLECTION = BRISTLES, BRISTLES + 1
MEMORY = DEFLECTION + BRISTLES
# Columns of `Scene.bristles`: friction in forward and backward motion, deflection at which joints
# slide, by how much of itself friction is more at rest, speed over which that goes.
FORWARD, BACKWARD, REACH, MORE, SLOW = range(5)


# Alone the stages make a swing on bristles gain 9e-4 (h Omega)^6 of its amplitude in a step. Stage
# b sees the place of stage a, too, by this times (h Omega)^2 of the fastest swing: that takes
# more, and is small enough for the order of the step to stay.
_LEAD = 0.14
BEGINNING, FIRST, SECOND, LAST = range(4)  # stages


class Bristles(NamedTuple):
    """Constants: a row for each joint with a bristle; without rows no code is left of them."""

    step: float  # [s]
    joint: Annotated[np.ndarray, int, 'bristles']    # its number in COLUMNS
    stiffness: Annotated[np.ndarray, 'bristles', 2]  # bent forward and backward, in motion
    reach: Annotated[np.ndarray, 'bristles']         # [m, rad]
    # By how much of itself it is more at rest, and the speed over which; no rows without.
    stribeck: Annotated[np.ndarray, 'stribeck', 2]
    lead: float  # of stage b, see `_LEAD`
    # Turn of the rotor per coordinate of an elastic gear, and the coordinate's place in a motion.
    gear: Annotated[np.ndarray, 'gears']
    place: int


class Bent(NamedTuple):
    """Work arrays: joints and deflections at the start of a step, and room for a load."""

    place: Annotated[np.ndarray, 'bristles']
    speed: Annotated[np.ndarray, 'bristles']
    deflection: Annotated[np.ndarray, 'bristles']
    middle: Annotated[np.ndarray, 'bristles']  # the way at stage a
    load: Annotated[np.ndarray, LOADS]


def bristles_of(models: list[Formulation], step: float, values: np.ndarray) -> list[np.ndarray]:
    """Return fields of models of one size, (n, ...); `values` are `Scene.bristles` of each."""
    rows, count = np.flatnonzero(values[:, :, REACH].any(axis=0)), len(models)
    reach, stribeck = values[:, rows, REACH], values[:, rows, MORE:]
    stiffness = np.divide(values[:, rows, :2], reach[..., np.newaxis], where=reach[
        ..., np.newaxis] > 0.0, out=np.zeros((count, len(rows), 2)))
    place, known = models[0].gear_place, {}
    for model, each in zip(models, values):
        key = id(model), each.tobytes()
        if key not in known:
            known[key] = _LEAD * step**2 * fastest(
                springs_of(each), mobilities(model, ())) if len(rows) else 0.0
    lead = [known[id(model), each.tobytes()] for model, each in zip(models, values)]
    gear = np.array([model.rotor[[place] * bool(model.gear)] for model in models])
    return [np.full(count, step), np.tile(rows, (count, 1)), stiffness, reach,
            stribeck if stribeck[:, :, 0].any() else stribeck[:, :0], np.array(lead), gear,
            np.full(count, place)]


def springs_of(values: np.ndarray) -> np.ndarray:
    """Return the largest stiffness of `Scene.bristles`, with any speed and direction, (4,)."""
    return np.divide(values[:, :2].max(axis=1) * (1.0 + np.maximum(values[:, MORE], 0.0)),
                     values[:, REACH], out=np.zeros(BRISTLES), where=values[:, REACH] > 0.0)


@lru_cache(maxsize=16)
def mobilities(model: Formulation, q: tuple[float, ...]) -> np.ndarray:
    """
    Return accelerations of joints by unit forces on each, (2, 4, 4), along and across the arm.

    The arm is straight, or bent as by modal coordinates, (N,).
    """
    motion = np.zeros(model.size)
    motion[3:3 + len(q)] = q
    free = model.free_places[:len(model.free_places) // 2]
    mass, joints = model.mass_matrix(motion)[0], model.joint_turns.T[:, free]
    turn = np.eye(len(mass))
    turn[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]]  # the shaft by a right angle
    both = np.array([mass, turn.T @ mass @ turn])[:, free[:, np.newaxis], free]
    return joints @ np.linalg.inv(both) @ joints.T


def fastest(slopes: np.ndarray, mobile: np.ndarray) -> float:
    """Return the largest eigenvalue of forces with slopes, (4,), on joints of `mobilities`."""
    root = np.sqrt(slopes)
    return max(0.0, *np.linalg.eigvalsh(np.outer(root, root) * mobile)[:, -1])


def swing_of(model: Formulation, values: np.ndarray) -> np.ndarray:
    """Return the speeds of joints whose energy `Scene.bristles` take as springs, (4,)."""
    if not values[:, REACH].any():
        return np.ones(BRISTLES)
    found = np.sqrt(springs_of(values) * mobilities(model, ())[0].diagonal()) * values[:, REACH]
    return np.where(found > 0.0, found, 1.0)


def memory_at(values: np.ndarray, swing: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """
    Return what steps begin with, where joints have these speeds, (..., 4), shape (..., MEMORY).

    `values` are `Scene.bristles`, (..., 4, 5), `swing` are `swing_of` them. Joints that move have
    slid, their bristles are bent; those of slower ones are so in part.
    """
    found = np.zeros((*speeds.shape[:-1], MEMORY))
    forward, backward, reach, more, slow = np.moveaxis(values, -1, 0)
    bent = np.clip(speeds / swing, -1.0, 1.0)
    found[..., DEFLECTION:] = bent * reach
    found[..., :BRISTLES] = -bent * np.where(bent > 0.0, forward, backward) * (
        1.0 + more / (1.0 + (speeds / slow)**2))
    return found


@inner
def add_friction(memory, load):
    """Add the dry friction that steps hand on to a load."""
    for i in range(BRISTLES):
        load[COLUMNS[i]] += memory[i]
    load[MOTOR_FRICTION] += memory[ROTOR]


@inner
def _share(bristles, n, speed):
    """Return friction at a speed over that in fast motion."""
    found = 1.0
    if len(bristles.stribeck):
        part = speed / bristles.stribeck[n, 1]
        found += bristles.stribeck[n, 0] / (1.0 + part * part)
    return found


@inner
def _force(bristles, n, deflection, share):
    """Return the friction of a bristle, against its deflection, at a speed with this share."""
    forward, backward = bristles.stiffness[n, 0], bristles.stiffness[n, 1]
    return -where(deflection > 0.0, forward, backward) * share * deflection


@inner
def _turn(start_speed, end_speed, way):
    """
    Return the way to where a joint turns round in a step, or 0; speeds are per step.

    The root of the cubic's rate is the one at which the rate changes its sign.
    """
    second = 3.0 * way - 2.0 * start_speed - end_speed
    third = start_speed + end_speed - 2.0 * way
    square = second * second - 3.0 * third * start_speed
    root = square_root(where(square > 0.0, square, 0.0))
    time = -start_speed / where(start_speed > 0.0, second - root, second + root)
    return where(start_speed * end_speed < 0.0,
                 time * (start_speed + time * (second + time * third)), 0.0)


@inner
def rub(tables, bristles, bent, stage, state, load):
    """Set `bent.load` to a load and the friction in the state of a stage."""
    copy(load, bent.load)
    for n in range(len(bristles.reach)):
        joint, reach, deflection = bristles.joint[n], bristles.reach[n], bent.deflection[n]
        speed = bent.speed[n]
        if stage != BEGINNING:
            way = joint_place(tables, state, load, joint) - bent.place[n]
            if stage == FIRST:
                bent.middle[n] = way
            if stage == SECOND:
                way -= bristles.lead * (way - bent.middle[n])
            # As if the joint did not turn on its way: no error was measured to grow by that.
            deflection = within(reach, deflection + way)
            # That of the parabola through both places.
            speed = way / (bristles.step if stage == LAST else 0.5 * bristles.step) * 2.0 - speed
        force = _force(bristles, n, deflection, _share(bristles, n, speed))
        bent.load[COLUMNS[joint]] += force
        if joint == ROTOR:
            bent.load[MOTOR_FRICTION] += force


@inner
def start_bristles(tables, bristles, state, load, motion, moved, bent, memory):
    """
    Begin a step with a state, by `memory`; if a step has `moved` joints to it, note that first.

    Bristles take the energy of their slides, by limits of friction, and what their springs hold.
    """
    for n in range(len(bristles.reach)):
        joint, reach = bristles.joint[n], bristles.reach[n]
        place = joint_place(tables, state, load, joint)
        speed = motion[len(motion) // 2 + min(joint, ROTOR)]
        if joint == ROTOR:
            for k in range(len(bristles.gear)):
                speed += bristles.gear[k] * motion[len(motion) // 2 + bristles.place]
        if moved:
            start, way = memory[DEFLECTION + joint], place - bent.place[n]
            turn = _turn(bristles.step * bent.speed[n], bristles.step * speed, way)
            middle = within(reach, start + turn)
            end = within(reach, middle + (way - turn))
            share = _share(bristles, n, speed)
            mean = 0.5 * (_share(bristles, n, bent.speed[n]) + share)
            here = _force(bristles, n, end, mean)
            memory[HEAT] += (
                magnitude(_force(bristles, n, middle, mean) * (start + turn - middle))
                + magnitude(here * (middle + (way - turn) - end))
                + 0.5 * (_force(bristles, n, start, mean) * start - here * end))
            memory[joint] = _force(bristles, n, end, share)
            memory[DEFLECTION + joint] = end
        bent.place[n], bent.speed[n] = place, speed
        bent.deflection[n] = memory[DEFLECTION + joint]
