# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parse and check MCAP records and chunks, and define the errors of logs."""

from contextlib import suppress
import fcntl
from io import BytesIO
import os
from pathlib import Path
import stat
import struct
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC
import zstandard

LARGEST_CHUNK = 64 * 1024 * 1024  # [B] uncompressed
LARGEST_RECORD = LARGEST_CHUNK + 1024 * 1024
HEAD = struct.Struct('<BQ')             # opcode, length of the content
UNREADABLE = McapError, struct.error, UnicodeDecodeError, OverflowError  # what mcap raises


class LogError(ValueError):
    """A log that cannot be read, or a file that cannot be written; the text says which and why."""


class Broken(ValueError):
    """A record that is damaged, or contradicts itself."""


def printable(path):
    """Return a path as text that can be printed anywhere; on Linux a name may be any bytes."""
    return os.fsencode(path).decode(errors='replace')


def files_of(path):
    """Return the Paths of a file, or of the parts of a bag in a folder; else raise LogError."""
    path = Path(path)
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    foreign = [file for file in inside if file.suffix in ('.db3', '.zstd')]
    if foreign:
        kind = 'SQLite' if '.db3' in foreign[0].suffixes else 'compressed as a whole'
        raise LogError(
            f'{printable(foreign[0])} is {kind}, not MCAP: rosbags-convert --src BAG --dst NEW '
            '--dst-storage mcap (pip install rosbags) makes a bag that can be read')
    if not path.is_dir():
        return inside
    files = [file for file in inside if file.suffix == '.mcap']
    # A bag that rosbag2 has split has files NAME_0.mcap, NAME_1.mcap, ...
    parts = {int(number): file for file in files
             if (number := file.stem.rpartition('_')[2]).isdecimal()}
    first = min(parts, default=0)
    if len(files) > 1 and len({file.stem.rpartition('_')[0] for file in files}) == 1 and (
            sorted(parts) == [*range(first, first + len(files))]):
        return [parts[number] for number in sorted(parts)]
    if len(files) != 1:
        raise LogError(f'{printable(path)} has {len(files)} files *.mcap: name one')
    return files


def file_of(path):
    """Return the Path of a file, or of the only one in a bag's folder; else raise LogError."""
    files = files_of(path)
    if len(files) > 1:
        raise LogError(f'{printable(path)} has {len(files)} files *.mcap: name one')
    return files[0]


def open_file(path):
    """Open a log and read its magic; raise LogError if it is not an MCAP file."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a pipe might never end
            raise LogError(f'{printable(path)} is not a file')
        stream = open(path, 'rb')
    except (PermissionError, NotADirectoryError) as error:
        raise LogError(f'{printable(path)}: {error.strerror}') from None
    start = stream.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        stream.close()
        raise LogError(f'{printable(path)} is empty' if not start else
                       f'{printable(path)} is not an MCAP file: it begins with {start!r}')
    return stream


def hold(stream):
    """Mark a new log as being written until its stream is closed or its process ends."""
    with suppress(OSError):  # some network file systems have no locks
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


def held(stream):
    """Return whether a process of this package is still writing a log, open for reading."""
    try:
        fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    fcntl.flock(stream, fcntl.LOCK_UN)
    return False


def uncompressed(content):
    """Return the uncompressed data of a chunk; raise Broken if size or checksum are wrong."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        if chunk.uncompressed_size > LARGEST_CHUNK:
            raise Broken(f'a chunk claims to hold {chunk.uncompressed_size} bytes, more than '
                         f'{LARGEST_CHUNK}')
        if chunk.compression not in _DECOMPRESS:
            raise Broken(f'a chunk has an unknown compression, {chunk.compression[:20]!r}')
        # One byte more than the chunk states, to find out if it has more.
        data = _DECOMPRESS[chunk.compression](chunk.data, chunk.uncompressed_size + 1)
    except (*UNREADABLE, RuntimeError, EOFError, zstandard.ZstdError) as error:
        raise Broken(f'a chunk cannot be read: {error}') from None
    if len(data) != chunk.uncompressed_size:
        raise Broken(f'a chunk does not have the {chunk.uncompressed_size} bytes that it states')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise Broken('the checksum of a chunk is wrong')
    return data


def _zstd(data, limit):
    decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK)
    return decompressor.stream_reader(data).read(limit)


_DECOMPRESS = {
    '': lambda data, limit: data[:limit],
    'lz4': lambda data, limit: lz4.frame.LZ4FrameDecompressor().decompress(data, limit),
    'zstd': _zstd}


def parsed(kind, content):
    """Return a record; raise Broken if it has other bytes when it is written again."""
    try:
        record = kind.read(ReadDataStream(BytesIO(content)))
        if bytes_of(record)[HEAD.size:] == content:
            return record
    except UNREADABLE:
        pass
    raise Broken(f'a record of kind {kind.__name__.lower()} is malformed')


def bytes_of(*records):
    """Return the bytes of MCAP records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()
