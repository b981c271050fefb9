# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Export a log as a table (for pandas, MATLAB and others) or as a folder like rosbag2's."""

from collections.abc import Iterable
import csv
import os
from pathlib import Path
import shutil

import numpy as np

from timo_sim.extras import optional
from timo_sim.log.read import LogError, LogFile
from timo_sim.log.tables import common, Recording
from timo_sim.log.write import information, printable, yaml_text
from timo_sim.scene.files import whole_file
from timo_sim.topics.outputs import outputs, title, with_angles

_ROWS = 10000  # rows of a CSV file that are converted to text at a time


def export(file: Path | str, output: Path | str, topic: str | None = None,
           node: str | None = None) -> str:
    """
    Write a log as a table.

    There is one row for each message of joint_states, or of `topic`. It also has the messages of
    the other topics with the same stamp; NaN stands for missing ones. At a reset two rows have the
    same time, before and after it.

    Parameters
    ----------
    file : str or Path
    output : str or Path
        A file that does not exist, *.parquet or *.csv.
    topic : str, optional
        Short name of a topic, such as '~/motor_torque', to be written alone.
    node : str, optional
        See `Recording`.

    Returns
    -------
    str
        What was written.

    Raises
    ------
    LogError
        If the file is not a log or lacks the topic, or `output` exists or has another suffix.

    """
    path = _new_table(Path(output))
    recording = Recording(file, node)
    columns, left = table(recording, topic)
    write_table(columns, path)
    text = f'{printable(path)}: {len(columns["time_s"])} rows, {len(columns)} columns'
    if left:
        text += '; messages at other times are left out, --topic writes them: ' + ', '.join(left)
    return '; '.join([text, *recording.unread.values()])


def write_table(columns: dict[str, np.ndarray], path: Path) -> None:
    """Write columns by name to a path; raise LogError unless it is new, and *.parquet or *.csv."""
    write = _parquet if _new_table(path).suffix == '.parquet' else _csv
    with whole_file(path, new=True) as part:
        write(columns, part)


def _new_table(path):
    if path.suffix not in ('.parquet', '.csv'):
        raise LogError(f'{printable(path)} must end with .parquet or .csv')
    return _new(path)


def _new(path):
    if path.exists():
        raise LogError(f'{printable(path)} exists: remove it or choose another name')
    return path


def named(topic: str, columns: Iterable[str]) -> list[str]:
    """Return the names that columns of a topic have in a table of several topics."""
    if topic == 'joint_states':
        return list(columns)
    prefix = title(topic) + '_'
    return [column if column.startswith('mode_') else prefix + column for column in columns]


def table(recording: Recording, topic: str | None = None) -> tuple[
        dict[str, np.ndarray], list[str]]:
    """Return columns by name, (n,) each, and the topics whose messages are in part left out."""
    found = recording.read(*([topic] if topic else [output.name for output in outputs(1)]))
    base = found.pop(topic or 'joint_states', None)
    if base is None:
        topics = ', '.join(sorted(recording.read())) or 'none'
        raise recording.lacks(f'{topic or "joint_states"}; it has {topics}')
    columns, left = {'time_s': 1e-9 * base.ns}, []
    if recording.facts:
        columns['step'] = base.step
    names, values = with_angles(base.columns, base.values)
    columns.update(zip(names, values.T))
    for name, series in found.items():
        names, values = with_angles(series.columns, series.values)
        here, there = common(base.ns, series.ns)
        whole = np.full((len(base.ns), len(names)), np.nan)
        whole[here] = values[there]
        columns.update(zip(named(name, names), whole.T))
        if names and len(series.ns[there]) < len(series.ns):
            left.append(name)
    return columns, left


def _parquet(columns, path):
    with optional():
        import pyarrow
        import pyarrow.parquet
    arrays = {name: pyarrow.array(np.ascontiguousarray(values), from_pandas=True)
              for name, values in columns.items()}
    with open(path, 'wb') as stream:
        pyarrow.parquet.write_table(pyarrow.table(arrays), stream)


def _csv(columns, path):
    with open(path, 'w', newline='') as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for first in range(0, len(columns['time_s']), _ROWS):
            part = [['' if value != value else value for value in
                     values[first:first + _ROWS].tolist()] for values in columns.values()]
            writer.writerows(zip(*part))


def export_bag(file: Path | str, output: Path | str) -> str:
    """Make a new folder as rosbag2 writes it; return a text that says what was done."""
    folder, log = Path(output), LogFile(file)
    name = f'{folder.name}_0.mcap'  # `ros2 bag reindex` takes no other name
    content = information(log.schemas.values(), log.channels.values(), log.statistics, name)
    _new(folder).parent.mkdir(parents=True, exist_ok=True)
    with whole_file(folder, new=True) as part:
        part.mkdir()
        try:
            os.link(log.path.resolve(), part / name)  # no time nor space for a gigabyte
        except OSError:
            shutil.copyfile(log.path, part / name)
        (part / 'metadata.yaml').write_text(yaml_text({'rosbag2_bagfile_information': content}))
    return f'{printable(folder)}: {printable(name)} and metadata.yaml'
