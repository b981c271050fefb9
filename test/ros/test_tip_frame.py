# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A force on the end effector in axes of the section there, which turn with shaft and bending."""

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sensor_msgs.msg import JointState

import timo_sim
from timo_sim.log.recording import Recording
from timo_sim.messages.commands import acting, COMMANDED, COMMANDS, Refused
from timo_sim.physics.layout import LOADS, TIP_TORQUE, TIP_X, TIP_Y
from timo_sim.replay.replay import replay
from timo_sim.simulation.simulator import Simulator

CARRIER, _, TIP, *_ = COMMANDS
FORCE, DURATION = [60.0, 40.0, 0.0, 0.0, 0.0, 5.0], 0.32  # turns the tip by 0.03 rad


def driven(scene, frame='tip'):
    """Return a simulator after DURATION under the force."""
    simulator, commanded = Simulator(scene), np.zeros(COMMANDED)
    TIP.apply(TIP.row([frame], [FORCE]), commanded)
    for _ in range(round(DURATION / scene.step)):
        simulator.advance(1, acting(commanded, simulator))
    return simulator


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_its_direction_is_right_to_second_order(formulation):
    """The reference integrates the same equations by another method with the exact direction."""
    scene = timo_sim.load_scene({'model.formulation': formulation, 'initial.shaft_velocity': 1.0})
    simulator = Simulator(scene)
    model, motion = simulator.model, simulator.integration.motion

    def rate(_, state):
        load = np.zeros(LOADS)
        _, _, theta, *q = motion(state, load)[:3 + scene.modal_count]
        turn = np.exp(1j * (theta + model.section_rotation(q, model.tip_point)[0]))
        force = turn * complex(*FORCE[:2])
        load[[TIP_X, TIP_Y, TIP_TORQUE]] = force.real, force.imag, FORCE[5]
        return model.rate(state, load)

    end = solve_ivp(rate, (0.0, DURATION), model.state(scene.initial_motion()), method='DOP853',
                    rtol=1e-11, atol=1e-12).y[:, -1]
    true = motion(end, np.zeros(LOADS))[:3 + scene.modal_count]

    def error(step):
        found = driven(scene.vary({'integrator.step': step})).motion.values[:len(true)]
        return np.abs(found - true).max()

    rough, fine, finest = map(error, (0.004, 0.002, 0.001))
    assert finest < 1e-6  # 2e-7
    for ratio in rough / fine, fine / finest:
        assert 1.8 < np.log2(ratio) < 2.2
    # The same force in axes of the shaft gives another motion.
    assert np.abs(driven(scene, 'arm').motion.values[:len(true)] - true).max() > 1e-3


def test_of_a_rigid_arm_the_axes_are_those_of_the_shaft_to_the_last_bit():
    scene = timo_sim.load_scene({'model.modes': 0, 'initial.shaft_velocity': 1.0})
    assert np.array_equal(driven(scene).motion.values, driven(scene, 'arm').motion.values)


def test_the_carrier_has_no_such_axes():
    with pytest.raises(Refused, match="frame_id must be empty, 'world' or 'arm', got 'tip'"):
        CARRIER.row(['tip'], [FORCE])
    with pytest.raises(Refused, match="must be empty, 'world', 'arm' or 'tip', got 'tool'"):
        TIP.row(['tool'], [FORCE])


def test_a_node_obeys_and_its_log_replays_to_the_last_bit(start, client):
    node = start(frame_prefix='left/', command_timeout=0.3)
    push = client.command(WrenchStamped, '/timo_sim/tip_wrench')
    states = client.collect(JointState, '/joint_states')
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.y = 'left/tip', 30.0

    def moved():
        push.publish(message)
        return states and states[-1].position[2] > 1.0
    client.wait(moved, 'the shaft to turn')
    turned = states[-1].header.stamp.sec
    client.wait(lambda: states[-1].header.stamp.sec >= turned + 2, 'the end of the command')
    assert node.end()[0] == 0
    recording, lines = Recording(node.log), []
    assert recording.topics['~/tip_wrench'].columns[-2:] == (
        'tip_force_along_tip_N', 'tip_force_across_tip_N')
    assert recording.topics['~/tip_wrench'].values[0].tolist() == [*6 * [0.0], 30.0]
    assert recording.summary['stale_commands'] == '1'
    assert replay(node.log, show=lines.append), lines
