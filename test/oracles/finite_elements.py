"""
The manipulator by finite elements, with exudyn: references for the tests, peer of the benchmarks.

Geometrically exact two-node beams (one integration point, so no shear locking), the rigid bodies
on the end nodes, and the trapezoidal rule, or with a driven shaft generalized-alpha; second order
in the mesh and in the step. The beams are extensible, with the E A of the section.

What was chosen, and measured on the paper's scene (20 elements, 1 ms; +- 20 %):

- a modified Newton, its Jacobian renewed when an iteration gains less than a factor of 4: 0.44 s;
  renewed in every step 1.3 s, in every iteration 2.5 s;
- increments below 1e-10 (`residualMode` 1): 1e-8 saves 20 % and costs 1e-5 rad at 1 ms and
  3e-4 rad at 0.2 ms; the default tolerance on the residual lies below round-off;
- loads as compiled symbolic functions, whose values Python sets once in a step: 0.04 s; Python
  functions, called in every iteration, 0.12 s;
- sparse factors, one thread, the build without range checks: 5 % less than the other one.
"""

import sys
import time

import numpy as np
from scipy.sparse import csr_matrix

from timo_sim.physics.formulation import FORCE_X, FORCE_Y, TORQUE

sys.exudynFast = True  # read by the import that follows
import exudyn  # noqa: E402, I100
import exudyn.FEM  # noqa: E402
import exudyn.itemInterface as items  # noqa: E402
import exudyn.utilities  # noqa: E402

STATIONS = {'l4': 0.25, 'l2': 0.5, '3l4': 0.75, 'l': 1.0}
CHANNELS = (FORCE_X, FORCE_Y, TORQUE)
TOLERANCE = 1e-10


def simulate(scene, elements, step, duration, every, drive=None, tolerance=TOLERANCE,
             axial_factor=1.0):
    """
    Simulate a scene with geometrically exact beam elements.

    Parameters
    ----------
    scene : Scene
        At rest or in rigid motion at first, undeformed; its modes and step are not used.
    elements : int
        A multiple of 4.
    step, duration : float
        [s]
    every : int
        Steps from sample to sample; loads may jump at samples only.
    drive : tuple of function(float) -> float, optional
        theta(t) [rad], theta'(t) and theta''(t): the carrier is held and the shaft driven.
        theta'' is 0 at t = 0, as exudyn's initial accelerations know no drive.
    tolerance : float
        Of the norm of a Newton increment [m, rad].
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
    if drive:
        _drive(system, nodes[0], drive)
    watched = [nodes[0], *(nodes[round(share * elements)] for share in STATIONS.values())]
    root, *stations, seconds = _solve(system, scene, watched, nodes[0], range(3), step, duration,
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


def reduced(scene, modes, step, duration, every, elements=200):
    """
    Simulate a scene with exudyn's modally reduced floating frame (ObjectFFRFreducedOrder).

    The frame sits on the shaft; the mesh is two rows of point masses at the radius of gyration
    of the section, and of the end effector, on either side of the axis, moved by clamped modes.

    Parameters
    ----------
    scene, step, duration, every
        As for `simulate`.
    modes : int
        Number of modes, from `elements` elements.

    Returns
    -------
    dict
        As from `simulate`; the deflection is linear in the modes, so axial
        displacements are left out.

    """
    arm, manipulator, values = scene.manipulator.arm, scene.manipulator, scene.values
    section = arm.section
    frequency, deflection, rotation = _modes(scene, elements, modes)
    xi = np.linspace(0.0, arm.length, elements + 1)
    mass = np.full(elements + 1, section.mass_per_length * arm.length / elements)
    mass[[0, -1]] /= 2.0
    inertia = mass * section.second_moment / section.area
    mass[-1] += manipulator.tip_mass
    inertia[-1] += manipulator.tip_inertia
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
            initialVelocity=_carrier(scene, '_velocity') + [0.0],
            initialAngularVelocity=[0.0, 0.0, values['initial.shaft_velocity']])
    root, modal = frame['nRigidBody'], frame['nGenericODE2']
    # No motion leaves the plane, so nothing has to hold it there; the first two inertias are free.
    system.AddObject(items.ObjectRigidBody(
        mass=manipulator.base_mass, inertia=[1.0, 1.0, manipulator.shaft_inertia, 0.0, 0.0, 0.0],
        nodeNumber=root))
    body, q, seconds = _solve(system, scene, [root, modal], root, (0, 1, 5), step, duration,
                              every, TOLERANCE)
    run = {'t': np.arange(len(q)) * (every * step),
           'x_c_m': values['initial.carrier_x'] + body[:, 0],
           'y_c_m': values['initial.carrier_y'] + body[:, 1], 'theta_rad': angle + body[:, 5]}
    for field, unit, of_modes in (('w', 'm', deflection), ('phi', 'rad', rotation)):
        for name, share in STATIONS.items():
            run[f'{field}_{name}_{unit}'] = q @ of_modes[:, round(share * elements)]
    return {**run, 'solver_seconds': seconds}


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
    # Twice as many: axial modes lie between those in bending.
    square, shape = system.ComputeODE2Eigenvalues(
        settings, useSparseSolver=True, numberOfEigenvalues=2 * count,
        constrainedCoordinates=[0, 1, 2])
    shape = shape.T.reshape(2 * count, elements + 1, 3)
    bending = np.flatnonzero(np.abs(shape[:, :, 1]).max(axis=1)
                             > np.abs(shape[:, :, 0]).max(axis=1))[:count]
    shape = shape[bending] * np.sign(shape[bending, 1, 2])[:, np.newaxis, np.newaxis]
    return np.sqrt(square[bending]) / (2.0 * np.pi), shape[:, :, 1], shape[:, :, 2]


_modes = modes  # `reduced` has an argument of this name


def _carrier(scene, kind=''):
    return [scene.values[f'initial.carrier_{axis}{kind}'] for axis in 'xy']


def _add_arm(system, scene, elements, angle=None, axial_factor=1.0):
    # Coordinates count from the carrier's initial position, for fewer digits lost.
    arm, spin = scene.manipulator.arm, scene.values['initial.shaft_velocity']
    section = arm.section
    angle = scene.values['initial.shaft'] if angle is None else angle
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    nodes = [system.AddNode(items.NodeRigidBody2D(
        referenceCoordinates=[*(xi * along), angle],
        initialVelocities=[*(_carrier(scene, '_velocity') + xi * spin * across), spin]))
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
    if body.tip_mass or body.tip_inertia:
        system.AddObject(items.ObjectRigidBody2D(
            mass=body.tip_mass, inertia=body.tip_inertia, nodeNumber=nodes[-1]))


def _drive(system, root, drive):
    ground = _marker(system, system.AddNode(items.NodePointGround()), 0)
    angle, rate, _ = drive
    for coordinate in range(3):
        follow = {} if coordinate < 2 else {
            'offsetUserFunction': lambda system, t, item, offset: angle(t) - angle(0.0),
            'offsetUserFunction_t': lambda system, t, item, offset: rate(t)}
        system.AddObject(items.ObjectConnectorCoordinate(
            markerNumbers=[ground, _marker(system, root, coordinate)], **follow))


def _marker(system, node, coordinate):
    return system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))


def _add_load(system, node, coordinate, value):
    # A load that is always `value`, a symbolic number set from outside.
    def constant(system, t, load):
        return 1.0 * value

    load = system.AddLoad(items.LoadCoordinate(
        markerNumber=_marker(system, node, coordinate), load=0.0))
    system.SetLoadParameter(load, 'loadUserFunction', exudyn.utilities.CreateSymbolicUserFunction(
        system, constant, 'loadUserFunction', load))


def _solve(system, scene, watched, root, coordinates, step, duration, every, tolerance,
           damped=False):
    # Coordinates of the watched nodes, each of shape (n_t, n), and the solver's CPU time [s].
    count = round(duration / step)
    loads = scene.load.stages(0, count, step)
    used = [(channel, coordinate) for channel, coordinate in zip(CHANNELS, coordinates)
            if loads[:, :, channel].any()]
    numbers = [exudyn.symbolic.Real(f'load {channel}', 0.0) for channel, _ in used]
    for number, (_, coordinate) in zip(numbers, used):
        _add_load(system, root, coordinate, number)
    loads = loads[:, :, [channel for channel, _ in used]]
    sensors = [system.AddSensor(items.SensorNode(
        nodeNumber=node, storeInternal=True, writeToFile=False,
        outputVariableType=exudyn.OutputVariableType.Coordinates)) for node in watched]
    system.Assemble()
    settings = _settings(every * step, tolerance, damped)
    # The rule takes the accelerations at both ends of a step, either of them with the load of
    # that step: at a jump, it begins anew from the accelerations after the jump.
    jumps = 1 + np.flatnonzero((loads[1:, 0] != loads[:-1, -1]).any(axis=1))
    if (jumps % every).any():
        raise ValueError(f'loads may jump at samples only, every {every} steps, got {jumps}')
    bounds, pieces, seconds = [0, *jumps.tolist(), count], [], 0.0
    for first, last in zip(bounds, bounds[1:]):
        _set_loads(system, numbers, [loads[first, 0], *loads[first:last, -1]])
        settings.timeIntegration.startTime = first * step
        settings.timeIntegration.endTime = last * step
        settings.timeIntegration.numberOfSteps = last - first
        start = time.process_time()
        system.SolveDynamic(settings, updateInitialValues=True)
        seconds += time.process_time() - start
        piece = [system.GetSensorStoredData(sensor) for sensor in sensors]
        if len(piece[0]) != (last - first) // every + 1:
            raise RuntimeError(f'exudyn stored {len(piece[0])} samples of {last - first} steps, '
                               f'expected every {every}')
        pieces.append([table[min(first, 1):, 1:] for table in piece])
    return *(np.concatenate(parts) for parts in zip(*pieces)), seconds


def _set_loads(system, numbers, rows):
    # The first row now, and one of the others before each step.
    rows = iter(np.array(rows).tolist())

    def set_next(system, t):
        for number, value in zip(numbers, next(rows)):
            number.SetValue(value)
        return True

    set_next(system, 0.0)
    if numbers:
        system.SetPreStepUserFunction(set_next)


def _settings(period, tolerance, damped):
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = period
    settings.parallel.numberOfThreads = 1
    settings.linearSolverType = exudyn.LinearSolverType.EigenSparse
    integration = settings.timeIntegration
    integration.verboseMode = 0
    # Driven at 6 rad/s, the trapezoidal rule blows up in the axial modes that no step resolves.
    integration.solverType = (exudyn.DynamicSolverType.GeneralizedAlpha if damped
                              else exudyn.DynamicSolverType.TrapezoidalIndex2)
    integration.generalizedAlpha.spectralRadius = 0.9
    integration.adaptiveStep = False
    newton = integration.newton
    newton.useModifiedNewton = True
    newton.modifiedNewtonContractivity = 0.25
    newton.residualMode = 1
    newton.absoluteTolerance = newton.relativeTolerance = tolerance
    return settings
