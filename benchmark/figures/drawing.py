# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What pictures of the gallery have in common: sheet, colours, the arm in the plane."""

import matplotlib
import numpy as np

from benchmark import ROOT

matplotlib.use('Agg')
# Okabe-Ito colours, which colour-blind readers tell apart, and grey for the background.
BLUE, ORANGE, GREEN, GREY = '#0072B2', '#D55E00', '#009E73', '#999999'
FOLDER = ROOT / 'doc' / 'gallery'


def sheet(title, ratio=1.0):
    """Return a figure, its plane of motion on the left, and its axes of time on the right."""
    import matplotlib.pyplot as plt
    plt.rcParams.update({'font.size': 15, 'axes.grid': True, 'grid.alpha': 0.3,
                         'lines.linewidth': 2.0, 'legend.fontsize': 13})
    figure, (plane, time) = plt.subplots(1, 2, figsize=(12.0, 5.2), layout='constrained',
                                         width_ratios=[ratio, 1.6])
    figure.suptitle(title, fontsize=18)
    plane.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
    time.set(xlabel='t [s]')
    return figure, plane, time


def draw_arm(plane, run, sample, colour, alpha=1.0, label=None, body=True):
    """Draw carrier, bent arm and end effector of a sample."""
    length = run.scene.manipulator.arm.length
    line = run.model.world(run.motion[[sample]], run.model.at(
        np.linspace(0.0, length, 41)))[0]
    plane.plot(*line.T, color=colour, alpha=alpha, lw=3, label=label, solid_capstyle='round')
    plane.plot(*line[-1], 'o', color=colour, alpha=alpha, ms=11)
    if body:
        plane.plot(*line[0], 's', color=colour, alpha=alpha, ms=12)


def save(figure, name):
    """Write a picture."""
    import matplotlib.pyplot as plt
    FOLDER.mkdir(exist_ok=True)
    figure.savefig(FOLDER / f'{name}.png', dpi=100)
    plt.close(figure)
