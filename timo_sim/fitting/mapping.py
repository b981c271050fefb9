# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The Record in a file, and the mapping that says which of its columns are which quantities."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from timo_sim.fitting.logs import read_log
from timo_sim.fitting.record import Channel, INPUT_UNITS, OUTPUTS, Record, unit_of, UNITS
from timo_sim.fitting.response import response_of
from timo_sim.log.columns import read_table, SUFFIXES
from timo_sim.scene.files import read_yaml
from timo_sim.scene.parameters import (
    check_keys, checked, did_you_mean, Parameter, ParameterError, PATH, short)

_ENTRIES = 'time', 'columns', 'start', 'end'
_KEYS = {'time': ('column', 'unit', 'file', 'period'),
         'columns': ('quantity', 'unit', 'scale', 'offset', 'noise', 'hold', 'knots', 'file',
                     'time')}
_RULES = {name: Parameter(name, 0.0, '', '') for name in ('scale', 'offset', 'start', 'end')}
_RULES |= {'file': Parameter('file', '', '', ''),
           **{name: Parameter(name, 0.0, '', '', low=0.0, open_low=True)
              for name in ('noise', 'period', 'knots')}}
_NOT_REAL = {'c': 'it has complex ones', 'M': 'it has stamps', 'm': 'it has durations'}


@checked(path=PATH, mapping=(
    lambda value: value and isinstance(value, (str, Path, Mapping)), 'a path, or values by name'))
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
        A YAML file or its content, see doc/fit.md: which column of a table is which quantity.

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
        raise ParameterError(f'mapping must be given with {path}: it says which columns are which '
                             'quantities, see doc/fit.md; a log of the node needs none')
    source = str(path if isinstance(mapping, Mapping) else mapping)
    mapping = mapping if isinstance(mapping, Mapping) else read_yaml(mapping)
    try:
        return _record(path, mapping, source)
    except ParameterError as error:
        raise ParameterError(f'{error} ({source})' if source not in str(error)
                             else str(error)) from None


def _record(path, mapping, source):
    if isinstance(mapping, Mapping) and 'frequency' in mapping:
        return response_of(mapping, read_table(path), str(path))
    check_keys('a mapping', mapping, _ENTRIES)
    table = cache(lambda name: read_table(path if name is None else path.parent / name))
    time, columns = _time_of(mapping, 'time'), mapping.get('columns')
    if not isinstance(columns, Mapping) or not columns:
        raise ParameterError('columns must say which columns are which quantities, got '
                             + short(columns))
    inputs, outputs, begun = {}, {}, []
    for column, entry in columns.items():
        entry = {'quantity': entry} if isinstance(entry, str) else entry
        check_keys(f'columns: {column}', entry, _KEYS['columns'])
        name = entry.get('quantity')
        known = {**INPUT_UNITS, **OUTPUTS}
        if not isinstance(name, str) or name not in known:
            raise ParameterError(
                f'columns: {column}: quantity must be one of {", ".join(known)}, got '
                f'{short(name)}{did_you_mean(name, known)}')
        kept = inputs if name in INPUT_UNITS else outputs
        if name in kept:
            raise ParameterError(f'columns: {name} is given twice')
        file = _entry(entry, 'file', None)
        values = _numbers(table(file).column(column), column)
        factor = _factor(f'columns: {column}', entry.get('unit'), unit_of(name))
        factor *= _entry(entry, 'scale', 1.0)
        own = _time_of(entry, f'columns: {column}: time')
        common = {key: time[key] for key in time if key != 'period' or 'column' not in own}
        t = _times({**common, **own}, file, table, len(values), begun)
        with np.errstate(over='ignore'):  # what is not finite is left out
            values = factor * values + _entry(entry, 'offset', 0.0)
        noise = abs(factor) * _entry(entry, 'noise', None) if 'noise' in entry else None
        kept[name] = Channel(t, values, noise, entry.get('hold', 'zero'),
                             _entry(entry, 'knots', None))
    record = Record.of(inputs, outputs, str(path))
    start, end = _entry(mapping, 'start', 0.0), _entry(mapping, 'end', np.inf)
    return record.cut(start, end) if (start, end) != (0.0, np.inf) else record


def _time_of(entry, place):
    """Return what a mapping or a column has for `time`; a name or number is that of a column."""
    time = entry.get('time', {})
    time = {'column': time} if isinstance(time, str) or type(time) is int else time
    check_keys(place, time, _KEYS['time'])
    return time


def _times(entry, file, table, count, begun):
    """Return times in s, shape (count,), from the first stamp of all, the first in `begun`."""
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
    # The first stamp is subtracted from all, because it may take most of their digits.
    begun.append(values[good[0] if len(good) else 0])
    try:
        since = values - begun[0]
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
