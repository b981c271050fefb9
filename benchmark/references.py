"""The stored finite-element references, read, and the largest differences of runs from them."""

import csv
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / 'test' / 'data'
STATIONS = {'0': 0.0, 'l4': 0.25, 'l2': 0.5, '3l4': 0.75, 'l': 1.0}  # xi / l


def read(name):
    """Return the comment and the columns, by name, of a stored table."""
    with open(DATA / f'finite_elements_{name}.csv', encoding='utf-8') as file:
        comment = file.readline().lstrip('# ').strip()
        names, *rows = csv.reader(file)
    return comment, dict(zip(names, np.array(rows, dtype=float).T))


def station(reference, name, length):
    """
    Return position and angle of a section of the finite-element model.

    Returns
    -------
    position : ndarray, shape (n, 2)
        In world axes [m].
    angle : ndarray, shape (n,)
        Of the section in world axes [rad].

    """
    theta = reference['theta_rad']
    carrier = np.column_stack([reference['x_c_m'], reference['y_c_m']])
    if name == '0':
        return carrier, theta
    along = STATIONS[name] * length + reference[f'u_{name}_m']
    across = reference[f'w_{name}_m']
    turned = np.column_stack([np.cos(theta) * along - np.sin(theta) * across,
                              np.sin(theta) * along + np.cos(theta) * across])
    return carrier + turned, theta + reference[f'phi_{name}_rad']
