# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Lock step by a client's calls or a controller's commands: its bits; the pacing of other runs."""

from contextlib import contextmanager
from math import inf, nan
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from ros_process import nanoseconds, PATIENCE, replayed
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

import timo_sim
from timo_sim.log.info import info
from timo_sim.log.tables import Recording
from timo_sim.ros.loop import Gate, Pace


def test_constant_force_gives_momentum_force_times_time(start, client):
    """A paused node is stepped by calls; commands are logged with the step at which they act."""
    node = start(start_paused=True, steps_per_call=10)
    states = client.collect(JointState, '/joint_states')
    wrench = client.command(WrenchStamped, '/timo_sim/carrier_wrench')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    call, push = client.service(Trigger, '/timo_sim/step'), WrenchStamped()
    push.wrench.force.x, push.wrench.force.y = 4.0, -1.0
    wrench.publish(push)
    for number in range(10, 511, 10):
        assert call().message == f'at step {number}'
        client.wait(lambda: states and nanoseconds(states[-1]) == 1000000 * number, 'the state')
        if number == 500:
            torque.publish(Float64(data=1.5))
    assert node.end()[0] == 0
    topics = Recording(node.log).topics
    assert topics['~/carrier_wrench'].log_ns.tolist() == [0]
    assert topics['~/motor_torque'].log_ns.tolist() == [500000000]
    scene = timo_sim.load_scene({}, {
        f'load.force_{axis}.piecewise': {'time': [0.0], 'value': [force]}
        for axis, force in (('x', 4.0), ('y', -1.0))})
    run = timo_sim.simulate(scene, 0.5, sample_every=10)
    assert np.abs(run.momentum()[:, :2] - np.outer(run.t, [4.0, -1.0])).max() < 1e-12
    # The client received that run, to the last bit; a state may come again.
    states = {nanoseconds(state): state for state in states}
    states = [states[10**7 * k] for k in range(1, 51)]
    assert [state.effort.tolist() for state in states] == [[4.0, -1.0, 0.0]] * 50
    assert np.array_equal([state.position for state in states], run.values[1:, :3])
    assert np.array_equal([state.velocity for state in states], run.values[1:, 6:9])


def pace_of(step, factor=1.0, limit=0.1):
    pace = Pace(step)
    pace.set(factor, limit, 0, 100.0)
    return pace


def test_every_deadline_gives_one_step_without_drift():
    pace, steps = pace_of(0.001), 0
    for tick in range(1, 20001):
        assert pace.deadline(steps) == pytest.approx(100.0 + tick * 0.001, abs=1e-9)
        assert pace.due(steps, pace.deadline(steps)) == 1
        steps += 1
    assert (pace.overruns, pace.dropped_steps) == (0, 0)
    assert pace.report() == 'no sim time was lost (0 late ticks)'


def test_ticks_are_at_least_a_millisecond_apart():
    """Short steps, and those of a fast run, are done ten at a time."""
    for step, factor, steps, period in ((0.0001, 1.0, 10, 0.001), (0.001, 10.0, 10, 0.001),
                                        (0.001, 0.1, 1, 0.010), (0.02, 1.0, 1, 0.020)):
        pace = pace_of(step, factor)
        assert pace.deadline(0) == pytest.approx(100.0 + period)
        assert pace.due(0, pace.deadline(0)) == steps


def test_a_delay_is_caught_up_and_counted_and_what_is_too_long_is_dropped():
    pace = pace_of(0.001)
    assert pace.due(0, 100.0501) == 50
    assert (pace.overruns, pace.dropped_steps) == (1, 0)
    assert pace.report() == 'no sim time was lost (1 late ticks)'
    assert pace.due(50, 100.0504) == 0
    assert pace.deadline(50) == pytest.approx(100.051)
    pace = pace_of(0.001, limit=0.1)
    assert pace.due(0, 102.0) == 100
    assert pace.dropped_steps == 1900
    assert pace.report() == (
        '1.9 s of sim time were lost to delays beyond catch_up_limit (1 late ticks)')
    # Sim time now lags wall time by the dropped time, and goes on at its pace.
    assert pace.due(100, 102.001) == 1
    assert pace.due(101, 103.001) == 100 and pace.dropped_steps == 1900 + 900
    # Nothing is counted where time waits for others.
    pace = Pace(0.001, waits=True)
    pace.set(1.0, 0.1, 0, 100.0)
    assert pace.due(0, 102.0) == 100 and pace.due(100, 102.001) == 1
    assert (pace.overruns, pace.dropped_steps) == (0, 0)


def test_looking_for_a_command_lengthens_a_wait_by_a_fiftieth_at_most_and_costs_little():
    gate, now, looks = Gate(1, 1.0), 100.0, 0
    while now < 110.0:
        gate.look(0, now, False, lambda: True)
        assert gate.waiting
        look = gate.poll(now)
        assert look <= max(1e-4, 0.02 * (now - 100.0))
        now, looks = now + look, looks + 1
    assert looks < 1300  # of some 10 us each


def test_a_new_limit_alone_keeps_the_deadlines():
    pace = pace_of(0.001)
    pace.set(1.0, 0.5, 0, 100.0007)
    assert pace.due(0, 100.001) == 1
    pace.set(2.0, 0.5, 1, 100.0017)
    assert pace.due(1, 100.0027) == 2
    assert pace_of(0.001, factor=0.0).free and not pace.free


EXAMPLE = Path(__file__).resolve().parents[2] / 'example'
sys.path.append(str(EXAMPLE))
SCENE, DURATION = EXAMPLE / 'slew.yaml', 0.2


@contextmanager
def controller(name):
    """Run a controller in a separate process; kill it at the end."""
    process = subprocess.Popen([sys.executable, EXAMPLE / f'{name}.py'], stdout=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def hinder(node, process):
    """Stop node and controller in turn for 10 ms, like a busy machine, until the node ends."""
    while node.runs():
        for each in (process.send_signal, node.send):
            each(signal.SIGSTOP)
            time.sleep(0.01)
            each(signal.SIGCONT)
            time.sleep(0.01)


@pytest.mark.parametrize('name, busy', [('lqr', True), ('mppi', False)])
def test_a_controlled_run_has_the_bits_of_a_loop_also_on_a_busy_machine(start, name, busy):
    """The loop runs the same controller without ROS, with a stroke of 1 N s on the tip."""
    from loop import in_a_loop
    from lqr import LQR
    from mppi import LIMIT, MPPI
    stroke = {'load.tip_force_y.piecewise.time': [0.1, 0.15],
              'load.tip_force_y.piecewise.value': [20.0, 0.0]}
    limit = {'motor.torque_limit': LIMIT} if name == 'mppi' else {}
    known = timo_sim.load_scene(SCENE, limit)
    node = start('--params-file', str(SCENE), duration=DURATION, real_time_factor=0.0,
                 sync_timeout=PATIENCE, **stroke, **limit)
    with controller(name) as process:
        if busy:
            hinder(node, process)
        assert node.wait()[0] == 0
    recording = Recording(node.log)
    assert np.array_equal(recording.topics['~/joint_command'].step, np.arange(0, 200, 2))
    assert recording.summary['missed_commands'] == 0
    replayed(node.log)
    record = in_a_loop(known.vary(stroke), {'lqr': LQR, 'mppi': MPPI}[name](known), DURATION)
    assert np.array_equal(recording.topics['joint_states'].values, record[:, 1:10])
    assert np.array_equal(recording.topics['~/tip_deflection'].values, record[:, 10:])


def test_an_example_answers_a_state_once(ros):
    """The node publishes the first state more than once."""
    from lock_step import LockStep
    from pd import PD, turn
    node = LockStep(PD(turn))
    sent = []
    node.publisher = SimpleNamespace(publish=sent.append, get_subscription_count=lambda: 1)
    parts = (JointState(position=[0.0]), JointState(position=[0.0]),
             JointState(position=[0.0] * 3, velocity=[0.0] * 3, effort=[0.0] * 3),
             Vector3Stamped())
    for moment in (1, 1, 2000000, 1):
        for place, message in enumerate(parts):
            message.header.stamp.nanosec = moment
            node.arrive(place, message)
        sent.append(None)
    node.destroy_node()
    assert [message is not None for message in sent] == [True, False, False, True, False, False]


def test_a_wait_ends_after_its_time_and_is_counted(start, client):
    """The controller answers the first state only; commands with a wrong stamp are dropped."""
    node = start(sync='wait', sync_period=0.1, sync_timeout=0.05, duration=1.0)
    states = client.collect(JointState, '/joint_states')
    command = client.command(JointState, '/timo_sim/joint_command')
    client.wait(lambda: len(states) > 1, 'the first state, twice')
    assert {*map(nanoseconds, states)} == {1}
    late = JointState(name=['shaft'], effort=[5.0])
    late.header.stamp.sec = 7
    command.publish(late)
    client.wait(lambda: len(states) > 3, 'the state again: a wrong stamp is no answer')
    assert nanoseconds(states[-1]) == 1
    torque = client.command(Float64, '/timo_sim/motor_torque')
    shown, sent = len(states), []

    def begins():  # a command whenever the state comes again, at most 9 for the 10 periods
        begun = nanoseconds(states[-1]) > 1
        if not begun and len(sent) < min(9, len(states) - shown + 1):
            sent.append(torque.publish(Float64(data=1.0)))
        return begun
    client.wait(begins, 'the run')
    code, output = node.wait()
    assert code == 0 and output.count('copy the stamp of joint_states') == 1
    summary = Recording(node.log).summary
    assert 1 <= summary['missed_commands'] <= 9
    shown = '\n'.join(info(node.log))
    for name in ('missed_commands', 'mismatched_commands', 'dropped_time_s'):
        assert f' {name} {summary[name]}' in shown


def test_time_stands_when_the_controller_of_lock_step_has_left(start, client):
    """There is a warning and no dropped time; the next controller gets the state and goes on."""
    node = start(sync='wait', sync_period=0.005, sync_timeout=0.05)
    states = client.collect(JointState, '/joint_states')
    health = client.collect(DiagnosticArray, '/diagnostics')

    def control(until):
        torque = client.command(Float64, '/timo_sim/motor_torque')

        def reached():
            torque.publish(Float64(data=0.1))
            return states and nanoseconds(states[-1]) >= until
        client.wait(reached, f'the state at {until} ns')
        client.destroy_publisher(torque)

    def stands():
        told = len(health)
        client.wait(lambda: len(health) > told and (
            health[-1].status[0].message.startswith('waiting for a command')), 'that it waits')
        shown = len(states)
        client.wait(lambda: len(states) > shown, 'the state, again')
        return nanoseconds(states[-1])

    assert stands() == 1
    control(20000000)
    left = stands()
    assert stands() == left
    control(left + 20000000)
    code, output = node.end()
    assert code == 0
    assert output.count('nobody publishes commands any more') in (1, 2)  # it may end at once
    recording = Recording(node.log)
    assert recording.summary['overruns'] == 0 and recording.summary['dropped_time_s'] == 0.0
    # Repeated states are not logged again.
    assert set(np.diff(recording.topics['joint_states'].step)) == {5}


def test_a_controller_that_waits_for_time_is_told_so(start, client):
    """A timer on sim time sends nothing before /clock goes on; without a publisher it is quiet."""
    node = start(sync='wait', record=False, publish_clock=True)
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: len(health) > 6, 'longer than a controller is waited for')
    assert {message.status[0].message for message in health} == {'waiting for a command'}
    timed = rclpy.create_node('timed', namespace='/timed', parameter_overrides=[
        Parameter('use_sim_time', value=True)])
    torque = timed.create_publisher(Float64, '/timo_sim/motor_torque', 10)
    timed.create_timer(0.002, lambda: torque.publish(Float64(data=1.0)))
    executor = SingleThreadedExecutor()
    executor.add_node(timed)

    def told():
        executor.spin_once(timeout_sec=0.01)
        return health and 'never begins' in health[-1].status[0].message
    client.wait(told, 'the remedy')
    timed.destroy_node()
    code, output = node.end()
    assert code == 0 and output.count('never begins') == 1


def test_the_latest_message_sets_an_input(start, client):
    """A message changes the inputs that it names; the others keep their values."""
    node = start(command_timeout=0.0)
    states = client.collect(JointState, '/joint_states')
    publishers = {
        kind: client.command(kind_type, f'/timo_sim/{kind}') for kind, kind_type in (
            ('carrier_wrench', WrenchStamped), ('motor_torque', Float64),
            ('tip_wrench', WrenchStamped), ('joint_command', JointState),
            ('commands', Float64MultiArray))}

    def acts_on(kind, message, effort):
        def acts():
            publishers[kind].publish(message)
            return states and states[-1].effort.tolist() == effort
        client.wait(acts, f'{effort} after {kind}')

    push, joints = WrenchStamped(), ['carrier_x', 'carrier_y', 'shaft']
    push.wrench.force.x = 3.0
    acts_on('carrier_wrench', push, [3.0, 0.0, 0.0])
    acts_on('motor_torque', Float64(data=1.0), [3.0, 0.0, 1.0])
    acts_on('joint_command', JointState(name=['shaft'], effort=[2.0]), [3.0, 0.0, 2.0])
    acts_on('joint_command', JointState(name=['carrier_y'], effort=[4.0]), [0.0, 4.0, 2.0])
    # NaN is a joint that no controller has claimed; `elbow` is a joint of another robot.
    acts_on('joint_command', JointState(name=joints, effort=[nan, nan, 2.5]), [0.0, 4.0, 2.5])
    acts_on('joint_command', JointState(name=joints, effort=[1.5, nan, nan]), [1.5, 4.0, 2.5])
    acts_on('joint_command', JointState(name=['elbow', 'carrier_y'], effort=[inf, 4.0]),
            [0.0, 4.0, 2.5])
    acts_on('motor_torque', Float64(data=-1.0), [0.0, 4.0, -1.0])
    publishers['tip_wrench'].publish(push)  # replayed below
    publishers['commands'].publish(Float64MultiArray(data=[1.0, 2.0]))
    for message in (JointState(name=joints, effort=[1.0]), JointState(name=['shaft']),
                    JointState(name=['shaft', 'shaft'], effort=[1.0, 2.0]),
                    JointState(name=['shaft'], effort=[inf])):
        publishers['joint_command'].publish(message)
    acts_on('motor_torque', Float64(data=0.5), [0.0, 4.0, 0.5])
    acts_on('commands', Float64MultiArray(data=[1.0, 2.0, 3.0]), [1.0, 2.0, 3.0])
    publishers['joint_command'].publish(JointState(name=['shaft_rad'], effort=[1.0]))
    acts_on('commands', Float64MultiArray(data=[4.0, 5.0, 6.0]), [4.0, 5.0, 6.0])
    code, output = node.end()
    assert code == 0 and "no effect: 'shaft_rad' is none of ('carrier_x'," in output
    recording = Recording(node.log)
    assert recording.summary['refused_commands'] == 5
    assert recording.topics['~/tip_wrench'].values.tolist() == [[3.0, *6 * [0.0]]]
    assert np.isnan(recording.topics['~/joint_command'].values).any()
    replayed(node.log)


def answer(kind, value, stamp=None):
    """Return a command of a kind that answers the state with a stamp."""
    if kind == 'commands':
        return Float64MultiArray(data=[0.0, 0.0, value])
    message = JointState(name=['shaft'], effort=[value]) if kind == 'joint_command' else (
        WrenchStamped())
    if kind != 'joint_command':
        message.wrench.force.x = value
    if stamp is not None:
        message.header.stamp = stamp
    return message


def test_a_second_answer_to_the_first_state_does_not_answer_the_next(start, client):
    """Neither at the start nor after a reset, when another state has the same sim time."""
    node = start(sync='wait', sync_period=0.01, sync_timeout=PATIENCE, real_time_factor=0.0)
    states = client.collect(JointState, '/joint_states')
    publisher = client.command(JointState, '/timo_sim/joint_command')

    def follow(value, least):
        """Answer the present state until one of at least a time has come; return its stamp."""
        stamp = states[-1].header.stamp

        def followed():
            publisher.publish(answer('joint_command', value, stamp))
            return nanoseconds(states[-1]) >= least
        client.wait(followed, f'the state at {least} ns')
        return stamp

    def stands():
        before = nanoseconds(states[-1])
        time.sleep(0.1)
        return nanoseconds(states[-1]) == before

    client.wait(lambda: states, 'the first state')
    first = follow(1.0, 10000000)
    publisher.publish(answer('joint_command', 5.0, first))
    assert stands()
    second = follow(2.0, 20000000)
    reset = client.service(Trigger, '/timo_sim/reset')
    for _ in range(2):
        shown = states[-1].header.stamp
        assert reset().success
        client.wait(lambda: states[-1].header.stamp != shown, 'the state after the reset')
        for late in (first, second, shown):
            publisher.publish(answer('joint_command', 5.0, late))
        assert stands()
    follow(3.0, 30000000)
    assert node.end()[0] == 0
    recording = Recording(node.log)
    series = recording.topics['~/joint_command']
    assert series.step.tolist() == [0, 10, 20]
    assert np.nanmax(series.values, axis=1).tolist() == [1.0, 2.0, 3.0]
    # Times in the log are exact, without the nanosecond of the stamps.
    assert set(recording.topics['joint_states'].ns.tolist()) == {0, 10000000, 20000000, 30000000}
    replayed(node.log)
