# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The finite-element engine exudyn: time integration of a system under the loads of a scene.

It uses the trapezoidal rule, or generalized-alpha with a driven shaft; second order in the step.

These settings were chosen by CPU time for the paper's scene (4 elements of three nodes, 1 ms):

- a modified Newton, its Jacobian renewed when an iteration gains less than a factor of 4: 0.10 s;
  of 2 as by default 0.10 s; with a driven shaft a full one, in two thirds of the time;
- dense factors, for up to 45 coordinates: 0.08 s; sparse ones 0.10 s;
- increments below 1e-10 (`residualMode` 1); 1e-8 takes 0.06 s, and costs 1e-4 rad; the default
  tolerance on the residual lies below round-off;
- loads as compiled symbolic functions of time: Python does nothing in a step;
- one thread, no files, the build without range checks.
"""

from bisect import bisect_right
import math
import sys
import time

import numpy as np

from oracles.peers import is_constant
from timo_sim.scene.loads import Harmonic

sys.exudynFast = True  # read by the import that follows
import exudyn  # noqa: E402, I100
from exudyn.advancedUtilities import CreateSymbolicUserFunction  # noqa: E402
import exudyn.itemInterface as items  # noqa: E402
import exudyn.utilities  # noqa: E402, F401

CHANNELS = ('force_x', 'force_y', 'torque')
TOLERANCE = 1e-10
_SMALL = 45  # coordinates that are solved for with dense factors


def solve(system, scene, watched, root, shaft, step, duration, every, tolerance=TOLERANCE,
          damped=False):
    """
    Assemble a system and integrate it under the loads of a scene.

    Parameters
    ----------
    system : MainSystem
        Of exudyn, with all its nodes and objects.
    scene : Scene
        Its loads are used, which are harmonic and piecewise.
    watched : list of int
        Numbers of the nodes to return.
    root : int
        Number of the node that the forces act on, along its first two coordinates.
    shaft : int
        Number of the marker that the torque acts on.
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
    numbers = {name: exudyn.symbolic.Real(name, 0.0) for name in CHANNELS
               if scene.load.terms.get(name)}
    for name, number in numbers.items():
        _add_load(system, name, number, scene.load.terms[name],
                  shaft if name == 'torque' else marker(system, root, CHANNELS.index(name)))
    sensors = [system.AddSensor(items.SensorNode(
        nodeNumber=node, storeInternal=True, writeToFile=False,
        outputVariableType=exudyn.OutputVariableType.Coordinates)) for node in watched]
    system.Assemble()
    settings = _settings(every * step, tolerance, damped,
                         system.systemData.ODE2Size() <= _SMALL)
    # The rule takes the accelerations at both ends of a step under the load of that step. After a
    # jump it therefore begins anew, from the accelerations after the jump.
    count = round(duration / step)
    jumps = sorted({round(jump / step) for name in numbers for term in scene.load.terms[name]
                    if not isinstance(term, Harmonic) for jump in term.jumps()
                    if 0.0 < jump < duration})
    if any(jump % every for jump in jumps):
        raise ValueError(f'loads may jump at samples only, every {every} steps, got {jumps}')
    bounds, pieces, seconds = [0, *jumps, count], [], 0.0
    for first, last in zip(bounds, bounds[1:]):
        for name, number in numbers.items():
            number.SetValue(float(sum(
                (0.0, *term.value)[bisect_right(term.time, (first + 0.5) * step)]
                for term in scene.load.terms[name] if not isinstance(term, Harmonic))))
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


def _add_load(system, name, constant, terms, marker):
    # The sum of a symbolic number, which is set before each piece, and of harmonic terms.
    if not all(isinstance(term, Harmonic) or is_constant(term) for term in terms):
        raise ValueError(f'load.{name} must be harmonic or piecewise')
    waves = [(term.amplitude, 2.0 * math.pi * term.frequency, term.phase) for term in terms
             if isinstance(term, Harmonic)]

    def value(system, t, load):
        total = 1.0 * constant
        for amplitude, omega, phase in waves:
            total = total + amplitude * exudyn.symbolic.sin(omega * t + phase)
        return exudyn.symbolic.Vector([0, 0, total]) if name == 'torque' else total

    if name == 'torque':
        load, function = items.Torque(markerNumber=marker), 'loadVectorUserFunction'
    else:
        load, function = items.LoadCoordinate(markerNumber=marker, load=0.0), 'loadUserFunction'
    load = system.AddLoad(load)
    system.SetLoadParameter(load, function, CreateSymbolicUserFunction(
        system, value, function, load))


def _settings(period, tolerance, damped, small):
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = period
    settings.parallel.numberOfThreads = 1
    settings.linearSolverType = (exudyn.LinearSolverType.EXUdense if small
                                 else exudyn.LinearSolverType.EigenSparse)
    integration = settings.timeIntegration
    integration.verboseMode = 0
    # With a shaft driven at 6 rad/s the trapezoidal rule diverges in unresolved axial modes.
    integration.solverType = (exudyn.DynamicSolverType.GeneralizedAlpha if damped
                              else exudyn.DynamicSolverType.TrapezoidalIndex2)
    integration.generalizedAlpha.spectralRadius = 0.9
    integration.adaptiveStep = False
    newton = integration.newton
    newton.useModifiedNewton = not damped
    newton.modifiedNewtonContractivity = 0.25
    newton.residualMode = 1
    newton.absoluteTolerance = newton.relativeTolerance = tolerance
    return settings
