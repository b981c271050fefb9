# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Large deflections by the elastica: an oracle for the arm bent by inertia of its end effector.

The carrier is pushed along x, the shaft is locked at 90 degrees. Once the force is constant and
the critically damped arm has come to rest in the accelerating frame, it is a cantilever under a
dead load: `m_e a` at its tip and `rho A a` along it.
"""

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipkinc

import timo_sim

LENGTH, RAMP, DURATION = 2.0, 4.0, 16.0
ARM = {'arm.length': LENGTH, 'arm.section.height': 0.005, 'end_effector.inertia': 0.0}


def elastica(load):
    """
    Return the closed form under a tip load alone, without shear.

    Source: K. E. Bisshopp, D. C. Drucker, Quart. Appl. Math. 3 (1945) 272-275.

    Parameters
    ----------
    load : float
        P l^2 / (E I).

    Returns
    -------
    ndarray, shape (3,)
        Tip rotation [rad], transverse deflection and axial shortening of the tip over the length.

    """
    def moduli(angle):
        m = 0.5 * (1.0 + np.sin(angle))
        return m, np.arcsin(np.sqrt(0.5 / m))

    def excess(angle):
        m, begin = moduli(angle)
        return ellipkinc(np.pi / 2, m) - ellipkinc(begin, m) - np.sqrt(load)
    angle = brentq(excess, 1e-9, np.pi / 2 - 1e-12, xtol=1e-14)
    m, begin = moduli(angle)
    across = 1.0 - 2.0 * (ellipeinc(np.pi / 2, m) - ellipeinc(begin, m)) / np.sqrt(load)
    return np.array([angle, across, 1.0 - np.sqrt(2.0 * np.sin(angle) / load)])


def boundary_value(section, tip_load, line_load, length=LENGTH, stretches=False):
    """
    Return what `elastica` does, with shear and a distributed load, by a boundary value solver.

    A section at angle phi carries the force (p, n) along and across the undeformed arm: the moment
    changes by `p` times the slope across less `n` times that along, and the shear strain is
    `(n cos(phi) - p sin(phi)) / (kappa G A)`.

    Parameters
    ----------
    section : Section
    tip_load, line_load : float or ndarray, shape (2,)
        Across the undeformed arm, or along and across it [N], [N/m].
    length : float
        [m]
    stretches : bool
        Whether the arm does, by `(p cos(phi) + n sin(phi)) / (E A)`.

    """
    tip_load, line_load = (np.append(np.zeros(2 - np.size(load)), load)
                           for load in (tip_load, line_load))

    def slopes(xi, y):
        pull, force = tip_load[:, np.newaxis] + np.multiply.outer(line_load, length - xi)
        cosine, sine = np.cos(y[0]), np.sin(y[0])
        shear = (force * cosine - pull * sine) / section.shear_stiffness
        stretch = 1.0 + stretches * (pull * cosine + force * sine) / section.axial_stiffness
        along, across = stretch * cosine - shear * sine, stretch * sine + shear * cosine
        return np.stack([y[1] / section.bending_stiffness, pull * across - force * along,
                         along, across])
    mesh = np.linspace(0.0, length, 101)
    guess = np.stack([0.5 * mesh, 1.0 - mesh / length, mesh, 0.2 * mesh**2])
    solution = solve_bvp(slopes, lambda root, tip: np.array([root[0], tip[1], root[2], root[3]]),
                         mesh, guess, tol=1e-10, max_nodes=20000)
    assert solution.success, solution.message
    angle, _, along, across = solution.sol(length)
    return np.array([angle, across / length, 1.0 - along / length])


def compare(modes, load, formulation='exact', step=0.005):
    """
    Return the values of `elastica` from a simulated run, and those of `boundary_value`.

    Parameters
    ----------
    modes : int
    load : float
        The tip load, as for `elastica`.
    formulation : str
    step : float
        [s]

    Returns
    -------
    run, truth : ndarray, shape (3,)

    """
    values = {
        **ARM, 'arm.damping_ratio': [1.0], 'motor.shaft': 'locked', 'carrier.held': 'y',
        'initial.shaft': np.pi / 2, 'model.modes': modes, 'model.formulation': formulation,
        'integrator.step': step}
    scene = timo_sim.load_scene({}, values)
    section, tip_mass = scene.manipulator.arm.section, scene.manipulator.end_effector_mass
    acceleration = load * section.bending_stiffness / LENGTH**2 / tip_mass
    run = timo_sim.simulate(scene.vary({
        'load.force_x.table.time': [0.0, RAMP],
        'load.force_x.table.value': [0.0, acceleration * scene.build().mass]}), DURATION)
    axial, across = run.deflection(LENGTH)[-1] / LENGTH
    return (np.array([run.rotation(LENGTH)[-1], across, -axial]),
            boundary_value(section, tip_mass * acceleration,
                           section.mass_per_length * acceleration))


def rows(load, modes=(1, 2, 3, 4, 5, 6, 8)):
    """Return the rotation of the tip [deg], and rows of errors against the number of modes."""
    found = []
    for formulation, count in [*(('exact', count) for count in modes), ('newton', modes[-1])]:
        run, truth = compare(count, load, formulation)
        error = np.abs(run - truth)
        found.append([formulation, count, f'{np.degrees(error[0]):.1e}',
                      f'{LENGTH * error[1]:.1e}', f'{LENGTH * error[2]:.1e}'])
    return np.degrees(truth[0]), found
