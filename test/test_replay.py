# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Replays of logs, bags and changed scenes, against runs with the same loads in the scene."""

from click.testing import CliRunner
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

import timo_sim
from timo_sim.cli import main
from timo_sim.log.recorder import Channel, Recorder
from timo_sim.log.recording import Recording
from timo_sim.view.track import of_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
# Log time after the first [ns], torque [N m]; the infinite one is refused.
TORQUES = ((0, 1.0), (299000001, -2.0), (500000000, np.inf), (700000000, 0.5))
SCENE = {'load.torque.piecewise.time': [0.1, 0.4, 0.8],
         'load.torque.piecewise.value': [1.0, -2.0, 0.5]}


def call(*arguments, code=0):
    """Call the command line; return what it prints."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, (result.output, result.exception)
    return result.output


@pytest.fixture
def bag(tmp_path):
    """Write a bag of torques as other tools do, with wall time as log time."""
    kind = 'std_msgs/msg/Float64'
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        torque = writer.add_connection('/timo_sim/motor_torque', kind, typestore=STORE)
        for time, value in TORQUES:
            writer.write(torque, 1700000000123456789 + time,
                         STORE.serialize_cdr(STORE.types[kind](value), kind))
    return tmp_path / 'bag'


def test_a_bag_of_commands_gives_the_run_with_these_loads(bag, paper, tmp_path):
    text = call('replay', bag, '--scene', paper, '--start', 0.1, '--duration', 1.5, '--set',
                'load.force_x.harmonic.amplitude=[]', '--set',
                'load.force_x.harmonic.frequency=[]', '--set', 'load.force_x.harmonic.phase=[]',
                '-o', tmp_path / 'run.mcap')
    assert '3 commands' in text and '1 commands are left out' in text
    recording = Recording(tmp_path / 'run.mcap')
    # A command 299.000001 ms after the first comes in the 300th step and acts from its end on.
    assert recording.topics['~/motor_torque'].step.tolist() == [100, 400, 800]
    scene = timo_sim.load_scene(paper, {
        'load.force_x.harmonic.amplitude': [], 'load.force_x.harmonic.frequency': [],
        'load.force_x.harmonic.phase': [], **SCENE})
    step, _, motion = recording.motion()
    run = timo_sim.simulate(scene, 1.5, sample_every=10)
    assert step.tolist() == list(range(0, 1501, 10))
    # The same loads, added in another order.
    assert np.abs(motion - run.motion).max() < 1e-12
    # A command at the last step would act only after it.
    for duration, count in ((0.1, 0), (0.4, 1), (0.401, 2)):
        path = tmp_path / f'{duration}.mcap'
        text = call('replay', bag, '--scene', paper, '--start', 0.1, '--duration', duration,
                    '-o', path)
        assert f': {count} commands and' in text
        assert len(Recording(path).topics['~/motor_torque'].step) == count


def test_a_bag_needs_a_scene_and_a_log_does_not(bag):
    assert 'give it by --scene' in call('replay', bag, code=2)


def log_of(path, scene, torques, last):
    """Write a log as the node would, joint states of `simulate` every 10 ms; return its path."""
    from timo_sim.log.notes import START, start_note
    from timo_sim.messages.outputs import outputs
    from timo_sim.messages.packing import Serializer
    from timo_sim.scene.parameters import PARAMETERS
    joints, = (output for output in outputs(0) if output.name == 'joint_states')
    values = {**{name: entry.default for name, entry in PARAMETERS.items()}, **scene.values}
    recorder = Recorder(path, [Channel('/joint_states', joints.type_name),
                               Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')],
                        {START: start_note('/timo_sim', values, {}, scene)})
    serialize = Serializer(joints.type_name, joints.template)
    run = timo_sim.simulate(scene.vary({
        'load.torque.piecewise.time': [1e-3 * step for step, _ in torques],
        'load.torque.piecewise.value': [value for _, value in torques]}), 1e-3 * last)
    for step in range(last + 1):
        if step % 10 == 0:
            torque = [value for begin, value in torques if begin < step][-1:] or [0.0]
            half = run.motion.shape[1] // 2
            numbers = [*run.motion[step, :3], *run.motion[step, half:half + 3], 0.0, 0.0, *torque]
            recorder.write(0, step, step * 1000000, serialize(divmod(step * 1000000, 10**9),
                                                              numbers))
        for value in [value for begin, value in torques if begin == step]:
            data = STORE.serialize_cdr(STORE.types['std_msgs/msg/Float64'](value),
                                       'std_msgs/msg/Float64')
            recorder.write(1, step, step * 1000000, bytes(data))
    recorder.close()
    return path


@pytest.fixture
def log(tmp_path):
    """Log a second with two commands, from `simulate` instead of the node."""
    return log_of(tmp_path / 'run.mcap', timo_sim.load_scene({}), [(100, 1.0), (455, -1.0)], 1000)


def test_a_view_of_a_log_has_the_work_of_its_commands(tmp_path):
    """From the step on at which they begin to act; samples are 10 ms apart."""
    log = log_of(tmp_path / 'run.mcap', timo_sim.load_scene({'model.modes': 0}),
                 [(100, 20.0), (500, -20.0), (510, 15.0)], 1000)
    track = of_recording(Recording(log), 'log')
    energy, balance = (track.trace(name).values for name in ('energy', 'balance'))
    assert np.abs(balance).max() < 1e-9 * energy.max()


def test_a_log_gives_the_same_bits_and_a_falsified_one_does_not(log, tmp_path):
    assert '909 of 909 logged numbers compared: all are the same to the last bit' in call(
        'replay', log)
    wrong = log_of(tmp_path / 'wrong.mcap', timo_sim.load_scene({'carrier.mass': 5.0000001}),
                   [(100, 1.0)], 1000)
    text = call('replay', wrong, '--duration', 0.5)
    assert 'same to the last bit' in text
    # The log now names another mass than that of its run.
    data = wrong.read_bytes().replace(b'"carrier.mass": 5.0000001', b'"carrier.mass": 5.0000002')
    wrong.write_bytes(data)
    text = call('replay', wrong, code=1)
    assert ' of 909 logged numbers compared: ' in text and ' differ\n' in text
    assert 'joint_states carrier_x_m' in text


def test_a_changed_scene_gives_differences_with_time_and_unit(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = call('replay', log, '--set', 'model.modes=5', '--set', 'end_effector.mass=2.5')
    assert 'new log: run_replay.mcap' in text
    scene = timo_sim.load_scene({
        'load.torque.piecewise.time': [0.1, 0.455], 'load.torque.piecewise.value': [1.0, -1.0]})
    before = timo_sim.simulate(scene, 1.0, sample_every=10)
    now = timo_sim.simulate(scene.vary({'model.modes': 5, 'end_effector.mass': 2.5}), 1.0,
                            sample_every=10)
    distance = np.abs(now.shaft - before.shaft)
    row = next(line.split() for line in text.splitlines() if 'joint_states shaft_rad' in line)
    assert float(row[2]) == pytest.approx(distance.max(), rel=0.01)
    assert float(row[3]) == before.t[distance.argmax()]
    assert float(row[5]) == pytest.approx(np.sqrt(np.mean(distance**2)), rel=0.01)
    assert '3 other quantities are the same' in text  # efforts
    assert Recording('run_replay.mcap').scene.values['model.modes'] == 5
    assert 'same to the last bit' in call('replay', 'run_replay.mcap')


def test_a_log_without_modes_replays_with_modes(tmp_path):
    log = log_of(tmp_path / 'rigid.mcap', timo_sim.load_scene({'model.modes': 0}), [(1, 1.0)], 100)
    call('replay', log, '--set', 'model.modes=3', '-o', tmp_path / 'bent.mcap')
    step, _, motion = Recording(tmp_path / 'bent.mcap').motion()
    assert step.tolist() == list(range(0, 101, 10)) and motion.shape == (11, 12)


def test_an_arm_that_stretches_replays_to_the_last_bit(tmp_path):
    run = timo_sim.simulate(timo_sim.load_scene({
        'model.axial_modes': 1, 'initial.shaft_velocity': 5.0}), 0.1, sample_every=10)
    run.save(tmp_path / 'soft.mcap')
    assert np.array_equal(Recording(tmp_path / 'soft.mcap').motion()[2], run.motion)
    assert run.motion.shape == (11, 2 * (3 + 3 + 1))
    assert 'same to the last bit' in call('replay', tmp_path / 'soft.mcap')


def test_another_time_step_is_taken_if_it_fits(log, tmp_path):
    text = call('replay', log, '--set', 'integrator.step=0.0005', '-o', tmp_path / 'fine.mcap')
    assert '2 commands and 0 resets in 1 s' in text
    assert Recording(tmp_path / 'fine.mcap').topics['~/motor_torque'].step.tolist() == [200, 910]
    text = call('replay', log, '--set', 'integrator.step=0.003', code=2)
    assert 'integrator.step = 0.003 s does not meet the times of /joint_states' in text


def test_a_run_that_diverges_is_code_1_and_says_when(log, tmp_path):
    text = call('replay', log, '--formulation', 'newton', '--set', 'initial.shaft_velocity=60',
                '--set', 'model.modes=5', '-o', tmp_path / 'new.mcap', code=1)
    assert 'diverges after t' in text and Recording(tmp_path / 'new.mcap').topics


def test_a_log_of_another_machine_gives_one_line(log):
    """Only the checksum of all data covers the notes; a replay does not check it."""
    import platform
    data = log.read_bytes()
    name = platform.machine().encode()
    log.write_bytes(data.replace(name, b'?' * len(name)))
    assert f'logged with machine {"?" * len(name)} (here {platform.machine()})' in call(
        'replay', log)


@pytest.mark.parametrize('settings, words', [
    (['--set', 'arm.lenght=2'], 'arm.lenght = 2 is not a parameter'),
    (['--set', 'arm.length'], '--set takes NAME=VALUE'),
    (['--set', 'arm.length=-1'], 'arm.length must be a finite number > 0'),
    (['--formulation', 'euler'], 'model.formulation must be one of'),
    (['--duration', '0.0005'], 'duration = 0.0005 must be a whole multiple'),
    (['--duration', '2'], 'beyond the end of the log, 1 s'),
    (['--scene', 'nothing.yaml'], 'nothing.yaml'),
])
def test_bad_input_is_one_line_and_code_2(log, settings, words):
    text = call('replay', log, *settings, code=2)
    assert words in text and text.count('\n') == 1
