# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Fixtures: a real node in its own process and a real client, over DDS."""

from contextlib import contextmanager
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading
import time

import pytest
from rcl_interfaces.srv import GetParameterTypes
import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from forked_node import ForkedNode
from timo_sim.runs.replay import replay

# [s] A longer wait is a hang. No test takes that long, also on a machine with ten times the load.
PATIENCE = 300.0
_TRIES = 15  # clients of a service that are made in this time until one is answered


def nanoseconds(message):
    """Return the sim time of a message, also of one of /clock [ns]."""
    stamp = message.header.stamp if hasattr(message, 'header') else message.clock
    return 10**9 * stamp.sec + stamp.nanosec


def facts(health):
    """Return the newest of the collected diagnostics as a dictionary, empty if there are none."""
    return {pair.key: pair.value for message in health[-1:] for pair in message.status[0].values}


def replayed(log, changes=None, **options):
    """Replay a log, check that all bits are the same, and return the lines of the report."""
    lines = []
    assert replay(log, changes, show=lines.append, **options), lines
    assert changes or any('same to the last bit' in line for line in lines), lines
    return lines


class Client(Node):
    """A client node: collects messages, calls services, waits for conditions."""

    def __init__(self):
        super().__init__('client')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self):
        while self.context.ok():
            try:
                return self._executor.spin()
            except InvalidHandle:  # of what a test has destroyed meanwhile
                pass

    def close(self):
        self._executor.shutdown()
        self._thread.join()
        self.destroy_node()

    def collect(self, message_type, topic):
        """Return a list to which the messages of a topic are appended."""
        messages = []
        self.create_subscription(message_type, topic, messages.append, 1000)
        self.wait(lambda: self.count_publishers(topic) > 0, f'a publisher of {topic}')
        return messages

    def command(self, message_type, topic):
        """Return a publisher of commands, each of which reaches the node under test."""
        publisher = self.create_publisher(message_type, topic, 10)
        self.wait(lambda: publisher.get_subscription_count() > 0, f'a subscriber of {topic}')
        self.wait_until_known_to(topic.rpartition('/')[0])
        return publisher

    def service(self, service_type, name):
        """Return a function that calls a service of the node under test and returns the answer."""
        for tries in range(_TRIES):
            client = self.create_client(service_type, name)
            assert client.wait_for_service(PATIENCE), f'no service {name}'
            try:
                self.wait_until_known_to(name.rpartition('/')[0], PATIENCE / _TRIES)
                break
            except AssertionError:  # in a storm the middleware may lose a reader for good
                if tries == _TRIES - 1:
                    raise
                self.destroy_client(client)
        return lambda **fields: self.answer(
            lambda: client.call_async(service_type.Request(**fields)), name)

    def wait_until_known_to(self, node, patience=PATIENCE):
        """
        Wait until a node knows all that this process has made: clients, publishers, subscribers.

        The middleware drops messages of a writer that the reader's process has not discovered,
        and answers to a reader that the server has not. A question that changes nothing is
        repeated until it is answered. A node discovers writers and readers of another process in
        the order in which they were made, so that it then knows the earlier ones, too.
        """
        client = self.create_client(GetParameterTypes, f'{node}/get_parameter_types')
        assert client.wait_for_service(PATIENCE), f'no service {client.srv_name}'
        self.answer(lambda: client.call_async(GetParameterTypes.Request()), client.srv_name, 0.5,
                    patience)

    @staticmethod
    def answer(call, what, repeat_after=PATIENCE, patience=PATIENCE):
        """Return what a service answers: `call` asks it, each `repeat_after` s, for a future."""
        done, end = threading.Event(), time.monotonic() + patience
        while time.monotonic() < end:
            future = call()
            future.add_done_callback(lambda _: done.set())
            if done.wait(repeat_after):
                return future.result()
        raise AssertionError(f'{what} does not answer')

    @staticmethod
    def wait(condition, what):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f'waited in vain for {what}'
            time.sleep(0.002)


@pytest.fixture(scope='session')
def ros():
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def client(ros):
    node = Client()
    yield node
    node.close()


class Process:
    """
    A `sim_node` in a process of its own, its log in a folder of its own.

    It is forked from a process that has imported its modules, or, if `fresh`, starts as those of
    users do.
    """

    def __init__(self, folder, *arguments, record=True, fresh=False, preexec_fn=None,
                 **parameters):
        values = {'record': record, 'record_file': str(Path(folder) / 'run.mcap'), **parameters}
        self.log = Path(folder) / values['record_file']
        arguments = ['--ros-args', *arguments]
        for name, value in values.items():
            shown = str(value).lower() if isinstance(value, bool) else value
            arguments += ['-p', f'{name}:={shown}']
        if not fresh and preexec_fn is None:
            self._process = ForkedNode(arguments, folder)
            return
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'timo_sim.cli.sim_node', *arguments], cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, preexec_fn=preexec_fn)

    def send(self, number):
        self._process.send_signal(number)

    def runs(self):
        return self._process.poll() is None

    def _status(self, name):
        status = Path(f'/proc/{self._process.pid}/status').read_text()
        return re.search(rf'{name}:\s*(\w+)', status)[1]

    def output(self):
        """Return what a forked node has printed so far."""
        return self._process.output()

    def memory(self):
        """Return the memory that the process has in use [B]."""
        return 1024 * int(self._status('VmRSS'))

    def wait_for_handlers(self):
        """Wait until the process has a handler of its own for SIGTERM; SIGINT's comes first."""
        end = time.monotonic() + PATIENCE
        while True:
            if int(self._status('SigCgt'), 16) >> signal.SIGTERM - 1 & 1:
                return
            assert time.monotonic() < end, 'no handler for SIGTERM'
            time.sleep(0.002)

    def end(self, number=signal.SIGINT):
        self._process.send_signal(number)
        return self.wait()

    def wait(self):
        """Wait for the end; return exit code and output."""
        output, _ = self._process.communicate(timeout=PATIENCE)
        return self._process.returncode, output

    def kill(self):
        if self.runs():
            self._process.send_signal(signal.SIGINT)  # it leaves the graph, unlike when killed
            try:
                output, _ = self._process.communicate(timeout=10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                output, _ = self._process.communicate()
            print(output)  # which pytest shows of a test that fails


@contextmanager
def shared_node(folder, *arguments, **parameters):
    """Start a node that several tests share, and a client; both end with the block."""
    client, node = Client(), Process(folder, *arguments, **parameters)
    try:
        yield node, client
    finally:
        node.kill()
        client.close()


@pytest.fixture
def start(tmp_path):
    """Return a function that starts the node with parameters and tidies up after the test."""
    processes = []

    def start(*arguments, **parameters):
        processes.append(Process(tmp_path, *arguments, **parameters))
        return processes[-1]
    yield start
    for process in processes:
        process.kill()
