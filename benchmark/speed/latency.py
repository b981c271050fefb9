# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures the latency of commands and the speed of lock step: `make benchmark-latency`, two minutes.

A client sends torques to a node at 1 kHz, at random times, and waits for the first message of
joint_states with that effort; in turns it sends them to an echo, a node that answers at once. Then
a controller answers each state of a node with `sync: wait` as fast as it can; in turns, it answers
a node without simulation that only sends the next state. All are Python processes of their own
and share a clock.
"""

from contextlib import ExitStack
from importlib.metadata import version
import os
from pathlib import Path
import random
import re
import statistics
import tempfile
import time

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from benchmark.process import ENVIRONMENT, running, wait
from benchmark.report import measured_on, parser, table
from benchmark.speed.node import spread, started
from benchmark.speed.node_processes import EXECUTORS
from oracles.domains import own_domain

APART = 0.003, 0.006    # [s] between samples, drawn at random
BASE = ('--ros-args', '-p', 'record:=false', '-p', 'rate.joint_states:=1000.0')
WAITS = (*BASE, '-p', 'sync:=wait', '-p', 'sync_period:=0.001', '-p', 'real_time_factor:=0.0')


class Client(Node):
    """Measures latencies; the main thread reads the states and does nothing else."""

    def __init__(self):
        super().__init__('client')
        self._executor = EventsExecutor()
        self._commands, self._sent, self._seen = {}, 0.0, {}
        for name, commands, states in (('node', '/timo_sim/motor_torque', '/joint_states'),
                                       ('echo', '/echo/motor_torque', '/echo/joint_states')):
            self._commands[name] = self.create_publisher(Float64, commands, 10)
            self.create_subscription(
                JointState, states, lambda state, name=name: self._receive(name, state), 10)
        self._executor.add_node(self)

    def _receive(self, name, state):
        if state.effort[2] == self._sent:
            self._seen.setdefault(name, (time.monotonic(), state))

    def _spin(self, until, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self._executor.spin_once(timeout_sec=max(0.0, end - time.monotonic()))
        return until()

    def sample(self, name):
        """
        Send a torque; return when [s], when the first state that shows it came [s], and it.

        Return None if no state shows it within two seconds.
        """
        self._spin(lambda: False, random.uniform(*APART))
        self._sent += 1e-6
        self._seen.clear()
        before = time.monotonic()
        self._commands[name].publish(Float64(data=self._sent))
        if not self._spin(lambda: name in self._seen, 2.0):
            return None
        return before, *self._seen[name]


def samples(count):
    """Return times [s]: rows (all, until tick, tick, back), and of the echo (all, out, back)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'ticks.npy'
        with ExitStack() as stack:
            node = stack.enter_context(started('node', path, *BASE, cwd=folder))
            echo = stack.enter_context(started('echo', 'EventsExecutor'))
            client = Client()
            for name, process in ('node', node), ('echo', echo):
                wait(lambda name=name: client.sample(name), process)
            pairs = [(client.sample('node'), client.sample('echo')) for _ in range(count)]
            node.terminate()
            node.finish()
        ticks = np.load(path)
    last = np.cumsum(ticks[:, 2])
    ours, theirs = [], []
    for (sent, came, state), (sent_echo, came_echo, echo) in pairs:
        step = round(1e3 * (state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec))
        begin, end, _ = ticks[np.searchsorted(last, step)]
        ours.append((came - sent, begin - sent, end - begin, came - end))
        theirs.append((came_echo - sent_echo, echo.position[0] - sent_echo,
                       came_echo - echo.position[0]))
    return np.array(ours), np.array(theirs)


def latency(count):
    """Return the table of the latencies."""
    rclpy.init()
    ours, theirs = samples(count)
    rclpy.shutdown()
    return table(['latency, p50 / p99 / max', 'us'], zip((
        'torque sent to the first state that shows it', '- until a tick takes it',
        '- the tick, with its step and messages', '- until the client has the state',
        'echo: torque sent to its state', '- out', '- back'), map(spread, (*ours.T, *theirs.T))))


def periods(server, domain, executor):
    """Return how many answers a second a controller gave to a server."""
    environment = {**ENVIRONMENT, 'ROS_DOMAIN_ID': str(domain)}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        if server == 'node':
            serving = running(['-m', 'timo_sim.cli.sim_node', *WAITS], env=environment, cwd=folder)
        else:
            serving = started('server', executor, environment=environment)
        served = stack.enter_context(serving)
        controller = stack.enter_context(started('controller', executor, environment=environment))
        return float(wait(lambda: re.search(r'^rate (.*)\n', controller.said(), re.MULTILINE),
                          controller, served)[1])


def lock_step(turns):
    """Return the table of lock step."""
    domains, found = {'node': own_domain(), 'server': own_domain()}, []
    for executor in EXECUTORS:
        rates = [[periods(server, domain, executor) for server, domain in domains.items()]
                 for _ in range(turns)]
        ours, bare = (statistics.median(column) for column in zip(*rates))
        ratio = statistics.median(one / other for one, other in rates)
        found.append((executor, f'{ours:.0f}', f'{bare:.0f}', f'{ratio:.2f}'))
    return table(['controller', 'node, `sync: wait`', 'without simulation', 'ratio'], found)


def main():
    """Measure and print Markdown tables."""
    quick = parser(__spec__, __doc__, 'a few samples').parse_args().quick
    os.environ.update(ENVIRONMENT)
    print(measured_on(rclpy=version('rclpy'), rmw=rclpy.get_rmw_implementation_identifier()))
    print('\n' + latency(200 if quick else 2000), flush=True)
    print('\nPeriods of lock step a second:\n\n' + lock_step(1 if quick else 5))


if __name__ == '__main__':
    main()
