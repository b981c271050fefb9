# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Read the messages of a topic as arrays, a chunk at a time, without a loop over messages."""

from dataclasses import dataclass

import numpy as np

from timo_sim.messages.cdr import CdrError, layout
from timo_sim.messages.commands import COMMANDS, LARGEST, Refused
from timo_sim.messages.outputs import NANOSECONDS, outputs

_HEAD = 31              # [B] of a message's record before its content, see `_HEAD_TYPE`
_HEAD_TYPE = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'),
                       ('sequence', '<u4'), ('log_time', '<u8'), ('publish_time', '<u8')])
_MOST_LAYOUTS = 100     # of a topic; names of frames in commands have different lengths
_COMMANDS = {command.name: command for command in COMMANDS}


@dataclass(frozen=True)
class Series:
    """
    The messages of a topic.

    Attributes
    ----------
    topic : str
    columns : tuple of str
        Names of k quantities, with units.
    step : ndarray of int64, shape (n,)
        Time steps; -1 in a plain bag, which has none.
    ns : ndarray of int64, shape (n,)
        Sim time [ns]. In a plain bag it is the stamp of the header. Stamps of commands mean
        nothing there: it is the sim time at their log time or, if that is not known, log time.
    log_ns : ndarray of int64, shape (n,)
        Time at which a message was logged [ns].
    values : ndarray, shape (n, k)
        NaN for what a command does not set.
    refused : int
        Commands that are left out, because the node refuses them.
    resets : ndarray of int64, shape (n,)
        How many resets were before a message; -1 if that is not known.
    data : list of bytes
        The messages of a command, CDR; empty for other topics.

    """

    topic: str
    columns: tuple
    step: np.ndarray
    ns: np.ndarray
    log_ns: np.ndarray
    values: np.ndarray
    refused: int
    resets: np.ndarray
    data: list


class Collector:
    """Gathers the messages of a topic; `frames` are the names of frames in commands."""

    def __init__(self, name, topic, type_name, frames):
        self.name, self.topic, self.type_name = name, topic, type_name
        self._frames = frames
        self.command = _COMMANDS.get(name)
        self.columns = self.command.names if self.command else ()
        self.refused = 0
        self._layouts, self._parts = [], []

    def add(self, place, data, offsets, channel):
        """Add the messages at these offsets in a block of data."""
        if not len(offsets):
            return
        heads = _gather(data, offsets, _HEAD_TYPE)
        sizes = heads['length'] - (_HEAD - 9)
        # A forged index might point outside, or to the same place twice.
        if not (np.all(heads['opcode'] == 5) and np.all(heads['channel'] == channel)
                and np.all(sizes <= len(data)) and np.all(offsets + _HEAD + sizes <= len(data))
                and np.all(np.diff(np.sort(offsets)) >= _HEAD)
                and sizes.sum() + _HEAD * len(sizes) <= len(data)):
            raise CdrError('the index points to something else')
        for size in np.unique(sizes):
            if not 4 <= size <= LARGEST:
                raise CdrError(f'it has {size} bytes')
            same = np.flatnonzero(sizes == size)
            rows = _gather(data, offsets[same] + np.uint64(_HEAD), np.dtype(f'V{size}')).view(
                np.uint8).reshape(len(same), -1)
            while len(rows):
                found = self._layout(bytes(rows[0]))
                alike = np.all(rows[:, found.fixed] == rows[0, found.fixed], axis=1)
                self._keep(place, offsets[same[alike]], heads[same[alike]], found, rows[alike])
                same, rows = same[~alike], rows[~alike]

    def _layout(self, data):
        for known, size, text in self._layouts:
            if len(data) == size and bytes(data[place] for place in known.fixed) == text:
                return known
        found = layout(self.type_name, data)
        self._layouts.append((found, len(data), bytes(data[place] for place in found.fixed)))
        if len(self._layouts) > (_MOST_LAYOUTS if self.command else 1):
            raise CdrError('its texts or lists are not those of the messages before it')
        if not self.command:
            self._name_columns(found)
        return found

    def _name_columns(self, found):
        texts = found.texts[1:]  # after the frame
        by_name = {output.name: output for output in outputs(max(1, len(texts)))}
        output = by_name[self.name]
        self.columns, self._places = output.columns, output.places
        if texts != output.texts[1:] or len(found.doubles) <= max(self._places, default=-1):
            raise CdrError(f'{", ".join(texts)[:80]} are not the joints of this node')

    def _keep(self, place, offsets, heads, found, rows):
        """Keep messages of one layout, for `arrays`."""
        log_ns, messages = heads['log_time'].astype(np.int64), np.empty(len(rows), object)
        if self.command:
            kept, loads = [], []
            for number, row in enumerate(_doubles(rows, found.doubles).tolist()):
                try:
                    loads.append(self.command.row(
                        found.texts, found.split(row), self._frames))
                    kept.append(number)
                    messages[number] = rows[number].tobytes()
                except Refused:
                    self.refused += 1
            offsets, heads, log_ns, messages = (
                array[kept] for array in (offsets, heads, log_ns, messages))
            ns, values = log_ns, np.array(loads, dtype=float).reshape(-1, len(self.columns))
        else:
            values = _doubles(rows, [found.doubles[place] for place in self._places])
            first = found.stamps[0]
            stamp = np.ascontiguousarray(rows[:, first:first + 8]).view('<i4')
            # As int64 before the product, which NumPy 1.26 would take in 32 bits.
            ns = NANOSECONDS * stamp[:, 0].astype(np.int64) + stamp[:, 1]
        self._parts.append((np.full(len(heads), place), offsets,
                            heads['sequence'].astype(np.int64), log_ns, ns, values, messages))

    def arrays(self):
        """
        Return arrays of n messages in the order of the file.

        They are: place, sequence number, log time [ns] and stamp [ns], int64; values, shape
        (n, k); bytes of commands. The stamp of a command is its log time.
        """
        none = np.zeros(0, dtype=np.int64)
        place, offset, *others = map(np.concatenate, zip(*self._parts or [
            (*[none] * 5, np.zeros((0, len(self.columns))), np.zeros(0, object))]))
        order = np.lexsort((offset, place))
        return tuple(array[order] for array in (place, *others))


def _gather(data, offsets, kind):
    """Return an element of the type `kind` from each of these offsets, shape (n,)."""
    last = len(data) - kind.itemsize
    if last < 0 or int(offsets.max()) > last:
        raise CdrError('the index points to something outside of its chunk')
    return np.ndarray((last + 1,), kind, data, strides=(1,))[offsets]


def _doubles(rows, places):
    columns = [place + byte for place in places for byte in range(8)]
    return np.ascontiguousarray(rows[:, columns]).view('<f8').reshape(len(rows), len(places))


def common(first, second):
    """
    Return the places of the same values in two ascending lists, pairwise.

    If a value occurs several times, as the step of a reset may, the last ones are paired.
    """
    if np.array_equal(first, second):
        return slice(None), slice(None)
    keys = []
    for values in (first, second):
        _, place, count = np.unique(values, return_index=True, return_counts=True)
        left = np.repeat(place + count, count) - np.arange(len(values))  # 1 for the last of each
        keys.append(np.rec.fromarrays([values, left]))
    _, one, other = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
    order = np.argsort(one)
    return one[order], other[order]
