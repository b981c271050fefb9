# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The columns of a text, a Parquet or a MAT file."""

from __future__ import annotations

import codecs
import csv
from pathlib import Path
import pickle
import subprocess
import sys

import numpy as np

from timo_sim.extras import optional
from timo_sim.scene.parameters import ParameterError, short

SUFFIXES = '.csv', '.txt', '.dat', '.tsv', '.parquet', '.mat'
_COMMENT = '%#'
_SEPARATORS = ';', '\t', ',', None       # None: white space
_MISSING = '', 'na', 'n/a', '#n/a', 'null', 'none'


class Columns:
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
            # The series in a matrix are its columns, or its rows if they are longer.
            if name in names and values.ndim == 2 and number.isdigit() and (
                    int(number) < len(series := min(values.T, values, key=len))):
                return series[int(number)]
        shown = [' '.join(names) or str(place) for place, (names, _) in enumerate(self._columns)]
        raise ParameterError(f'{short(key, str)} is no column of the table; it has '
                             f'{", ".join(shown)[:300]}{self._hint}')


def read_table(path: Path) -> Columns:
    """Return the Columns in a file, or raise ParameterError."""
    if path.exists() and not path.is_file():  # a pipe or device may have no end
        raise ParameterError(f'{path} is not a file')
    readers = {'.parquet': _read_parquet, '.mat': _read_mat}
    return readers.get(path.suffix, _read_text)(path)


def _read_parquet(path):
    with optional():
        import pyarrow
        import pyarrow.parquet
    try:
        found = pyarrow.parquet.read_table(path).flatten()
        return Columns([([name], values.to_numpy())
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
    return Columns(columns)


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
    """Return the Columns in a text; names are in lines above the numbers."""
    content = path.read_bytes()
    wide = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    text = content.decode('utf-16' if wide else 'utf-8', errors='replace')
    try:
        return _parse_lines(text.lstrip('\ufeff').splitlines(), path)
    except csv.Error as error:
        raise ParameterError(f'{path} is not a table: {error}') from None


def _parse_lines(lines, path):
    good = [line for line in lines if line.strip() and line.strip()[0] not in _COMMENT]
    first, separator = _first_numbers(good, path)
    rows = [*_cells(good[first:], separator)]
    for number, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise ParameterError(f'{path}: row {number + 1} of numbers has {len(row)} columns, '
                                 f'the first has {len(rows[0])}')
    texts = [cell for row in rows for cell in row]
    if any(',' in text for text in texts) and (
            separator == ',' or any('.' in text for text in texts)):
        raise ParameterError(f'{path} must have decimal points, or decimal commas alone and '
                             'another separator than commas')
    try:
        values = np.array([*map(_number, texts)]).reshape(len(rows), -1)
    except ValueError as error:
        raise ParameterError(f'{path} must have numbers alone: {error}') from None
    above = [line.strip(_COMMENT + ' \t') if line.strip()[:1] in [*_COMMENT] else line
             for line in lines[:lines.index(good[first])]]
    heads = [[name.strip() for name in head] for head in _cells(above, separator)]
    return _name_columns(values, heads, separator)


def _name_columns(values, heads, separator):
    """Return the Columns of a matrix with lines of names or units above it."""
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
    return Columns([([head[k] for head in kept if head[k]], each)
                    for k, each in enumerate(values.T)], '' if kept else hint)


def _first_numbers(lines, path):
    """Return the place of the first line of numbers, and its separator."""
    for first, line in enumerate(lines):
        for separator in _SEPARATORS:
            if separator and separator not in line:
                continue
            cells = next(_cells([line], separator), [])
            try:
                if np.isfinite([*map(_number, cells)]).any():
                    return first, separator
            except ValueError:
                continue
    raise ParameterError(f'{path} has no line of numbers')


def _cells(lines, separator):
    """Return the cells of each line with any."""
    if separator is None:
        lines = (' '.join(line.split()) for line in lines)
    return filter(None, csv.reader(lines, delimiter=separator or ' ', skipinitialspace=True))


def _number(text):
    text = text.strip()
    return np.nan if text.lower() in _MISSING else float(text.replace(',', '.'))
