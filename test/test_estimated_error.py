# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The distance from a finer run is the error, by finite elements and by finer steps."""

import math

import numpy as np
from oracles import elastica, spectral_elements
import pytest
import timo_sim
from timo_sim.runs.run import run_scene
from timo_sim.simulation.finer import choose_parts, refine

# A free arm that turns fast, a stroke on the tip of an arm with one mode, an axial force.
STROKE = {'load.tip_torque.piecewise.time': [0.1, 0.12],
          'load.tip_torque.piecewise.value': [60.0, 0.0]}
PULL = {'model.formulation': 'newton', 'carrier.held': 'both', 'motor.shaft': 'locked',
        'initial.shaft': 0.0, 'load.tip_force_x.piecewise.time': [0.0],
        'load.tip_force_x.piecewise.value': [400.0], 'load.tip_force_y.piecewise.time': [0.0],
        'load.tip_force_y.piecewise.value': [10.0]}
# A light, soft arm with dry friction: scene 491 of the stress test.
DRY = {'integrator.step': 0.002, 'arm.length': 0.329, 'arm.section.height': 0.00213,
       'arm.section.width': 0.00331,
       'arm.density': 1970.0, 'arm.young_modulus': 2.87e8, 'arm.shear_modulus': 1.96e7,
       'arm.section.shear_correction': 0.592, 'arm.damping_ratio': [0.0],
       'end_effector.mass': 5.68e-05,
       'end_effector.inertia': 0.000249, 'carrier.mass': 1.53, 'motor.mass': 0.000725,
       'motor.shaft_inertia': 0.000352, 'carrier.coulomb_friction': 0.000397,
       'motor.coulomb_friction': 0.00314, 'initial.shaft': 1.97, 'initial.shaft_velocity': -2.78,
       'initial.carrier_y_velocity': -0.00537,
       'load.torque.table.time': [0.875, 1.0, 1.2],
       'load.torque.table.value': [0.0, -0.0012, 0.0],
       'load.tip_torque.table.time': [0.0825, 0.227, 0.444],
       'load.tip_torque.table.value': [0.0, -0.00186, 0.0]}
# An arm that stretches, starts at full speed and is pushed.
ABRUPT = {'carrier.held': 'both', 'model.modes': 5, 'model.axial_modes': 1,
          'integrator.step': 0.005, 'initial.shaft_velocity': 10.0,
          'load.tip_force_y.piecewise.time': [0.0, 0.1],
          'load.tip_force_y.piecewise.value': [20.0, 0.0]}
# Arms that stretch as they turn, with steps of 11 rad of the first axial vibration in a half.
TURN = {'spun up': {'load.torque.table.time': [0.0, 0.3, 0.6],
                    'load.torque.table.value': [0.0, 400.0, 0.0]},
        'one axis held': {'carrier.held': 'x', 'initial.shaft_velocity': 5.0}}
SCENES = {'stretch': {'initial.shaft_velocity': 20.0}, 'modes': {'model.modes': 1, **STROKE},
          'formulation': PULL}


# The arm buckles under a force along it, or stands near its critical load.
GROWS = {
    'buckles': ({
        'arm.length': 2.2482, 'arm.section.height': 0.066878, 'arm.section.width': 0.16744,
        'arm.density': 1600.0,
        'arm.young_modulus': 60000000000.0, 'arm.shear_modulus': 4000000000.0,
        'carrier.mass': 149.05, 'motor.mass': 24.856, 'motor.shaft_inertia': 18.618,
        'end_effector.mass': 13.397, 'end_effector.inertia': 0.012546, 'initial.shaft':
        0.0, 'motor.shaft': 'locked', 'carrier.held': 'y', 'load.tip_force_x.table.time':
        [0.0, 0.276], 'load.tip_force_x.table.value': [0.0, -159030.0],
        'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value':
        [464.99], 'model.modes': 3, 'model.axial_modes': 1, 'integrator.step': 0.00023}, 4000),
    'stands': ({
        'arm.length': 0.9699, 'arm.section.height': 0.036018, 'arm.section.width': 0.068316,
        'arm.density': 1200.0,
        'arm.young_modulus': 2400000000.0, 'arm.shear_modulus': 900000000.0,
        'carrier.mass': 0.98723, 'motor.mass': 1.7494, 'motor.shaft_inertia': 0.15888,
        'end_effector.mass': 1.257, 'end_effector.inertia': 0.00026731, 'initial.shaft':
        1.5720106365574924, 'motor.shaft': 'locked', 'carrier.held': 'both', 'gravity':
        [0.0, -681.69], 'load.tip_force_x.piecewise.time': [0.0, 0.3276],
        'load.tip_force_x.piecewise.value': [31.885, 0.0], 'model.modes': 5,
        'model.axial_modes': 0, 'integrator.step': 0.00063}, 2600),
}
SHARED = {'initial.shaft_velocity': 20.0, 'model.modes': 3}


def simulate(values, duration, every=5, **options):
    return timo_sim.simulate(timo_sim.load_scene({}, values), duration, every, **options)


@pytest.mark.parametrize('name', SCENES)
def test_the_error_is_the_distance_from_finite_elements(name):
    run = simulate(SCENES[name], 0.5)
    tip = spectral_elements.simulate(run.scene, 0.005, 100, order=8, courant=0.9)[2]
    error = np.linalg.norm(run.position(2.0) - tip, axis=1).max()
    assert error > 1e-5
    # Three further modes and one axial mode give most, but not all, of the error.
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.2)
    assert (run.warning is not None) == (error > 1.2e-3)  # 6e-4 of the arm's length


def test_steps_that_do_not_resolve_axial_vibrations():
    run = simulate(ABRUPT, 1.0)
    tip = spectral_elements.simulate(run.scene, 0.025, 40, order=8, courant=0.9)[2]
    error = np.linalg.norm(run.position(2.0) - tip, axis=1).max()
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.5)


@pytest.mark.parametrize('name', TURN)
def test_stretch_is_measured_by_steps_that_do_not_resolve_axial_vibrations(name):
    """Without an axial mode the estimate would be a tenth of the error."""
    run = simulate({**TURN[name], 'integrator.step': 0.01}, 0.6, 1)
    assert choose_parts(run.scene)[0] == 2
    tip = spectral_elements.simulate(run.scene, 0.01, 60, order=8, courant=0.9)[2]
    error = np.linalg.norm(run.position(2.0) - tip, axis=1).max()
    assert error > 1e-5
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.2)


@pytest.mark.parametrize('name', GROWS)
def test_errors_that_grow_are_measured(name):
    """Against spectral elements, in a run and beside one."""
    values, steps = GROWS[name]
    scene = timo_sim.load_scene({}, values)
    length, every = scene.values['arm.length'], steps // 20
    run = simulate(values, steps * scene.step, every)
    tip = spectral_elements.simulate(scene.vary({'model.axial_modes': 0}), every * scene.step, 20,
                                     order=8, courant=0.9)[2]
    error = np.linalg.norm(run.position(length) - tip, axis=1).max()
    assert error > 1e-3 * length and run.warning and steps > 2048
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.3)
    simulator = timo_sim.EstimatingSimulator(scene)
    for _ in range(20):
        simulator.advance(every)
    if math.isfinite(simulator.estimated_error):
        assert simulator.estimated_error == pytest.approx(error, rel=0.3)
    assert simulator.warning


def test_the_measured_error_does_not_depend_on_the_samples_asked_for():
    """Between samples far apart the tips are compared as well."""
    found = [simulate(SCENES['stretch'], 0.5, every).stats['estimated_tip_error_m']
             for every in (1, 5, 100, 500)]
    assert found == [found[0]] * 4


@pytest.mark.parametrize('duration, every', [(100.0, 1), (500.0, 1), (100.0, 50)])
def test_the_measured_error_is_the_largest_of_all_steps(duration, every):
    """At whole seconds a vibration of 1 Hz always has the same phase."""
    scene = timo_sim.load_scene({
        'carrier.held': 'both', 'motor.viscous_friction': 5.0, 'integrator.step': 0.02,
        'load.torque.harmonic.amplitude': [20.0], 'load.torque.harmonic.frequency': [1.0],
        'load.torque.harmonic.phase': [0.5 * math.pi]})
    steps, parts = round(duration / scene.step), choose_parts(scene)[0]
    run, fine = run_scene(scene, steps), run_scene(refine(scene, parts), parts * steps, parts)
    assert timo_sim.simulate(scene, duration, every).stats['estimated_tip_error_m'] == (
        pytest.approx(np.linalg.norm(run.position() - fine.position(), axis=1).max()))


def test_a_comparison_changes_no_model_that_others_use():
    """A later scene of the same bodies has the bits of one that nothing came before."""
    before, _ = timo_sim.Simulator(SHARED).advance(50, sample_every=10)
    simulate(SHARED, 0.05, estimate=True)
    again, _ = timo_sim.Simulator(SHARED).advance(50, sample_every=10)
    np.testing.assert_array_equal(again, before)


def test_an_error_is_measured_only_if_asked_for():
    once, twice = (simulate(SCENES['stretch'], 0.5, estimate=choice) for choice in (False, True))
    assert math.isnan(once.stats['estimated_tip_error_m'])
    np.testing.assert_array_equal(once.values, twice.values)
    assert math.isnan(timo_sim.Simulator('paper').estimated_error)


@pytest.mark.parametrize('values, remedy', [
    (SCENES['stretch'], 'model.axial_modes 1'), (SCENES['modes'], 'more model.modes'),
    (SCENES['formulation'], 'model.formulation exact'),
    ({'integrator.step': 0.02, 'carrier.held': 'both', 'load.torque.harmonic.amplitude': [500.0],
      'load.torque.harmonic.frequency': [8.0]}, 'a smaller integrator.step')])
def test_the_warning_names_what_moves_the_tip_most(values, remedy):
    assert simulate(values, 1.0).warning.endswith(f'take {remedy}')


def test_the_error_under_commands_is_that_from_finer_steps():
    """Random torques, one for each call; the finer run is followed in parts and at once."""
    random, paths, found = np.random.default_rng(1), [], []
    torques = random.normal(0.0, 200.0, 100)
    for parts, kind in ((1, timo_sim.EstimatingSimulator), (16, timo_sim.Simulator)):
        simulator = kind({'integrator.step': 0.02 / parts, 'model.modes': 6})
        path = []
        for torque in torques:
            simulator.step(torque=torque, duration=0.02)
            path.append(simulator.model.world(simulator.motion.values[np.newaxis],
                                              simulator.model.tip_point)[0, 0])
            if parts == 1 and len(path) % 7 == 0:
                assert simulator.measure_error(3)
        paths.append(path)
        found.append(simulator.estimated_error)
    error = np.linalg.norm(np.subtract(*paths), axis=1).max()
    assert error > 1e-4 and found[0] == pytest.approx(error, rel=0.3)


def test_the_error_under_commands_of_a_controller_is_not_that_of_its_loop():
    """A standing arm in gravity falls without its controller, and so does the finer run."""
    scene = timo_sim.load_scene({
        'arm.length': 0.6, 'arm.material': 'aluminium', 'arm.section.width': 0.03,
        'arm.section.height': 0.003, 'arm.damping_ratio': [0.01], 'end_effector.mass': 0.15,
        'motor.shaft_inertia': 0.002, 'carrier.held': 'both', 'gravity': [0.0, -9.81],
        'integrator.step': 0.002})

    def loop(simulator, periods=2500):  # 5 s
        steps = round(0.002 / simulator.scene.step)
        for _ in range(periods):
            torque = 8.0 * (0.5 - simulator.motion.shaft) - 0.6 * simulator.motion.shaft_velocity
            simulator.step(torque=torque, duration=steps * simulator.scene.step)
        return simulator.motion.shaft

    simulator = timo_sim.EstimatingSimulator(scene)
    found = loop(simulator)
    finer = timo_sim.Simulator(scene.vary({'integrator.step': 0.001, 'model.modes': 4}))
    error = 0.6 * abs(found - loop(finer))
    assert error < 1e-3 < simulator.estimated_error
    assert simulator.estimated_error > 10.0 * error
    assert 'run the loop again with half the integrator.step' in simulator.warning


def test_the_error_does_not_depend_on_the_calls_that_advance():
    """It is that after each step, also of calls without samples, or longer than a block."""
    found = []
    for calls in ([(1, 1)] * 5003, [(3000, 0), (2003, 0)], [(5003, 7)], [(10, 3), (4993, 4992)]):
        simulator, alone = timo_sim.EstimatingSimulator('paper'), timo_sim.Simulator('paper')
        for count, every in calls:
            for seen, expected in zip(simulator.advance(count, sample_every=every),
                                      alone.advance(count, sample_every=every)):
                assert np.array_equal(seen, expected)
        found.append(simulator.estimated_error)
    assert found == pytest.approx([found[0]] * 4, rel=1e-9) and found[0] > 1e-8


def test_the_finer_run_follows_changes_and_resets():
    """A change of the scene that both runs make is no error; a reset begins anew."""
    scene = timo_sim.load_scene('paper')
    simulator = timo_sim.EstimatingSimulator(scene)
    simulator.advance(200)
    simulator.change(scene.vary({'end_effector.mass': 3.0, 'carrier.viscous_friction': 5.0}))
    simulator.advance(300)
    assert 0.0 < simulator.estimated_error < 1e-4
    simulator.reset()
    assert simulator.estimated_error == 0.0
    simulator.advance(500)
    assert 0.0 < simulator.estimated_error < 1e-4


def test_the_error_of_an_equilibrium_is_known_before_the_first_step():
    scene = timo_sim.load_scene({}, {**elastica.ARM, 'model.formulation': 'newton',
                                     'carrier.held': 'both', 'motor.shaft': 'locked',
                                     'initial.shaft': 0.0, 'initial.equilibrium': True})
    arm = scene.manipulator.arm
    force = 3.2 * arm.section.bending_stiffness / arm.length**2
    simulator = timo_sim.EstimatingSimulator(scene.vary({
        'load.tip_force_y.piecewise.time': [0.0],
        'load.tip_force_y.piecewise.value': [force]}))
    _, across, short = arm.length * elastica.elastica(3.2)
    off = math.dist(simulator.position(), (arm.length - short, across))
    # The five modes of the finer run and shear, which the closed form lacks, make 5e-6 m.
    assert simulator.estimated_error == pytest.approx(off, abs=1e-5) and off > 1.0


def test_lists_of_modes_grow_with_the_modes():
    scene = timo_sim.load_scene({}, {
        'model.modes': 2, 'model.axial_modes': 1, 'arm.damping_ratio': [0.1, 0.2, 0.3],
        'initial.modal_coordinates': [1e-3, 2e-3, 3e-6], 'initial.modal_rates': [4.0, 5.0, 6.0]})
    fine = refine(scene, 2)
    assert fine.values['arm.damping_ratio'] == (0.1, 0.2, 0.2, 0.2, 0.3, 0.3, 0.3)
    coarse = timo_sim.load_scene({}, {'integrator.step': 0.02, 'arm.damping_ratio': 0.1})
    unresolved = refine(coarse, 2)
    assert unresolved.values['arm.damping_ratio'] == (*4 * (0.1,), 1.0)
    motion = scene.initial_motion(), fine.initial_motion()
    tips = [each.build().tip(initial) for each, initial in zip((scene, fine), motion)]
    np.testing.assert_allclose(*tips, atol=1e-15)


def test_a_finer_run_starts_where_the_run_does_also_if_static_shapes_are_bent():
    scene = timo_sim.load_scene({}, {**SCENES['stretch'], 'model.static_modes': 'force',
                                     'initial.modal_coordinates': [2e-3, 0.0, 0.0, 2e-3]})
    tips = [each.build().tip(each.initial_motion()) for each in (scene, refine(scene, 2))]
    # Few nodes see the shortening, the square of the bend, to 4e-4 of itself.
    assert tips[0][1] > 1e-3 and tips[1] == pytest.approx(tips[0], abs=1e-7)


def test_one_mode_has_a_finer_run():
    one = {'model.modes': 1, 'initial.modal_coordinates': [0.2], 'arm.damping_ratio': [0.01]}
    assert simulate(one, 0.1).stats['estimated_tip_error_m'] > 0.0


def test_steps_with_dry_friction_are_fine_enough():
    run = simulate(DRY, 2.0)
    fine = run_scene(refine(run.scene, 16), 16 * run.stats['steps'], 16 * 5)
    error = np.linalg.norm(run.position(0.329) - fine.position(0.329), axis=1).max()
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.1)


def of_random_joints(kind, random):
    """Return an arm without modes, whose steps alone have errors, with joints of a kind."""
    size = 10.0**random.uniform(-1.0, 1.0, 4)
    joints = {'motor.coulomb_friction': size[0], 'motor.coulomb_presliding': 0.01 * size[1],
              'carrier.coulomb_friction': size[2], 'carrier.coulomb_presliding': 0.03 * size[3]
              } if kind == 'dry' else {
        'motor.gear.stiffness': 600.0 * size[0], 'motor.gear.damping': size[1],
        'motor.gear.backlash': 0.01 * size[2], 'motor.rotor.inertia': 1.0 + size[3]}
    return timo_sim.load_scene('paper', {
        'model.modes': 0, 'integrator.step': 0.01, 'load.torque.harmonic.frequency': [1.0],
        'initial.shaft_velocity': random.uniform(-2.0, 2.0),
        'load.torque.harmonic.amplitude': [random.uniform(1.0, 10.0)], **joints})


@pytest.mark.parametrize('kind', ['dry', 'backlash'])
def test_errors_of_steps_with_events_are_measured(kind):
    """Within a factor of two in 95 % of scenes, also where the order of the steps is lower."""
    ratios = []
    for number in range(40):
        scene = of_random_joints(kind, np.random.default_rng(number))
        run = timo_sim.simulate(scene, 2.0)
        fine = run_scene(scene.vary({'integrator.step': 0.01 / 64}), 64 * 200, 64)
        error = np.linalg.norm(run.position() - fine.position(), axis=1).max()
        ratios.append(run.stats['estimated_tip_error_m'] / error)
    assert np.mean(np.abs(np.log2(ratios)) < 1.0) >= 0.95
