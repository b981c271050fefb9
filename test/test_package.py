# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The package as a ROS user builds it: colcon, then the installed executable."""

from pathlib import Path
import subprocess

ROOT = Path(__file__).resolve().parents[1]


def test_colcon_builds_and_the_installed_node_runs(installed, tmp_path):
    import rclpy  # noqa: F401  # without which there is no node
    prefix, environment = installed
    share = prefix / 'share' / 'timo_sim'
    assert (prefix / 'share/ament_index/resource_index/packages/timo_sim').exists()
    assert (share / 'package.xml').exists() and (share / 'launch/sim.launch.py').exists()
    scene = share / 'config' / 'paper.yaml'
    assert scene.read_text() == (ROOT / 'config/paper.yaml').read_text()

    executables = {path.name for path in (prefix / 'lib/timo_sim').iterdir()}
    assert executables == {'sim_node', 'timo_sim'}
    result = subprocess.run(
        [prefix / 'lib/timo_sim/sim_node', '--ros-args', '--params-file', scene, '-p',
         'duration:=0.5', '-p', 'record_file:=run.mcap'],
        cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    assert 'simulated 0.5 s' in result.stdout + result.stderr
    assert (tmp_path / 'run.mcap').stat().st_size > 1000
    # The program that `ros2 run timo_sim timo_sim` starts, and a scene by its name.
    for command, words in ((['info', 'run.mcap'], 'sim time  0 to 0.5 s'),
                           (['simulate', 'spin_up', '--duration', '0.1'], 'no warnings')):
        told = subprocess.run([prefix / 'lib/timo_sim/timo_sim', *command], cwd=tmp_path,
                              capture_output=True, text=True, env=environment)
        assert told.returncode == 0 and words in told.stdout, told.stderr
