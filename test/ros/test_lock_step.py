# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Steps at a call give the motion of `simulate` to the last bit; the pacing of other runs."""

from geometry_msgs.msg import Vector3Stamped, WrenchStamped
import numpy as np
import pytest
from ros_process import nanoseconds
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.ros.loop import Pace


def once(messages):
    """Return the last message of each stamp, in the order of their times."""
    return list({nanoseconds(message): message for message in messages}.values())


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
        self.first = self.step_of(self.states[-1])

    def step_of(self, message):
        """Return the step of a message."""
        return round(1e-9 * nanoseconds(message) / self.h)

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
            self.client.wait(lambda: received and self.step_of(received[-1]) == step,
                             'the state after a step')


def test_constant_force_gives_momentum_force_times_time(start, client):
    """Commands are logged with the step at which they act."""
    node = start(start_paused=True, steps_per_call=10)
    stepper = LockStep(client)
    stepper.push(x=4.0, y=-1.0)
    for _ in range(50):
        stepper.step()
    states, tips = stepper.states[-50:], stepper.tips[-50:]
    stepper.turn(1.5)
    stepper.step()
    stepper.push(x=2.0)
    stepper.turn(-1.0)
    stepper.step()
    assert node.end()[0] == 0

    first = stepper.first
    for topic, steps in (('motor_torque', [500, 510]), ('carrier_wrench', [0, 510])):
        series = Recording(node.log).topics[f'~/{topic}']
        acting = series.step >= first
        assert (series.step[acting] - first).tolist() == steps
        assert np.array_equal(series.log_ns[acting], 1000000 * series.step[acting])

    scene = timo_sim.load_scene({
        'load.force_x.piecewise.time': [0.0], 'load.force_x.piecewise.value': [4.0],
        'load.force_y.piecewise.time': [0.0], 'load.force_y.piecewise.value': [-1.0]})
    run = timo_sim.simulate(scene, 0.5, sample_every=10)
    momentum = run.momentum()[:, :2]
    assert np.abs(momentum - np.outer(run.t, [4.0, -1.0])).max() < 1e-12
    # The client received that run, to the last bit.
    assert [state.effort.tolist() for state in states] == [[4.0, -1.0, 0.0]] * 50
    assert np.array_equal([state.position for state in states],
                          np.column_stack([run.carrier, run.shaft])[1:])
    assert np.array_equal([state.velocity for state in states],
                          np.column_stack([run.carrier_velocity, run.shaft_velocity])[1:])
    # Deflections of one and of many samples are summed in different order.
    tips = [[tip.vector.x, tip.vector.y] for tip in tips]
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
    assert stepper.step_of(tips[-1]) == stepper.first + 2000
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


def test_a_command_to_a_manipulator_at_rest_acts_at_its_step(start, client):
    node = start(start_paused=True, steps_per_call=20)
    states = client.collect(JointState, '/joint_states')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    step = client.service(Trigger, '/timo_sim/step')
    acting = []
    while not acting:  # a publisher discovers its subscriber before the reverse
        torque.publish(Float64(data=2.0))
        end = int(step().message.removeprefix('at step '))
        client.wait(lambda: states and nanoseconds(states[-1]) == 1000000 * end, 'the state then')
        acting = [state for state in states if state.effort[2] == 2.0]
    for _ in range(10):
        end = int(step().message.removeprefix('at step '))
    client.wait(lambda: nanoseconds(states[-1]) == 1000000 * end, 'the last state')
    assert node.end()[0] == 0

    begin = Recording(node.log).topics['~/motor_torque'].step[0]
    assert begin % 20 == 0
    scene = timo_sim.load_scene({'load.torque.piecewise.time': [begin * 0.001],
                                 'load.torque.piecewise.value': [2.0]})
    run = timo_sim.simulate(scene, end * 0.001)
    for state in states:
        k = nanoseconds(state) // 1000000
        assert state.position.tolist() == run.motion[k, :3].tolist()
        assert state.effort.tolist() == [0.0, 0.0, 2.0 if k > begin else 0.0]


def pace_of(step, factor=1.0, limit=0.1):
    pace = Pace(step)
    pace.set(factor, limit, 0, 100.0)
    return pace


def test_every_deadline_gives_one_step_without_drift():
    pace, steps = pace_of(0.001), 0
    for tick in range(1, 100001):
        assert pace.deadline(steps) == pytest.approx(100.0 + tick * 0.001, abs=1e-9)
        assert pace.due(steps, pace.deadline(steps)) == 1
        steps += 1
    assert (pace.overruns, pace.dropped_steps) == (0, 0)


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
    assert pace.due(50, 100.0504) == 0
    assert pace.deadline(50) == pytest.approx(100.051)
    pace = pace_of(0.001, limit=0.1)
    assert pace.due(0, 102.0) == 100
    assert pace.dropped_steps == 1900
    # Sim time now lags wall time by the dropped time, and goes on at its pace.
    assert pace.due(100, 102.001) == 1
    assert pace.due(101, 103.001) == 100 and pace.dropped_steps == 1900 + 900
    # Nothing is counted where time waits for others.
    pace = Pace(0.001, waits=True)
    pace.set(1.0, 0.1, 0, 100.0)
    assert pace.due(0, 102.0) == 100 and pace.due(100, 102.001) == 1
    assert (pace.overruns, pace.dropped_steps) == (0, 0)


def test_a_new_limit_alone_keeps_the_deadlines():
    pace = pace_of(0.001)
    pace.set(1.0, 0.5, 0, 100.0007)
    assert pace.due(0, 100.001) == 1
    pace.set(2.0, 0.5, 1, 100.0017)
    assert pace.due(1, 100.0027) == 2
    assert pace_of(0.001, factor=0.0).free and not pace.free
