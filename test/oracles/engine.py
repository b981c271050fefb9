# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The finite-element engine exudyn: time integration of a system under the loads of a scene.

It uses the trapezoidal rule, or generalized-alpha with a driven shaft; second order in the step.

These settings were chosen by CPU time for the paper's scene (20 elements, 1 ms; +- 20 %):

- a modified Newton, its Jacobian renewed when an iteration gains less than a factor of 4: 0.44 s;
  renewed in every step 1.3 s, in every iteration 2.5 s;
- increments below 1e-10 (`residualMode` 1): 1e-8 saves 20 % and costs 1e-5 rad at 1 ms and
  3e-4 rad at 0.2 ms; the default tolerance on the residual lies below round-off;
- loads as compiled symbolic functions, whose values Python sets once in a step: 0.04 s; Python
  functions, called in every iteration, 0.12 s;
- sparse factors, one thread, the build without range checks: 5 % less than with them.
"""

import sys
import time

import numpy as np

from timo_sim.model.layout import FORCE_X, FORCE_Y, TORQUE

sys.exudynFast = True  # read by the import that follows
import exudyn  # noqa: E402, I100
import exudyn.FEM  # noqa: E402
import exudyn.itemInterface as items  # noqa: E402
import exudyn.utilities  # noqa: E402

CHANNELS = (FORCE_X, FORCE_Y, TORQUE)
TOLERANCE = 1e-10


def solve(system, scene, watched, root, coordinates, step, duration, every, tolerance=TOLERANCE,
          damped=False):
    """
    Assemble a system and integrate it under the loads of a scene.

    Parameters
    ----------
    system : MainSystem
        Of exudyn, with all its nodes and objects.
    scene : Scene
        Its loads are used.
    watched : list of int
        Numbers of the nodes to return.
    root : int
        Number of the node that the loads act on.
    coordinates : sequence of int
        Its coordinates x, y and angle.
    step, duration, every, tolerance
        As for `finite_elements.simulate`.
    damped : bool
        Generalized-alpha instead of the trapezoidal rule.

    Returns
    -------
    *coordinates : ndarray, shape (n_t, n)
        Of each of the watched nodes.
    seconds : float
        CPU time of the solver alone [s].

    """
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
    # The rule takes the accelerations at both ends of a step under the load of that step. After a
    # jump it therefore begins anew, from the accelerations after the jump.
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


def marker(system, node, coordinate):
    """Return a marker of a coordinate of a node."""
    return system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))


def _add_load(system, node, coordinate, value):
    # A load that equals `value`, a symbolic number that Python sets.
    def constant(system, t, load):
        return 1.0 * value

    load = system.AddLoad(items.LoadCoordinate(
        markerNumber=marker(system, node, coordinate), load=0.0))
    system.SetLoadParameter(load, 'loadUserFunction', exudyn.utilities.CreateSymbolicUserFunction(
        system, constant, 'loadUserFunction', load))


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
    # With a shaft driven at 6 rad/s the trapezoidal rule diverges in unresolved axial modes.
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
