# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Draw the arm in the paper's scene, and signs: `make picture` writes README.md's and fit.md's."""

import numpy as np

from benchmark import ROOT
from benchmark.drawing import BLUE, DIFFERENCE, GREY, MEASURED, PREDICTED, RED, save, sheet
from benchmark.report import parser
from oracles.references import read
import timo_sim
from timo_sim.view.plot import animate
from timo_sim.view.track import Track

LENGTH = 2.0
SCALE = 5.0  # of the drawn deflection


def main():
    """Draw the tip beside the reference, the plot of the first script, signs, and an animation."""
    parser(__spec__, __doc__).parse_args()
    run = timo_sim.simulate(timo_sim.load_scene('paper', {'model.modes': 5}), 10.0)
    save(run.plot(SCALE), 'run')
    run = timo_sim.simulate(timo_sim.load_scene('paper'), 4.0)
    animate([Track(run, 'paper', SCALE)], ROOT / 'doc' / 'arm.gif')
    _draw_arm()
    _draw_signs()


def _draw_arm():
    scene = timo_sim.load_scene(ROOT / 'config' / 'paper.yaml',
                                {'model.modes': 5, 'integrator.step': 0.005})
    run = timo_sim.simulate(scene, 10.0, sample_every=2)
    across, ours = read('paper')[1]['w_l_m'], run.deflection(LENGTH)[:, 1]
    figure, (time, rest) = sheet(2, height=4.6, sharex=True, height_ratios=[3, 2])
    time.plot(run.t, 1e3 * across, color=MEASURED, lw=3.5, label='finite elements')
    time.plot(run.t, 1e3 * ours, color=PREDICTED, lw=1.2, label='timo_sim, 5 modes, 5 ms, on them')
    rest.plot(run.t, 1e6 * (ours - across), color=DIFFERENCE, lw=1.0)
    time.set(ylabel='tip deflection w(l) [mm]', xlim=(0, 10))
    rest.set(xlabel='t [s]', ylabel='difference [\u00b5m]')
    time.legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    figure.align_ylabels()
    save(figure, 'arm')
    print(f'doc/arm.png; largest difference: {1e6 * np.abs(ours - across).max():.2f} um')


def _draw_signs():
    """Draw a bent arm with what is measured of it; every sign is positive."""
    shaft = np.radians(25.0)
    run = timo_sim.simulate(timo_sim.load_scene('paper', {
        'motor.shaft': 'locked', 'initial.shaft': shaft, 'initial.equilibrium': True,
        'carrier.held': 'both', 'end_effector.mass': 0.0, 'end_effector.inertia': 0.0,
        'load': {}, 'load.tip_force_y.piecewise': {'time': [0.0], 'value': [110.0]}}), 0.01)
    line = np.stack([run.position(x)[0] for x in np.linspace(0.0, LENGTH, 41)])
    side = np.gradient(line, axis=0) @ [[0.0, 1.0], [-1.0, 0.0]]
    side *= 0.035 / np.linalg.norm(side, axis=1)[:, None]
    root, tip = line[0], line[-1]
    seen, end = (np.arctan2(*(tip - point)[::-1]) for point in (root, line[-2]))
    along, beyond = (np.array([np.cos(angle), np.sin(angle)]) for angle in (shaft, end))

    figure, axes = sheet(height=5.3)
    axes.fill(*np.concatenate([line + side, (line - side)[::-1]]).T, color='#cfe3f1')
    axes.plot(*line.T, color=BLUE, lw=1)
    axes.plot(*(line - side)[1:7].T, color=RED, lw=6, solid_capstyle='butt')
    for ends, style in (((root, root + [2.0, 0.0]), '-'), ((root, root + 2.15 * along), '--'),
                        ((root, tip), ':'), ((tip, tip + 0.45 * along), '--'),
                        ((tip, tip + 0.45 * beyond), '-')):
        axes.plot(*np.array(ends).T, color=GREY, lw=0.8, ls=style)
    axes.plot(*root, 'o', color='k', ms=15)
    arrow = {'arrowstyle': '-|>', 'shrinkA': 0, 'shrinkB': 0}
    for centre, radius, *angles, name in ((root, 1.35, 0.0, shaft, 'shaft'),
                                          (root, 1.0, shaft, seen, 'tip_angle'),
                                          (tip, 0.4, shaft, end, 'tip_rotation'),
                                          (root, 0.2, -0.9, 1.2, '')):
        arc = np.linspace(*angles, 30)
        arc = np.column_stack([np.cos(arc), np.sin(arc)])
        axes.plot(*(centre + radius * arc).T, color='k', lw=1.5)
        axes.annotate('', *(centre + radius * arc)[[-1, -4]], arrowprops={**arrow, 'color': 'k'})
        axes.text(*(centre + (radius + 0.05) * arc[15]), name, va='center')
    foot = root + along * ((tip - root) @ along)
    axes.annotate('', tip, foot, arrowprops={**arrow, 'color': BLUE, 'lw': 2})
    axes.text(*(0.5 * (tip + foot) + [0.04, 0.0]), 'tip_transverse,\ntip_acceleration', color=BLUE)
    axes.annotate('root_strain: gauge on this side,\nstretched is positive', (line - side)[4],
                  root + [0.55, -0.3], color=RED, arrowprops={'arrowstyle': '-', 'color': RED})
    axes.text(*(root + [0.0, -0.28]), 'torque, voltage', ha='center')
    axes.text(*(root + [2.02, 0.0]), 'x', va='center')
    axes.set(aspect='equal', xlim=(-0.3, 2.5), ylim=(-0.35, 1.4))
    axes.axis('off')
    save(figure, 'signs')


if __name__ == '__main__':
    main()
