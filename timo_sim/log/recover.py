# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A complete log from one that ends early or is damaged."""

from collections import Counter
import os
from pathlib import Path

from mcap.records import Channel, Metadata, Schema

from timo_sim.log.reader import Message, Reader
from timo_sim.log.recorder import CHUNK_SIZE, create, sync
from timo_sim.log.records import LogError, open_file
from timo_sim.log.rosbag2 import add_rosbag2_metadata, printable
from timo_sim.log.writer import Chunk, Writer


def recover(file, output=None):
    """
    Write what is intact in a log to a new one, with index and summary.

    Parameters
    ----------
    file : str or Path
        It is only read.
    output : str or Path, optional
        A file that does not exist; by default beside `file`, with `_recovered` after its stem,
        and a number if that exists.

    Returns
    -------
    str
        What was found and done. If the log is complete, nothing is written.

    Raises
    ------
    LogError
        If there is nothing to recover, or `output` exists.
    OSError
        If the new log cannot be written.

    """
    path = Path(file)
    with open_file(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        # Read once before anything is written: most files are complete, and some are no logs.
        reader = Reader(stream, size, printable(path))
        found, last = Counter(), 0
        for record in reader.records():
            found[type(record)] += 1
            if isinstance(record, Message):
                last = max(last, record.time)
        contents = f'{found[Message]} messages until sim time {1e-9 * last:.3f} s'
        if reader.damage is None:
            return f'{printable(path)} is complete: {contents}; nothing is written'
        if not found:
            raise LogError(f'{printable(path)}: nothing in it is intact: {reader.damage}')
        stream.seek(0)
        new = _write(Reader(stream, size, printable(path)), reader.profile, path, output)
    return (f'{printable(path)}: {reader.damage}; {contents}, {size - reader.kept} bytes lost; '
            f'complete in {printable(new)}')


def _write(reader, profile, path, output):
    """Write a new log; return its path."""
    if output is None:
        new, stream = create(path.with_stem(path.stem + '_recovered'))
    else:
        try:
            new, stream = Path(output), open(output, 'xb')
        except FileExistsError:
            raise LogError(
                f'{printable(output)} exists: remove it or choose another --output') from None
    try:
        with stream:
            _copy(reader, profile, stream, new.name)
            sync(stream)
    except BaseException:
        new.unlink()  # what is not whole would be taken for it
        raise
    return new


def _copy(reader, profile, stream, name):
    writer, chunk = Writer(stream, profile), Chunk()
    for record in reader.records():
        if isinstance(record, Message):
            chunk.add_record(*record)
            if len(chunk.data) < CHUNK_SIZE:
                continue
        if chunk.data:
            writer.add_chunk(chunk)
            chunk = Chunk()
        if isinstance(record, (Schema, Channel)):
            writer.add_record(record)
        elif isinstance(record, Metadata) and record.name != 'rosbag2':
            writer.add_metadata(record.name, record.metadata)
    if chunk.data:
        writer.add_chunk(chunk)
    if profile == 'ros2':
        add_rosbag2_metadata(writer, name)
    writer.finish()
