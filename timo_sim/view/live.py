"""A stream of a running simulation to a viewer, which never waits for it."""

from collections import deque
import threading

import numpy as np
import rerun as rr

from timo_sim.track import body_of, of_motion
from timo_sim.view.entities import (
    ABOUT, log_curves, log_frame_of_plane, log_looks, PLANE, send_curves, send_poses, TRAIL)
from timo_sim.view.panels import blueprint, Panel

PERIOD = 1.0 / 30.0  # [s] of wall time between frames
_MOST_WAITING = 300  # frames; older ones are dropped
_PATIENCE = 1.0      # [s] for what is left at the end


class Live:
    """
    Stream samples of a simulation to a viewer from a thread of its own.

    Parameters
    ----------
    scene : Scene
    url : str
        Of the viewer, as in 'rerun+http://127.0.0.1:9876/proxy'. It may come and go.
    name : str
        Of the node.

    Raises
    ------
    ValueError
        If the address is none.

    """

    def __init__(self, scene, url, name):
        self._scene, self._name = scene, name.strip('/').replace('/', '_')
        self._path = f'{PLANE}/{self._name}'
        self._stream = rr.RecordingStream('timo_sim')
        self._stream.connect_grpc(url)
        self._waiting = deque(maxlen=_MOST_WAITING)
        self._due, self._closing = 0.0, threading.Event()
        self._trail, self._largest = np.zeros((0, 2)), [0.0, 0.0]
        self._thread = threading.Thread(target=self._run, name='live', daemon=True)
        self._thread.start()

    def offer(self, now, simulator, effort):
        """
        Take a sample if one is due; return at once.

        Parameters
        ----------
        now : float
            Wall time, steady [s].
        simulator : Simulator
        effort : function() -> tuple of float
            Force x, y [N] and torque [N m] as applied.

        """
        if now >= self._due:
            self._due = now + PERIOD
            self._waiting.append((simulator.nanoseconds, simulator.motion(), effort()))

    def close(self):
        """Send what waits, for a second at most."""
        self._closing.set()
        self._thread.join(_PATIENCE)

    def _run(self):
        self._start()
        while not self._closing.wait(PERIOD):
            self._send()
        self._send()
        self._stream.flush(timeout_sec=_PATIENCE)

    def _start(self):
        root, reach = self._scene.initial_motion()[:2], 1.3 * self._scene.manipulator.arm.length
        bounds = np.array([root - reach, root + reach])
        log_frame_of_plane(self._stream, bounds)
        log_looks(self._stream, self._path, body_of(self._scene), 0, 1)
        still = self._track([(0, self._scene.initial_motion(), (0.0, 0.0, 0.0))])
        self._stream.log(ABOUT, rr.TextDocument(
            'live: 30 samples a second of wall time, curves too', media_type='text/markdown'),
            static=True)
        for trace in still.traces:
            log_curves(self._stream, trace.panel, self._name, 0, 1, trace.names)
        panels = {trace.panel: Panel(len(trace.names)) for trace in still.traces}
        self._stream.send_blueprint(blueprint(panels, bounds, live=True))

    def _track(self, samples):
        ns, motion, effort = map(np.array, zip(*samples))
        return of_motion(self._name, self._scene, ns, motion, effort, balanced=False)

    def _send(self):
        samples = [self._waiting.popleft() for _ in range(len(self._waiting))]
        if not samples:
            return
        track = self._track(samples)
        poses = track.poses(slice(None))
        tip = poses.line[:, -1]
        missing = max(0, TRAIL - 1 - len(self._trail))
        self._trail = np.concatenate([np.repeat(tip[:1], missing, axis=0), self._trail, tip])
        self._trail = self._trail[-(TRAIL - 1 + len(tip)):]
        self._largest = [max(self._largest[0], np.hypot(*poses.effort[:, :2].T).max()),
                         max(self._largest[1], np.abs(poses.effort[:, 2]).max())]
        send_poses(self._stream, self._path, track.ns, poses, track.body, self._largest,
                   self._trail)
        self._trail = self._trail[1 - TRAIL:]
        for trace in track.traces:
            send_curves(self._stream, trace.panel, self._name, track.ns,
                        trace.values(slice(None)))
