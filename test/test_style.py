# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Linters as tests."""

from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = [folder for folder in ('timo_sim', 'test', 'launch', 'benchmark', 'doc', 'example',
                                 'setup.py')
           if (ROOT / folder).exists()]


@pytest.mark.parametrize('command', [
    ['flake8', *FOLDERS], ['pydocstyle', 'timo_sim', 'launch'], ['mypy', 'timo_sim']],
    ids=lambda command: command[0])
def test_linter(command):
    result = subprocess.run([sys.executable, '-m', *command], cwd=ROOT, capture_output=True,
                            text=True)
    assert result.returncode == 0, result.stdout + result.stderr


def test_every_file_says_its_licence():
    """In the form that ament_copyright requires; it knows no shorter one."""
    header = (ROOT / 'timo_sim/version.py').read_text().partition('\n\n')[0]
    assert header.startswith('# Copyright') and 'License, Version 2.0' in header
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob('*.py')]
    assert len(files) > 200
    assert not [path for path in files if not path.read_text().startswith(header)]


def test_equations_that_the_code_cites_are_in_the_theory():
    numbers = re.findall(r'\\tag\{(T\d+)\}', (ROOT / 'doc' / 'theory.md').read_text())
    cited = {path.name: set(re.findall(r'\((T\d+)\)', path.read_text()))
             for path in (ROOT / 'timo_sim').rglob('*.py')}
    assert numbers == [f'T{n + 1}' for n in range(len(numbers))]
    assert set().union(*cited.values()) <= set(numbers)
    for formulation in ('exact', 'newton', 'newton_root_stress', 'newton_rigid_axial'):
        assert cited[f'{formulation}.py']
