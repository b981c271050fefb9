# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A log of a run without a node."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from timo_sim.log.notes import START, start_note, SUMMARY, TEXT
from timo_sim.log.write import Channel, Recorder
from timo_sim.scene.parameters import frame_names
from timo_sim.topics.cdr import pack
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import TRANSFORMS

if TYPE_CHECKING:
    from timo_sim.scene.scene import Scene

DESCRIPTION = 'robot_description'


def description(scene: Scene, frames: dict[str, str]) -> bytes:
    """Return the message with the URDF of a scene, with these names of frames."""
    from timo_sim.scene.urdf import urdf_of
    return pack(TEXT, {'data': urdf_of(scene.manipulator, frames)})


class NewLog(Recorder):
    """
    A log of a run without a node: the same topics, and the bytes that the node writes.

    `summary`, a dictionary of str, is noted at its end.
    """

    def __init__(self, path: Path | str, scene: Scene, values: dict[str, Any],
                 node: str = '/timo_sim', **notes: str) -> None:
        namespace = node.rpartition('/')[0]
        channels = [Channel(node + command.name[1:], command.type_name) for command in COMMANDS]
        self._topics: dict[str, tuple] = {}
        self.summary: dict[str, str] = {}
        frames = frame_names(values)
        for output in (*scene.outputs, scene.transforms):
            name = output.name
            topic = (name if name.startswith('/') else
                     node + name[1:] if name.startswith('~') else f'{namespace}/{name}')
            delay = round(1e9 * scene.values[output.delay]) if output.delay else 0
            self._topics[name] = len(channels), output.serializer(frames), delay
            channels.append(Channel(topic, output.type_name))
        channels.append(Channel(f'{namespace}/{DESCRIPTION}', TEXT, durability='transient_local'))
        super().__init__(path, channels, {START: {**start_note(node, values), **notes}})
        self.write(len(channels) - 1, 0, 0, description(scene, frames))
        self._frames_due, self._frames_period = 0, round(1e9 / values[TRANSFORMS.rate])

    def output(self, name: str, snapshot: Any, numbers: np.ndarray) -> None:
        """Log a message of an output, and frames where they are due; commands go to `write`."""
        if name == 'joint_states' and snapshot.nanoseconds >= self._frames_due:
            # A microsecond less, because times are rounded to nanoseconds.
            self._frames_due = snapshot.nanoseconds + self._frames_period - 1000
            self.output(TRANSFORMS.name, snapshot, TRANSFORMS.numbers(snapshot))
        index, serialize, delay = self._topics[name]
        self.write(index, snapshot.step, snapshot.nanoseconds + delay,
                   serialize(snapshot, numbers))

    def close(self) -> None:
        """Complete the file; raise OSError if that fails, or the log has ended early."""
        self.note(SUMMARY, self.summary)
        super().close()
        if self.error:
            raise OSError(self.error)
