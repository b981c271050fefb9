# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sends samples of a running simulation to a process that streams them to a viewer."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec
import json
import os
import re
import socket
import subprocess
import sys

import numpy as np

from timo_sim.scene.parameters import ParameterError, short
from timo_sim.scene.scene import Scene
from timo_sim.simulation.simulator import Simulator

_PERIOD = 1.0 / 30.0  # [s] of wall time between samples
_ENDING = 2.0        # [s] for the process to send its last samples
_PORT = 9876         # rerun's, for an address without one
_CONNECTING = 0.5    # [s] for a viewer to answer
_ADDRESS = re.compile(r'rerun(\+https?)?://(\S+?)(:(\d+))?/proxy')


class Feed:
    """
    Sends samples to a process of `view.rerun`, and never waits for it.

    Samples for which its pipe has no room, because the viewer is slow or stuck, are dropped. `url`
    is that of a viewer, which may come and go, `name` the node's. `warning` is a warning if no
    viewer listened at the start. Raises ParameterError if `url` is no address of a viewer, or
    rerun is not installed.
    """

    def __init__(self, scene: Scene, url: str, name: str) -> None:
        address = _ADDRESS.fullmatch(url)
        if not address:
            raise ParameterError('rerun_live must be the address of a viewer of rerun, got '
                                 f'{short(url)}: it has the form rerun+http://HOST:PORT/proxy')
        if find_spec('rerun') is None:
            raise ParameterError('rerun_live needs rerun, which is not installed: '
                                 'pip install timo_sim[view]')
        self.warning: str | None = None
        try:
            socket.create_connection((address[2], int(address[4] or _PORT)), _CONNECTING).close()
        except (OSError, OverflowError) as error:  # OverflowError: the port is too large
            self.warning = f'rerun_live: no viewer listens at {url} yet: {error}'
        # In a session of its own, so that Ctrl+C ends only the node, which then ends this. It
        # imports from where this process does, and not from the working directory.
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, '-P', '-m', 'timo_sim.view.rerun', url, name],
            stdin=subprocess.PIPE, start_new_session=True, env={**os.environ, 'PYTHONPATH': path})
        assert self._process.stdin is not None
        self._stream = self._process.stdin
        with suppress(BrokenPipeError):
            os.write(self._stream.fileno(), json.dumps(dict(scene.values)).encode() + b'\n')
        os.set_blocking(self._stream.fileno(), False)
        self._due = 0.0

    def send(self, now: float, simulator: Simulator,
             effort: Callable[[], Sequence[float]]) -> None:
        """Send a sample if one is due at the wall time `now` [s]; return at once."""
        if now < self._due:
            return
        self._due = now + _PERIOD
        # A pipe takes so few bytes, below PIPE_BUF, as a whole or not at all.
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._stream.fileno(), np.concatenate(
                [[simulator.nanoseconds], simulator.motion.values, effort()]).tobytes())

    def close(self) -> None:
        """End the stream; the process has two seconds to send its last samples."""
        self._stream.close()
        try:
            self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
