"""
Errors in the paper's scene against finite elements, and what a step costs: `make accuracy`.

The peer in the same run is the cost of one compiled 16 x 16 matrix-vector product, because
absolute times differ from machine to machine and from minute to minute.
"""

from pathlib import Path
import platform
import statistics
import time

import numba
import numpy as np

import timo_sim
from timo_sim.simulation import Simulator

ROOT = Path(__file__).resolve().parents[1]
CASES = [('exact', 2, 0.010), ('exact', 3, 0.010), ('exact', 3, 0.005), ('exact', 5, 0.010),
         ('exact', 5, 0.005), ('exact', 5, 0.001), ('newton', 3, 0.010)]
REPEATS = 15


@numba.njit
def products(matrix, vector, count):
    """Do matrix-vector products that depend on each other; return one element."""
    size = len(vector)
    out = np.zeros(size)
    for _ in range(count):
        for i in range(size):
            total = 0.0
            for j in range(size):
                total += matrix[i, j] * vector[j]
            out[i] = total
        vector, out = out, vector
    return vector[0]


def product_time():
    """Return the time of one product [s]."""
    matrix, count = np.eye(16) * 0.5, 20000
    start = time.perf_counter()
    products(matrix, np.ones(16), count)
    return (time.perf_counter() - start) / count


def main():
    """Print a Markdown table."""
    names, *rows = (ROOT / 'test' / 'data' / 'reference_table4.csv').read_text().split()
    columns = np.array([row.split(',') for row in rows], dtype=float).T
    reference = dict(zip(names.split(','), columns))
    product_time()
    print(f'{platform.machine()}, Python {platform.python_version()}, numba {numba.__version__}\n')
    print('| formulation | N | h ms | x_c m | theta rad | w(l) m | us per step, min / median '
          '| in products |')
    print('|---|---|---|---|---|---|---|---|')
    for formulation, modes, step in CASES:
        scene = timo_sim.load_scene(ROOT / 'config' / 'paper.yaml', {
            'model.formulation': formulation, 'model.modes': modes, 'integrator.step': step})
        run = timo_sim.simulate(scene, 10.0, every=round(0.01 / step))
        errors = [np.abs(run.carrier[:, 0] - reference['x_c_m']).max(),
                  np.abs(run.shaft - reference['theta_rad']).max(),
                  np.abs(run.deflection(2.0)[:, 1] - reference['w_l_m']).max()]
        simulator = Simulator(scene)
        loads = simulator.scene_loads(1000).copy()
        times, units = [], []
        for _ in range(REPEATS):
            units.append(product_time())
            start = time.perf_counter()
            simulator.advance(loads)
            times.append((time.perf_counter() - start) / len(loads))
        median = statistics.median(times)
        print(f'| {formulation} | {modes} | {1e3 * step:g} '
              f'| {" | ".join(f"{error:.1e}" for error in errors)} '
              f'| {1e6 * min(times):.1f} / {1e6 * median:.1f} '
              f'| {median / statistics.median(units):.0f} |')


if __name__ == '__main__':
    main()
