# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Write the finite-element references of the tests to test/data, or to a given folder.

Each is extrapolated in the mesh and in the step; its first line estimates its error.
"""

from itertools import product
from pathlib import Path

import exudyn
import numpy as np

from benchmark import ROOT
from benchmark.report import parser
from oracles import finite_elements
from oracles.references import CANTILEVER, PENDULUM, spin_up, TORQUE
from timo_sim import load_scene

RIGID, TIP = ('x_c_m', 'y_c_m', 'theta_rad'), ('w_l_m', 'phi_l_rad', 'u_l_m')
INNER = tuple(f'{field}_{name}_{unit}' for field, unit in (('w', 'm'), ('phi', 'rad'), ('u', 'm'))
              for name in ('l4', 'l2', '3l4'))
LEVELS = 4
# Powers of the mesh size and of the step in the error; numerical damping is of third order.
TRAPEZOIDAL, DAMPED = ((0, 2, 4, 6), (0, 2, 4, 6)), ((0, 2, 4, 6), (0, 2, 3, 4))


def extrapolate(values, levels, orders):
    """
    Return the limit of values on halved meshes and steps.

    `values` are arrays by (i, j): mesh size halved i times, step j times. Those at a triangle of
    levels, shape (n, 2), determine as many terms of the expansion of the error, whose powers of
    the mesh size and of the step are `orders`.
    """
    relative = levels - levels.min(axis=0)
    powers = np.stack([np.array(order)[relative[:, k]] for k, order in enumerate(orders)])
    matrix = 0.5**(relative @ powers)
    weights = np.linalg.solve(matrix.T, np.eye(len(levels))[0])
    return sum(weight * values[tuple(level)] for weight, level in zip(weights, levels))


def triangle(first, size):
    """Return the levels (i, j) = first + (a, b) with a + b < size, shape (n, 2)."""
    return np.array(sorted((first[0] + i, first[1] + j) for i, j in product(range(size), repeat=2)
                           if i + j < size))


def reference(scene, duration, period, columns, elements, step, drive=None, axial_factor=1.0):
    """Return the extrapolated columns, shape (n_t, n), their names, and a comment for the file."""
    levels, values = triangle((0, 0), LEVELS), {}
    orders = DAMPED if drive else TRAPEZOIDAL
    for i, j in levels.tolist():
        run = finite_elements.simulate(
            scene, elements * 2**i, step / 2**j, duration, round(period * 2**j / step), drive,
            tolerance=1e-11, axial_factor=axial_factor)
        values[i, j] = np.stack([run[name] for name in columns], axis=1)
        print(f'{elements * 2**i} elements, {step / 2**j:g} s: {run["solver_seconds"]:.1f} s',
              flush=True)
    best = extrapolate(values, levels, orders)
    error = np.zeros(len(columns))
    for corner in ((0, 1), (1, 0)):
        coarse = extrapolate(values, triangle(corner, LEVELS - 1), orders)
        error = np.maximum(error, np.abs(coarse - best).max(axis=0))
    bounds = ', '.join(f'{name} {bound:.0e}' for name, bound in zip(columns[1:], error[1:]))
    return best, columns, (
        f'exudyn {exudyn.__version__}, ObjectBeamGeometricallyExact2D, '
        f'{"generalized-alpha, spectral radius 0.9" if drive else "trapezoidal rule"}: '
        f'{elements} 2^i elements, {step:g}/2^j s, i + j < {LEVELS}, extrapolated; differs '
        f'from the extrapolation with one level less by up to: {bounds}')


def modes(scene):
    """Return six modes as rows, shape (6, 84), names of the columns, and a comment."""
    frequency, *shapes = finite_elements.modes(scene, 200, 6)
    coarse, fine = (finite_elements.modes(scene, count, 6)[0] for count in (100, 400))
    limit, rough = (4.0 * fine - frequency) / 3.0, (4.0 * frequency - coarse) / 3.0
    limit += (limit - rough) / 15.0
    print('modes', coarse, frequency, fine, limit, (limit - rough) / limit)
    columns = ['f_hz', 'f_extrapolated_hz', *(f'{name}_{i}' for name in ('W', 'Phi')
                                              for i in range(41))]
    rows = np.column_stack([frequency, limit, *(shape[:, ::5] for shape in shapes)])
    return rows, columns, (
        f'exudyn {exudyn.__version__}, ObjectBeamGeometricallyExact2D, 200 elements, mass-'
        'normalised, W [1/sqrt(kg)] and Phi [1/(m sqrt(kg))] at xi = 0, l/40, ..., l; '
        'f_extrapolated_hz from 100, 200 and 400 elements')


def inextensible(scene, duration, period, columns):
    """Return the spin-up reference of an arm that does not stretch, as `reference` does."""
    # The effect of the axial compliance is linear in it: 8e-5 m in w(l), a tenth with 10 E A.
    (soft, *_), (stiff, _, comment) = (
        reference(scene, duration, period, columns, 40, 0.005, spin_up(), factor)
        for factor in (1.0, 10.0))
    rows = stiff + (stiff - soft) / 9.0
    bounds = ', '.join(f'{name} {bound:.0e}' for name, bound in zip(
        columns[1:], np.abs(stiff - soft).max(axis=0)[1:]))
    return rows, columns, (
        f'{comment}; with 10 E A, and extrapolated from E A to an inextensible arm, '
        f'their difference: {bounds}')


def write(path, rows, columns, comment):
    """Write a table with 9 significant digits, a comment in its first line."""
    np.savetxt(path, rows, '%.9g', ',', header=f'# {comment}\n{",".join(columns)}', comments='')
    print(f'{path}: {comment}', flush=True)


def main():
    """Write the files that the command line names, or all, to a folder."""
    command = parser(__spec__, __doc__)
    command.add_argument('folder', nargs='?', type=Path, default=ROOT / 'test' / 'data')
    command.add_argument('only', nargs='*', metavar='name',
                         help='modes, spin_up, torque, pendulum, cantilever, paper')
    given = command.parse_args()
    paper = load_scene(ROOT / 'config' / 'paper.yaml')
    spin_up_scene = load_scene(ROOT / 'config' / 'spin_up.yaml', {'initial.shaft': 0.0})
    whole, tip = ('t', *RIGID, *INNER, *TIP), ('t', *RIGID, *TIP)
    files = {
        'modes': lambda: modes(paper),
        'spin_up': lambda: inextensible(spin_up_scene, 20.0, 0.02, ('t', *TIP)),
        'torque': lambda: reference(load_scene(TORQUE), 5.0, 0.01, tip, 104, 0.00025),
        'pendulum': lambda: reference(load_scene(PENDULUM), 5.0, 0.01, tip, 104, 0.00025),
        'cantilever': lambda: reference(load_scene(CANTILEVER), 3.0, 0.02, ('t', *TIP), 416,
                                        0.00025),
        'paper': lambda: reference(paper, 10.0, 0.01, whole, 52, 0.0005),
    }
    for name in given.only or files:
        write(given.folder / f'finite_elements_{name}.csv', *files[name]())


if __name__ == '__main__':
    main()
