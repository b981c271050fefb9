# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Fixtures and settings of all tests: scenes, reference, DDS domain, tests left out."""

from contextlib import contextmanager, ExitStack
from importlib.util import find_spec
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import sysconfig

import pytest

from oracles.domains import own_domain
from oracles.references import read
from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.store import lock
from timo_sim.model.exact_code import Tables
from timo_sim.scene import scene

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / 'config' / 'paper.yaml'
BROWSER = ROOT / 'test' / 'browser'

# Nodes of one test process must not see those of other runs or of other processes of pytest-xdist.
os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST', ROS_DOMAIN_ID=str(own_domain()))
# Under nohup nodes would inherit that SIGHUP is ignored, and not end by it.
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(hookwrapper=True)
def pytest_collection():
    """Let one process compile the tests to bytecode, while the others wait for it."""
    with ExitStack() as stack:
        stack.enter_context(lock('collection.lock'))
        last = f'test/__pycache__/test_without_ros.{sys.implementation.cache_tag}*'
        if any(ROOT.glob(last)):  # another was here
            stack.close()
        yield


# Begins of names of files and folders of tests of code for a size, of bits that another process
# has, too, or of long runs.
OF_ONE_SIZE = (
    'log', 'ros', 'tools', 'test_code_store', 'test_compiled', 'test_composition', 'test_export',
    'test_fit', 'test_gpu', 'test_hardware', 'test_peers', 'test_sweep', 'test_threads')


# Entry points of snapshots and sensors, where the motion and the tip alone have known bits.
OF_SNAPSHOTS = 'model.functions.sense', 'model.functions.energies'


@contextmanager
def code_for_any_size(names=''):
    """
    Let this process run code for any size of `exact`, which is half as fast and compiled once.

    For a size LLVM takes longer than 50 000 steps. The two differ in round-off (test_compiled.py).
    `names` are the begins of names of entry points, by default of all; of none if it is ().
    """
    own = EntryPoint.of

    def of(entry, *constants, any_size=False):
        return own(entry, *constants, any_size=any_size or (
            entry.name.startswith(names) and bool(constants) and constants[0].kind is Tables))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EntryPoint, 'of', of)
        yield
    scene._shared_model.cache_clear()  # which have code of this kind


@pytest.fixture(autouse=True, scope='module')
def any_size(request):
    """Let most tests run code for any size."""
    with code_for_any_size(() if any(part.startswith(OF_ONE_SIZE) for part in (
            request.path.relative_to(ROOT).parts)) else ''):
        yield


@pytest.fixture(scope='session')
def paper():
    """Path of the paper's scene."""
    return PAPER


@pytest.fixture(scope='session')
def spin_up():
    """Path of the spin-up manoeuvre."""
    return ROOT / 'config' / 'spin_up.yaml'


@pytest.fixture(scope='session')
def installed(tmp_path_factory):
    """
    Install node and launch files with colcon; return the prefix and the environment with it.

    As pip does, it hands on what a build needs by PYTHONPATH, to a Python that has nothing else.
    """
    folder, packages = tmp_path_factory.mktemp('colcon'), sysconfig.get_path('purelib')
    subprocess.run(
        [sys._base_executable, '-m', 'colcon', '--log-base', folder / 'log', 'build',
         '--base-paths', ROOT, ROOT / 'bringup', '--build-base', folder / 'build',
         '--install-base', folder / 'install', '--merge-install'],
        check=True, cwd=folder, capture_output=True,
        env={**os.environ, 'PYTHONPATH': packages})
    prefix = folder / 'install'
    built = sysconfig.get_path('purelib', vars={'base': str(prefix)})
    paths = {'PYTHONPATH': f'{built}{os.pathsep}{packages}', 'AMENT_PREFIX_PATH': str(prefix)}
    return prefix, {**os.environ, **{
        name: os.pathsep.join(filter(None, (path, os.environ.get(name))))
        for name, path in paths.items()}}


@pytest.fixture(scope='session')
def reference():
    """
    Columns of the finite-element reference of the paper's scene, by name.

    Geometrically exact elements, extrapolated in mesh and step. Their estimated errors are 1e-7 m
    in w(l), 8e-8 rad in theta, 3e-8 m in x_c, and 1e-6 rad in the rotation of inner sections.
    """
    return read('paper')[1]


# These tests need packages without wheels on PyPI; they run where the packages are installed.
NEED = {'ros/test_transforms.py': 'tf2_msgs', 'ros/test_interfaces.py': 'simulation_interfaces',
        'tools': 'ros2cli', 'tools/test_ros2_bag.py': 'rosbag2_py',
        **dict.fromkeys(('tools/test_launch.py', 'tools/test_ros2_control_launch.py'),
                        'ros2launch')}
collect_ignore = [path for path, package in NEED.items() if find_spec(package) is None]


def pytest_ignore_collect(collection_path, config):
    """Leave out the tests in browsers, unless they are asked for: `make browser` does."""
    if collection_path == BROWSER and not _asks_for_browsers(config):
        return True


def _asks_for_browsers(config):
    return any('browser' in arg for arg in config.args)


def pytest_terminal_summary(terminalreporter):
    """Count the files that cannot run here in the last line, with the packages they need."""
    left_out = {}
    if collect_ignore:
        packages = ', '.join(dict.fromkeys(NEED[path] for path in collect_ignore))
        left_out[f'left out for want of {packages}'] = collect_ignore
    if not _asks_for_browsers(terminalreporter.config):
        left_out['left to make browser'] = [path.name for path in BROWSER.glob('test_*.py')]
    for reason, paths in left_out.items():
        terminalreporter.stats[reason] = [
            pytest.CollectReport(path, 'skipped', None, None) for path in paths]


# The fixtures `start`, `client` and `ros`: a node in its own process, and a client of it.
pytest_plugins = ['ros_process']


@pytest.fixture
def small_disk():
    """Let no file of this process grow beyond 2 kB, as a full disk would."""
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    signal.signal(signal.SIGXFSZ, handler)
