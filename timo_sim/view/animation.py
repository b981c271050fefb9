# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Draws tracks as an animated GIF, which any browser shows."""

from itertools import cycle

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from PIL import Image

from timo_sim.scene.files import whole_file
from timo_sim.scene.parameter import ParameterError
from timo_sim.view.plot import COLOURS, draw_floor
from timo_sim.view.track import FPS

_MOST_FPS = 20.0  # [Hz]; browsers play faster GIFs too slowly
_SIZE, _DPI = (8.0, 4.0), 80  # [inch], [1/inch]
_MARGIN = 0.1  # around what moves, in arm lengths
_COLOURS_PER_FRAME = 32


def animate(tracks, path, fps=_MOST_FPS):
    """
    Write a GIF of tracks, laid over each other, in real time.

    The left axes show the arms in the plane of motion, each with its straight arm and the path of
    its tip so far; where there is gravity, a floor under the carrier. The right axes show the
    transverse deflection of the tips, with a line at now.

    Parameters
    ----------
    tracks : list of Track
    path : str or Path
    fps : float
        Frames per second of sim time; more than 20 are reduced to 20.

    Raises
    ------
    ParameterError
        If the path does not end with .gif, or `fps` is not above 0 and at most 1e6.

    """
    if not str(path).endswith('.gif'):
        raise ParameterError(f'the path of an animation must end with .gif, got {path}')
    fps = min(FPS.check(fps), _MOST_FPS)
    figure = Figure(figsize=_SIZE, dpi=_DPI, layout='constrained')
    canvas = FigureCanvasAgg(figure)
    plane, curves = np.asarray(figure.subplots(1, 2, width_ratios=[3, 2]))
    arms = [_Arm(plane, track, fps, colour) for track, colour in zip(tracks, cycle(COLOURS))]
    corners = np.array([arm.corners for arm in arms])
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    plane.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal', xlabel='x [m]',
              ylabel='y [m]')
    for track in tracks:
        draw_floor(plane, track.floor)
    for track, colour in zip(tracks, cycle(COLOURS)):
        trace = track.trace('tip_deflection')
        curves.plot(1e-9 * trace.ns, trace.values[:, -1], color=colour, label=track.name)
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
        self.times, self._poses = 1e-9 * track.ns[picked], track.poses(picked)
        self._length, margin = track.body.length, _MARGIN * track.body.length
        places = self._poses.line.reshape(-1, 2)
        self.corners = places.min(axis=0) - margin, places.max(axis=0) + margin
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
        line, angle = self._poses.line[number], self._poses.shaft[number]
        end = line[0] + self._length * np.array([np.cos(angle), np.sin(angle)])
        for artist, points in ((self._path, self._poses.line[:number + 1, -1]),
                               (self._straight, np.array([line[0], end])), (self._bent, line),
                               (self._carrier, line[:1]), (self._tip, line[-1:])):
            artist.set_data(*points.T)
            axes.draw_artist(artist)
