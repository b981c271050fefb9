# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sensitivities against closed forms, linear models and complex steps; the errors they state."""

import math
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import timo_sim

HELD = {'carrier.held': 'both', 'initial.shaft': 0.0}
PENDULUM = {**HELD, 'model.modes': 0, 'gravity': [0.0, -9.81], 'initial.shaft': 0.9,
            'initial.shaft_velocity': 1.5}


def rigid(scene):
    """Return moment of inertia about the shaft [kg m2], and mass times lever [kg m]."""
    arm, tip = scene.manipulator.arm, scene.manipulator.end_effector_mass
    section, length = arm.section, arm.length
    inertia = (scene.manipulator.shaft_inertia + section.mass_per_length * length**3 / 3.0
               + section.mass_per_length * section.second_moment / section.area * length
               + tip * length**2 + scene.manipulator.end_effector_inertia)
    return inertia, section.mass_per_length * length**2 / 2.0 + tip * length


def shaft(batch):
    """Return the shaft angles, shape (n,) [rad]."""
    return batch.motion.shaft


def test_rigid_arm_under_torques():
    scene = timo_sim.load_scene({}, {**HELD, 'model.modes': 0})
    inertia, torques = rigid(scene)[0], np.array([3.0, -1.0, 2.0, 5.0])
    found = timo_sim.sensitivities(
        scene, 0.4, shaft, ['motor.shaft_inertia', 'initial.shaft_velocity'],
        {'torque': torques}, samples=2)
    assert found.inputs == ('motor.shaft_inertia', 'initial.shaft_velocity', 'torque[0]',
                            'torque[1]', 'torque[2]', 'torque[3]')
    expected = []
    for t in found.t:
        begun = np.minimum(0.1 * np.arange(4), t)
        ended = np.minimum(begun + 0.1, t)
        by_torque = ((t - begun)**2 - (t - ended)**2) / (2.0 * inertia)
        expected.append([-by_torque @ torques / inertia, t, *by_torque])
    assert found.t == pytest.approx([0.2, 0.4], abs=1e-12)
    assert found.jacobian == pytest.approx(np.array(expected), rel=1e-10, abs=1e-12)
    assert np.all(np.abs(found.jacobian - expected) <= 10.0 * found.error + 1e-13)


def test_flow_and_inputs_of_an_arm_at_rest_are_those_of_its_linear_model():
    """Near rest the Jacobian is A^k of the sampled model, and A^k B, without approximation."""
    scene = timo_sim.load_scene({}, {'initial.shaft': 0.0, 'arm.damping_ratio': [0.02]})
    count, duration = 5, 0.25
    model = timo_sim.linearize(scene).select(['torque_N_m'], ['shaft_rad']).to_discrete(
        duration / count)
    found = timo_sim.sensitivities(scene, duration, shaft, ['initial'],
                                   {'torque': np.zeros(count)})
    flow = np.linalg.matrix_power(model.A, count)
    by_state = dict(zip(model.states, (model.C @ flow)[0]))
    by_torque = [(model.C @ np.linalg.matrix_power(model.A, count - 1 - k) @ model.B)[0, 0]
                 for k in range(count)]
    assert found.jacobian[0, -count:] == pytest.approx(by_torque, rel=1e-7)
    names = dict(zip(found.inputs, found.jacobian[0]))
    assert names['initial.shaft_velocity'] == pytest.approx(
        by_state['shaft_velocity_rad_per_s'], rel=1e-7)
    assert names['initial.shaft'] == pytest.approx(by_state['shaft_rad'], rel=1e-7)


def pendulum(parameter, change, duration):
    """Return the angle of the rigid arm in gravity, with a complex change of a parameter."""
    scene = timo_sim.load_scene(PENDULUM)
    inertia, moment = (value + 0j for value in rigid(scene))
    state = np.array([PENDULUM['initial.shaft'], PENDULUM['initial.shaft_velocity']],
                     dtype=complex)
    if parameter == 'end_effector.mass':
        inertia, moment = inertia + change * 4.0, moment + change * 2.0
    elif parameter == 'initial.shaft':
        state[0] += change
    else:
        state[1] += change

    def rate(_, state):
        return [state[1], -9.81 * moment / inertia * np.cos(state[0])]

    return solve_ivp(rate, (0.0, duration), state, method='DOP853', rtol=1e-13,
                     atol=1e-13).y[0, -1]


@pytest.mark.parametrize('name', ['end_effector.mass', 'initial.shaft', 'initial.shaft_velocity'])
def test_swinging_arm_against_complex_steps(name):
    """Complex steps have no difference of near numbers: of another integrator, to 1e-11."""
    expected = pendulum(name, 1e-30j, 3.0).imag / 1e-30
    found = timo_sim.sensitivities(PENDULUM, 3.0, shaft, [name])
    assert found.values[0] == pytest.approx(pendulum(name, 0.0, 3.0).real, abs=1e-9)
    assert found.jacobian[0, 0] == pytest.approx(expected, rel=1e-8)
    assert abs(found.jacobian[0, 0] - expected) <= 10.0 * found.error[0, 0] + 1e-9


def test_estimated_errors_hold_for_an_arm_that_bends():
    """Derivatives of longer and shorter differences agree as their stated errors say."""
    names = ['end_effector.mass', 'arm.young_modulus', 'initial.shaft_velocity']
    scene = timo_sim.load_scene('paper', {'integrator.step': 0.005})
    one, other = (timo_sim.sensitivities(
        scene, 2.0, parameters={name: size * scene.values[name] or size for name in names},
        samples=20) for size in (1.0, 0.17))
    apart = np.abs(one.jacobian - other.jacobian)
    assert np.all(apart <= 10.0 * (one.error + other.error))
    assert np.all(one.error <= 1e-6 * np.abs(one.jacobian).max(axis=(0, 1)))


def test_a_limit_is_a_kink_of_which_the_error_tells():
    scene = timo_sim.load_scene({}, {**HELD, 'model.modes': 0, 'motor.torque_limit': 4.0})
    one_sided = 0.1**2 / (2.0 * rigid(scene)[0])
    with pytest.warns(timo_sim.ModelWarning, match='estimated error .* by torque'):
        found = timo_sim.sensitivities(scene, 0.1, shaft, commands={'torque': [4.0]})
    assert found.jacobian[0, 0] == pytest.approx(0.5 * one_sided, rel=1e-6)
    assert found.error[0, 0] == pytest.approx(0.5 * one_sided, rel=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = timo_sim.sensitivities(scene, 0.1, shaft, commands={'torque': [3.0]})
    assert found.jacobian[0, 0] == pytest.approx(one_sided, rel=1e-9)


def test_runs_that_diverge_do_not_count_but_the_run_itself_must_not():
    with pytest.raises(timo_sim.DivergenceError, match='diverges after'):
        timo_sim.sensitivities({'initial.shaft_velocity': 1e6, 'model.formulation': 'newton'}, 0.1,
                               commands={'torque': [1.0]})


@pytest.mark.parametrize('given, text', [
    (dict(), 'sensitivities need parameters or commands, got none'),
    (dict(parameters=['end_efector.mass']), 'end_efector.mass cannot be free: .*did you mean'),
    (dict(parameters=['model.modes']), 'model.modes cannot be free: it is no number'),
    (dict(parameters=['motor.viscous_friction']),
     r"motor.viscous_friction is 0: give .*parameters=\{'motor.viscous_friction': size\}"),
    (dict(parameters={'end_effector.mass': -1.0}), 'size of end_effector.mass must be .*> 0 kg'),
    (dict(commands={'torqe': [1.0]}), 'commands has torqe, which is none of .*did you mean tor'),
    (dict(commands={'torque': 1.0}), r'commands torque must be numbers of shape \(k,\), got 1.0'),
    (dict(commands={'force': [1.0]}), r'commands force must be numbers of shape \(k, 2\)'),
    (dict(commands={'torque': [1.0] * 3}), 'the 100 steps .* multiple of the number of torque'),
    (dict(parameters=['arm.length'], samples=3), 'the 100 steps .* multiple of the number of sam'),
    (dict(parameters=['arm.length'], samples=0), 'samples must be .*>= 1, got 0'),
    (dict(parameters=['arm.length'], output=lambda batch: 1.0), 'output must be an array of 17'),
])
def test_refusals(given, text):
    with pytest.raises(timo_sim.ParameterError, match=text):
        timo_sim.sensitivities({}, 0.1, **given)


def test_more_than_tip_and_parameters():
    """Any function of the batch is an output; of a list, elements are inputs."""
    scene = timo_sim.load_scene('paper')
    found = timo_sim.sensitivities(scene, 0.1, lambda batch: batch.motion.values,
                                   ['load.torque.harmonic.amplitude[0]'],
                                   {'force': [[0.0, 0.0], [1.0, 2.0]]}, samples=4)
    assert found.values.shape == (4, 12) and found.jacobian.shape == (4, 12, 5)
    assert found.inputs[1:] == ('force[0][0]', 'force[0][1]', 'force[1][0]', 'force[1][1]')
    assert np.all(np.isfinite(found.error)) and not found.jacobian[:2, :, 3:].any()
    assert math.isclose(found.jacobian[1, 6, 1] * scene.build().mass, 0.05, rel_tol=0.2)
