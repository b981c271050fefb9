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
from scipy.linalg import eigvalsh

from timo_sim.model.layout import FORCE_X, FORCE_Y, TORQUE

_CHANNELS = [FORCE_X, FORCE_Y, TORQUE]
_ITERATIONS, _TOLERANCE = 20, 1e-10  # of the implicit rule, relative
# All of fastmath but that there is no NaN.
_compiled = numba.njit(fastmath={'reassoc', 'contract', 'arcp', 'nsz'}, error_model='numpy')


class Links:
    """
    The constants of a chain: links one after the other, with a spring between neighbours.

    Parameters
    ----------
    scene : Scene
    lengths : sequence of float
        Of the links [m]: the first turns with the shaft, the last carries the end effector.
    springs : sequence of float
        Between neighbours [N m/rad].
    lumped : bool
        The mass of a link between two others is at its ends.

    """

    def __init__(self, scene, lengths, springs, lumped=False):
        body, section = scene.manipulator, scene.manipulator.arm.section
        self.scene, self.lengths, self.springs = scene, np.array(lengths), np.array(springs)
        self.each = np.arange(len(lengths))
        self.rods, self.tip_mass = section.mass_per_length * self.lengths, body.end_effector_mass
        # From the carrier to the middle of each link and to the tip, link by link.
        arms = np.tril(np.tile(self.lengths, (len(lengths) + 1, 1)))
        arms[self.each, self.each] *= 0.5
        mass = np.append(self.rods, self.tip_mass)
        self.inertia = (section.inertia_per_length * self.lengths
                        + self.rods * self.lengths**2 / 12.0)
        if lumped:
            self.inertia[1:-1] = self.rods[1:-1] * self.lengths[1:-1]**2 / 4.0
        self.inertia[0] += body.shaft_inertia
        self.inertia[-1] += body.end_effector_inertia
        self.total = mass.sum() + body.base_mass
        self.first = mass @ arms
        self.second = arms.T @ (mass[:, np.newaxis] * arms) + np.diag(self.inertia)
        difference = np.diff(np.eye(len(lengths)), axis=0)
        self.stiffness = difference.T @ np.diag(self.springs) @ difference

    def frequencies(self):
        """Return the angular frequencies of the straight arm in bending [rad/s]."""
        angle = self.scene.values['initial.shaft']
        across = np.array([-math.sin(angle), math.cos(angle)])[self.scene.constraints.free_axes]
        mass = self.second - across @ across / self.total * np.outer(self.first, self.first)
        fixed = self.scene.values['motor.shaft'] != 'free'
        square = eigvalsh(self.stiffness[fixed:, fixed:], mass[fixed:, fixed:])
        return np.sqrt(square[not fixed:])


def chain_of(scene, count, lumped=False, identified=True):
    """
    Return the Links of an arm that is cut into `count` parts.

    `identified`: a common factor of the springs gives the chain the first frequency of the arm,
    which an engineer measures; it is that of 200 parts.
    """
    arm = scene.manipulator.arm
    part = arm.length / count
    lengths = [0.5 * part, *[part] * (count - 1), 0.5 * part]
    links = Links(scene, lengths, np.full(count, arm.section.bending_stiffness / part), lumped)
    if not identified:
        return links
    true = chain_of(scene, 200, identified=False).frequencies()[0]
    factor = (true / links.frequencies()[0])**2
    return Links(scene, lengths, factor * links.springs, lumped)


def longest_step(scene, count):
    """Return the longest stable step of the classical Runge-Kutta method [s]."""
    return 2.8 / chain_of(scene, count).frequencies()[-1]


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
def _accelerations(links, place, speed, bent, load, given, share, matrix, out):
    """
    Write accelerations to `out`, shape (2 + n,).

    The springs act at `bent` and, in the implicit rule, at `share` [s2] times the accelerations
    beyond it. `given` has accelerations of x, y and shaft that are prescribed, NaN for others.
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
            force -= turned * speed[2 + j]**2 + stiffness[i, j] * bent[2 + j]
            if j <= i:
                matrix[2 + i, 2 + j] = second[i, j] * (
                    cosine[i] * cosine[j] + sine[i] * sine[j]) + share * stiffness[i, j]
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
def _explicit(links, place, speed, loads, given, step, every, samples):
    """Integrate by the classical Runge-Kutta method."""
    size, half = len(place), 0.5 * step
    matrix, (a1, a2, a3, a4) = np.zeros((size, size)), np.zeros((4, size))
    for k in range(len(loads)):
        load, fixed = loads[k], given[k]
        _accelerations(links, place, speed, place, load[0], fixed[0], 0.0, matrix, a1)
        q, v2 = place + half * speed, speed + half * a1
        _accelerations(links, q, v2, q, load[1], fixed[1], 0.0, matrix, a2)
        q, v3 = place + half * v2, speed + half * a2
        _accelerations(links, q, v3, q, load[1], fixed[1], 0.0, matrix, a3)
        q, v4 = place + step * v3, speed + step * a3
        _accelerations(links, q, v4, q, load[2], fixed[2], 0.0, matrix, a4)
        place += step / 6.0 * (speed + 2.0 * v2 + 2.0 * v3 + v4)
        speed += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if (k + 1) % every == 0:
            samples[(k + 1) // every - 1] = place


@_compiled
def _implicit(links, place, speed, loads, given, step, every, samples):
    """Integrate by the midpoint rule, with the springs solved for and the rest iterated."""
    size, half = len(place), 0.5 * step
    matrix, (rate, found) = np.zeros((size, size)), np.zeros((2, size))
    for k in range(len(loads)):
        bent = place + half * speed
        for _ in range(_ITERATIONS):
            middle = speed + half * rate
            _accelerations(links, place + half * middle, middle, bent, loads[k, 1], given[k, 1],
                           half * half, matrix, found)
            change = np.abs(found - rate).max()
            rate[:] = found
            if not change > _TOLERANCE * np.abs(rate).max():
                break
        place += step * (speed + half * rate)
        speed += step * rate
        if (k + 1) % every == 0:
            samples[(k + 1) // every - 1] = place


RULES = {'RK4': _explicit, 'implicit midpoint': _implicit}


def rigid_links(scene, links, step, duration, every, drive=None, rule='RK4', identified=True):
    """Simulate a scene by `chain_of` it and one of RULES; the rest is as of `rivals.chain`."""
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
    RULES[rule](constants, place.copy(), np.zeros(size), loads[:1], given[:1], step, 1,
                samples[:1])  # compiles
    begun = time.process_time()
    RULES[rule](constants, place, np.zeros(size), loads, given, step, every, samples)
    seconds = time.process_time() - begun
    turned = samples[:, 2:] - samples[:, 2:3]
    return (seconds, samples[:, 2], samples[:, :2], np.cos(turned) @ chain.lengths,
            np.sin(turned) @ chain.lengths)
