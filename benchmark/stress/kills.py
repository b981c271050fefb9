# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nodes killed at random moments: how much of what was published is in their logs."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from mcap.reader import make_reader

from benchmark import ROOT
from benchmark.process import arguments, ENVIRONMENT
from benchmark.stress.tally import ensure, Tally
from oracles.logs import decoded
import timo_sim
from timo_sim.log.read import LogError, recover

NODES = 4              # that live at the same time
LIFE = 3.0             # [s] of a node, at most, from its first message; of some, from their start
PATIENCE = 60.0        # [s] until a node is heard
MOST_LOST = 1.0        # [s] of sim time that a killed node may cost
# Shared memory would stay behind when a node is killed.
ON_THE_WIRE = {**ENVIRONMENT, 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}


@contextmanager
def _listening():
    """Yield listen(namespace), which returns a function: the latest sim time heard there [s]."""
    os.environ.update(ON_THE_WIRE)
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import JointState
    rclpy.init()
    node, executor = rclpy.create_node('listener'), SingleThreadedExecutor()
    executor.add_node(node)
    heard = {}

    def listen(name):
        def hear(state):
            heard[name] = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        node.create_subscription(JointState, f'/{name}/joint_states', hear, 100)
        return lambda: heard.get(name)

    with ThreadPoolExecutor(1) as thread:
        spinning = thread.submit(executor.spin)
        yield listen
        executor.shutdown()
        spinning.result()
    node.destroy_node()
    rclpy.try_shutdown()


def kills(count, generator):
    """Kill nodes: every fifth maybe before its first message, the others after it."""
    tally, lost, early = Tally('`kill -9` of the node at a random moment'), [0.0], 0
    moments = [generator.uniform(0.0, LIFE) for _ in range(count)]
    timo_sim.simulate(timo_sim.load_scene(ROOT / 'config' / 'paper.yaml'), 0.1)  # compiles

    def kill(number):
        name = f'n{number}'
        path, heard = Path(folder) / f'{name}.mcap', listen(name)
        command = [sys.executable, '-m', 'timo_sim.cli.sim_node', *arguments(
            rate=100.0, record=True, record_file=str(path)), '-r', f'__ns:=/{name}']
        with subprocess.Popen(command, env=ON_THE_WIRE, cwd=folder, stdout=subprocess.DEVNULL,
                              stderr=subprocess.DEVNULL) as process:
            end = time.monotonic() + PATIENCE
            while number % 5 and heard() is None and time.monotonic() < end:
                time.sleep(0.01)
            time.sleep(moments[number])
            process.kill()
        time.sleep(0.2)  # for messages under way
        return number, path, heard()

    with tempfile.TemporaryDirectory() as folder, _listening() as listen:
        with ThreadPoolExecutor(NODES) as pool:
            for number, path, heard in pool.map(kill, range(count)):
                with tally.trial(f'after {moments[number]:.3f} s'):
                    latest = _latest(path)
                    early += latest is None
                    if heard is not None:
                        ensure(latest is not None, f'heard until {heard} s, no log')
                        lost.append(heard - latest)
                        ensure(lost[-1] < MOST_LOST, f'{lost[-1]:.3f} s were lost')
    return tally.row(f'at most {max(lost):.2f} s lost; {early} before there was a log')


def _latest(path):
    """Recover a log; return its last time [s], or None if there is nothing."""
    if not path.exists():
        return None
    try:
        recover(path)
    except LogError as error:
        ensure('empty' in str(error) or 'nothing in it' in str(error), str(error))
        return None
    new = path.with_stem(path.stem + '_recovered')
    decoded(new)
    with open(new, 'rb') as stream:
        return 1e-9 * make_reader(stream).get_summary().statistics.message_end_time
