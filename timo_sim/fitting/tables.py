# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Read the columns of a table from CSV and other text, Parquet or MAT files."""

import codecs
import csv

import numpy as np

from timo_sim.extras import optional
from timo_sim.scene.parameter import ParameterError, short

SUFFIXES = '.csv', '.txt', '.dat', '.tsv', '.parquet', '.mat'
_COMMENT = '%#'
_SEPARATORS = ';', '\t', ',', None       # None: white space
_MISSING = '', 'na', 'n/a', '#n/a', 'null', 'none'


class Table:
    """
    The columns of a file.

    Parameters
    ----------
    columns : list of tuple
        Of each column its names, a list, and its values, shape (n,) or (n, m).
    hint : str
        For errors: why columns have no names.

    """

    def __init__(self, columns, hint=''):
        self._columns, self._hint = columns, hint

    @property
    def names(self):
        """All names of columns, a list."""
        return [name for names, _ in self._columns for name in names]

    def column(self, key):
        """
        Return the values of a column, shape (n,), as they are in the file.

        Parameters
        ----------
        key : str or int
            A name, a number from 0, or NAME:NUMBER for a column of a matrix, or for a row if it
            has more columns than rows.

        """
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
        raise ParameterError(f'{short(key, str)} is no column of the table; it has '
                             f'{", ".join(self._shown())[:300]}{self._hint}')

    def _shown(self):
        for place, (names, values) in enumerate(self._columns):
            name = ' '.join(names) or str(place)
            yield (name if values.ndim == 1 else
                   f'{name}:0 to {name}:{len(_series(values)) - 1}')


def read_table(path):
    """Return the Table in a file, or raise ParameterError."""
    if path.exists() and not path.is_file():  # a pipe or device may have no end
        raise ParameterError(f'{path} is not a file')
    if path.suffix == '.parquet':
        return Table(_parquet(path))
    if path.suffix == '.mat':
        return Table(_mat(path))
    return _text(path)


def _series(matrix):
    """Return the series in a matrix: its columns, or its rows if they are longer."""
    return matrix if matrix.shape[0] < matrix.shape[1] else matrix.T


def _parquet(path):
    with optional():
        import pyarrow
        import pyarrow.parquet
    try:
        found = pyarrow.parquet.read_table(path).flatten()
        return [([name], values.to_numpy())
                for name, values in zip(found.column_names, found.columns)]
    except (pyarrow.ArrowException, ValueError) as error:
        raise ParameterError(f'{path} cannot be read: {error}') from None


def _mat(path):
    from scipy.io import loadmat
    try:
        found = loadmat(path, simplify_cells=True)
    except OSError:
        raise
    except Exception as error:  # of many types, for damaged files
        raise ParameterError(f'{path} cannot be read, save it with -v7: {error}') from None
    columns = [([name], values) for name, values in _flat(found, '')]
    if not columns:
        raise ParameterError(f'{path} has no arrays of numbers; save timeseries and other objects '
                             'as arrays or structs')
    return columns


def _flat(value, name):
    """Yield names, with .FIELD for a struct and [k] for an element of an array, and arrays."""
    if isinstance(value, dict):
        for field, each in value.items():
            if not field.startswith('__'):
                yield from _flat(each, f'{name}.{field}'.lstrip('.'))
    elif isinstance(value, list) or isinstance(value, np.ndarray) and value.dtype == object:
        for k, each in enumerate(value):
            yield from _flat(each, f'{name}[{k}]')
    elif isinstance(value, np.ndarray) and value.dtype.kind in 'biufc' and value.ndim in (1, 2):
        yield name, value


def _text(path):
    """Return the Table in a text; names are in lines above the numbers, or begin its rows."""
    content = path.read_bytes()
    wide = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    text = content.decode('utf-16' if wide else 'utf-8', errors='replace')
    try:
        return _of_lines(text.lstrip('\ufeff').splitlines(), path)
    except csv.Error as error:
        raise ParameterError(f'{path} is not a table: {error}') from None


def _of_lines(lines, path):
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
    return _named(values, heads, separator)


def _named(values, heads, separator):
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
