# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim info` and `export`: the printed facts, tables and bags, read by other libraries."""

import csv
import json
import re
import subprocess
import sys

from click.testing import CliRunner
import numpy as np
import pyarrow.parquet
import pytest
from rosbags.rosbag2 import Reader
import yaml

from ros_process import Process
import timo_sim
from timo_sim.cli import main
from timo_sim.log import info as info_module
from timo_sim.log.read import LogFile
from timo_sim.log.write import Channel, Recorder
from timo_sim.topics.cdr import Serializer
from timo_sim.topics.outputs import outputs


@pytest.fixture(scope='module')
def log(tmp_path_factory, paper):
    """Log two seconds of the paper's scene, joint states half as often as the tip's pose."""
    node = Process(tmp_path_factory.mktemp('log'), '--params-file', str(paper),
                   real_time_factor=0.0, duration=2.0,
                   **{'rate.joint_states': 100.0, 'rate.tip_pose': 200.0,
                      'rate.modal_state': 50.0, 'rate.tip_deflection': 1000.0})
    assert node.wait()[0] == 0
    return node.log


@pytest.fixture(scope='module')
def run(paper):
    """Return the same run, every 10 ms."""
    return timo_sim.simulate(timo_sim.load_scene(paper), 2.0, sample_every=10)


def call(*arguments, code=0):
    """Call the command line; return what it prints."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, (result.output, result.exception)
    return result.output


def test_info_describes_the_run(log, paper):
    text = call('info', log)
    run = timo_sim.simulate(timo_sim.load_scene(paper), 2.0)
    across = np.abs(run.deflection(2.0)[:, 1])
    assert f'{across.max():.6g} m transverse, at {run.t[across.argmax()]:.6g} s' in text
    for words in ('log of /timo_sim', 'load.torque.harmonic.frequency = [4.0]', 'numpy ',
                  'sim time  0 to 2 s', 'refused_commands 0', 'resets    none'):
        assert words in text
    rows = {words[0]: words[1:] for words in map(str.split, text.splitlines()) if words}
    assert rows['/timo_sim/tip_pose'] == ['401', '200', 'Hz', '0.005', 's']
    assert rows['/timo_sim/modal_state'] == ['101', '50', 'Hz', '0.02', 's']
    assert '/timo_sim/motor_torque' in ' '.join(rows['without'])


def test_info_finds_gaps_and_a_peak_that_was_not_noted(tmp_path):
    output, = (output for output in outputs(0) if output.name == '~/tip_deflection')
    topics = [Channel('/timo_sim/tip_deflection', output.type_name)]
    recorder = Recorder(tmp_path / 'run.mcap', topics, {
        'timo_sim': {'node': '/timo_sim', 'parameters': '{}', 'changed': '{}'}})
    serialize = Serializer(output.type_name, output.template)
    for step in [*range(0, 50), *range(80, 100)]:
        recorder.write(0, step, step * 1000000, serialize((0, step * 1000000), (0.0, -step)))
    recorder.close()
    text = call('info', tmp_path / 'run.mcap')
    assert '0.031 s' in text and '99 m transverse, at 0.099 s' in text and 'not known' in text


def test_info_prints_no_control_characters(tmp_path):
    recorder = Recorder(tmp_path / 'run.mcap', [Channel('/\x1b[2J', 'std_msgs/msg/Float64')], {
        'timo_sim': {'node': '\x1b]0;', 'changed': json.dumps({'\x1b': 1}), 'numpy': '\x1b'}})
    recorder.close()
    text = call('info', tmp_path / 'run.mcap')
    assert '\x1b' not in text and '[2J' in text


def test_a_gigabyte_takes_no_longer_than_its_index(tmp_path, monkeypatch):
    """Of 4000 chunks, as a gigabyte has them, each index is read once, and few are unpacked."""
    path, done = tmp_path / 'many.mcap', {'read': 0, 'times': 0}
    recorder = Recorder(path, [Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')], {})
    for k in range(4000):
        recorder.write(0, k, k * 10000000, bytes(12))
        recorder.note('', {})  # which ends a chunk
    recorder.close()
    assert len(LogFile(path).chunks) == 4000

    def counted(name, method):
        def call(self, chunk):
            done[name] += 1
            return method(self, chunk)
        return call

    for name in done:
        monkeypatch.setattr(LogFile, name, counted(name, getattr(LogFile, name)))
    assert '100 Hz' in call('info', path)
    assert done['times'] == 4000 and done['read'] <= 50


def test_a_topic_that_ends_early_has_its_rate_where_chunks_are_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(info_module, '_MOST_TIMES', 20)  # of 225: one chunk in twelve
    path = tmp_path / 'early.mcap'
    recorder = Recorder(path, [Channel('/short', 'std_msgs/msg/Float64'),
                               Channel('/long', 'std_msgs/msg/Float64')], {})
    for k in range(200):
        recorder.write(1, k, k * 10000000, bytes(12))
        if 70 < k < 96:
            recorder.write(0, k, k * 10000000, bytes(12))
        recorder.note('', {})  # which ends a chunk
    recorder.close()
    assert all(f' {count}      100 Hz  0.01 s' in call('info', path) for count in (200, 25))


def test_info_imports_no_physics(log):
    code = ('import sys; from timo_sim.log.info import info; info(sys.argv[1]); '
            'assert not {"numba", "scipy", "rclpy"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', code, log], check=True)


def test_a_table_has_the_run_with_units_in_its_names(log, run, tmp_path):
    """pandas and MATLAB read Parquet and CSV; pyarrow and csv do so here."""
    assert 'left out' in call('export', log, '-o', tmp_path / 'run.parquet')
    table = pyarrow.parquet.read_table(tmp_path / 'run.parquet').to_pydict()
    call('export', log, '-o', tmp_path / 'run.csv')
    with open(tmp_path / 'run.csv') as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(table)
    for name, values in table.items():
        assert [float(row[name]) if row[name] else None for row in rows] == values
    assert table['step'] == list(range(0, 2001, 10))
    assert np.allclose(table['time_s'], run.t, rtol=0, atol=1e-12)
    assert np.array_equal(table['carrier_x_m'], run.carrier[:, 0])
    assert np.array_equal(table['shaft_velocity_rad_per_s'], run.shaft_velocity)
    assert np.array_equal(table['mode_2_m_sqrt_kg'][::2], run.q[::2, 1])
    assert set(table['mode_2_m_sqrt_kg'][1::2]) == {None}  # half as often as joint states
    assert np.allclose(table['tip_deflection_transverse_m'], run.deflection(2.0)[:, 1],
                       rtol=0, atol=1e-14)
    assert np.allclose(table['tip_pose_rotation_rad'], run.shaft + run.rotation(2.0),
                       rtol=0, atol=1e-14)


def test_a_topic_alone_has_all_its_messages(log, tmp_path):
    path = tmp_path / 'pose.parquet'
    assert '401 rows' in call('export', log, '-o', path, '--topic', '~/tip_pose')
    table = pyarrow.parquet.read_table(path)
    assert table.column_names == ['time_s', 'step', 'x_m', 'y_m', 'rotation_rad']
    text = call('export', log, '-o', tmp_path / 'none.csv', '--topic', 'x', code=2)
    assert 'no x; it has' in text and 'joint_states' in text


def test_export_overwrites_nothing(log, tmp_path):
    for name in ('run.csv', 'run.parquet'):
        (tmp_path / name).write_text('precious')
        assert 'exists' in call('export', log, '-o', tmp_path / name, code=2)
        assert (tmp_path / name).read_text() == 'precious'
    assert 'exists' in call('export', log, '-o', tmp_path, '--bag', code=2)
    assert 'must end with' in call('export', log, '-o', tmp_path / 'run.xlsx', code=2)


@pytest.mark.parametrize('option', ['--topic', '--node'])
def test_options_of_tables_are_refused_for_a_bag(log, tmp_path, option):
    text = call('export', log, '-o', tmp_path / 'bag', '--bag', option, '/timo_sim', code=2)
    assert text == f'timo_sim: --bag takes the whole file: leave out {option}\n'
    assert not (tmp_path / 'bag').exists()


def test_a_bag_opens_as_a_folder(log, tmp_path):
    call('export', log, '-o', tmp_path / 'bag', '--bag')
    with Reader(tmp_path / 'bag') as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        assert bag.duration == 2000000001 and counts['/timo_sim/tip_pose'] == 401
        assert sum(1 for _ in bag.messages()) == bag.message_count
    content = yaml.safe_load((tmp_path / 'bag/metadata.yaml').read_text())
    topics = content['rosbag2_bagfile_information']['topics_with_message_count']
    assert {topic['topic_metadata']['offered_qos_profiles'][0]['reliability']
            for topic in topics} == {'reliable'}
    # `ros2 bag reindex` accepts only such names (rosbag2_cpp/reindexer.cpp).
    file, = (tmp_path / 'bag').glob('*.mcap')
    assert re.fullmatch(r'(.+_(\d+)\.([a-zA-Z0-9])+)', str(file)) and file.name == 'bag_0.mcap'
    # Commands take the folder for its file, `view` in test_view.py, `replay` in test_replay.py.
    for command in ('info', 'recover'):
        assert call(command, file.parent) == call(command, file)
    call('export', file.parent, '-o', tmp_path / 'other', '--bag')
    assert (tmp_path / 'other/other_0.mcap').samefile(log)
    (tmp_path / 'link.mcap').symlink_to('bag/bag_0.mcap')
    call('export', tmp_path / 'link.mcap', '-o', tmp_path / 'third', '--bag')
    assert (tmp_path / 'third/third_0.mcap').samefile(log)
    assert not (tmp_path / 'third/third_0.mcap').is_symlink()


@pytest.mark.parametrize('command', ['info', 'export', 'replay'])
def test_a_file_that_is_no_log_gives_one_line_and_code_2(command, tmp_path):
    path = tmp_path / 'no.mcap'
    more = ['-o', tmp_path / 'out.csv'] if command == 'export' else []
    for content, words in ((None, 'No such file'), (b'', 'is empty'),
                           (b'#!/bin/sh\n', 'not an MCAP file')):
        if content is not None:
            path.write_bytes(content)
        text = call(command, path, *more, code=2)
        assert words in text and text.count('\n') == 1


def test_each_subcommand_shows_an_example():
    for name in main.commands:
        assert f'    timo_sim {name} ' in call(name, '--help'), name
