# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The manipulator by exudyn's modally reduced floating frame: a peer in the benchmarks."""

import exudyn.FEM
import numpy as np
from scipy.sparse import csr_matrix

from oracles.engine import exudyn, items, solve
from oracles.finite_elements import carrier, modes as clamped_modes, STATIONS


def simulate(scene, modes, step, duration, every, elements=200):
    """
    Simulate a scene with exudyn's modally reduced floating frame (ObjectFFRFreducedOrder).

    The frame is that of the shaft. The mesh is two rows of point masses, on either side of the
    axis at the radius of gyration of the section and of the end effector; clamped modes move them.
    Their deflection is linear, without the shortening that balances the turning frame's terms of
    second order: equations of the same frame and modes, written out, are 1.0e-2 m off on the
    paper's scene with 3 and with 6 modes. The rows stretch as they turn, which adds 2e-3 m;
    without the end effector's inertia exudyn agrees with those equations to 2e-5 m.

    Parameters
    ----------
    scene, step, duration, every
        As for `finite_elements.simulate`.
    modes : int
        Number of modes, from `elements` elements.

    Returns
    -------
    dict
        As from `finite_elements.simulate`; the deflection is linear in the modes, so axial
        displacements are left out.

    """
    arm, manipulator, values = scene.manipulator.arm, scene.manipulator, scene.values
    section = arm.section
    frequency, deflection, rotation = clamped_modes(scene, elements, modes)
    xi = np.linspace(0.0, arm.length, elements + 1)
    mass = np.full(elements + 1, section.mass_per_length * arm.length / elements)
    mass[[0, -1]] /= 2.0
    inertia = mass * section.second_moment / section.area
    mass[-1] += manipulator.end_effector_mass
    inertia[-1] += manipulator.end_effector_inertia
    radius = np.sqrt(inertia / mass)
    position, shape = np.zeros((2, elements + 1, 3)), np.zeros((2, elements + 1, 3, modes))
    for row, side in enumerate((radius, -radius)):
        position[row, :, 0], position[row, :, 1] = xi, side
        shape[row, :, 0], shape[row, :, 1] = -side[:, np.newaxis] * rotation.T, deflection.T
    shape = shape.reshape(-1, modes)
    mass = np.repeat(np.tile(mass / 2.0, 2), 3)
    momentum = mass[:, np.newaxis] * shape
    mesh = exudyn.FEM.FEMinterface()
    mesh.nodes = {'Position': position.reshape(-1, 3)}
    mesh.modeBasis = {'matrix': shape, 'type': 'NormalModes'}
    mesh.massMatrix = csr_matrix(np.diag(mass))
    mesh.stiffnessMatrix = csr_matrix(
        momentum * (2.0 * np.pi * frequency)**2 @ momentum.T)
    angle = values['initial.shaft']
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    frame = exudyn.FEM.ObjectFFRFreducedOrderInterface(
        mesh, rigidBodyNodeType=exudyn.NodeType.RotationRxyz).AddObjectFFRFreducedOrder(
            system, rotationMatrixRef=exudyn.utilities.RotationMatrixZ(angle),
            initialVelocity=carrier(scene, '_velocity') + [0.0],
            initialAngularVelocity=[0.0, 0.0, values['initial.shaft_velocity']])
    root, modal = frame['nRigidBody'], frame['nGenericODE2']
    # All motion is in the plane without constraints; the first two inertias have no effect.
    system.AddObject(items.ObjectRigidBody(
        mass=manipulator.base_mass, inertia=[1.0, 1.0, manipulator.shaft_inertia, 0.0, 0.0, 0.0],
        nodeNumber=root))
    shaft = system.AddMarker(items.MarkerNodeRigid(nodeNumber=root))
    body, q, seconds = solve(system, scene, [root, modal], root, shaft, step, duration, every)
    run = {'t': np.arange(len(q)) * (every * step),
           'x_c_m': values['initial.carrier_x'] + body[:, 0],
           'y_c_m': values['initial.carrier_y'] + body[:, 1], 'theta_rad': angle + body[:, 5]}
    for field, unit, of_modes in (('w', 'm', deflection), ('phi', 'rad', rotation)):
        for name, share in STATIONS.items():
            run[f'{field}_{name}_{unit}'] = q @ of_modes[:, round(share * elements)]
    return {**run, 'solver_seconds': seconds}
