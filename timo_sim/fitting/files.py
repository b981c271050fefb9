# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Read a record from CSV, Parquet or MAT files, by a mapping from columns to quantities."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
import re
from typing import Any

import numpy as np

from timo_sim.extras import optional
from timo_sim.fitting.from_log import read_log
from timo_sim.fitting.quantities import INPUTS, OUTPUTS, unit_of, UNITS
from timo_sim.fitting.record import Channel, Record
from timo_sim.scene.files import read_yaml
from timo_sim.scene.parameter import did_you_mean, Parameter, ParameterError, short

SUFFIXES = '.csv', '.txt', '.dat', '.tsv', '.parquet', '.mat'
_ENTRIES = 'time', 'columns', 'start', 'end'
_KEYS = {'time': ('column', 'unit', 'file', 'period'),
         'columns': ('quantity', 'unit', 'scale', 'offset', 'noise', 'hold', 'knots', 'file',
                     'time')}
_NUMBERS = {name: Parameter(name, 0.0, '', '') for name in ('scale', 'offset', 'start', 'end')}
_NUMBERS.update({name: Parameter(name, 0.0, '', '', low=0.0, open_low=True)
                 for name in ('noise', 'period', 'knots')})
_COMMENT = '%#'


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
    ParameterError
        If something in table or mapping is not understood; the text says what.
    LogError
        If the file is not a log.
    OSError
        If a file cannot be read.

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
        mapping, source = _by_names(_table(path)), str(path)
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
    table = cache(lambda name: _table(path if name is None else path.parent / name))
    time, columns = mapping.get('time', {}), mapping.get('columns')
    if not isinstance(columns, Mapping) or not columns:
        raise ParameterError('columns must say which columns are which quantities, got '
                             + short(columns))
    inputs, outputs, noise, begun = {}, {}, {}, []

    def origin(value):  # the first stamp, which is subtracted, because it may take most digits
        begun.append(value)
        return begun[0]

    for column, entry in columns.items():
        entry = {'quantity': entry} if isinstance(entry, str) else entry
        _check_keys(f'columns: {column}', entry, _KEYS['columns'])
        name = entry.get('quantity')
        known = {**INPUTS, **OUTPUTS}
        if name not in known:
            raise ParameterError(f'columns: {column}: quantity must be one of '
                                 f'{", ".join(known)}, got {short(name)}'
                                 f'{did_you_mean(name, known)}')
        kept = inputs if name in INPUTS else outputs
        if name in kept:
            raise ParameterError(f'columns: {name} is given twice')
        values = _column(table(entry.get('file')), column)
        factor = _factor(f'columns: {column}', entry.get('unit'), unit_of(name))
        factor *= _number(entry, 'scale', 1.0)
        t = _times({**time, **entry.get('time', {})}, entry.get('file'), table, len(values),
                   origin)
        kept[name] = Channel(t, factor * values + _number(entry, 'offset', 0.0),
                             hold=entry.get('hold', 'zero'),
                             knots=_number(entry, 'knots', None))
        if 'noise' in entry:
            noise[name] = abs(factor) * _number(entry, 'noise', None)
    record = Record.of(inputs, outputs, noise, source)
    start, end = _number(mapping, 'start', 0.0), _number(mapping, 'end', np.inf)
    return record.cut(start, end) if (start, end) != (0.0, np.inf) else record


def _times(entry, file, table, count, origin):
    _check_keys('time', entry, _KEYS['time'])
    if 'period' in entry:
        return _number(entry, 'period', None) * np.arange(count)
    if 'column' not in entry:
        raise ParameterError('time must have a column or a period [s]')
    values = _column(table(entry.get('file', file)), entry['column'])
    if len(values) != count:
        raise ParameterError(f'time must have as many samples as each column, got {len(values)} '
                             f'for {count}')
    return (values - origin(float(values[0]))) * _factor('time', entry.get('unit'), 's')


def _factor(entry, unit, base):
    known = UNITS[base]
    if unit is not None and unit not in known:
        raise ParameterError(f'{entry}: unit must be one of {", ".join(known)}, got '
                             f'{short(unit)}')
    return known[base if unit is None else unit]


def _number(entry, name, default):
    return _NUMBERS[name].check(entry[name]) if name in entry else default


def _check_keys(place, entry, known):
    if not isinstance(entry, Mapping):
        raise ParameterError(f'{place} must have some of {", ".join(known)}, got {short(entry)}')
    for key in entry:
        if key not in known:
            raise ParameterError(f'{place}: {short(key, str)} is not known, but '
                                 f'{", ".join(known)}{did_you_mean(key, known)}')


def _by_names(table):
    """Return the mapping of a table whose columns are named as `timo_sim export` names them."""
    columns = {}
    for column in table:
        name = _quantity(str(column))
        if name and name not in columns.values():
            columns[column] = name
    if 'time_s' not in table or not any(name in OUTPUTS for name in columns.values()):
        raise ParameterError('without a mapping the table must have time_s and columns such as '
                             'torque_N_m and shaft_rad; it has '
                             + short(', '.join(map(str, table)), str))
    return {'time': {'column': 'time_s'}, 'columns': columns}


def _quantity(column):
    plain = re.sub(r'^(tip_deflection_|encoder_|motor_torque_|motor_voltage_|carrier_wrench_|'
                   r'tip_wrench_)', '', column)
    plain = {'transverse_m': 'tip_transverse_m', 'root_strain_outer_fibre': 'root_strain',
             'tip_imu_data_raw_acceleration_y_m_per_s2': 'tip_acceleration_m_per_s2',
             'tip_pose_x_m': 'tip_x_m', 'tip_pose_y_m': 'tip_y_m'}.get(plain, plain)
    for name in (*INPUTS, *OUTPUTS):
        unit = unit_of(name).replace(' ', '_').replace('/', '_per_')
        if plain == (f'{name}_{unit}' if unit else name):
            return name
    return None


def _column(table, column):
    """Return a column by name, number, or NAME:NUMBER for one of a matrix, shape (n,)."""
    name, _, number = str(column).rpartition(':')
    if name in table and number.isdigit() and np.ndim(table[name]) == 2:
        matrix = np.asarray(table[name], dtype=float)
        if int(number) < matrix.shape[1]:
            return matrix[:, int(number)]
    elif column in table or str(column) in table:
        values = np.asarray(table[column if column in table else str(column)], dtype=float)
        if values.ndim == 1 or 1 in values.shape:
            return values.ravel()
    elif isinstance(column, int) and 0 <= column < len(table):
        return np.asarray([*table.values()][column], dtype=float)
    shown = [f'{name}:0 to {name}:{values.shape[1] - 1}' if np.ndim(values) == 2
             and 1 not in values.shape else str(name) for name, values in table.items()]
    raise ParameterError(f'{short(column, str)} is no column of the table; it has '
                         f'{", ".join(shown)[:300]}')


def _table(path):
    """Return the columns of a file by name."""
    if path.suffix == '.parquet':
        with optional():
            import pyarrow.parquet
        found = pyarrow.parquet.read_table(path)
        return {name: found[name].to_numpy(zero_copy_only=False) for name in found.column_names}
    if path.suffix == '.mat':
        from scipy.io import loadmat
        try:
            found = loadmat(path)
        except (NotImplementedError, ValueError) as error:
            raise ParameterError(f'{path} cannot be read, save it with -v7: {error}') from None
        return {name: values for name, values in found.items()
                if not name.startswith('__') and np.issubdtype(values.dtype, np.number)}
    return _text(path)


def _text(path):
    """Return the columns of a text; its names, if any, are in the last line before the numbers."""
    with open(path, encoding='utf-8', errors='replace') as stream:
        lines = [line.strip() for line in stream]
    for first, line in enumerate(lines):
        if line and line[0] not in _COMMENT and re.match(r'[-+.\d]|nan\b|inf\b', line, re.I):
            break
    else:
        raise ParameterError(f'{path} has no line of numbers')
    separator = next((each for each in (',', ';', '\t') if each in lines[first]), None)
    rows = [line.split(separator) for line in lines[first:] if line and line[0] not in _COMMENT]
    width = len(rows[0])
    for number, row in enumerate(rows):
        if len(row) != width:
            raise ParameterError(f'{path}: row {number + 1} of numbers has {len(row)} columns, '
                                 f'the first has {width}')
    try:
        values = np.array([[float(cell) if cell.strip() else np.nan for cell in row]
                           for row in rows])
    except ValueError as error:
        raise ParameterError(f'{path} must have numbers alone: {error}') from None
    head = lines[first - 1].lstrip(_COMMENT).split(separator) if first else []
    names = [name.strip().strip('"') for name in head]
    if len({*names}) < width or len(names) < width:
        return dict(enumerate(values.T))
    return dict(zip(names, values.T))
