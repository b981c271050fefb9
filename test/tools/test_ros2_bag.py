# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2 run`, `topic` and `bag` with the installed package: push, record, read and play."""

from contextlib import contextmanager, suppress
import os
from pathlib import Path
import re
import signal
import subprocess

import numpy as np
import pytest
from ros_process import Client, PATIENCE
from rosbags.rosbag2 import Reader
import yaml

from timo_sim.log.tables import Recording

TORQUE = '/timo_sim/motor_torque'
PAGE = (Path(__file__).resolve().parents[2] / 'doc/log.md').read_text()


class Ros2:
    """The command `ros2` in a folder."""

    def __init__(self, folder, environment):
        self.folder = folder
        self._options = {'cwd': folder, 'env': environment, 'stdin': subprocess.DEVNULL,
                         'text': True}

    def __call__(self, *command):
        done = subprocess.run(['ros2', *map(str, command)], stdout=subprocess.PIPE,
                              timeout=PATIENCE, **self._options)
        assert done.returncode == 0, done.stdout
        return done.stdout

    @contextmanager
    def running(self, *command):
        process = subprocess.Popen(['ros2', *command], start_new_session=True, **self._options)
        try:
            yield
            os.killpg(process.pid, signal.SIGINT)
            assert process.wait(PATIENCE) in (0, signal.SIGINT)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def state(self, condition):
        """Return the first joint state for which an expression in `m` is true."""
        return next(yaml.safe_load_all(self(
            'topic', 'echo', '--no-daemon', '--once', '--filter', condition, '/joint_states',
            'sensor_msgs/msg/JointState')))


@pytest.fixture(scope='module')
def ros2(ros, installed, tmp_path_factory):
    """Run, push and record a node; return `ros2` in the folder of `run.mcap` and `bag`."""
    ros2, client = Ros2(tmp_path_factory.mktemp('bag'), installed[1]), Client()
    with ros2.running('run', 'timo_sim', 'sim_node', '--ros-args',
                      '-p', 'record_file:=run.mcap'), \
            ros2.running('bag', 'record', '-o', 'bag', '--disable-keyboard-controls',
                         '--include-unpublished-topics', '--topics', TORQUE, '/joint_states'):
        client.wait(lambda: client.count_subscribers('/joint_states'), 'the recorder')
        client.close()
        with ros2.running('topic', 'pub', '-w', '2', '-r', '10', TORQUE, 'std_msgs/msg/Float64',
                          '{data: 2.0}'):
            assert ros2.state('m.velocity[2] > 0.5')['effort'] == [0.0, 0.0, 2.0]
    return ros2


def response(path):
    """Return motions by step, counted from the first command."""
    recording = Recording(path)
    pushed = recording.topics['~/motor_torque'].step[0]
    ns, motion, _ = recording.motion()
    step = np.rint(1e-9 * ns / recording.scene.step).astype(int)
    return dict(zip((step - pushed).tolist(), motion, strict=True))


def test_a_recorded_bag_replays_to_the_recorded_motion(ros2):
    assert {*ros2('pkg', 'executables', 'timo_sim').split()} == {'timo_sim', 'sim_node'}
    with Reader(ros2.folder / 'bag') as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
    assert counts[TORQUE] > 1 and counts['/joint_states'] > 10
    told = ros2('run', 'timo_sim', 'timo_sim', 'info', 'bag')
    found = re.findall(r'^ +(/\S+) +(\d+) ', told, re.MULTILINE)
    assert {topic: int(count) for topic, count in found} == counts
    ros2('run', 'timo_sim', 'timo_sim', 'export', 'bag', '-o', 'bag.csv')
    table = np.genfromtxt(ros2.folder / 'bag.csv', delimiter=',', names=True)
    assert len(table) == counts['/joint_states'] and table['shaft_velocity_rad_per_s'][-1] > 0.5
    (ros2.folder / 'scene.yaml').write_text(
        'timo_sim: {ros__parameters: {rate.joint_states: 1000.0, rate.modal_state: 1000.0}}')
    ros2('run', 'timo_sim', 'timo_sim', 'replay', 'bag', '--scene', 'scene.yaml', '--duration',
         f'{table["time_s"][-1]:.3f}', '-o', 'again.mcap')
    live, again = response(ros2.folder / 'run.mcap'), response(ros2.folder / 'again.mcap')
    both = [step for step in live.keys() & again.keys() if step > 0]
    # Without other loads the motion depends only on the time since the push.
    assert len(both) > 10 and all(np.array_equal(live[step], again[step]) for step in both)


def test_a_log_is_a_bag_that_moves_a_live_node(ros2):
    count = len(Recording(ros2.folder / 'run.mcap').topics['joint_states'].step)
    play, = re.findall(r'^ros2 (bag play run\.mcap .*)', PAGE, re.MULTILINE)
    export, = re.findall(r'^(timo_sim export run\.mcap -o \S+ --bag)', PAGE, re.MULTILINE)
    ros2('run', 'timo_sim', *export.split())
    for path in 'run.mcap', 'my_bag':
        assert re.search(rf'Topic: /joint_states .*Count: {count} ', ros2('bag', 'info', path))
    ros2('bag', 'play', 'my_bag', '-r', 100, '--disable-keyboard-controls')
    with ros2.running('run', 'timo_sim', 'sim_node', '--ros-args', '-p', 'record:=false'):
        assert ros2.state('True')['velocity'] == [0.0, 0.0, 0.0]
        ros2(*play.split(), '--disable-keyboard-controls')
        assert ros2.state('m.velocity[2] > 0.5')['effort'] == [0.0, 0.0, 2.0]
