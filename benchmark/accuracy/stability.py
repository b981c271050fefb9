# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Energy drift of fast arms without loads and damping, over modes and step: `make stability`.

A run lasts 5 s; energy should not change. Numbers in brackets are h omega of the highest mode.
"""

import numpy as np

from benchmark.report import parser, table
import timo_sim

LENGTH, DURATION = 2.0, 5.0
SCENES = [(30.0, 5.0), (100.0, 2.0)]  # shaft speed [rad/s], speed of the tip [m/s]
MODES, STEPS = (3, 5, 8, 12, 20), (0.010, 0.005, 0.002, 0.001, 0.0005, 0.0002)


def cell(modes, step, speed, velocity):
    """
    Return the largest relative change of energy and h omega as text.

    Units: `step` [s], `speed` of the shaft [rad/s], `velocity` of the bending tip [m/s].
    """
    values = {'model.modes': modes, 'integrator.step': step, 'initial.shaft_velocity': speed}
    scene = timo_sim.load_scene(values)
    rates = timo_sim.project_on_modes(
        scene, lambda xi: velocity * (1.5 * (xi / LENGTH)**2 - 0.5 * (xi / LENGTH)**3),
        lambda xi: velocity * (3.0 * (xi / LENGTH) - 1.5 * (xi / LENGTH)**2) / LENGTH)
    try:
        energy = timo_sim.simulate(scene.vary({'initial.modal_rates': rates}), DURATION,
                                   estimate=False).energy()
        change = np.abs(energy / energy[0] - 1.0).max()
    except timo_sim.DivergenceError:
        change = np.inf
    return (f'{change:.0e}' if change < 1.0 else 'diverges') + (
        f' ({step * scene.build().modes.omega[-1]:.2g})')


def main():
    """Print a table for each scene."""
    quick = parser(__spec__, __doc__, 'few modes and steps').parse_args().quick
    modes, steps = (MODES[:2], STEPS[:4]) if quick else (MODES, STEPS)
    for speed, velocity in SCENES:
        print(f'\nshaft {speed:g} rad/s, tip {velocity:g} m/s\n')
        print(table(['N', *(f'{1e3 * step:g} ms' for step in steps)], [
            [count, *(cell(count, step, speed, velocity) for step in steps)] for count in modes]),
            flush=True)


if __name__ == '__main__':
    main()
