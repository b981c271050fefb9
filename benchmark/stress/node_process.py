# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node under attack, in a process and a folder of its own, and whether it survived."""

from pathlib import Path
import re
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message

from benchmark.process import ENVIRONMENT, LONGEST, options, Process, resident, wait

PROGRAM = '-m', 'timo_sim.cli.sim_node'
# A node that keeps something of each command.
LEAKY = '-c', """
from timo_sim.cli.sim_node import main
from timo_sim.ros.topics import Inlet
kept, receive = [], Inlet.receive
def keep(inlet, data, answered):
    kept.append(bytearray(b'x') * 10000)
    return receive(inlet, data, answered)
Inlet.receive = keep
main()
"""
WINDOW = 4.0     # [s] of which the lowest memory counts: that of messages under way varies
WINDOWS = 3      # in a row, in each of which memory grows by more than `LEAK`, mean a leak
LEAK = 1e6       # [B]
MOST_WINDOWS = 10  # that are looked at; the middleware's pools grow more slowly after four or five


class Node:
    """A node in a process and a folder of its own."""

    def __init__(self, folder, *arguments, environment=ENVIRONMENT, program=PROGRAM,
                 **parameters):
        self.folder, self.log = Path(folder), Path(folder) / 'run.mcap'
        self.process = Process(
            [*program, '--ros-args', *arguments,
             *options(record_file=self.log.name, **parameters)], cwd=folder, env=environment)
        self.output = self.process.said

    def ready(self, words='logging to'):
        """Wait until the node prints `words`, by default that it logs, or until it has ended."""
        wait(lambda: words in self.output() or self.process.poll() is not None, self.process)
        return self

    def leak(self, seconds):
        """
        Watch the memory for some seconds or more; return whether it leaks, and the growth as text.

        Pools of memory stop growing when they are full; a leak does not, however long one looks.
        """
        lows, window = [], max(WINDOW, seconds / (WINDOWS + 2))
        while len(lows) * window < seconds or len(lows) <= WINDOWS or (
                growth(lows) > LEAK and len(lows) < MOST_WINDOWS):
            end, lows = time.monotonic() + window, [*lows, resident(self.process.pid)]
            while time.monotonic() < end:
                time.sleep(0.05)
                lows[-1] = min(lows[-1], resident(self.process.pid))
        return growth(lows) > LEAK, f'{growth(lows) / 1e6:+.1f} MB in {window:.0f} s'

    def handles_signals(self):
        """Return whether the process has its handlers, or has ended."""
        status = Path(f'/proc/{self.process.pid}/status').read_text()
        caught = re.search(r'SigCgt:\s*(\w+)', status)[1]
        return bool(int(caught, 16) >> signal.SIGTERM - 1 & 1) or self.process.poll() is not None

    def end(self, number=signal.SIGTERM):
        """End the node; return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(LONGEST)
        finally:
            if self.process.poll() is None:
                self.process.kill()
                self.process.wait()

    def health(self):
        """Return the counters of the last diagnostics in the log, and the messages' count."""
        with open(self.log, 'rb') as stream:
            counters, count = {}, 0
            for _, channel, message in make_reader(stream).iter_messages():
                count += 1
                if channel.topic.endswith('/diagnostics'):
                    status = deserialize_message(message.data, DiagnosticArray).status[0]
                    counters = {pair.key: pair.value for pair in status.values}
        return counters, count


def growth(lows):
    """Return the least growth from window to window at the end, given each one's least memory."""
    last = lows[-1 - WINDOWS:]
    return min(after - before for before, after in zip(last, last[1:]))


def survived(node, number=signal.SIGTERM):
    """End a node that should be alive; return whether all is well, and its counters."""
    alive = node.process.poll() is None
    well = node.end(number) == 0 and alive and 'Traceback' not in node.output()
    counters, count = node.health()
    return well and count > 0, counters
