# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Sends what is drawn to rerun: the entities of the plane and the curves of the panels."""

import numpy as np
import rerun as rr

TIMELINE = 'sim_time'
PLANE, CURVES, ABOUT = 'plane', 'curves', 'about'
# Okabe-Ito colours, which colour-blind viewers can tell apart; greys for dark and light themes.
COLOURS = [(86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167), (240, 228, 66),
           (213, 94, 0), (0, 114, 178)]
GHOST, GRID, TICKS = (120, 120, 120), (128, 128, 128, 90), (170, 170, 170)
EFFORT = COLOURS[3]
TRAIL = 90  # frames of the tip's trail
# Length of the arrow of the largest force [arm lengths], angle of the largest torque's arc [rad].
_LONGEST, _FARTHEST = 0.3, 1.5 * np.pi
_ARC = np.linspace(0.0, 1.0, 20)


def _time(ns):
    return rr.TimeColumn(TIMELINE, duration=np.asarray(ns).astype('timedelta64[ns]'))


def colour(run, runs, curve=0):
    """Return the RGB colour of a curve: a shade for its run if there are several, else its own."""
    if runs == 1:
        return COLOURS[curve % len(COLOURS)]
    base = np.array(COLOURS[run % len(COLOURS)])
    return tuple((base + (255 - base) * (1 - 0.6**curve)).astype(int).tolist())


def log_frame_of_plane(stream, bounds):
    """Log the static parts of the plane: y upward, and a grid in the bounds, (2, 2) [m]."""
    # Rerun's plane has y downward: the plane is mirrored, its content is not.
    stream.log(PLANE, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
    low, high = bounds
    spacing, low = _spacing(np.max(high - low)), low + 0.05 * np.max(high - low)
    lines, labels, places = [], [], []
    for axis, name in enumerate('xy'):
        for k in range(int(np.ceil(low[axis] / spacing)), int(high[axis] / spacing) + 1):
            ends = np.array([low, high])
            ends[:, axis] = k * spacing
            lines.append(ends)
            places.append(ends[0])
            labels.append(f'{name} = {k * spacing:g} m' if k == 0 else f'{k * spacing:g}')
    stream.log(f'{PLANE}/grid', rr.LineStrips2D(
        lines, colors=GRID, radii=rr.Radius.ui_points(0.5), draw_order=-10.0), static=True)
    stream.log(f'{PLANE}/grid/ticks', rr.Points2D(
        places, labels=labels, show_labels=True, colors=TICKS, radii=0.0), static=True)


def log_floor(stream, name, floor, bounds):
    """Log the Floor of a run, across bounds of the plane, (2, 2) [m], and gravity's direction."""
    stream.log(f'{PLANE}/{name}/floor', rr.LineStrips2D(
        [floor.line(bounds)], colors=TICKS, radii=rr.Radius.ui_points(1.0), draw_order=-5.0),
        static=True)
    stream.log(f'{PLANE}/{name}/gravity', rr.Arrows2D(
        origins=floor.arrow[:1], vectors=np.diff(floor.arrow, axis=0), colors=TICKS,
        radii=rr.Radius.ui_points(1.5), draw_order=-5.0), static=True)


def _spacing(extent):
    decade = 10.0**np.floor(np.log10(extent / 3.0))
    return decade * max(n for n in (1, 2, 5) if n * decade <= extent / 3.0)


class Plane:
    """The moving entities of a run in the plane."""

    def __init__(self, stream, name, body, run, runs):
        self._stream, self._path, self._body, self._trail = stream, f'{PLANE}/{name}', body, None
        own, line, points = colour(run, runs), 0.5 * body.thickness, rr.Radius.ui_points
        grey, tip = (TICKS, COLOURS[5]) if runs == 1 else (own, own)
        styles: list[tuple] = [
            ('ghost', rr.LineStrips2D, GHOST, points(1.0), {}),
            ('carrier', rr.Boxes2D, own, points(1.5), {'half_sizes': [0.5 * body.carrier] * 2}),
            ('motor', rr.Points2D, grey, 0.5 * body.motor, {}),
            ('arm', rr.LineStrips2D, own, line if line > 0.004 * body.length else points(2.0), {}),
            ('end_effector', rr.Points2D, tip, 0.5 * body.end_effector, {}),
            ('trail', rr.LineStrips2D, grey, points(1.0), {}),
            ('force', rr.Arrows2D, EFFORT, points(2.0), {}),
            ('torque', rr.LineStrips2D, EFFORT, points(1.5), {})]
        for order, (name, kind, colors, radii, more) in enumerate(styles):
            stream.log(f'{self._path}/{name}', kind.from_fields(
                colors=colors, radii=radii, draw_order=float(order), **more), static=True)

    def send(self, ns, poses, largest):
        """
        Send Poses at sim times, shape (m,) [ns], after all that were sent before.

        `largest` is the force [N] and the torque [N m] that are drawn in full size.
        """
        body, root, tip = self._body, poses.line[:, 0], poses.line[:, -1]
        straight = root + body.length * np.column_stack([np.cos(poses.shaft), np.sin(poses.shaft)])
        before = np.repeat(tip[:1], TRAIL - 1, axis=0) if self._trail is None else self._trail
        trail = np.concatenate([before, tip])
        self._trail = trail[1 - TRAIL:]
        trails = np.moveaxis(np.lib.stride_tricks.sliding_window_view(trail, TRAIL, axis=0), 1, 2)
        for name, columns in {
                'ghost': rr.LineStrips2D.columns(
                    strips=_floats(np.stack([root, straight], axis=1))),
                'trail': rr.LineStrips2D.columns(strips=_floats(trails)),
                'carrier': rr.Boxes2D.columns(centers=_floats(root)),
                'motor': rr.Points2D.columns(positions=_floats(root)),
                'arm': rr.LineStrips2D.columns(strips=_floats(poses.line)),
                'end_effector': rr.Points2D.columns(positions=_floats(tip)),
                'force': rr.Arrows2D.columns(
                    origins=_floats(root), vectors=_floats(
                        poses.effort[:, :2] * (_LONGEST * body.length / (largest[0] or 1.0)))),
                'torque': rr.LineStrips2D.columns(strips=_floats(
                    _arcs(root, poses.shaft, poses.effort[:, 2] / (largest[1] or 1.0), body)))
                }.items():
            self._stream.send_columns(f'{self._path}/{name}', [_time(ns)], columns)


def _floats(values):
    return np.ascontiguousarray(values, dtype=np.float32)


def _arcs(centre, start, share, body):
    # An arc from the arm in the sense of the torque, and the two strokes of its head.
    radius = 0.12 * body.length
    angle = start[:, np.newaxis] + _FARTHEST * share[:, np.newaxis] * _ARC
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    last, head = angle[:, -1], np.clip(0.4 * np.abs(share), 0.0, 0.2) * np.sign(share)
    strokes = [arc]
    for distance in (0.85, 1.15):
        back = radius * distance * np.column_stack([np.cos(last - head), np.sin(last - head)])
        strokes += [arc[:, -1:] + np.minimum(1.0, np.abs(share) * 10)[:, np.newaxis, np.newaxis]
                    * (back[:, np.newaxis] - arc[:, -1:]), arc[:, -1:]]
    return centre[:, np.newaxis] + np.concatenate(strokes, axis=1)


def log_curves(stream, panel, name, run, runs, names):
    """Log names and colours of the curves of a run in a panel."""
    stream.log(f'{CURVES}/{panel}/{name}', rr.SeriesLines(
        names=[f'{name}: {text}' for text in names] if runs > 1 else list(names), widths=1.5,
        colors=[colour(run, runs, curve) for curve in range(len(names))]), static=True)


def send_curves(stream, panel, name, ns, values):
    """Send samples of curves at sim times, shape (m,) [ns]; values have shape (m, k)."""
    stream.send_columns(
        f'{CURVES}/{panel}/{name}', [_time(ns)],
        rr.Scalars.columns(scalars=np.ravel(values)).partition(
            np.full(len(values), values.shape[1])))
