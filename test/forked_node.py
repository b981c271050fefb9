# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes that are forked from a process that has imported their modules, which saves time."""

from contextlib import suppress
import multiprocessing
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

from timo_sim.cli import sim_node
from timo_sim.ros import diagnostics

_SERVER = multiprocessing.get_context('forkserver')
_SERVER.set_forkserver_preload([
    'timo_sim.ros.process', 'timo_sim.ros.node', 'timo_sim.cli.sim_node'])


def _run(arguments, folder, environment, output):
    diagnostics._PERIOD = 0.2  # [s] of wall time, since many tests wait for diagnostics
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    descriptor = os.open(output, os.O_WRONLY | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    sys.argv[1:] = arguments
    sys.exit(sim_node.main())


class ForkedNode:
    """A `sim_node` with methods of `subprocess.Popen` for tests."""

    def __init__(self, arguments, folder):
        self._output = tempfile.NamedTemporaryFile()
        self._process = _SERVER.Process(target=_run, args=(
            arguments, folder, dict(os.environ), self._output.name))
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self):
        return self._process.exitcode

    def poll(self):
        return self.returncode

    def send_signal(self, number):
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended since
                os.kill(self.pid, number)

    def kill(self):
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout=None):
        self._process.join(timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired('sim_node', timeout)
        return self.output(), None

    def output(self):
        return Path(self._output.name).read_text()
