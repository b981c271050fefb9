# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Bode diagram and pole map of a linear model, as a picture."""

import matplotlib
import numpy as np

matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402

# Okabe and Ito's colours, which colour-blind readers tell apart.
_COLOURS = '#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9'
_FREQUENCIES = 4000


def draw(model, path):
    """
    Draw what the first input of a model does to its outputs, and the model's poles.

    Parameters
    ----------
    model : LinearModel
    path : str or Path
        PNG, PDF or SVG.

    """
    poles = model.poles()
    vibrating = np.abs(poles[np.abs(poles) > 1.0]) / (2.0 * np.pi)
    ends = (0.1, 100.0) if not len(vibrating) else (0.1 * vibrating[0], 3.0 * vibrating[-1])
    frequency = np.geomspace(ends[0], ends[1], _FREQUENCIES)
    response = model.frequency_response(frequency)

    figure, axes = plt.subplot_mosaic([['size', 'poles'], ['phase', 'poles']], figsize=(12, 6),
                                      width_ratios=[2, 1], layout='constrained')
    for name, values, colour in zip(model.outputs, response[:, :, 0].T, _COLOURS):
        axes['size'].loglog(frequency, np.abs(values), color=colour, label=name)
        # Turned a little, so that round-off does not choose between 180 and -180 degrees.
        phase = np.angle(values * np.exp(-1e-3j)) + 1e-3
        axes['phase'].semilogx(frequency, np.degrees(phase), color=colour)
    axes['size'].set(ylabel=f'output per {model.inputs[0]}')
    axes['size'].legend(fontsize='small')
    axes['phase'].set(xlabel='frequency [Hz]', ylabel='phase [deg]', yticks=range(-180, 181, 90))
    axes['poles'].plot(poles.real, poles.imag / (2.0 * np.pi), 'x', color=_COLOURS[0])
    axes['poles'].set(xlabel='real part [1/s]', ylabel='imaginary part / 2 pi [Hz]',
                      title='poles')
    if np.abs(poles.real).max() < 1e-3 * np.abs(poles.imag).max():
        # Else round-off fills the width.
        axes['poles'].set(xlim=(-1.0, 1.0), xticks=(-1.0, 0.0, 1.0))
    for each in axes.values():
        each.grid(alpha=0.3)
    figure.savefig(path, dpi=100)
    plt.close(figure)
