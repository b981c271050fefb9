# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Logs rewritten by mcap's writer give right results or one line; recovery loses nothing."""

from collections import Counter
from functools import partial
import re

from click.testing import CliRunner
from mcap.records import Channel, DataEnd, Footer, Header, Message, Schema
from mcap.writer import MCAP0_MAGIC
import pytest

from oracles import hostile_logs, rewritten_logs
from oracles.hostile_logs import chunk, message, raw, written
from oracles.log_judge import Judge, readable
from oracles.rewritten_logs import NOTE, records, WRITTEN
from timo_sim.cli import main
from timo_sim.log.read import recover

# The rewritings that are tried on a log with a reset; all would take too long.
WITH_RESET = ['as it is', 'no chunks', 'shuffled', 'metadata reversed', 'metadata last',
              'no index of messages', 'merged with itself']
# Rewritings that replay, though in another order, with more or with less than was logged.
SAME = {'as it is', 'zstd', 'a chunk a message', 'no chunks', 'no index of messages', 'reversed',
        'reversed, no chunks', 'shuffled', 'topic after topic', 'metadata last', 'messages twice',
        'merged with itself', 'joint states dropped', 'channels of other tools', 'attachments',
        'no sequence numbers'}
# Rewritings that cannot be exported, because the scene or the kind of messages is missing.
NO_TABLE = {'no statistics', 'channels not repeated', 'schemas not repeated', 'without schemas',
            'no index of metadata', 'no indexes', 'no summary', 'merged with another run',
            'scene removed', 'records of its own', 'records of its own in a chunk',
            'other numbers'}


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Return the path of a log with commands."""
    return rewritten_logs.record(tmp_path_factory.mktemp('source') / 'run.mcap')


@pytest.fixture(scope='module')
def reset(tmp_path_factory):
    """Return the path of a log with a reset and a setting."""
    return rewritten_logs.record(tmp_path_factory.mktemp('reset') / 'run.mcap', [200])


def call(*arguments, code=0):
    """Call the command line; return what it prints."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, (result.output, result.exception)
    return result.output


def test_every_command_is_right_or_an_error_of_one_line(source, tmp_path):
    judge, found = Judge(source), {}
    for name, path in rewritten_logs.rewritings(source, tmp_path):
        found[name] = {command: judge.judge(path, command) for command in Judge.COMMANDS}
    assert {found[name]['replay'] for name in SAME} == {'right'}
    assert {each['recover'] for each in found.values()} == {'right'}
    assert {name for name, each in found.items() if each['export'] == 'error'} == NO_TABLE
    assert {name for name, each in found.items() if each['info'] == 'error'} < NO_TABLE


def test_logs_with_a_reset_too(reset, tmp_path):
    judge, path, found = Judge(reset), tmp_path / 'run.mcap', Counter()
    for name in WITH_RESET:
        change, options = WRITTEN[name]
        rewritten_logs.write(path, change(records(reset)), **options)
        found.update(f'{command} {judge.judge(path, command)}' for command in Judge.COMMANDS)
    assert found['replay right'] >= 1 and found['export right'] >= 4
    assert found['info right'] == found['recover right'] == len(WITH_RESET)


@pytest.fixture
def write(source, tmp_path):
    """Return a function that rewrites a log in the way with this name; it returns the path."""
    def write(name, log=source):
        change, options = WRITTEN[name]
        rewritten_logs.write(tmp_path / 'again.mcap', change(records(log)), **options)
        return tmp_path / 'again.mcap'
    return write


def test_a_replay_says_how_much_of_a_log_it_compared(source, write):
    counts = set()
    for path in (source, write('shuffled')):
        text = call('replay', path)
        done, logged = re.search(r'\n(\d+) of (\d+) logged numbers compared: all', text).groups()
        counts |= {done, logged}
    assert len(counts) == 1 and int(counts.pop()) > 1000


def test_a_topic_that_cannot_be_read_fails_a_replay_and_is_named_in_a_table(write, tmp_path):
    words = ('/timo_sim/tip_pose is not read: its type is unknown, without a schema, encoded as '
             "'cdr'")
    path = write('a topic without a schema')
    text = call('replay', path, code=1)
    assert words in text and ' of ' in text and ': all' not in text
    assert words in call('export', path, '-o', tmp_path / 'table.csv')
    assert 'has no joint_states; it has none; ' in call(
        'export', write('without schemas'), '-o', tmp_path / 'none.csv', code=2)


@pytest.mark.parametrize('name, words', [
    ('shuffled', 'it does not say which messages were before a reset'),
    ('metadata last', 'whether .* at the step of a reset was before or after it is not known')])
def test_an_unknown_order_at_a_reset_is_refused(name, words, reset, write):
    assert re.search(words, call('replay', write(name, reset), code=2))


def test_notes_of_two_runs_are_refused(write):
    path = write('merged with another run')
    for command in ('info', 'replay'):
        assert 'has the notes of several runs' in call(command, path, code=2)


HEAD = MCAP0_MAGIC + written(Header(profile='', library=''))
FLOAT = Schema(id=1, name='std_msgs/msg/Float64', encoding='ros2msg', data=b'float64 data')
TORQUE = partial(Channel, topic='/torque', message_encoding='cdr', metadata={})


@pytest.mark.parametrize('name', ['channels of other tools', 'without schemas', 'attachments'])
def test_records_of_other_tools_are_recovered(name, write):
    """From a log without its end: channels without schema, other types, attachments are kept."""
    path = write(name)
    expected = readable(path)
    data = path.read_bytes()
    end = next(place for place, opcode, _ in hostile_logs.places(data) if opcode == 15)
    path.write_bytes(data[:end] + raw(0x80, b'of my own'))
    new = path.with_name('new.mcap')
    assert f'it ends early (byte {end + 18})' in recover(path, new)
    assert readable(new) == expected and raw(0x80, b'of my own') in new.read_bytes()
    assert (repr(NOTE) in expected) == (name == 'attachments')
    assert 'is complete' in recover(new)


def test_a_record_that_is_not_understood_is_skipped_alone(tmp_path):
    """Other messages are kept, also of an unknown schema; skipped records are counted."""
    inside = written(message(), message(channel=9), message(), raw(0x20, b'?'), message(),
                     TORQUE(id=2, schema_id=7), message(channel=2))
    path, new = tmp_path / 'run.mcap', tmp_path / 'new.mcap'
    path.write_bytes(HEAD + written(FLOAT, TORQUE(id=1, schema_id=1), chunk(inside), DataEnd(0),
                                    Footer(0, 0, 0)) + MCAP0_MAGIC)
    text = recover(path, new)
    assert 'a message is of an unknown channel, 9 (byte' in text and ' and 3 more; 4 mess' in text
    found = records(new)
    assert [entry.channel_id for entry in found if isinstance(entry, Message)] == [1, 1, 1, 2]
    assert {entry.id: entry.schema_id for entry in found if isinstance(entry, Channel)} == {
        1: 1, 2: 0}
    call('info', new)


def test_a_damaged_attachment_is_left_out_with_a_message(tmp_path):
    data = bytearray(written(NOTE))
    data[-6] ^= 1
    path = tmp_path / 'run.mcap'
    path.write_bytes(HEAD + written(NOTE) + bytes(data))
    assert 'an attachment is malformed' in recover(path, tmp_path / 'new.mcap')
    assert list(readable(tmp_path / 'new.mcap').elements()) == [repr(NOTE)]
