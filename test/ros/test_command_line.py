# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How the process starts and ends: bad parameters, signals."""

import os
import signal
import time

from mcap.reader import make_reader
import pytest


@pytest.mark.parametrize('parameters, words', [
    ({'arm.length': -2.0}, 'arm.length must be a finite number > 0 m, got -2.0'),
    ({'arm.lenght': 2.0}, 'arm.lenght = 2.0 is not a parameter of timo_sim'),
    ({'rate.tip_pose': 300.0}, 'rate.tip_pose = 300, the ratio is 3.33333'),
    ({'load.torque.piecewise.time': '[1.0, 2]'}, 'load.torque.piecewise.time'),
    ({'carrier.held': False}, 'carrier.held must be one of none, x, y, both, got False'),
    ({'use_sim_time': 1}, "'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'"),
])
def test_bad_parameters_end_with_one_line_and_code_2(start, parameters, words):
    code, output = start(**parameters).wait()
    ours = [line for line in output.splitlines() if line.startswith('timo_sim: ')]
    assert code == 2
    assert len(ours) == 1 and words in ours[0]
    assert 'Traceback' not in output


def test_a_node_without_docstrings_writes_its_log_into_the_home(start, tmp_path, monkeypatch):
    monkeypatch.setenv('PYTHONOPTIMIZE', '2')
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    code, output = start(fresh=True, duration=0.1, record_file='~/logs/run.mcap').wait()
    assert code == 0 and (tmp_path / 'home/logs/run.mcap').exists(), output
    assert not (tmp_path / '~').exists()


def test_nohup_is_respected(start):
    def ignore():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    node = start(preexec_fn=ignore, real_time_factor=0.0, duration=20.0)
    node.wait_for_handlers()
    node.send(signal.SIGHUP)
    assert 'simulated 20 s' in node.wait()[1]


def test_an_invalid_parameter_file(start, tmp_path):
    (tmp_path / 'bad.yaml').write_text('timo_sim: {ros__parameters: {arm: [')
    code, output = start('--params-file', 'bad.yaml').wait()
    assert code == 2 and 'bad.yaml' in output and 'Traceback' not in output


def test_a_namespace_that_is_too_long_ends_with_one_line_and_code_2(start):
    code, output = start('-r', f'__ns:=/{"x" * 230}').wait()
    assert (code, output.count('\n')) == (2, 1) and 'topic length should not exceed' in output


def test_a_node_with_closed_streams_runs_and_its_log_is_intact(start):
    def close():
        for number in range(3):
            os.close(number)

    node = start(preexec_fn=close, duration=0.1)
    assert node.wait()[0] == 0
    with open(node.log, 'rb') as stream:
        assert make_reader(stream, validate_crcs=True).get_summary().statistics.message_count


def test_an_error_of_the_middleware_ends_with_one_line_and_code_1(start, tmp_path, monkeypatch):
    """Security is on, but keys are missing, or Fast DDS was built without security."""
    (tmp_path / 'enclaves' / 'timo_sim').mkdir(parents=True)
    for name, value in (('KEYSTORE', tmp_path), ('ENABLE', 'true'), ('STRATEGY', 'Enforce')):
        monkeypatch.setenv(f'ROS_SECURITY_{name}', str(value))
    code, output = start('--enclave', '/timo_sim').wait()
    assert code == 1 and 'timo_sim: error creating node' in output and 'Traceback' not in output


def test_spellings_of_numbers_implausible_values_and_a_run_without_a_log(start, tmp_path):
    code, output = start(record=False, duration=0.1, **{
        'initial.shaft': 45.0, 'arm.length': '2', 'arm.width': '2.0e-2',
        'arm.young_modulus': '70.5e9'}).wait()
    assert code == 0 and 'is this meant? initial.shaft = 45 rad is more than a turn' in output
    assert not list(tmp_path.rglob('*.mcap'))


@pytest.mark.parametrize('delay, number', [
    (0.0, signal.SIGINT), (0.3, signal.SIGTERM), (0.6, signal.SIGINT), (0.9, signal.SIGTERM),
    (2.4, signal.SIGINT), (2.4, signal.SIGHUP)])
def test_signals_end_the_process_cleanly(start, number, delay):
    """Two signals at any time during and after the start, once Python can handle them."""
    node = start(fresh=True)
    node.wait_for_handlers()
    time.sleep(delay)
    node.send(number)
    time.sleep(0.02)
    code, output = node.end(number)
    assert 'Traceback' not in output
    if node.log.exists():
        with open(node.log, 'rb') as stream:
            assert make_reader(stream).get_summary().statistics is not None
    assert code == 0
