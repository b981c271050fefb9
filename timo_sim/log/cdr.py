"""Where numbers and texts are in a serialised message: CDR of the few types that the node uses."""

import struct
from typing import NamedTuple

_HEADER = ('stamp', 'string')
# Fields in order; of a JointState names, positions, velocities, efforts.
_FIELDS = {
    'sensor_msgs/msg/JointState': (*_HEADER, 'strings', 'doubles', 'doubles', 'doubles'),
    'geometry_msgs/msg/Vector3Stamped': (*_HEADER, *3 * ['double']),
    'geometry_msgs/msg/PoseStamped': (*_HEADER, *7 * ['double']),
    'geometry_msgs/msg/WrenchStamped': (*_HEADER, *6 * ['double']),
    'std_msgs/msg/Float64': ('double',),
    'std_msgs/msg/Float64MultiArray': ('dimensions', 'number', 'doubles'),
    'sensor_msgs/msg/Imu': (*_HEADER, *37 * ['double']),
    'rosgraph_msgs/msg/Clock': ('stamp',),
    'tf2_msgs/msg/TFMessage': ('transforms',),
}
TYPES = frozenset(_FIELDS)
_START = 4                     # of what is aligned, after the encoding
_LITTLE_ENDIAN = b'\x00\x01'   # plain CDR


class CdrError(ValueError):
    """A message that is not what its type says; the text says why."""


class Layout(NamedTuple):
    """
    Where things are in a message, bytes from its beginning.

    Messages of the same size and the same bytes at `fixed`, which are encoding, texts and lengths
    of lists, have the same layout.
    """

    size: int            # without the padding that some writers add
    stamps: list         # of the seconds of each time, nanoseconds follow
    doubles: list        # of each number
    lists: list          # how many numbers are in each list; fields in a row are one
    texts: list          # values
    fixed: list

    def split(self, numbers):
        """Return numbers as the lists in which they are."""
        parts, place = [], 0
        for length in self.lists:
            parts.append(numbers[place:place + length])
            place += length
        return parts

    def meant(self):
        """Return the places of all bytes that mean something: none of those in between."""
        return [*self.fixed, *(place + byte for place in (*self.stamps, *self.doubles)
                               for byte in range(8))]


class _Walk:
    def __init__(self, data):
        self._data, self.place = data, _START
        self.found = Layout(0, [], [], [], [], [0, 1])
        if bytes(data[:2]) != _LITTLE_ENDIAN:
            raise CdrError(f'its encoding is {bytes(data[:2])!r}, not {_LITTLE_ENDIAN!r}')

    def _pass(self, size, alignment):
        begin = self.place + (_START - self.place) % alignment
        self.place = begin + size
        if self.place > len(self._data):
            raise CdrError('it is too short')
        return begin

    def _count(self):
        begin = self._pass(4, 4)
        self.found.fixed.extend(range(begin, begin + 4))
        return struct.unpack_from('<I', self._data, begin)[0]

    def stamp(self):
        self.found.stamps.append(self._pass(8, 4))

    def string(self):
        size = self._count()
        begin = self._pass(size, 1)
        self.found.fixed.extend(range(begin, begin + size))
        text = bytes(self._data[begin:begin + size])
        self.found.texts.append(text.removesuffix(b'\0').decode(errors='replace'))

    def strings(self):
        for _ in range(self._count()):
            self.string()

    def number(self):
        self._count()

    def dimensions(self):
        for _ in range(self._count()):
            self.string()
            self.number()  # its size
            self.number()  # its stride

    def transforms(self):
        for _ in range(self._count()):
            self.stamp()
            self.string()  # frame
            self.string()  # its child
            for _ in range(7):
                self.double()

    def double(self):
        if not self.found.lists:
            self.found.lists.append(0)
        self.found.lists[-1] += 1
        self.found.doubles.append(self._pass(8, 8))

    def doubles(self):
        self.found.lists.append(0)
        for _ in range(self._count()):
            self.double()


def layout(type_name, data):
    """
    Return the layout of a message.

    Parameters
    ----------
    type_name : str
        One of TYPES.
    data : bytes-like
        CDR.

    Returns
    -------
    Layout

    Raises
    ------
    CdrError
        If the message ends too early or is encoded in another way.

    """
    walk = _Walk(data)
    for field in _FIELDS[type_name]:
        getattr(walk, field)()
    return walk.found._replace(size=walk.place)
