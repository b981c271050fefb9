# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Static shapes of loads on a light tip: the arc of a clamped arm under a tip torque."""


import numpy as np
import pytest

from oracles.elastica import boundary_value
import timo_sim
from timo_sim.model.modes import modes_of
from timo_sim.scene.static_shapes import _missing, _of_tip
from timo_sim.simulation.finer import refine

BARE = {'arm.length': 1.0, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
        'arm.density': 2700.0, 'arm.young_modulus': 7e10, 'arm.shear_modulus': 2.6e10,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'carrier.held': 'both',
        'motor.shaft': 'locked', 'initial.shaft': 0.0}
HEAVY = {'end_effector.mass': 2.0, 'end_effector.inertia': 0.5}
TURN = 0.6  # of the tip [rad]


def arc(scene, turn=TURN):
    """Return the torque that turns the tip by an angle [N m], and the tip of the arc [m]."""
    arm = scene.manipulator.arm
    return (turn * arm.section.bending_stiffness / arm.length,
            arm.length * np.array([np.sin(turn), 1.0 - np.cos(turn)]) / turn)


def soft_in_shear(ratio):
    """Return overrides of BARE with kappa G A L^2 / (E I) = `ratio`."""
    section = timo_sim.load_scene('paper', BARE).manipulator.arm.section
    return {'arm.shear_modulus': BARE['arm.shear_modulus'] * ratio * section.bending_stiffness
            / section.shear_stiffness}


@pytest.mark.parametrize('modes, shear', [
    (3, {}), (3, soft_in_shear(20.0)), (36, {})], ids=['few', 'few, soft in shear', 'many'])
@pytest.mark.parametrize('static', ['auto', 'none'])
def test_the_estimate_under_a_tip_torque_is_the_distance_to_the_arc(modes, static, shear):
    values = {**BARE, **shear, 'initial.equilibrium': True, 'model.modes': modes,
              'model.static_modes': static, 'load.tip_torque.piecewise.time': [0.0]}
    torque, tip = arc(timo_sim.load_scene('paper', {**BARE, **shear}))
    run = timo_sim.simulate(timo_sim.load_scene(
        'paper', {**values, 'load.tip_torque.piecewise.value': [torque]}), 0.02)
    error, estimate = np.hypot(*(run.position()[-1] - tip)), run.stats['estimated_tip_error_m']
    if static == 'auto':
        assert error < 2e-8 and estimate < 2e-8
    else:
        assert 0.5 < estimate / error < 2.0 and error > 1e-5
        assert error < 5e-4 or 'model.static_modes auto' in run.warning


@pytest.mark.parametrize('modes, share', [(16, 1e-3), (36, 1e-4)])
def test_many_modes_that_need_no_shape_are_compared_with_a_run_that_has_it(modes, share):
    """A tip of a thousandth of the arm: two more modes would see a third of the error."""
    tip = {'end_effector.mass': 0.81 * share, 'end_effector.inertia': 0.081 * share}
    scene = timo_sim.load_scene({}, {**BARE, **tip, 'model.modes': modes})
    torque, end = arc(scene)
    run = timo_sim.simulate(scene.vary({
        'initial.equilibrium': True, 'load.tip_torque.piecewise.time': [0.0],
        'load.tip_torque.piecewise.value': [torque]}), 0.004)
    error = np.hypot(*(run.position()[-1] - end))
    assert scene.static == () and 1e-7 < error < 1e-4
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.05)


@pytest.mark.parametrize('modes, turn', [(3, TURN), (4, TURN), (5, 3.0 * TURN)])
def test_one_more_mode_shows_the_error_of_an_arm_with_a_heavy_tip(modes, turn):
    """The first mode that is left out has most of the error."""
    scene = timo_sim.load_scene('paper', {**BARE, **HEAVY, 'model.modes': modes})
    torque, end = arc(scene, turn)
    run = timo_sim.simulate(scene.vary({
        'initial.equilibrium': True, 'load.tip_torque.piecewise.time': [0.0],
        'load.tip_torque.piecewise.value': [torque]}), 0.004)
    finer, error = refine(scene, 2), np.hypot(*(run.position()[-1] - end))
    assert finer.values['model.modes'] == modes + 1 and finer.static == () and error > 1e-7
    assert 0.5 < run.stats['estimated_tip_error_m'] / error < 1.1


def test_shapes_follow_the_modes_and_only_a_light_tip_has_them():
    light, heavy = (timo_sim.load_scene('paper', {**BARE, **tip}) for tip in ({}, HEAVY))
    assert light.static == ('torque',) and heavy.static == ()
    assert timo_sim.load_scene('paper', {**BARE, **soft_in_shear(20.0)}).static == (
        'force', 'torque')
    clamped = light.vary({'model.static_modes': 'none'}).build().modes.omega
    np.testing.assert_array_equal(light.build().modes.omega[:3], clamped)
    bent = light.vary({'initial.modal_coordinates': [0.1, 0.0, 0.0]})
    assert bent.modal_count == 4 and bent.initial_motion()[6] == 0.0


@pytest.mark.parametrize('static', [(), ('torque',), ('force',), ('force', 'torque')], ids=str)
@pytest.mark.parametrize('tip', [{}, HEAVY], ids=['bare', 'heavy'])
def test_what_modes_and_shapes_leave_out_of_responses_is_known_before_shapes_are(static, tip):
    body = timo_sim.load_scene('paper', {**BARE, **tip}).manipulator
    modes = modes_of(body, 3, static)
    shapes = np.concatenate([modes.deflection(np.ones(1)), modes.rotation(np.ones(1))])
    left = 1.0 - shapes / modes.omega**2 @ shapes.T / _of_tip(body.arm)[0]
    np.testing.assert_allclose(_missing(body, 3, static), np.abs(left), rtol=1e-9, atol=1e-11)


def test_commands_bend_a_light_tip_to_the_arc():
    """By Simulator.step and by Batch.step, whose scenes have the shapes that any of them needs."""
    light = timo_sim.load_scene('paper', {**BARE, 'arm.damping_ratio': [0.3]})
    torque, tip = arc(light)
    simulator = timo_sim.Simulator(light)
    simulator.step(tip_torque=torque, duration=3.0)
    batch = timo_sim.Batch([light, light.vary(HEAVY)])
    batch.step(tip_torque=torque, duration=3.0)
    assert batch.scenes[1].static == ('torque',)
    # Measured: 8e-9; vibrations decay to exp(-0.3 52 3) = 5e-21 of the bend.
    assert np.hypot(*(simulator.position() - tip)) < 1e-7
    assert np.hypot(*(batch.position()[0] - tip)) < 1e-7


def test_a_changed_end_effector_keeps_the_shapes():
    simulator = timo_sim.Simulator(timo_sim.load_scene('paper', BARE))
    simulator.change(simulator.scene.vary(HEAVY))
    assert simulator.scene.static == ('torque',) and len(simulator.step().q) == 4


@pytest.mark.parametrize('static', ['auto', 'both'])
def test_two_shapes_of_a_sandwich_arm_do_not_resonate_with_the_step(static):
    """Under a sudden force, of 0.3 m; the second shape has 24 rad in a step of 1 ms."""
    scene = timo_sim.load_scene('paper', {
        **BARE, **soft_in_shear(11.0), 'model.modes': 5, 'model.static_modes': static,
        'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value': [120.0]})
    coarse, fine = (timo_sim.simulate(scene.vary({'integrator.step': step}), 0.5, every)
                    for step, every in ((1e-3, 1), (1e-4, 10)))
    # Measured: 0.004 m; undamped at its own frequency the shape put the run of 1 ms 0.11 m off.
    # The finer run of 1 ms has no vibration of the shapes, either: it sees half of the error.
    error = np.hypot(*(coarse.position() - fine.position()).T).max()
    assert error < 0.006 and 0.4 < coarse.stats['estimated_tip_error_m'] / error < 2.0
    assert 'smaller integrator.step' in coarse.warning


@pytest.mark.parametrize('ratio', [5.0, 20.0])
def test_the_estimate_of_an_arm_soft_in_shear_is_its_distance_to_the_elastica(ratio):
    """An axial force turns the shear force; no mode, of however many, has the shear of that."""
    scene = timo_sim.load_scene({}, {**BARE, **soft_in_shear(ratio), 'model.modes': 5,
                                     'initial.equilibrium': True})
    force = 2.0 * scene.manipulator.arm.section.bending_stiffness
    _, across, short = boundary_value(scene.manipulator.arm.section, force, 0.0, 1.0,
                                      stretches=True)
    run = timo_sim.simulate(scene.vary({'load.tip_force_y.piecewise.time': [0.0],
                                        'load.tip_force_y.piecewise.value': [force]}), 0.004)
    error = np.hypot(*(run.position()[-1] - [1.0 - short, across]))
    assert error > 1e-4  # measured: 6.5e-3, 2.4e-4
    assert 0.9 < run.stats['estimated_tip_error_m'] / error < 1.1
    assert error < 6e-4 or run.warning.endswith('equations alone mends that')


def test_a_rigid_arm_has_no_shape_of_shear():
    """A tip torque on a rigid arm whose section is soft in shear turns all as one body."""
    scene = timo_sim.load_scene({}, {
        'model.modes': 0, 'arm.section.bending_stiffness': 50.0,
        'arm.section.shear_stiffness': 50.0, 'arm.section.mass_per_length': 1.0,
        'load.torque.harmonic.amplitude': [], 'load.tip_torque.piecewise.time': [0.0],
        'load.tip_torque.piecewise.value': [1.0]})
    run = timo_sim.simulate(scene, 0.1)
    # A rigid body: the run and its finer run differ by the error of the steps alone.
    assert run.stats['estimated_tip_error_m'] < 1e-9
