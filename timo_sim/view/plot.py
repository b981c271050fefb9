# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Figures of runs, linear models and vibrations, and animations as GIF."""

from collections.abc import Mapping, Sequence
from itertools import cycle
import math
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
import numpy as np
from PIL import Image

from timo_sim.model.layout import rotate, without_unit
from timo_sim.scene.files import whole_file
from timo_sim.scene.parameters import ParameterError
from timo_sim.view.track import FPS, Track

# Okabe and Ito's colours, which colour-blind readers tell apart.
COLOURS = '#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9'
MEASURED, PREDICTED, DIFFERENCE = COLOURS[:3]
_ARMS = 3  # shapes of the arm that are drawn
_FREQUENCIES = 4000
_GREY = '0.5'
_ABOVE = {'fontsize': 'small', 'frameon': False, 'loc': 'lower right',
          'bbox_to_anchor': (1.0, 1.0), 'borderaxespad': 0.0}


def plot(run: Any, deflection_scale: float = 1.0) -> Figure:
    """
    Return a Figure of a Run: curves of what can move or is held, and the arm in the plane.

    The plane shows the arm where it is bent most in each third of the run, with `deflection_scale`
    times its deflection; one that is not above 0 and at most 1e9 is a ParameterError.
    """
    track, panels, bend = Track(run, '', deflection_scale), _panels(run), run.deflection()
    parts = np.array_split(np.arange(len(run.t)), min(_ARMS, len(run.t)))
    size, near = np.abs(bend[:, 1]), len(parts[0]) // 4
    most = [part[size[part].argmax()] for part in parts]
    # Of two in one swing, at the border of two parts, the one that is bent more is drawn.
    most = [k for k in most if not any(
        abs(k - other) <= near and size[k] < size[other] for other in most)]
    shapes, straight = track.line(slice(None)), track.straight(np.array(most))
    extent, height = np.ptp(shapes, axis=(0, 1)), max(1.6 * len(panels), 5.0)
    width = min(max(height * extent[0] / max(extent[1], 0.1 * extent[0]), 2.5), 6.0)
    figure = Figure(figsize=(4.8 + width, height + 0.8), layout='constrained')
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=[4.8, width]))
    curves = left.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
    for axes, (label, lines) in zip(curves, panels.items()):
        for (line, values), colour in zip(lines.items(), COLOURS):
            axes.plot(run.t, values, color=colour, label=line)
        axes.set(ylabel=label, xlim=(run.t[0], run.t[-1] or 1.0))
        axes.grid(alpha=0.3)
        axes.legend(ncols=len(lines), **_ABOVE)
    curves[-1].set(xlabel='time [s]')

    plane = right.subplots()
    plane.plot(*shapes[:, -1].T, color=COLOURS[5], linewidth=0.8, label='path of the tip')
    for k, line, alpha in zip(most, straight, np.linspace(0.25, 1.0, len(most))):
        bent, = plane.plot(*shapes[k].T, '-o', color=COLOURS[0], alpha=alpha, linewidth=2.0,
                           markevery=[-1])
        rigid, = plane.plot(*line.T, '--', color=_GREY, linewidth=0.8)
    bent.set_label(f'arm, where bent most in each {(run.t[-1] - run.t[0]) / len(parts):.3g} s')
    rigid.set_label('arm, if it did not bend')
    plane.plot(*shapes[most, 0].T, 's', color='0.3', markersize=6, label='carrier')
    plane.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim',
              title=track.title)
    plane.grid(alpha=0.3)
    right.legend(fontsize='small', frameon=False, loc='outside upper right')
    return figure


def _panels(run):
    """Return the curves of each panel by its label, each (n,) by name."""
    held, force = run.model.constrained, run.effort
    turns = run.model.constraints.locked is None
    panels = {
        'tip deflection [m]': dict(zip(('axial', 'transverse'), run.deflection().T)
                                   if run.q.size else ()),
        'shaft angle [rad]': {'theta': run.shaft} if turns else {},
        'carrier [m]': {'xy'[k]: run.carrier[:, k] for k in (0, 1) if not held[k]},
        'holding force [N]': {'xy'[k]: force[:, k] for k in (0, 1) if held[k]},
        'holding torque [N m]': {'on the shaft': force[:, 2]} if held[2] else {}}
    return {label: lines for label, lines in panels.items() if lines}


def write(figure: Figure, path: Path | str) -> None:
    """Write a figure in the format of the file's suffix; an unknown one is a ParameterError."""
    try:
        with whole_file(path) as part:
            figure.savefig(part, dpi=100)
    except ValueError as error:
        raise ParameterError(f'{path} cannot be drawn: {error}') from None


def bode(model: Any, frequencies: np.ndarray) -> Figure:
    """
    Return a Figure: Bode diagram from a LinearModel's first input to its outputs, and poles.

    It ends a little above the last of the `frequencies` of the arm's modes, (n,) [Hz]: static
    shapes answer slow loads, and poles of their own above the modes are none of the arm.
    """
    poles = model.poles()
    vibrating = np.abs(poles[np.abs(poles) > 1.0]) / (2.0 * np.pi)
    lowest = 0.1 * vibrating[0] if len(vibrating) else 0.1
    highest = 1.2 * frequencies[-1] if len(frequencies) else 1e3 * lowest
    frequency = np.geomspace(lowest, highest, _FREQUENCIES)
    response = model.frequency_response(frequency)

    outputs = [without_unit(name) for name in model.outputs]
    cause, per = without_unit(model.inputs[0])
    per = f'({per})' if ' ' in per else per
    units = [*dict.fromkeys(unit for _, unit in outputs)]
    figure = Figure(figsize=(8.4, 2.5 + 1.5 * len(units)), layout='constrained')
    axes = figure.subplot_mosaic([[name, 'poles'] for name in (*units, 'phase')],
                                 width_ratios=[5, 2])
    for (name, unit), values, colour, style in zip(outputs, response[:, :, 0].T, cycle(COLOURS),
                                                   cycle(('-', '--', '-.', ':'))):
        axes[unit].loglog(frequency, np.abs(values), color=colour, label=name.replace('_', ' '))
        # Rotated by 1e-3 rad and back, so that round-off does not choose between +-180 degrees.
        phase = np.unwrap(np.angle(values * np.exp(-1e-3j))) + 1e-3
        phase -= 2.0 * np.pi * np.ceil((phase[0] - 0.5 * np.pi) / (2.0 * np.pi))
        axes['phase'].semilogx(frequency, np.degrees(phase), style, color=colour)
    for unit in units:
        if not any(np.any(line.get_ydata()) for line in axes[unit].lines):
            axes[unit].set_yscale('linear')  # zero is on no other, such as the strain of no modes
        axes[unit].set(ylabel=f'[{unit or 1} / {per}]')
        axes[unit].tick_params(labelbottom=False)
        axes[unit].legend(**_ABOVE)
    axes[units[0]].set(title=f'gain from {cause.replace("_", " ")}')
    axes['phase'].set(xlabel='frequency [Hz]', ylabel='phase [deg]')
    axes['phase'].yaxis.set_major_locator(MultipleLocator(90.0))
    axes['poles'].plot(poles.real, poles.imag / (2.0 * np.pi), 'x', color=COLOURS[0])
    axes['poles'].set(xlabel='real part [1/s]', ylabel='imaginary part / 2 pi [Hz]', title='poles')
    if np.abs(poles.real).max() < 1e-3 * np.abs(poles.imag).max():
        # Otherwise round-off of the real parts would fill the width.
        axes['poles'].set(xlim=(-1.0, 1.0), xticks=(-1.0, 0.0, 1.0))
    for each in axes.values():
        each.grid(alpha=0.3)
    return figure


_MOST_SHAPES, _POINTS = 6, 41  # shapes that are drawn, and points of each
_AMPLITUDE = 0.15  # largest displacement, in arm lengths


def shapes(vibrations: Any) -> Figure:
    """Return a Figure: the first shapes of Vibrations in the axes of the shaft, exaggerated."""
    model, count = vibrations.model, min(len(vibrations.poles), _MOST_SHAPES)
    xi = np.linspace(0.0, model.manipulator.arm.length, _POINTS)
    rest = np.vstack([np.zeros(2), model.centre_line(vibrations.motion.q, model.at(xi))])
    carrier = np.stack(rotate(-vibrations.motion.shaft, *vibrations.vectors[:, :2].T), axis=-1)
    moves = np.concatenate([carrier[:, np.newaxis], vibrations.shapes(xi)], axis=1).real
    figure = Figure(figsize=(6, 1 + 1.5 * max(1, count)), layout='constrained')
    panels = figure.subplots(max(1, count), sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, moved, frequency, damping in zip(
            panels, moves, vibrations.frequency, vibrations.damping):
        axes.plot(*rest.T, '--', color=_GREY, linewidth=1.0)
        for size, colour in (-_AMPLITUDE, COLOURS[5]), (_AMPLITUDE, COLOURS[0]):
            line = rest + size * xi[-1] * moved
            axes.plot(*line.T, color=colour, marker='.', markevery=4, markersize=4)
            axes.plot(*line[0], 's', color='0.3', markersize=4)
        axes.set(title=f'{frequency:.4g} Hz, damping {damping:.2g}', aspect='equal',
                 ylabel='across [m]')
        axes.grid(alpha=0.3)
    panels[-1].set(xlabel='along the arm [m]')
    return figure


def campbell(found: Mapping[Any, Any]) -> Figure:
    """Return a Figure: frequencies of Vibrations by speed [rad/s], and multiples of the speed."""
    figure = Figure(figsize=(7, 5), layout='constrained')
    axes = figure.subplots()
    for speed, each in found.items():
        axes.plot([speed] * len(each.poles), each.frequency, 'o', color=COLOURS[0], markersize=4)
    axes.set(ylim=(0.0, None), xlabel='shaft speed [rad/s]', ylabel='frequency [Hz]',
             title='dashed: 1, 2, 3, 4 times the speed')
    for multiple in range(1, 5):
        axes.axline((0.0, 0.0), slope=multiple / (2.0 * np.pi), color=_GREY, linestyle='--')
    axes.grid(alpha=0.3)
    return figure


_MOST_FPS = 20.0  # [Hz]; browsers play faster GIFs too slowly
_SIZE, _DPI = (8.0, 4.8), 80  # [inch], [1/inch]
_MARGIN = 0.1  # around what moves, in arm lengths
_COLOURS_PER_FRAME = 32


def animate(tracks: Sequence[Track], path: Path | str, fps: float = _MOST_FPS) -> None:
    """
    Write a GIF of tracks, laid over each other, in real time, at most 20 frames per second.

    The left axes show the arms in the plane of motion, each with its straight arm and the path of
    its tip so far, the right axes the transverse deflection of the tips, with a line at now.
    Raises ParameterError if `fps` is not above 0 and at most 1e6.
    """
    fps = 100.0 / math.ceil(100.0 / min(FPS.check(fps), _MOST_FPS))  # a GIF counts times by 10 ms
    figure = Figure(figsize=_SIZE, dpi=_DPI, layout='constrained')
    canvas = FigureCanvasAgg(figure)
    plane, curves = np.asarray(figure.subplots(1, 2, width_ratios=[3, 2]))
    arms = [_Arm(plane, track, fps, colour) for track, colour in zip(tracks, cycle(COLOURS))]
    corners = np.array([arm.corners for arm in arms])
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    plane.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal', xlabel='x [m]',
              ylabel='y [m]')
    plane.set_title(', '.join(sorted({track.title for track in tracks} - {''})))
    for track, colour in zip(tracks, cycle(COLOURS)):
        curves.plot(1e-9 * track.ns, track.curves['tip_deflection']['w'], color=colour,
                    label=track.name)
    curves.set(xlabel='time [s]', ylabel='transverse tip deflection [m]')
    if len(tracks) > 1:
        curves.legend(fontsize='small')
    for axes in plane, curves:
        axes.grid(alpha=0.3)
    begin, end = min(arm.times[0] for arm in arms), max(arm.times[-1] for arm in arms)
    now, frames = curves.axvline(begin, color='0.5', animated=True), []
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    for time in begin + np.arange(int((end - begin) * fps) + 1) / fps:
        canvas.restore_region(background)
        now.set_xdata([time, time])
        curves.draw_artist(now)
        for arm in arms:
            arm.draw(plane, time)
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).quantize(
            _COLOURS_PER_FRAME))
    with whole_file(path) as part:
        frames[0].save(part, save_all=True, append_images=frames[1:], duration=round(1e3 / fps),
                       loop=0)


class _Arm:
    """Draws a track in the plane; `times` [s], `corners` of all that it reaches, (2, 2) [m]."""

    def __init__(self, axes, track, fps, colour):
        picked = track.frames(fps)
        self.times, margin = 1e-9 * track.ns[picked], _MARGIN * track.body.length
        self._lines, self._ends = track.line(picked), track.straight(picked)
        self.corners = (self._lines.min(axis=(0, 1)) - margin,
                        self._lines.max(axis=(0, 1)) + margin)
        self._path, self._straight, self._bent, self._carrier, self._tip = (
            axes.plot([], [], animated=True, **style)[0] for style in (
                {'color': colour, 'alpha': 0.3, 'linewidth': 1.0},
                {'color': '0.6', 'linewidth': 1.0, 'linestyle': '--'},
                {'color': colour, 'linewidth': 3.0},
                {'color': '0.3', 'marker': 's', 'markersize': 9.0},
                {'color': colour, 'marker': 'o', 'markersize': 7.0}))

    def draw(self, axes, time):
        """Draw the last frame until a time [s]."""
        number = max(np.searchsorted(self.times, time, side='right') - 1, 0)
        line = self._lines[number]
        for artist, points in ((self._path, self._lines[:number + 1, -1]),
                               (self._straight, self._ends[number]), (self._bent, line),
                               (self._carrier, line[:1]), (self._tip, line[-1:])):
            artist.set_data(*points.T)
            axes.draw_artist(artist)
