# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files, by `ros2 launch`, where it is installed."""

import os
from pathlib import Path
import re
import signal
import subprocess
import time

from mcap_ros2.reader import read_ros2_messages
import pytest
from rcl_interfaces.srv import GetParameters
from rosgraph_msgs.msg import Clock
from ros_process import PATIENCE
import yaml

from timo_sim.log.tables import Recording


class Launch:
    """`ros2 launch timo_sim_bringup` in a separate process."""

    def __init__(self, folder, environment, *arguments):
        self._output = folder / 'output.txt'
        with open(self._output, 'w') as output:
            self.process = subprocess.Popen(
                ['ros2', 'launch', 'timo_sim_bringup', *arguments], cwd=folder, stdout=output,
                stderr=subprocess.STDOUT, env={**environment, 'ROS_LOG_DIR': str(folder)})

    def seen(self, words):
        """Return all matches of a regular expression in the output so far."""
        return re.findall(words, self._output.read_text())

    def wait_for(self, words, count=1):
        end = time.monotonic() + PATIENCE
        while len(self.seen(words)) < count:
            assert time.monotonic() < end, self._output.read_text()
            time.sleep(0.05)
        return self.seen(words)

    def wait(self):
        return self.process.wait(PATIENCE), self._output.read_text()


@pytest.fixture
def launch(installed, tmp_path):
    """Return a function that launches; the process is ended after the test."""
    found = []

    def launch(*arguments, **environment):
        found.append(Launch(tmp_path, {**installed[1], **environment}, *arguments))
        return found[-1]
    yield launch
    for each in found:
        each.process.send_signal(signal.SIGINT)
        each.process.wait(PATIENCE)


def test_arguments_of_the_simulator(launch, client, tmp_path):
    launched = launch('sim.launch.py', 'namespace:=left', 'frame_prefix:=left/', 'respawn:=true',
                      'record_file:=1.mcap')  # a text that begins like a number
    clock = client.collect(Clock, '/clock')
    client.wait(lambda: clock, 'the clock')
    get = client.service(GetParameters, '/left/timo_sim/get_parameters')
    names = ['publish_clock', 'publish_tf', 'frame_prefix', 'record_file',
             'load.force_x.harmonic.amplitude']
    clocked, framed, prefix, path, force = get(names=names).values
    assert clocked.bool_value and not framed.bool_value and prefix.string_value == 'left/'
    assert path.string_value == '1.mcap' and [*force.double_array_value] == [5.0]  # the paper's
    pid, = launched.seen(r'sim_node-1\]: process started with pid \[(\d+)\]')
    assert (tmp_path / '1.mcap').exists()
    os.kill(int(pid), signal.SIGKILL)
    launched.wait_for('ready for commands', 2)
    assert (tmp_path / '1_1.mcap').exists()
    launched.process.send_signal(signal.SIGINT)
    assert launched.wait()[0] == 0


def test_arguments_that_are_not_given_leave_the_file_as_it_is(launch, tmp_path):
    (tmp_path / 'my scene.yaml').write_text(yaml.safe_dump({'/**': {'ros__parameters': {
        'duration': 0.1, 'record_file': 'its.mcap', 'frame_prefix': 'its/',
        'publish_tf': True, 'publish_clock': True}}}))
    code, output = launch('sim.launch.py', 'params_file:=my scene.yaml', 'clock:=False',
                          'tf:=false', 'respawn:=False').wait()
    assert code == 0, output
    values = Recording(tmp_path / 'its.mcap').parameters
    assert [values[name] for name in ('publish_clock', 'publish_tf', 'frame_prefix')] == [
        False, False, 'its/']
    assert {message.ros_msg.header.frame_id for message in read_ros2_messages(
        str(tmp_path / 'its.mcap'), topics=['/timo_sim/tip_deflection'])} == {'its/arm'}


@pytest.mark.parametrize('file, argument, words', [
    ('sim.launch.py', 'params_file:=none.yaml', 'params_file must be a file, got none.yaml'),
    ('sim.launch.py', 'clock:=yes', 'Argument "clock" provided value "yes" is not valid'),
    ('rviz.launch.py', 'clock:=yes', 'Argument "clock" provided value "yes" is not valid'),
])
def test_wrong_arguments_end_the_launch(launch, file, argument, words):
    launched = launch(file, argument)
    code, output = launched.wait()
    assert code == 1 and words in output and not launched.seen('process started')


def test_rviz_gets_namespace_and_time(launch, installed, tmp_path):
    """A stand-in of the program prints its arguments."""
    others = tmp_path / 'others'
    (others / 'share/ament_index/resource_index/packages').mkdir(parents=True)
    (others / 'share/ament_index/resource_index/packages/rviz2').touch()
    program = others / 'lib/rviz2/rviz2'
    program.parent.mkdir(parents=True)
    program.write_text('#!/bin/sh\nprintf "%s\\n" "$@" > rviz2.txt\nfor each; do case $each '
                       'in *launch_params*) cat "$each" > rviz2.yaml; esac; done\n')
    program.chmod(0o755)
    code, output = launch(
        'rviz.launch.py', 'clock:=True', 'namespace:=left',
        AMENT_PREFIX_PATH=f'{others}:{installed[1]["AMENT_PREFIX_PATH"]}').wait()
    assert code == 0, output
    told = (tmp_path / 'rviz2.txt').read_text()
    parameters = yaml.safe_load((tmp_path / 'rviz2.yaml').read_text())
    assert '__ns:=/left\n' in told
    assert parameters['/**']['ros__parameters']['use_sim_time'] is True
    _, view, *_ = told.splitlines()
    displays = yaml.safe_load(Path(view).read_text())['Visualization Manager']['Displays']
    topics = [display[key]['Value'] for display in displays for key in display if 'Topic' in key]
    assert topics == ['robot_description']  # relative, in the namespace
