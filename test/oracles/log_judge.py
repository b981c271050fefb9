# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A judge of commands on rewritten logs: their results against the contents by mcap's reader."""

from collections import Counter, defaultdict
import csv
import re

from click.testing import CliRunner
from mcap.records import Channel, Message, Schema

from oracles.rewritten_logs import records
import timo_sim
from timo_sim.cli import main
from timo_sim.log.read import LogFile
from timo_sim.topics.outputs import outputs


def readable(path):
    """Return counts of the records that mcap finds in a file, without rosbag2's metadata."""
    schemas, channels, found = {0: ('', '', b'')}, {}, Counter()
    for entry in records(path):
        if isinstance(entry, Schema):
            schemas[entry.id] = entry.name, entry.encoding, entry.data
        elif isinstance(entry, Channel):
            channels[entry.id] = (entry.topic, entry.message_encoding, *schemas[entry.schema_id])
        elif isinstance(entry, Message):
            found[(*channels[entry.channel_id], entry.log_time, entry.publish_time, entry.sequence,
                   entry.data)] += 1
        elif getattr(entry, 'name', '') != 'rosbag2':
            found[repr(entry)] += 1
    return found


class Wrong(AssertionError):
    """A wrong result without an error."""


class Judge:
    """
    Judges the results of commands on a rewritten log: 'right', or 'error' for a clear error.

    Any other result raises Wrong, or the exception with which the command ended.

    Parameters
    ----------
    original : Path
        A log of this package.

    """

    COMMANDS = 'replay', 'recover', 'info', 'export', 'open_log'

    def __init__(self, original):
        self._content, self._folder = readable(original), original.parent
        self._motion = timo_sim.open_log(original).motion
        self._rows = self._exported(original)
        data = [key[-1] for key in self._content if key[0] == '/joint_states']
        self._by_data = dict(zip(data, self._rows))
        width = {output.name.removeprefix('~'): len(output.columns) for output in outputs(3)}
        self._width = lambda topic: width.get(topic.removeprefix('/timo_sim'), width.get(
            topic.removeprefix('/'), 0))

    def judge(self, path, command):
        """Return 'right' or 'error' for a command on a file."""
        content = readable(path)
        return getattr(self, '_' + command)(path, content, content == self._content)

    def _call(self, *arguments, code=(0,)):
        result = CliRunner().invoke(main, [str(argument) for argument in arguments])
        if result.exception and not isinstance(result.exception, SystemExit):
            raise result.exception
        if result.exit_code == 2 and result.output.count('\n') == 1:
            return None
        _ensure(result.exit_code in code, result.output)
        return result.output

    def _replay(self, path, content, same):
        text = self._call('replay', path, code=(0,) if same else (0, 1))
        if text is None:
            return 'error'
        done, logged = map(int, re.search(r'(\d+) of (\d+) logged numbers', text).groups())
        there = sum(count * self._width(key[0]) for key, count in content.items()
                    if isinstance(key, tuple))
        if 'all are the same' in text:
            _ensure(done == logged == there, f'{there} numbers are there: {text}')
            return 'right'
        _ensure(re.search('differ|is not read', text), text)
        return 'error'

    def _recover(self, path, content, same):
        new = path.with_name('recovered.mcap')
        try:
            text = self._call('recover', path, '-o', new)
            messages = sum(content[key] for key in content if isinstance(key, tuple))
            _ensure(f'{messages} messages' in text, f'{messages} messages are there: {text}')
            if new.exists():
                _ensure(readable(new) == content, f'something is missing: {text}')
                LogFile(new)
        finally:
            new.unlink(missing_ok=True)
        return 'right'

    def _info(self, path, content, same):
        text = self._call('info', path)
        if text is None:
            return 'error'
        times = defaultdict(list)
        for key, count in content.items():
            if isinstance(key, tuple):
                times[key[0]] += count * [key[5]]
        for topic, when in times.items():
            when.sort()
            found = next((line.split()[1:] for line in text.splitlines()
                          if line.split()[:1] == [topic]), None)
            _ensure(found and int(found[0]) == len(when), f'{len(when)} of {topic}: {text}')
            if found[1:] != ['-', '-']:  # where there is no index of times
                gap = max(b - a for a, b in zip([when[0], *when], when))
                rate = (len(when) - 1) * 1e9 / (when[-1] - when[0]) if when[-1] > when[0] else None
                said = [f'{rate:.6g}', 'Hz'] if rate else ['-']
                said += [f'{gap / 1e9:.6g}', 's'] if gap else ['-']
                _ensure(found[1:] == said, f'{topic} has {said}: {text}')
        return 'right'

    def _exported(self, path):
        table = path.with_name('table.csv')
        try:
            if self._call('export', path, '-o', table, '--topic', 'joint_states') is None:
                return None
            with open(table) as stream:
                return list(csv.DictReader(stream))
        finally:
            table.unlink(missing_ok=True)

    def _export(self, path, content, same):
        bag = path.with_name('bag')
        self._call('export', path, '-o', bag, '--bag')
        for entry in bag.iterdir() if bag.exists() else ():
            entry.unlink()
        if bag.exists():
            bag.rmdir()
        rows = self._exported(path)
        if rows is None:
            return 'error'
        expected = [self._by_data[key[-1]] for key, count in content.items()
                    if key[0] == '/joint_states' for _ in range(count)]
        if rows and 'step' not in rows[0]:  # of a plain bag
            expected = [{name: text for name, text in row.items() if name != 'step'}
                        for row in expected]
        _ensure(sorted(map(str, rows)) == sorted(map(str, expected)), 'other rows')
        _ensure(not same or rows == self._rows, 'another order')
        at = [float(row['time_s']) for row in rows]
        _ensure(at == sorted(at), 'not ascending')
        return 'right'

    def _open_log(self, path, content, same):
        try:
            run = timo_sim.open_log(path)
        except ValueError as error:
            _ensure('\n' not in str(error), str(error))
            return 'error'
        _ensure(not same or (run.motion == self._motion).all(), 'another motion')
        _ensure((run.t[1:] >= run.t[:-1]).all(), 'not ascending')
        return 'right'


def _ensure(condition, text):
    if not condition:
        raise Wrong(text)
