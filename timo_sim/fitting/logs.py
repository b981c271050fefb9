# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The Record in a log of the node, or in a bag."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from timo_sim.fitting.record import Channel, Record
from timo_sim.log.tables import Recording
from timo_sim.model.layout import INPUTS
from timo_sim.runs.replay import segments_of
from timo_sim.scene.parameters import DEFAULTS, ParameterError
from timo_sim.scene.scene import Scene
from timo_sim.simulation.loads import limits_of
from timo_sim.topics.commands import COMMANDED, COMMANDS
from timo_sim.topics.outputs import SENSORS

_COLUMNS = {each.name: column for column, each in enumerate(INPUTS) if each.argument}
# The topics and columns that show an output, of which the first that a log has is read.
_OUTPUTS = {
    'shaft': [('joint_states', 'shaft_rad')],
    'carrier_x': [('joint_states', 'carrier_x_m')],
    'carrier_y': [('joint_states', 'carrier_y_m')],
    'tip_transverse': [('~/tip_deflection', 'transverse_m')],
}
_MEASURING = [sensor for sensor in SENSORS if sensor.measured]
_SENSORS = {sensor.topic: sensor.name for sensor in _MEASURING}
for _sensor in _MEASURING:
    _OUTPUTS.setdefault(_sensor.measured, []).insert(0, (_sensor.topic, _sensor.columns[-1]))


def read_log(path: str | Path, scene: Scene | None = None) -> tuple[Scene, Record]:
    """
    Return `scene`, by default that of a log, and the log's Record after its last reset.

    A plain bag needs `scene`. Raises LogError if the file is not a log, or has nothing to replay;
    ParameterError if it has what a record cannot: settings, or forces in the axes of the arm.
    """
    recording = Recording(path)
    if (own := recording.scene or scene) is None:
        raise ParameterError(f'scene must be given with {path}, a plain bag, which has none')
    values = {**DEFAULTS, **(recording.parameters if recording.facts else {})}
    segment = segments_of(recording, own, values)[-1]
    if recording.changes:  # also before a reset, which keeps them
        step, _, changes = recording.changes[0]
        raise ParameterError(f'{", ".join(changes)} was set at {step * own.step:g} s: a record '
                             'must be of one scene')
    outputs = _outputs(segment, recording, own)
    # A log begins at its start or reset. A bag may have any clock, and begins with its first
    # message; until its first command nothing is known to act.
    begin = segment.first if recording.facts else min([
        *(round(channel.t[0] / own.step) for channel in outputs.values()),
        *(step for step, *_ in segment.commands[:1])], default=0)
    # Sensors send late what they measured; their delay is part of the scene, not of the stamps.
    return scene or own, Record.of(_inputs(segment, own, begin), outputs, source=str(path))


def _inputs(segment, scene, begin):
    commanded = np.zeros(COMMANDED)
    rows = {float(begin): commanded.copy()}  # by step; what comes at the same one replaces it
    # If rates are limited, a command at the first step does not: it ramps up from 0.
    ramps = np.isfinite(limits_of(scene.values)[1]).any()
    for step, index, values, _ in segment.commands:
        COMMANDS[index].apply(values, commanded)
        rows[max(step, begin + 1e-6 * ramps)] = commanded.copy()
    table = np.array([*rows.values()])
    if table[:, [k for k in range(COMMANDED) if k not in _COLUMNS.values()]].any():
        raise ParameterError('forces in the axes of the arm or of the tip cannot be inputs of a '
                             'fit, because they follow a motion that is not measured')
    t = scene.step * np.array([*rows])
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
            last, noise = series.resets == series.resets.max(), None
            if recording.scene is not None and topic in _SENSORS:
                # The standard deviation of the noise and rounding.
                deviation, step = (recording.scene.values[f'sensor.{_SENSORS[topic]}.{kind}']
                                   for kind in ('noise', 'resolution'))
                noise = math.hypot(deviation, step / math.sqrt(12.0)) or None
            found[name] = Channel(
                1e-9 * series.ns[last], series.values[last, series.columns.index(column)], noise)
    return found
