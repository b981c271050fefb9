# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How far a replayed motion is from what was logged."""

from dataclasses import dataclass

import numpy as np

from timo_sim.messages.outputs import outputs, with_angles


@dataclass(frozen=True)
class Difference:
    """
    How far the replay of a quantity is from its log.

    Attributes
    ----------
    name : str
        Topic and column.
    largest, rms : float
        In the unit that the column names.
    time : float
        When it is largest [s].

    """

    name: str
    largest: float
    rms: float
    time: float


def compare(segments, scene, columns):
    """
    Compare what was replayed with what was logged.

    Parameters
    ----------
    segments : list of Segment
    scene : Scene
    columns : dict
        Names of the quantities of each topic in the log.

    Returns
    -------
    count, other : int
        Numbers in the log, and how many are not the same to the last bit.
    list of Difference
        Of each quantity that log and replay have both.

    """
    count = other = 0
    result = []
    for output in outputs(scene.modal_count):
        topic = output.name
        done = [segment for segment in segments
                if topic in segment.logged and topic in segment.replayed]
        if not done:
            continue
        parts = [slice(segment.done[topic]) for segment in done]
        time = scene.step * np.concatenate(
            [segment.samples[topic][part] for segment, part in zip(done, parts)])
        logged, replayed = (
            np.concatenate([getattr(segment, kind)[topic][part]
                            for segment, part in zip(done, parts)])
            for kind in ('logged', 'replayed'))
        count += logged.size
        other += (int(np.count_nonzero(logged.view('i8') != replayed.view('i8')))
                  if logged.shape == replayed.shape else logged.size)
        if len(time):
            result += _differences(topic, time, with_angles(columns[topic], logged),
                                   with_angles(output.columns, replayed))
    return count, other, result


def _differences(topic, time, logged, replayed):
    for column in [name for name in logged[0] if name in replayed[0]]:
        before, now = (values[:, columns.index(column)] for columns, values in (logged, replayed))
        distance = np.abs(now - before)
        place = int(np.argmax(distance))
        yield Difference(f'{topic.removeprefix("~/")} {column}', float(distance[place]),
                         float(np.sqrt(np.mean(distance**2))), float(time[place]))
