# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Open a log as a Run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from timo_sim.log.payloads import payloads_of
from timo_sim.log.records import LogError
from timo_sim.log.recording import Recording
from timo_sim.runs.run import Run


def open_log(path: str | Path, node: str | None = None) -> Run:
    """
    Open a log of the node, or of `Run.save`, as a run.

    Parameters
    ----------
    path : str or Path
    node : str, optional
        Fully qualified name of the node; needed if the file has several.

    Returns
    -------
    Run
        Its samples are the messages of joint_states; `run.recording.topics` has all topics.

    Raises
    ------
    LogError
        If the file is not a log, or is a plain bag, without a scene.

    Examples
    --------
    >>> import timo_sim
    >>> path = timo_sim.simulate(timo_sim.load_scene('paper'), 1.0).save('run.mcap')
    >>> timo_sim.open_log(path).shaft.shape
    (1001,)

    """
    recording = Recording(path, node)
    if recording.scene is None:
        raise LogError(f'{recording.title} is a plain bag, which does not contain the scene: '
                       'timo_sim export makes a table of it')
    _, ns, motion = recording.motion()
    scene = recording.scene
    heat = np.full(len(ns), np.nan) if scene.friction.any() else np.zeros(len(ns))
    return Run(scene, scene.build(), 1e-9 * ns, motion, heat, None, recording.summary, recording,
               payloads_of(recording))
