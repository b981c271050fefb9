"""Imports go one way: physics at the bottom, the node on top."""

import ast
from pathlib import Path
import subprocess
import sys

import timo_sim

PACKAGE = Path(timo_sim.__file__).parent
# A module may import from its own layer and from those listed.
BELOW = {
    'physics': set(),
    'actuators': {'physics', 'parameters'},
    'energy': set(),
    'cautions': {'step_control'},
    'parameters': {'physics'},
    'scene': {'physics', 'parameters', 'actuators'},
    'commands': {'physics'},
    'linear': {'physics', 'parameters'},
    'outputs': {'physics', 'sensors'},
    'sensors': set(),
    'run': {'physics', 'scene', 'energy'},
    'simulation': {'physics', 'parameters', 'scene', 'run', 'accuracy', 'actuators',
                   'cautions', 'step_control'},
    'step_control': {'physics'},
    'accuracy': {'parameters', 'scene', 'simulation'},
    'replay': {'physics', 'commands', 'outputs', 'parameters', 'scene', 'simulation', 'log',
               'ros'},
    'sweep': {'physics', 'parameters', 'scene', 'simulation', ''},
    'track': {'physics', 'scene', 'energy'},
    'view': {'track', 'scene'},
    'cli': {'parameters', 'scene', 'linear', 'log', 'replay', 'sweep', 'track', 'view'},
    'log': {'commands', 'outputs', 'parameters', 'scene', ''},
    'ros': {'physics', 'commands', 'outputs', 'parameters', 'scene', 'simulation', 'accuracy',
            'log', 'view', ''},
}
OUTSIDE_OF_PHYSICS = {'rclpy', 'yaml', 'mcap', 'rerun', 'logging', 'pathlib'}


def imports(path):
    """Return the modules that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module)
    return found


def layer(module):
    """Return the layer of a module of ours: '' for the package itself."""
    return module.split('.')[1] if '.' in module else ''


def test_arrows_point_down():
    for path in PACKAGE.rglob('*.py'):
        own = path.relative_to(PACKAGE).parts[0].removesuffix('.py')
        if own == '__init__':
            continue
        ours = {layer(name) for name in imports(path) if name.startswith('timo_sim')}
        assert ours <= BELOW[own] | {own}, f'{path} imports {ours - BELOW[own]}'


def test_physics_knows_no_files_ros_or_log():
    for path in (PACKAGE / 'physics').glob('*.py'):
        if path.name != 'compiled.py':  # keeps machine code on disk
            foreign = {name.split('.')[0] for name in imports(path)} & OUTSIDE_OF_PHYSICS
            assert not foreign, f'{path} imports {foreign}'


def test_offline_use_needs_no_ros_and_the_package_itself_nothing_heavy():
    code = ('import sys, timo_sim; assert not {"numpy", "numba", "rclpy"} & set(sys.modules); '
            'timo_sim.simulate(timo_sim.load_scene({}), 0.01); '
            'assert not {"rclpy", "mcap", "rerun", "matplotlib", "pyarrow", "distributed", '
            '"click", "scipy.integrate"} & set(sys.modules); '
            'timo_sim.simulate_many(timo_sim.load_scene({}), [{}], 0.01, workers=1); '
            'assert not {"pyarrow", "distributed", "click"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', code], check=True)


def test_the_command_line_imports_what_a_subcommand_needs_when_it_runs():
    code = ('import sys, timo_sim.cli; '
            'assert not {"numpy", "yaml", "tqdm", "pyarrow"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', code], check=True)
