# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Energy drift of fast arms without loads and damping, over modes and step: `make stability`.

A run lasts 5 s; energy should not change. Numbers in brackets are h omega of the highest mode.
"""

import numpy as np

from benchmark.command import parser
import timo_sim

LENGTH, DURATION = 2.0, 5.0
SCENES = [(30.0, 5.0), (100.0, 2.0)]  # shaft speed [rad/s], speed of the tip [m/s]
MODES, STEPS = (3, 5, 8, 12, 20), (0.010, 0.005, 0.002, 0.001, 0.0005, 0.0002)


def drift(modes, step, speed, velocity):
    """
    Return the largest relative change of energy, infinite if the run diverges.

    Units: `step` [s], `speed` of the shaft [rad/s], `velocity` of the bending tip [m/s].
    """
    values = {'model.modes': modes, 'integrator.step': step, 'initial.shaft_velocity': speed}
    rates = timo_sim.project_on_modes(
        timo_sim.load_scene(values),
        lambda xi: velocity * (1.5 * (xi / LENGTH)**2 - 0.5 * (xi / LENGTH)**3),
        lambda xi: velocity * (3.0 * (xi / LENGTH) - 1.5 * (xi / LENGTH)**2) / LENGTH)
    scene = timo_sim.load_scene(values, {'initial.modal_rates': rates})
    try:
        energy = timo_sim.simulate(scene, DURATION).energy()
    except timo_sim.DivergenceError:
        return np.inf
    return np.abs(energy / energy[0] - 1.0).max()


def table(speed, velocity, modes=MODES, steps=STEPS):
    """Print a Markdown table."""
    print(f'\nshaft {speed:g} rad/s, tip {velocity:g} m/s\n')
    print('| N | ' + ' | '.join(f'{1e3 * step:g} ms' for step in steps) + ' |')
    print('|---|' + '---|' * len(steps))
    for count in modes:
        highest = timo_sim.load_scene({'model.modes': count}).build().modes.omega[-1]
        cells = []
        for step in steps:
            change = drift(count, step, speed, velocity)
            shown = f'{change:.0e}' if change < 1.0 else 'diverges'
            cells.append(f'{shown} ({highest * step:.2g})')
        print(f'| {count} | ' + ' | '.join(cells) + ' |')


def main():
    """Print a table for each scene."""
    quick = parser(__spec__, __doc__, 'few modes and steps').parse_args().quick
    for speeds in SCENES:
        table(*speeds, *((MODES[:2], STEPS[:4]) if quick else ()))


if __name__ == '__main__':
    main()
