# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Readers of logs as oracles: this package's is checked by mcap, mcap_ros2 and rosbags."""

from collections import Counter
import os
import subprocess
import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from timo_sim.log.info import info
from timo_sim.log.read import LogError, recover
from timo_sim.log.tables import Recording


def outcome(path):
    """
    Read a log and recover it; check the result.

    Returns
    -------
    str
        'complete', 'refused' or 'recovered'; any other result is an exception.

    """
    new = path.with_name('out.mcap')
    for look in info, lambda file: Recording(file).topics:
        try:
            look(path)
        except LogError as error:
            if '\n' in str(error):
                raise RuntimeError(f'a refusal is one line: {error}') from None
    try:
        text = recover(path, new)
    except LogError as error:
        if new.exists() or '\n' in str(error) or path.name not in str(error):
            raise RuntimeError(f'a refusal is one line and writes nothing: {error}') from None
        return 'refused'
    if not new.exists():
        return 'complete'
    try:
        said = f'{contents(new).total()} messages'
        if said not in text or f'is complete: {said}' not in recover(new):
            raise RuntimeError(f'{said} are there: {text}')
    finally:
        new.unlink()
    return 'recovered'


def contents(path):
    """Return messages by topic, as mcap's own reader finds them."""
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        found = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        last = summary.statistics.message_end_time
        latest = [entry.log_time for _, _, entry in reader.iter_messages(start_time=last)]
    if found.total() != summary.statistics.message_count or any(
            time != last for time in latest) or bool(latest) != bool(found):
        raise RuntimeError(f'{path} has {found}, its summary says {summary.statistics}')
    return found


def decoded(path):
    """Return a log's messages by topic, as mcap_ros2 and rosbags decode them, if they agree."""
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        first = Counter(channel.topic for _, channel, _, _ in reader.iter_decoded_messages())
    second = Counter()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            second[connection.topic] += 1
    if first != second:
        raise RuntimeError(f'{path}: mcap_ros2 finds {first}, rosbags {second}')
    return first


LIMITED = """
import pathlib, re, resource, sys
from oracles.log_readers import outcome
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]) << 20,) * 2)
for path in map(pathlib.Path, sys.argv[2:]):
    print(path.stem, outcome(path), sep=': ')
# Not ru_maxrss, which begins with that of the process that started this one.
print(int(re.search(r'VmHWM:\\s*(\\d+)', pathlib.Path('/proc/self/status').read_text())[1]) >> 10)
"""


def limited(paths, limit, timeout):
    """
    Recover logs in a process of bounded memory.

    Parameters
    ----------
    paths : list of Path
    limit : int
        Size of its address space [MB].
    timeout : float
        [s]

    Returns
    -------
    dict, int
        `outcome` by name of the file; largest resident memory [MB].

    """
    process = subprocess.run(
        [sys.executable, '-c', LIMITED, str(limit), *map(str, paths)], timeout=timeout,
        capture_output=True, text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)})
    if process.returncode:
        raise RuntimeError(process.stdout + process.stderr)
    *lines, memory = process.stdout.splitlines()
    return dict(line.split(': ') for line in lines), int(memory)
