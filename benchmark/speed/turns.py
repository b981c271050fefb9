# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Processes that are measured in turns, stopped in between: the peers of a node, and the node."""

from contextlib import ExitStack
from pathlib import Path
import signal
import subprocess
import tempfile
import time

import numpy as np

from benchmark.process import ENVIRONMENT, running
from oracles.domains import own_domain

START_UP, SETTLE = 4.0, 0.5   # [s]


def processor_time(pid):
    """Return the CPU time of all threads of a process [s]."""
    return 1e-9 * sum(int(path.read_text().split()[0])
                      for path in Path(f'/proc/{pid}/task').glob('*/schedstat'))


class Peer:
    """
    A process that is measured in turns, stopped in between; and its listener, if any.

    Attributes
    ----------
    cpu : ndarray
        CPU time for each step, in each turn [s]; known after `end`.
    ticks : list of ndarray, shape (n, 3)
        Begin and end of the ticks of each turn [s], and their steps; known after `end`.

    """

    def __init__(self, name, folder, domain, listened=True, extra=()):
        environment = {**ENVIRONMENT, 'ROS_DOMAIN_ID': str(domain)}
        self._path = Path(folder) / f'{domain}.npy'
        self._turns, self.cpu, self.ticks = [], None, []
        self._stack = ExitStack()
        with ExitStack() as stack:
            if listened:
                listener = stack.enter_context(
                    started('listener', '-', environment, stdout=subprocess.PIPE))
                _expect(listener, 'listening')
            self._process = stack.enter_context(
                started(name, self._path, environment, *extra, cwd=folder))
            if listened:
                _expect(listener, 'hearing')
            else:
                time.sleep(START_UP)
            self._stack = stack.pop_all()
        self._process.send_signal(signal.SIGSTOP)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._stack.close()

    def turn(self, seconds):
        """Let the process run, and measure."""
        self._process.send_signal(signal.SIGCONT)
        time.sleep(SETTLE)
        begin, before = time.monotonic(), processor_time(self._process.pid)
        time.sleep(seconds)
        end, after = time.monotonic(), processor_time(self._process.pid)
        self._process.send_signal(signal.SIGSTOP)
        self._turns.append((begin, end, after - before))

    def end(self):
        """End the process and read when its ticks were."""
        self._process.send_signal(signal.SIGCONT)
        self._process.terminate()
        if self._process.wait() != 0:
            raise RuntimeError('a peer failed')
        times = np.load(self._path)
        self.ticks = [times[(times[:, 0] > begin) & (times[:, 1] < end)]
                      for begin, end, _ in self._turns]
        self.cpu = np.array([cpu / ticks[:, 2].sum()
                             for (_, _, cpu), ticks in zip(self._turns, self.ticks)])


def _expect(process, word):
    lines = []
    for line in process.stdout:  # the middleware may print lines, too
        lines.append(line.strip())
        if lines[-1] == word:
            return
    raise RuntimeError('\n'.join(lines))


def started(name, path, environment, *extra, **options):
    """Start one of `node_processes`, and end it after the context."""
    options = {'stdout': subprocess.DEVNULL, 'stderr': subprocess.STDOUT, **options}
    return running(['-m', 'benchmark.speed.node_processes', name, str(path), *extra],
                   env=environment, **options)


def compare(turns, seconds, **peers):
    """Run peers, each the arguments of a `Peer`, in turns; return them by name."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        running = {name: stack.enter_context(Peer(kind, folder, own_domain(), listened, extra))
                   for name, (kind, listened, extra) in peers.items()}
        order = list(running.values())
        for _ in range(turns):
            for peer in order:
                peer.turn(seconds)
            order.append(order.pop(0))
        for peer in order:
            peer.end()
    return running
