# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The record in a log of the node, or in a bag with its topics."""

import math

import numpy as np

from timo_sim.fitting.record import Channel, Record
from timo_sim.log.recording import Recording
from timo_sim.messages.commands import COMMANDED, COMMANDS
from timo_sim.physics.layout import VOLTAGE
from timo_sim.replay.segments import segments_of
from timo_sim.scene.loads import CHANNELS
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.parameters import PARAMETERS

_COLUMNS = {**CHANNELS, 'voltage': VOLTAGE}
# By output, the topics and columns that show it, the first that a log has; sensors have noise.
_SENSORS = {'~/encoder': 'encoder', '~/root_strain': 'root_strain',
            '~/tip_imu/data_raw': 'tip_acceleration'}
_OUTPUTS = {
    'shaft': (('~/encoder', 'shaft_rad'), ('joint_states', 'shaft_rad')),
    'carrier_x': (('joint_states', 'carrier_x_m'),),
    'carrier_y': (('joint_states', 'carrier_y_m'),),
    'tip_transverse': (('~/tip_deflection', 'transverse_m'),),
    'root_strain': (('~/root_strain', 'outer_fibre'),),
    'tip_acceleration': (('~/tip_imu/data_raw', 'acceleration_y_m_per_s2'),),
}


def read_log(path, scene=None, node=None):
    """
    Return the scene of a log, None for a plain bag, and its Record after its last reset.

    Parameters
    ----------
    path : str or Path
    scene : Scene, optional
        For the time step of the commands in a plain bag.
    node : str, optional
        See `Recording`.

    Raises
    ------
    LogError
        If the file is not a log, or has nothing to replay.
    ParameterError
        If the log has what a record cannot: settings, or forces in the axes of the arm.

    """
    recording = Recording(path, node)
    own = recording.scene or scene
    if own is None:
        raise ParameterError(f'scene must be given with {path}, a plain bag, which has none')
    defaults = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values = {**defaults, **(recording.parameters if recording.facts else {})}
    segment = segments_of(recording, own, values)[-1]
    if segment.changes:
        step, changes = segment.changes[0]
        raise ParameterError(f'{", ".join(changes)} was set at {step * own.step:g} s: a record '
                             'must be of one scene')
    outputs = _outputs(segment, recording, own)
    # A log begins at its start or reset. A bag may have any clock, and begins with its first
    # message; until its first command nothing is known to act.
    begin = segment.first if recording.facts else min([
        *(round(channel.t[0] / own.step) for channel in outputs.values()),
        *(step for step, *_ in segment.commands[:1])], default=0)
    # Sensors send late what they measured; their delay is part of the scene, not of the stamps.
    return recording.scene, Record.of(_inputs(segment, own, begin), outputs, source=str(path))


def _inputs(segment, scene, begin):
    commanded, rows, steps = np.zeros(COMMANDED), [np.zeros(COMMANDED)], [begin]
    for step, index, values, _ in segment.commands:
        COMMANDS[index].apply(values, commanded)
        if step == steps[-1]:
            rows[-1] = commanded.copy()
        else:
            rows.append(commanded.copy())
            steps.append(step)
    table = np.array(rows)
    left = table[:, [k for k in range(COMMANDED) if k not in _COLUMNS.values()]]
    if left.any():
        raise ParameterError('forces in the axes of the arm or of the tip cannot be inputs of a '
                             'fit, because they follow a motion that is not measured')
    t = scene.step * np.array(steps)
    return {name: Channel(t, table[:, column]) for name, column in _COLUMNS.items()
            if table[:, column].any()}


def _outputs(segment, recording, scene):
    found, held = {}, scene.build().constrained
    skipped = {name for name, still in zip(('carrier_x', 'carrier_y', 'shaft'), held) if still}
    for name, places in _OUTPUTS.items():
        for topic, column in places:
            series = recording.topics.get(topic)
            if series is None or name in skipped or name in found or not len(series.ns):
                continue
            values = series.values[series.resets == series.resets.max(), :]
            ns = series.ns[series.resets == series.resets.max()]
            found[name] = Channel(1e-9 * ns, values[:, series.columns.index(column)],
                                  _noise(recording.scene, _SENSORS.get(topic)))
    return found


def _noise(scene, sensor):
    """Return the standard deviation of a sensor's noise and rounding in a scene, or None."""
    if scene is None or sensor is None:
        return None
    noise, step = (scene.values[f'sensor.{sensor}.{kind}'] for kind in ('noise', 'resolution'))
    return math.hypot(noise, step / math.sqrt(12.0)) or None
