# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Loads of steps: terms of a load over time, and what actuators make of commands.

A step takes three values of a load, at its start, middle and end, and its linear part integrates
the parabola through them exactly. If a load jumps at the boundary of two steps, each step sees its
own side. A load with a kink inside the step is replaced by the parabola with the same integral and
the same first and second moment (T37): with s from 0 to 1 over the step and `I_j = int s^j p ds`,

    p(0)   =    9 I_0 - 36 I_1 + 30 I_2
    p(1/2) = -3/2 I_0 + 15 I_1 - 15 I_2
    p(1)   =    3 I_0 - 24 I_1 + 30 I_2

The fourth row of a step's loads is the true load at its end, see `model.layout`.

Python and an exported arm call this code. It has no fast math and so gives both the same bits.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import (
    Array, as_vectors, Constants, floor, magnitude, strict, WIDTH)
from timo_sim.model.functions import sincos
from timo_sim.model.layout import (
    ACCELERATION, AFTER, ANGLE, END, LOADS, MIDDLE, SPEED, STAGES, START, STEP_LOADS, TORQUE,
    VOLTAGE)

NEAR = 1e-6  # [steps] distance from a step boundary within which a position counts as on it
PIECE = 7    # numbers of a piece of a curve


class SceneLoads(NamedTuple):
    """
    Loads of a scene over time, for steps of one size; columns are those of a load.

    A curve is made of the pieces from its first to before its last, which follow its column in
    `curves`. That of an angle gives its speed and acceleration, too.
    """

    step: float  # [s]
    # Column, amplitude, frequency [Hz] and phase [rad] of amplitude sin(2 pi frequency t + phase).
    harmonics: Annotated[np.ndarray, 'harmonics', 4]
    curves: Annotated[np.ndarray, 'curves', 3]
    # Times [s] from which on a curve is a quintic polynomial of the time since, constant first; a
    # repeated time is a jump. Times near the boundary of two steps must be exactly on it.
    pieces: Annotated[np.ndarray, 'pieces', PIECE]


class Actuators(NamedTuple):
    """
    What makes loads of commands, and its memory.

    The goal of a load is its command within a limit. With a limit of its rate it moves to the goal
    on a straight line, which begins at the step at which goals changed.
    """

    step: float  # [s]
    gain: float  # torque per voltage [N m/V]
    limit: Annotated[np.ndarray, LOADS]   # of commands
    rate: Annotated[np.ndarray, LOADS]    # limit of their rate; infinite: they act at once
    goal: Annotated[np.ndarray, LOADS]
    origin: Annotated[np.ndarray, LOADS]  # where the lines began
    since: Annotated[np.ndarray, int, 1]  # number of the step at which they began


# Loads over time.

@entry_point(fast=False, step=float, harmonics=Array((None, 4)), harmonic_count=int,
             curves=Array((None, 3)), curve_count=int, pieces=Array((None, PIECE)), first=int,
             count=int, out=Array((None, STEP_LOADS, LOADS)), room=Array((WIDTH,)))
def add_scene_loads(step, harmonics, harmonic_count, curves, curve_count, pieces, first, count,
                    out, room):
    """Add the loads of `SceneLoads` to those of `count` steps, from step `first` on."""
    for i in range(harmonic_count):
        _add_harmonic(int(harmonics[i, 0]), harmonics[i, 1], harmonics[i, 2], harmonics[i, 3],
                      step, first, count, out, room)
    for i in range(curve_count):
        _add_curve(int(curves[i, 0]), pieces, int(curves[i, 1]), int(curves[i, 2]), step, first,
                   count, out)


@strict
def _add_harmonic(column, amplitude, frequency, phase, step, first, count, out, room):
    """Add a harmonic term; the sines of WIDTH half steps are computed as one vector."""
    vector = as_vectors(room)
    for begin in range(0, count + 1, WIDTH // 2):
        for j in range(WIDTH):
            room[j] = 0.5 * (2 * (first + begin) + j) * step
        turns = frequency * vector[0]
        sines, _ = sincos(2.0 * np.pi * (turns - floor(turns)) + phase)
        vector[0] = amplitude * sines
        for k in range(begin, min(begin + WIDTH // 2, count + 1)):
            start = room[2 * (k - begin)]
            if k > 0:
                out[k - 1, END, column] += start
                out[k - 1, AFTER, column] += start
            if k < count:
                out[k, START, column] += start
                out[k, MIDDLE, column] += room[2 * (k - begin) + 1]


@strict
def _piece_at(pieces, begin, end, time):
    """Return the last of some pieces that has begun at a time, or the first."""
    low, high = begin + 1, end
    while low < high:
        middle = (low + high) // 2
        if pieces[middle, 0] <= time:
            low = middle + 1
        else:
            high = middle
    return low - 1


@strict
def _add_curve(column, pieces, begin, end, step, first, count, out):
    """Add a curve of the pieces from `begin` to `end`."""
    piece = _piece_at(pieces, begin, end, first * step)
    for k in range(count):
        start, stop = (first + k) * step, (first + k + 1) * step
        while piece + 1 < end and pieces[piece + 1, 0] <= start:
            piece += 1
        last, low = piece, start
        # From piece to piece, if some begin inside.
        while last + 1 < end and pieces[last + 1, 0] < stop:
            _add_integrals(column, pieces, last, low, pieces[last + 1, 0], start, step, out[k])
            last += 1
            low = pieces[last, 0]
        if last > piece:
            _add_integrals(column, pieces, last, low, stop, start, step, out[k])
        else:
            for stage in range(STAGES):
                _add_values(column, pieces, last, 0.5 * (2 * (first + k) + stage) * step, 1.0,
                            out[k, stage])
        _add_values(column, pieces, last, stop, 1.0, out[k, AFTER])


@strict
def _add_integrals(column, pieces, piece, low, high, start, step, out):
    """Add what the stages of a step see of a piece between two times."""
    for node in range(len(_PLACES)):
        time = low + (high - low) * _PLACES[node]
        share = _SHARES[node] * (high - low) / step
        for stage in range(STAGES):
            _add_values(column, pieces, piece, time, share * _seen(stage, (time - start) / step),
                        out[stage])


@strict
def _add_values(column, pieces, piece, time, factor, out):
    """Add the value of a piece at a time, and the derivatives of an angle, times a factor."""
    since = time - pieces[piece, 0]
    value, slope, half_bend = 0.0, 0.0, 0.0
    for j in range(PIECE - 1):
        # Horner's scheme, with the halves of second derivatives.
        half_bend = half_bend * since + slope
        slope = slope * since + value
        value = value * since + pieces[piece, PIECE - 1 - j]
    out[column] += factor * value
    if column == ANGLE:
        out[SPEED] += factor * slope
        out[ACCELERATION] += factor * (2.0 * half_bend)


# What a stage sees is the integral of the load over the step with the weight `_seen`. It is found
# by Gauss's rule, which is exact for a quintic polynomial times a parabola, from kink to kink.

_PLACES = 0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970262
_SHARES = 0.1739274225687269, 0.3260725774312730, 0.3260725774312730, 0.1739274225687269


@strict
def _seen(stage, s):
    """Return the weight of a load at s, from 0 to 1, in what a stage sees of the step."""
    if stage == START:
        return 9.0 + s * (30.0 * s - 36.0)
    if stage == MIDDLE:
        return 15.0 * s * (1.0 - s) - 1.5
    return 3.0 + s * (30.0 * s - 24.0)


# Actuators.

@entry_point(fast=False, actuators=Constants(), commanded=Array((LOADS,), own=True), first=int,
             count=int, out=Array((None, STEP_LOADS, LOADS), own=True))
def add_commands(actuators, commanded, first, count, out):
    """Add what `Actuators` make of commands from step `first` on; it changes their goals."""
    changed = False
    for column in range(LOADS):
        changed = changed or _goal(actuators, commanded, column) != actuators.goal[column]
    if changed:
        restart(actuators, first)
    for column in range(LOADS):
        actuators.goal[column] = _goal(actuators, commanded, column)
        slow = actuators.rate[column] < np.inf
        held = 0.0 if slow else actuators.goal[column]
        if column == TORQUE:
            held += actuators.gain * _goal(actuators, commanded, VOLTAGE)
        for k in range(count):
            if slow:
                _add_line(actuators, column, 1.0 * (first + k - actuators.since[0]), out[k])
            for row in range(STEP_LOADS):
                out[k, row, column] += held


@strict
def _goal(actuators, commanded, column):
    return min(max(commanded[column], -actuators.limit[column]), actuators.limit[column])


@entry_point(fast=False, actuators=Constants(), number=int)
def restart(actuators, number):
    """Let all lines begin and end at what acts at a step, so that limits may change."""
    elapsed = (number - actuators.since[0]) * actuators.step
    for column in range(LOADS):
        reached = _reached(actuators, column, elapsed)
        actuators.origin[column] = actuators.goal[column] = reached
    actuators.since[0] = number


@strict
def _reached(actuators, column, elapsed):
    """Return what acts of a command some time after the lines began."""
    goal, origin = actuators.goal[column], actuators.origin[column]
    value = goal
    if actuators.rate[column] < np.inf:
        way = elapsed * actuators.rate[column]
        if magnitude(goal - origin) > way:
            value = origin + way if goal > origin else origin - way
    return value


@strict
def _add_line(actuators, column, begin, out):
    """Add what acts of a command in a step that begins some steps after the lines."""
    step = actuators.step
    out[AFTER, column] += _reached(actuators, column, (begin + 1.0) * step)
    # Where the line ends, counted in steps.
    end = magnitude(actuators.goal[column] - actuators.origin[column]) / (
        actuators.rate[column] * step)
    if begin < end < begin + 1.0 and magnitude(end - floor(end + 0.5)) > NEAR:
        for part in range(2):
            low, high = (begin, end) if part == 0 else (end, begin + 1.0)
            for node in range(len(_PLACES)):
                at = low + (high - low) * _PLACES[node]
                value = _SHARES[node] * (high - low) * _reached(actuators, column, at * step)
                for stage in range(STAGES):
                    out[stage, column] += value * _seen(stage, at - begin)
    else:
        for stage in range(STAGES):
            out[stage, column] += _reached(actuators, column, (begin + 0.5 * stage) * step)
