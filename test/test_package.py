"""The package as a ROS user builds it: colcon, then the installed executable."""

import os
from pathlib import Path
import subprocess
import sys
import sysconfig

ROOT = Path(__file__).resolve().parents[1]


def test_colcon_builds_and_the_installed_node_runs(tmp_path):
    subprocess.run(
        [Path(sys.executable).with_name('colcon'), '--log-base', tmp_path / 'log', 'build',
         '--base-paths', ROOT, '--packages-select', 'timo_sim', '--build-base',
         tmp_path / 'build', '--install-base', tmp_path / 'install'],
        check=True, cwd=tmp_path, capture_output=True)
    prefix = tmp_path / 'install' / 'timo_sim'
    share = prefix / 'share' / 'timo_sim'
    assert (prefix / 'share/ament_index/resource_index/packages/timo_sim').exists()
    assert (share / 'package.xml').exists() and (share / 'launch/sim.launch.py').exists()
    scene = share / 'config' / 'paper.yaml'
    assert scene.read_text() == (ROOT / 'config/paper.yaml').read_text()

    executables = {path.name for path in (prefix / 'lib/timo_sim').iterdir()}
    assert executables >= {'sim_node', 'timo_sim', 'bode', 'export', 'info', 'recover', 'replay'}
    purelib = sysconfig.get_path('purelib', vars={'base': str(prefix)})
    environment = {**os.environ, 'PYTHONPATH': str(purelib)}
    result = subprocess.run(
        [prefix / 'lib/timo_sim/sim_node', '--ros-args', '--params-file', scene, '-p',
         'duration:=0.5', '-p', 'record_file:=run.mcap'],
        cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    assert 'simulated 0.5 s' in result.stdout + result.stderr
    assert (tmp_path / 'run.mcap').stat().st_size > 1000
    # What `ros2 run timo_sim info` and `timo_sim info` start.
    for command in (['info'], ['timo_sim', 'info']):
        told = subprocess.run([prefix / 'lib/timo_sim' / command[0], *command[1:], 'run.mcap'],
                              cwd=tmp_path, capture_output=True, text=True, env=environment)
        assert told.returncode == 0 and 'sim time  0 to 0.5 s' in told.stdout, told.stderr
