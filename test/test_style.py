"""Linters as tests."""

from pathlib import Path
import re
import subprocess
import sys

from catkin_pkg.package import parse_package
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


def test_package_xml():
    package = parse_package(str(ROOT / 'package.xml'))
    package.validate()
    assert package.get_build_type() == 'ament_python'


def test_one_version():
    import timo_sim
    assert f"version='{timo_sim.__version__}'" in (ROOT / 'setup.py').read_text()
    assert parse_package(str(ROOT / 'package.xml')).version == timo_sim.__version__
    assert f'## {timo_sim.__version__}' in (ROOT / 'CHANGELOG.md').read_text()


def test_equations_that_the_code_cites_are_in_the_theory():
    numbers = set(re.findall(r'\\tag\{(T\d+)\}', (ROOT / 'doc' / 'theory.md').read_text()))
    cited = {path.name: set(re.findall(r'\((T\d+)\)', path.read_text()))
             for path in (ROOT / 'timo_sim').rglob('*.py')}
    assert numbers == {f'T{n + 1}' for n in range(len(numbers))}
    assert set().union(*cited.values()) <= numbers
    for formulation in ('exact', 'newton', 'newton_root_stress', 'newton_rigid_axial'):
        assert cited[f'{formulation}.py']
