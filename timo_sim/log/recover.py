# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Recover a damaged or incomplete log: write what is intact in it to a complete one."""

from pathlib import Path

from mcap.records import Attachment, Metadata
from mcap.writer import MCAP0_MAGIC

from timo_sim.log.notes import START
from timo_sim.log.reader import Private, Reader
from timo_sim.log.recorder import create, sync
from timo_sim.log.records import file_of, held, LogError, open_file, printable
from timo_sim.log.writer import Chunk, Writer


def recover(file, output=None):
    """
    Write what is intact in a damaged or incomplete log to a new one, with index and summary.

    Parameters
    ----------
    file : str or Path
        A file, or a bag's folder with one. It is only read.
    output : str or Path, optional
        A file that does not exist; by default beside `file`, with `_recovered` after its stem,
        and a number if that exists.

    Returns
    -------
    str
        What was found, what was lost, and what was written: nothing if the log is complete.

    Raises
    ------
    LogError
        If there is nothing to recover, or `output` exists.
    OSError
        If the new log cannot be written.

    """
    path = file_of(file)
    with open_file(path) as stream:
        # A first pass before anything is written: most files are complete, and some are no logs.
        reader = Reader(stream)
        found, own = 0, False
        for found, record in enumerate(reader.records(), 1):
            own = own or isinstance(record, Metadata) and record.name == START
        contents = f'{reader.counts.total()} messages ' + (
            f'until sim time {1e-9 * reader.latest:.3f} s' if own else
            # Log times of a bag are those of a wall clock.
            f'within {1e-9 * max(0, reader.latest - reader.earliest):.3f} s')
        if reader.damage is None:
            return f'{printable(path)} is complete: {contents}; nothing is written'
        if not found:
            raise LogError(f'{printable(path)}: nothing in it is intact: {reader.damage}')
        stream.seek(len(MCAP0_MAGIC))
        new = _write(Reader(stream).records(), reader.profile, Path(file), output)
        state = 'it is still being written' if held(stream) else reader.damage
    more = f' and {reader.faults - 1} more' if reader.faults > 1 else ''
    # Unpacked, damaged records may be larger than the file.
    lost = min(reader.size, reader.size - reader.kept)
    return (f'{printable(path)}: {state}{more}; {contents}, {lost} bytes lost; complete in '
            f'{printable(new)}')


def _write(records, profile, path, output):
    """Write a new log; return its path."""
    if output is None:
        path = Path(f'{path.resolve()}.mcap') if path.is_dir() else path
        new, stream = create(path.with_stem(path.stem + '_recovered'))
    else:
        try:
            new, stream = Path(output), open(output, 'xb')
        except FileExistsError:
            raise LogError(
                f'{printable(output)} exists: remove it or choose another --output') from None
    try:
        with stream:
            writer = Writer(stream, profile)
            for record in records:
                if isinstance(record, Chunk):
                    writer.add_chunk(record)
                elif isinstance(record, Metadata):
                    writer.add_metadata(record.name, record.metadata)
                elif isinstance(record, Attachment):
                    writer.add_attachment(record)
                elif isinstance(record, Private):
                    writer.add_private(*record)
                else:
                    writer.add_record(record)
            writer.finish(new.name)
            sync(stream)
    except BaseException:
        new.unlink()  # an incomplete file would be taken for a recovered log
        raise
    return new
