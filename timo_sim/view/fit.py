# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of fits: what was measured and what is predicted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TYPE_CHECKING

import numpy as np

from timo_sim.extras import optional

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_fit(predictions: Sequence[Any], unit_of: Callable[[str], str]) -> Figure:
    """
    Draw records in columns, whose rows are inputs and outputs; what was held out is grey.

    `predictions` are as `timo_sim.fitting.result.Prediction`; `unit_of` gives units of quantities.
    """
    with optional():
        from matplotlib.figure import Figure

        from timo_sim.view.plot import COLOURS
    inputs, outputs = ([*dict.fromkeys(
        name for each in predictions for name in getattr(each.record, kind))]
        for kind in ('inputs', 'outputs'))
    rows, count = [*inputs, *outputs], len(predictions)
    figure = Figure(figsize=(max(12, 8 * count), 1.0 + 2.2 * len(rows)), layout='constrained')
    every = figure.subplots(len(rows), count, sharex='col', sharey='row', squeeze=False,
                            height_ratios=[0.6] * len(inputs) + [1.0] * len(outputs))
    for number, (prediction, column) in enumerate(zip(predictions, every.T), 1):
        record = prediction.record
        for axes, name in zip(column, rows):
            channel = {**record.inputs, **record.outputs}.get(name)
            title = f'record {number}, {record.source}' if count > 1 and axes is column[0] else ''
            axes.set_title(title, loc='left', fontsize='medium')
            axes.grid(alpha=0.3)
            if prediction.until < record.duration:
                axes.axvspan(prediction.until, record.duration, color='0.93', zorder=0)
            if number == 1:
                label = 'tip deflection' if name == 'tip_transverse' else name.replace('_', ' ')
                axes.set_ylabel(f'{label} [{unit_of(name)}]' if unit_of(name) else label)
            if channel is None:
                continue
            if name in record.inputs:
                axes.plot(channel.t, channel.values, color='0.4', linewidth=1.0,
                          drawstyle='steps-post' if channel.hold == 'zero' else 'default')
                continue
            axes.plot(channel.t, channel.values, color=COLOURS[0], label='measured', linewidth=2.0)
            if name in prediction.predicted:
                shown = prediction.predicted[name]
                axes.plot(channel.t, shown, color=COLOURS[1], linewidth=1.2, label='predicted')
                axes.plot(channel.t, channel.values - shown, color=COLOURS[2], linewidth=0.8,
                          label='difference')
            each = prediction.errors[name]
            text = 'R² = ' + ', '.join(f'{value:.3f} {part}' for value, part in (
                (each.r_squared, 'fitted'), (each.hold_out_r_squared, 'held out'))
                if np.isfinite(value))
            axes.legend(fontsize='medium', ncols=3, frameon=False, loc='lower right',
                        bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
            axes.set_title(f'{title}\n{text}'.strip(), loc='left', fontsize='medium')
        column[-1].set(xlabel='time [s]', xlim=(0.0, record.duration))
    return figure


def draw_responses(predictions: Sequence[Any]) -> Figure:
    """Return a Figure: measured points and predicted curves, a column for each response."""
    with optional():
        from matplotlib.figure import Figure
    figure = Figure(figsize=(7 * len(predictions), 7), layout='constrained')
    for (size, phase), prediction in zip(figure.subplots(
            2, len(predictions), sharex='col', squeeze=False).T, predictions):
        record = prediction.record
        for name, channel in record.outputs.items():
            measured, found = (record.response(name, values) for values in (
                channel.values, prediction.predicted[name]))
            line, = size.loglog(channel.t[::2], np.abs(found), label=name)
            size.loglog(channel.t[::2], np.abs(measured), '.', color=line.get_color())
            for values, style in (found, '-'), (measured, '.'):
                phase.semilogx(channel.t[::2], np.degrees(np.unwrap(np.angle(values))), style,
                               color=line.get_color())
        size.set(title=record.source, ylabel=f'gain from {", ".join(record.inputs)}')
        phase.set(xlabel='frequency [Hz]', ylabel='phase [deg]')
        size.legend()
        for axes in (size, phase):
            axes.grid(alpha=0.3)
    return figure
