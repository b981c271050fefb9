# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Measures the latency of commands and the speed of lock step: `make benchmark-latency`, two minutes.

A client sends torques to a node at 1 kHz, at random times, and waits for the first message of
joint_states with that effort; in turns it sends them to an echo, a node that answers at once. Then
a controller answers each state of a node with `sync: wait` as fast as it can; in turns, it answers
a node without simulation that only sends the next state. All are Python processes of their own
and share a clock.
"""

from contextlib import ExitStack, suppress
from importlib.metadata import version
import os
from pathlib import Path
import random
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from benchmark.command import parser
from benchmark.process import ENVIRONMENT, running
from benchmark.report import machine
from benchmark.speed.node import spread
from benchmark.speed.turns import started
from oracles.domains import own_domain

MODULE = 'benchmark.speed.latency'
EXECUTORS = {'rclpy.spin': SingleThreadedExecutor, 'EventsExecutor': EventsExecutor}
APART = 0.003, 0.006    # [s] between samples, drawn at random
SETTLE = 1.0            # [s]
SHAFT = 2               # its place in joint_states
BASE = ('--ros-args', '-p', 'record:=false', '-p', 'rate.joint_states:=1000.0')
WAITS = (*BASE, '-p', 'sync:=wait', '-p', 'sync_period:=0.001', '-p', 'real_time_factor:=0.0')


class Echo(Node):
    """Answers each torque with a joint state, and says when it came."""

    def __init__(self):
        super().__init__('echo')
        self._publisher = self.create_publisher(JointState, '/echo/joint_states', 10)
        self.create_subscription(Float64, '/echo/motor_torque', self._answer, 10)

    def _answer(self, command):
        self._publisher.publish(JointState(
            position=[time.monotonic(), 0.0, 0.0], effort=[0.0, 0.0, command.data]))


class Server(Node):
    """Sends the next state for each command: a node in lock step without a simulation."""

    def __init__(self):
        super().__init__('timo_sim')
        self._count = 0
        self._publisher = self.create_publisher(JointState, '/joint_states', 10)
        self.create_subscription(JointState, '/timo_sim/joint_command', self._next, 10)
        self.create_timer(0.2, lambda: self._count or self._next(None))

    def _next(self, command):
        self._count += command is not None
        state = JointState(name=['carrier_x', 'carrier_y', 'shaft'], position=3 * [0.0],
                           velocity=3 * [0.0], effort=3 * [0.0])
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(
            1000000 * self._count, 1000000000)
        self._publisher.publish(state)


class Controller(Node):
    """
    Answers each state.

    Attributes
    ----------
    rate : float or None
        Answers per second, known after `seconds` of answers.

    """

    def __init__(self, seconds):
        super().__init__('controller')
        self._publisher = self.create_publisher(JointState, '/timo_sim/joint_command', 10)
        self.create_subscription(JointState, '/joint_states', self._answer, 10)
        self._begin, self._seconds, self._count, self.rate = None, seconds, 0, None

    def _answer(self, state):
        command = JointState(name=['shaft'], effort=[0.1 - 0.1 * state.velocity[SHAFT]])
        command.header.stamp = state.header.stamp
        self._publisher.publish(command)
        now = time.monotonic()
        self._begin = self._begin or now + SETTLE
        self._count += now >= self._begin
        if now >= self._begin + self._seconds:
            self.rate = self._count / (now - self._begin)


class Client(Node):
    """Measures latencies; the main thread reads the states and does nothing else."""

    def __init__(self):
        super().__init__('client')
        self._executor = EventsExecutor()
        self._commands, self._sent, self._seen = {}, 0.0, {}
        for name, space in (('node', '/timo_sim'), ('echo', '/echo')):
            self._commands[name] = self.create_publisher(Float64, f'{space}/motor_torque', 10)
            states = f'{space}/joint_states' if name == 'echo' else '/joint_states'
            self.create_subscription(
                JointState, states, lambda state, name=name: self._receive(name, state), 10)
        self._executor.add_node(self)

    def _receive(self, name, state):
        if state.effort[SHAFT] == self._sent:
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
            node = stack.enter_context(started('node', path, ENVIRONMENT, *BASE, cwd=folder))
            stack.enter_context(running(['-m', MODULE, 'echo'], env=ENVIRONMENT))
            client = Client()
            for name in ('node', 'echo'):
                while client.sample(name) is None:
                    pass
            pairs = [(client.sample('node'), client.sample('echo')) for _ in range(count)]
            node.terminate()
            node.wait()
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
    """Print the table of the latencies."""
    rclpy.init()
    ours, theirs = samples(count)
    rclpy.shutdown()
    print('| latency, p50 / p99 / max | us |\n|---|---|')
    for line, values in zip((
            'torque sent to the first state that shows it', '- until a tick takes it',
            '- the tick, with its step and messages', '- until the client has the state',
            'echo: torque sent to its state', '- out', '- back'), (*ours.T, *theirs.T)):
        print(f'| {line} | {spread(values)} |', flush=True)


def periods(server, domain, executor, seconds):
    """Return how many answers a second a controller gave to a server."""
    environment = {**ENVIRONMENT, 'ROS_DOMAIN_ID': str(domain)}
    with tempfile.TemporaryDirectory() as folder, running(
            ['-m', 'timo_sim.cli.sim_node', *WAITS] if server == 'node'
            else ['-m', MODULE, 'server', executor], env=environment, cwd=folder,
            stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT), running(
            ['-m', MODULE, 'controller', executor, str(seconds)], env=environment,
            stdout=subprocess.PIPE) as controller:
        # The middleware may print lines, too.
        return float(next(line for line in controller.stdout
                          if line.startswith('rate ')).removeprefix('rate '))


def lock_step(turns, seconds):
    """Print the table of lock step."""
    print('\n| lock step, 1/s | node, `sync: wait` | without simulation | ratio |\n'
          '|---|---|---|---|')
    domains = {'node': own_domain(), 'server': own_domain()}
    for executor in EXECUTORS:
        rates = [[periods(server, domain, executor, seconds)
                  for server, domain in domains.items()] for _ in range(turns)]
        ours, bare = (statistics.median(column) for column in zip(*rates))
        ratio = statistics.median(one / other for one, other in rates)
        print(f'| controller with {executor} | {ours:.0f} | {bare:.0f} | {ratio:.2f} |',
              flush=True)


def serve(kind, executor, *arguments):
    """Run one of the nodes until SIGTERM; a controller ends by printing its rate."""
    rclpy.init()
    node = {'echo': Echo, 'server': Server, 'controller': Controller}[kind](*arguments)
    executor = EXECUTORS[executor]()
    executor.add_node(node)
    with suppress(ExternalShutdownException):
        while rclpy.ok() and not (kind == 'controller' and node.rate):
            executor.spin_once(timeout_sec=0.1)
    if kind == 'controller':
        print('rate', node.rate, flush=True)


def main():
    """Measure and print Markdown tables."""
    quick = parser(__spec__, __doc__, 'a few samples').parse_args().quick
    os.environ.update(ENVIRONMENT)
    print('Measured on: ' + ', '.join(f'{name} {value}' for name, value in machine().items())
          + f', rclpy {version("rclpy")}, {rclpy.get_rmw_implementation_identifier()}.\n')
    latency(200 if quick else 2000)
    lock_step(1 if quick else 5, 1.0 if quick else 3.0)


if __name__ == '__main__':
    if len(sys.argv) > 1 and sys.argv[1] in ('echo', 'server', 'controller'):
        serve(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else 'EventsExecutor',
              *map(float, sys.argv[3:]))
    else:
        main()
