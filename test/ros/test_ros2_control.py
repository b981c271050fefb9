# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A controller manager with the plugin JointStateTopicSystem, and what is when it leaves."""

import math

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from timo_sim.log.recording import Recording
from timo_sim.replay.replay import replay

JOINTS = ['carrier_x', 'carrier_y', 'shaft']


class ControllerManager:
    """
    Does what ros2_control_node does on sim time, with JointStateTopicSystem as its hardware.

    Cycle, order, messages and QoS are those of ros2_control_node.cpp of ros2_control (jazzy) and
    of joint_state_topic_hardware_interface.cpp (topic_based_hardware_interfaces): after the clock
    has started it sleeps for a period, then reads, updates and writes at each. One controller has
    claimed the shaft's effort: joints that nobody has claimed are NaN.
    """

    def __init__(self, client, period, law, threshold=-1.0):
        self._client, self._law, self._threshold = client, law, threshold
        self._period, self._until = round(1e9 * period), None
        self._latest, self._states = JointState(), dict.fromkeys(JOINTS, (0.0, 0.0, 0.0))
        self.publisher = client.create_publisher(JointState, '/timo_sim/joint_command', 1)
        self._subscriptions = [client.create_subscription(kind, topic, take, qos) for (
            kind, topic, take, qos) in (
                (JointState, '/joint_states', self._take, qos_profile_sensor_data),
                (Clock, '/clock', self._wake, qos_profile_sensor_data))]

    def _take(self, message):
        self._latest = message

    def _wake(self, message):
        now = 10**9 * message.clock.sec + message.clock.nanosec
        if self._until is None and now > 0:
            self._until = now + self._period
        elif self._until is not None and now >= self._until:
            self._until = now + self._period
            self._read()
            self._write(message.clock, [math.nan, math.nan, self._law(*self._states['shaft'][:2])])

    def _read(self):
        message = self._latest
        for name, *found in zip(message.name, message.position, message.velocity, message.effort):
            self._states[name] = [new if math.isfinite(new) else old
                                  for new, old in zip(found, self._states[name])]

    def _write(self, stamp, commands):
        if sum(abs(self._states[name][2] - command) for name, command in zip(
                JOINTS, commands)) <= self._threshold:
            return
        message = JointState(name=JOINTS, effort=commands)
        message.header.stamp = stamp
        self.publisher.publish(message)

    def close(self):
        """Leave."""
        for subscription in self._subscriptions:
            self._client.destroy_subscription(subscription)
        self._client.destroy_publisher(self.publisher)


def law(angle, speed):
    """Turn the shaft to 1 rad."""
    return 20.0 * (1.0 - angle) - 12.0 * speed


def test_a_controller_manager_in_lock_step_gives_the_same_bits_twice(start, client, tmp_path):
    """Each command acts on the state that it was made from."""
    torques = []
    for name in 'first', 'second':
        log = tmp_path / f'{name}.mcap'
        node = start(sync='any_command', sync_period=0.02, sync_timeout=60.0, duration=1.0,
                     publish_clock=True, real_time_factor=0.0, record_file=str(log))
        manager = ControllerManager(client, 0.02, law)
        code, output = node.wait()
        manager.close()
        assert code == 0, output
        recording, lines = Recording(log), []
        assert replay(log, show=lines.append), lines
        for count in 'missed', 'mismatched', 'refused':
            assert recording.summary[f'{count}_commands'] == '0'
        commands, states = recording.topics['~/joint_command'], recording.topics['joint_states']
        # Until its clock has gone on it sends nothing; then one command each period.
        assert np.array_equal(commands.step, np.arange(commands.step[0], 1000, 20))
        assert commands.step[0] >= 20
        # States are shown when a command is waited for, whatever their rate.
        assert set(states.step) == set(range(0, 1001, 20))
        shown = states.values[np.searchsorted(states.step, commands.step)]
        torque = commands.values[:, 4]
        assert np.isnan(commands.values[:, :4]).all()
        assert np.array_equal(torque, [law(row[2], row[5]) for row in shown])
        torques.append(torque)
    both = min(map(len, torques))
    assert np.array_equal(torques[0][:both], torques[1][:both])


def test_a_command_that_comes_before_a_state_is_shown_is_no_answer_to_it(start, client):
    """Each is counted, so that it is known to have come."""
    start(sync='any_command', sync_period=0.01, start_paused=True, steps_per_call=5, record=False)
    health = client.collect(DiagnosticArray, '/diagnostics')
    command = client.command(JointState, '/timo_sim/joint_command')
    step = client.service(Trigger, '/timo_sim/step')

    def count(name):
        return int({pair.key: pair.value for pair in health[-1].status[0].values}[name])

    def connected():
        command.publish(JointState())
        return health and count('refused_commands') > 0
    client.wait(connected, 'a command that is refused')
    for number, reached in (1, 'at step 5'), (2, 'at step 10'), (3, 'at step 15'):
        if number == 3:  # the second came at step 5
            assert step().message == 'at step 10, which waits for a command'
        command.publish(JointState(name=['shaft', 'elbow'], effort=[1.0, 1.0]))
        client.wait(lambda: count('foreign_joints') == number, 'a command')
        assert step().message == reached
        assert 'foreign_joints' not in health[-1].status[0].message  # no reason for a warning


def test_a_controller_manager_beside_a_free_node(start, client):
    """Its stamps and NaN are no reason for a refusal; without it inputs fall to zero."""
    node = start(publish_clock=True, command_timeout=0.5)
    states = client.collect(JointState, '/joint_states')
    manager = ControllerManager(client, 0.02, lambda angle, speed: 2.0)
    client.wait(lambda: states and states[-1].effort.tolist() == [0.0, 0.0, 2.0], 'its torque')
    manager.close()
    client.wait(lambda: states[-1].effort.tolist() == [0.0, 0.0, 0.0], 'the end of its torque')
    assert node.end()[0] == 0
    summary = Recording(node.log).summary
    assert summary['refused_commands'] == '0' and int(summary['stale_commands']) >= 1


def test_time_stands_when_the_controller_of_lock_step_has_left(start, client):
    """That is said, and no loss; the next controller sees the state and goes on."""
    node = start(sync='wait', sync_period=0.005, sync_timeout=0.05)
    states = client.collect(JointState, '/joint_states')
    health = client.collect(DiagnosticArray, '/diagnostics')

    def nanoseconds():
        return 10**9 * states[-1].header.stamp.sec + states[-1].header.stamp.nanosec

    def control(until):
        torque = client.command(Float64, '/timo_sim/motor_torque')

        def reached():
            torque.publish(Float64(data=0.1))
            return states and nanoseconds() >= until
        client.wait(reached, f'the state at {until} ns')
        client.destroy_publisher(torque)

    def stands():
        told = len(health)
        client.wait(lambda: len(health) > told and (
            health[-1].status[0].message.startswith('waiting for a command')), 'that it waits')
        shown = len(states)
        client.wait(lambda: len(states) > shown, 'the state, again')
        return nanoseconds()

    assert stands() == 1
    command = client.command(JointState, '/timo_sim/joint_command')
    wrong = JointState(name=['shaft'], effort=[1.0])
    wrong.header.stamp.sec = 7

    def told():
        command.publish(wrong)
        return health[-1].status[0].message == 'waiting for a command; more mismatched_commands'
    client.wait(told, 'a warning of the wrong stamp')
    client.destroy_publisher(command)
    control(20000000)
    left = stands()
    assert stands() == left
    control(left + 20000000)
    code, output = node.end()
    assert code == 0 and output.count('need sync: any_command') == 1
    assert output.count('nobody publishes commands any more') in (1, 2)  # it may end at once
    recording = Recording(node.log)
    assert recording.summary['overruns'] == '0' and recording.summary['dropped_time_s'] == '0.0'
    # What is shown again is not logged again.
    assert set(np.diff(recording.topics['joint_states'].step)) == {5}
