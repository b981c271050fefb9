# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Make tables of two laboratories' files: `python -m benchmark.accuracy.unpack FILE.mat ...`.

Genoa's file has the velocity of a tip, which no record of timo_sim may have; FILE_table.csv has
its integral, less the mean of 0.5 s around each sample (ten periods of the first mode), beside the
current. Those of Buenos Aires hold an object of a class of MATLAB; their tables have times,
voltages and readings of the accelerometer. All else is as it was.
"""

from pathlib import Path
import struct
import zlib

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.io import loadmat
from scipy.ndimage import uniform_filter1d

from benchmark.report import parser

CURRENT, VELOCITY = 'Data1_AI_Aminus1_Current', 'Data1_AI_Aminus2_Velocity'
TIME = f'Data1_time_{CURRENT.removeprefix("Data1_")}'
AROUND = 0.5  # of the mean that is taken off the integral [s]
TEXT, SUBSYSTEM = 116, b'\x00\x01IM'  # where a file says where its objects are, and their mark
DOUBLE, MATRIX, NUMBERS = 9, 14, range(6, 16)  # types of elements, and classes that are numbers


def elements(data):
    """Yield type and bytes of each element in the bytes of a file of MATLAB."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from('<II', data, place)
        if kind >> 16:  # of at most four bytes, which lie in its head
            yield kind & 0xffff, data[place + 4:place + 4 + (kind >> 16)]
            size = 0
        else:
            yield kind, data[place + 8:place + 8 + size]
        place += 8 + size + -size % 8


def arrays(data):
    """Yield all arrays of doubles in the bytes of a file of MATLAB, in their order."""
    for _, matrix in (each for each in elements(data) if each[0] == MATRIX):
        parts = list(elements(matrix))
        if len(parts) > 3 and parts[0][1][0] in NUMBERS:
            if parts[3][0] == DOUBLE:
                yield np.frombuffer(parts[3][1])
        else:
            yield from arrays(matrix)


def object_of(path):
    """Return times [s], voltages [V] and readings of the object in a file, shape (n, 3)."""
    data = path.read_bytes()
    place, = struct.unpack_from('<Q', data, TEXT)
    size, = struct.unpack_from('<I', data, place + 4)
    inside = zlib.decompress(data[place + 8:place + 8 + size])
    found = [each for each in arrays(inside[inside.index(SUBSYSTEM) + 8:]) if len(each) > 50]
    found = [each for each in found if len(each) == len(found[0])]
    return np.column_stack([found[0], found[-1], found[1]])


def place_of(found):
    """Return times [s], currents and places of the tip [m] of the file of Genoa, shape (n, 3)."""
    t, current, speed = (found[name].ravel() for name in (TIME, CURRENT, VELOCITY))
    way = cumulative_trapezoid(speed - speed.mean(), t, initial=0.0)
    way -= uniform_filter1d(way, round(AROUND / (t[1] - t[0])))
    return np.column_stack([t, current, way])


def unpack(path):
    """Write the table beside a file of MATLAB; return its path."""
    path = Path(path)
    found = loadmat(path)
    result = path.with_name(f'{path.stem}_table.csv')
    np.savetxt(result, place_of(found) if VELOCITY in found else object_of(path), '%.9g',
               delimiter=',')
    return result


if __name__ == '__main__':
    arguments = parser(__spec__, __doc__)
    arguments.add_argument('files', nargs='+')
    for file in arguments.parse_args().files:
        print(unpack(file))
