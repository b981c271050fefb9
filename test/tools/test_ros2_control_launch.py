# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2 launch` of ros2_control.launch.py, and the literal commands of doc/ros.md."""

from contextlib import contextmanager, suppress
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree

import pytest
from ros_process import PATIENCE
from sensor_msgs.msg import JointState
import yaml

from timo_sim.log.read import recover
from timo_sim.runs.replay import replay

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / 'doc/ros.md').read_text()
LAUNCH, PUBLISH = (re.findall(f'^ros2 {name} .*', PAGE, re.M) for name in ('launch', 'topic pub'))
PROGRAMS = {'controller_manager': ['ros2_control_node', 'spawner'], 'timo_sim_hardware': [],
            'robot_state_publisher': ['robot_state_publisher'],
            'timo_sim': ['timo_sim']}
PREFIXES = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
MISSING = [package for package in PROGRAMS
           if not any(Path(prefix, 'share', package).is_dir() for prefix in PREFIXES)]


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Install `timo_sim`, and stand-ins of others that print their arguments and wait."""
    for package, programs in PROGRAMS.items():
        for program in programs:
            path = tmp_path / 'lib' / package / program
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text('#!/bin/bash\n' + (
                f'exec {sys.executable} -m timo_sim "$@"' if program == 'timo_sim'
                else f'echo "{program} $*"; exec sleep {PATIENCE}'))
            path.chmod(0o755)
        index = tmp_path / 'share/ament_index/resource_index/packages' / package
        index.parent.mkdir(parents=True, exist_ok=True)
        index.touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join([str(tmp_path), *PREFIXES]))
    return f'ros2 launch {ROOT}/hardware/launch/ros2_control.launch.py'


@contextmanager
def launched(command, folder):
    """Run a launch file in a folder; yield a function that returns its output."""
    said = folder / 'said.txt'
    with said.open('w') as file:
        process = subprocess.Popen(['bash', '-c', f'exec {command}'], cwd=folder, stdout=file,
                                   stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                                   env={**os.environ, 'ROS_HOME': str(folder)},  # logs, locks
                                   start_new_session=True)
    try:
        yield said.read_text
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)
    finally:
        print(said.read_text())  # pytest shows it if the test fails
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.skipif(not shutil.which('cc'), reason='needs a C compiler')
def test_the_manager_that_has_the_arm_inside(packages, tmp_path):
    (tmp_path / 'scene.yaml').write_text('timo_sim: {ros__parameters: {arm.length: 1.5}}')
    # The publisher's only parameter file has the description.
    publisher = tmp_path / 'lib/robot_state_publisher/robot_state_publisher'
    publisher.write_text('#!/bin/bash\nfor each; do case $each in *launch_params*) cp "$each" '
                         f'{tmp_path}/part; mv {tmp_path}/part {tmp_path}/told.yaml; esac; done; '
                         f'exec sleep {PATIENCE}\n')
    with launched(f'{packages} params_file:=scene.yaml', tmp_path) as said:
        end = time.monotonic() + PATIENCE
        while 'ros2_control_node --ros-args' not in said() or (
                not (tmp_path / 'told.yaml').exists()):
            assert time.monotonic() < end, said()
            time.sleep(0.05)
        assert '-r controller_manager:/clock:=/clock_unheard' in said()
        told = yaml.safe_load((tmp_path / 'told.yaml').read_text())['/**']['ros__parameters']
        robot = ElementTree.fromstring(told['robot_description'])
        assert robot.find('joint[@name="tip"]/origin').get('xyz') == '1.5 0 0'
        given = {each.get('name'): each.text for each in robot.iterfind('ros2_control//param')}
        assert Path(given['scene_library']).stat().st_size > 10000
        assert given['publish_clock'] == 'true'


@pytest.mark.skipif(not shutil.which('cc'), reason='needs a C compiler')
@pytest.mark.parametrize('missing, words', [
    ('a file', "No such file or directory: 'nowhere.yaml'"),
    ('a package', "'controller_manager' not found"),
    ('a plugin', 'ros2_control_node-2] was required'),
    ('a controller', 'spawner-3] was required')])
def test_what_is_missing_ends_everything(packages, tmp_path, missing, words):
    if missing == 'a package':
        (tmp_path / 'share/ament_index/resource_index/packages/controller_manager').unlink()
    for place, program in ('a plugin', 'ros2_control_node'), ('a controller', 'spawner'):
        if place == missing:
            (tmp_path / 'lib/controller_manager' / program).write_text('#!/bin/sh\nexit 1\n')
    (tmp_path / 'scene.yaml').write_text('timo_sim: {ros__parameters: {model.modes: 0}}')
    scene = [f'params_file:={"nowhere" if missing == "a file" else "scene"}.yaml']
    with (tmp_path / 'said.txt').open('w') as file:
        process = subprocess.Popen([*packages.split(), *scene], cwd=tmp_path, stdout=file,
                                   stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                                   env={**os.environ, 'ROS_HOME': str(tmp_path)},
                                   start_new_session=True)
    try:
        process.wait(PATIENCE)
        assert words in (tmp_path / 'said.txt').read_text()
        with pytest.raises(ProcessLookupError):  # the simulator and others have ended, too
            os.killpg(process.pid, 0)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.skipif(bool(MISSING), reason=f'not installed: {", ".join(MISSING)}')
@pytest.mark.parametrize('launch, publish, moved', zip(LAUNCH, PUBLISH, [
    lambda angle, speed, effort: effort == 1.0 and speed > 0.1,
    lambda angle, speed, effort: abs(angle - 1.5) < 0.01 and abs(speed) < 0.01], strict=True),
    ids=['effort', 'pid'])
def test_the_commands_of_the_page_move_the_shaft(client, tmp_path, launch, publish, moved):
    """With the real ros2_control."""
    with launched(launch, tmp_path) as said:
        client.wait(lambda: re.search(
            'activated .*(effort|pid)_controller|process has died', said()), 'a controller')
        states = client.collect(JointState, '/joint_states')
        subprocess.run(['bash', '-c', publish], check=True, timeout=PATIENCE)

        def reached():
            return states and moved(*(getattr(states[-1], name)[states[-1].name.index('shaft')]
                                      for name in ('position', 'velocity', 'effort')))
        client.wait(reached, 'the motion of the shaft')
    recover(tmp_path / 'timo_sim.mcap')
    assert replay(tmp_path / 'timo_sim_recovered.mcap')
