# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""MCAP records: parsed and checked, the errors of logs, and the metadata records of a run."""

from contextlib import suppress
import fcntl
from importlib.metadata import version
from io import BytesIO
import json
import math
import os
from pathlib import Path
import platform
import stat
import struct
from typing import NamedTuple
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC
import zstandard

from timo_sim.version import __version__

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


START, RESET, SUMMARY = 'timo_sim', 'timo_sim.reset', 'timo_sim.summary'
CHANGE = 'timo_sim.change'
# Versions and hardware that the last bits of a run depend on.
_ENVIRONMENT = ('timo_sim', 'python', 'numpy', 'scipy', 'numba', 'machine', 'processor')


class LogNotes(NamedTuple):
    """The metadata of a log."""

    facts: dict    # texts noted at the start of the run; empty if there are none
    summary: dict  # texts noted at its end; empty if there are none
    resets: list   # (step, place in the file) of each
    changes: list  # (step, place, values by name) of each setting of the scene's parameters


def read_notes(index):
    """Return the LogNotes of an Index; raise LogError if they cannot be read."""
    starts, summary, resets, changes = [], {}, [], []
    for place, record in index.metadata():
        content = record.metadata
        try:
            if record.name == START:
                starts.append(content)
            elif record.name == SUMMARY:
                summary = content
            elif record.name == RESET:
                resets.append((_step(content), place))
            elif record.name == CHANGE:
                changes.append((_step(content), place, dict(json.loads(content['values']))))
        except (KeyError, TypeError, ValueError, RecursionError):
            raise LogError(f'{index.name} has a malformed metadata record {record.name}: '
                           f'{str(content)[:80]!r}') from None
    if any(content != starts[0] for content in starts):
        raise LogError(f'{index.name} has the notes of several runs')
    return LogNotes(starts[0] if starts else {}, summary, sorted(resets),
                    sorted(changes, key=lambda entry: entry[:2]))


def _step(content):
    step = content['step']
    if not step.isdecimal() or len(step) > 18:
        raise ValueError('it is not a number of steps')
    return int(step)


def change_note(step, values):
    """Return the metadata for parameters of the scene that were set while the node runs."""
    return {'step': str(step), 'values': _json(values)}


def _json(values):
    # A limit may be infinite, and JSON has no infinity; the text is read as a number again.
    return json.dumps({name: str(value) if value in (math.inf, -math.inf) else value
                       for name, value in values.items()})


def start_note(node, values, changed, scene):
    """Return the metadata for the start of a run; `changed` are values other than defaults."""
    return {
        'node': node, 'parameters': _json(values), 'changed': _json(changed),
        'initial_motion': json.dumps(scene.initial_motion().tolist()), **_here()}


def names_note(channels):
    """Return the metadata for the names of topics before they were remapped."""
    return {'topics': _json({channel.topic: channel.name for channel in channels})}


def read_names(facts):
    """Return the names of topics before they were remapped, by topic; {} if a log has none."""
    try:
        return {topic: str(name) for topic, name in json.loads(facts['topics']).items()}
    except (KeyError, AttributeError, ValueError, RecursionError):
        return {}


def other_ground(facts):
    """Return in words which versions and hardware differ from those of a log, or ''."""
    return ', '.join(f'{name} {facts[name][:40]} (here {value})'
                     for name, value in _here().items() if facts.get(name, value) != value)


def made_with(facts):
    """Return in words the versions and hardware that a log was made with."""
    return ', '.join(f'{name} {facts[name][:40]}' for name in _ENVIRONMENT if name in facts)


class Peak:
    """The largest transverse deflection of the tip that was published."""

    def __init__(self):
        self._found = 0.0, 0.0

    def see(self, numbers, nanoseconds):
        """Take account of a tip deflection, axial and transverse [m], at a time [ns]."""
        if not abs(numbers[1]) <= self._found[0]:
            self._found = abs(numbers[1]), 1e-9 * nanoseconds

    def note(self):
        """Return the metadata for it, a dictionary of str."""
        return {'peak_tip_deflection_m': str(self._found[0]),
                'peak_tip_deflection_at_s': f'{self._found[1]:.9f}'}


def _here():
    from llvmlite.binding import get_host_cpu_name  # steps are compiled for this processor
    return dict(zip(_ENVIRONMENT, (
        __version__, platform.python_version(),
        *(version(package) for package in ('numpy', 'scipy', 'numba')),
        platform.machine(), get_host_cpu_name())))
