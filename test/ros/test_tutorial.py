# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Commands of the tutorials on ROS and control; test_project.py runs those without a node."""

from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys

import pytest
from ros_process import PATIENCE

from timo_sim.log.tables import Recording

ROOT = Path(__file__).resolve().parents[2]
MODULES = {'sim_node': ['-m', 'timo_sim.cli.sim_node'], 'timo_sim': ['-m', 'timo_sim'],
           'python': []}


# Makes rclpy wait until the node knows each new client and publisher. The middleware drops answers
# to others and their messages, and the lines of the page do not repeat theirs.
KNOWN = """
from rcl_interfaces.srv import GetParameterTypes
import rclpy
from rclpy.node import Node
ask = Node.create_client
def known(make):
    def made(node, kind, name, *arguments, **options):
        found, answer = make(node, kind, name, *arguments, **options), None
        if not name.startswith('/timo_sim/'):
            return found  # the node's own
        client = ask(node, GetParameterTypes, '/timo_sim/get_parameter_types')
        while not (answer and answer.done()):
            answer = client.call_async(GetParameterTypes.Request())
            rclpy.spin_until_future_complete(node, answer, timeout_sec=0.5)
        return found
    return made
Node.create_client, Node.create_publisher = known(ask), known(Node.create_publisher)
"""


class Reader:
    """Runs the commands of a page in a folder with a copy of the examples."""

    def __init__(self, page, folder):
        self.text, self.folder = (ROOT / 'doc' / 'tutorial' / page).read_text(), folder
        shutil.copytree(ROOT / 'example', folder / 'example')
        self.python = '\n'.join(re.findall(r'```python\n(.*?)```', self.text, re.DOTALL))

    def _command(self, begin):
        line, = re.findall(rf'^(?:\$ )?\.venv/bin/({begin}.*)$', self.text, re.MULTILINE)
        name, *arguments = shlex.split(line)
        return [sys.executable, *MODULES[name], *arguments]

    def start(self, begin, *more):
        """Start the node by the line of the page that begins with `begin`, and more arguments."""
        self.node = subprocess.Popen([*self._command(begin), *more], cwd=self.folder)

    def run(self, begin):
        """Run the command on the line that begins with `begin`; return what it prints."""
        result = subprocess.run(self._command(begin), cwd=self.folder, capture_output=True,
                                text=True, timeout=PATIENCE)
        assert result.returncode == 0, result.stderr
        return result.stdout


@pytest.fixture
def reader(tmp_path):
    readers = []

    def read(page):
        readers.append(Reader(page, tmp_path))
        return readers[-1]
    yield read
    for each in readers:
        each.node.kill()
        each.node.wait()


def test_ros(reader):
    ros = reader('ros.md')
    ros.start('sim_node')
    shown = subprocess.run([sys.executable, '-c', KNOWN + ros.python], capture_output=True,
                           text=True, timeout=PATIENCE, check=True).stdout
    # The peak of 23.00 mm may fall between samples, and a busy node shows fewer samples.
    steps = re.search(  # the middleware may print errors of its own before
        r'bent by up to 2[0-3] mm\npaused\nat step (\d+)\nat step (\d+)\nrunning\n\Z', shown)
    assert int(steps[2]) == int(steps[1]) + 1
    ros.node.send_signal(signal.SIGINT)
    assert ros.node.wait(PATIENCE) == 0
    torques = Recording(ros.folder / 'push.mcap').topics['~/motor_torque'].values
    assert torques[:, 0].tolist() == [10.0, 0.0]
    assert re.search('/timo_sim/motor_torque +2 ', ros.run('timo_sim info'))
    assert 'all are the same to the last bit' in ros.run(r'timo_sim replay push.mcap$')
    assert 'tip_deflection transverse_m' in ros.run('timo_sim replay push.mcap --set')


def test_control(reader):
    control = reader('control.md')
    (control.folder / 'example' / 'my_lqr.py').write_text(control.python)
    # Short and as fast as possible; a loop, of the same bits (test_lock_step.py), has the rest.
    control.start('sim_node .* -p record_file:=my_lqr.mcap', '-p', 'real_time_factor:=0.0',
                  '-p', f'sync_timeout:={PATIENCE}', '-p', 'duration:=0.5')
    assert 'LQR: 251 states answered' in control.run('python example/my_lqr.py$')
    assert control.node.wait(PATIENCE) == 0
    score = subprocess.run([sys.executable, 'example/my_lqr.py', '--loop'], cwd=control.folder,
                           capture_output=True, text=True, check=True).stdout.splitlines()[-1]
    assert score.startswith('LQR: 2501 states') and score in control.text
    assert 'all are the same to the last bit' in control.run(r'timo_sim replay my_lqr.mcap$')
