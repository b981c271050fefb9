# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Imports point down: no cycle among modules or folders, lazy imports included."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path
import re
import subprocess
import sys

import pytest

import timo_sim

PACKAGE = Path(timo_sim.__file__).parent
# From the ground up, as doc/design.md lists them: a folder may import from those before it.
LAYERS = ['version', 'extras', 'jit', 'physics', 'messages', 'scene', 'simulation',
          'log', 'view', 'runs', 'replay', 'sweep', 'fitting', 'gym', 'ros', 'cli',
          '__main__', '__init__']
MODULES = {'.'.join(['timo_sim', *path.relative_to(PACKAGE).with_suffix('').parts])
           .removesuffix('.__init__'): path for path in PACKAGE.rglob('*.py')}
NAMED = re.compile(r'(timo_sim(?:\.\w+)+)(?::\w+)?')


def named_modules(path):
    """Yield the modules that a file imports anywhere, or names in a string for a later import."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f'{path} has a relative import'
            for alias in node.names:
                inside = f'{node.module}.{alias.name}'
                yield inside if inside in MODULES else node.module
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found = NAMED.fullmatch(node.value)
            if found and found.group(1) in MODULES:
                yield found.group(1)


@pytest.fixture(scope='module')
def names():
    """Return the modules that each module names."""
    return {name: {*named_modules(path)} for name, path in MODULES.items()}


@pytest.fixture(scope='module')
def imports(names):
    """Return the modules of the package that each module imports."""
    return {name: found & MODULES.keys() - {name} for name, found in names.items()}


def layer(module):
    """Return the layer of a module."""
    return module.split('.')[1] if '.' in module else '__init__'


def folder(module):
    """Return the innermost folder of a module; for a module of the root its name."""
    own = MODULES[module].parent.relative_to(PACKAGE).as_posix()
    return module if own == '.' else own


def test_no_cycle_among_modules(imports):
    [*TopologicalSorter(imports).static_order()]  # raises CycleError


def test_no_cycle_among_folders(imports):
    graph = {}
    for name, modules in imports.items():
        graph.setdefault(folder(name), set()).update(
            folder(module) for module in modules if folder(module) != folder(name))
    [*TopologicalSorter(graph).static_order()]


@pytest.mark.parametrize('name', sorted(MODULES))
def test_imports_point_down(name, imports):
    above = {module for module in imports[name]
             if LAYERS.index(layer(module)) > LAYERS.index(layer(name))}
    assert not above


def test_the_sorter_detects_a_cycle():
    with pytest.raises(ValueError, match='cycle'):
        [*TopologicalSorter({'a': {'b'}, 'b': {'a'}}).static_order()]


def test_which_layers_import_which_packages(names, imports):
    """Only `ros` imports ROS; physics and messages open no files; no node imports the viewer."""
    outside = {name: {module.split('.')[0] for module in found} for name, found in names.items()}

    def importing(*packages):
        return {layer(name) for name, modules in outside.items() if modules & {*packages}}

    assert importing('rclpy', 'std_msgs', 'sensor_msgs', 'geometry_msgs') == {'ros'}
    assert importing('numba', 'llvmlite') == {'jit', 'log'}  # a log notes their versions
    assert importing('rerun') == {'view', 'cli'}
    assert not any(modules & {'pathlib', 'yaml', 'mcap', 'os'} for name, modules in outside.items()
                   if layer(name) in ('physics', 'messages'))
    assert not any(layer(module) == 'view' for name, modules in imports.items()
                   for module in modules if layer(name) == 'ros')


def test_offline_use_imports_no_ros_and_the_package_itself_nothing_heavy():
    code = ('import sys, timo_sim; assert not {"numpy", "numba", "rclpy"} & set(sys.modules); '
            'timo_sim.simulate(timo_sim.load_scene({}), 0.01); '
            'assert not {"rclpy", "mcap", "rerun", "matplotlib", "pyarrow", "distributed", '
            '"click", "scipy.integrate"} & set(sys.modules); '
            'timo_sim.simulate_many(timo_sim.load_scene({}), [{}], 0.01, workers=1); '
            'assert not {"pyarrow", "distributed", "click"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', code], check=True)


def test_the_command_line_imports_the_needs_of_a_subcommand_when_it_runs():
    code = ('import sys, timo_sim.cli; '
            'assert not {"numpy", "yaml", "tqdm", "pyarrow"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', code], check=True)


def test_parameters_need_no_numba():
    code = ('import sys, timo_sim.scene.parameters; assert "numba" not in sys.modules')
    subprocess.run([sys.executable, '-c', code], check=True)
