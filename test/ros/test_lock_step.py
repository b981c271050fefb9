# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A client steps the node over DDS and gets the motion of `simulate` to the last bit."""

from geometry_msgs.msg import Vector3Stamped, WrenchStamped
from mcap_ros2.reader import read_ros2_messages
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

import timo_sim


def stamp(message):
    """Return the time of a message [s]."""
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def once(messages):
    """Return the last message of each stamp, in the order of their times."""
    return list({stamp(message): message for message in messages}.values())


class LockStep:
    """Steps a paused node; its publishers are known to be connected."""

    def __init__(self, client, h=0.001):
        self.client, self.h = client, h
        self._received = (client.collect(JointState, '/joint_states'),
                          client.collect(Vector3Stamped, '/timo_sim/tip_deflection'))
        self.wrench = client.command(WrenchStamped, '/timo_sim/carrier_wrench')
        self.torque = client.command(Float64, '/timo_sim/motor_torque')
        self.call_step = client.service(Trigger, '/timo_sim/step')
        # A publisher discovers its subscriber before the reverse: step until commands arrive.
        effort = None
        while effort != [1.0, 0.0, 2.0]:
            self.push(x=1.0)
            self.turn(2.0)
            self.step()
            effort = self._received[0][-1].effort.tolist()
        assert client.service(Trigger, '/timo_sim/reset')().success
        self.first = round(stamp(self.states[-1]) / h)

    @property
    def states(self):
        """Each state once; new subscribers get it again if the next step comes late."""
        return once(self._received[0])

    @property
    def tips(self):
        """Each deflection of the tip once."""
        return once(self._received[1])

    def push(self, x=0.0, y=0.0, frame=''):
        """Command a force on the carrier."""
        message = WrenchStamped()
        message.header.frame_id = frame
        message.wrench.force.x, message.wrench.force.y = x, y
        self.wrench.publish(message)

    def turn(self, torque):
        """Command a torque on the shaft."""
        self.torque.publish(Float64(data=torque))

    def step(self):
        """Let the node do its steps, and wait for the state after them."""
        response = self.call_step()
        assert response.success
        step = int(response.message.removeprefix('at step '))
        for received in self._received:
            self.client.wait(lambda: received and round(stamp(received[-1]) / self.h) == step,
                             'the state after a step')


def test_constant_force_gives_momentum_force_times_time(start, client):
    node = start(start_paused=True, steps_per_call=10)
    stepper = LockStep(client)
    stepper.push(x=4.0, y=-1.0)
    for _ in range(50):
        stepper.step()
    assert node.end()[0] == 0

    scene = timo_sim.load_scene({
        'load.force_x.piecewise.time': [0.0], 'load.force_x.piecewise.value': [4.0],
        'load.force_y.piecewise.time': [0.0], 'load.force_y.piecewise.value': [-1.0]})
    run = timo_sim.simulate(scene, 0.5, sample_every=10)
    momentum = run.momentum()[:, :2]
    assert np.abs(momentum - np.outer(run.t, [4.0, -1.0])).max() < 1e-12
    # The client received that run, to the last bit.
    states = stepper.states[-50:]
    assert [state.effort.tolist() for state in states] == [[4.0, -1.0, 0.0]] * 50
    assert np.array_equal([state.position for state in states],
                          np.column_stack([run.carrier, run.shaft])[1:])
    assert np.array_equal([state.velocity for state in states],
                          np.column_stack([run.carrier_velocity, run.shaft_velocity])[1:])
    # Deflections of one and of many samples are summed in different order.
    tips = [[tip.vector.x, tip.vector.y] for tip in stepper.tips[-50:]]
    assert np.abs(tips - run.deflection(2.0)[1:]).max() < 1e-15


def test_paper_loads_from_a_client_give_the_finite_element_reference(start, client, reference):
    """Steps hold the load of their middle: the error is (8 pi h)^2 / 24 of the motion."""
    h = 0.005
    node = start(start_paused=True, **{
        'integrator.step': h, 'model.modes': 5, 'rate.joint_states': 200.0,
        'rate.tip_deflection': 200.0})
    stepper = LockStep(client, h)
    middle = (np.arange(2000) + 0.5) * h
    commands = 5.0 * np.sin(np.pi * np.outer(middle, [4.0, 6.0, 8.0]))
    for x, y, torque in commands:
        stepper.push(x, y)
        stepper.turn(torque)
        stepper.step()
    assert node.end()[0] == 0

    tips, states = stepper.tips[-2000:], stepper.states[-2000:]
    assert round(stamp(tips[-1]) / h) == stepper.first + 2000
    # On a busy machine a service call may overtake a message: some commands act a step later.
    applied = np.array([state.effort for state in states])
    assert np.mean(np.all(applied == commands, axis=1)) > 0.95
    # The applied loads give this motion, to the last bit.
    times = (np.arange(2000) * h).tolist()
    scene = timo_sim.load_scene({'model.modes': 5, 'integrator.step': h, **{
        f'load.{channel}.piecewise.{key}': values
        for channel, column in zip(('force_x', 'force_y', 'torque'), applied.T)
        for key, values in (('time', times), ('value', column.tolist()))}})
    run = timo_sim.simulate(scene, 10.0)
    assert np.array_equal([state.position for state in states],
                          np.column_stack([run.carrier, run.shaft])[1:])
    # Held loads cause errors of 0.7e-4 m and 1.4e-4 rad; each late command adds about 1e-4.
    late = 1.0 + np.count_nonzero(np.any(applied != commands, axis=1))
    across = np.array([tip.vector.y for tip in tips])[1::2]
    assert np.abs(across - reference['w_l_m'][1:]).max() < 2e-4 * late
    theta = np.array([state.position[2] for state in states])[1::2]
    assert np.abs(theta - reference['theta_rad'][1:]).max() < 2e-4 * late


def test_forces_in_the_arm_frame_turn_with_the_shaft(start, client):
    node = start(start_paused=True, steps_per_call=10, **{
        'initial.shaft': 0.5, 'initial.shaft_velocity': 3.0, 'model.modes': 0})
    stepper = LockStep(client)
    stepper.push(x=2.0, y=1.0, frame='arm')
    for _ in range(20):
        stepper.step()
    assert node.end()[0] == 0
    for state in stepper.states[-20:]:
        c, s = np.cos(state.position[2]), np.sin(state.position[2])
        assert np.allclose(state.effort, [2 * c - s, 2 * s + c, 0.0], rtol=0, atol=1e-14)


def test_commands_are_logged_with_the_step_at_which_they_act(start, client):
    node = start(start_paused=True, steps_per_call=10)
    stepper = LockStep(client)
    stepper.step()
    stepper.turn(1.5)
    stepper.step()
    stepper.push(x=2.0)
    stepper.turn(-1.0)
    stepper.step()
    assert node.end()[0] == 0

    commands = [(message.channel.topic, message.sequence_count, message.log_time_ns)
                for message in read_ros2_messages(str(node.log))
                if message.channel.topic.endswith(('torque', 'wrench'))]
    first = stepper.first
    assert [command for command in commands if command[1] > first] == [
        ('/timo_sim/motor_torque', first + 10, (first + 10) * 1000000),
        ('/timo_sim/carrier_wrench', first + 20, (first + 20) * 1000000),
        ('/timo_sim/motor_torque', first + 20, (first + 20) * 1000000)]
