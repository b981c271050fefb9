# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Serialise messages as CDR, and locate the numbers and texts in serialised ones."""

import struct
from typing import NamedTuple

from timo_sim.messages.definitions import DEFINITIONS, fields

TYPES = frozenset(DEFINITIONS)
_START = 4                     # bytes of the header; alignment counts from its end
_LITTLE_ENDIAN = b'\x00\x01'   # plain CDR
_NUMBERS = {'byte': 'B', 'int32': 'i', 'uint32': 'I', 'float64': 'd'}  # codes of `struct`


class CdrError(ValueError):
    """A message does not match its type; the text says why."""


class Layout(NamedTuple):
    """
    Places of the parts of a message, in bytes from its beginning.

    Messages of the same size with the same bytes at the places `fixed` have the same layout.
    """

    size: int            # [B], without the padding that some writers add at the end
    stamps: list         # place of the seconds of each time; its nanoseconds follow
    doubles: list        # place of each float64
    lists: list          # number of float64 in each sequence, and in the fields between sequences
    texts: list          # the texts themselves
    fixed: list          # places of the bytes of encoding, texts, integers and lengths

    def split(self, numbers):
        """Return the float64 of a message, given in order, split as in `lists`."""
        parts, place = [], 0
        for length in self.lists:
            parts.append(numbers[place:place + length])
            place += length
        return parts

    def meant(self):
        """Return the places of all bytes with content; the others are padding."""
        return [*self.fixed, *(place + byte for place in (*self.stamps, *self.doubles)
                               for byte in range(8))]


def layout(type_name, data):
    """
    Return the Layout of a serialised message of one of TYPES.

    Raises
    ------
    CdrError
        If the message is too short, or not in little-endian plain CDR.

    """
    walk = _Walk(data)
    walk.value(type_name)
    return walk.found._replace(size=walk.place)


def pack(type_name, values):
    """
    Return a serialised message, little-endian CDR with zeros as padding.

    Parameters
    ----------
    type_name : str
        One of TYPES.
    values : dict
        Values by name of field: numbers, str, dict for messages, lists for arrays. A field that
        is missing has its default, which is zero or empty unless the definition says otherwise
        (w of a quaternion is 1).

    Raises
    ------
    CdrError
        If a field is unknown, or an array of fixed length is given with another length.

    Examples
    --------
    >>> pack('std_msgs/msg/Float64', {'data': 1.0}).hex()
    '00010000000000000000f03f'

    """
    data = bytearray(_LITTLE_ENDIAN + bytes(_START - len(_LITTLE_ENDIAN)))
    _append(data, type_name, values)
    return bytes(data)


def _append(data, type_name, value):
    if type_name == 'string':
        text = value.encode() + b'\0'
        _append(data, 'uint32', len(text))
        data += text
    elif type_name in _NUMBERS:
        code = '<' + _NUMBERS[type_name]
        data += bytes((_START - len(data)) % struct.calcsize(code)) + struct.pack(code, value)
    else:
        unknown = value.keys() - {field.name for field in fields(type_name)}
        if unknown:
            raise CdrError(f'{type_name} has no field {", ".join(sorted(unknown))}')
        for field in fields(type_name):
            elements = value.get(field.name, field.default)
            if field.length is None:
                elements = [elements]
            elif field.length == 0:
                _append(data, 'uint32', len(elements))
            elif field.length != len(elements):
                raise CdrError(f'{field.name} of {type_name} must have {field.length} elements, '
                               f'got {len(elements)}')
            for element in elements:
                _append(data, field.type_name, element)


class _Walk:
    """Reads through a message, and notes in `found` where its values are."""

    def __init__(self, data):
        self._data, self.place = data, _START
        self._in_a_row = False  # whether further float64 belong to the last of `found.lists`
        self.found = Layout(0, [], [], [], [], [0, 1])
        if bytes(data[:2]) != _LITTLE_ENDIAN:
            raise CdrError(f'its encoding is {bytes(data[:2])!r}, not {_LITTLE_ENDIAN!r}')

    def value(self, type_name):
        if type_name == 'builtin_interfaces/msg/Time':
            self.found.stamps.append(self._pass(8, 4))
        elif type_name == 'float64':
            self._doubles(1)
        elif type_name == 'string':
            text = bytes(self._data[slice(*self._fixed(self._count(), 1))])
            self.found.texts.append(text.removesuffix(b'\0').decode(errors='replace'))
        elif type_name in _NUMBERS:
            size = struct.calcsize('<' + _NUMBERS[type_name])
            self._fixed(size, size)
        else:
            for field in fields(type_name):
                self._field(field.type_name, field.length)

    def _field(self, type_name, length):
        if length is None:
            self.value(type_name)
        elif type_name != 'float64':
            for _ in range(length or self._count()):
                self.value(type_name)
        elif length:
            self._doubles(length)
        else:
            self.found.lists.append(0)
            self._in_a_row = True
            self._doubles(self._count())
            self._in_a_row = False

    def _doubles(self, count):
        if not self._in_a_row:
            self._in_a_row = True
            self.found.lists.append(0)
        if count:  # an empty sequence is not followed by padding
            self.found.lists[-1] += count
            self.found.doubles.extend(range(self._pass(8 * count, 8), self.place, 8))

    def _count(self):
        return struct.unpack_from('<I', self._data, self._fixed(4, 4)[0])[0]

    def _fixed(self, size, alignment):
        begin = self._pass(size, alignment)
        self.found.fixed.extend(range(begin, self.place))
        return begin, self.place

    def _pass(self, size, alignment):
        begin = self.place + (_START - self.place) % alignment
        self.place = begin + size
        if self.place > len(self._data):
            raise CdrError('it is too short')
        return begin
