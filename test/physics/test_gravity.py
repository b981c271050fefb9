# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Gravity: elastica, free fall, momentum, equilibria and their vibrations, sensors, refusals."""

import numpy as np
import pytest

from oracles import elastica, references, spectral_elements
import timo_sim
from timo_sim.model import FORMULATIONS
from timo_sim.model.layout import LOADS
from timo_sim.simulation.simulator import Simulator
from timo_sim.topics.outputs import outputs

G = 9.81
DOWN = {'gravity': [0.0, -G]}
CLAMPED = {**DOWN, 'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.equilibrium': True}
HANGING = {**DOWN, 'carrier.held': 'both', 'initial.shaft': -np.pi / 2}


@pytest.mark.parametrize('height, tip, angle, static, least', [
    (0.0018, 0.0, 0.0, 'weight', 60.0), (0.002, 0.0, 0.4, 'weight', 60.0),
    (0.0022, 0.0, -0.5, 'weight', 35.0), (0.004, 0.3, 0.0, 'none', 45.0),
    (0.005, 0.3, -2.9, 'none', 25.0)])
def test_cantilever_under_its_own_weight_is_the_elastica(height, tip, angle, static, least):
    scene = timo_sim.load_scene({}, {
        **CLAMPED, 'arm.section.height': height, 'end_effector.mass': tip,
        'end_effector.inertia': 0.0,
        'initial.shaft': angle, 'model.modes': 8, 'model.static_modes': static})
    section, (along, across) = scene.manipulator.arm.section, (-np.sin(angle), -np.cos(angle))
    weight = G * np.array([along, across])
    truth = elastica.boundary_value(section, tip * weight, section.mass_per_length * weight)
    assert np.degrees(np.abs(truth[0])) > least
    x, y, turn = scene.build().tip(scene.initial_motion())
    # Measured: 4e-7 lengths; without the static shape 3e-6 where there is no end effector.
    assert np.abs([y / 2.0 - truth[1], 1.0 - x / 2.0 - truth[2]]).max() < 1e-6
    assert abs(turn - truth[0]) < 2e-5


@pytest.mark.parametrize('formulation', FORMULATIONS)
def test_free_fall_leaves_the_arm_straight(formulation):
    scene = timo_sim.load_scene({'gravity': [3.0, -G], 'model.formulation': formulation})
    run = timo_sim.simulate(scene, 1.0, estimate=False)
    fallen = 0.5 * run.t[:, np.newaxis]**2 * [3.0, -G]
    assert np.abs(run.carrier - fallen).max() < 1e-12 and np.ptp(run.shaft) < 1e-14
    assert np.abs(run.q).max() < 1e-14


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_who_falls_does_not_see_gravity(formulation):
    values = {'model.formulation': formulation, 'initial.shaft_velocity': 2.0,
              'initial.modal_rates': [0.5, 0.1, 0.0], 'load.torque.harmonic.amplitude': [5.0],
              'load.torque.harmonic.frequency': [1.0]}
    falling, still = (timo_sim.simulate(
        timo_sim.load_scene({}, {**values, 'gravity': gravity}), 1.0, estimate=False)
        for gravity in ([3.0, -G], [0.0, 0.0]))
    fallen = 0.5 * still.t[:, np.newaxis]**2 * [3.0, -G]
    assert np.abs(falling.carrier - still.carrier - fallen).max() < 1e-12
    assert np.abs(falling.q - still.q).max() < 1e-12


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_energy_of_a_pendulum(formulation):
    scene = timo_sim.load_scene({}, {**DOWN, 'carrier.held': 'both', 'initial.shaft': -0.8,
                                     'model.formulation': formulation})
    run = timo_sim.simulate(scene, 2.0, estimate=False)
    energy = run.energy()
    # `newton` leaves out what is of third order in the bend, here 1 J in 60 turns of the sign.
    bound = 1e-8 if formulation == 'exact' else 2e-2
    assert np.abs(energy - energy[0]).max() < bound * scene.build().mass * G
    body = scene.manipulator
    arm = body.arm.section.mass_per_length * 2.0
    assert energy[0] == pytest.approx(
        (arm + 2.0 * body.end_effector_mass) * G * np.sin(-0.8), rel=1e-12)


def test_a_clamped_arm_let_go_under_its_weight_against_finite_elements():
    """The tip sinks by a fifth of the arm; the stored reference is right to 1e-5 m."""
    run = timo_sim.simulate(timo_sim.load_scene({}, {
        **references.CANTILEVER, 'model.modes': 5, 'integrator.step': 0.001}), 3.0, 20,
        estimate=False)
    truth = references.read('cantilever')[1]['w_l_m']
    # Measured: 2.3e-4 m, of five modes; 2.7e-5 m with eight.
    assert run.deflection(10.0)[:, 1] == pytest.approx(truth, abs=3e-4) and truth.min() < -2.0


def test_a_swinging_arm_against_finite_elements():
    truth = references.read('pendulum')[1]
    run = timo_sim.simulate(timo_sim.load_scene(references.PENDULUM, {
        'model.modes': 5, 'model.axial_modes': 1}), 5.0, sample_every=10, estimate=False)
    # The reference is known to 1e-6 m.
    assert np.abs(run.shaft - truth['theta_rad']).max() < 2e-6
    assert np.abs(run.deflection(2.0)[:, 1] - truth['w_l_m']).max() < 5e-6


@pytest.mark.parametrize('held, gravity, angle', [
    ('x', [0.0, -G], 0.6), ('both', [4.0, -3.0], 2.0)])
def test_a_swinging_arm_against_spectral_elements(held, gravity, angle):
    scene = timo_sim.load_scene({'gravity': gravity, 'carrier.held': held, 'model.modes': 5,
                                 'initial.shaft': angle, 'model.axial_modes': 1,
                                 'motor.shaft': 'free'})
    run = timo_sim.simulate(scene, 1.0, sample_every=100, estimate=False)
    carrier, shaft, tip, _ = spectral_elements.simulate(scene, 0.1, 10, order=8, courant=0.9)
    assert np.abs(run.shaft - shaft).max() < 2e-6
    assert np.abs(run.position(2.0) - tip).max() < 4e-6


@pytest.mark.parametrize('values', [
    HANGING, {**HANGING, 'carrier.held': 'y'}, CLAMPED,
    {**CLAMPED, 'arm.section.height': 0.008, 'end_effector.mass': 0.3, 'initial.shaft': 0.4}],
    ids=['hanging', 'hanging, x free', 'clamped', 'far bent'])
def test_vibrations_about_an_equilibrium(values):
    scene = timo_sim.load_scene({}, {**values, 'model.modes': 8, 'initial.equilibrium': True})
    tip, truth = spectral_elements.equilibrium(scene)
    motion = scene.initial_motion()
    found = scene.build().world(motion[np.newaxis], scene.build().tip_point)[0, 0]
    # The elements stretch, by 1e-6 of the length under the weight; the model does not.
    assert np.abs(found - tip[:2]).max() < 4e-6
    assert timo_sim.modes(scene).frequency[:4] == pytest.approx(truth[truth > 1e-3][:4], rel=2e-5)


def test_equilibria_are_stable_ones():
    upright = {**HANGING, 'initial.shaft': np.pi / 2, 'initial.equilibrium': True}
    # The shaft tips over; a locked one bears its straight arm until it buckles.
    assert np.sin(timo_sim.load_scene({}, upright).initial_motion()[2]) == pytest.approx(-1.0)
    locked = {**upright, 'motor.shaft': 'locked', 'end_effector.mass': 0.0,
              'end_effector.inertia': 0.0, 'model.modes': 8}
    section = timo_sim.load_scene({}, locked).manipulator.arm.section
    # Greenhill's column under its own weight, 7.837 E I / (rho A g l^3); shear makes it 1e-4 less.
    critical = 7.8373 * section.bending_stiffness / section.mass_per_length / 2.0**3
    for share, bends in ((0.999, False), (1.001, True)):
        scene = timo_sim.load_scene({}, {**locked, 'gravity': [0.0, -share * critical]})
        assert (np.abs(scene.initial_motion()[3]) > 1e-3) == bends


def test_forces_that_hold_an_arm_at_rest():
    scene = timo_sim.load_scene({}, {**CLAMPED, 'initial.shaft': 0.3})
    simulator = timo_sim.Simulator(scene)
    body = scene.manipulator
    arm, tip = body.arm.section.mass_per_length * 2.0, body.end_effector_mass
    model, motion = scene.build(), scene.initial_motion()
    place = model.world(motion[np.newaxis], model.points)[0]
    torque = G * model.point_mass @ place[:, 0]
    assert simulator.effort == pytest.approx([0.0, (10.0 + arm + tip) * G, torque], abs=1e-9)
    # An accelerometer at rest shows what holds it, one that falls nothing.
    turned = 0.3 + model.tip(motion)[2]
    assert simulator.sensors.tip_acceleration == pytest.approx(
        [G * np.sin(turned), G * np.cos(turned)], abs=1e-6)
    # The topic has the third axis, too: nothing of the Earth's gravity is left for it.
    imu = next(output for output in outputs(3) if output.name == '~/tip_imu/data_raw')
    for gravity, along_z in (([0.0, -9.80665], 0.0), ([0.0, 0.0], 9.80665),
                             ([3.0, 4.0], 8.436254)):
        scene = timo_sim.load_scene({'gravity': gravity})
        assert imu.unlogged(Simulator(scene).snapshot())[0] == pytest.approx(along_z, abs=1e-5)
    falling = timo_sim.Simulator(timo_sim.load_scene({}, DOWN))
    falling.step(duration=0.1)
    assert falling.sensors.tip_acceleration == pytest.approx([0.0, 0.0], abs=1e-6)


def test_the_sag_that_modes_leave_out_is_estimated():
    scene = timo_sim.load_scene({}, {**CLAMPED, 'initial.shaft': 0.0})
    run = timo_sim.simulate(scene, 0.1)
    section, body = scene.manipulator.arm.section, scene.manipulator
    truth = elastica.boundary_value(section, -G * body.end_effector_mass,
                                    -G * section.mass_per_length)
    error = abs(run.deflection(2.0)[0, 1] - 2.0 * truth[1])
    assert 0.5 < run.stats['estimated_tip_error_m'] / error < 2.0


def test_the_axial_force_that_newton_leaves_out_is_that_of_an_accelerated_carrier():
    held = timo_sim.load_scene({}, {**HANGING, 'model.formulation': 'newton'}).build()
    pushed = timo_sim.load_scene({'model.formulation': 'newton', 'initial.shaft': -np.pi / 2})
    pushed, load = pushed.build(), np.zeros(LOADS)
    load[1] = pushed.mass * G
    motion = np.zeros(held.size)
    motion[2] = -np.pi / 2
    share = pushed.axial_share(pushed.state(motion), load)
    assert held.axial_share(held.state(motion), np.zeros(LOADS)) == pytest.approx(share, rel=1e-9)
    assert share > 0.04


@pytest.mark.parametrize('share, holds', [(2.02, True), (0.99, False)])
def test_dry_friction_holds_an_arm_up_to_its_weight(share, holds):
    """Which acts suddenly and bends the bristle twice as far as it does slowly."""
    locked = timo_sim.load_scene({}, {**CLAMPED, 'initial.shaft': 0.3})
    torque, start = Simulator(locked).effort[2], locked.initial_motion()
    scene = timo_sim.load_scene({}, {
        **DOWN, 'carrier.held': 'both', 'motor.coulomb_friction': share * torque,
        'initial.shaft': 0.3, 'initial.modal_coordinates': start[3:6]})
    run = timo_sim.simulate(scene, 1.0, estimate=False)
    assert (np.abs(run.shaft - 0.3).max() < 1e-3) == holds


@pytest.mark.parametrize('values, words', [
    ({'gravity': [1.0]}, 'gravity must have 2 elements'),
    ({**DOWN, 'initial.equilibrium': True}, 'the carrier is free along y'),
    ({'carrier.held': 'both', 'initial.equilibrium': True, 'load.torque.piecewise.time': [0.0],
      'load.torque.piecewise.value': [1.0]}, 'no equilibrium was found'),
    ({**CLAMPED, 'initial.modal_rates': [1.0, 0.0, 0.0]},
     'initial.modal_rates must be empty or 0'),
    ({**CLAMPED, 'motor.shaft': 'free', 'initial.shaft_velocity': 1.0},
     'initial.shaft_velocity must be empty or 0')])
def test_what_is_refused(values, words):
    with pytest.raises(timo_sim.ParameterError, match=words):
        timo_sim.load_scene({}, values).initial_motion()
