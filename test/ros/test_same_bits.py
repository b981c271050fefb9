# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Runs with commands, pauses and resets replay from their logs to the last bit."""

import shutil
import signal

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_process import nanoseconds, replayed
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

import timo_sim
from timo_sim.log.read import recover
from timo_sim.log.tables import Recording
from timo_sim.runs.replay import Replay, segments_of

TURNING = {'initial.shaft_velocity': 1.0}
EVERY_STEP = ('joint_states', 'modal_state', 'tip_deflection', 'tip_pose', 'carrier_pose', 'clock')
SCENES = {
    'free, with friction': {
        'initial.shaft_velocity': 1.0, 'carrier.coulomb_friction': 2.0,
        'motor.coulomb_friction': 0.5},
    'newton, held, driven': {
        'model.formulation': 'newton', 'carrier.held': "'y'", 'motor.shaft': 'driven',
        'motor.drive.time': [0.0, 0.5], 'motor.drive.angle': [0.0, 0.3],
        'motor.drive.speed': [0.0, 1.0], 'motor.drive.acceleration': [0.0, 0.0]},
}


def drive_about(client):
    """Send commands, pause, step and reset; return the number of resets."""
    states = client.collect(JointState, '/joint_states')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    wrench = client.command(WrenchStamped, '/timo_sim/carrier_wrench')
    pause = client.service(SetBool, '/timo_sim/pause')
    step, reset = (client.service(Trigger, f'/timo_sim/{name}') for name in ('step', 'reset'))
    client.wait(lambda: states, 'states')

    def later(count):
        shown = len(states)
        client.wait(lambda: len(states) >= shown + count, f'{count} steps')

    for turn in range(3):
        for k in range(10):
            torque.publish(Float64(data=0.3 * k - turn))
            push = WrenchStamped()
            push.header.frame_id = ('arm', 'world', '')[turn]
            push.wrench.force.x, push.wrench.force.y = 2.0 + k, -1.0
            wrench.publish(push)
            wrench.publish(WrenchStamped()) if k == 5 else None
            later(5)
        later(50)  # time-outs
        assert pause(data=True).success
        if turn == 0:
            for _ in range(3):
                torque.publish(Float64(data=1.0))
                assert step().success
            assert reset().success and reset().success
        assert pause(data=False).success
        if turn == 1:
            assert reset().success
    later(25)
    return 3


@pytest.mark.parametrize('name', SCENES)
def test_every_step_of_a_commanded_run_is_the_same_to_the_last_bit(name, start, client, paper):
    values = SCENES[name]
    rate = 1.0 / values.get('integrator.step', 0.001)
    node = start('--params-file', str(paper), command_timeout=0.02, steps_per_call=7,
                 publish_clock=True, real_time_factor=0.5, **values,
                 **{f'rate.{topic}': rate for topic in EVERY_STEP})
    resets = drive_about(client)
    assert node.end()[0] == 0

    recording = Recording(node.log)
    commands = {name: recording.topics[name] for name in ('~/motor_torque', '~/carrier_wrench')}
    assert len(recording.resets) == resets
    # On a busy machine a later command replaces one that waits.
    assert all(len(series.step) > 5 for series in commands.values())
    # Time-outs are commands of zeros in the log.
    assert all((series.values == 0.0).all(axis=1).sum() >= 2 for series in commands.values())
    # The state is logged at every step, from the first to the last.
    steps = recording.topics['~/modal_state'].step
    assert set(steps) == set(range(steps.max() + 1)) and steps.max() > 50

    lines = replayed(node.log)  # in this process, not the node's
    count = sum(series.values.size for name, series in recording.topics.items()
                if name not in commands)
    assert (f'{count} of {count} logged numbers compared: all are the same to the last bit'
            in lines)

    # The comparison is sensitive: it shows missing commands, and commands a step later.
    for change in (lambda commands: commands[:-3],
                   lambda commands: [(step + 1, *rest) for step, *rest in commands]):
        segments = segments_of(recording, recording.scene, {})
        segments[-1].commands = change(segments[-1].commands)
        Replay(recording.scene, segments).run()
        assert np.any(segments[-1].replayed['joint_states'] != segments[-1].logged['joint_states'])


def test_a_run_that_diverged_was_reset_and_killed_replays(start, client):
    node = start(**{'model.formulation': 'newton', 'model.modes': 5, 'rate.joint_states': 1000.0,
                    'initial.shaft_velocity': 100.0, 'rate.tip_pose': 1000.0,
                    'initial.modal_rates': [1.0, 0.0, 0.0, 0.0, 0.0]})
    states = client.collect(JointState, '/joint_states')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    go_on, reset = (client.service(kind, f'/timo_sim/{name}') for kind, name in (
        (SetBool, 'pause'), (Trigger, 'reset')))
    for turn in range(3):
        client.wait(lambda: not go_on(data=False).success, 'divergence')
        torque.publish(Float64(data=float(turn)))
        assert reset().success and go_on(data=False).success
        torque.publish(Float64(data=-2.0))
    client.wait(lambda: not go_on(data=False).success, 'divergence')
    whole = node.log.with_name('whole.mcap')

    def kept():  # until the recorder has given the last reset to the operating system
        whole.unlink(missing_ok=True)
        recover(shutil.copy(node.log, node.log.with_name('copy.mcap')), whole)
        return len(Recording(whole).resets) == 3
    client.wait(kept, 'the log')
    node.send(signal.SIGKILL)
    node.wait()
    assert len(states) > 10
    assert '3 resets' in replayed(whole)[0]


def test_parameters_that_change_and_a_log_of_a_replay(start, client, paper, tmp_path):
    """The log of a replay has the node's messages, and can be replayed, too."""
    node = start('--params-file', str(paper), real_time_factor=4.0, **{
        'rate.joint_states': 1000.0, 'rate.modal_state': 1000.0, **TURNING})
    states = client.collect(JointState, '/joint_states')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    torque.publish(Float64(data=1.0))
    change = client.service(SetParameters, '/timo_sim/set_parameters')
    reset = client.service(Trigger, '/timo_sim/reset')

    def later(steps):
        until = len(states) and nanoseconds(states[-1]) + 1000000 * steps
        client.wait(lambda: states and nanoseconds(states[-1]) >= until, f'{steps} steps')

    for values in ({'rate.tip_pose': 500.0},
                   {'end_effector.mass': 5.0, 'end_effector.inertia': 0.6},
                   {'end_effector.mass': 8.0, 'end_effector.pick_up': 'at_rest'}):
        later(200)
        answer = change(parameters=[Parameter(name, value=value).to_parameter_msg()
                                    for name, value in values.items()])
        assert all(result.successful for result in answer.results)
    later(200)
    assert reset().success
    later(400)
    assert node.end()[0] == 0
    replayed(node.log, output=tmp_path / 'again.mcap')
    first, second = (Recording(path) for path in (node.log, tmp_path / 'again.mcap'))
    assert first.scene == second.scene
    for name, series in first.topics.items():
        again = second.topics[name]
        assert np.array_equal(series.step, again.step) and series.data == again.data
        assert np.array_equal(series.values, again.values) and series.topic == again.topic
    replayed(tmp_path / 'again.mcap')
    assert len(timo_sim.open_log(node.log).payloads) == 2


def test_commands_after_a_reset_act_in_a_record_when_the_log_says(start, client):
    """A fit to a log: its record begins at the reset; commands and outputs have one clock."""
    node = start(start_paused=True, steps_per_call=400, **{
        'motor.viscous_friction': 0.8, 'integrator.step': 0.001, 'record_sensors': True,
        'sensor.encoder.noise': 1e-4, 'rate.joint_states': 100.0, 'duration': 4.0})
    torque = client.command(Float64, '/timo_sim/motor_torque')
    step, reset = (client.service(Trigger, f'/timo_sim/{name}') for name in ('step', 'reset'))
    for value in (3.0, -2.0, None, 2.0, -4.0, 1.0, 3.0, -1.0, 2.0, 0.0):
        if value is None:
            assert reset().success
            continue
        torque.publish(Float64(data=value))
        client.wait(lambda: step().success, 'a step')
    node.end()
    record = timo_sim.read_record(node.log)
    assert record.outputs['shaft'].t[0] == 0.0 and record.inputs['torque'].t[-1] < record.duration
    assert record.outputs['shaft'].noise == pytest.approx(1e-4)
    guess = timo_sim.load_scene({'motor.viscous_friction': 2.0, 'end_effector.mass': 2.5})
    found = timo_sim.fit(guess, record, ['motor.viscous_friction', 'end_effector.mass'])
    assert found.values == pytest.approx(
        {'motor.viscous_friction': 0.8, 'end_effector.mass': 2.0}, rel=0.02)
    assert np.isclose(found.errors['shaft'].rms, 1e-4, rtol=0.2)
