# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sensors: measured quantities against closed forms and differences, noise by its statistics."""

import numpy as np
import pytest
from scipy import stats

import timo_sim
from timo_sim.model import FORMULATIONS
from timo_sim.model.layout import place, rotate
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.snapshot import reading
from timo_sim.steps.sensors import normal, philox
from timo_sim.topics.cdr import form
from timo_sim.topics.outputs import IMU, outputs, SENSORS

MOVING = {'initial.shaft_velocity': 2.0, 'initial.modal_rates': [2.0, 0.5, 0.1]}
STEPS = 20000
GYRO = 2  # among the sensors, whose random numbers depend on it


def measured(simulator):
    """Return the numbers of the sensors' messages by topic."""
    snapshot = simulator.snapshot()
    return {output.name: np.array(output.numbers(snapshot))
            for output in outputs(simulator.scene.values['model.modes']) if output.delay}


def test_sensors_print_their_readings():
    sensors = timo_sim.Simulator('paper').sensors
    assert f'encoder = {sensors.encoder}' in repr(sensors) and ' at 0x' not in repr(sensors)


def test_each_topic_and_sensor_has_its_own_name_and_all_numbers_of_its_message():
    scene = timo_sim.load_scene({'motor.gear.stiffness': 900.0, 'motor.rotor.inertia': 0.5,
                                 'sensor.tip_imu.position': 0.5})
    snapshot = Simulator(scene).snapshot()
    for output in (*scene.outputs, scene.transforms):
        found = *output.numbers(snapshot), *output.unlogged(snapshot)
        assert len(found) == len(form(output.type_name, output.template)[2]), output.name
    for names in [each.name for each in SENSORS], [each.name for each in scene.outputs]:
        assert len({*names}) == len(names)


def test_an_imu_within_the_arm_has_a_frame_there():
    scene = timo_sim.load_scene({}, {**MOVING, 'sensor.tip_imu.position': 0.5})
    simulator = Simulator(scene)
    snapshot = simulator.snapshot()
    x, y, sine, cosine = scene.transforms.unlogged(snapshot)[-4:]
    assert [*place(*snapshot.joint_positions, x, y)] == pytest.approx(simulator.position(0.5))
    assert 2.0 * np.arctan2(sine, cosine) == pytest.approx(simulator.rotation(0.5))
    imu, = (output.template for output in scene.outputs if output.name == IMU)
    frame = scene.transforms.template['transforms'][-1]['child_frame_id']
    assert imu['header']['frame_id'] == frame == 'arm_imu'


@pytest.mark.parametrize('name', [*FORMULATIONS, 'driven'])
def test_acceleration_is_the_second_difference_of_the_tips_position(name, paper, spin_up):
    """At the end of a step of a motion under loads, also with a driven shaft."""
    scene = timo_sim.load_scene(spin_up) if name == 'driven' else timo_sim.load_scene(
        paper, {'model.formulation': name, **MOVING})
    scene = scene.vary({'integrator.step': 5e-4})
    length = scene.manipulator.arm.length
    simulator, ahead = (Simulator(scene) for _ in range(2))
    simulator.advance(8000)
    ahead.advance(8000 - 24)
    formulation, (motions, _) = simulator.model, ahead.advance(48, sample_every=1)
    place = formulation.world(motions, formulation.at([length]))[:, 0]
    found = np.array(rotate(simulator.motion.shaft + simulator.rotation(),
                            *simulator.sensors.tip_acceleration))

    def error(weights, stride):
        half = len(weights) // 2
        at = place[24 - half * stride:25 + half * stride:stride]
        return np.linalg.norm(weights @ at / (stride * scene.step)**2 - found)

    second = [error(np.array([1.0, -2.0, 1.0]), stride) for stride in (8, 4, 2)]
    # The observed order is 2 as long as this error is above that of the motion.
    assert np.array(second[:-1]) / second[1:] == pytest.approx([4.0, 4.0], rel=0.1)
    sixth = np.array([1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90])
    # Measured: 3e-9 to 7e-9, the round-off of positions divided by the square of the step.
    assert error(sixth, 1) < 2e-8 * np.linalg.norm(found)


@pytest.mark.parametrize('place', [0.0, 0.5])
@pytest.mark.parametrize('formulation', FORMULATIONS)
def test_gauge_and_imu_on_a_rigid_arm(formulation, place):
    """The acceleration of a free body under a torque, and the moment that it needs beyond."""
    turning, torque = 3.0, 4.0
    scene = timo_sim.load_scene({
        'model.modes': 0, 'model.formulation': formulation, 'initial.shaft_velocity': turning,
        'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [torque],
        'sensor.root_strain.position': place, 'sensor.tip_imu.position': place})
    body, length = scene.manipulator, 2.0
    imu = place or length
    beam = body.arm.section.mass_per_length * length
    total = body.base_mass + beam + body.end_effector_mass
    centre = (0.5 * beam + body.end_effector_mass) * length / total
    inertia = (body.shaft_inertia + body.end_effector_inertia + body.end_effector_mass * length**2
               + beam * length**2 / 3.0
               + body.arm.section.inertia_per_length * length - total * centre**2)
    simulator = Simulator(scene)
    for _ in range(2):
        speed = turning + torque / inertia * simulator.steps * scene.step
        found = measured(simulator)
        assert found['~/tip_imu/data_raw'] == pytest.approx([
            -(imu - centre) * speed**2, (imu - centre) * torque / inertia, speed],
            rel=1e-9, abs=1e-9)
        assert found['~/encoder'][0] == simulator.motion.values[2]
        # A rigid arm has no strain; the sensor shows that of a nearly rigid one with its moment.
        section, rest = body.arm.section, length - place
        moment = -torque / inertia * (
            body.end_effector_inertia + section.inertia_per_length * rest
            + body.end_effector_mass * rest * (length - centre)
            + beam / length * rest**2 * (rest / 3.0 + 0.5 * (place - centre)))
        assert found['~/root_strain'][0] == pytest.approx(
            0.5 * section.height * moment / section.bending_stiffness, rel=1e-8)
        simulator.advance(700)


@pytest.mark.parametrize('formulation', FORMULATIONS)
@pytest.mark.parametrize('load, shares', [
    ({'tip_force_y': 0.1}, (0.7, 0.4)), ({'tip_torque': 0.1}, (1.0, 1.0)),
    ({'push_y': 0.1}, (0.25, 0.0)), ({'gravity': [0.0, -0.1]}, (0.49, 0.16))])
def test_strain_within_a_cantilever_is_that_at_the_root_times_its_share(formulation, load, shares):
    """At 0.3 and 0.6 of its length, with a push at 0.4; one mode has none of these curvatures."""
    (name, value), = load.items()
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'motor.shaft': 'locked', 'model.modes': 1, 'initial.shaft': 0.0,
        'model.static_modes': 'none', 'model.formulation': formulation, 'push.position': 0.8,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'initial.equilibrium': True,
        'initial.shaft_velocity': 0.0, **(load if name == 'gravity' else {
            f'load.{name}.piecewise.time': [0.0], f'load.{name}.piecewise.value': [value]})})
    root, *within = (Simulator(scene.vary({'sensor.root_strain.position': xi})).sensors.root_strain
                     for xi in (0.0, 0.6, 1.2))
    # The tip moves along the arm by (w / l)^2, which `exact` knows.
    assert np.array(within) / root == pytest.approx(shares, abs=1e-4)


@pytest.mark.parametrize('values', [
    {'motor.gear.stiffness': 900.0, 'motor.rotor.inertia': 0.5, 'motor.coulomb_friction': 0.5,
     'initial.modal_rates': [2.0, 0.5, 0.1, 0.3], 'end_effector.offset': 0.2},
    {'motor.spring.stiffness': 30.0, 'hub.radius': 0.2, 'motor.shaft': 'locked',
     'initial.shaft_velocity': 0.0},
    {'carrier.held': 'y', 'model.axial_modes': 1, 'initial.modal_rates': [2.0, 0.5, 0.1, 0.01]},
    {'model.formulation': 'newton', 'carrier.held': 'x', 'hub.radius': 0.2}], ids=str)
def test_a_gauge_next_to_the_root_reads_what_one_at_the_root_does(values):
    """The balance of what is beyond the gauge is that of shaft and carrier."""
    scene = timo_sim.load_scene({}, {
        **MOVING, 'gravity': [1.0, -9.0], 'arm.damping_ratio': [0.02], 'push.position': 0.7,
        'load.push_y.piecewise': {'time': [0.0], 'value': [1.0]}, **values})
    strains = []
    for xi in (0.0, 1e-7):
        simulator = Simulator(scene.vary({'sensor.root_strain.position': xi}))
        simulator.advance(50)
        strains.append(simulator.sensors.root_strain)
    assert strains[1] == pytest.approx(strains[0], rel=1e-6) and abs(strains[0]) > 1e-5


@pytest.mark.parametrize('formulation', FORMULATIONS)
def test_root_strain_follows_from_the_moment_on_the_shaft(formulation):
    """The moment is J_m theta'' minus torque and friction; differences of fourth order."""
    torque, friction = 1.5, 0.5
    scene = timo_sim.load_scene({}, {
        'model.formulation': formulation, **MOVING, 'motor.viscous_friction': friction,
        'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [torque]})
    simulator, section = Simulator(scene), scene.manipulator.arm.section
    speeds, strains = [], []
    for _ in range(301):
        simulator.advance(1)
        speeds.append(simulator.motion.shaft_velocity)
        strains.append(measured(simulator)['~/root_strain'][0])
    speeds = np.array(speeds)
    second = (speeds[:-4] - 8 * speeds[1:-3] + 8 * speeds[3:-1] - speeds[4:]) / (12 * scene.step)
    moment = scene.manipulator.shaft_inertia * second - torque + friction * speeds[2:-2]
    expected = 0.5 * section.height * moment / section.bending_stiffness
    assert np.abs(expected).max() > 1e-4
    # The error of the difference is (190 rad/s x 1 ms)^4 / 30 of the third mode's share.
    assert strains[2:-2] == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())


@pytest.mark.parametrize('formulation', FORMULATIONS)
def test_strain_under_a_constant_force_is_that_of_statics(formulation):
    """Of a locked arm, damped to rest: F l h / (2 E I), and no acceleration."""
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0,
        'arm.damping_ratio': [0.7], 'load.tip_force_y.piecewise.time': [0.0],
        'model.formulation': formulation, 'load.tip_force_y.piecewise.value': [1e-3]})
    simulator, section = Simulator(scene), scene.manipulator.arm.section
    simulator.advance(20000)
    found = measured(simulator)
    statics = 1e-3 * 2.0 * section.height / (2.0 * section.bending_stiffness)
    assert found['~/root_strain'][0] == pytest.approx(statics, rel=1e-8)
    assert found['~/tip_imu/data_raw'] == pytest.approx(np.zeros(3), abs=1e-9)
    assert simulator.effort == pytest.approx([0.0, -1e-3, -2e-3], rel=1e-8, abs=1e-11)


def noise_of(sensor, steps=range(STEPS), axes=1, **changed):
    """Return readings of zeros by a sensor with unit noise, one row for each axis."""
    scene = timo_sim.load_scene({f'sensor.{sensor}.noise': 1.0, **changed})
    return np.array([reading(scene, sensor, step, [0.0] * axes) for step in steps]).T


def test_random_bits_are_those_of_the_authors_of_philox():
    """Known answers of Random123, kat_vectors."""
    pi = [0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344, 0xa4093822, 0x299f31d0]
    for given, answer in ((6 * [0], '6627e8d5 e169c58d bc57ac4c 9b00dbd8'),
                          (6 * [0xffffffff], '408f276d 41c83b0e a20bc7c6 6d5451fd'),
                          (pi, 'd16cfe09 94fdcceb 5001e420 24126ea1')):
        assert ' '.join(f'{word:08x}' for word in philox(*given)) == answer


def test_noise_is_white_normal_and_independent():
    rows = np.vstack([noise_of('tip_acceleration', axes=2), noise_of('root_strain'),
                      noise_of('gyro'), noise_of('encoder'),
                      noise_of('gyro', **{'sensor.seed': 1})])
    # Four times the standard error of each estimate; seeds are fixed, so the test is repeatable.
    assert np.abs(rows.mean(axis=1)).max() < 4.0 / np.sqrt(STEPS)
    assert np.abs(rows.std(axis=1) - 1.0).max() < 4.0 / np.sqrt(2.0 * STEPS)
    assert np.abs((np.abs(rows) > 1.96).mean(axis=1) - 0.05).max() < 4.0 * np.sqrt(0.0475 / STEPS)
    assert np.abs(np.corrcoef(rows) - np.eye(len(rows))).max() < 4.0 / np.sqrt(STEPS)
    assert min(stats.kstest(row, 'norm').pvalue for row in rows) > 1e-3
    for lag in (1, 256):
        assert np.abs((rows[:, lag:] * rows[:, :-lag]).mean(axis=1)).max() < 4.0 / np.sqrt(STEPS)


def test_noise_depends_on_the_step_and_not_on_earlier_readings():
    steps = [3, 2**40, 0, 255, 256, 70000, 3]
    at_once, backwards = noise_of('gyro', steps)[0], noise_of('gyro', steps[::-1])[0]
    assert np.array_equal(at_once, backwards[::-1]) and len(set(at_once)) == len(steps) - 1
    # Machine code has the bits of Python.
    assert at_once.tolist() == [normal(0, 2 * GYRO, step) for step in steps]
    # The noise of one axis does not depend on the other.
    both = noise_of('tip_acceleration', steps, axes=2)
    assert np.array_equal(both[0], noise_of('tip_acceleration', steps)[0])


def test_bias_noise_and_resolution_in_this_order():
    scene = timo_sim.load_scene({'sensor.encoder.bias': 0.3, 'sensor.encoder.noise': 0.1,
                                 'sensor.encoder.resolution': 0.25})
    found = [reading(scene, 'encoder', step, [5.0])[0] for step in range(200)]
    random = noise_of('encoder', range(200))[0]
    assert found == [0.25 * round((5.3 + 0.1 * number) / 0.25) for number in random]
    assert len(set(found)) > 2


@pytest.mark.parametrize('resolution', [5e-324, 1e-300, 1e-17])
def test_a_resolution_below_that_of_numbers_rounds_nothing(resolution):
    scene = timo_sim.load_scene({'sensor.gyro.resolution': resolution})
    assert reading(scene, 'gyro', 0, [1e8]) == (1e8,)


def test_a_delay_that_does_not_fit_the_step_is_refused_with_the_ratio():
    with pytest.raises(timo_sim.ParameterError, match=(
            'sensor.tip_imu.delay = 0.0025 must be a whole multiple of integrator.step = 0.001, '
            'the ratio is 2.5')):
        timo_sim.load_scene({'sensor.tip_imu.delay': 0.0025})
