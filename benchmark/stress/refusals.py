# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameters that a node must refuse, from files and from the command line."""

from pathlib import Path
import subprocess
import sys
import tempfile

from benchmark.process import ENVIRONMENT
from benchmark.stress.node_process import READY

FILES = {
    'empty': (b'', 0), 'of other bytes': (b'timo_sim: {ros__parameters: {record_file: \xe9}}', 2),
    'cut': (b'timo_sim: {ros__parameters: {arm: [', 2),
    'with a NUL': (b'timo_sim: {ros__parameters: {arm.length: 1\0}}', 2),
    'with an alias': (b'timo_sim: {ros__parameters: {arm.length: &a 1.0, arm.width: *a}}', 2),
    'with a name twice': (b'timo_sim: {ros__parameters: {arm.length: 1.0, arm.length: 2.0}}', 2),
    'with a merge key': (b'timo_sim: {ros__parameters: {arm: {<<: {length: 1.0}}}}', 2),
    'with a tag': (b'timo_sim: {ros__parameters: {arm.length: !!python/object/apply:os.system '
                   b'[touch tag]}}', 2),
    'nested a thousand deep': (b'timo_sim: {ros__parameters: {a: ' + 1000 * b'[' + b'}}', 2),
    'with a list of 20000': (b'timo_sim: {ros__parameters: {arm.profile.width: ['
                             + b'1.0, ' * 20000 + b'1.0]}}', 2),
    'with a huge number': (b'timo_sim: {ros__parameters: {arm.length: 1.0e+400}}', 2),
    'with a nonsense scene': (b'timo_sim: {ros__parameters: {arm.height: 1.0e+300}}', 2)}
VALUES = (
    'arm.length:=-1.0', 'arm.length:=.nan', 'arm.length:=[1, a]', 'arm.length:=1.0e+300',
    'rate.joint_states:=1.0e+13', 'duration:=1.0e-13', 'duration:=1.0e+308',
    'integrator.step:=1.0e-300', 'command_timeout:=.inf', 'model.modes:=99999999999999999999',
    'initial.shaft:=1.0e+100', 'no.such:=1', 'record_file:=7', 'arm.length:={a: 1}', 'arm:=')


def rows(quick):
    """Start nodes with bad parameters, which must be refused in one line with code 2."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'scene.yaml'
        good = 0
        for content, expected in list(FILES.values())[::3 if quick else 1]:
            path.write_bytes(content)
            good += _ends_with(expected, folder, '--params-file', path.name)
        yield ('parameter files ' + ', '.join(list(FILES)[::3 if quick else 1]),
               len(list(FILES)[::3 if quick else 1]), good, 'a line, code 2; no tag is executed')
        values = VALUES[::5 if quick else 1]
        good = sum(_ends_with(2, folder, '-p', value) for value in values)
        yield 'bad parameters on the command line', len(values), good, 'a line, code 2'


def _ends_with(code, folder, *arguments):
    result = subprocess.run(
        [sys.executable, '-m', 'timo_sim.cli.sim_node', '--ros-args', '-p', 'duration:=0.01',
         '-p', 'record:=false', *arguments], cwd=folder, env=ENVIRONMENT, capture_output=True,
        text=True, timeout=READY)
    lines = [line for line in result.stderr.splitlines() if line.startswith('timo_sim: ')]
    return (result.returncode == code and len(lines) == (code == 2)
            and 'Traceback' not in result.stderr and not (Path(folder) / 'tag').exists())
