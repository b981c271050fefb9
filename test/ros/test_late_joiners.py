# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Subscribers that join while time stands get the present state; the log has it once."""

import time

from geometry_msgs.msg import PoseStamped
import numpy as np
from ros_process import PATIENCE
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

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
