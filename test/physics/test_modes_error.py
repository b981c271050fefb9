# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The estimate of the error by the number of modes, against closed forms and more modes."""

import numpy as np
import pytest
import timo_sim
from timo_sim.physics.integrate.steps import Steps
from timo_sim.physics.layout import LOADS, TIP_I, TIP_II, TIP_TORQUE

CLAMPED = {'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0}
THIN = {'arm.height': 0.004, 'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0],
        'motor.drive.angle': [0.0, 10.0], 'motor.drive.speed': [0.0, 20.0],
        'motor.drive.acceleration': [0.0, 0.0], 'end_effector.mass': 0.1,
        'end_effector.inertia': 0.0}
SOFT = {'arm.shear_modulus': 1e6, 'load.tip_force_y.piecewise.time': [0.0, 0.5],
        'load.tip_force_y.piecewise.value': [100.0, 0.0]}


@pytest.mark.parametrize('load, size', [(TIP_II, 0.02), (TIP_TORQUE, 0.01)])
@pytest.mark.parametrize('shear_modulus', [26e9, 1e6])
def test_the_shift_is_the_missing_static_deflection_of_a_clamped_arm(load, size, shear_modulus):
    model = timo_sim.load_scene({**CLAMPED, 'arm.shear_modulus': shear_modulus}).build()
    arm, acting, motion = model.manipulator.arm, np.zeros(LOADS), np.zeros(model.size)
    tip = model.tip_point
    along = tip.deflection if load == TIP_II else tip.rotation
    motion[3:model.size // 2] = size * along[:, 0] / model.modes.omega**2
    acting[load] = size
    section, length = arm.section, arm.length
    whole = (length**3 / (3.0 * section.bending_stiffness) + length / section.shear_stiffness
             if load == TIP_II else length**2 / (2.0 * section.bending_stiffness))
    shift = Steps(model, 0.001).errors.modes.shifts(model.state(motion), acting)[0]
    lacking = size * whole - model.centre_line(motion[np.newaxis, 3:model.size // 2], tip)[0, 0, 1]
    assert abs(lacking) > 1e-5 * size * whole
    assert shift[1] == pytest.approx(lacking, rel=5e-3)  # six nodes integrate products of modes


def test_an_axial_force_stretches_a_clamped_arm():
    model = timo_sim.load_scene(CLAMPED).build()
    acting, arm = np.zeros(LOADS), model.manipulator.arm
    acting[TIP_I] = 100.0
    shifts = Steps(model, 0.001).errors.modes.shifts(model.state(np.zeros(model.size)), acting)
    expected = [[0.0, 0.0], [100.0 * arm.length / arm.section.axial_stiffness, 0.0]]
    np.testing.assert_allclose(shifts, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('modes, values', [
    (5, {}), (3, {}), (3, {'carrier.held': 'both'}),
    (3, {'arm.damping_ratio': [0.01]}), (3, {'initial.shaft_velocity': 3.0}),
    (3, {'model.formulation': 'newton'}),
], ids=['five modes', 'free', 'held', 'damped', 'turning', 'newton'])
def test_vibrations_run_ahead_as_estimated(modes, values):
    runs = [timo_sim.simulate(timo_sim.load_scene({
        'model.modes': count, 'initial.modal_rates': [1.0] + [0.0] * (count - 1), **values}), 4.0)
        for count in (modes, 12 if modes == 5 else 5)]
    error = np.linalg.norm(runs[0].position(2.0) - runs[1].position(2.0), axis=1).max()
    assert error / 3.0 < runs[0].stats['modes_error_m'] < 4.0 * error
    assert runs[1].stats['modes_error_m'] < 0.1 * error


@pytest.mark.parametrize('values', [THIN, SOFT], ids=['thin', 'soft in shear'])
def test_too_few_modes_give_a_warning(values):
    with pytest.warns(timo_sim.ModelWarning, match='take more model.modes'):
        timo_sim.simulate(timo_sim.load_scene({**values, 'integrator.step': 0.0005}), 2.0)


def test_enough_modes_give_no_warning(recwarn):
    run = timo_sim.simulate(timo_sim.load_scene('paper'), 10.0)
    assert run.warning is None
    assert run.stats['modes_error_m'] < 1e-4


def test_a_rigid_arm_has_no_error_by_modes():
    run = timo_sim.simulate(timo_sim.load_scene('paper', {'model.modes': 0}), 1.0)
    assert run.stats['modes_error_m'] == 0.0
