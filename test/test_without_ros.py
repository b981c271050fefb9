# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The command line and the examples in a Python that has no ROS."""

import json
import os
from pathlib import Path
import subprocess
import sys

import pytest

from timo_sim.log.tables import Recording

ROOT = Path(__file__).resolve().parents[1]
# Python imports this as sitecustomize at its start; it hides all packages of ROS.
NO_ROS = """
import re, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if re.match(r'rclpy|rosidl|ament_index_python|std_srvs|\\w+_(msgs|interfaces)', name):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, NoRos())
"""


@pytest.fixture
def python(tmp_path):
    """Run Python without ROS in a folder of its own; return what it prints."""
    (tmp_path / 'sitecustomize.py').write_text(NO_ROS)
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH')}

    def run(*arguments, code=0):
        result = subprocess.run(
            [sys.executable, *arguments], cwd=tmp_path, capture_output=True, text=True,
            env={**environment, 'PYTHONPATH': f'{tmp_path}{os.pathsep}{ROOT}'})
        assert result.returncode == code, result.stderr
        return result.stdout + result.stderr
    return run


ONE_BY_ONE = """
import sys
from timo_sim.cli import main
for command in sys.argv[1:]:
    main(command.split(), standalone_mode=False)
"""
COMMANDS = {
    'simulate paper --duration 1 --png paper.png -o paper.mcap --set arm.length=1.9 --rate 200':
        '201 samples until t = 1 s, no warnings',
    'replay paper.mcap': 'all are the same to the last bit',
    'replay paper.mcap --set end_effector.mass=3': 'new log: paper_replay.mcap',
    'export paper_replay.mcap -o out.csv': 'rows',
    'info paper_replay.mcap': 'sim time  0 to 1 s',
    'simulate paper --duration 0.1 -o run.parquet': 'no warnings'}


def test_simulate_draws_logs_and_tabulates(python, tmp_path):
    told = python('-c', ONE_BY_ONE, *COMMANDS)
    for words in COMMANDS.values():
        said, words, told = told.partition(words)
        assert words, said
    assert (tmp_path / 'paper.png').read_bytes().startswith(b'\x89PNG')
    recording = Recording(tmp_path / 'paper.mcap')
    assert recording.scene.values['arm.length'] == 1.9 and len(recording.motion()[0]) == 201
    assert (tmp_path / 'run.parquet').exists()


def test_a_divergent_run_is_written_and_has_code_1(python, tmp_path):
    (tmp_path / 'scene.yaml').write_text('/**:\n  ros__parameters: ' + json.dumps({
        'integrator.step': 0.01, 'initial.shaft_velocity': 100.0,
        'initial.modal_rates': [10.0, 0.0, 0.0]}))
    told = python('-m', 'timo_sim', 'simulate', 'scene.yaml', '--duration', '100', '-o',
                  'run.csv', code=1)
    assert 'the state diverges' in told and (tmp_path / 'run.csv').exists()


def test_the_node_says_what_is_missing(python):
    told = python('-m', 'timo_sim.cli.sim_node', '--ros-args', '-p', 'duration:=1.0', code=1)
    assert 'sim_node needs ROS 2' in told


def test_an_example_says_how_it_runs_without_ros(python):
    told = python(str(ROOT / 'example/pd.py'), code=2)
    assert 'the node needs ROS 2' in told and '--loop runs without it' in told


def test_send_says_what_is_missing(python):
    told = python('-m', 'timo_sim', 'send', 'motor_torque', '1', code=1)
    assert 'timo_sim: rclpy is missing: in a clone of timo_sim, ' in told
    assert told.endswith("-m pip install -e '.[ros]'\n")
