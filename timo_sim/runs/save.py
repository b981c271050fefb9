# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Runs written to files, as logs or tables."""

import numpy as np

from timo_sim.log.export import named, write_table
from timo_sim.log.new_log import NewLog
from timo_sim.messages.outputs import outputs, with_angles
from timo_sim.physics.layout import FORCE_X, FORCE_Y, LOADS, TORQUE
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.simulation.snapshot import Snapshot


def save(run, path):
    """Write a run to a file, see `Run.save`."""
    if path.suffix != '.mcap':
        write_table(run.columns(), path)
        return path
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    log = NewLog(path, run.scene, {**values, **run.scene.values}, saved_by='Run.save')
    try:
        for snapshot in _snapshots(run):
            for output in _motion_outputs(run):
                log.output(output.name, snapshot, output.numbers(snapshot))
    finally:
        log.close()
    return log.path


def columns_of(run):
    """Return the columns of a run, see `Run.columns`."""
    snapshots = list(_snapshots(run))
    found = {'time_s': run.t}
    for output in _motion_outputs(run):
        values = np.array([output.numbers(snapshot) for snapshot in snapshots])
        names, values = with_angles(output.columns, values)
        found.update(zip(named(output.name, names), values.T))
    return found


def _motion_outputs(run):
    # What is read off the motion alone: sensors need the simulator.
    return [output for output in outputs(run.scene.modal_count)
            if output.columns and not output.delay]


def _snapshots(run):
    steps = np.rint(run.t / run.scene.step).astype(int).tolist()
    for step, motion, effort in zip(steps, run.motion, run.effort.tolist()):
        load = [0.0] * LOADS
        if step:  # before the first step nothing has acted
            load[FORCE_X], load[FORCE_Y], load[TORQUE] = effort
        yield Snapshot(run.scene, run.model, step, round(step * run.scene.step * 1e9), motion,
                       load)
