# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Dependencies in pyproject.toml, package.xml and the lists of versions match the imports."""

import ast
from importlib.util import find_spec
import os
from pathlib import Path
import re
import subprocess
import sys
import tomllib

from catkin_pkg.package import parse_package
from conftest import NEED
from packaging.requirements import Requirement
import pytest
import timo_sim
from timo_sim import extras
import yaml

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / 'pyproject.toml').read_text())['project']
EXTRAS = PROJECT['optional-dependencies']
PACKAGE = parse_package(str(ROOT / 'package.xml'))
ROSDEP = yaml.safe_load((ROOT / 'test/data/rosdep_keys.yaml').read_text())
RUN_KEYS = {depend.name for depend in PACKAGE.exec_depends}

# Distributions by module, where the names differ.
DISTRIBUTIONS = {'llvmlite': 'numba', 'PIL': 'pillow', 'rerun': 'rerun-sdk',
                 'rerun_cli': 'rerun-sdk', 'yaml': 'pyyaml'}
# ROS packages that the node uses where they are installed, as README.md says.
OPTIONAL_ROS = {'simulation_interfaces'}


def requirements(lines):
    """Return the requirements by lower-case name, without extras of timo_sim itself."""
    parsed = [Requirement(line) for line in lines]
    return {each.name.lower(): each for each in parsed if each.name != 'timo_sim'}


def listed(name):
    """Return the lines of a file of requirements that are no comments."""
    lines = (ROOT / name).read_text().splitlines()
    return [line for line in lines if line and not line.startswith('#')]


def imported(folder):
    """Return {third-party module: a file that imports it}, imports in functions included."""
    found = {}
    for path in sorted((ROOT / folder).rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            elif (isinstance(node, ast.Call) and 'import' in ast.unparse(node.func)
                  and node.args and isinstance(node.args[0], ast.Constant)):
                names = [node.args[0].value]
            for name in names:
                found.setdefault(name.split('.')[0], path.relative_to(ROOT))
    return {name: path for name, path in found.items()
            if name not in sys.stdlib_module_names and name != 'timo_sim'}


def test_package_xml():
    PACKAGE.validate()
    assert PACKAGE.get_build_type() == 'ament_python'
    assert PACKAGE.name == PROJECT['name']
    assert PACKAGE.licenses == ['Apache-2.0']


def test_one_version():
    assert PACKAGE.version == timo_sim.__version__
    assert f'## {timo_sim.__version__}' in (ROOT / 'CHANGELOG.md').read_text()
    assert 'version' in PROJECT['dynamic']


def test_two_console_scripts_that_exist():
    assert sorted(PROJECT['scripts']) == ['sim_node', 'timo_sim']
    for target in PROJECT['scripts'].values():
        assert find_spec(target.split(':')[0]) is not None, target


@pytest.mark.parametrize('key', sorted({
    depend.name for kind in ('build', 'build_export', 'buildtool', 'exec', 'test')
    for depend in getattr(PACKAGE, f'{kind}_depends')}))
def test_rosdep_installs_it_with_apt(key):
    assert ROSDEP['apt'].get(key) or ROSDEP['jazzy'].get(key), (
        f'{key} in package.xml: test/data/rosdep_keys.yaml has neither an apt rule nor a package')


def test_imports_are_declared():
    declared = {*requirements(PROJECT['dependencies'])}
    for extra in re.findall(r'\w+', EXTRAS['all'][0].partition('[')[2]):
        declared |= {*requirements(EXTRAS[extra])}
    ros = (RUN_KEYS & {*ROSDEP['jazzy']}) | OPTIONAL_ROS
    modules = imported('timo_sim') | imported('launch')
    assert modules.keys() >= {'numpy', 'rclpy', 'launch'}
    undeclared = {module: str(path) for module, path in modules.items()
                  if module not in ros and DISTRIBUTIONS.get(module, module) not in declared}
    assert not undeclared


def test_package_xml_and_the_pip_list_make_up_the_dependencies():
    keys = {key.removeprefix('python3-') for key in RUN_KEYS & {*ROSDEP['apt']}}
    from_apt = {DISTRIBUTIONS.get(key, key) for key in keys}
    without_key = listed('requirements-pip.txt')
    assert {*without_key} <= {*PROJECT['dependencies']}
    assert from_apt.isdisjoint(requirements(without_key))
    assert from_apt | {*requirements(without_key)} == {*requirements(PROJECT['dependencies'])}
    assert {*requirements(without_key)} <= {*ROSDEP['none']}
    assert 'requirements-pip.txt' in (ROOT / 'README.md').read_text()


def test_the_page_on_ros2_control_installs_what_package_xml_says():
    page = (ROOT / 'doc/ros.md').read_text()
    named = {name.replace('-', '_') for name in re.findall(r'ros-jazzy-([\w-]+)', page)}
    sources = 'ros2_control', 'ros2_controllers', 'topic_based_hardware_interfaces'
    assert named == {'robot_state_publisher'} | {
        key for key in RUN_KEYS if ROSDEP['jazzy'].get(key) in sources}


def test_every_version_that_is_asked_for_is_pinned_and_allowed():
    optional = [line for extra in ('cluster', 'control', 'pandas', 'plot', 'rl', 'sweep')
                for line in EXTRAS[extra]]
    lowest = requirements(listed('constraints-lowest.txt'))
    pinned = requirements(listed('constraints.txt'))
    bounded = requirements(PROJECT['dependencies'] + optional)
    assert {*lowest} == {*bounded}
    for name, requirement in bounded.items():
        for constraints in (lowest, pinned):
            version = str(constraints[name].specifier).removeprefix('==')
            assert requirement.specifier.contains(version), (name, version)


def test_a_run_that_leaves_tests_out_says_so_in_its_last_line():
    import rclpy  # noqa: F401  # without which there is no node
    code = ('import sys; sys.modules["tf2_msgs"] = None; import pytest; sys.exit(pytest.main('
            '["test/test_layers.py", "-ksorter", "-pno:xdist", "-pno:cacheprovider"]))')
    told = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert told.returncode == 0, told.stdout + told.stderr
    last = told.stdout.splitlines()[-1]
    assert re.match(r'1 passed, .*left out for want of .*tf2_msgs', last), told.stdout


def test_the_workflow_leaves_out_no_test_on_a_machine_with_ros():
    ros = (ROOT / '.github/workflows/test.yml').read_text().partition('container: ros:jazzy')[2]
    assert f"python -c 'import {', '.join(sorted({*NEED.values()}))}'" in ros


def test_what_is_missing_is_named_with_the_command_that_installs_it(tmp_path):
    """Also in Python; extras that are named have the package among their requirements."""
    code = """
import sys
from timo_sim import extras
class Missing:
    def find_spec(self, name, *_):
        if name in extras._EXTRAS:
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, Missing())
import timo_sim
RECORD = {'time': {'column': 't'}, 'columns': {'s': 'shaft'}}
run = timo_sim.simulate('paper', 0.1)
for use in (lambda: run.plot(), lambda: run.view(), lambda: run.to_pandas(),
            lambda: run.save('run.parquet'), lambda: timo_sim.linearize('paper').to_control(),
            lambda: timo_sim.read_record('in.parquet', RECORD),
            lambda: __import__('timo_sim.gym'),
            lambda: timo_sim.simulate_many('paper', [{}], 0.1, scheduler='tcp://localhost:1')):
    try:
        use()
    except ModuleNotFoundError as error:
        print(error)
"""
    (tmp_path / 'in.parquet').touch()
    done = subprocess.run([sys.executable, '-W', 'ignore', '-c', code], cwd=tmp_path, text=True,
                          capture_output=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        f"{package} is missing: pip install 'timo_sim[{extra}]'" for package, extra in (
            ('matplotlib', 'plot'), ('rerun_cli', 'view'), ('pandas', 'pandas'),
            ('pyarrow', 'sweep'), ('control', 'control'), ('pyarrow', 'sweep'),
            ('gymnasium', 'rl'), ('distributed', 'cluster'))]
    assert [*tmp_path.iterdir()] == [tmp_path / 'in.parquet']
    for package, extra in extras._EXTRAS.items():
        name = DISTRIBUTIONS.get(package, package).replace('_', '-')
        assert any(name in line for line in EXTRAS[extra]), package


@pytest.mark.skipif(sys.platform != 'linux', reason='elsewhere there is a screen without DISPLAY')
def test_make_view_without_a_screen_is_an_error_with_one_line_that_make_can_follow():
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('DISPLAY', 'WAYLAND_DISPLAY')}
    make = ['make', '-o', '.venv/.gallery', 'view']  # rerun need not be installed
    done = subprocess.run(make, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and 'make view VIEW=--web' in done.stderr
    assert done.stderr.count('\n') == 2  # the last is make's own
    done = subprocess.run([*make, '-n', 'VIEW=--web'], cwd=ROOT, capture_output=True, text=True)
    assert 'timo_sim view run/paper.mcap --web\n' in done.stdout
