# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Draw the pictures of doc/modes.md and fill its table: shapes, spinning arms, convergence.

The truth is the finite elements of `test/oracles/linear_beam.py`.
"""

import numpy as np

from benchmark.drawing import BLACK, MEASURED, PREDICTED, save, sheet
from benchmark.report import fill, parser, table
from oracles.linear_beam import spinning, WRIGHT
import timo_sim

BARE = {'arm.length': 1.0, 'arm.section.width': 0.01, 'arm.section.height': 0.001,
        'end_effector.mass': 0.0,
        'end_effector.inertia': 0.0}
COUNTS = 3, 5, 8, 12
SPEEDS = 1.0, 2.0, 4.0  # over the first frequency at rest


def draw_spinning():
    """Draw the frequencies of a bare arm over the speed, with tables and finite elements."""
    scene = timo_sim.load_scene({}, {**BARE, 'model.modes': 12})
    section = scene.manipulator.arm.section
    unit = np.sqrt(section.bending_stiffness / section.mass_per_length)
    speed = np.linspace(0.0, 12.0, 25)
    found = np.array([timo_sim.modes(scene, unit * each).omega[:3] for each in speed]) / unit
    at = speed[1::2]
    truth = np.array([spinning(scene, unit * each, 3) / unit for each in at])
    figure, panels = sheet(1, 3, 3.4)
    for n, axes in enumerate(panels):
        axes.plot(at, truth[:, n], '+', color=MEASURED, ms=11, mew=2, label='finite elements')
        axes.plot([*WRIGHT], [np.sqrt(row[n]**2 - each**2) for each, row in WRIGHT.items()],
                  'o', color=BLACK, mfc='none', label='Wright et al. 1982')
        axes.plot(speed, found[:, n], color=PREDICTED, label='timo_sim, N = 12, through both')
        axes.set_title(f'mode {n + 1}')
        axes.grid(alpha=0.3)
    panels[0].set(ylabel='frequency / $\\sqrt{E I / (\\rho A l^4)}$')
    panels[1].set(xlabel='speed / $\\sqrt{E I / (\\rho A l^4)}$')
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=3,
                  frameon=False)
    save(figure, 'spinning')


def convergence():
    """Return the table of errors of the first two frequencies by the number of modes."""
    rows = []
    for name, values in ('bare, 1/1000 thin', BARE), ("the paper's", {'model.axial_modes': 1}):
        scene = timo_sim.load_scene({}, values)
        first = timo_sim.modes(scene, 0.0).omega[0]
        for share in SPEEDS:
            truth, cells = spinning(scene, share * first, 2), []
            for count in COUNTS:
                found = timo_sim.modes(scene.vary({'model.modes': count}), share * first)
                error = np.abs(found.omega[:2] / truth - 1.0)
                cells.append(', '.join(f'{each:.0e} ({stated:.0e})'
                                       for each, stated in zip(error, found.error)))
            rows.append([name, f'{share:g}', *cells])
    return table(['arm', 'speed over first frequency', *(f'N = {count}' for count in COUNTS)],
                 rows)


def main():
    """Draw the pictures and fill the table."""
    parser(__spec__, __doc__).parse_args()
    scene = timo_sim.load_scene('paper', {'arm.damping_ratio': 0.01})
    save(timo_sim.modes(scene).plot(), 'modes')
    draw_spinning()
    fill('modes.md', 'convergence', convergence())


if __name__ == '__main__':
    main()
