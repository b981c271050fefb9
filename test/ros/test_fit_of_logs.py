# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""A fit to the log of a real node that was reset."""

import numpy as np
import pytest
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

import timo_sim

SCENE = {'motor.viscous_friction': 0.8, 'integrator.step': 0.001, 'record_sensors': True,
         'sensor.encoder.noise': 1e-4, 'rate.joint_states': 100.0, 'duration': 4.0}


def test_commands_after_a_reset_act_when_the_log_says(start, client):
    """The record begins at the reset; commands and outputs of it have the same clock."""
    node = start(start_paused=True, steps_per_call=400, **SCENE)
    torque = client.command(Float64, '/timo_sim/motor_torque')
    step, reset = (client.service(Trigger, f'/timo_sim/{name}') for name in ('step', 'reset'))
    for value in (3.0, -2.0, None, 2.0, -4.0, 1.0, 3.0, -1.0, 2.0, 0.0):
        if value is None:
            assert reset().success
            continue
        torque.publish(Float64(data=value))
        client.wait(lambda: step().success, 'a step')
    node.end()
    record = timo_sim.read_record(node.log)
    assert record.outputs['shaft'].t[0] == 0.0 and record.inputs['torque'].t[-1] < record.duration
    assert record.outputs['shaft'].noise == pytest.approx(1e-4)
    guess = timo_sim.load_scene({'motor.viscous_friction': 2.0, 'end_effector.mass': 2.5})
    found = timo_sim.fit(guess, record, ['motor.viscous_friction', 'end_effector.mass'])
    assert found.values == pytest.approx(
        {'motor.viscous_friction': 0.8, 'end_effector.mass': 2.0}, rel=0.02)
    assert np.isclose(found.errors['shaft'].rms, 1e-4, rtol=0.2)
