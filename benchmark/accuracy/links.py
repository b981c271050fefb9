# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What a control engineer writes for predictive control of this arm: a few rigid links.

The arm is cut into equal parts, each with a hinge and its spring in the middle (rigid finite
elements: E. Wittbrodt, I. Adamiec-Wojcik, S. Wojciech, Dynamics of Flexible Multibody Systems,
Springer 2006). So half a part is fixed to the shaft, and another one to the end effector; errors
are of second order in the number of parts. The coordinates are those of the carrier and the angles
of the links in the plane; their equations of motion are compiled by numba.
"""

import math
import time

import numba
import numpy as np

from benchmark.accuracy.rivals import chain_of
from timo_sim.model.layout import FORCE_X, FORCE_Y, TORQUE

_CHANNELS = [FORCE_X, FORCE_Y, TORQUE]
# All of fastmath but that there is no NaN.
_compiled = numba.njit(fastmath={'reassoc', 'contract', 'arcp', 'nsz'}, error_model='numpy')


@_compiled
def _solve(matrix, vector):
    """Solve in place, by L D L^T of a symmetric matrix of which the lower half is read."""
    size = len(vector)
    for j in range(size):
        for k in range(j):
            factor = matrix[j, k] * matrix[k, k]
            for i in range(j, size):
                matrix[i, j] -= matrix[i, k] * factor
        for i in range(j + 1, size):
            matrix[i, j] /= matrix[j, j]
    for i in range(size):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
    for i in range(size):
        vector[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= matrix[k, i] * vector[k]


@_compiled
def _accelerations(links, place, speed, load, given, matrix, out):
    """
    Write accelerations to `out`, shape (2 + n,).

    `given` has accelerations of x, y and shaft that are prescribed, NaN for others.
    """
    total, first, second, stiffness, gravity = links
    count = len(first)
    cosine, sine = np.cos(place[2:]), np.sin(place[2:])
    matrix[0, 0] = matrix[1, 1] = total
    matrix[1, 0] = 0.0
    out[0], out[1] = load[0] + total * gravity[0], load[1] + total * gravity[1]
    for i in range(count):
        x, y = -first[i] * sine[i], first[i] * cosine[i]
        matrix[2 + i, 0], matrix[2 + i, 1] = x, y
        square = speed[2 + i]**2
        out[0] += y * square
        out[1] -= x * square
        force = x * gravity[0] + y * gravity[1]
        for j in range(count):
            turned = second[i, j] * (sine[i] * cosine[j] - cosine[i] * sine[j])
            force -= turned * speed[2 + j]**2 + stiffness[i, j] * place[2 + j]
            if j <= i:
                matrix[2 + i, 2 + j] = second[i, j] * (
                    cosine[i] * cosine[j] + sine[i] * sine[j])
        out[2 + i] = force
    out[2] += load[2]
    for c in range(3):
        if not math.isnan(given[c]):
            for i in range(len(out)):
                out[i] -= matrix[max(i, c), min(i, c)] * given[c]
                matrix[max(i, c), min(i, c)] = 0.0
            matrix[c, c], out[c] = 1.0, given[c]
    _solve(matrix, out)


@_compiled
def _integrate(links, place, speed, loads, given, step, every, samples):
    """Integrate by the classical Runge-Kutta method."""
    size, half = len(place), 0.5 * step
    matrix, (a1, a2, a3, a4) = np.zeros((size, size)), np.zeros((4, size))
    for k in range(len(loads)):
        load, fixed = loads[k], given[k]
        _accelerations(links, place, speed, load[0], fixed[0], matrix, a1)
        q, v2 = place + half * speed, speed + half * a1
        _accelerations(links, q, v2, load[1], fixed[1], matrix, a2)
        q, v3 = place + half * v2, speed + half * a2
        _accelerations(links, q, v3, load[1], fixed[1], matrix, a3)
        q, v4 = place + step * v3, speed + step * a3
        _accelerations(links, q, v4, load[2], fixed[2], matrix, a4)
        place += step / 6.0 * (speed + 2.0 * v2 + 2.0 * v3 + v4)
        speed += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if (k + 1) % every == 0:
            samples[(k + 1) // every - 1] = place


def rigid_links(scene, links, step, duration, every, drive=None, identified=True):
    """Simulate a scene by `chain_of` it; arguments and result are those of `rivals.chain`."""
    chain, count = chain_of(scene, links, identified=identified), round(duration / step)
    loads = np.ascontiguousarray(scene.load.stages(0, count, step)[:, :, _CHANNELS])
    given = np.full((count, 3, 3), np.nan)
    given[:, :, [axis for axis in (0, 1) if axis not in scene.constraints.free_axes]] = 0.0
    if drive:
        given[:, :, 2] = [[drive[2]((k + part) * step) for part in (0.0, 0.5, 1.0)]
                          for k in range(count)]
    elif scene.values['motor.shaft'] == 'locked':
        given[:, :, 2] = 0.0
    size = 2 + len(chain.lengths)
    place = np.append([0.0, 0.0], np.full(size - 2, scene.values['initial.shaft']))
    constants = (chain.total, chain.first, chain.second, chain.stiffness,
                 np.array(scene.values['gravity'], dtype=float))
    samples = np.empty((count // every, size))
    _integrate(constants, place.copy(), np.zeros(size), loads[:1], given[:1], step, 1,
               samples[:1])  # compiles
    begun = time.process_time()
    _integrate(constants, place, np.zeros(size), loads, given, step, every, samples)
    seconds = time.process_time() - begun
    turned = samples[:, 2:] - samples[:, 2:3]
    return (seconds, samples[:, 2], samples[:, :2], np.cos(turned) @ chain.lengths,
            np.sin(turned) @ chain.lengths)
