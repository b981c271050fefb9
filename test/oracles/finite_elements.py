# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The manipulator by finite elements, with exudyn: references for the tests, peer of the benchmarks.

There are three kinds of elements, all extensible, with the rigid bodies on the end nodes:

- 'linear': geometrically exact beams with two nodes (one integration point, so no shear locking),
  of second order in the mesh; the references are made of them;
- 'quadratic': those with three nodes, of fourth order;
- 'cable': ANCF cables, whose position is cubic, without shear and without rotary inertia.

`engine` integrates them.
"""

import numpy as np

from oracles.engine import (
    CreateSymbolicUserFunction, exudyn, items, marker, solve, TOLERANCE)

STATIONS = {'l4': 0.25, 'l2': 0.5, '3l4': 0.75, 'l': 1.0}


def simulate(scene, elements, step, duration, every, drive=None, tolerance=TOLERANCE,
             axial_factor=1.0, kind='linear'):
    """
    Simulate a scene with beam elements.

    Parameters
    ----------
    scene : Scene
        It starts undeformed, at rest or in rigid motion; its modes and step are not used.
    elements : int
        They have nodes at each quarter of the arm if this is a multiple of 4, of 2 if they are
        quadratic.
    step, duration : float
        [s]
    every : int
        Steps from sample to sample; loads may jump at samples only.
    drive : tuple of function(float) -> float, optional
        theta(t) [rad], theta'(t) and theta''(t) of a shaft that is driven.
        theta'' is 0 at t = 0, because exudyn's initial accelerations leave the drive out.
    tolerance : float
        For the norm of a Newton increment [m, rad].
    axial_factor : float
        Axial stiffness over E A of the section.
    kind : str

    Returns
    -------
    dict
        't' [s], 'x_c_m', 'y_c_m', 'theta_rad', deflection 'w_l4_m', 'w_l2_m', 'w_3l4_m', 'w_l_m'
        and section rotation 'phi_l4_rad', ... in the arm frame, axial displacement 'u_l4_m', ...,
        of the stations that have a node: each of shape (n_t,); 'solver_seconds': CPU time of the
        solver alone [s].

    """
    spans = elements * (2 if kind == 'quadratic' else 1)
    stations = {name: share for name, share in STATIONS.items() if share * spans % 1.0 == 0.0}
    if drive and drive[2](0.0) != 0.0:
        raise ValueError(f'the drive must start without acceleration, got {drive[2](0.0)} rad/s2')
    values = scene.values
    length, start = values['arm.length'], values['initial.shaft']
    container, system, nodes, beams = system_of(scene, elements, axial_factor, kind)
    if drive:
        _drive(system, nodes[0], drive, kind,
               step * np.arange(1, round(duration / step) + 1))
    watched = [nodes[0], *(nodes[round(share * spans)] for share in stations.values())]
    shaft = system.AddMarker(
        items.MarkerBodyRigid(bodyNumber=beams[0], localPosition=[0.0, 0.0, 0.0])
        if kind == 'cable' else items.MarkerNodeRigid(nodeNumber=nodes[0]))
    root, *tables, seconds = solve(system, scene, watched, nodes[0], shaft, step, duration,
                                   every, tolerance, damped=bool(drive))
    turn, *turns = (_rotation(table, start, kind) for table in (root, *tables))
    theta = start + turn
    run = {'t': np.arange(len(theta)) * (every * step),
           'x_c_m': root[:, 0] + values['initial.carrier_x'],
           'y_c_m': root[:, 1] + values['initial.carrier_y'], 'theta_rad': theta}
    fields = {}
    for (name, share), table, rotation in zip(stations.items(), tables, turns):
        x = share * length * np.cos(start) + table[:, 0] - root[:, 0]
        y = share * length * np.sin(start) + table[:, 1] - root[:, 1]
        run[f'w_{name}_m'] = np.cos(theta) * y - np.sin(theta) * x
        fields[f'phi_{name}_rad'] = rotation - turn
        fields[f'u_{name}_m'] = np.cos(theta) * x + np.sin(theta) * y - share * length
    return {**run, **fields, 'solver_seconds': seconds}


def system_of(scene, elements, axial_factor=1.0, kind='linear'):
    """Return exudyn's container and system, with numbers of nodes and elements along the arm."""
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    nodes, beams = _add_arm(system, scene, elements, axial_factor=axial_factor, kind=kind)
    _add_bodies(system, scene, nodes, kind)
    _add_weight(system, scene, nodes, beams)
    _hold(system, scene, nodes[0], kind)
    return container, system, nodes, beams


def _rotation(table, start, kind):
    # Of a node since the start, from its coordinates.
    if kind != 'cable':
        return table[:, 2]
    return np.unwrap(np.arctan2(np.sin(start) + table[:, 3], np.cos(start) + table[:, 2])) - start


def modes(scene, elements, count):
    """
    Return the lowest bending modes of the arm clamped at its root, the end effector on it.

    Returns
    -------
    frequency : ndarray, shape (count,)
        [Hz]
    deflection, rotation : ndarray, shape (count, elements + 1)
        W [1/sqrt(kg)] and Phi [1/(m sqrt(kg))] at the nodes, mass-normalised, Phi growing from
        the root.

    """
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    nodes, _ = _add_arm(system, scene, elements, angle=0.0)
    _add_bodies(system, scene, nodes)
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.linearSolverType = exudyn.LinearSolverType.EigenSparse
    # Twice as many, because axial modes lie between those in bending.
    square, shape = system.ComputeODE2Eigenvalues(
        settings, useSparseSolver=True, numberOfEigenvalues=2 * count,
        constrainedCoordinates=[0, 1, 2])
    shape = shape.T.reshape(2 * count, elements + 1, 3)
    bending = np.flatnonzero(np.abs(shape[:, :, 1]).max(axis=1)
                             > np.abs(shape[:, :, 0]).max(axis=1))[:count]
    shape = shape[bending] * np.sign(shape[bending, 1, 2])[:, np.newaxis, np.newaxis]
    return np.sqrt(square[bending]) / (2.0 * np.pi), shape[:, :, 1], shape[:, :, 2]


def carrier(scene, kind=''):
    """Return x and y of the carrier at first [m], or with '_velocity' their rates [m/s]."""
    return [scene.values[f'initial.carrier_{axis}{kind}'] for axis in 'xy']


def _add_arm(system, scene, elements, angle=None, axial_factor=1.0, kind='linear'):
    # Nodes and elements. Coordinates are relative to the carrier's initial position, to lose fewer
    # digits.
    assert not scene.manipulator.hub_radius, 'these elements begin at the axis of the shaft'
    arm, spin = scene.manipulator.arm, scene.values['initial.shaft_velocity']
    section = arm.section
    angle = scene.values['initial.shaft'] if angle is None else angle
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    new, turn, rate = ((items.NodePoint2DSlope1, along, spin * across) if kind == 'cable'
                       else (items.NodeRigidBody2D, [angle], [spin]))
    inner = 2 if kind == 'quadratic' else 1
    nodes = [system.AddNode(new(
        referenceCoordinates=[*(xi * along), *turn],
        initialVelocities=[*(carrier(scene, '_velocity') + xi * spin * across), *rate]))
        for xi in np.linspace(0.0, arm.length, inner * elements + 1)]
    constants = {'physicsLength': arm.length / elements,
                 'physicsMassPerLength': section.mass_per_length,
                 'physicsBendingStiffness': section.bending_stiffness,
                 'physicsAxialStiffness': axial_factor * section.axial_stiffness}
    element = items.ObjectANCFCable2D
    if kind != 'cable':
        element = items.ObjectBeamGeometricallyExact2D
        constants |= {'physicsCrossSectionInertia': section.inertia_per_length,
                      'physicsShearStiffness': section.shear_stiffness,
                      'includeReferenceRotations': True}
    return nodes, [system.AddObject(element(nodeNumbers=nodes[first:first + inner + 1],
                                            **constants))
                   for first in range(0, inner * elements, inner)]


def _add_bodies(system, scene, nodes, kind='linear'):
    body = scene.manipulator
    for node, mass, inertia in ((nodes[0], body.base_mass, body.shaft_inertia),
                                (nodes[-1], body.end_effector_mass, body.end_effector_inertia)):
        if mass or inertia:
            # The slope of a cable turns as a unit vector: its inertia is that of the body.
            turning = [inertia, inertia] if kind == 'cable' else [inertia]
            system.AddObject(items.ObjectGenericODE2(
                nodeNumbers=[node], massMatrix=np.diag([mass, mass, *turning])))


def _add_weight(system, scene, nodes, beams):
    body, gravity = scene.manipulator, scene.values['gravity']
    if not any(gravity):
        return
    for beam in beams:
        system.AddLoad(items.LoadMassProportional(
            markerNumber=system.AddMarker(items.MarkerBodyMass(bodyNumber=beam)),
            loadVector=[*gravity, 0.0]))
    for node, mass in (nodes[0], body.base_mass), (nodes[-1], body.end_effector_mass):
        for axis, acceleration in enumerate(gravity):
            system.AddLoad(items.LoadCoordinate(markerNumber=marker(system, node, axis),
                                                load=mass * acceleration))


def _hold(system, scene, root, kind):
    ground = marker(system, system.AddNode(items.NodePointGround()), 0)
    held = set(range(2)) - set(scene.constraints.free_axes)
    if scene.values['motor.shaft'] == 'locked':
        # A slope may change in length, along x at first.
        held |= {3 if kind == 'cable' else 2}
    for axis in held:
        system.AddObject(items.ObjectConnectorCoordinate(
            markerNumbers=[ground, marker(system, root, axis)]))


def _drive(system, root, drive, kind, times):
    # Symbolic numbers are the shaft's angle and speed, which Python sets once in a step.
    ground = marker(system, system.AddNode(items.NodePointGround()), 0)
    symbolic, begin = exudyn.symbolic, drive[0](0.0)
    angle, rate = symbolic.Real('angle', begin), symbolic.Real('rate', drive[1](0.0))
    times = iter(times)

    def set_next(system, t):
        now = next(times)
        angle.SetValue(drive[0](now))
        rate.SetValue(drive[1](now))
        return True

    def function(value):
        return lambda system, t, item, offset: value()

    driven = {2: (lambda: angle - begin, lambda: 1.0 * rate)}
    if kind == 'cable':
        driven = {2: (lambda: symbolic.cos(angle) - np.cos(begin),
                      lambda: -symbolic.sin(angle) * rate),
                  3: (lambda: symbolic.sin(angle) - np.sin(begin),
                      lambda: symbolic.cos(angle) * rate)}
    for axis, values in driven.items():
        constraint = system.AddObject(items.ObjectConnectorCoordinate(
            markerNumbers=[ground, marker(system, root, axis)]))
        for name, value in zip(('offsetUserFunction', 'offsetUserFunction_t'), values):
            system.SetObjectParameter(constraint, name, CreateSymbolicUserFunction(
                system, function(value), name, constraint))
    system.SetPreStepUserFunction(set_next)
