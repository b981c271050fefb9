# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Replays of logs, bags and changed scenes, against runs with the same loads in the scene."""

import struct

from command_line import call
from mcap.opcode import Opcode
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

import timo_sim
from timo_sim.log.new_log import NewLog
from timo_sim.log.notes import CHANGE, change_note, RESET
from timo_sim.log.read import LogError
from timo_sim.log.tables import Recording
from timo_sim.log.write import Channel, Recorder
from timo_sim.model.layout import LOADS, TORQUE
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.topics.cdr import pack
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs

STORE = get_typestore(Stores.ROS2_JAZZY)
# Log time after the first [ns], torque [N m]; the infinite one is refused.
TORQUES = ((0, 1.0), (299000001, -2.0), (500000000, np.inf), (700000000, 0.5))
SCENE = {'load.torque.piecewise.time': [0.0, 0.3, 0.7],
         'load.torque.piecewise.value': [1.0, -2.0, 0.5]}


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
    text = call('replay', bag, '--scene', paper, '--duration', 1.5, '--set',
                'load.force_x.harmonic.amplitude=[]', '--set',
                'load.force_x.harmonic.frequency=[]', '--set', 'load.force_x.harmonic.phase=[]',
                '--set', 'rate.tip_pose=20', '-o', tmp_path / 'run.mcap')
    assert '3 commands' in text and '1 commands are left out' in text
    recording = Recording(tmp_path / 'run.mcap')
    # A command 299.000001 ms after the first comes in the 300th step and acts from its end on.
    assert recording.topics['~/motor_torque'].step.tolist() == [0, 300, 700]
    assert recording.topics['~/tip_pose'].step.tolist() == list(range(0, 1501, 50))
    scene = timo_sim.load_scene(paper, {
        'load.force_x.harmonic.amplitude': [], 'load.force_x.harmonic.frequency': [],
        'load.force_x.harmonic.phase': [], **SCENE})
    ns, motion, _ = recording.motion()
    run = timo_sim.simulate(scene, 1.5, sample_every=10, estimate=False)
    assert ns.tolist() == list(range(0, 1501 * 10**6, 10**7))
    # The same loads, added in another order.
    assert np.abs(motion - run.values).max() < 1e-12
    assert 'act after the end' not in text
    # A command at the last step would act only after it.
    for duration, count in ((0.1, 1), (0.3, 1), (0.301, 2)):
        path = tmp_path / f'{duration}.mcap'
        text = call('replay', bag, '--scene', paper, '--duration', duration, '-o', path)
        assert f': {count} commands and' in text
        assert f'{3 - count} commands are left out, because they act after the end' in text
        assert len(Recording(path).topics['~/motor_torque'].step) == count


def bag_of_runs(path, commands, states):
    """
    Write a bag as rosbag2 does; return its path.

    Commands are (log time, torque), states (log time, step, positions and velocities).
    """
    from timo_sim.topics.cdr import Serializer
    from timo_sim.topics.outputs import outputs
    joints, = (output for output in outputs(0) if output.name == 'joint_states')
    serialize, torque = Serializer(joints.type_name, joints.template), 'std_msgs/msg/Float64'
    messages = [(time, '/timo_sim/motor_torque', torque, STORE.serialize_cdr(
        STORE.types[torque](value), torque)) for time, value in commands]
    messages += [(time, '/joint_states', joints.type_name, serialize(
        divmod(step * 1000000, 10**9), [*state, 0.0, 0.0, 0.0])) for time, step, state in states]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        known = {}
        for time, topic, kind, data in sorted(messages, key=lambda message: message[0]):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], 1700000000123456789 + round(1e9 * time), bytes(data))
    return path


def states_of(torques, last):
    """Return positions and velocities every 10 ms of the default arm with these torques."""
    scene = timo_sim.load_scene({'load.torque.piecewise.time': [time for time, _ in torques],
                                 'load.torque.piecewise.value': [value for _, value in torques]})
    motion = timo_sim.simulate(scene, last, sample_every=10, estimate=False).values
    half = motion.shape[1] // 2
    return np.hstack([motion[:, :3], motion[:, half:half + 3]])


@pytest.fixture
def default_scene(tmp_path):
    (tmp_path / 'scene.yaml').write_text('/**: {ros__parameters: {hub.radius: 0.0}}')
    return tmp_path / 'scene.yaml'


def test_a_bag_without_its_scene_is_replayed(tmp_path, default_scene):
    torques = [(0.1, 1.0), (0.7, -2.0)]
    motion = states_of(torques, 0.9)
    states = [(0.01 * k, 10 * k, state) for k, state in enumerate(motion)]
    bag = bag_of_runs(tmp_path / 'bag', torques, states)
    text = call('replay', bag, '--scene', default_scene, '-o', tmp_path / 'new.mcap')
    assert f'{bag}' in text and '2 commands and 0 resets in 0.9 s' in text
    found = Recording(tmp_path / 'new.mcap')
    assert found.topics['~/motor_torque'].step.tolist() == [100, 700]
    assert np.abs(found.topics['joint_states'].values[:, :6] - motion).max() < 1e-12
    (bag / 'another.mcap').touch()
    assert 'has 2 files *.mcap, and must have one: ros2 bag convert' in call(
        'replay', bag, '--scene', default_scene, code=2)


def test_a_bag_with_a_reset_but_without_its_scene_is_refused(tmp_path, default_scene):
    """The bag does not say that ~/reset was called; its joint states go back to the start."""
    before, after = states_of([(0.1, 1.0)], 0.5), states_of([(0.2, -2.0)], 0.4)
    states = [(0.01 * k, 10 * k, state) for k, state in enumerate(before)]
    states += [(0.51 + 0.01 * k, 500 + 10 * k, state) for k, state in enumerate(after)]
    bag = bag_of_runs(tmp_path / 'bag', [(0.1, 1.0), (0.71, -2.0)], states)
    assert 'start of the scene at log time 1700000000633456789 ns, as by a reset' in call(
        'replay', bag, '--scene', default_scene, code=2)


def test_a_bag_that_spans_two_runs_is_refused_with_the_place(tmp_path, default_scene):
    first, second = states_of([(0.1, 1.0)], 0.5), states_of([(0.2, -2.0)], 0.4)
    bag = bag_of_runs(tmp_path / 'bag', [(0.1, 1.0), (0.9, -2.0)], [
        *((0.01 * k, 10 * k, state) for k, state in enumerate(first)),
        *((0.7 + 0.01 * k, 10 * k, state) for k, state in enumerate(second))])
    for arguments in (['replay', bag, '--scene', default_scene],
                      ['export', bag, '-o', tmp_path / 'run.csv']):
        text = call(*arguments, code=2)
        assert 'stamps of /joint_states fall from 0.5 to 0 s at log time 1700000000823456789' in (
            text) and text.count('\n') == 1


@pytest.mark.parametrize('time, states', [  # log times of 0 and nearly 2^63 ns
    (-1.7e9, []), (7.5e9, []), (7.5e9, [(0.01 * n, 10 * n, np.zeros(6)) for n in range(9)])])
def test_a_log_time_that_cannot_be_is_one_line_not_all_memory(
        time, states, tmp_path, default_scene):
    path = bag_of_runs(tmp_path / 'bag', [(0.05, 1.0), (time, 2.0)], states)
    options = 'replay', path, '--scene', default_scene, '-o', tmp_path / 'new.mcap'
    text = call(*options, code=2)
    assert ' lasts ' in text and 'give --duration' in text and text.count('\n') == 1
    assert ' commands and ' in call(*options, '--duration', 0.1)


def log_of(path, scene, torques, last):
    """Write a log as the node would, joint states of `simulate` every 10 ms; return its path."""
    from timo_sim.log.notes import START, start_note
    from timo_sim.scene.parameters import PARAMETERS
    from timo_sim.topics.cdr import Serializer
    from timo_sim.topics.outputs import outputs
    joints, = (output for output in outputs(0) if output.name == 'joint_states')
    values = {**{name: entry.default for name, entry in PARAMETERS.items()}, **scene.values}
    recorder = Recorder(path, [Channel('/joint_states', joints.type_name),
                               Channel('/timo_sim/motor_torque', 'std_msgs/msg/Float64')],
                        {START: start_note('/timo_sim', values)})
    serialize = Serializer(joints.type_name, joints.template)
    run = timo_sim.simulate(scene.vary({
        'load.torque.piecewise.time': [1e-3 * step for step, _ in torques],
        'load.torque.piecewise.value': [value for _, value in torques]}), 1e-3 * last)
    for step in range(last + 1):
        if step % 10 == 0:
            torque = [value for begin, value in torques if begin < step][-1:] or [0.0]
            half = run.values.shape[1] // 2
            numbers = [*run.values[step, :3], *run.values[step, half:half + 3], 0.0, 0.0, *torque]
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


def falsify(log, old, new):
    """Replace bytes of a log, and the checksum of all data by 0, which says that it has none."""
    data = log.read_bytes().replace(old, new)
    place = data.rindex(struct.pack('<BQ', Opcode.DATA_END, 4)) + 9
    log.write_bytes(data[:place] + bytes(4) + data[place + 4:])


def test_a_log_gives_the_same_bits_and_a_falsified_one_does_not(log, tmp_path):
    assert '909 of 909 logged numbers compared: all are the same to the last bit' in call(
        'replay', log)
    wrong = log_of(tmp_path / 'wrong.mcap', timo_sim.load_scene({'carrier.mass': 5.0000001}),
                   [(100, 1.0)], 1000)
    text = call('replay', wrong, '--duration', 0.5)
    assert 'same to the last bit' in text
    # The log now names another mass than that of its run.
    falsify(wrong, b'"carrier.mass": 5.0000001', b'"carrier.mass": 5.0000002')
    text = call('replay', wrong, code=1)
    assert ' of 909 logged numbers compared: ' in text and ' differ\n' in text
    assert 'joint_states carrier_x_m' in text


JUMP = {'load.torque.piecewise.time': [0.0, 0.02], 'load.torque.piecewise.value': [1.0, -2.0]}
FREE = {'carrier.held': 'none', 'carrier.mass': 1.0}
# Arms without a hub and a static shape have machine code in common with those of other tests.
PLAIN = {'hub.radius': 0.0, 'model.static_modes': 'none'}
SAVED = {
    'held': {}, 'free': FREE, 'in gravity': {**FREE, 'carrier.held': 'x', 'gravity': [0.0, -9.81]},
    'friction': {'motor.coulomb_friction': 0.1},
    'current limit': {**FREE, 'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5,
                      'motor.dc.current_limit': 1.9, 'initial.shaft_velocity': 3.0},
    'elastic gear': {**FREE, 'motor.gear.stiffness': 300.0, 'motor.rotor.inertia': 0.05}}


@pytest.mark.parametrize('values', SAVED.values(), ids=SAVED)
def test_a_row_is_the_motion_and_the_effort_before_it(values, tmp_path):
    """In a run, its table, its log and a simulator alike; a replay of the log is the same."""
    run = timo_sim.simulate(timo_sim.load_scene('arm', {**JUMP, **PLAIN, **values}), 0.04,
                            estimate=False)
    torque = np.where(run.t < 0.0205, 1.0, -2.0)
    if 'motor.dc.current_limit' not in values:  # 0.95 N m and the back-EMF
        assert run.effort[:, 2] == pytest.approx(torque)
    assert timo_sim.Simulator(run.scene).effort[2] == run.effort[0, 2]
    assert run.columns()['shaft_torque_N_m'].tolist() == run.effort[:, 2].tolist()
    path = run.save(tmp_path / 'run.mcap')
    assert np.array_equal(timo_sim.open_log(path).effort, run.effort)
    text = call('replay', path)
    count = 41 * (19 + 2 * run.scene.modal_count - run.model.constrained.sum())
    assert f'{count} of {count} logged numbers compared: all are the same to the last bit' in text


def driven(path, scene):
    """
    Return a simulator that is driven as by the node, and its log.

    And functions of it: advance(steps, torque) logs each step and the command at the first,
    change(values) notes what is set.
    """
    simulator, log = timo_sim.Simulator(scene), NewLog(
        path, scene, {name: rule.default for name, rule in PARAMETERS.items()}
        | dict(scene.values))
    states = {output.name: output for output in outputs(scene.modal_count)
              if output.name in ('joint_states', '~/modal_state')}

    load = np.zeros(LOADS)

    def advance(count, torque=0.0):
        if torque != load[TORQUE]:
            load[TORQUE] = torque
            log.write([each.name for each in COMMANDS].index('~/motor_torque'), simulator.steps,
                      simulator.nanoseconds, pack('std_msgs/msg/Float64', {'data': torque}))
        for _ in range(count):
            simulator.advance(1, load)
            look = simulator.snapshot()
            for name, output in states.items():
                log.output(name, look, output.numbers(look))

    def change(values):
        simulator.change(simulator.scene.vary(values))
        log.note(CHANGE, change_note(simulator.steps, values))

    return simulator, log, advance, change


@pytest.mark.parametrize('presliding', [0.0, 0.003])
def test_what_was_set_is_set_again_also_beside_a_reset(presliding, tmp_path):
    simulator, log, advance, change = driven(tmp_path / 'set.mcap', timo_sim.load_scene({
        'initial.shaft_velocity': 2.0, 'carrier.coulomb_friction': 5.0,
        'carrier.coulomb_presliding': presliding}))
    for mass, reset in ((1 / 3, False), (2.0, True), (0.5, False)):
        advance(40)
        change({'end_effector.mass': mass})
        if reset:
            simulator.reset()
            log.note(RESET, {'step': str(simulator.steps)})
    advance(40)
    log.close()
    text = call('replay', log.path, '-o', tmp_path / 'again.mcap')
    assert 'all are the same to the last bit' in text and '1 resets' in text
    assert 'all are the same to the last bit' in call('replay', tmp_path / 'again.mcap')
    assert 'at step 40: end_effector.mass = 0.333' in call('info', log.path)
    with pytest.raises(timo_sim.ParameterError, match='end_effector.mass was set at 0.04 s'):
        timo_sim.read_record(log.path)


def test_a_log_whose_scene_was_set_before_its_last_reset_is_no_record(tmp_path):
    """A reset keeps what was set, so the motion after it is not that of the first scene."""
    simulator, log, advance, change = driven(tmp_path / 'set.mcap', timo_sim.load_scene({
        'initial.shaft_velocity': 2.0}))
    advance(40)
    change({'carrier.viscous_friction': 5.0})
    simulator.reset()
    log.note(RESET, {'step': str(simulator.steps)})
    advance(40)
    log.close()
    with pytest.raises(timo_sim.ParameterError, match='carrier.viscous_friction was set at 0.04'):
        timo_sim.read_record(log.path)


def test_a_fit_to_a_log_follows_a_rate_limit_from_the_first_step_on(tmp_path):
    """In lock step the first command acts at the first step, and ramps up from 0."""
    _, log, advance, _ = driven(tmp_path / 'ramp.mcap', timo_sim.load_scene({
        'motor.torque_rate_limit': 2.0, 'motor.viscous_friction': 0.5}))
    advance(1500, 2.0)
    advance(500, -1.0)
    log.close()
    scene = timo_sim.open_log(log.path).scene.vary({'motor.viscous_friction': 0.4})
    found = timo_sim.fit(scene, timo_sim.read_record(log.path), ['motor.viscous_friction'])
    assert found.values['motor.viscous_friction'] == pytest.approx(0.5, abs=1e-6)


def test_the_dissipated_energy_follows_friction_and_damping_that_were_set(tmp_path):
    _, log, advance, change = driven(tmp_path / 'set.mcap', timo_sim.load_scene({
        'initial.shaft_velocity': 2.0, 'initial.modal_rates': [0.5, 0.0, 0.0]}))
    for values in ({'motor.viscous_friction': 2.0, 'load.torque.harmonic.amplitude': []},
                   {'arm.damping_ratio': [0.02], 'carrier.viscous_friction': 1.0}, {}):
        advance(301)
        change(values)
    log.close()
    run = timo_sim.open_log(log.path)
    left = run.energy() - run.energy()[0] + run.dissipated()
    assert not run.dissipated()[:301].any() and run.dissipated()[-1] > 1.0
    # Measured: 9e-7 J, by modes of up to 470 rad/s at samples 1 ms apart.
    assert np.abs(left).max() < 2e-6
    assert run.save(tmp_path / 'table.csv').exists()
    with pytest.raises(ValueError, match='set.mcap: copy this file, since a log made of its mot'):
        run.save(tmp_path / 'copy.mcap')


def test_a_log_of_an_old_version_is_refused_with_the_version_that_reads_it(log):
    log.write_bytes(log.read_bytes().replace(timo_sim.__version__.encode(), b'0.1.0'))
    assert 'run.mcap is of timo_sim 0.1.0: read it with timo_sim 0.2.0, the last version' in call(
        'replay', log, code=2)


def test_a_log_of_0_2_0_is_read_by_the_present_names(tmp_path):
    log = log_of(tmp_path / 'old.mcap', timo_sim.load_scene({'model.modes': 1}), [(10, 1.0)], 20)
    for name in ('width', 'height', 'shear_correction'):
        falsify(log, f'"arm.section.{name}"'.encode(), f'"arm.{name}"        '.encode())
    falsify(log, b'"sensor.encoder.noise": 0.0', b'"integrator.tolerance": 0.0')
    assert 'all are the same to the last bit' in call('replay', log, '-o', tmp_path / 'new.mcap')
    falsify(log, b'"integrator.tolerance": 0.0', b'"integrator.tolerance": 0.1')
    assert 'split by integrator.tolerance: replay it with timo_sim 0.2.0' in call(
        'replay', log, code=2)


def test_views_say_what_a_bag_or_log_lacks(bag, log, tmp_path):
    for file, missing in (bag, '/timo_sim/scene, so'), (log, 'modal_state of /timo_sim'):
        text = call('view', file, '--gif', tmp_path / 'run.gif', code=2)
        assert f'has no {missing}' in text and text.count('\n') == 1
    with pytest.raises(LogError, match='has no /timo_sim/scene'):
        timo_sim.open_log(bag)


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


def test_an_arm_that_stretches_replays_to_the_last_bit(tmp_path):
    run = timo_sim.simulate(timo_sim.load_scene({
        'model.axial_modes': 1, 'initial.shaft_velocity': 5.0}), 0.1, sample_every=10)
    run.save(tmp_path / 'soft.mcap')
    assert np.array_equal(Recording(tmp_path / 'soft.mcap').motion()[1], run.values)
    assert run.values.shape == (11, 2 * (3 + 3 + 1))
    assert 'same to the last bit' in call('replay', tmp_path / 'soft.mcap')


def test_another_time_step_is_taken_if_it_fits(log, tmp_path):
    text = call('replay', log, '--set', 'integrator.step=0.0005', '-o', tmp_path / 'fine.mcap')
    assert '2 commands and 0 resets in 1 s' in text
    assert Recording(tmp_path / 'fine.mcap').topics['~/motor_torque'].step.tolist() == [200, 910]
    text = call('replay', log, '--set', 'integrator.step=0.003', code=2)
    assert 'integrator.step = 0.003 s does not meet the times of /joint_states' in text


def test_a_run_that_diverges_is_code_1_and_says_when(log, tmp_path):
    text = call('replay', log, '--set', 'model.formulation=newton', 'model.modes=5',
                'initial.shaft_velocity=60', '-o', tmp_path / 'new.mcap', code=1)
    assert 'diverges after t' in text and Recording(tmp_path / 'new.mcap').topics


def test_a_log_of_another_machine_gives_one_line(log):
    import platform
    name = platform.machine().encode()
    falsify(log, name, b'?' * len(name))
    assert f'logged with machine {"?" * len(name)} (here {platform.machine()})' in call(
        'replay', log)


BAD_INPUT = [
    (['--set', 'arm.lenght=2'], 'arm.lenght = 2 is not a parameter'),
    (['--set', 'arm.length'], '--set takes NAME=VALUE'),
    (['--duration', '0.0005'], 'duration = 0.0005 must be a whole multiple'),
    (['--duration', '2'], 'beyond the end of the log, 1 s'),
    (['--scene', 'nothing.yaml'], 'nothing.yaml'),
]


def test_bad_input_is_one_line_and_code_2(log):
    for settings, words in BAD_INPUT:
        text = call('replay', log, *settings, code=2)
        assert words in text and text.count('\n') == 1


def forged(log, before, after):
    """Exchange bytes of a log's notes, and let its data section have no checksum."""
    content = log.read_bytes()
    assert before in content and len(before) == len(after)
    end = content.rindex(bytes([Opcode.DATA_END]) + struct.pack('<Q', 4))
    content = content[:end + 9] + bytes(4) + content[end + 13:]
    log.write_bytes(content.replace(before, after))
    return log


def test_a_log_whose_scene_has_other_modes_than_its_messages_is_refused(tmp_path):
    log = timo_sim.simulate('paper', 0.01).save(tmp_path / 'run.mcap')
    with pytest.raises(LogError, match='has 3 modal coordinates, but its scene has 5'):
        timo_sim.open_log(forged(log, b'"model.modes": 3', b'"model.modes": 5'))


def test_replay_prints_no_control_characters_of_a_log(log):
    version = np.__version__.encode()
    text = call('replay', forged(log, version, b'\x1b[2J'.ljust(len(version), b'x')))
    assert '[2J' in text and '\x1b' not in text
