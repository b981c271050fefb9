# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Figs. 6 to 10 and 13: motion of sections, and the effect of the wrong axial force on it."""

import matplotlib.pyplot as plt
import numpy as np

from benchmark.figures.paper.style import BLACK, COLOURS, MODES, NAMES, save
from oracles.references import LENGTH, motion_of, peak, simulate, STATIONS


def histories(t, runs, truth, fem):
    """Return Figs. 6 to 10."""
    text = ''
    motions = {name: motion_of(run) for name, run in runs.items()}

    def draw(axis, theirs, ours, title):
        axis.plot(t, theirs, color=BLACK, lw=2.2, alpha=0.35, label='finite elements')
        for (name, values), style in zip(ours.items(), ('-', '--')):
            axis.plot(t, values, style, color=COLOURS[name], label=f'{name}, N = {MODES}')
        axis.set_title(title, fontsize=9)

    for number, label, pick in (
            ('06', 'horizontal position [m]', lambda motion: motion[0][:, 0]),
            ('07', 'vertical position [m]', lambda motion: motion[0][:, 1]),
            ('08', 'angular position [deg]', lambda motion: np.degrees(motion[1]))):
        figure, axes = plt.subplots(2, 3, figsize=(10, 4.8), sharex=True)
        for axis, name in zip(axes.flat, STATIONS):
            draw(axis, pick(truth[name]), {key: pick(motion[name])
                                           for key, motion in motions.items()},
                 f'xi = {NAMES[name]}')
        label_times(axes)
        for axis in axes[:, 0]:
            axis.set_ylabel(label)
        text += save(figure, number, f'Fig. {int(number)}: {label} of five sections') + '\n'

    inner = list(STATIONS)[1:]
    for number, label, ours, theirs in (
            ('09', 'transverse deflection [mm]',
             lambda run, name: 1e3 * run.deflection(STATIONS[name] * LENGTH)[:, 1],
             lambda name: 1e3 * fem[f'w_{name}_m']),
            ('10', 'section rotation [deg]',
             lambda run, name: np.degrees(run.rotation(STATIONS[name] * LENGTH)),
             lambda name: np.degrees(fem[f'phi_{name}_rad']))):
        figure, axes = plt.subplots(2, 2, figsize=(9, 4.8), sharex=True)
        for axis, name in zip(axes.flat, inner):
            draw(axis, theirs(name), {key: ours(run, name) for key, run in runs.items()},
                 f'xi = {NAMES[name]}, peak {peak(t, theirs(name)):.2f}')
        for axis in axes[1]:
            axis.set_xlabel('t [s]')
        for axis in axes[:, 0]:
            axis.set_ylabel(label)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=3)
        text += save(figure, number, f'Fig. {int(number)}: {label} of four sections') + '\n'
    return text


def label_times(axes):
    """Label the time axes of five panels (2, 3); the room of the sixth is for the legend."""
    axes[0, 2].tick_params(labelbottom=True)
    axes[1, 2].axis('off')
    axes[1, 2].legend(*axes[0, 0].get_legend_handles_labels(), loc='center', fontsize=9)
    for axis in (axes[1, 0], axes[1, 1], axes[0, 2]):
        axis.set_xlabel('t [s]')


def wrong_axial(t, fem, newton):
    """Return Fig. 13 and its verdict."""
    run = simulate('newton_rigid_axial', MODES)
    figure, axes = plt.subplots(2, 3, figsize=(10, 4.8), sharex=True)
    panels = [
        ('x_c [m]', lambda r: r.carrier[:, 0], fem['x_c_m']),
        ('y_c [m]', lambda r: r.carrier[:, 1], fem['y_c_m']),
        ('theta [deg]', lambda r: np.degrees(r.shaft), np.degrees(fem['theta_rad'])),
        ('w(l) [mm]', lambda r: 1e3 * r.deflection(LENGTH)[:, 1], 1e3 * fem['w_l_m']),
        ('phi(l) [deg]', lambda r: np.degrees(r.rotation(LENGTH)), np.degrees(fem['phi_l_rad'])),
    ]
    for axis, (label, pick, theirs) in zip(axes.flat, panels):
        axis.plot(t, theirs, color=BLACK, lw=2.2, alpha=0.35, label='finite elements')
        axis.plot(t, pick(newton), color=COLOURS['newton'], label='newton, (34)')
        axis.plot(t, pick(run), '--', color=COLOURS['newton_rigid_axial'],
                  label='newton_rigid_axial, (35)')
        axis.set_ylabel(label)
    label_times(axes)
    text = save(figure, '13', 'Fig. 13: the wrong axial assumption (35)')
    moved = np.abs(run.carrier - newton.carrier).max(axis=0)
    kept = max(np.abs(run.shaft - newton.shaft).max(), np.abs(
        run.deflection(LENGTH) - newton.deflection(LENGTH)).max())
    verdict = ('Fig. 13: (35) moves the carrier, not the angles and deflections',
               'significant error in x, y only',
               f'{moved[0]:.2f} m in x, {moved[1]:.2f} m in y; {kept:.0e} in theta, w', '',
               'agrees' if moved.min() > 0.1 and kept < 1e-9 else 'does not agree')
    return text, verdict
