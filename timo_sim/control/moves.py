# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Files of `timo_sim ringdown`: what was measured, and moves, also JointTrajectory as YAML."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline
import yaml

from timo_sim.control.shaping import Shaper
from timo_sim.fitting.mapping import read_record
from timo_sim.log.columns import read_table, SUFFIXES
from timo_sim.log.tables import write_table
from timo_sim.scene.files import read_yaml, whole_file
from timo_sim.scene.parameters import ParameterError, short

_YAML = '.yaml', '.yml'
_SAMPLES = 50  # least samples of a shaped move in a period of the fastest vibration


class Move(NamedTuple):
    """Names of joints, times (n,) [s], positions (n, joints), and velocities, or None."""

    joints: list[str]
    t: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None


def read_signal(path: str | Path, column: str | None = None,
                mapping: str | Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return times [s] and values of a column, (n,) each, of a table, whose first one is the time.

    Of a log, or with a mapping as that of `read_record`, the column is an output of the Record.
    Raises ParameterError if it is none and there are several.
    """
    path = Path(path)
    if mapping is not None or path.suffix not in SUFFIXES:
        outputs = read_record(path, mapping).outputs
        if column not in outputs and (column is not None or len(outputs) > 1):
            raise ParameterError(f'--column must be one of {", ".join(outputs)}, got {column}')
        channel = outputs[column or next(iter(outputs))]
        return channel.t, channel.values
    table = read_table(path)
    if column is None and len(table.names) > 2:
        raise ParameterError(f'--column must say which of {", ".join(table.names[1:])} was '
                             f'measured ({path})')
    key = 1 if column is None else int(column) if column.isdigit() else column
    t, values = (table.column(each).astype(float) for each in (0, key))
    good = np.isfinite(t) & np.isfinite(values)
    return t[good], values[good]


def read_move(path: str | Path) -> Move:
    """
    Return the Move in a table, whose first column is the time, or in the YAML of a trajectory.

    Raises ParameterError if it is none.
    """
    path = Path(path)
    if path.suffix in _YAML:
        return _of_trajectory(read_yaml(path), path)
    table = read_table(path)
    names = table.names
    if len(names) < 2:
        raise ParameterError(f'{path} must have a line with names: the time, then joints')
    columns = [table.column(name).astype(float) for name in names]
    return _checked(Move(names[1:], columns[0], np.stack(columns[1:], -1)), path)


def _of_trajectory(content, path):
    try:
        points = content['points']
        stamps = [each['time_from_start'] for each in points]
        t = np.array([each['sec'] + 1e-9 * each.get('nanosec', 0) for each in stamps], dtype=float)
        positions, velocities = (np.array([each.get(name) or [] for each in points], dtype=float)
                                 for name in ('positions', 'velocities'))
        joints = [str(name) for name in content['joint_names']]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ParameterError(f'{path} must be a trajectory_msgs/JointTrajectory, with joint_names '
                             f'and points: {short(error, str)}') from None
    return _checked(Move(joints, t, positions, velocities if velocities.size else None), path)


def _checked(move, path):
    rows = (len(move.t), len(move.joints))
    if (len(move.t) < 2 or not (np.diff(move.t) > 0.0).all() or any(
            each.shape != rows or not np.isfinite(each).all()
            for each in (move.positions, move.velocities) if each is not None)):
        raise ParameterError(f'{path} must have two or more times that ascend, and finite '
                             'positions of each joint at all of them')
    return move


def shape_move(move: Move, shaper: Shaper) -> Move:
    """Return a Move, shaped, with velocities; between its points a move is linear, or cubic."""
    t, positions, speeds = move[1:]
    path = (make_interp_spline(t, positions, k=1) if speeds is None
            else CubicHermiteSpline(t, positions, speeds))
    dt = float(np.median(np.diff(t)))
    dt /= np.ceil(_SAMPLES * dt * np.abs(shaper.poles).max() / (2.0 * np.pi))
    times = t[0] + dt * np.arange(np.ceil((t[-1] - t[0] + shaper.times[-1]) / dt) + 1.0)
    shaped = shaper.shape(lambda at: path(np.clip(at, t[0], t[-1])))(times)
    velocities = np.gradient(shaped, times, axis=0)
    velocities[[0, -1]] = 0.0  # controllers refuse a move that does not end at rest
    return Move(move.joints, times, shaped, velocities)


def write_move(move: Move, path: str | Path) -> None:
    """Write a Move to a new file, *.csv or *.parquet, or *.yaml for ROS; LogError for another."""
    if Path(path).suffix not in _YAML:
        write_table({'time_s': move.t, **dict(zip(move.joints, move.positions.T))}, Path(path))
        return
    velocities = np.zeros_like(move.positions) if move.velocities is None else move.velocities
    nanoseconds = np.round(1e9 * move.t).astype(int)
    points = [{'positions': place, 'velocities': speed, 'time_from_start': {
        'sec': int(stamp // 10**9), 'nanosec': int(stamp % 10**9)}}
        for stamp, place, speed in zip(nanoseconds, move.positions.tolist(), velocities.tolist())]
    with whole_file(path, new=True) as part:
        part.write_text(yaml.safe_dump({'joint_names': move.joints, 'points': points},
                                       default_flow_style=None, sort_keys=False))
