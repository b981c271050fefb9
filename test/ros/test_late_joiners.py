# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Subscribers get the state at which time stands; the log has it once, or not at all."""

import time

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from mcap.reader import NonSeekingReader
import numpy as np
import pytest
from ros_process import PATIENCE
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

import timo_sim
from timo_sim.log.recording import Recording
from timo_sim.ros.topics import Outlet


def nanoseconds(message):
    """Return the sim time of a message [ns]."""
    stamp = message.clock if isinstance(message, Clock) else message.header.stamp
    return 10**9 * stamp.sec + stamp.nanosec


def shown(client, message_type, topic):
    """Subscribe to a topic; return the list of its messages as soon as some have come."""
    messages = client.collect(message_type, topic)
    client.wait(lambda: len(messages) > 1, f'{topic}, again')
    return messages


def test_a_paused_node_shows_its_state(start, client):
    node = start(start_paused=True, steps_per_call=7, publish_clock=True, publish_arm_shape=True,
                 **{'initial.shaft_velocity': 1.0})
    step = client.service(Trigger, '/timo_sim/step')
    assert step().message == 'at step 7'
    for kind, topic in ((Clock, '/clock'), (Marker, '/timo_sim/arm_shape'),
                        (PoseStamped, '/timo_sim/tip_pose'), (JointState, '/timo_sim/encoder')):
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
    steps = [int(step().message.removeprefix('at step ')) for _ in range(20)]
    assert steps == [*range(7, 141, 7)]
    for paused in False, True:
        assert pause(data=paused).success
    last = int(step().message.removeprefix('at step '))
    steps += [last - 7, last]
    for topic, messages in received.items():
        client.wait(lambda: nanoseconds(messages[-1]) == 1000000 * steps[-1], f'the last {topic}')
        assert {1000000 * number for number in steps} <= {*map(nanoseconds, messages)}
    assert node.end()[0] == 0
    recording = Recording(node.log)
    deflections = recording.topics['~/tip_deflection']
    for name in '/clock', 'joint_states', '~/tip_deflection':
        assert recording.topics[name].step.tolist() == [*range(0, steps[-1] + 1, 10)]
    if watched:  # the states between the marks are those of the run
        run = timo_sim.simulate({'initial.modal_rates': [0.1, 0.0, 0.0]}, 1e-3 * steps[-1])
        for state in received['/joint_states']:
            assert [*state.position] == run.motion[nanoseconds(state) // 1000000, :3].tolist()
    assert float(recording.summary['peak_tip_deflection_m']) == np.abs(
        deflections.values[:, 1]).max()


def test_a_state_is_repeated_only_for_new_subscribers(client):
    """A client that steps slowly gets each state once."""
    outlet = Outlet(client, 'joint_states', 'sensor_msgs/msg/JointState')
    assert not outlet.watched_anew(time.monotonic())
    client.collect(JointState, '/joint_states')
    client.wait(lambda: outlet.watched_anew(time.monotonic()), 'a subscriber')
    assert not outlet.watched_anew(time.monotonic() + 20.0)


def test_a_node_that_waits_for_its_controller_shows_its_state(start, client):
    """The controller has answered once and then takes a minute."""
    node = start(sync='wait', sync_period=0.005, sync_timeout=PATIENCE, publish_clock=True)
    torque = client.command(Float64, '/timo_sim/motor_torque')
    states = client.collect(JointState, '/joint_states')

    def answered():  # once or more often, until the node has found the publisher
        if states and nanoseconds(states[-1]) == 1:
            states.clear()
            torque.publish(Float64(data=1.0))
        return states and nanoseconds(states[-1]) > 1
    client.wait(answered, 'a later state')
    clocks = shown(client, Clock, '/clock')
    poses = shown(client, PoseStamped, '/timo_sim/tip_pose')
    client.wait(lambda: nanoseconds(clocks[-1]) == nanoseconds(poses[-1]), 'the same state')
    assert node.end()[0] == 0
    topics = Recording(node.log).topics
    for name in '/clock', 'joint_states':
        assert 1 < len(topics[name].step) < 100 and {*np.diff(topics[name].step)} == {5}
    # The clock goes on before the states come that wake the controller.
    with open(node.log, 'rb') as stream:
        order = [(message.sequence, channel.topic) for _, channel, message in NonSeekingReader(
            stream).iter_messages(log_time_order=False) if message.sequence % 5 == 0]
    firsts = dict(reversed(order))
    assert {firsts[step] for step in topics['/clock'].step} == {'/clock'}
