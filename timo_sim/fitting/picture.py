# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The picture of a fit: what was measured, what a run predicts, and their difference."""

from typing import Any

from matplotlib.figure import Figure
import numpy as np

from timo_sim.fitting.record import unit_of
from timo_sim.view.plot import COLOURS

_SHOWN = {'tip_transverse': 'tip deflection', 'tip_angle': 'tip angle',
          'tip_acceleration': 'tip acceleration'}


def plot(fit: Any) -> Figure:
    """Return a Figure of a Fit; the part of the record that was held out is shaded."""
    record = fit.record
    rows = [*record.inputs, *record.outputs]
    figure = Figure(figsize=(12, 1.0 + 2.2 * len(rows)), layout='constrained')
    heights = [0.6 if name in record.inputs else 1.0 for name in rows]
    all_axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False,
                               height_ratios=heights)[:, 0]
    for axes, name in zip(all_axes, rows):
        unit = unit_of(name)
        axes.set(ylabel=f'{_SHOWN.get(name, name.replace("_", " "))}' + (
            f' [{unit}]' if unit else ''), xlim=(0.0, record.duration))
        axes.grid(alpha=0.3)
        if fit.until < record.duration:
            axes.axvspan(fit.until, record.duration, color='0.93', zorder=0)
        if name in record.inputs:
            channel = record.inputs[name]
            axes.plot(channel.t, channel.values, color='0.4', linewidth=1.0,
                      drawstyle='steps-post' if channel.hold == 'zero' else 'default')
            continue
        channel = record.outputs[name]
        axes.plot(channel.t, channel.values, color=COLOURS[0], label='measured', linewidth=2.0)
        if name in fit.predicted:
            axes.plot(channel.t, fit.predicted[name], color=COLOURS[1], linewidth=1.2,
                      label='predicted')
            axes.plot(channel.t, channel.values - fit.predicted[name], color=COLOURS[2],
                      linewidth=0.8, label='difference')
        each = fit.errors[name]
        text = f'R² = {each.r_squared:.3f} fitted'
        if np.isfinite(each.hold_out_r_squared):
            text += f', {each.hold_out_r_squared:.3f} held out'
        axes.legend(fontsize='small', ncols=3, frameon=False, loc='lower right',
                    bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
        axes.set_title(text, loc='left', fontsize='small')
    all_axes[-1].set(xlabel='time [s]')
    return figure
