# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Linear models against closed forms, and against the nonlinear simulation nearby."""

from dataclasses import replace
import re
import warnings

from command_line import call
import numpy as np
from oracles.linear_beam import LinearBeam
import pytest
import scipy.linalg

import timo_sim
from timo_sim.model.bodies import Quadrature
from timo_sim.model.layout import INPUTS, LOADS, VOLTAGE, without_unit
from timo_sim.scene.loads import CHANNELS
from timo_sim.simulation.simulator import Simulator


def straight(formulation, angle, free):
    """Return mass and stiffness matrices of the free coordinates, the straight arm at an angle."""
    body, modes = formulation.manipulator, formulation.modes
    fine = Quadrature(body.arm.breaks, 100)
    mass, inertia = body.inertia(fine)
    xi = fine.points
    deflection, rotation = modes.deflection(xi), modes.rotation(xi)
    across = np.array([-np.sin(angle), np.cos(angle)])
    matrix = np.eye(3 + len(modes))
    matrix[:2, :2] *= body.base_mass + mass.sum()
    matrix[2, 2] = body.shaft_inertia + mass @ xi**2 + inertia.sum()
    matrix[2, :2] = matrix[:2, 2] = (mass @ xi) * across
    matrix[3:, :2] = np.outer(mass @ deflection, across)
    matrix[:2, 3:] = matrix[3:, :2].T
    matrix[2, 3:] = matrix[3:, 2] = (mass * xi) @ deflection + inertia @ rotation
    stiffness = np.diag(np.append(np.zeros(3), modes.omega**2))
    return matrix[np.ix_(free, free)], stiffness[np.ix_(free, free)]


STRIP = {'arm.length': 1.0, 'arm.section.width': 0.02, 'arm.section.height': 0.002,
         'arm.density': 7850.0,
         'arm.young_modulus': 2.1e11, 'arm.shear_modulus': 8e10, 'end_effector.mass': 0.0,
         'end_effector.inertia': 0.0}
TAPERED = {'arm.profile.position': [0.0, 0.4, 0.4, 1.0], 'arm.profile.height': [0.02, 0.01] * 2}


@pytest.mark.parametrize('count', [1, 4])
@pytest.mark.parametrize('name, values, free', [
    ('exact', {}, [0, 1, 2]), ('newton', {}, [0, 1, 2]),
    ('exact', {'carrier.held': 'both'}, [2]),
    ('exact', {'carrier.held': 'both', 'motor.shaft': 'locked'}, []),
    ('exact', {'carrier.held': 'both', 'motor.shaft': 'locked', **STRIP}, []),
    ('exact', {**STRIP, **TAPERED}, [0, 1, 2]),
    ('exact', {**STRIP, 'arm.section.height': 0.2}, [0, 1, 2]),
    ('exact', {'carrier.held': 'y'}, [0, 2]), ('newton', {'carrier.held': 'x'}, [1, 2])], ids=str)
def test_poles_are_the_frequencies_of_the_straight_arm(name, values, free, count):
    """All of them, the highest included, with the masses integrated at a hundred points."""
    scene = timo_sim.load_scene({}, {
        'model.formulation': name, 'model.modes': count, 'model.static_modes': 'none',
        'initial.shaft': 0.3, **values})
    model = timo_sim.linearize(scene)
    free = [*free, *range(3, 3 + count)]
    squares = scipy.linalg.eigvalsh(*reversed(straight(scene.build(), 0.3, free)))
    expected = np.sqrt(np.maximum(squares, 0.0))
    expected = expected[expected > 1.0]
    poles = model.poles()
    found = np.sort(poles.imag[poles.imag > 1.0])
    # With one axis held, theory (T35), the linear part is one of a sector's middle.
    assert found == pytest.approx(expected, rel=1e-6)
    # The other poles belong to shaft and carrier, two zeros each, which round-off splits.
    assert np.sum(np.abs(poles) < 1e-3) == 2 * (len(free) - len(expected))
    assert np.abs(poles.real).max() < 1e-3


@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_damping_ratio_of_a_clamped_mode(name):
    scene = timo_sim.load_scene({}, {
        'model.formulation': name, 'model.modes': 8, 'carrier.held': 'both',
        'motor.shaft': 'locked', 'arm.damping_ratio': [0.01, 0.02, 0.3, *5 * [0.0]]})
    poles = timo_sim.linearize(scene).poles()
    poles = poles[poles.imag > 0.0][:3]
    assert -poles.real / np.abs(poles) == pytest.approx([0.01, 0.02, 0.3], rel=1e-9)
    assert np.abs(poles) == pytest.approx(scene.build().modes.omega[:3], rel=1e-9)


HEAVY = {'end_effector.mass': 60.0, 'end_effector.inertia': 12.0}
HELD = {'carrier.held': 'both'}
OUTPUTS = ['shaft_rad', 'tip_y_m', 'tip_transverse_m', 'tip_rotation_rad',
           'tip_acceleration_m_per_s2']


@pytest.mark.parametrize('name', ['exact', 'newton'])
@pytest.mark.parametrize('values, cause', [
    ({**HEAVY, **HELD}, 'torque_N_m'), ({**HEAVY, **HELD}, 'tip_torque_N_m'),
    (HEAVY, 'force_y_N'), ({}, 'torque_N_m'),
    ({'hub.radius': 0.3, 'sensor.tip_imu.position': 0.5}, 'torque_N_m')], ids=str)
def test_frequency_responses_converge_to_those_of_finite_elements(name, values, cause):
    """Up to 60 Hz, beyond resonances, also with a heavy tip, which hardly moves."""
    errors = []
    for modes in (4, 8):
        scene = timo_sim.load_scene({}, {'model.formulation': name, 'model.modes': modes,
                                         'initial.shaft': 0.0, **values})
        beam, frequencies = LinearBeam(scene, held='carrier.held' in values), [1.0, 15.0, 60.0]
        model = timo_sim.linearize(scene).select([cause], OUTPUTS)
        found = model.frequency_response(frequencies)
        expected = [[beam.response(cause, frequency)[name] for name in OUTPUTS]
                    for frequency in frequencies]
        errors.append(np.abs(found[:, :, 0] / expected - 1.0).max())
    assert errors[1] < 6e-4 and errors[1] < errors[0] / 2.0**6  # order 6 at least


LIGHT = {'end_effector.mass': 0.0, 'end_effector.inertia': 0.0}
LOCKED = {'motor.shaft': 'locked'}
WITHIN = {'sensor.root_strain.position': 0.5}
# Relative error of the series of curvatures with three modes; doc/theory.md, section 9, has these.
SERIES = {'tip_force_y_N': 0.028, 'force_y_N': 1.0, 'tip_torque_N_m': 0.46}


@pytest.mark.parametrize('name', ['exact', 'newton'])
@pytest.mark.parametrize('values, cause', [
    ({}, 'tip_force_y_N'), ({'motor.shaft_inertia': 0.1}, 'force_y_N'), (LIGHT, 'tip_torque_N_m'),
    (LOCKED, 'force_y_N'), ({**LOCKED, **HELD}, 'tip_torque_N_m'),
    ({'hub.radius': 0.5}, 'tip_force_y_N'),
    ({**LOCKED, **HELD, 'hub.radius': 0.5}, 'tip_force_y_N'), (WITHIN, 'tip_force_y_N'),
    ({**WITHIN, **LOCKED, **HELD, 'hub.radius': 0.5}, 'tip_force_y_N')], ids=str)
def test_strain_needs_few_modes(name, values, cause):
    """Three modes do for quasi-static loads; at 15 Hz the strain converges as the motion does."""
    errors = []
    for modes in (3, 6):
        scene = timo_sim.load_scene({}, {
            'model.formulation': name, 'model.modes': modes, 'model.static_modes': 'none',
            'initial.shaft': 0.0, **values})
        beam = LinearBeam(scene, held='carrier.held' in values, locked='motor.shaft' in values)
        model = timo_sim.linearize(scene).select([cause], ['root_strain'])
        found = model.frequency_response([0.1, 15.0])[:, 0, 0]
        if modes == 3 and cause in SERIES and not values.keys() & {
                *LOCKED, *HELD, *WITHIN, 'hub.radius'}:
            states = replace(model, C=np.eye(len(model.A)), D=np.zeros((len(model.A), 1)))
            q = states.frequency_response([0.1])[0, 3:6, 0]
            curvature = scene.build().modes.curvature(np.zeros(1))[0]
            series = 0.5 * scene.manipulator.arm.section.height * curvature @ q
            lost = abs(series / beam.response(cause, 0.1)['root_strain'] - 1.0)
            assert lost == pytest.approx(SERIES[cause], rel=0.05)
        errors.append(np.abs([strain / beam.response(cause, frequency)['root_strain'] - 1.0
                              for frequency, strain in zip((0.1, 15.0), found)]))
    # Round-off of stiffness against inertia at 0.1 Hz: 1e-7 to 4e-6 of a strain, by processor.
    assert errors[0][0] < 1e-5 and errors[1][1] < 2e-4 and errors[1][1] < errors[0][1] / 2.0**4


@pytest.mark.parametrize('cause, static, at_15_hz', [
    ('tip_torque_N_m', 'torque', 2e-3), ('tip_force_y_N', 'force', 2e-3),
    ('tip_torque_N_m', 'both', 4e-3)])
@pytest.mark.parametrize('tip', [LIGHT, {'end_effector.mass': 0.05,
                                         'end_effector.inertia': 1e-4}], ids=str)
@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_static_shapes_converge_with_a_light_tip(name, tip, cause, static, at_15_hz):
    """Four eigenmodes alone are 0.9 to 13 % off at 0.1 Hz, and 17 to 35 % at 15 Hz."""
    outputs, frequencies = ['tip_transverse_m', 'tip_rotation_rad'], [0.1, 15.0]
    errors = {}
    for shapes in (static, 'none'):
        scene = timo_sim.load_scene({}, {'model.formulation': name, 'model.modes': 4, **tip,
                                         'initial.shaft': 0.0, 'model.static_modes': shapes})
        model, beam = timo_sim.linearize(scene).select([cause], outputs), LinearBeam(scene)
        expected = [[beam.response(cause, frequency)[name] for name in outputs]
                    for frequency in frequencies]
        for way, d in ('modes', 0.0), ('with the residual', 1.0):
            found = replace(model, D=d * model.D).frequency_response(frequencies)[:, :, 0]
            errors[shapes, way] = np.abs(found / expected - 1.0).max(axis=1)
    assert errors[static, 'modes'][0] < 1e-4 and errors[static, 'modes'][1] < at_15_hz
    assert errors['none', 'modes'][0] > 7e-3 and errors['none', 'modes'][1] > 0.1
    for shapes in (static, 'none'):
        assert errors[shapes, 'with the residual'][0] < 1e-4
    assert errors['none', 'with the residual'][1] < 0.3 * errors['none', 'modes'][1]


def test_loads_at_a_straight_tip_turn_it_by_its_deflection_over_the_length():
    model = timo_sim.linearize(timo_sim.load_scene({}, {
        **LIGHT, 'arm.length': 0.7, 'motor.shaft_inertia': 0.1,
        'model.static_modes': 'none'})).select(outputs=['tip_angle_rad', 'tip_transverse_m'])
    for each in model.C, model.D:
        assert np.abs(each).max() > 1e-6 and each[0] == pytest.approx(each[1] / 0.7, rel=1e-9)


BENT = {'gravity': [2.0, -9.81], 'initial.equilibrium': True, 'carrier.held': 'both',
        'initial.shaft': -0.4, 'end_effector.mass': 0.1, 'end_effector.inertia': 1e-4,
        'arm.section.height': 0.004, 'load.torque.piecewise.time': [0.0],
        'load.torque.piecewise.value': [6.0], 'load.tip_force_y.piecewise.time': [0.0],
        'load.tip_force_y.piecewise.value': [-3.0]}


@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_outputs_are_derivatives_of_the_readings(name):
    """Of the simulator's sensors in gravity, where the arm is bent far, by central differences."""
    scene = timo_sim.load_scene({}, {'model.formulation': name, 'model.modes': 3, **BENT})
    model = timo_sim.linearize(scene).select(outputs=[
        'root_strain', 'tip_acceleration_along_m_per_s2', 'tip_acceleration_m_per_s2',
        'gyro_rad_per_s', 'tip_angle_rad'])
    load, simulator = scene.load_at_start(), Simulator(scene)
    assert abs(simulator.snapshot().tip[2]) > 0.3
    columns = [CHANNELS[without_unit(name)[0]] for name in model.inputs]
    random, small = np.random.default_rng(1), 1e-5
    for _ in range(3):
        x, u = random.normal(size=len(model.A)), random.normal(size=len(columns))
        ends = []
        for sign in (-small, small):
            simulator.set_motion(model.to_motion(sign * x))
            simulator._load[:] = load
            simulator._load[columns] += sign * u
            sensors = simulator.sensors
            ends.append([sensors.root_strain, *sensors.tip_acceleration, sensors.gyro,
                         np.arctan2(*simulator.snapshot().tip[1::-1])])
        found = np.subtract(*reversed(ends)) / (2.0 * small)
        # Differences of flow and readings: 1e-9 in the acceleration over 1e-5.
        # What acts at the tip also bends the arm beyond the modes; the simulator leaves this out.
        expected = model.C @ x + model.D @ u - [0.0, 0.0, 0.0, 0.0, model.D[4] @ u]
        assert expected == pytest.approx(found, rel=1e-4)


def test_damping_takes_its_share_of_the_root_moment():
    """The strain follows the moment without that of damping, here proportional to stiffness."""
    rate, frequency = 5e-4, 5.0
    omega = timo_sim.load_scene({'model.modes': 8}).build().modes.omega
    scene = timo_sim.load_scene({}, {'model.modes': 8, 'initial.shaft': 0.0,
                                     'arm.damping_ratio': (0.5 * rate * omega).tolist()})
    model = timo_sim.linearize(scene).select(['tip_force_y_N'], ['root_strain'])
    expected = LinearBeam(scene, stress_damping=rate).response(
        'tip_force_y_N', frequency)['root_strain']
    found = model.frequency_response([frequency])[0, 0, 0]
    # The damping moment is a sum of curvatures; without it the error is 2 pi 5 rate = 0.016.
    assert abs(found / expected - 1.0) < 2e-5


# `newton` needs a smaller step: the terms that are not in its linear part cause an error of it.
@pytest.mark.parametrize('name, step', [('exact', 0.005), ('newton', 0.0005)])
def test_a_step_of_the_simulation_is_the_discrete_model(name, step):
    """Small deviations and held commands over one step: the difference is of second order."""
    scene = timo_sim.load_scene({}, {'model.formulation': name, 'model.modes': 3,
                                     'arm.damping_ratio': [0.02], 'integrator.step': step})
    model = timo_sim.linearize(scene).to_discrete(step)
    random, small = np.random.default_rng(1), 1e-6
    for _ in range(3):
        x, u = random.normal(size=len(model.A)), random.normal(size=6)
        ends = []
        for sign in (-1.0, 1.0):
            simulator = Simulator(scene)
            simulator.set_motion(model.to_motion(sign * small * x))
            held = np.zeros(LOADS)
            held[[0, 1, 4, 5, 6, 9]] = sign * small * u
            simulator.advance(1, held)
            ends.append(model.state(simulator.motion))
        found = (ends[1] - ends[0]) / (2.0 * small)
        expected = model.A @ x + model.B[:, :6] @ u
        assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize('values', [{'carrier.held': 'x'}, {'motor.shaft': 'locked'}, BENT],
                         ids=['x held', 'locked', 'bent'])
def test_motions_of_states_leave_what_is_no_state_at_rest(values):
    scene = timo_sim.load_scene({}, {**values, 'initial.carrier_y': 0.2, 'initial.carrier_x': 0.1})
    model, rest = timo_sim.linearize(scene), scene.initial_motion()
    x = np.random.default_rng(1).normal(size=(2, 3, len(model.A)))
    motion = model.to_motion(x)
    assert motion.values.shape == (2, 3, len(rest))
    assert model.state(motion) == pytest.approx(x, abs=1e-14)
    changed = (motion.values != rest).any(axis=(0, 1))
    assert changed.sum() == len(model.A) and not model.state(rest).any()
    assert np.array_equal(changed, np.isin(np.arange(len(rest)), model.places))


MOTOR = {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.05, 'motor.dc.gear_ratio': 7.0}


def test_a_voltage_turns_a_rigid_arm_as_the_motor_s_constants_say():
    """`J theta'' = n k / R (V - n k theta')`: gain and pole in closed form."""
    scene = timo_sim.load_scene({}, {**MOTOR, 'model.modes': 0, 'carrier.held': 'both'})
    body, at_shaft = scene.manipulator, 7.0 * 0.05
    section, length = body.arm.section, body.arm.length
    inertia = (body.shaft_inertia + body.end_effector_mass * length**2 + body.end_effector_inertia
               + section.mass_per_length * length**3 / 3.0 + section.inertia_per_length * length)
    model = timo_sim.linearize(scene).select(['voltage_V'], ['shaft_rad'])
    s = 2j * np.pi * 0.7
    expected = at_shaft / 2.0 / (inertia * s**2 + at_shaft**2 / 2.0 * s)
    assert model.frequency_response([0.7])[0, 0, 0] == pytest.approx(expected, rel=1e-9)
    assert 'voltage_V' not in timo_sim.linearize('paper').inputs


def test_a_held_voltage_moves_the_simulated_arm_as_the_discrete_model():
    scene = timo_sim.load_scene({}, {**MOTOR, 'initial.shaft': 0.3})
    model, simulator = timo_sim.linearize(scene).to_discrete(0.05), Simulator(scene)
    found = model.state(simulator.step(voltage=1e-3, duration=0.05))
    expected = 1e-3 * model.B[:, model.inputs.index('voltage_V')]
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize('values, inputs', [
    ({}, ['force_x_N', 'force_y_N', 'torque_N_m', 'tip_force_x_N', 'tip_force_y_N',
          'tip_torque_N_m']),
    ({'carrier.held': 'both'}, ['torque_N_m', 'tip_force_y_N', 'tip_torque_N_m',
                                'carrier_acceleration_y_m_per_s2']),
    ({'carrier.held': 'y', 'motor.shaft': 'locked', 'model.modes': 0},
     ['force_x_N', 'tip_force_x_N'])])
def test_inputs_without_effect_are_left_out(values, inputs):
    model = timo_sim.linearize(timo_sim.load_scene({}, {'initial.shaft': 0.0, **values}))
    assert list(model.inputs) == inputs


@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_each_input_acts_in_each_formulation(name):
    """Those in axes of the arm are no inputs of linear models; only a held carrier is driven."""
    found = {each for held in ({}, {'carrier.held': 'both'}) for each in timo_sim.linearize(
        timo_sim.load_scene({}, {'model.formulation': name, 'push.position': 1.0, **MOTOR,
                                 **held})).inputs}
    assert found == {INPUTS[column].column for column in (*CHANNELS.values(), VOLTAGE)}


def test_bode_diagram_from_the_command_line(tmp_path):
    scene, picture = tmp_path / 'scene.yaml', tmp_path / 'bode.png'
    scene.write_text('timo_sim: {ros__parameters: {hub.radius: 0.01}}')
    told = call('bode', '--help')
    inputs = timo_sim.linearize({**MOTOR, 'push.position': 1.0}).inputs
    assert len(inputs) == 9 and all(re.search(rf'\b{name}\b', told) for name in inputs)
    assert f'{picture} is drawn\n' == call(
        'bode', scene, '--output', picture, '--set', 'model.modes=3')
    assert picture.stat().st_size > 20000
    for picture, name, words in ((picture, 'tip', "output 'tip' is none of"),
                                 ('bode.foo', 'shaft_rad', 'bode.foo cannot be drawn: Format')):
        assert words in call('bode', scene, '-o', picture, '--response', name, code=2)


def test_a_linear_model_has_the_static_shapes_of_its_scene():
    """Those of a lane of a Batch, or of another mass on a page, are not those of its own tip."""
    scene = timo_sim.load_scene('arm', {'arm.length': 0.4})
    light, heavy = timo_sim.Batch([scene, scene.vary({'end_effector.mass': 1.0})]).scenes
    assert scene.static == light.static == heavy.static == ('torque',)
    assert len(timo_sim.linearize(heavy).states) == len(timo_sim.linearize(light).states)


@pytest.mark.filterwarnings('error')
def test_the_bode_diagram_of_a_rigid_arm_has_gains_of_zero(tmp_path):
    call('bode', 'paper', '--set', 'model.modes=0', '--png', tmp_path / 'bode.png')
    assert (tmp_path / 'bode.png').stat().st_size > 20000


@pytest.mark.parametrize('values', [{'initial.shaft_velocity': 1.0},
                                    {'initial.modal_coordinates': [0.1, 0.0, 0.0]}])
def test_a_moving_scene_is_no_equilibrium(values):
    with pytest.raises(timo_sim.ParameterError, match='about an equilibrium'):
        timo_sim.linearize(timo_sim.load_scene({}, values))


@pytest.mark.parametrize('values', [
    {}, {'model.modes': 5}, {'model.formulation': 'newton'}, {'carrier.held': 'x'},
    {'motor.shaft': 'locked', 'end_effector.mass': 0.0, 'end_effector.inertia': 0.0}], ids=str)
@pytest.mark.parametrize('ratios', [[0.01], [0.02, 0.005, 0.01]], ids=str)
def test_damping_ratios_of_the_whole_manipulator(values, ratios):
    modes = values.get('model.modes', 3)
    count = timo_sim.load_scene({}, values).modal_count
    ratios = ratios if len(ratios) == 1 else [*ratios, *[0.003] * (modes - 3)]
    poles = timo_sim.linearize(timo_sim.load_scene({}, {
        **values, 'arm.damping_ratio': ratios, 'arm.damping_of': 'system'})).poles()
    poles = poles[poles.imag > 1.0]
    assert len(poles) == count
    assert -poles.real / np.abs(poles) == pytest.approx(
        [*ratios, *(count - len(ratios)) * ratios[-1:]], rel=0.02)


def test_damping_ratios_that_no_clamped_modes_give_are_refused():
    with pytest.raises(timo_sim.ParameterError, match='mode 1 would need a ratio of -0.008'):
        timo_sim.load_scene({}, {'motor.shaft_inertia': 1e-3, 'arm.damping_ratio': [0.01],
                                 'model.modes': 5, 'arm.damping_of': 'system'})


BARE = {'arm.length': 1.0, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
        'arm.density': 2710.0, 'arm.young_modulus': 70e9, 'arm.shear_modulus': 27e9,
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'model.static_modes': 'none'}


def at_rest(model, effects, causes):
    """Return static gains, shape (effects, causes)."""
    return model.select(causes, effects).frequency_response([0.0])[0].real


@pytest.mark.parametrize('hub', [0.0, 2.0])
def test_static_gains_are_those_of_a_cantilever_with_any_number_of_modes(hub):
    """Of bending, shear and, with axial modes, stretch; a push at 0.4 l bends the tip, too."""
    scene = timo_sim.load_scene({}, {**BARE, 'model.modes': 2, 'model.axial_modes': 1,
                                     'hub.radius': hub, 'push.position': 0.4})
    section, a = scene.manipulator.arm.section, 0.4
    bend, shear, pull = (1.0 / section.bending_stiffness, 1.0 / section.shear_stiffness,
                         1.0 / section.axial_stiffness)
    across = [bend / 3.0 + shear, bend / 2.0, bend * a**2 * (3.0 - a) / 6.0 + shear * a]
    with pytest.warns(timo_sim.ModelWarning, match='gyro_rad_per_s .* lacks .* tip_torque_N_m'):
        model = timo_sim.linearize(scene)
    found = at_rest(model, ['tip_transverse_m', 'tip_y_m', 'tip_angle_rad', 'tip_rotation_rad'],
                    ['tip_force_y_N', 'tip_torque_N_m', 'push_y_N'])
    turned = [bend / 2.0, bend, bend * a**2 / 2.0]
    assert found == pytest.approx(np.array([across, across, across, turned]), rel=1e-6)
    along = at_rest(model, ['tip_axial_m', 'tip_x_m'], ['tip_force_x_N', 'push_x_N'])
    assert along == pytest.approx(np.array([[pull, a * pull]] * 2), rel=1e-6)


@pytest.mark.parametrize('frequency', [0.3, 2.0, 15.0])
def test_a_gyro_turns_with_the_tip_or_the_model_says_that_it_does_not(frequency):
    """Static shapes have what a torque on a bare tip does to rates, which take no feedthrough."""
    scene = timo_sim.load_scene({}, {**BARE, 'model.modes': 5})
    turns = {}
    for static in 'none', 'both':
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter('always')
            model = timo_sim.linearize(scene.vary({'model.static_modes': static}))
        turns[static] = model.select(['tip_torque_N_m'], [
            'gyro_rad_per_s', 'tip_rotation_rad']).frequency_response([frequency])[0, :, 0]
        assert bool(told) == (static == 'none')
    gyro, rotation = turns['both']
    assert gyro == pytest.approx(2j * np.pi * frequency * rotation, rel=1e-6)
    gyro, rotation = turns['none']
    assert abs(gyro / (2j * np.pi * frequency * rotation) - 1.0) > 0.07


@pytest.mark.parametrize('cause, effect', [
    ('tip_torque_N_m', 'tip_rotation_rad'), ('push_y_N', 'gyro_rad_per_s')])
@pytest.mark.filterwarnings('error')
def test_a_linear_model_warns_of_no_output_that_nobody_wants(cause, effect, tmp_path):
    values = {**BARE, 'model.modes': 5, 'push.position': 0.4}
    scene = timo_sim.load_scene({}, values)
    for wanted, found in (([cause], [effect]), ([], None), (None, [])):
        model = timo_sim.linearize(scene, inputs=wanted, outputs=found)
        assert wanted in (None, [*model.inputs]) and found in (None, [*model.outputs])
    call('bode', 'paper', '--input', cause, '--response', effect, '--png', tmp_path / 'bode.png',
         *(f'--set={name}={value}' for name, value in values.items()))
    with pytest.raises(timo_sim.ParameterError, match="output 'gyro' is none of"):
        timo_sim.linearize(scene, outputs=['gyro'])


def test_modes_are_the_vibrations_of_the_linear_model_on_springs_of_presliding():
    """A rigid arm on the spring of its friction before it slides: `sqrt(limit / reach / J)`."""
    scene = timo_sim.load_scene({}, {
        **BARE, 'model.modes': 0, 'motor.shaft': 'free', 'motor.shaft_inertia': 0.1,
        'motor.coulomb_friction': 0.4, 'motor.coulomb_presliding': 0.02})
    inertia = scene.build().mass_matrix(scene.initial_motion())[0][2, 2]
    with pytest.warns(timo_sim.ModelWarning, match='spring of motions within coulomb_presliding'):
        found = timo_sim.modes(scene)
    assert found.omega == pytest.approx([np.sqrt(20.0 / inertia)], rel=1e-9)
    assert found.poles == pytest.approx(timo_sim.linearize(scene).poles()[1:], rel=1e-9)
