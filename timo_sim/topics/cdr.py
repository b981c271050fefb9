# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Definitions of the messages that are logged, and their serialisation as CDR.

Numbers and texts are located in serialised messages, so that they can be read and written fast.
"""

from collections.abc import Mapping
from functools import cache
from itertools import accumulate
from operator import itemgetter
import re
import struct
from typing import Any, NamedTuple

# Lines of the .msg files, without comments; sorted by package.
DEFINITIONS = {
    'builtin_interfaces/msg/Time': ('int32 sec', 'uint32 nanosec'),
    'diagnostic_msgs/msg/DiagnosticArray': (
        'std_msgs/Header header', 'DiagnosticStatus[] status'),
    'diagnostic_msgs/msg/DiagnosticStatus': (
        'byte OK=0', 'byte WARN=1', 'byte ERROR=2', 'byte STALE=3', 'byte level', 'string name',
        'string message', 'string hardware_id', 'KeyValue[] values'),
    'diagnostic_msgs/msg/KeyValue': ('string key', 'string value'),
    'geometry_msgs/msg/Point': ('float64 x', 'float64 y', 'float64 z'),
    'geometry_msgs/msg/Pose': ('Point position', 'Quaternion orientation'),
    'geometry_msgs/msg/PoseStamped': ('std_msgs/Header header', 'Pose pose'),
    'geometry_msgs/msg/Quaternion': ('float64 x 0', 'float64 y 0', 'float64 z 0', 'float64 w 1'),
    'geometry_msgs/msg/Transform': ('Vector3 translation', 'Quaternion rotation'),
    'geometry_msgs/msg/TransformStamped': (
        'std_msgs/Header header', 'string child_frame_id', 'Transform transform'),
    'geometry_msgs/msg/Vector3': ('float64 x', 'float64 y', 'float64 z'),
    'geometry_msgs/msg/Vector3Stamped': ('std_msgs/Header header', 'Vector3 vector'),
    'geometry_msgs/msg/Wrench': ('Vector3 force', 'Vector3 torque'),
    'geometry_msgs/msg/WrenchStamped': ('std_msgs/Header header', 'Wrench wrench'),
    'rosgraph_msgs/msg/Clock': ('builtin_interfaces/Time clock',),
    'sensor_msgs/msg/Imu': (
        'std_msgs/Header header',
        'geometry_msgs/Quaternion orientation', 'float64[9] orientation_covariance',
        'geometry_msgs/Vector3 angular_velocity', 'float64[9] angular_velocity_covariance',
        'geometry_msgs/Vector3 linear_acceleration', 'float64[9] linear_acceleration_covariance'),
    'sensor_msgs/msg/JointState': (
        'std_msgs/Header header', 'string[] name', 'float64[] position', 'float64[] velocity',
        'float64[] effort'),
    'std_msgs/msg/Float64': ('float64 data',),
    'std_msgs/msg/Float64MultiArray': ('MultiArrayLayout layout', 'float64[] data'),
    'std_msgs/msg/Header': ('builtin_interfaces/Time stamp', 'string frame_id'),
    'std_msgs/msg/MultiArrayDimension': ('string label', 'uint32 size', 'uint32 stride'),
    'std_msgs/msg/MultiArrayLayout': ('MultiArrayDimension[] dim', 'uint32 data_offset'),
    'std_msgs/msg/String': ('string data',),
    'tf2_msgs/msg/TFMessage': ('geometry_msgs/TransformStamped[] transforms',),
}

_FIELD = re.compile(r'([\w/]+)(\[\d*\])? (\w+)(?: (\S+))?')


class Field(NamedTuple):
    """A field of a message."""

    name: str
    type_name: str        # 'float64', 'string', ... or as in 'geometry_msgs/msg/Point'
    length: int | None    # of an array; 0 for a sequence of any length, None for a single value
    default: Any          # what a new message holds: 0, '', {} or an array of these


@cache
def fields(type_name: str) -> tuple[Field, ...]:
    """Return the fields of a message type of DEFINITIONS in order, a tuple of Field."""
    found = []
    for line in DEFINITIONS[type_name]:
        if '=' in line:  # defines a constant, which is in no message
            continue
        kind, array, name, default = _FIELD.findall(line)[0]
        if kind[0].isupper():
            kind = f'{type_name.split("/")[0]}/{kind}'  # of the same package
        value: Any = {} if '/' in kind else '' if kind == 'string' else int(default or 0)
        length = int(array[1:-1] or 0) if array else None
        found.append(Field(name, kind.replace('/', '/msg/'), length,
                           value if length is None else length * (value,)))
    return tuple(found)


@cache
def schema_text(type_name: str) -> str:
    """Return a definition with all that it depends on, in the `ros2msg` encoding of MCAP."""
    names = [type_name]
    for name in names:  # grows by what is found
        for field in fields(name):
            if field.type_name in DEFINITIONS and field.type_name not in names:
                names.append(field.type_name)
    lines = [*DEFINITIONS[type_name]]
    for name in names[1:]:
        lines += ['=' * 80, 'MSG: ' + name.replace('/msg/', '/'), *DEFINITIONS[name]]
    return '\n'.join(lines) + '\n'


NANOSECONDS = 1000000000
LARGEST = 8192  # [B] of a message that `Reader` takes, which needs 3 ms at most
_START = 4                     # bytes of the header; alignment counts from its end
_LITTLE_ENDIAN = b'\x00\x01'   # plain CDR
_NUMBERS = {'byte': 'B', 'int32': 'i', 'uint32': 'I', 'float64': 'd'}  # codes of `struct`


class CdrError(ValueError):
    """A message does not match its type; the text says why."""


class Layout(NamedTuple):
    """Places in a message [B]; it is that of all messages with these bytes at `fixed`."""

    stamps: list         # place of the seconds of each time; its nanoseconds follow
    doubles: list        # place of each float64
    lists: list          # number of float64 in each sequence, and in the fields between sequences
    texts: list          # the texts themselves
    fixed: list          # places of the bytes of encoding, texts, integers and lengths


def layout(type_name: str, data: bytes | memoryview) -> Layout:
    """Return the Layout of a message of DEFINITIONS; CdrError unless it is little-endian CDR."""
    walk = _Walk(data)
    walk.value(type_name)
    return walk.found


class Content(NamedTuple):
    """What a message says: texts, float64 split as in `Layout.lists`, and its time [ns], or 0."""

    texts: list[str]
    lists: list[list[float]]
    stamp: int


class Reader:
    """Reads messages of a type of DEFINITIONS: those with the layout of the last one fast."""

    def __init__(self, type_name: str) -> None:
        self._type_name, self._alike = type_name, lambda data: False

    def __call__(self, data: bytes) -> Content:
        """Return the Content of a message; CdrError as `layout`, or if it is a huge one."""
        if len(data) > LARGEST:
            raise CdrError(f'it has {len(data)} bytes, more than {LARGEST}')
        if not self._alike(data):
            self._layout = layout(self._type_name, data)
            fixed = itemgetter(*self._layout.fixed)
            size, own = len(data), fixed(data)
            self._alike = lambda data: len(data) == size and fixed(data) == own
        found = self._layout
        numbers = [struct.unpack_from('<d', data, place)[0] for place in found.doubles]
        seconds, nanoseconds = (struct.unpack_from('<iI', data, found.stamps[0]) if found.stamps
                                else (0, 0))
        return Content(found.texts, [
            numbers[end - length:end] for length, end in zip(found.lists, accumulate(found.lists))
        ], NANOSECONDS * seconds + nanoseconds)


def pack(type_name: str, values: Mapping[str, Any]) -> bytes:
    """
    Return a serialised message of a type of DEFINITIONS, little-endian CDR with zeros as padding.

    `values` has by name of field numbers, str, dict for messages, lists for arrays. A field that
    is missing has its default, which is zero or empty unless the definition says otherwise (w of a
    quaternion is 1). Raises CdrError if a field is unknown, its value is of another type, or an
    array of fixed length is given with another length.

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
            elif isinstance(elements, (str, Mapping)) or not hasattr(elements, '__len__'):
                raise CdrError(f'{field.name} of {type_name} must be a list, got {elements!r}')
            elif field.length == 0:
                _append(data, 'uint32', len(elements))
            elif field.length != len(elements):
                raise CdrError(f'{field.name} of {type_name} must have {field.length} elements, '
                               f'got {len(elements)}')
            for element in elements:
                try:
                    if element is True or element is False:
                        raise TypeError
                    _append(data, field.type_name, element)
                except (AttributeError, TypeError, OverflowError, struct.error):
                    raise CdrError(f'{field.name} of {type_name} must be a {field.type_name}, got '
                                   f'{element!r}') from None


class _Walk:
    """Reads through a message, and notes in `found` where its values are."""

    def __init__(self, data):
        self._data, self._place = data, _START
        self._list_goes_on = False  # whether a float64 belongs to the last of `found.lists`
        self.found = Layout([], [], [], [], [0, 1])
        if bytes(data[:2]) != _LITTLE_ENDIAN:
            raise CdrError(f'its encoding is {bytes(data[:2])!r}, not {_LITTLE_ENDIAN!r}')

    def value(self, type_name):
        if type_name == 'builtin_interfaces/msg/Time':
            self.found.stamps.append(self._pass(8, 4))
        elif type_name == 'float64':
            if not self._list_goes_on:
                self._begin_list()
            self.found.lists[-1] += 1
            self.found.doubles.append(self._pass(8, 8))
        elif type_name == 'string':
            text = bytes(self._data[slice(*self._fixed(self._count(), 1))])
            self.found.texts.append(text.removesuffix(b'\0').decode(errors='replace'))
        elif type_name in _NUMBERS:
            size = struct.calcsize('<' + _NUMBERS[type_name])
            self._fixed(size, size)
        else:
            for field in fields(type_name):
                own_list = field.type_name == 'float64' and field.length == 0
                if own_list:
                    self._begin_list()
                for _ in range(1 if field.length is None else field.length or self._count()):
                    self.value(field.type_name)
                self._list_goes_on &= not own_list

    def _begin_list(self):
        self.found.lists.append(0)
        self._list_goes_on = True

    def _count(self):
        return struct.unpack_from('<I', self._data, self._fixed(4, 4)[0])[0]

    def _fixed(self, size, alignment):
        begin = self._pass(size, alignment)
        self.found.fixed.extend(range(begin, self._place))
        return begin, self._place

    def _pass(self, size, alignment):
        begin = self._place + (_START - self._place) % alignment
        self._place = begin + size
        if self._place > len(self._data):
            raise CdrError('it is too short')
        return begin


class Number(NamedTuple):
    """
    Stands in a template, values as `pack` takes them, for a number that each message has anew.

    Numbers are counted in the order of the template, those without a name last; these describe
    the others, as variances do, and are no columns.

    >>> template = {'name': ['shaft'], 'position': [Number('shaft_rad')]}
    >>> serialize = Serializer('sensor_msgs/msg/JointState', template)
    >>> message = serialize((1, 500000000), [0.25])  # at 1.5 s
    """

    column: str = ''  # its name with unit, as in 'shaft_rad'


def columns(template: Any) -> tuple[str, ...]:
    """Return the names of those numbers of a template that have one, a tuple of str."""
    found = []
    _filled(template, lambda number: found.append(number.column))
    return tuple(filter(None, found))


def form(type_name: str, template: Mapping[str, Any]) -> tuple[bytes, Layout, tuple[int, ...]]:
    """Return a message of a template, its Layout, and which of its float64 each Number is."""
    marks: list[tuple[bool, float]] = []

    def mark(number):  # with a value that no template holds: 5e-324, 1e-323, ...
        marks.append((not number.column, 5e-324 * (len(marks) + 1)))
        return marks[-1][1]

    data = pack(type_name, _filled(template, mark))
    found = layout(type_name, data)
    doubles = [struct.unpack_from('<d', data, place)[0] for place in found.doubles]
    return data, found, tuple(doubles.index(value) for _, value in sorted(marks))


def _filled(template, value):
    """Return a template with value(number) for each Number, in the order of the template."""
    if isinstance(template, Number):
        return value(template)
    if isinstance(template, dict):
        return {name: _filled(part, value) for name, part in template.items()}
    if isinstance(template, list):
        return [_filled(part, value) for part in template]
    return template


class Serializer:
    """
    Writes time and numbers straight into a serialised message, a copy of the first of its topic.

    All times in a message are the same. A type without a time is a ValueError.
    """

    def __init__(self, type_name, template):
        data, found, places = form(type_name, template)
        if not found.stamps:
            raise ValueError(f'{type_name} has no time')
        self._data = bytearray(data)
        # CDR aligns every number to its size, counted from the end of the header of four bytes.
        body = memoryview(self._data)[4:]
        self._words = body[:len(body) // 4 * 4].cast('I')
        self._times = [(place - 4) // 4 for place in found.stamps]
        self._numbers = body[:len(body) // 8 * 8].cast('d')
        self._places = [(found.doubles[place] - 4) // 8 for place in places]
        for place in self._places:  # numbers that no call gives are zero
            self._numbers[place] = 0.0

    def __call__(self, time, numbers):
        """Return the serialised message with a time ([s], [ns]) and numbers in the columns."""
        for place in self._times:
            self._words[place], self._words[place + 1] = time
        view = self._numbers
        for place, number in zip(self._places, numbers):
            view[place] = number
        return bytes(self._data)
