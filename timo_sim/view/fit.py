# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of fits: what was measured and what is predicted."""

from collections.abc import Callable, Sequence
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from timo_sim.view.plot import DIFFERENCE, MEASURED, PREDICTED

_MOST_SWINGS, _SWINGS = 25, 8  # that can be read in a record, and of a detail of it


def draw_fit(predictions: Sequence[Any], unit_of: Callable[[str], str]) -> Figure:
    """
    Draw records in columns, whose rows are inputs and outputs; what was held out is grey.

    A single record with too many swings to read has a second column, a detail of it.

    `predictions` are as `timo_sim.fitting.result.Prediction`; `unit_of` gives units of quantities.
    """
    inputs, outputs = ([*dict.fromkeys(
        name for each in predictions for name in getattr(each.record, kind))]
        for kind in ('inputs', 'outputs'))
    rows, parts = [*inputs, *outputs], [(each, (0.0, each.record.duration))
                                        for each in predictions]
    detail = _detail(predictions[0]) if len(predictions) == 1 and (
        predictions[0].predicted) else None
    if detail is not None:
        parts.append((predictions[0], detail))
    figure = Figure(figsize=(max(8.4, 6.0 * len(predictions)), 1.0 + 1.7 * len(rows)),
                    layout='constrained')
    every = figure.subplots(len(rows), len(parts), sharex='col', sharey='row', squeeze=False,
                            height_ratios=[0.6] * len(inputs) + [1.0] * len(outputs),
                            width_ratios=None if detail is None else [2, 1])
    for number, ((prediction, part), column) in enumerate(zip(parts, every.T), 1):
        record = prediction.record
        for axes, name in zip(column, rows):
            channel = {**record.inputs, **record.outputs}.get(name)
            title = f'record {number}, {record.source}' if len(
                predictions) > 1 and axes is column[0] else ''
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
            axes.plot(channel.t, channel.values, color=MEASURED, label='measured', linewidth=2.5)
            if name in prediction.predicted:
                shown = prediction.predicted[name]
                axes.plot(channel.t, shown, color=PREDICTED, linewidth=1.2,
                          label='predicted, drawn over it')
                axes.plot(channel.t, channel.values - shown, color=DIFFERENCE, linewidth=0.8,
                          label='difference')
            each = prediction.errors[name]
            text = 'R² = ' + ', '.join(f'{value:.3f} {half}' for value, half in (
                (each.r_squared, 'fitted'), (each.hold_out_r_squared, 'held out'))
                if np.isfinite(value))
            axes.set_title(f'{title}\n{text}'.strip() if part is not detail else
                           'where it is worst' * (name == rows[-1]), loc='left', fontsize='medium')
        column[-1].set(xlabel='time [s]', xlim=part)
    figure.legend(*axes.get_legend_handles_labels(), loc='outside upper right', ncols=3,
                  frameon=False)
    return figure


def _detail(prediction):
    """Return begin and end [s] of a detail, where the last output, if it swings, is worst."""
    name, shown = [*prediction.predicted.items()][-1]
    t, values, *_ = prediction.record.outputs[name]
    far = values[np.abs(values - values.mean()) > 0.3 * values.std()] > values.mean()
    swings = 0.5 * np.count_nonzero(np.diff(far))
    if swings < _MOST_SWINGS:
        return None
    # Of a record that is held out in part, that part.
    asked = (t >= prediction.until) | (prediction.until >= t[-1])
    worst, half = t[np.where(asked, np.abs(values - shown), 0.0).argmax()], (
        0.5 * t[-1] * _SWINGS / swings)
    return np.clip(worst, half, t[-1] - half) + [-half, half]


def draw_responses(predictions: Sequence[Any]) -> Figure:
    """Return a Figure: measured points and predicted curves, a column for each response."""
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
