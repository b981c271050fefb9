# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2 param` and lines of the pages, where `ros2` is installed."""

from contextlib import suppress
from pathlib import Path
import re
import subprocess

from ros_process import PATIENCE
from timo_sim.scene.parameters import PARAMETERS

DOC = Path(__file__).resolve().parents[2] / 'doc'


def told(*command):
    """Return what a command prints; one that hangs, since its answer was dropped, is repeated."""
    for _ in range(5):
        with suppress(subprocess.TimeoutExpired):
            result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE / 5)
            assert result.returncode == 0, result.stderr
            return result.stdout + result.stderr
    raise TimeoutError(command)


def ros2(command, *arguments):
    """Return what a command of `ros2 param` prints; no daemon stays behind."""
    return told('ros2', 'param', command, '--no-daemon', '--timeout', f'{PATIENCE:g}', '/timo_sim',
                *arguments)


def test_dump_starts_a_node_with_the_same_dump(start, tmp_path):
    node = start(record=False, **{'initial.shaft': 1.0 / 3.0, 'carrier.mass': 5})
    dumped = ros2('dump')
    assert dumped.count('\n') > len(PARAMETERS)
    (tmp_path / 'dump.yaml').write_text(dumped)
    assert node.end()[0] == 0
    start('--params-file', 'dump.yaml', record=False)
    assert ros2('dump') == dumped


def test_describe_load_set_get_and_the_line_of_the_page(start, tmp_path):
    start(record=False)
    assert 'Max value: 2147483647.0' in ros2('describe', 'duration')
    (tmp_path / 'load.yaml').write_text(
        '/timo_sim: {ros__parameters: {load.torque.table.time: [0, 1.5, 1.0e+5], '
        'load.torque.table.value: [0.0, 1.0e-05, 1.0]}}')
    loaded = ros2('load', str(tmp_path / 'load.yaml'))
    assert loaded.count('successful') == 2 and 'failed' not in loaded
    assert '[0.0, 1.5, 100000.0]' in ros2('get', 'load.torque.table.time')
    for text, shown in (('[]', '[]'), ('[1]', '[1.0]')):
        assert 'Set parameter successful' in ros2('set', 'arm.damping_ratio', text)
        assert shown in ros2('get', 'arm.damping_ratio')
    line, = re.findall(r'^(ros2 service call \S*set_parameters_atomically .*\\\n.*)$',
                       (DOC / 'sensors.md').read_text(), re.MULTILINE)
    assert 'successful=True' in told('bash', '-c', line)
    assert '[0.5, 0.0]' in ros2('get', 'load.torque.piecewise.value')


def test_the_lines_of_the_tutorial(start):
    start(record=False)
    lines = re.findall(r'^ros2 (?:topic pub|service call) .*$',
                       (DOC / 'tutorial' / 'ros.md').read_text(), re.MULTILINE)
    for line, shown in zip(lines, ('publishing #1: ', "'paused'", "'at step ", "'running'"),
                           strict=True):
        assert shown in told('bash', '-c', line)
