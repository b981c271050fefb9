# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A stand-in of ros2_control's controller manager drives the node, and leaves it."""

from pathlib import Path
from xml.etree import ElementTree

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from ros_process import facts, nanoseconds, PATIENCE, replayed
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from timo_sim.log.tables import Recording
from timo_sim.scene.files import read_sections
from timo_sim.scene.parameters import check
from timo_sim.topics.commands import COMMANDS, JOINTS
from topic_hardware import ControllerManager

ROOT = Path(__file__).resolve().parents[2]


def test_controllers_have_joints_and_interfaces_of_the_urdf_and_the_rate_of_the_node():
    block = ElementTree.parse(ROOT / 'timo_sim/scene/timo_sim.urdf').find('ros2_control')
    commands, states = ({f'{joint.get("name")}/{interface.get("name")}'
                         for joint in block.iterfind('joint')
                         for interface in joint.iterfind(f'{kind}_interface')}
                        for kind in ('command', 'state'))
    sections = read_sections(ROOT / 'hardware/config/controllers.yaml')
    effort, pid = sections['/effort_controller'], sections['/pid_controller']
    (dof,), (claimed,) = pid['dof_names'], effort['joints']
    claimed += f'/{effort["interface_name"]}'
    assert commands == {f'{joint}/effort' for joint in JOINTS}
    assert {claimed, f'{dof}/{pid["command_interface"]}'} <= commands
    assert {f'{dof}/{name}' for name in pid['reference_and_state_interfaces']} <= states
    assert [name for name in pid if name.startswith('gains') and f'.{dof}.' not in name] == []
    # generate_parameter_library refuses whole numbers for doubles.
    assert all(type(value) is not int for value in pid.values())

    node = check(sections['/timo_sim'], 'controllers.yaml')
    rate = sections['/controller_manager']['update_rate']
    assert node['rate.joint_states'] == node['rate.clock'] == rate == round(
        1.0 / node['sync_period']) and type(rate) is int
    assert 0.0 < node['command_timeout'] <= 0.5 and node['publish_clock']
    hardware = {entry.get('name'): entry.text for entry in block.iterfind('hardware/param')}
    assert hardware['joint_commands_topic'] == '/timo_sim/joint_command'
    assert '~/joint_command' in [command.name for command in COMMANDS]
    # The hardware becomes a node of this name.
    assert block.get('name').lower() != 'timo_sim'


def law(angle, speed):
    """Return the torque of a PD controller that turns the shaft to 1 rad [N m]."""
    return 20.0 * (1.0 - angle) - 12.0 * speed


def test_a_controller_manager_in_lock_step_gives_the_same_bits_twice(start, client, tmp_path):
    """Each command acts on the state from which it was computed."""
    torques = []
    for name in 'first', 'second':
        log = tmp_path / f'{name}.mcap'
        node = start(sync='any_command', sync_period=0.02, sync_timeout=PATIENCE, duration=0.6,
                     publish_clock=True, real_time_factor=0.0, record_file=str(log))
        manager = ControllerManager(client, 0.02, law)
        code, output = node.wait()
        manager.close()
        assert code == 0, output
        replayed(log)
        recording = Recording(log)
        for count in 'missed', 'mismatched', 'refused':
            assert recording.summary[f'{count}_commands'] == 0
        commands, states = recording.topics['~/joint_command'], recording.topics['joint_states']
        # The manager sends nothing until its clock has gone on, then one command each period.
        assert np.array_equal(commands.step, np.arange(commands.step[0], 600, 20))
        assert commands.step[0] >= 20
        # States are published when the node waits for a command, whatever their rate.
        assert set(states.step) == set(range(0, 601, 20))
        shown = states.values[np.searchsorted(states.step, commands.step)]
        torque = commands.values[:, 4]
        assert np.isnan(commands.values[:, :4]).all()
        assert np.array_equal(torque, [law(row[2], row[5]) for row in shown])
        torques.append(torque)
    both = min(map(len, torques))
    assert np.array_equal(torques[0][:both], torques[1][:both])


def test_a_command_that_comes_before_a_state_does_not_answer_it(start, client):
    """Each command names a foreign joint: its count shows that the command has come."""
    start(sync='any_command', sync_period=0.01, start_paused=True, steps_per_call=5, record=False)
    health = client.collect(DiagnosticArray, '/diagnostics')
    command = client.command(JointState, '/timo_sim/joint_command')
    step = client.service(Trigger, '/timo_sim/step')

    def connected():
        command.publish(JointState())
        return health and int(facts(health)['refused_commands']) > 0
    client.wait(connected, 'a command that is refused')
    for number, reached in (1, 'at step 5'), (2, 'at step 10'), (3, 'at step 15'):
        if number == 3:  # the second came at step 5
            assert step().message == 'at step 10, which waits for a command'
        command.publish(JointState(name=['shaft', 'elbow'], effort=[1.0, 1.0]))
        client.wait(lambda: facts(health)['foreign_joints'] == str(number), 'a command')
        assert step().message == reached
        assert 'foreign_joints' not in health[-1].status[0].message  # no reason for a warning


def test_a_controller_manager_beside_a_free_node(start, client):
    """Its stamps and NaN are accepted; after it has left inputs fall to zero."""
    node = start(publish_clock=True, command_timeout=0.5)
    states = client.collect(JointState, '/joint_states')
    manager = ControllerManager(client, 0.02, lambda angle, speed: 2.0)
    client.wait(lambda: states and states[-1].effort.tolist() == [0.0, 0.0, 2.0], 'its torque')
    manager.close()
    client.wait(lambda: states[-1].effort.tolist() == [0.0, 0.0, 0.0], 'the end of its torque')
    assert node.end()[0] == 0
    summary = Recording(node.log).summary
    assert summary['refused_commands'] == 0 and summary['stale_commands'] >= 1


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
