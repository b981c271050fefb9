# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameters set while the node runs, and motor voltages, act and are in the log."""

from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from timo_sim.log.info import info
from timo_sim.log.recording import Recording
from timo_sim.replay.replay import replay

MOTOR = {'motor.dc.resistance': 0.5, 'motor.dc.torque_constant': 0.06, 'motor.dc.gear_ratio': 50.0}


def test_loads_damping_and_limits_are_set_at_run_time(start, client):
    """With a reset in between; replay gives the same bits."""
    node = start(**MOTOR)
    states = client.collect(JointState, '/joint_states')
    atomically = client.service(SetParametersAtomically, '/timo_sim/set_parameters_atomically')
    one_by_one = client.service(SetParameters, '/timo_sim/set_parameters')

    def parameters(values):
        return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]

    def shows(effort):
        client.wait(lambda: states and states[-1].effort[2] == effort, f'a torque of {effort}')

    load = {'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [3.0]}
    refused = one_by_one(parameters=parameters(load)[:1]).results
    assert not refused[0].successful and 'must have the same length' in refused[0].reason
    assert atomically(parameters=parameters(load)).result.successful
    shows(3.0)
    assert all(result.successful for result in one_by_one(parameters=parameters({
        'arm.damping_ratio': [0.02], 'motor.viscous_friction': 2.0,
        'motor.dc.voltage_limit': 10.0})).results)
    client.command(Float64, '/timo_sim/motor_voltage').publish(Float64(data=12.0))
    shows(3.0 + 50.0 * 0.06 / 0.5 * 10.0)
    client.command(Float64, '/timo_sim/motor_torque').publish(Float64(data=4.0))
    shows(7.0)
    assert one_by_one(parameters=parameters({'motor.torque_limit': 1.0})).results[0].successful
    shows(4.0)
    assert client.service(Trigger, '/timo_sim/reset')().success
    shows(3.0)
    assert node.end()[0] == 0

    changes = Recording(node.log).changes
    assert [list(values) for _, _, values in changes] == [
        list(load), ['arm.damping_ratio'], ['motor.viscous_friction'],
        ['motor.dc.voltage_limit'], ['motor.torque_limit']]
    assert f'at step {changes[0][0]}: load.torque.piecewise.value = [3.0]' in '\n'.join(
        info(node.log))
    lines = []
    assert replay(node.log, show=lines.append), lines
    assert 'the same to the last bit' in lines[1]
