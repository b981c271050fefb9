# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The class Record: what was measured, in time, and the quantities that a record may have.

It is read from CSV, Parquet or MAT files, from a log of the node, or from a bag.
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping
import csv
from dataclasses import dataclass, replace
from functools import cache
import math
from pathlib import Path
import pickle
import re
import subprocess
import sys
from typing import Any, Callable, NamedTuple

import numpy as np

from timo_sim.extras import optional
from timo_sim.log.tables import Recording
from timo_sim.model.layout import INPUTS, with_unit
from timo_sim.runs.replay import segments_of
from timo_sim.scene.files import read_yaml
from timo_sim.scene.parameters import (
    checked, DEFAULTS, did_you_mean, MAPPING, NUMBER, Parameter, ParameterError, PATH, short,
    TEXT)
from timo_sim.scene.scene import Scene
from timo_sim.topics.commands import COMMANDED, COMMANDS
from timo_sim.topics.outputs import SENSORS, title

DRIVE = 'drive'


class Output(NamedTuple):
    """A measured quantity."""

    unit: str
    meaning: str
    of_run: Callable  # from a Run to the quantity at its samples, shape (n,)


# Units of the inputs that a record may have.
INPUT_UNITS = {**{each.name: each.unit for each in INPUTS if each.argument}, DRIVE: 'rad'}


def _tip_angle(run):
    along, across = run.deflection().T
    return np.arctan2(across, run.model.manipulator.arm.length + along)


OUTPUTS = {
    **{sensor.measured: Output(
        sensor.unit, sensor.meaning,
        lambda run, read=sensor.of_motion: read(run.model, run.values))
        for sensor in SENSORS if sensor.of_motion},
    'shaft_velocity': Output('rad/s', 'speed of the shaft', lambda run: run.shaft_velocity),
    'carrier_x': Output('m', 'position of the carrier', lambda run: run.carrier[:, 0]),
    'carrier_y': Output('m', 'position of the carrier', lambda run: run.carrier[:, 1]),
    'tip_x': Output('m', 'position of the tip, world axes', lambda run: run.position()[:, 0]),
    'tip_y': Output('m', 'position of the tip, world axes', lambda run: run.position()[:, 1]),
    'tip_transverse': Output('m', 'deflection of the tip across the arm',
                             lambda run: run.deflection()[:, 1]),
    'tip_angle': Output('rad', 'direction of the tip as seen from the root, straight arm: 0',
                        _tip_angle),
    'tip_rotation': Output('rad', 'rotation of the end effector relative to the shaft',
                           lambda run: run.rotation()),
    'root_strain': Output('', 'strain of the outer fibre at the root',
                          lambda run: run.root_strain()),
    'tip_acceleration': Output('m/s2', 'specific force on the tip across it, as an accelerometer '
                               'shows it', lambda run: run.tip_acceleration()[:, 1]),
}
UNITS = {
    'rad': {'rad': 1.0, 'mrad': 1e-3, 'deg': np.pi / 180.0, 'turn': 2.0 * np.pi},
    'rad/s': {'rad/s': 1.0, 'deg/s': np.pi / 180.0, 'rpm': np.pi / 30.0},
    'm': {'m': 1.0, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6},
    'm/s2': {'m/s2': 1.0, 'g': 9.80665},
    's': {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9},
    'N': {'N': 1.0, 'mN': 1e-3}, 'N m': {'N m': 1.0, 'mN m': 1e-3}, 'V': {'V': 1.0, 'mV': 1e-3},
    '': {'': 1.0, 'strain': 1.0, 'microstrain': 1e-6},
}


def unit_of(name: str) -> str:
    """Return the unit of a quantity; values in a Record have it."""
    return INPUT_UNITS[name] if name in INPUT_UNITS else OUTPUTS[name].unit


HOLDS = 'zero', 'linear'
# Limits of values, and of noise relative to them, that keep squares of residuals finite.
_MAX_VALUE, _MIN_NOISE = 1e100, 1e-12
_MIN_SAMPLES = 20  # samples of an output, or of a drive


class Channel(NamedTuple):
    """
    The samples of one quantity.

    Attributes
    ----------
    t, values : ndarray, shape (n,)
        Times, ascending [s], which may be uneven; values in the unit of the quantity, see `UNITS`.
    noise : float or None
        Standard deviation of the noise of a sensor, if it is known.
    hold : str
        Of an input: `zero` if each value holds until the next sample, as a controller's command
        does, or `linear` in between.
    knots : float or None
        Of the input `drive`: distance of the knots of the spline that smooths the angle [s], since
        noise and counts of an encoder would become accelerations; None: it meets all samples.

    """

    t: np.ndarray
    values: np.ndarray
    noise: float | None = None
    hold: str = 'zero'
    knots: float | None = None


@dataclass(frozen=True)
class Record:
    """
    A measured record of an arm; t = 0 is its first sample.

    Attributes
    ----------
    inputs, outputs : dict of Channel
        By name of a quantity, see `timo_sim.fitting.record`.
    source : str
        Where it is from, for messages.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> t = np.arange(100) * 0.01
    >>> timo_sim.Record.of({'torque': (t, np.sin(t))}, {'shaft': (t, t**3 / 6.0)}).duration
    0.99

    """

    inputs: dict[str, Channel]
    outputs: dict[str, Channel]
    source: str = 'given arrays'

    @staticmethod
    @checked(inputs=MAPPING, outputs=MAPPING, noise=MAPPING, source=TEXT)
    def of(inputs: Mapping[str, Any], outputs: Mapping[str, Any],
           noise: Mapping[str, float] | None = None, source: str = 'given arrays') -> Record:
        """
        Return a checked Record of arrays.

        `inputs` and `outputs` have by quantity its times and values, two arrays of shape (n,), or
        a Channel; samples that are not finite are left out. `noise` has standard deviations of
        sensors, by quantity; by default they are fitted, too. `source` is for messages. Raises
        ParameterError if a quantity is unknown, has too few samples, or times do not ascend.
        """
        ins: dict[str, Channel] = {}
        outs: dict[str, Channel] = {}
        rules: Any = (ins, inputs, INPUT_UNITS, 'input'), (outs, outputs, OUTPUTS, 'output')
        for kept, given, known, kind in rules:
            for name, channel in given.items():
                if name not in known:
                    raise ParameterError(f'{short(name, str)} is no {kind} of a record, but '
                                         f'{", ".join(known)}{did_you_mean(name, known)} '
                                         f'({source})')
                kept[name] = _check_channel(name, channel, source, kind == 'output')
        for name, deviation in (noise or {}).items():
            least = _MIN_NOISE * np.abs(outs[name].values).max() if name in outs else 0.0
            if name not in outs or not max(least, np.finfo(float).tiny) < deviation < _MAX_VALUE:
                raise ParameterError(f'noise of {short(name, str)} must be > 0 and at least '
                                     f'{_MIN_NOISE:g} of the largest value, of one of '
                                     f'{", ".join(outs)}, got {short(deviation)} ({source})')
            outs[name] = outs[name]._replace(noise=float(deviation))
        if not outs:
            raise ParameterError(f'a record must have an output, one of {", ".join(OUTPUTS)} '
                                 f'({source})')
        begin = min(channel.t[0] for channel in (*ins.values(), *outs.values()))
        for part in (ins, outs):
            part.update({name: channel._replace(t=channel.t - begin)
                         for name, channel in part.items()})
        return Record(ins, outs, source)

    @property
    def duration(self) -> float:
        """Time of the last sample of an output [s]."""
        return float(max(channel.t[-1] for channel in self.outputs.values()))

    @property
    def period(self) -> float:
        """The shortest of the median times between samples of a quantity [s]."""
        return float(min(np.median(np.diff(channel.t)) for channel in (
            *self.inputs.values(), *self.outputs.values()) if len(channel.t) > 1))

    def select(self, *outputs: str) -> Record:
        """Return the record with these outputs alone; ParameterError if it has not got one."""
        for name in outputs:
            if not isinstance(name, str) or name not in self.outputs:
                raise ParameterError(f'{short(name, str)} is no output of this record, but '
                                     f'{", ".join(self.outputs)} ({self.source})')
        return replace(self, outputs={name: self.outputs[name] for name in outputs})

    @checked(start=NUMBER, end=(lambda end: float(end) > 0.0, 'a number > 0'))
    def cut(self, start: float = 0.0, end: float = np.inf) -> Record:
        """
        Return the part from `start` to `end` [s], whose time begins at 0 again.

        An input that has no sample in it keeps the value that acts there. Raises ParameterError
        if an output has too few samples in it.
        """
        if not 0.0 <= start < end:
            raise ParameterError(f'start and end must be 0 <= start < end, got {start:g} and '
                                 f'{end:g}')

        def part(name, channel, is_input):
            first, last = np.searchsorted(channel.t, [start, end])
            if is_input and first and (first == len(channel.t) or channel.t[first] > start):
                first -= 1  # its value still holds at the start
            t = np.maximum(channel.t[first:last + 1] - start, 0.0)
            within = t <= end - start
            found = channel._replace(t=t[within], values=channel.values[first:last + 1][within])
            if is_input and name != DRIVE and not len(found.t):
                found = channel._replace(t=np.zeros(1), values=channel.values[first:first + 1])
            _check_count(name, len(found.t), not is_input, f'from {start:g} s to {end:g} s of '
                         f'{self.duration:g} s, {self.source}')
            return found
        return Record({name: part(name, channel, True) for name, channel in self.inputs.items()},
                      {name: part(name, channel, False) for name, channel in self.outputs.items()},
                      self.source)


def _check_count(name, count, is_output, place):
    fewest = _MIN_SAMPLES if is_output or name == DRIVE else 1
    if count < fewest:
        raise ParameterError(f'{name} must have at least {fewest} finite samples, got {count} '
                             f'({place})')


def _check_channel(name, channel, source, is_output):
    t, values, *more = channel
    try:
        # Converted to floats, complex values would lose a part, and stamps their unit.
        good = not any(np.asarray(each).dtype.kind in 'cmM' for each in (t, values))
        t, values = (np.array(each if good else [], dtype=float) for each in (t, values))
        good = good and t.ndim == 1 and t.shape == values.shape
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ParameterError(f'{name} must have as many times as values, lists of real '
                             f'numbers ({source})')
    kept = np.isfinite(t) & np.isfinite(values)
    t, values = t[kept], values[kept]
    _check_count(name, len(t), is_output, source)
    if np.abs(values).max() > _MAX_VALUE:
        raise ParameterError(f'values of {name} must be at most {_MAX_VALUE:g} in size, got '
                             f'{np.abs(values).max():g} ({source})')
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if len(late):
        raise ParameterError(f'times of {name} must ascend, got {t[late[0]]:.12g} s and then '
                             f'{t[late[0] + 1]:.12g} s ({source})')
    found = Channel(t, values, *more)
    if found.hold not in HOLDS:
        raise ParameterError(f'hold of {name} must be one of {", ".join(HOLDS)}, got '
                             f'{short(found.hold)} ({source})')
    return found


SUFFIXES = '.csv', '.txt', '.dat', '.tsv', '.parquet', '.mat'
_COMMENT = '%#'
_SEPARATORS = ';', '\t', ',', None       # None: white space
_MISSING = '', 'na', 'n/a', '#n/a', 'null', 'none'


class Table:
    """The columns of a file: names and values, (n,) or (n, m), of each."""

    def __init__(self, columns: list[tuple[list[str], np.ndarray]], hint: str = '') -> None:
        self._columns, self._hint = columns, hint

    @property
    def names(self) -> list[str]:
        """All names of columns."""
        return [name for names, _ in self._columns for name in names]

    def column(self, key: str | int) -> np.ndarray:
        """Return the column, (n,), of a name, a number from 0, or NAME:NUMBER in a matrix."""
        places = [k for k, (names, _) in enumerate(self._columns) if str(key) in names]
        if not places and type(key) is int and 0 <= key < len(self._columns):
            places = [key]
        if len(places) > 1:
            raise ParameterError(f'{short(key, str)} is the name of the columns '
                                 f'{", ".join(map(str, places))}: give the number of one')
        if places and self._columns[places[0]][1].ndim == 1:
            return self._columns[places[0]][1]
        name, _, number = str(key).rpartition(':')
        for names, values in self._columns:
            if name in names and values.ndim == 2 and number.isdigit():
                series = _series(values)
                if int(number) < len(series):
                    return series[int(number)]
        shown = []
        for place, (names, values) in enumerate(self._columns):
            name = ' '.join(names) or str(place)
            shown.append(name if values.ndim == 1 else
                         f'{name}:0 to {name}:{len(_series(values)) - 1}')
        raise ParameterError(f'{short(key, str)} is no column of the table; it has '
                             f'{", ".join(shown)[:300]}{self._hint}')


def read_table(path: Path) -> Table:
    """Return the Table in a file, or raise ParameterError."""
    if path.exists() and not path.is_file():  # a pipe or device may have no end
        raise ParameterError(f'{path} is not a file')
    readers = {'.parquet': _read_parquet, '.mat': _read_mat}
    return readers.get(path.suffix, _read_text)(path)


def _series(matrix):
    """Return the series in a matrix: its columns, or its rows if they are longer."""
    return matrix if matrix.shape[0] < matrix.shape[1] else matrix.T


def _read_parquet(path):
    with optional():
        import pyarrow
        import pyarrow.parquet
    try:
        found = pyarrow.parquet.read_table(path).flatten()
        return Table([([name], values.to_numpy())
                      for name, values in zip(found.column_names, found.columns)])
    except (pyarrow.ArrowException, ValueError) as error:
        raise ParameterError(f'{path} cannot be read: {error}') from None


# A damaged file may end the process that reads it, so it is another one.
_MAT_READER = """
import pickle, sys
from scipy.io import loadmat
try:
    found = loadmat(sys.argv[1], simplify_cells=True)
except Exception as error:  # of many types, for damaged files
    found = str(error) or type(error).__name__
pickle.dump(found, sys.stdout.buffer)
"""


def _read_mat(path):
    open(path, 'rb').close()  # an OSError for what cannot be read
    done = subprocess.run([sys.executable, '-c', _MAT_READER, path], capture_output=True)
    found = 'it is damaged' if done.returncode else pickle.loads(done.stdout)
    if isinstance(found, str):
        raise ParameterError(f'{path} cannot be read, save it with -v7: {found}')
    columns = [([name], values) for name, values in _flatten_arrays(found, '')]
    if not columns:
        raise ParameterError(f'{path} has no arrays of numbers; save timeseries and other objects '
                             'as arrays or structs')
    return Table(columns)


def _flatten_arrays(value, name):
    """Yield names, with .FIELD for a struct and [k] for an element of an array, and arrays."""
    if isinstance(value, dict):
        for field, each in value.items():
            if not field.startswith('__'):
                yield from _flatten_arrays(each, f'{name}.{field}'.lstrip('.'))
    elif isinstance(value, list) or isinstance(value, np.ndarray) and value.dtype == object:
        for k, each in enumerate(value):
            yield from _flatten_arrays(each, f'{name}[{k}]')
    elif isinstance(value, np.ndarray) and value.dtype.kind in 'biufc' and value.ndim in (1, 2):
        yield name, value


def _read_text(path):
    """Return the Table in a text; names are in lines above the numbers, or begin its rows."""
    content = path.read_bytes()
    wide = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    text = content.decode('utf-16' if wide else 'utf-8', errors='replace')
    try:
        return _parse_lines(text.lstrip('\ufeff').splitlines(), path)
    except csv.Error as error:
        raise ParameterError(f'{path} is not a table: {error}') from None


def _parse_lines(lines, path):
    good = [line for line in lines if line.strip() and line.strip()[0] not in _COMMENT]
    named, found = 0, _first_numbers(good, 0)
    if found is None:
        named, found = 1, _first_numbers(good, 1)
    if found is None:
        raise ParameterError(f'{path} has no line of numbers')
    first, separator = found
    rows = [*_cells(good[first:], separator)]
    for number, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise ParameterError(f'{path}: row {number + 1} of numbers has {len(row)} columns, '
                                 f'the first has {len(rows[0])}')
    if len(rows) >= len(rows[0]):
        named = 0  # a text begins each row of a table, and is no name of a series
    texts = [cell for row in rows for cell in row[named:]]
    if any(',' in text for text in texts) and (
            separator == ',' or any('.' in text for text in texts)):
        raise ParameterError(f'{path} must have decimal points, or decimal commas alone and '
                             'another separator than commas')
    try:
        values = np.array([*map(_number, texts)]).reshape(len(rows), -1)
    except ValueError as error:
        raise ParameterError(f'{path} must have numbers alone: {error}') from None
    if named:
        return Table([([row[0].strip()], each) for row, each in zip(rows, values)])
    above = [line.strip(_COMMENT + ' \t') if line.strip()[:1] in [*_COMMENT] else line
             for line in lines[:lines.index(good[first])]]
    heads = [[name.strip() for name in head] for head in _cells(above, separator)]
    return _name_columns(values, heads, separator)


def _name_columns(values, heads, separator):
    """Return the Table of a matrix with lines of names or units above it."""
    width, hint, kept = values.shape[1], '', []
    blank = width - len(np.trim_zeros(~np.isnan(values).all(axis=0), 'b'))
    for head in reversed([head for head in heads if any(head)]):
        if separator is None:  # a unit such as [s] belongs to the word before it
            head = [name for name in head if not (name[:1] in '[(' and name[-1:] in '])')] or head
        while head and not head[-1]:
            head = head[:-1]
        if not width - blank <= len(head) <= width:
            hint = f'; the line above has {len(head)} names for {width} columns'
            break
        kept.insert(0, head + [''] * (width - len(head)))
    if kept or len(values) >= width:
        return Table([([head[k] for head in kept if head[k]], each)
                      for k, each in enumerate(values.T)], '' if kept else hint)
    return Table([([], each) for each in values])


def _first_numbers(lines, skipped):
    """Return the first line of which all cells but the skipped are numbers, and its separator."""
    for first, line in enumerate(lines):
        for separator in _SEPARATORS:
            if separator and separator not in line:
                continue
            cells = next(_cells([line], separator), [])[skipped:]
            try:
                if np.isfinite([*map(_number, cells)]).any():
                    return first, separator
            except ValueError:
                continue
    return None


def _cells(lines, separator):
    """Return the cells of each line with any."""
    if separator is None:
        lines = (' '.join(line.split()) for line in lines)
    return filter(None, csv.reader(lines, delimiter=separator or ' ', skipinitialspace=True))


def _number(text):
    text = text.strip()
    return np.nan if text.lower() in _MISSING else float(text.replace(',', '.'))


_COLUMNS = {each.name: column for column, each in enumerate(INPUTS) if each.argument}
# The topics and columns that show an output, of which the first that a log has is read.
_OUTPUTS = {
    'shaft': [('joint_states', 'shaft_rad')],
    'carrier_x': [('joint_states', 'carrier_x_m')],
    'carrier_y': [('joint_states', 'carrier_y_m')],
    'tip_transverse': [('~/tip_deflection', 'transverse_m')],
}
_MEASURING = [sensor for sensor in SENSORS if sensor.measured]
_SENSORS = {sensor.topic: sensor.name for sensor in _MEASURING}
for _sensor in _MEASURING:
    _OUTPUTS.setdefault(_sensor.measured, []).insert(0, (_sensor.topic, _sensor.columns[-1]))


def read_log(path: str | Path, scene: Scene | None = None,
             node: str | None = None) -> tuple[Scene, Record]:
    """
    Return `scene`, by default that of a log, and the log's Record after its last reset.

    A plain bag needs `scene`; for `node` see `Recording`. Raises LogError if the file is not a
    log, or has nothing to replay; ParameterError if it has what a record cannot: settings, or
    forces in the axes of the arm.
    """
    recording = Recording(path, node)
    own = recording.scene or scene
    if own is None:
        raise ParameterError(f'scene must be given with {path}, a plain bag, which has none')
    values = {**DEFAULTS, **(recording.parameters if recording.facts else {})}
    segment = segments_of(recording, own, values)[-1]
    if segment.changes:
        step, changes = segment.changes[0]
        raise ParameterError(f'{", ".join(changes)} was set at {step * own.step:g} s: a record '
                             'must be of one scene')
    outputs = _outputs(segment, recording, own)
    # A log begins at its start or reset. A bag may have any clock, and begins with its first
    # message; until its first command nothing is known to act.
    begin = segment.first if recording.facts else min([
        *(round(channel.t[0] / own.step) for channel in outputs.values()),
        *(step for step, *_ in segment.commands[:1])], default=0)
    # Sensors send late what they measured; their delay is part of the scene, not of the stamps.
    return scene or own, Record.of(_inputs(segment, own, begin), outputs, source=str(path))


def _inputs(segment, scene, begin):
    commanded, rows, steps = np.zeros(COMMANDED), [np.zeros(COMMANDED)], [begin]
    for step, index, values, _ in segment.commands:
        COMMANDS[index].apply(values, commanded)
        if step == steps[-1]:
            rows[-1] = commanded.copy()
        else:
            rows.append(commanded.copy())
            steps.append(step)
    table = np.array(rows)
    left = table[:, [k for k in range(COMMANDED) if k not in _COLUMNS.values()]]
    if left.any():
        raise ParameterError('forces in the axes of the arm or of the tip cannot be inputs of a '
                             'fit, because they follow a motion that is not measured')
    t = scene.step * np.array(steps)
    return {name: Channel(t, table[:, column]) for name, column in _COLUMNS.items()
            if table[:, column].any()}


def _outputs(segment, recording, scene):
    found, held = {}, scene.build().constrained
    skipped = {name for name, still in zip(('carrier_x', 'carrier_y', 'shaft'), held) if still}
    for name, places in _OUTPUTS.items():
        for topic, column in places:
            series = recording.topics.get(topic)
            if series is None or name in skipped or name in found or not len(series.ns):
                continue
            values = series.values[series.resets == series.resets.max(), :]
            ns = series.ns[series.resets == series.resets.max()]
            noise = None
            if recording.scene is not None and topic in _SENSORS:
                # The standard deviation of the noise and rounding.
                deviation, step = (recording.scene.values[f'sensor.{_SENSORS[topic]}.{kind}']
                                   for kind in ('noise', 'resolution'))
                noise = math.hypot(deviation, step / math.sqrt(12.0)) or None
            found[name] = Channel(1e-9 * ns, values[:, series.columns.index(column)], noise)
    return found


_ENTRIES = 'time', 'columns', 'start', 'end'
_KEYS = {'time': ('column', 'unit', 'file', 'period'),
         'columns': ('quantity', 'unit', 'scale', 'offset', 'noise', 'hold', 'knots', 'file',
                     'time')}
_RULES = {name: Parameter(name, 0.0, '', '') for name in ('scale', 'offset', 'start', 'end')}
_RULES.update({name: Parameter(name, 0.0, '', '', low=0.0, open_low=True)
               for name in ('noise', 'period', 'knots')})
_NOT_REAL = {'c': 'it has complex ones', 'M': 'it has stamps', 'm': 'it has durations'}
_RULES['file'] = Parameter('file', '', '', '')


def is_mapping(value: Any) -> bool:
    """Return whether a value says which columns are which quantities, or the file that does."""
    return bool(value) and isinstance(value, (str, Path, Mapping))


@checked(path=PATH, mapping=(is_mapping, 'a path, or values by name'))
def read_record(path: str | Path,
                mapping: str | Path | Mapping[str, Any] | None = None) -> Record:
    """
    Return the Record in a table, or in a log of the node.

    Parameters
    ----------
    path : str or Path
        CSV or other text with columns, Parquet, or MAT (version 5 to 7). Anything else is a log
        without a mapping, and a text with one.
    mapping : str, Path or dict, optional
        A YAML file or its content, see doc/fit.md: which column is which quantity. Without it,
        columns named as `timo_sim export` names them are taken.

    Raises
    ------
    ParameterError, LogError, OSError
        If something in table or mapping is not understood; the file is no log; it cannot be read.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> t = np.arange(100) * 0.01
    >>> np.savetxt('arm.csv', np.column_stack([t, np.sin(t), 20.0 * t]), delimiter=',')
    >>> record = timo_sim.read_record('arm.csv', {'time': {'column': 0}, 'columns': {
    ...     1: 'torque', 2: {'quantity': 'shaft', 'unit': 'deg'}}})
    >>> round(float(record.outputs['shaft'].values[-1]), 4)
    0.3456

    """
    path = Path(path)
    if mapping is None and path.suffix not in SUFFIXES:
        return read_log(path)[1]
    if mapping is None:
        mapping, source = _map_by_names(read_table(path)), str(path)
    elif isinstance(mapping, Mapping):
        source = str(path)
    else:
        mapping, source = read_yaml(mapping), str(mapping)
    try:
        return _record(path, mapping, source)
    except ParameterError as error:
        raise ParameterError(f'{error} ({source})' if source not in str(error)
                             else str(error)) from None


def _record(path, mapping, source):
    _check_keys('a mapping', mapping, _ENTRIES)
    table = cache(lambda name: read_table(path if name is None else path.parent / name))
    time, columns = _time_of(mapping, 'time'), mapping.get('columns')
    if not isinstance(columns, Mapping) or not columns:
        raise ParameterError('columns must say which columns are which quantities, got '
                             + short(columns))
    inputs, outputs, noise, begun = {}, {}, {}, []

    def origin(value):
        # The first stamp is subtracted from all, because it may take most of their digits.
        begun.append(value)
        return begun[0]

    for column, entry in columns.items():
        entry = {'quantity': entry} if isinstance(entry, str) else entry
        _check_keys(f'columns: {column}', entry, _KEYS['columns'])
        name = entry.get('quantity')
        known = {**INPUT_UNITS, **OUTPUTS}
        if not isinstance(name, str) or name not in known:
            raise ParameterError(f'columns: {column}: quantity must be one of '
                                 f'{", ".join(known)}, got {short(name)}'
                                 f'{did_you_mean(name, known)}')
        kept = inputs if name in INPUT_UNITS else outputs
        if name in kept:
            raise ParameterError(f'columns: {name} is given twice')
        file = _entry(entry, 'file', None)
        values = _numbers(table(file).column(column), column)
        factor = _factor(f'columns: {column}', entry.get('unit'), unit_of(name))
        factor *= _entry(entry, 'scale', 1.0)
        own = _time_of(entry, f'columns: {column}: time')
        t = _times({**time, **own}, file, table, len(values), origin)
        with np.errstate(over='ignore'):  # what is not finite is left out
            values = factor * values + _entry(entry, 'offset', 0.0)
        kept[name] = Channel(t, values, hold=entry.get('hold', 'zero'),
                             knots=_entry(entry, 'knots', None))
        if 'noise' in entry:
            noise[name] = abs(factor) * _entry(entry, 'noise', None)
    record = Record.of(inputs, outputs, noise, str(path))
    start, end = _entry(mapping, 'start', 0.0), _entry(mapping, 'end', np.inf)
    return record.cut(start, end) if (start, end) != (0.0, np.inf) else record


def _time_of(entry, place):
    """Return what a mapping or a column has for `time`; a name or number is that of a column."""
    time = entry.get('time', {})
    time = {'column': time} if isinstance(time, str) or type(time) is int else time
    _check_keys(place, time, _KEYS['time'])
    return time


def _times(entry, file, table, count, origin):
    """Return times in s, shape (count,), from the first stamp of all."""
    if 'period' in entry:
        with np.errstate(over='ignore'):
            return _entry(entry, 'period', None) * np.arange(count)
    if 'column' not in entry:
        raise ParameterError('time must have a column or a period [s]')
    values = table(_entry(entry, 'file', file)).column(entry['column'])
    if len(values) != count:
        raise ParameterError(f'time must have as many samples as each column, got {len(values)} '
                             f'for {count}')
    unit, stamps = entry.get('unit'), values.dtype.kind in 'mM'
    if stamps and unit is not None:
        raise ParameterError(f'time: unit must be left out, because the column has stamps with a '
                             f'unit of their own, got {short(unit)}')
    if not stamps:  # whole numbers of ns need all their digits
        values = (values.astype(np.int64) if values.dtype.kind in 'iu'
                  else _numbers(values, entry['column']))
    good = np.flatnonzero(np.isfinite(values))
    try:
        since = values - origin(values[good[0] if len(good) else 0])
        return since / np.timedelta64(1, 's') if stamps else since * _factor('time', unit, 's')
    except TypeError:
        raise ParameterError('time must have stamps for all columns or for none') from None


def _numbers(values, column):
    """Return the values of a column as floats, or raise ParameterError."""
    try:
        if values.dtype.kind in _NOT_REAL or not len(values):
            raise ValueError(_NOT_REAL.get(values.dtype.kind, 'it is empty'))
        return values.astype(float)
    except (TypeError, ValueError) as error:
        raise ParameterError(f'{short(column, str)} must have real numbers: {error}') from None


def _factor(entry, unit, base):
    known = UNITS[base]
    if unit is not None and not (isinstance(unit, str) and unit in known):
        raise ParameterError(f'{entry}: unit must be one of {", ".join(filter(None, known))}, got '
                             f'{short(unit)}')
    return known[base if unit is None else unit]


def _entry(entry, name, default):
    return _RULES[name].check(entry[name]) if name in entry else default


def _check_keys(place, entry, known):
    if not isinstance(entry, Mapping):
        raise ParameterError(f'{place} must have some of {", ".join(known)}, got {short(entry)}')
    for key in entry:
        if key not in known:
            raise ParameterError(f'{place}: {short(key, str)} is not known, but '
                                 f'{", ".join(known)}{did_you_mean(key, known)}')


def _map_by_names(table):
    """Return the mapping of a table whose columns are named as `timo_sim export` names them."""
    columns = {}
    for column in table.names:
        name = _quantity_of_column(column)
        if name and name not in columns.values():
            columns[column] = name
    if 'time_s' not in table.names or not any(name in OUTPUTS for name in columns.values()):
        raise ParameterError('without a mapping the table must have time_s and columns such as '
                             'torque_N_m and shaft_rad; it has '
                             + (short(', '.join(table.names), str) or 'no names'))
    return {'time': {'column': 'time_s'}, 'columns': columns}


def _quantity_of_column(column):
    plain = re.sub(r'^(tip_deflection_|encoder_|motor_torque_|motor_voltage_|carrier_wrench_|'
                   r'tip_wrench_)', '', column)
    plain = {'transverse_m': 'tip_transverse_m', 'tip_pose_x_m': 'tip_x_m',
             'tip_pose_y_m': 'tip_y_m', **{
                 f'{title(sensor.topic)}_{sensor.columns[-1]}': with_unit(
                     sensor.measured, sensor.unit) for sensor in _MEASURING}}.get(plain, plain)
    for name in (*INPUT_UNITS, *OUTPUTS):
        if plain == with_unit(name, unit_of(name)):
            return name
    return None
