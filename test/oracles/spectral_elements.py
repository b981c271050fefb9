# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The manipulator with an extensible arm by spectral elements: a reference for all constraints.

The unknowns are positions and section angles at Gauss-Lobatto nodes in world axes, so that the
mass matrix is diagonal and constant and all nonlinearity is in the strains,

    e = r' . t - 1     gamma = r' . n     kappa = phi'     t = (cos phi, sin phi), n normal to it

(Simo and Vu-Quoc 1986); there are no modes, momenta or turning axes. Stoermer-Verlet steps are
short enough for the fastest wave of the mesh; their error is far below that of the mesh. Friction
and damping are not modelled.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.polynomial import legendre

from timo_sim.compiled.store import lock
from timo_sim.model.layout import ANGLE, FORCE_I, FORCE_X, SPEED, TIP_I, TIP_TORQUE, TIP_X, TORQUE

_CHUNK = 20000  # steps whose loads are in memory


def simulate(scene, period, samples, order=10, elements=2, courant=0.5,
             stretch=1.0):
    """
    Simulate a scene that starts as a straight arm.

    Parameters
    ----------
    scene : Scene
        Its modes and step are not used; its loads, and the load at its tip, jump at samples only.
    period : float
        Time from sample to sample [s].
    samples : int
    order, elements : int
        Polynomial order of an element, and their number; each span of a varying section has as
        many.
    courant : float
        Step over the limit of stability.
    stretch : float
        Factor of the axial compliance.

    Returns
    -------
    carrier, shaft, tip, rotation : ndarray, shapes (samples + 1, 2), (samples + 1,)
        Carrier and tip in world axes [m], angles of shaft and end effector [rad].

    """
    mesh = _mesh(scene, order, elements, stretch)
    inverse, derivative, jacobian, stiffness = mesh[1:5]
    motion = scene.initial_motion()
    half, line = len(motion) // 2, mesh.line
    angle, spin = motion[2], motion[half + 2]
    along = np.array([np.cos(angle), np.sin(angle)])
    q = _straight(mesh, motion)
    v = np.column_stack([motion[half:half + 2] + spin * np.outer(line, [-along[1], along[0]]),
                         np.full(len(line), spin)])
    changes = {round(number * scene.step / period): tip for number, *tip in scene.payloads}
    lightest = inverse.copy()
    lightest[-1] = 1.0 / mesh.arm_tip
    with lock('spectral_elements.lock'):  # one process compiles, others wait for its code
        step = courant * _limit(q, lightest if changes else inverse, derivative, jacobian,
                                stiffness)
        _advance(q, v, scene.load.stages(0, 0, step), step, inverse, derivative, jacobian,
                 stiffness, mesh.weight, scene.constraints.driven)
    count = int(np.ceil(period / step))
    step, found = period / count, [(q[0].copy(), q[-1].copy())]
    for sample in range(samples):
        if sample in changes:
            _take(mesh, v, *changes[sample][:2], scene)
        for first in range(0, count, _CHUNK):
            loads = scene.load.stages(sample * count + first, min(_CHUNK, count - first), step)
            _advance(q, v, loads, step, inverse, derivative, jacobian, stiffness, mesh.weight,
                     scene.constraints.driven)
        found.append((q[0].copy(), q[-1].copy()))
    root, tip = np.moveaxis(np.array(found), 1, 0)
    return root[:, :2], root[:, 2], tip[:, :2], tip[:, 2]


def _take(mesh, v, mass, inertia, scene):
    # A load that was at rest shares the momentum of the node that takes it.
    tip = mesh.arm_tip + [mass, mass, inertia]
    if scene.values['end_effector.pick_up'] == 'at_rest':
        v[-1] *= np.minimum(1.0, mesh.mass[-1] / tip)
    mesh.mass[-1], mesh.inverse[-1] = tip, 1.0 / tip
    mesh.weight[-1] = tip * np.append(scene.values['gravity'], 0.0)


class _Mesh(NamedTuple):
    line: np.ndarray        # distances of the nodes from the root [m], (n,)
    inverse: np.ndarray     # of the mass of x, y and angle, 0 of what is held, (n, 3)
    derivative: np.ndarray
    jacobian: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray        # (n, 3)
    weight: np.ndarray      # (n, 3)
    arm_tip: np.ndarray     # share of the arm in the last node's mass, (3,)


def _mesh(scene, order, elements, stretch):
    body = scene.manipulator
    assert not body.hub_radius, 'these elements begin at the axis of the shaft'
    breaks = np.concatenate([np.linspace(*ends, elements, endpoint=False) for ends in
                             zip(body.arm.breaks, body.arm.breaks[1:])] + [[body.arm.length]])
    x, weights, derivative = _rule(order)
    jacobian = 0.5 * np.diff(breaks)
    xi = breaks[:-1, np.newaxis] + jacobian[:, np.newaxis] * (x + 1.0)
    inner = breaks[:-1, np.newaxis] + jacobian[:, np.newaxis] * ((1.0 - 1e-12) * x + 1.0)
    stiffness, mass = np.empty((3, *xi.shape)), np.zeros((len(jacobian) * order + 1, 3))
    for k, places in enumerate(inner):
        section, share = body.arm.at(places), jacobian[k] * weights
        stiffness[:, k] = [share * section.young_modulus * section.area / stretch,
                           share * section.shear_stiffness, share * section.bending_stiffness]
        mass[k * order:(k + 1) * order + 1] += np.multiply.outer(share, [1.0, 1.0, 0.0]) * (
            np.ravel(section.mass_per_length * np.ones_like(x))[:, np.newaxis])
        mass[k * order:(k + 1) * order + 1, 2] += share * section.inertia_per_length
    mass[0] += [body.base_mass, body.base_mass, body.shaft_inertia]
    arm_tip = mass[-1].copy()
    mass[-1] += [body.end_effector_mass, body.end_effector_mass, body.end_effector_inertia]
    inverse = 1.0 / mass
    inverse[0, [k for k in range(2) if k not in scene.constraints.free_axes]] = 0.0
    if scene.constraints.driven:
        inverse[0, 2] = 0.0
    weight = mass * np.append(scene.values['gravity'], 0.0)
    return _Mesh(np.unique(xi.round(13)), inverse, derivative, jacobian, stiffness, mass, weight,
                 arm_tip)


def _straight(mesh, motion):
    along = np.array([np.cos(motion[2]), np.sin(motion[2])])
    return np.column_stack([motion[:2] + np.outer(mesh.line, along),
                            np.full(len(mesh.line), motion[2])])


def equilibrium(scene, order=12, elements=2):
    """
    Return where a scene is at rest under gravity, and how it vibrates about it.

    Gravity is raised in steps from the straight arm in the scene's initial place on, so that a
    free shaft must be there already.

    Returns
    -------
    tip : ndarray, shape (3,)
        Place in world axes [m], angle of the end effector [rad].
    frequency : ndarray
        Natural frequencies, ascending [Hz].

    """
    mesh = _mesh(scene, order, elements, 1.0)
    q, free = _straight(mesh, scene.initial_motion()), np.flatnonzero(mesh.inverse)

    def force(shift, weight):
        found, shifted = np.empty_like(q), q.copy()
        shifted.ravel()[free] += shift
        _force(shifted, mesh.derivative, mesh.jacobian, mesh.stiffness, weight, found)
        return found.ravel()[free]

    def slope(weight):
        return np.stack([(force(shift, weight) - force(-shift, weight)) / 2e-6
                         for shift in 1e-6 * np.eye(len(free))], axis=-1)

    for share in np.linspace(0.0, 1.0, 11)[1:]:
        for _ in range(20):
            change = -np.linalg.solve(slope(share * mesh.weight),
                                      force(np.zeros(len(free)), share * mesh.weight))
            q.ravel()[free] += change
            if np.abs(change).max() < 1e-11:
                break
    squares = np.linalg.eigvals(-mesh.inverse.ravel()[free, np.newaxis] * slope(mesh.weight)).real
    return q[-1], np.sqrt(np.sort(squares)) / (2.0 * np.pi)


def _rule(order):
    # Gauss-Lobatto nodes and weights in [-1, 1], and the differentiation matrix there.
    last = np.eye(order + 1)[order]
    inner = np.sort(legendre.legroots(legendre.legder(last)).real)
    x = np.concatenate([[-1.0], inner, [1.0]])
    weights = 2.0 / (order * (order + 1) * legendre.legval(x, last)**2)
    values = legendre.legvander(x, order)
    slopes = np.column_stack([legendre.legval(x, legendre.legder(unit))
                              for unit in np.eye(order + 1)])
    return x, weights, slopes @ np.linalg.inv(values)


def _limit(q, inverse, derivative, jacobian, stiffness):
    # Longest stable step: 2 over the highest frequency, by power iteration on the straight arm.
    shift, size, force = np.random.default_rng(1).standard_normal(q.shape), 1.0, np.empty_like(q)
    for _ in range(300):
        shift /= np.abs(shift).max()
        change = np.zeros_like(q)
        for side in (1.0, -1.0):
            _force(q + side * 1e-6 * shift, derivative, jacobian, stiffness,
                   np.zeros_like(q), force)
            change -= side * inverse * force / 2e-6
        size, shift = np.abs(change).max(), change
    return 2.0 / np.sqrt(1.1 * size)


# numba's cache sees that this file changes, but not that columns of `layout` do.
@numba.njit(fastmath=True, cache=True)
def _force(q, derivative, jacobian, stiffness, weight, out):
    for node in range(len(out)):
        for part in range(3):
            out[node, part] = weight[node, part]
    n = len(derivative)
    stress = np.empty((3, n))
    for k in range(len(jacobian)):
        base = k * (n - 1)
        for i in range(n):
            x = y = bend = 0.0
            for j in range(n):
                x += derivative[i, j] * q[base + j, 0]
                y += derivative[i, j] * q[base + j, 1]
                bend += derivative[i, j] * q[base + j, 2]
            x, y, bend = x / jacobian[k], y / jacobian[k], bend / jacobian[k]
            c, s = np.cos(q[base + i, 2]), np.sin(q[base + i, 2])
            stretch, shear = c * x + s * y, c * y - s * x
            axial = stiffness[0, k, i] * (stretch - 1.0)
            across = stiffness[1, k, i] * shear
            stress[0, i] = (axial * c - across * s) / jacobian[k]
            stress[1, i] = (axial * s + across * c) / jacobian[k]
            stress[2, i] = stiffness[2, k, i] * bend / jacobian[k]
            out[base + i, 2] -= axial * shear - across * stretch
        for part in range(3):
            for j in range(n):
                total = 0.0
                for i in range(n):
                    total += derivative[i, j] * stress[part, i]
                out[base + j, part] -= total


@numba.njit(cache=True)
def _kick(v, q, inner, load, half, inverse):
    """Add what half a step's forces change: of the arm, and of a load on its ends."""
    c, s, last = np.cos(q[0, 2]), np.sin(q[0, 2]), len(q) - 1
    for node in range(len(q)):
        for part in range(3):
            v[node, part] += half * inverse[node, part] * inner[node, part]
    for node, x, i, torque in ((0, FORCE_X, FORCE_I, TORQUE), (last, TIP_X, TIP_I, TIP_TORQUE)):
        v[node, 0] += half * inverse[node, 0] * (load[x] + c * load[i] - s * load[i + 1])
        v[node, 1] += half * inverse[node, 1] * (load[x + 1] + s * load[i] + c * load[i + 1])
        v[node, 2] += half * inverse[node, 2] * load[torque]


@numba.njit(cache=True)
def _advance(q, v, loads, step, inverse, derivative, jacobian, stiffness, weight, driven):
    inner = np.empty_like(q)
    _force(q, derivative, jacobian, stiffness, weight, inner)
    for k in range(len(loads)):
        _kick(v, q, inner, loads[k, 0], 0.5 * step, inverse)
        for node in range(len(q)):
            for part in range(3):
                q[node, part] += step * v[node, part]
        if driven:
            q[0, 2], v[0, 2] = loads[k, 2, ANGLE], loads[k, 2, SPEED]
        _force(q, derivative, jacobian, stiffness, weight, inner)
        _kick(v, q, inner, loads[k, 2], 0.5 * step, inverse)
