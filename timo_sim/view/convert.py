# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Writes tracks to a rerun file."""

from typing import Any

import numpy as np
import rerun as rr

from timo_sim.scene.files import whole_file
from timo_sim.view.entities import (
    ABOUT, log_curves, log_floor, log_frame_of_plane, Plane, send_curves, TRAIL)
from timo_sim.view.panels import blueprint, Panel

BLOCK = 65536  # samples, or frames, that are sent at once
# By panel of differences: the trace that is compared, and its columns.
_DIFFERENCES: dict[str, tuple[str, Any]] = {
    'difference': ('tip_deflection', 0), 'shaft_difference': ('shaft', 0),
    'carrier_difference': ('carrier', slice(None))}


def write(tracks, path, fps=30.0, report=lambda done: None, at=None):
    """
    Write tracks to a rerun file, laid over each other.

    Parameters
    ----------
    tracks : list of Track
        Of different names.
    path : str or Path
    fps : float
        Most frames of the plane per second of sim time; curves have all samples.
    report : function(float)
        Called with the share of the work that was done since the last call; the sum is 1.
    at : float, optional
        Sim time that gets a frame, too [s].

    Returns
    -------
    ndarray, shape (2, 2)
        Corners of the plane that is shown, lower left and upper right [m].

    Raises
    ------
    OSError
        If the file cannot be written.

    """
    stream = rr.RecordingStream('timo_sim')
    with whole_file(path) as part:
        # Not `stream.save`, which prints some errors of a full disk and waits for ever at others.
        content = stream.binary_stream()
        bounds = _send(stream, tracks, fps, report, at)
        part.write_bytes(content.read())
    return bounds


def _send(stream, tracks, fps, report, at):
    frames = [track.frames(fps, at) for track in tracks]
    bounds, largest = _extent(tracks, frames)
    log_frame_of_plane(stream, bounds)
    stream.log(ABOUT, rr.TextDocument(_about(tracks, largest, fps), media_type='text/markdown'),
               static=True)
    shares = [len(track.traces) + 2 for track in tracks]
    panels = {}
    for run, track in enumerate(tracks):
        plane = Plane(stream, track.name, track.body, run, len(tracks))
        if track.floor is not None:
            log_floor(stream, track.name, track.floor, bounds)
        for part in _blocks(len(frames[run])):
            picked = frames[run][part]
            plane.send(track.ns[picked], track.poses(picked), largest)
        report(2 / sum(shares))
        for trace in track.traces:
            log_curves(stream, trace.panel, track.name, run, len(tracks), trace.names)
            panel = panels.setdefault(trace.panel, Panel())
            panel.curves += len(trace.names)
            for part in _blocks(len(trace.ns)):
                send_curves(stream, trace.panel, track.name, trace.ns[part], trace.values[part])
            panel.see(trace.values)
            report(1 / sum(shares))
        if run:
            _send_differences(stream, tracks[0], track, run, len(tracks), panels)
    if 'balance' in panels:  # so that a balance that closes looks flat, not like magnified noise
        panels['balance'].least = 1e-3 * max(panels['energy'].high, -panels['energy'].low)
    stream.send_blueprint(blueprint(panels, bounds, len(tracks)))
    return bounds


def _blocks(count):
    return [slice(k, min(k + BLOCK, count)) for k in range(0, count, BLOCK)]


def _extent(tracks, frames):
    # Return the corners of all that is drawn, with a margin, and the largest force and torque.
    corners, efforts = [], []
    for track, picked in zip(tracks, frames):
        for part in _blocks(len(picked)):
            poses = track.poses(picked[part])
            points = poses.line.reshape(-1, 2)
            corners += [points.min(axis=0) - 0.15 * track.body.length,
                        points.max(axis=0) + 0.15 * track.body.length]
            efforts.append([np.hypot(*poses.effort[:, :2].T).max(),
                            np.abs(poses.effort[:, 2]).max()])
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    # Room for the numbers at the grid.
    return (np.array([low - 0.05 * np.max(high - low), high]), np.max(efforts, axis=0).tolist())


def _send_differences(stream, first, track, run, runs, panels):
    for panel, (source, columns) in _DIFFERENCES.items():
        ours, theirs = track.trace(source), first.trace(source)
        inside = np.flatnonzero((ours.ns >= theirs.ns[0]) & (ours.ns <= theirs.ns[-1]))
        if not len(inside):
            continue
        names = np.array(ours.names)[columns].reshape(-1)
        log_curves(stream, panel, track.name, run, runs,
                   [f'{text} less {first.name}' for text in names])
        seen = panels.setdefault(panel, Panel(least=1e-12))
        seen.curves += len(names)
        for part in _blocks(len(inside)):
            ns, values = ours.ns[inside[part]], ours.values[inside[part]]
            values = values - np.column_stack(
                [np.interp(ns, theirs.ns, column) for column in theirs.values.T])
            values = values[:, columns].reshape(len(ns), -1)
            send_curves(stream, panel, track.name, ns, values)
            seen.see(values)


def _about(tracks, largest, fps):
    lines = [f'- **{track.name}**: {track.note}' for track in tracks]
    lines.append(f'- arrow: force, at most {largest[0]:.3g} N; arc: torque, at most '
                 f'{largest[1]:.3g} N m; grey: the arm if it did not bend; trail: '
                 f'{TRAIL} frames of the tip, at most {fps:g} per second')
    if any(track.floor is not None for track in tracks):
        lines.append('- line and arrow at the carrier: floor, and direction of gravity')
    if len(tracks) > 1:
        lines.append(f'- differences are from **{tracks[0].name}**, interpolated linearly')
    return '\n'.join(lines)
