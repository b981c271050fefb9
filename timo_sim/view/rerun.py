# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Tracks in rerun: files and pictures, the viewer as a child process."""

from collections.abc import Sequence
from contextlib import closing
import os
from pathlib import Path
import socket
import subprocess
import sys
import tempfile
import time

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli

from timo_sim.scene.files import whole_file
from timo_sim.scene.parameters import Parameter, ParameterError
from timo_sim.view.track import FPS, Track

_TIMELINE = 'sim_time'
_PLANE, _CURVES = 'plane', 'curves'
# Okabe-Ito colours, which colour-blind viewers can tell apart; greys for dark and light themes.
_COLOURS = [(86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167), (240, 228, 66),
            (213, 94, 0), (0, 114, 178)]
_GHOST, _GRID, _TICKS = (120, 120, 120), (128, 128, 128, 90), (170, 170, 170)
_TRAIL = 90  # frames of the tip's trail
_BLOCK = 65536  # samples, or frames, that are sent at once
# By panel of differences: the panel whose curves are compared.
_DIFFERENCES = {'difference': 'tip_deflection', 'shaft_difference': 'shaft',
                'carrier_difference': 'carrier'}
# Titles of the panels, in the order in which they are shown.
_TITLES = {
    'tip_deflection': 'tip deflection w [m]',
    'tip_rotation': 'tip rotation phi [rad]',
    'difference': 'difference of w [m]',
    'carrier': 'carrier [m]',
    'shaft': 'shaft theta [rad]',
    'force': 'force on carrier [N]',
    'torque': 'torque on shaft [N m]',
    'modal': 'modes q [m sqrt(kg)]',
    'energy': 'energy [J]',
    'shaft_speed': 'shaft speed [rad/s]',
    'carrier_velocity': 'carrier velocity [m/s]',
    'tip_axial': 'tip deflection u, along [m]',
    'shaft_difference': 'difference of shaft [rad]',
    'carrier_difference': 'difference of carrier [m]',
}
_ON_FIRST_PAGE = 6
# Panels with a legend when there are several runs.
_WITH_LEGEND = 'tip_deflection', 'difference'
_AT = Parameter('--at', 0.0, 's', 'sim time of the picture')
_LOOPBACK = '127.0.0.1'
_LOADING = 300.0  # [s] until a viewer must have loaded a file: a longer wait is a hang
_ENDING = 5.0     # [s] until a viewer must have ended


class ViewerError(OSError):
    """The viewer does not start or does not answer."""


def write(tracks: Sequence[Track], path: Path | str, fps: float = 30.0,
          at: float | None = None) -> np.ndarray:
    """
    Write tracks of different names to a rerun file, laid over each other.

    The plane has at most `fps` frames per second of sim time, and one at the sim time `at` [s];
    curves have all samples. Returns the corners of the plane that is shown, lower left and upper
    right, shape (2, 2) [m]. Raises OSError if the file cannot be written.
    """
    stream = rr.RecordingStream('timo_sim')
    with whole_file(path) as part:
        # Not `stream.save`, which prints some errors of a full disk and waits for ever at others.
        content = stream.binary_stream()
        bounds = _send(stream, tracks, fps, at)
        part.write_bytes(content.read())
    return bounds


def _send(stream, tracks, fps, at):
    corners, panels = [], {}
    for run, track in enumerate(tracks):
        entities, frames = _Entities(stream, track, run, len(tracks)), track.frames(fps, at)
        for part in _blocks(len(frames)):
            line, margin = track.line(frames[part]), 0.15 * track.body.length
            entities.send_shapes(track.ns[frames[part]], line, track.straight(frames[part]))
            corners += [line.min(axis=(0, 1)) - margin, line.max(axis=(0, 1)) + margin]
        shown = [(panel, track.ns, curves) for panel, curves in track.curves.items()]
        for panel, ns, curves in [*shown, *(_differences(track, tracks[0]) if run else ())]:
            entities.send_curves(panel, ns, curves)
            panels[panel] = len(curves)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    bounds = np.array([low - 0.05 * np.max(high - low), high])  # room for the numbers at the grid
    _log_plane(stream, bounds)
    stream.send_blueprint(_blueprint(panels, bounds, tracks))
    return bounds


def _blocks(count):
    return [slice(k, min(k + _BLOCK, count)) for k in range(0, count, _BLOCK)]


def _differences(track, first):
    """Yield panel, times and curves of what differs from the first, where both have samples."""
    begin, end = max(track.ns[0], first.ns[0]), min(track.ns[-1], first.ns[-1])
    # At samples of the one that has fewer: a line between these would miss vibrations.
    ns = min((each.ns[(begin <= each.ns) & (each.ns <= end)] for each in (track, first)), key=len)
    for panel, source in _DIFFERENCES.items() if len(ns) else ():
        yield panel, ns, {f'{name} less {first.name}': np.subtract(*(
            np.interp(ns, each.ns, each.curves[source][name]) for each in (track, first)))
            for name in track.curves[source]}


class _Entities:
    """What a stream has of a track, number `run` of `runs`: bodies in the plane, and curves."""

    def __init__(self, stream: rr.RecordingStream, track: Track, run: int, runs: int) -> None:
        self._stream, self._name, self._run, self._runs = stream, track.name, run, runs
        self._path = f'{_PLANE}/{track.name}'
        self._trail: np.ndarray | None = None
        body, points = track.body, rr.Radius.ui_points
        own, line = self._colour(), 0.5 * body.thickness
        grey, tip = (_TICKS, _COLOURS[5]) if self._runs == 1 else (own, own)
        styles: list[tuple] = [
            ('ghost', rr.LineStrips2D, _GHOST, points(1.0), {}),
            ('carrier', rr.Boxes2D, own, points(1.5), {'half_sizes': [0.5 * body.carrier] * 2}),
            ('motor', rr.Points2D, grey, 0.5 * body.motor, {}),
            ('arm', rr.LineStrips2D, own, line if line > 0.004 * body.length else points(2.0), {}),
            ('end_effector', rr.Points2D, tip, 0.5 * body.end_effector, {}),
            ('trail', rr.LineStrips2D, grey, points(1.0), {})]
        for order, (name, kind, colors, radii, more) in enumerate(styles):
            self._stream.log(f'{self._path}/{name}', kind.from_fields(
                colors=colors, radii=radii, draw_order=float(order), **more), static=True)

    def _colour(self, curve=0):
        """Return the RGB colour of a curve: a shade for its run if there are several."""
        if self._runs == 1:
            return _COLOURS[curve % len(_COLOURS)]
        base = np.array(_COLOURS[self._run % len(_COLOURS)])
        return tuple((base + (255 - base) * (1 - 0.6**curve)).astype(int).tolist())

    def send_shapes(self, ns: np.ndarray, line: np.ndarray, straight: np.ndarray) -> None:
        """Send lines at times (m,) [ns], as of `Track`."""
        root, tip = line[:, 0], line[:, -1]
        before = np.repeat(tip[:1], _TRAIL - 1, axis=0) if self._trail is None else self._trail
        trail = np.concatenate([before, tip])
        self._trail = trail[1 - _TRAIL:]
        trails = np.moveaxis(np.lib.stride_tricks.sliding_window_view(trail, _TRAIL, axis=0), 1, 2)
        for name, columns in {
                'ghost': rr.LineStrips2D.columns(strips=straight),
                'trail': rr.LineStrips2D.columns(strips=trails),
                'carrier': rr.Boxes2D.columns(centers=root),
                'motor': rr.Points2D.columns(positions=root),
                'arm': rr.LineStrips2D.columns(strips=line),
                'end_effector': rr.Points2D.columns(positions=tip)}.items():
            self._stream.send_columns(f'{self._path}/{name}', [_time(ns)], columns)

    def send_curves(self, panel: str, ns: np.ndarray, curves: dict[str, np.ndarray]) -> None:
        """Send curves at times (n,) [ns], with names and colours."""
        path, values = f'{_CURVES}/{panel}/{self._name}', np.column_stack([*curves.values()])
        self._stream.log(path, rr.SeriesLines(
            names=[f'{self._name}: {text}' if self._runs > 1 else text for text in curves],
            colors=[self._colour(curve) for curve in range(len(curves))], widths=1.5), static=True)
        for part in _blocks(len(ns)):
            scalars = rr.Scalars.columns(scalars=values[part].ravel())
            self._stream.send_columns(path, [_time(ns[part])], scalars.partition(
                np.full(len(ns[part]), len(curves))))


def _log_plane(stream, bounds):
    """Log the static parts of the plane: y upward, and a grid in the bounds, (2, 2) [m]."""
    # Rerun's plane has y downward: the plane is mirrored, its content is not.
    stream.log(_PLANE, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
    low, high = bounds
    extent = np.max(high - low)
    decade = 10.0**np.floor(np.log10(extent / 3.0))
    spacing = decade * max(n for n in (1, 2, 5) if n * decade <= extent / 3.0)
    low = low + 0.05 * extent
    lines, labels, places = [], [], []
    for axis, name in enumerate('xy'):
        for k in range(int(np.ceil(low[axis] / spacing)), int(high[axis] / spacing) + 1):
            ends = np.array([low, high])
            ends[:, axis] = k * spacing
            lines.append(ends)
            places.append(ends[0])
            labels.append(f'{name} = {k * spacing:g} m' if k == 0 else f'{k * spacing:g}')
    stream.log(f'{_PLANE}/grid', rr.LineStrips2D(
        lines, colors=_GRID, radii=rr.Radius.ui_points(0.5), draw_order=-10.0), static=True)
    stream.log(f'{_PLANE}/grid/ticks', rr.Points2D(
        places, labels=labels, show_labels=True, colors=_TICKS, radii=0.0), static=True)


def _time(ns):
    return rr.TimeColumn(_TIMELINE, duration=np.asarray(ns).astype('timedelta64[ns]'))


def _blueprint(panels, bounds, tracks):
    """
    Return the layout of the plane with corners `bounds` and of panels.

    `panels` has the number of curves by key of _TITLES. With several runs only some panels have a
    legend.
    """
    views = [rrb.TimeSeriesView(
        origin=f'{_CURVES}/{key}', name=title,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=(
            key in _WITH_LEGEND if len(tracks) > 1 else panels[key] > 1)))
        for key, title in _TITLES.items() if key in panels]
    (left, bottom), (right, top) = bounds
    plane = rrb.Spatial2DView(
        origin='/', contents=f'{_PLANE}/**',
        name=', '.join(filter(None, ['plane of motion, x right, y up [m]', tracks[0].title])),
        visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(-top, -bottom)))
    pages = [rrb.Grid(*views[:_ON_FIRST_PAGE], grid_columns=2, name='motion')]
    if len(views) > _ON_FIRST_PAGE:
        pages.append(rrb.Grid(*views[_ON_FIRST_PAGE:], grid_columns=2, name='more'))
    return rrb.Blueprint(
        rrb.Horizontal(plane, rrb.Tabs(*pages, active_tab=0), column_shares=[1, 1]),
        rrb.TimePanel(timeline=_TIMELINE, expanded=False, play_state='paused'),
        rrb.BlueprintPanel(expanded=False), rrb.SelectionPanel(expanded=False))


def show_tracks(tracks: Sequence[Track], save: str | None = None, png: str | None = None,
                at: float | None = None, fps: float = 30.0) -> None:
    """
    Show tracks, unless only a file or a picture is wanted.

    `save` and `png` are paths of a rerun file (*.rrd) and of a picture, which is of the sim time
    `at` [s], by default the end; for `fps` see `write`. Raises ParameterError if a path or number
    breaks its rule, or the time is not in the runs; ViewerError if the viewer does not start or
    does not answer.
    """
    at, fps = at if at is None else _AT.check(at), FPS.check(fps)
    if save and not str(save).endswith('.rrd'):
        raise ParameterError(f'the path of --save, a rerun file, must end with .rrd, got {save}')
    if png and not os.access(Path(png).absolute().parent, os.W_OK):
        raise ParameterError(f'--png {png} cannot be written: its folder is missing or read-only')
    with tempfile.TemporaryDirectory(prefix='timo_sim_') as folder:
        path = Path(save or Path(folder, 'run.rrd'))
        begin = min(track.ns[0] for track in tracks)
        end = max(track.ns[-1] for track in tracks)
        if at is not None and not begin <= round(1e9 * at) <= end:
            raise ParameterError(f'--at = {at:g} s is not in the run, which is from '
                                 f'{1e-9 * begin:g} to {1e-9 * end:g} s')
        write(tracks, path, fps, at)
        if png:
            picture(path, png, at)
        if not (save or png):
            _show(path)


def _show(path):
    """Show a rerun file until the window is closed."""
    if sys.platform == 'linux' and not (
            os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')):
        raise ViewerError('there is no screen (DISPLAY is not set): --png OUT.png draws a '
                          'picture, --save OUT.rrd writes a file for rerun elsewhere')
    code = _viewer('--port', str(_free_port()), path).wait()
    if code:
        raise ViewerError(f'the viewer of rerun ended with code {code}: --save OUT.rrd writes a '
                          'file for rerun elsewhere')


def picture(path: Path | str, png: Path | str, at: float | None = None,
            size: tuple[int, int] = (1600, 1000), view: str | None = None,
            timeline: str = _TIMELINE) -> None:
    """
    Draw a rerun file, or a log as rerun itself shows it, to a picture, without a screen.

    The picture is of the sim time `at` [s], by default the end; `size` is the width and height of
    the window, `view` the beginning of the name of the only view to draw. The `timeline` of a log
    is message_log_time. Raises ViewerError.
    """
    from rerun.experimental import ViewerClient
    port = _free_port()
    process = _viewer('--headless', '--port', str(port), '--window-size',
                      f'{size[0]}x{size[1]}', path, stderr=subprocess.PIPE, text=True)
    try:
        client = _until(
            lambda: ViewerClient.connect(f'rerun+http://{_LOOPBACK}:{port}/proxy'), process)

        def load():
            state = client.get_state()
            ready = not state.loading and state.views and state.recordings and any(
                line.name == timeline for line in state.recordings[0].timelines)
            return state if ready else None

        state = _until(load, process)
        end = max(line.end for line in state.recordings[0].timelines if line.name == timeline)
        client.set_time(timeline, duration=end * 1e-9 if at is None else at, play_state='paused')
        only = next((each.view_id for each in state.views
                     if view is not None and each.name.startswith(view)), None)
        with whole_file(png) as part:
            before, now = b'at first', b''
            while now != before:  # the viewer moves its axes to their places gradually
                time.sleep(0.5)
                client.save_screenshot(str(part.absolute()), only)
                before, now = now, part.read_bytes() if part.exists() else b''
            if now[-8:-4] != b'IEND':
                raise ViewerError(f'{png} cannot be written to its end: is the disk full?')
    finally:
        stop(process)
        process.communicate()


def stop(process: subprocess.Popen) -> None:
    """End a viewer; if it does not obey, kill it."""
    process.terminate()
    try:
        process.wait(_ENDING)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _viewer(*arguments, **options):
    # The binary itself: its Python wrapper, when ended, would leave it running.
    return subprocess.Popen(
        [Path(rerun_cli.__file__).with_name('rerun'), '--bind', _LOOPBACK, *arguments],
        env={'RUST_LOG': 'error', **os.environ}, **options)


def _free_port():
    with closing(socket.socket()) as sock:
        sock.bind((_LOOPBACK, 0))
        return sock.getsockname()[1]


def _until(condition, process):
    """Return what a condition finds; until a viewer answers, it raises RuntimeError or OSError."""
    deadline = time.monotonic() + _LOADING
    while time.monotonic() < deadline:
        if process.poll() is not None:
            text = process.stderr.read()
            raise ViewerError(
                'pictures need a driver for graphics: apt-get install mesa-vulkan-drivers '
                'libvulkan1' if 'adapter' in text or 'render context' in text else
                'the viewer of rerun ended: ' + ' '.join(text.split())[-300:])
        try:
            found = condition()
        except (RuntimeError, OSError):
            found = None
        if found:
            return found
        time.sleep(0.05)
    raise ViewerError(f'the viewer of rerun did not answer within {_LOADING:g} s: try it '
                      'again, or --save OUT.rrd')
