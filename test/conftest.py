"""What several tests need: the paper's scene and the finite-element reference."""

import os
from pathlib import Path
import uuid

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / 'config' / 'paper.yaml'

# Tests talk to nobody but themselves.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(1 + uuid.uuid4().int % 100)


@pytest.fixture(scope='session')
def paper():
    """Path of the paper's scene."""
    return PAPER


@pytest.fixture(scope='session')
def spin_up():
    """Path of the spin-up manoeuvre."""
    return ROOT / 'config' / 'spin_up.yaml'


@pytest.fixture(scope='session')
def reference():
    """
    Columns of the finite-element reference of the paper's scene, by name.

    400 geometrically exact elements, extrapolated in mesh and step; uncertainty 7e-8 m in w(l),
    3e-8 rad in theta, 9e-9 m in x_c.
    """
    path = Path(__file__).parent / 'data' / 'reference_table4.csv'
    names = path.read_text().split('\n', 1)[0].split(',')
    return dict(zip(names, np.loadtxt(path, delimiter=',', skiprows=1).T))


# A node in its own process and a client: `start`, `client`, `ros`.
pytest_plugins = ['ros_process']
