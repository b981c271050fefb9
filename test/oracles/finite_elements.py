# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The manipulator by finite elements, with exudyn: references for the tests, peer of the benchmarks.

The arm is made of geometrically exact two-node beams (one integration point, so no shear locking)
with the rigid bodies on the end nodes; second order in the mesh. The beams are extensible, with
the E A of the section. `engine` integrates them.
"""

import numpy as np

from oracles.engine import exudyn, items, marker, solve, TOLERANCE

STATIONS = {'l4': 0.25, 'l2': 0.5, '3l4': 0.75, 'l': 1.0}


def simulate(scene, elements, step, duration, every, drive=None, tolerance=TOLERANCE,
             axial_factor=1.0):
    """
    Simulate a scene with geometrically exact beam elements.

    Parameters
    ----------
    scene : Scene
        It starts undeformed, at rest or in rigid motion; its modes and step are not used.
    elements : int
        A multiple of 4.
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

    Returns
    -------
    dict
        't' [s], 'x_c_m', 'y_c_m', 'theta_rad', deflection 'w_l4_m', 'w_l2_m', 'w_3l4_m', 'w_l_m'
        and section rotation 'phi_l4_rad', ... in the arm frame, axial displacement 'u_l4_m', ...:
        each of shape (n_t,); 'solver_seconds': CPU time of the solver alone [s].

    """
    if elements % 4:
        raise ValueError(f'elements must be a multiple of 4, got {elements}')
    if drive and drive[2](0.0) != 0.0:
        raise ValueError(f'the drive must start without acceleration, got {drive[2](0.0)} rad/s2')
    values = scene.values
    length, start = values['arm.length'], values['initial.shaft']
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    nodes = _add_arm(system, scene, elements, axial_factor=axial_factor)
    _add_bodies(system, scene, nodes)
    _add_weight(system, scene, nodes)
    _hold(system, scene, nodes[0])
    if drive:
        _drive(system, nodes[0], drive)
    watched = [nodes[0], *(nodes[round(share * elements)] for share in STATIONS.values())]
    root, *stations, seconds = solve(system, scene, watched, nodes[0], range(3), step, duration,
                                     every, tolerance, damped=bool(drive))
    theta = start + root[:, 2]
    run = {'t': np.arange(len(theta)) * (every * step),
           'x_c_m': root[:, 0] + values['initial.carrier_x'],
           'y_c_m': root[:, 1] + values['initial.carrier_y'], 'theta_rad': theta}
    fields = {}
    for (name, share), station in zip(STATIONS.items(), stations):
        x = share * length * np.cos(start) + station[:, 0] - root[:, 0]
        y = share * length * np.sin(start) + station[:, 1] - root[:, 1]
        run[f'w_{name}_m'] = np.cos(theta) * y - np.sin(theta) * x
        fields[f'phi_{name}_rad'] = station[:, 2] - root[:, 2]
        fields[f'u_{name}_m'] = np.cos(theta) * x + np.sin(theta) * y - share * length
    return {**run, **fields, 'solver_seconds': seconds}


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
    nodes = _add_arm(system, scene, elements, angle=0.0)
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


def _add_arm(system, scene, elements, angle=None, axial_factor=1.0):
    # Coordinates are relative to the carrier's initial position, to lose fewer digits.
    arm, spin = scene.manipulator.arm, scene.values['initial.shaft_velocity']
    section = arm.section
    angle = scene.values['initial.shaft'] if angle is None else angle
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    nodes = [system.AddNode(items.NodeRigidBody2D(
        referenceCoordinates=[*(xi * along), angle],
        initialVelocities=[*(carrier(scene, '_velocity') + xi * spin * across), spin]))
        for xi in np.linspace(0.0, arm.length, elements + 1)]
    for pair in zip(nodes, nodes[1:]):
        system.AddObject(items.ObjectBeamGeometricallyExact2D(
            nodeNumbers=list(pair), length=arm.length / elements,
            massPerLength=section.mass_per_length,
            crossSectionInertia=section.inertia_per_length,
            bendingStiffness=section.bending_stiffness, shearStiffness=section.shear_stiffness,
            axialStiffness=axial_factor * section.young_modulus * section.area,
            includeReferenceRotations=True))
    return nodes


def _add_bodies(system, scene, nodes):
    body = scene.manipulator
    system.AddObject(items.ObjectRigidBody2D(
        mass=body.base_mass, inertia=body.shaft_inertia, nodeNumber=nodes[0]))
    if body.end_effector_mass or body.end_effector_inertia:
        system.AddObject(items.ObjectRigidBody2D(
            mass=body.end_effector_mass, inertia=body.end_effector_inertia, nodeNumber=nodes[-1]))


def _add_weight(system, scene, nodes):
    # Of an element of linear shape functions half on either node.
    body, arm = scene.manipulator, scene.manipulator.arm
    mass = np.full(len(nodes), arm.section.mass_per_length * arm.length / (len(nodes) - 1))
    mass[[0, -1]] *= 0.5
    mass[0] += body.base_mass
    mass[-1] += body.end_effector_mass
    for axis, gravity in enumerate(scene.values['gravity']):
        for node, share in zip(nodes, mass) if gravity else ():
            system.AddLoad(items.LoadCoordinate(markerNumber=marker(system, node, axis),
                                                load=share * gravity))


def _hold(system, scene, root):
    ground = marker(system, system.AddNode(items.NodePointGround()), 0)
    held = set(range(2)) - set(scene.constraints.free_axes)
    for axis in held | ({2} if scene.values['motor.shaft'] == 'locked' else set()):
        system.AddObject(items.ObjectConnectorCoordinate(
            markerNumbers=[ground, marker(system, root, axis)]))


def _drive(system, root, drive):
    ground = marker(system, system.AddNode(items.NodePointGround()), 0)
    angle, rate, _ = drive
    system.AddObject(items.ObjectConnectorCoordinate(
        markerNumbers=[ground, marker(system, root, 2)],
        offsetUserFunction=lambda system, t, item, offset: angle(t) - angle(0.0),
        offsetUserFunction_t=lambda system, t, item, offset: rate(t)))
