# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures the arm inside ros2_control's controller manager, where ROS has it and timo_sim_hardware.

A stock controller manager runs a PID controller of the shaft at 500 Hz under the paper's loads, on
sim time, as fast as possible: `--runs` times while as many busy processes as twice the cores run,
and three times without. Runs must have the same commands and states to the last bit, which must be
those of a `Simulator` under these commands, by `timo_sim replay`; else it ends with an error.
"""

from contextlib import contextmanager
import hashlib
import os
from pathlib import Path
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import numpy as np
from pal_statistics_msgs.msg import StatisticsNames, StatisticsValues
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
import yaml

from benchmark import ROOT
from benchmark.process import ENVIRONMENT
from benchmark.report import make_page, targets
from timo_sim.log.read import recover
from timo_sim.log.tables import Recording
from timo_sim.runs.replay import replay
from timo_sim.scene.files import read_sections, scene_file

CONTROLLERS = ROOT / 'hardware/config/controllers.yaml'
STATISTICS = '/controller_manager/statistics'


def program(name):
    """Return the path of a program of the controller manager."""
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        if (path := Path(prefix, 'lib/controller_manager', name)).exists():
            return str(path)
    raise FileNotFoundError(f'controller_manager has no {name} in AMENT_PREFIX_PATH')


@contextmanager
def started(*command, **options):
    """Start a process, and interrupt it at the end."""
    process = subprocess.Popen(command, env=ENVIRONMENT, **options)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Watch:
    """Gives the robot description, and collects the times of read() and write() [us]."""

    def __init__(self, node, urdf):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node, self._places, self.times = node, {}, []
        self._entities = [node.create_publisher(String, '/robot_description', latched)]
        self._entities[0].publish(String(data=urdf))
        node.create_subscription(StatisticsNames, f'{STATISTICS}/names', self._name, latched)
        # A reliable reader that is too slow would end the manager: its publisher throws.
        node.create_subscription(StatisticsValues, f'{STATISTICS}/values', self._take, QoSProfile(
            depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))

    def _name(self, message):
        names = [*message.names]
        wanted = [f'controller_manager.{kind}_time' for kind in ('read', 'write')]
        if {*wanted} <= {*names}:  # at the start not all are registered
            self._places[message.names_version] = [names.index(name) for name in wanted]

    def _take(self, message):
        if message.names_version in self._places:
            self.times.append(sum(message.values[place]
                                  for place in self._places[message.names_version]))


def write_scene(folder):
    """Write the paper's scene with a log, as fast as possible; return its URDF."""
    scene = {'/**': {'ros__parameters': {
        **read_sections(scene_file('paper'))['/**'], 'real_time_factor': 0.0,
        'record_file': str(folder / 'run.mcap')}}}
    (folder / 'scene.yaml').write_text(yaml.safe_dump(scene))
    return subprocess.run(
        [sys.executable, '-m', 'timo_sim', 'urdf', folder / 'scene.yaml', '--ros2-control',
         folder / 'scene.so'], env=ENVIRONMENT, check=True, text=True,
        stdout=subprocess.PIPE).stdout


def processor_time(pid):
    """Return the processor time of the busiest thread of a process, here the control loop [s]."""
    spent = [(each / 'stat').read_text().rpartition(')')[2].split()
             for each in Path(f'/proc/{pid}/task').iterdir()]
    return max(int(each[11]) + int(each[12]) for each in spent) / os.sysconf('SC_CLK_TCK')


def run(urdf, folder, duration):
    """
    Do a run of some sim time [s].

    Returns its log, sim time by wall time and by the loop's processor time, and the times of
    read() and write() of cycles [us].
    """
    log, said = folder / 'run.mcap', folder / 'said.txt'
    log.unlink(missing_ok=True)
    node = rclpy.create_node('watch')
    watch, begun = Watch(node, urdf), (0.0, 0.0)
    # The manager is started last, and so ends first.
    with said.open('w') as out, \
            started(program('spawner'), 'joint_state_broadcaster', 'pid_controller',
                    '--param-file', CONTROLLERS, '--switch-timeout', '300',
                    '--service-call-timeout', '300', stdout=out, stderr=out), \
            started(program('ros2_control_node'), '--ros-args', '--params-file', CONTROLLERS,
                    '-p', 'use_sim_time:=true', stdout=out, stderr=out) as manager:
        while True:
            now = time.monotonic(), processor_time(manager.pid)  # before the look at the log
            reached = sim_time(log)
            if reached >= duration:
                break
            if manager.poll() is not None:
                raise RuntimeError(said.read_text())
            for _ in range(20):
                rclpy.spin_once(node, timeout_sec=0.001)
            begun = begun if reached else now
        factors = reached / (time.monotonic() - begun[0]), reached / (
            processor_time(manager.pid) - begun[1])
    node.destroy_node()
    for old in folder.glob('run_recovered*'):
        old.unlink()
    recover(log)
    return folder / 'run_recovered.mcap', factors, watch.times


def sim_time(log):
    """Return the sim time that a growing log has reached [s], 0 before its first message."""
    if not log.exists():
        return 0.0
    with log.open('rb') as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
        end = file.read()
    # The stamp of joint_states is before its frame and the name of its first joint.
    place = end.rfind(b'carrier_x\0')
    if place < 20:
        return 0.0
    sec, nanosec = np.frombuffer(end, '<u4', 2, place - 24)
    return sec + 1e-9 * nanosec


def digest(log, duration):
    """Return a hash of the commands and states of a log until some sim time [s], and counts."""
    topics, found, counts = Recording(log).topics, hashlib.sha256(), []
    for name in '~/joint_command', 'joint_states', '~/modal_state', '~/tip_deflection':
        series = topics[name]
        inside = series.ns <= round(1e9 * duration)
        found.update(series.step[inside].tobytes() + series.values[inside].tobytes())
        counts.append(int(inside.sum()))
    return found.hexdigest()[:12], counts


def rows(quick, runs=20, duration=60.0):
    """Return the rows of the table."""
    if quick:
        runs, duration = 2, 20.0
    os.environ.update(ENVIRONMENT)  # the same domain
    rclpy.init()
    hashes, factors, times, calm = {}, [], [], []
    with TemporaryDirectory() as name:
        folder = Path(name)
        urdf = write_scene(folder)
        for number in range(3 + runs):
            busy = [subprocess.Popen([sys.executable, '-c', 'while True: pass'])
                    for _ in range(2 * os.cpu_count() if number >= 3 else 0)]
            try:
                log, factor, cycles = run(urdf, folder, duration)
            finally:
                for each in busy:
                    each.kill()
                    each.wait()
            found, counts = digest(log, duration)
            hashes.setdefault(found, []).append(number)
            (factors if number >= 3 else calm).append(factor)
            if number < 3:
                times += cycles
            print(f'run {number}: {found}, {counts} messages, {factor[0]:.0f} times real time, '
                  f'{factor[1]:.0f} by processor time, {len(cycles)} cycles', flush=True)
        told = []
        same = replay(log, show=told.append)
    rclpy.try_shutdown()
    if len(hashes) > 1 or not same:
        raise SystemExit(f'other bits: {hashes}, {told}')
    fast, loop = np.median(calm, axis=0)
    middle, most = np.percentile(times, [50, 99])
    return [
        (f'{runs} runs of {duration:g} s under stress and 3 without: hashes of commands and '
         'states', '1', len(hashes), True, f'{counts[0]} commands, {counts[1]} states'),
        ('a `Simulator` under these commands', 'same bits', 'same', True, told[1]),
        ('sim time by wall time, with a log', 50, f'{fast:.0f}', bool(fast >= 50),
         f'{loop:.0f} by processor time of the loop; under stress '
         f'{min(factors)[0]:.0f} to {max(factors)[0]:.0f}'),
        ('p99 of `read()` + `write()` of the manager', '20 us', f'{most:.1f} us', most < 20.0,
         f'p50 {middle:.1f} us, {len(times)} cycles')]


if __name__ == '__main__':
    make_page(__spec__, __doc__, 'speed.md',
              {'Inside the controller manager': lambda quick: targets(rows(quick))}, 'a minute')
