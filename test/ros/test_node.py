# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node over DDS: topics, services, refused and stale commands, parameters, diagnostics."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3Stamped, WrenchStamped
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

import timo_sim
from timo_sim.scene.parameters import RATES


def seconds(stamp):
    """Return a builtin_interfaces/Time in seconds."""
    return stamp.sec + 1e-9 * stamp.nanosec


def values(status):
    """Return the key-value pairs of a diagnostic status."""
    return {pair.key: pair.value for pair in status.values}


def test_topics_carry_the_physics(start, client, paper):
    node = start('--params-file', str(paper), record=False)
    joints = client.collect(JointState, '/joint_states')
    modes = client.collect(JointState, '/timo_sim/modal_state')
    deflections = client.collect(Vector3Stamped, '/timo_sim/tip_deflection')
    tips = client.collect(PoseStamped, '/timo_sim/tip_pose')
    carriers = client.collect(PoseStamped, '/timo_sim/carrier_pose')
    for received in (joints, modes, deflections, tips, carriers):
        client.wait(lambda: len(received) >= 100, 'a second of messages')
    assert node.end()[0] == 0

    last = seconds(joints[-1].header.stamp)
    run = timo_sim.simulate(timo_sim.load_scene(paper), round(last, 2) + 1.0, sample_every=10)

    def at(message):
        return round(seconds(message.header.stamp) * 100)

    for joint in joints:
        k = at(joint)
        assert joint.name == ['carrier_x', 'carrier_y', 'shaft']
        assert np.array_equal(joint.position, run.motion[k, :3])
        assert np.array_equal(joint.velocity, run.motion[k, 6:9])
        assert joint.effort == pytest.approx(
            5 * np.sin(2 * np.pi * np.array([2, 3, 4]) * run.t[k]), abs=1e-12)
    for mode in modes:
        assert mode.name == ['mode_1', 'mode_2', 'mode_3'] and not mode.effort
        assert np.array_equal(mode.position, run.q[at(mode)])
        assert np.array_equal(mode.velocity, run.qdot[at(mode)])
    across, rotation, position = run.deflection(2.0), run.rotation(2.0), run.position(2.0)
    for deflection in deflections:
        assert deflection.header.frame_id == 'arm'
        assert (deflection.vector.x, deflection.vector.y) == pytest.approx(
            across[at(deflection)], abs=1e-14)
    for tip in tips:
        k, z, w = at(tip), tip.pose.orientation.z, tip.pose.orientation.w
        assert tip.header.frame_id == 'world'
        assert (tip.pose.position.x, tip.pose.position.y) == pytest.approx(position[k], abs=1e-14)
        assert 2 * np.arctan2(z, w) == pytest.approx(run.shaft[k] + rotation[k], abs=1e-14)
    for carrier in carriers:
        place = carrier.pose.position
        assert (place.x, place.y) == tuple(run.carrier[at(carrier)])
        assert carrier.pose.orientation.w == 1.0
    stamps = [at(joint) for joint in joints]
    assert stamps == list(range(stamps[0], stamps[0] + len(stamps)))


def test_nodes_in_namespaces_are_separate(start, client):
    for name, angle in (('left', 0.25), ('right', 0.5)):
        start('-r', f'__ns:=/{name}', record=False, **{'initial.shaft': angle})
    left = client.collect(JointState, '/left/joint_states')
    right = client.collect(JointState, '/right/joint_states')
    client.command(Float64, '/right/timo_sim/motor_torque').publish(Float64(data=1.0))
    client.wait(lambda: left and right and right[-1].effort[2] == 1.0, 'both nodes')
    assert {state.position[2] for state in left} == {0.25}
    assert all(state.position[2] >= 0.5 for state in right)


def test_pause_step_and_reset(start, client):
    start(start_paused=True, steps_per_call=10, record=False, **{'initial.shaft_velocity': 1.0})
    states = client.collect(JointState, '/joint_states')
    pause = client.service(SetBool, '/timo_sim/pause')
    reset = client.service(Trigger, '/timo_sim/reset')
    step = client.service(Trigger, '/timo_sim/step')

    assert step().message == 'at step 10' and step().message == 'at step 20'
    assert pause(data=False).success
    client.wait(lambda: states and seconds(states[-1].header.stamp) > 0.1, 'time going on')
    refused = step()
    assert not refused.success and 'paused' in refused.message
    assert pause(data=True).success
    steps = int(step().message.removeprefix('at step '))
    assert int(step().message.removeprefix('at step ')) == steps + 10

    del states[:]
    assert reset().message == f'reset at step {steps + 10}'
    # The state before the reset may come once more.
    client.wait(lambda: states and states[-1].position[2] == np.pi / 4, 'the state then')
    # The state is the initial one, and the clock goes on.
    assert states[-1].position.tolist() == pytest.approx([0.0, 0.0, np.pi / 4], abs=1e-15)
    assert states[-1].velocity.tolist() == pytest.approx([0.0, 0.0, 1.0], abs=1e-14)
    assert round(seconds(states[-1].header.stamp) * 1000) == steps + 10


def test_bad_commands_are_refused_counted_and_change_nothing(start, client):
    node = start(record=False)
    states = client.collect(JointState, '/joint_states')
    health = client.collect(DiagnosticArray, '/diagnostics')
    wrench = client.command(WrenchStamped, '/timo_sim/carrier_wrench')
    torque = client.command(Float64, '/timo_sim/motor_torque')
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
    client.wait(lambda: health and values(health[-1].status[0])['refused_commands'] == '5',
                'five refused commands')
    assert health[-1].status[0].level == DiagnosticStatus.WARN
    assert all(state.effort.tolist() == [0.0, 0.0, 0.5] for state in states[begun:])
    code, output = node.end()
    assert code == 0
    assert 'data must be finite, got nan' in output
    # Warnings are throttled: there is one for each topic.
    assert output.count('command refused') == 2


@pytest.mark.parametrize('topic, torque', [('carrier_wrench', 1.0), ('tip_wrench', 0.0)])
def test_parts_of_a_wrench_without_effect_are_noticed_once(start, client, topic, torque):
    node = start(record=False)
    states = client.collect(JointState, '/joint_states')
    wrench, motor = (client.command(kind, f'/timo_sim/{name}') for kind, name in (
        (WrenchStamped, topic), (Float64, 'motor_torque')))

    def send(number):  # the torque on the motor shows that both have come
        def acts():
            wrench.publish(message)
            motor.publish(Float64(data=float(number)))
            return states and states[-1].effort[2] == number
        client.wait(acts, 'a command')

    message = WrenchStamped()
    message.wrench.torque.z = 1.0 - torque  # of the tip's wrench it acts
    send(1)
    message.wrench.force.z, message.wrench.torque.z = 0.5, 1.0
    for number in 2, 3:
        send(number)
    code, output = node.end()
    assert code == 0 and output.count('no effect') == 1
    assert f'no effect of {"force.z, torque.z" if torque else "force.z"}: ' in output


def test_a_second_node_of_the_same_name_is_noticed(start, client):
    """Also without /clock; the two have different energies."""
    *twins, other = (
        start('-r', f'__ns:={namespace}', record=False, **{'initial.shaft_velocity': speed})
        for namespace, speed in (('/twice', 0.0), ('/twice', 1.0), ('/once', 2.0)))
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: len({values(message.status[0])['energy_J'] for message in health
                             if 'another node' in message.status[0].message}) == 2, 'warnings')
    assert all(message.status[0].name == 'twice/timo_sim: simulation' for message in health
               if 'another node' in message.status[0].message)
    for node in twins:
        assert node.end()[1].count('another node is called /twice/timo_sim') == 1
    assert 'another node' not in other.end()[1]


def test_commands_go_stale(start, client):
    node = start(record=False, command_timeout=0.2)
    states = client.collect(JointState, '/joint_states')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    torque.publish(Float64(data=0.5))
    client.wait(lambda: any(state.effort[2] == 0.5 for state in states), 'the torque acting')
    client.wait(lambda: states[-1].effort[2] == 0.0, 'the torque falling to zero')
    acted = [state for state in states if state.effort[2] == 0.5]
    span = seconds(acted[-1].header.stamp) - seconds(acted[0].header.stamp)
    assert 0.18 <= span <= 0.2  # sampled every 10 ms
    code, output = node.end()
    assert code == 0 and output.count('the shaft input falls to zero') == 1


def test_parameters_at_run_time(start, client):
    start(record=False)
    states = client.collect(JointState, '/joint_states')
    set_parameters = client.service(SetParameters, '/timo_sim/set_parameters')

    def set_one(name, value):
        parameter = Parameter(name, value=value).to_parameter_msg()
        return set_parameters(parameters=[parameter]).results[0]

    assert set_one('rate.joint_states', 500).successful  # a whole number for a float
    client.wait(lambda: len(states) > 1 and seconds(states[-1].header.stamp)
                - seconds(states[-2].header.stamp) == pytest.approx(0.002), 'the new rate')
    refused = set_one('rate.joint_states', 300.0)
    assert not refused.successful and 'the ratio is 3.33333' in refused.reason
    for name, value in (('command_timeout', -1.0), ('command_timeout', float('nan')),
                        ('steps_per_call', 0), ('real_time_factor', 'fast')):
        assert not set_one(name, value).successful
    refused = set_one('arm.length', 3.0)
    assert not refused.successful and 'read-only' in refused.reason
    assert set_one('real_time_factor', 5.0).successful

    describe = client.service(DescribeParameters, '/timo_sim/describe_parameters')
    length, modes, loads = describe(
        names=['arm.length', 'model.modes', 'load.torque.table.time']).descriptors
    assert length.read_only and 'length of the arm [m]' in length.description
    assert length.floating_point_range[0].from_value == 0.0
    assert (modes.integer_range[0].from_value, modes.integer_range[0].to_value) == (0, 40)
    assert loads.type == ParameterType.PARAMETER_DOUBLE_ARRAY
    assert ParameterValue().type == ParameterType.PARAMETER_NOT_SET


def test_own_clock_with_use_sim_time_does_not_deadlock(start, client):
    node = start(record=False, publish_clock=True, use_sim_time=True)
    clocks = client.collect(Clock, '/clock')
    client.wait(lambda: len(clocks) > 50, 'the clock')
    assert node.end()[0] == 0
    steps = np.diff([round(seconds(clock.clock) * 100) for clock in clocks])
    assert np.all(steps == 1)


def test_a_free_run_drops_nothing(start):
    code, output = start(real_time_factor=0.0, duration=20.0).wait()
    assert code == 0
    assert 'simulated 20 s' in output and ' 0 overruns, 0 s dropped' in output


def test_a_run_without_end_ends_at_the_largest_time_of_a_stamp(start):
    rates = dict.fromkeys(RATES, 1e-6)
    code, output = start(real_time_factor=0.0, **{'integrator.step': 1000.0}, **rates).wait()
    assert code == 0 and 'simulated 2.14748e+09 s' in output and 'Traceback' not in output


def test_diagnostics_report_state_energy_and_real_time_factor(start, client):
    start(record=False, **{'initial.shaft_velocity': 1.0, 'model.modes': 0})
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: len(health) >= 2, 'diagnostics')
    status = health[-1].status[0]
    facts = values(status)
    assert status.name == 'timo_sim: simulation'
    assert facts['state'] == 'running' and facts['log'] == 'off'
    assert 0.0 < float(facts['real_time_factor']) < 1.5  # a busy machine may be late
    # The energy of a rigid arm that turns about its root is constant.
    scene = timo_sim.load_scene({'model.modes': 0, 'initial.shaft_velocity': 1.0})
    assert float(facts['energy_J']) == pytest.approx(
        timo_sim.simulate(scene, 0.001).energy()[0], rel=1e-12)


def test_divergence_pauses_with_the_reason(start, client):
    node = start(real_time_factor=0.0, record=False, **{
        'integrator.step': 0.01, 'model.modes': 12, 'initial.shaft_velocity': 1e4,
        'initial.modal_rates': f'{[9.0] * 12}'})
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: health and health[-1].status[0].level == DiagnosticStatus.ERROR,
                'an error in diagnostics')
    assert 'the state diverges after t =' in health[-1].status[0].message
    refused = client.service(SetBool, '/timo_sim/pause')(data=False)
    assert not refused.success and 'reset' in refused.message
    refused = client.service(Trigger, '/timo_sim/step')()
    assert not refused.success and 'reset' in refused.message
    assert client.service(Trigger, '/timo_sim/reset')().success
    assert node.end()[0] == 0


def test_a_shaft_too_fast_for_its_formulation_is_a_warning(start, client):
    node = start(record=False, **{'model.formulation': 'newton', 'initial.shaft_velocity': 12.0})
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: health and health[-1].status[0].level == DiagnosticStatus.WARN,
                'a warning in diagnostics')
    assert 'faster than 11.8 rad/s' in health[-1].status[0].message
    assert 'take model.formulation exact' in node.end()[1]


def test_a_driven_shaft_and_a_held_carrier_do_as_told(start, client, spin_up):
    start('--params-file', str(spin_up), real_time_factor=0.0, duration=1.0, start_paused=True,
          record=False)
    states = client.collect(JointState, '/joint_states')
    client.service(SetBool, '/timo_sim/pause')(data=False)
    client.wait(lambda: states and states[-1].header.stamp.sec == 1, 'the last joint state')
    assert list(states[-1].position)[:2] == [0.0, 0.0]
    assert states[-1].position[2] == pytest.approx(0.002907277335, abs=1e-11)
    assert states[-1].velocity[2] == pytest.approx(0.011595116307, abs=1e-11)
