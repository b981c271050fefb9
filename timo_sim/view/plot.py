# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A run as a figure: curves over time, and the arm in the plane."""

from matplotlib.figure import Figure
import numpy as np

# Okabe and Ito's colours, which colour-blind readers tell apart.
COLOURS = '#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9'
_ARMS, _POINTS = 8, 41  # shapes of the arm that are drawn, and points of each


def plot(run):
    """
    Draw a run.

    Parameters
    ----------
    run : Run

    Returns
    -------
    matplotlib.figure.Figure

    """
    length = run.scene.manipulator.arm.length
    curves = {
        'tip': ('tip deflection [m]', {'axial': run.deflection(length)[:, 0],
                                       'transverse': run.deflection(length)[:, 1]}),
        'shaft': ('shaft angle [rad]', {'theta': run.shaft}),
        'carrier': ('carrier [m]', {'x': run.carrier[:, 0], 'y': run.carrier[:, 1]})}
    held = run.model.constrained
    if held[:2].any():
        curves['force'] = 'holding force [N]', {
            axis: run.effort[:, k] for k, axis in enumerate('xy') if held[k]}
    if held[2]:
        curves['torque'] = 'holding torque [N m]', {'torque': run.effort[:, 2]}
    figure = Figure(figsize=(12, 1 + 2 * len(curves)), layout='constrained')
    axes = figure.subplot_mosaic([[name, 'plane'] for name in curves], width_ratios=[3, 2])
    for name, (label, lines) in curves.items():
        for (line, values), colour in zip(lines.items(), COLOURS):
            axes[name].plot(run.t, values, color=colour, label=line)
        axes[name].set(ylabel=label, xlim=(run.t[0], run.t[-1] or 1.0))
        axes[name].grid(alpha=0.3)
        if len(lines) > 1:
            axes[name].legend(fontsize='small')
    axes[[*curves][-1]].set(xlabel='time [s]')

    xi = np.linspace(0.0, length, _POINTS)
    shapes = run.position(xi)
    axes['plane'].plot(*shapes[:, -1].T, color=COLOURS[5], linewidth=0.8, label='path of the tip')
    picked = np.unique(np.linspace(0, len(run.t) - 1, _ARMS).astype(int))
    for number, k in enumerate(picked):
        axes['plane'].plot(*shapes[k].T, color=COLOURS[0], alpha=(1 + number) / len(picked),
                           label=f'arm until t = {run.t[-1]:g} s' if k == picked[-1] else None)
    axes['plane'].plot(*shapes[picked, 0].T, 's', color='0.3', markersize=4, label='carrier')
    axes['plane'].set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
    axes['plane'].legend(fontsize='small')
    axes['plane'].grid(alpha=0.3)
    return figure
