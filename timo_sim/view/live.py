# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The process that streams samples from `view.feed` to a viewer of rerun."""

from collections import deque
import json
import os
import sys
import threading

import numpy as np
import rerun as rr

from timo_sim.scene.scene import load_scene
from timo_sim.view.entities import (
    ABOUT, log_curves, log_floor, log_frame_of_plane, Plane, send_curves)
from timo_sim.view.panels import blueprint, Panel
from timo_sim.view.track import body_of, of_motion

_PERIOD = 1.0 / 30.0  # [s] of wall time between two sendings
_MOST_WAITING = 300   # samples; older ones are dropped
_PATIENCE = 1.0       # [s] to send the last samples


class Stream:
    """Shows a growing run of a Scene in the viewer at an address."""

    def __init__(self, url, name, scene):
        self._scene, self._name = scene, name.strip('/').replace('/', '_')
        self._largest = [0.0, 0.0]
        self._stream = rr.RecordingStream('timo_sim')
        self._stream.connect_grpc(url)
        start, body = scene.initial_motion(), body_of(scene)
        reach = 1.3 * body.length
        bounds = np.array([start[:2] - reach, start[:2] + reach])
        log_frame_of_plane(self._stream, bounds)
        self._plane = Plane(self._stream, self._name, body, 0, 1)
        self._stream.log(ABOUT, rr.TextDocument(
            f'**{name}**, live: 30 samples per second of wall time, also in the curves'
            ' (a log has all)', media_type='text/markdown'), static=True)
        first = self._track(np.concatenate([[0.0], start, np.zeros(3)])[np.newaxis])
        if first.floor is not None:
            log_floor(self._stream, self._name, first.floor, bounds)
        for trace in first.traces:
            log_curves(self._stream, trace.panel, self._name, 0, 1, trace.names)
        self._stream.send_blueprint(blueprint(
            {trace.panel: Panel(len(trace.names)) for trace in first.traces}, bounds, live=True))

    def _track(self, samples):
        return of_motion(self._name, self._scene, samples[:, 0].astype(np.int64),
                         samples[:, 1:-3], samples[:, -3:], balanced=False)

    def send(self, samples):
        """Send samples, shape (m, 1 + 2 (3 + N) + 3): time [ns], motion, effort."""
        track = self._track(samples)
        poses = track.poses(slice(None))
        self._largest = [max(self._largest[0], np.hypot(*poses.effort[:, :2].T).max()),
                         max(self._largest[1], np.abs(poses.effort[:, 2]).max())]
        self._plane.send(track.ns, poses, self._largest)
        for trace in track.traces:
            send_curves(self._stream, trace.panel, self._name, track.ns,
                        trace.values)

    def flush(self):
        """Wait up to a second until all is sent."""
        self._stream.flush(timeout_sec=_PATIENCE)


def main(url, name, number):
    """Stream samples from standard input; file descriptor `number` has a scene's values, JSON."""
    with open(int(number)) as values:
        scene = load_scene(json.load(values))
    waiting, ended = deque(maxlen=_MOST_WAITING), threading.Event()

    def work():
        stream = Stream(url, name, scene)
        while not ended.wait(_PERIOD) or waiting:
            samples = [waiting.popleft() for _ in range(len(waiting))]
            if samples:
                stream.send(np.array(samples))
        stream.flush()

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    size = 8 * (1 + scene.build().size + 3)
    while len(data := sys.stdin.buffer.read(size)) == size:
        waiting.append(np.frombuffer(data))
    ended.set()
    worker.join(_PATIENCE)
    os._exit(0)  # at once: rerun would wait for a viewer that does not answer


if __name__ == '__main__':
    main(*sys.argv[1:])
