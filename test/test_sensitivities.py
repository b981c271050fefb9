# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sensitivities against closed forms, linear models and complex steps; the errors they state."""

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


def test_rigid_arm_under_a_torque():
    scene = timo_sim.load_scene({}, {
        **HELD, 'model.modes': 0, 'load.torque.piecewise.time': [0.0],
        'load.torque.piecewise.value': [3.0], 'load.torque.harmonic.amplitude': []})
    inertia = rigid(scene)[0]
    found = timo_sim.sensitivities(
        scene, 0.4, shaft, ['motor.shaft_inertia', 'initial.shaft_velocity',
                            'load.torque.piecewise.value[0]'], samples=2)
    t = np.array([0.2, 0.4])
    by_torque = t**2 / (2.0 * inertia)
    expected = np.transpose([-by_torque * 3.0 / inertia, t, by_torque])
    assert found.t == pytest.approx(t, abs=1e-12)
    assert found.jacobian == pytest.approx(expected, rel=1e-10, abs=1e-12)
    assert np.all(np.abs(found.jacobian - expected) <= 10.0 * found.error + 1e-13)


def test_the_flow_of_an_arm_at_rest_is_that_of_its_linear_model():
    """Near rest the Jacobian is that of the sampled model, without approximation."""
    scene = timo_sim.load_scene({}, {'initial.shaft': 0.0, 'arm.damping_ratio': [0.02]})
    model = timo_sim.linearize(scene).select([], ['shaft_rad']).to_discrete(0.25)
    found = timo_sim.sensitivities(scene, 0.25, shaft, ['initial'])
    by_state = dict(zip(model.states, (model.C @ model.A)[0]))
    names = dict(zip(found.inputs, found.jacobian[0]))
    assert names['initial.shaft_velocity'] == pytest.approx(
        by_state['shaft_velocity_rad_per_s'], rel=1e-7)
    assert names['initial.shaft'] == pytest.approx(by_state['shaft_rad'], rel=1e-7)


def test_the_only_number_of_a_list_needs_no_index():
    """One mode of a clamped arm without loads swings back and forth."""
    scene = timo_sim.load_scene('arm', {
        'motor.shaft': 'locked', 'carrier.held': 'both', 'model.modes': 1,
        'model.static_modes': 'none', 'arm.damping_ratio': [0.0],
        'load.torque.piecewise': {'time': [], 'value': []}})
    omega = scene.build().modes.omega[0]
    found = timo_sim.sensitivities(
        scene, 0.1, lambda batch: batch.motion.q[:, 0],
        ['initial.modal_coordinates', 'initial.modal_rates'])
    assert found.jacobian.ravel() == pytest.approx(
        [np.cos(omega * 0.1), np.sin(omega * 0.1) / omega], abs=1e-5)


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
    """The output is cut off where it is now."""
    scene = timo_sim.load_scene({}, {**HELD, 'model.modes': 0, 'initial.shaft_velocity': 1.0})

    def cut(batch):
        return np.minimum(batch.motion.shaft_velocity, limit)
    limit = 1.0
    with pytest.warns(timo_sim.ModelWarning, match='estimated error .* by initial'):
        found = timo_sim.sensitivities(scene, 0.1, cut, ['initial.shaft_velocity'])
    assert found.jacobian[0, 0] == pytest.approx(0.5, rel=1e-6)
    assert found.error[0, 0] == pytest.approx(0.5, rel=1e-3)
    limit = 2.0
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = timo_sim.sensitivities(scene, 0.1, cut, ['initial.shaft_velocity'])
    assert found.jacobian[0, 0] == pytest.approx(1.0, rel=1e-9)


def test_runs_that_diverge_do_not_count_but_the_run_itself_must_not():
    with pytest.raises(timo_sim.DivergenceError, match='diverges after'):
        timo_sim.sensitivities({'initial.shaft_velocity': 1e6, 'model.formulation': 'newton',
                                'load.torque.piecewise.time': [0.0],
                                'load.torque.piecewise.value': [1.0]}, 0.1,
                               parameters=['end_effector.mass'])


@pytest.mark.parametrize('given, text', [
    (dict(), 'sensitivities need parameters, got none'),
    (dict(parameters=['end_efector.mass']), 'end_efector.mass cannot be free: .*did you mean'),
    (dict(parameters=['model.modes']), 'model.modes cannot be free: it is no number'),
    (dict(parameters=['motor.viscous_friction']),
     r"motor.viscous_friction is 0: give .*parameters=\{'motor.viscous_friction': size\}"),
    (dict(parameters={'end_effector.mass': -1.0}), 'size of end_effector.mass must be .*> 0 kg'),
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
                                   samples=4)
    assert found.values.shape == (4, 12) and found.jacobian.shape == (4, 12, 1)
    assert np.all(np.isfinite(found.error))
