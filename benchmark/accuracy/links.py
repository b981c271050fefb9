# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
What a control engineer writes for predictive control of this arm: a few rigid links.

The arm is cut into links with hinges and springs in between (rigid finite elements: E. Wittbrodt,
I. Adamiec-Wojcik, S. Wojciech, Dynamics of Flexible Multibody Systems, Springer 2006), half a
part fixed to the shaft, and another one to the end effector; `rivals.chain_of` says where.
The coordinates are the angles of the links in the plane. A carrier that is free to move needs
none: forces on it accelerate the centre of mass of all, and the angles do not depend on its place.
The equations of motion are compiled by numba. Steps are those of the classical Runge-Kutta method,
or of ETDRK4 as this package takes them, in the modes of the straight arm.
"""

import math
import time

import numba
import numpy as np

from benchmark.accuracy.rivals import chain_of
from timo_sim.model.layout import END, FORCE_X, FORCE_Y, MIDDLE, START, TORQUE
from timo_sim.steps.etdrk4 import propagator

_CHANNELS, _WHEN = [FORCE_X, FORCE_Y, TORQUE], [START, MIDDLE, END]
# Of Runge-Kutta: which load (start, middle, end), weight of the rate, part of the step to the next
_STAGES = ((0, 1.0, 0.5), (1, 2.0, 0.5), (1, 2.0, 1.0), (2, 1.0, 0.0))
# Of ETDRK4: which load, and which stage the free motion to the next one starts from.
_EXPONENTIAL = (0, 0), (1, 0), (1, 1), (2, 0)
# All of fastmath but that there is no NaN.
_compiled = numba.njit(fastmath={'reassoc', 'contract', 'arcp', 'nsz'}, error_model='numpy')


@_compiled
def _accelerations(links, place, speed, load, held, turned, work, out):
    """
    Write the angular accelerations of the links to `out`, shape (n,).

    `load` is a field [m/s2] along x and y that pulls at all masses, and the torque on the shaft
    [N m]; a shaft that is `held` has the acceleration `turned`. `work`, shape (n, n + 2), is
    overwritten.
    """
    each, first, second, springs = links
    count, cosine, sine, matrix = len(each), work[:, -1], work[:, -2], work[:, :-2]
    for i in range(count):
        cosine[i], sine[i] = math.cos(place[i]), math.sin(place[i])
        out[i] = first[i] * (cosine[i] * load[1] - sine[i] * load[0])
        for j in range(i):
            matrix[i, j] = second[i, j] * (cosine[i] * cosine[j] + sine[i] * sine[j])
            across = second[i, j] * (sine[i] * cosine[j] - cosine[i] * sine[j])
            out[i] -= across * speed[j]**2
            out[j] += across * speed[i]**2
        matrix[i, i] = second[i, i]
    for i in range(count - 1):
        moment = springs[i] * (place[i + 1] - place[i])
        out[i] += moment
        out[i + 1] -= moment
    out[0] += load[2]
    if held:
        for i in range(1, count):
            out[i] -= matrix[i, 0] * turned
            matrix[i, 0] = 0.0
        matrix[0, 0], out[0] = 1.0, turned
    # L D L^T of the symmetric matrix, with 1 / D on its diagonal.
    for j in range(count):
        for k in range(j):
            factor = matrix[j, k] * matrix[k, k]
            out[j] -= factor * out[k]
            for i in range(j, count):
                matrix[i, j] -= matrix[i, k] * factor
        matrix[j, j] = 1.0 / matrix[j, j]
    for j in range(count - 1, -1, -1):
        for k in range(j + 1, count):
            out[j] -= matrix[k, j] * out[k]
        out[j] *= matrix[j, j]


@_compiled
def _integrate(links, step, place, loads, held, turned, every, samples):
    """Integrate by the classical Runge-Kutta method, from rest."""
    count = len(links[0])
    work = np.empty((count, count + 2))
    speed, q, v, a, moved, gained = np.zeros((6, count))
    for k in range(len(loads)):
        q[:], v[:] = place, speed
        moved[:] = 0.0
        gained[:] = 0.0
        for at, weight, ahead in _STAGES:
            _accelerations(links, q, v, loads[k, at], held, turned[k, at], work, a)
            for i in range(count):
                moved[i] += weight * v[i]
                gained[i] += weight * a[i]
                q[i] = place[i] + ahead * step * v[i]
                v[i] = speed[i] + ahead * step * a[i]
        for i in range(count):
            place[i] += step / 6.0 * moved[i]
            speed[i] += step / 6.0 * gained[i]
        if (k + 1) % every == 0:
            samples[(k + 1) // every - 1] = place


@_compiled
def _integrate_exponentially(links, modes, place, loads, held, turned, every, samples):
    """Integrate by ETDRK4, from rest; `modes` are those of `_exponential`."""
    shapes, inverse, squares, free, weights = modes
    count = len(links[0])
    work = np.empty((count, count + 2))
    q, v, a = np.empty((3, count))
    modal, rates = np.zeros((5, 2, count)), np.empty((4, count))
    modal[0, 0] = inverse @ place
    for k in range(len(loads)):
        for stage, (at, origin) in enumerate(_EXPONENTIAL):
            for i in range(count):
                q[i] = v[i] = 0.0
                for j in range(count):
                    q[i] += shapes[i, j] * modal[stage, 0, j]
                    v[i] += shapes[i, j] * modal[stage, 1, j]
            _accelerations(links, q, v, loads[k, at], held, turned[k, at], work, a)
            for i in range(count):
                rate = squares[i] * modal[stage, 0, i]
                for j in range(count):
                    rate += inverse[i, j] * a[j]
                rates[stage, i] = rate
                for j in range(2):
                    moved = (free[stage, j, 0, i] * modal[origin, 0, i]
                             + free[stage, j, 1, i] * modal[origin, 1, i])
                    for each in range(stage + 1):
                        moved += weights[stage, each, j, i] * rates[each, i]
                    modal[stage + 1, j, i] = moved
        modal[0] = modal[4]
        if (k + 1) % every == 0:
            for i in range(count):
                moved = 0.0
                for j in range(count):
                    moved += shapes[i, j] * modal[0, 0, j]
                samples[(k + 1) // every - 1, i] = moved


def _exponential(mass, stiffness, held, step):
    """
    Return what `_integrate_exponentially` needs of the straight arm, whose vibrations are exact.

    The shapes of its modes, their inverse, squares of angular frequencies [rad2/s2]; and for each
    stage the free motion to the next one, shape (4, 2, 2, n), and the weights of the rates of
    all stages, shape (4, 4, 2, n).
    """
    mass, stiffness = mass.copy(), stiffness.copy()
    if held:  # the first angle has the acceleration that it is given
        mass[0], stiffness[0] = np.eye(1, len(mass)), 0.0
    squares, shapes = np.linalg.eig(np.linalg.solve(mass, stiffness))
    linear = np.zeros((len(mass), 2, 2))
    linear[:, 0, 1], linear[:, 1, 0] = 1.0, -squares
    whole, half, *columns = np.moveaxis(propagator(linear, step), 1, -1)
    middle, first, both, last = (matrix[:, 1] for matrix in columns)
    none = np.zeros_like(middle)
    return (shapes, np.linalg.inv(shapes), squares, np.array([half, half, half, whole]),
            np.array([[middle, none, none, none], [none, middle, none, none],
                      [-middle, none, 2.0 * middle, none], [first, both, both, last]]))


def rigid_links(scene, links, step, duration, every, drive=None, gauss=True, matched=None,
                exponential=False, compiled=True):
    """
    Simulate a scene by `chain_of` it; arguments and result are those of `rivals.chain`.

    The steps are explicit, of Runge and Kutta, or `exponential`. If they are not `compiled`, which
    takes seconds, only the equations of motion are. The carrier must be free along both axes or
    held, else ValueError.
    """
    chain, count = chain_of(scene, links, gauss, matched), round(duration / step)
    loads = np.ascontiguousarray(scene.load.stages(0, count, step)[:, _WHEN][:, :, _CHANNELS])
    second, free = chain.second, len(scene.constraints.free_axes)
    if free == 1:
        raise ValueError("carrier.held must be 'none' or 'both'")
    pull = loads[:, :, :2] / chain.total
    if free:  # as seen by who falls with the centre of mass
        second = second - np.outer(chain.first, chain.first) / chain.total
    loads[:, :, :2] = -pull if free else scene.values['gravity']
    turned = np.zeros((count, 3))
    if drive:
        turned[:] = [[drive[2]((k + part) * step) for part in (0.0, 0.5, 1.0)]
                     for k in range(count)]
    held = scene.values['motor.shaft'] != 'free'
    # A tuple has its length in its type, so code is compiled for that number of links.
    constants = tuple(chain.each), chain.first, second, chain.springs
    place = np.full(len(chain.lengths), scene.values['initial.shaft'])
    samples = np.empty((count // every, len(place)))
    integrate, own = _integrate, step
    if exponential:
        integrate, own = _integrate_exponentially, _exponential(
            second, chain.stiffness, held, step)
    integrate = integrate if compiled else integrate.py_func
    integrate(constants, own, place.copy(), loads[:1], held, turned[:1], 1,
              samples[:1])  # compiles
    begun = time.process_time()
    integrate(constants, own, place, loads, held, turned, every, samples)
    seconds = time.process_time() - begun
    bent, carrier = samples - samples[:, :1], np.zeros((len(samples), 2))
    if free:  # The path of the centre of mass is a sum.
        begin, middle, end = np.moveaxis(pull + scene.values['gravity'], 1, 0)
        gained = step / 6.0 * (begin + 4.0 * middle + end)
        moved = step * (np.cumsum(gained, axis=0) - gained) + step**2 / 6.0 * (
            begin + 2.0 * middle)
        start, ahead = (np.stack([np.cos(each), np.sin(each)]) @ chain.first / chain.total
                        for each in (np.full(len(place), scene.values['initial.shaft']), samples))
        carrier = np.cumsum(moved, axis=0)[every - 1::every] + start - ahead.T
    return (seconds, samples[:, 0], carrier, np.cos(bent) @ chain.lengths,
            np.sin(bent) @ chain.lengths)
