# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The running node: services, refused and stale commands, diagnostics, states for latecomers."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3Stamped, WrenchStamped
import numpy as np
import pytest
from ros_process import facts, nanoseconds, shared_node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.ros.topics import Outlet
from timo_sim.scene.parameters import RATES


def reached(service):
    """Step by a service; return the step that the node has reached."""
    return int(service().message.removeprefix('at step '))


@pytest.fixture(scope='module')
def running(ros, tmp_path_factory):
    """Return node, client, states and diagnostics of a running node, apart from other nodes."""
    with shared_node(tmp_path_factory.mktemp('running'), '-r', '__ns:=/running', '-r',
                     '/diagnostics:=/running/diagnostics', record=False) as (node, client):
        yield (node, client, client.collect(JointState, '/running/joint_states'),
               client.collect(DiagnosticArray, '/running/diagnostics'))
        assert node.end()[0] == 0


def test_bad_commands_are_refused_counted_and_change_nothing(running):
    node, client, states, health = running
    wrench = client.command(WrenchStamped, '/running/timo_sim/carrier_wrench')
    torque = client.command(Float64, '/running/timo_sim/motor_torque')
    torque.publish(Float64(data=0.5))
    client.wait(lambda: states and states[-1].effort[2] == 0.5, 'the torque acting')
    begun = len(states)
    for data in (np.nan, np.inf, -np.inf):
        torque.publish(Float64(data=data))
    message = WrenchStamped()
    message.wrench.force.x = np.nan
    wrench.publish(message)
    message.wrench.force.x = 1.0
    message.header.frame_id = 'map'
    wrench.publish(message)
    client.wait(lambda: facts(health).get('refused_commands') == '5', 'five refused commands')
    assert health[-1].status[0].level == DiagnosticStatus.WARN
    assert all(state.effort.tolist() == [0.0, 0.0, 0.5] for state in states[begun:])
    assert 'data must be finite, got nan' in node.output()
    # Warnings are throttled: there is one for each topic.
    assert node.output().count('command refused') == 2


def test_parts_of_a_wrench_without_effect_are_noticed_once(running):
    node, client, states, _ = running
    motor = client.command(Float64, '/running/timo_sim/motor_torque')
    for topic, torque, words in (('carrier_wrench', 0.0, 'no effect of force.z, torque.z: '),
                                 ('tip_wrench', 1.0, 'no effect of force.z: ')):
        wrench, message = client.command(
            WrenchStamped, f'/running/timo_sim/{topic}'), WrenchStamped()

        def send(number):  # the torque on the motor shows that both have come
            def acts():
                wrench.publish(message)
                motor.publish(Float64(data=number))
                return states and states[-1].effort[2] == number
            client.wait(acts, 'a command')

        message.wrench.torque.z = torque  # of the tip's wrench it acts
        send(1.0)
        assert words not in node.output()
        message.wrench.force.z, message.wrench.torque.z = 0.5, 1.0
        send(2.0)
        send(3.0)
        client.wait(lambda: words in node.output(), 'a warning')
        assert node.output().count('no effect of') == 1 + (topic == 'tip_wrench')


def test_a_torque_by_a_topic_bends_a_bare_tip_to_the_arc_and_the_estimate_says_so(start, client):
    node = start(record=False, **{
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'arm.damping_ratio': [0.7]})
    section = timo_sim.load_scene('paper').manipulator.arm.section
    length, turn = 2.0, 0.3
    message = WrenchStamped()
    message.wrench.torque.z = turn * section.bending_stiffness / length
    wrench = client.command(WrenchStamped, '/timo_sim/tip_wrench')
    poses = client.collect(PoseStamped, '/timo_sim/tip_pose')
    health = client.collect(DiagnosticArray, '/diagnostics')
    tip = length / turn * np.array([np.sin(turn), 1.0 - np.cos(turn)])

    def off():
        at = poses[-1].pose.position
        return np.hypot(*(tip - [at.x, at.y]))

    def bent():
        wrench.publish(message)
        return poses and off() < 1e-6
    client.wait(bent, 'the arc')
    # Of the motion to it; without a static shape the tip stays 3e-3 m from the arc.
    client.wait(
        lambda: float(facts(health).get('estimated_tip_error_m', 'nan')) > 0.0, 'an estimate')
    assert float(facts(health)['estimated_tip_error_m']) < 1e-3
    assert node.end()[0] == 0


def test_commands_go_stale(start, client):
    node = start(record=False, command_timeout=0.2)
    states = client.collect(JointState, '/joint_states')
    client.wait(lambda: states, 'states')
    client.command(Float64, '/timo_sim/motor_torque').publish(Float64(data=0.5))
    client.wait(lambda: any(state.effort[2] == 0.5 for state in states), 'the torque acting')
    client.wait(lambda: states[-1].effort[2] == 0.0, 'the torque falling to zero')
    acted = [nanoseconds(state) for state in states if state.effort[2] == 0.5]
    assert 0.18e9 <= acted[-1] - acted[0] <= 0.2e9  # sampled every 10 ms
    code, output = node.end()
    assert code == 0 and output.count('the shaft input falls to zero') == 1


def test_pause_step_and_reset(start, client):
    start(start_paused=True, steps_per_call=10, record=False, **{'initial.shaft_velocity': 1.0})
    states = client.collect(JointState, '/joint_states')
    pause = client.service(SetBool, '/timo_sim/pause')
    reset = client.service(Trigger, '/timo_sim/reset')
    step = client.service(Trigger, '/timo_sim/step')

    assert step().message == 'at step 10' and step().message == 'at step 20'
    assert pause(data=False).success
    client.wait(lambda: states and nanoseconds(states[-1]) > 10**8, 'time going on')
    refused = step()
    assert not refused.success and 'paused' in refused.message
    assert pause(data=True).success
    steps = reached(step)
    assert reached(step) == steps + 10

    del states[:]
    assert reset().message == f'reset at step {steps + 10}'
    # The state before the reset may come once more.
    client.wait(lambda: states and states[-1].position[2] == np.pi / 4, 'the state then')
    # The state is the initial one, and the clock goes on.
    assert states[-1].position.tolist() == pytest.approx([0.0, 0.0, np.pi / 4], abs=1e-15)
    assert states[-1].velocity.tolist() == pytest.approx([0.0, 0.0, 1.0], abs=1e-14)
    assert nanoseconds(states[-1]) == 10**6 * (steps + 10)


def test_a_second_node_of_the_same_name_is_noticed(start, client):
    """Also without /clock."""
    *twins, other = (start('-r', f'__ns:={namespace}', record=False)
                     for namespace in ('/twice', '/twice', '/once'))
    health, words = client.collect(DiagnosticArray, '/diagnostics'), 'another node has the name '
    client.wait(lambda: all(words in node.output() for node in twins), 'warnings')
    client.wait(lambda: any(words in message.status[0].message for message in health), 'health')
    assert {message.status[0].name for message in health if words in message.status[0].message
            } == {'twice/timo_sim: simulation'}
    for node in twins:
        assert node.end()[1].count(f'{words}/twice/timo_sim') == 1
    assert words not in other.end()[1]


def test_free_runs_drop_nothing_and_end_at_the_largest_time_of_a_stamp(start):
    rates = dict.fromkeys(RATES, 1e-6)
    code, output = start(real_time_factor=0.0, duration=5.0).wait()
    assert code == 0
    assert 'simulated 5 s' in output and ' no sim time was lost' in output
    code, output = start(real_time_factor=0.0, **rates, **{
        'integrator.step': 1000.0, 'model.modes': 0, 'carrier.held': 'both'}).wait()
    assert code == 0 and 'simulated 2.14748e+09 s' in output and 'Traceback' not in output


def test_diagnostics_and_the_clock_of_a_node_that_uses_sim_time_itself(start, client):
    node = start(record=False, publish_clock=True, use_sim_time=True,
                 **{'initial.shaft_velocity': 1.0, 'model.modes': 0})
    clocks = client.collect(Clock, '/clock')
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: len(health) > 1 and len(clocks) > 50, 'diagnostics and the clock')
    status = health[-1].status[0]
    found = facts(health)
    assert status.name == 'timo_sim: simulation'
    assert found['state'] == 'running' and found['log'] == 'off'
    assert 0.0 < float(found['real_time_factor']) < 2.0  # a busy machine catches up 0.1 s
    # The energy of a rigid arm that turns about its root is constant.
    scene = timo_sim.load_scene({'model.modes': 0, 'initial.shaft_velocity': 1.0})
    assert float(found['energy_J']) == pytest.approx(
        timo_sim.simulate(scene, 0.001).energy()[0], rel=1e-12)
    assert node.end()[0] == 0
    assert np.all(np.diff([nanoseconds(clock) for clock in clocks]) == 10**7)


def test_divergence_pauses_with_the_reason_and_too_fast_a_shaft_is_a_warning(start, client):
    node = start('-r', '__ns:=/a', real_time_factor=0.0, record=False, **{
        'integrator.step': 0.01, 'initial.shaft_velocity': 1e4,
        'initial.modal_rates': f'{[9.0] * 3}'})
    fast = start('-r', '__ns:=/b', record=False, **{
        'model.formulation': 'newton', 'initial.shaft_velocity': 12.0})
    health = client.collect(DiagnosticArray, '/diagnostics')

    def said(level):
        return [message.status[0].message for message in health
                if message.status[0].level == level]
    client.wait(lambda: said(DiagnosticStatus.ERROR) and said(DiagnosticStatus.WARN), 'both')
    assert 'the state diverges after t =' in said(DiagnosticStatus.ERROR)[-1]
    refused = client.service(SetBool, '/a/timo_sim/pause')(data=False)
    assert not refused.success and 'reset' in refused.message
    refused = client.service(Trigger, '/a/timo_sim/step')()
    assert not refused.success and 'reset' in refused.message
    assert client.service(Trigger, '/a/timo_sim/reset')().success
    assert node.end()[0] == 0
    assert any('faster than 11.8 rad/s' in text for text in said(DiagnosticStatus.WARN))
    assert 'take model.formulation exact' in fast.end()[1]


def test_the_log_has_the_largest_error_of_all_runs_between_resets(start, client):
    values = {'initial.shaft_velocity': 5.0}
    node = start(start_paused=True, steps_per_call=500, **values)
    step, reset = (client.service(Trigger, f'/timo_sim/{name}') for name in ('step', 'reset'))
    assert step().success and reset().success  # from here on the error is 0 again
    assert node.end()[0] == 0
    simulator = timo_sim.EstimatingSimulator(timo_sim.load_scene(values))
    for _ in range(50):  # the node measures where it publishes, at 100 Hz
        simulator.advance(10)
    found = Recording(node.log).summary
    assert found['estimated_tip_error_m'] == float(f'{simulator.estimated_error:.3g}') > 0.0
    assert found['estimated_deflection_error_m'] == float(
        f'{simulator.estimated_deflection_error:.3g}') > 0.0


def shown(client, message_type, topic):
    """Subscribe to a topic; return the list of its messages as soon as some have come."""
    messages = client.collect(message_type, topic)
    client.wait(lambda: len(messages) > 1, f'{topic}, again')
    return messages


def test_a_paused_node_shows_its_state(start, client):
    node = start(start_paused=True, steps_per_call=7, publish_clock=True, **{
        'initial.shaft_velocity': 1.0})
    step = client.service(Trigger, '/timo_sim/step')
    assert step().message == 'at step 7'
    for kind, topic in ((Clock, '/clock'), (PoseStamped, '/timo_sim/tip_pose'),
                        (JointState, '/timo_sim/encoder')):
        messages = shown(client, kind, topic)
        assert {*map(nanoseconds, messages)} == {7000000}
    states = shown(client, JointState, '/joint_states')
    assert len({tuple(state.position) for state in states}) == 1
    assert nanoseconds(states[-1]) == 7000000 and states[-1].velocity[2] > 0.99
    assert step().message == 'at step 14'
    client.wait(lambda: nanoseconds(states[-1]) == 14000000, 'the state after a step')
    assert node.end()[0] == 0
    topics = Recording(node.log).topics
    assert topics['joint_states'].step.tolist() == topics['/clock'].step.tolist() == [0, 10]


@pytest.mark.parametrize('watched', [True, False])
def test_steps_and_a_pause_end_with_state_and_clock_and_the_log_is_the_same(
        start, client, watched):
    """Also between the marks of the rates; repeated states, 0.2 s later, are not waited for."""
    node = start(start_paused=True, steps_per_call=7, publish_clock=True, **{
        'initial.modal_rates': '[0.1, 0.0, 0.0]', 'sensor.root_strain.delay': 0.01})
    kinds = {'/joint_states': JointState, '/clock': Clock, '/timo_sim/tip_deflection':
             Vector3Stamped, '/timo_sim/encoder': JointState} if watched else {}
    received = {topic: client.collect(kind, topic) for topic, kind in kinds.items()}
    pause, step = (client.service(kind, f'/timo_sim/{name}') for kind, name in (
        (SetBool, 'pause'), (Trigger, 'step')))
    steps = [reached(step) for _ in range(20)]
    assert steps == [*range(7, 141, 7)]
    for paused in False, True:
        assert pause(data=paused).success
    last = reached(step)
    steps += [last - 7, last]
    for topic, messages in received.items():
        client.wait(lambda: nanoseconds(messages[-1]) == 1000000 * steps[-1], f'the last {topic}')
        assert {1000000 * number for number in steps} <= {*map(nanoseconds, messages)}
    assert node.end()[0] == 0
    recording = Recording(node.log)
    for name in '/clock', 'joint_states', '~/tip_deflection':
        assert recording.topics[name].step.tolist() == [*range(0, steps[-1] + 1, 10)]
    if watched:  # the states between the marks are those of the run
        run = timo_sim.simulate({'initial.modal_rates': [0.1, 0.0, 0.0]}, 1e-3 * steps[-1])
        for state in received['/joint_states']:
            assert [*state.position] == run.values[nanoseconds(state) // 1000000, :3].tolist()


def test_a_state_is_repeated_only_for_new_subscribers(client):
    """A client that steps slowly gets each state once."""
    outlet = Outlet(client, 'joint_states', 'sensor_msgs/msg/JointState')
    assert not outlet.watched_anew(time.monotonic())
    client.collect(JointState, '/joint_states')
    client.wait(lambda: outlet.watched_anew(time.monotonic()), 'a subscriber')
    assert not outlet.watched_anew(time.monotonic() + 20.0)
