# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A doubtful run is compared with a finer one, whose distance is that from finite elements."""

import warnings

import numpy as np
from oracles import spectral_elements
import pytest
import timo_sim
from timo_sim.jit.constants import pack
from timo_sim.runs import second_run

# A free arm that turns fast, a stroke on the tip of an arm with one mode, an axial force.
STROKE = {'load.tip_torque.piecewise.time': [0.1, 0.12],
          'load.tip_torque.piecewise.value': [60.0, 0.0]}
PULL = {'model.formulation': 'newton', 'carrier.held': 'both', 'motor.shaft': 'locked',
        'initial.shaft': 0.0, 'load.tip_force_x.piecewise.time': [0.0],
        'load.tip_force_x.piecewise.value': [400.0], 'load.tip_force_y.piecewise.time': [0.0],
        'load.tip_force_y.piecewise.value': [10.0]}
# A light, soft arm with dry friction: scene 491 of the stress test.
DRY = {'integrator.step': 0.002, 'arm.length': 0.329, 'arm.height': 0.00213, 'arm.width': 0.00331,
       'arm.density': 1970.0, 'arm.young_modulus': 2.87e8, 'arm.shear_modulus': 1.96e7,
       'arm.shear_correction': 0.592, 'arm.damping_ratio': [0.0], 'end_effector.mass': 5.68e-05,
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
SCENES = {'stretch': {'initial.shaft_velocity': 20.0}, 'modes': {'model.modes': 1, **STROKE},
          'formulation': PULL}


# The arm buckles under a force along it, grows soft near its critical load, or stands near it.
GROWS = {
    'buckles': ({
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0, 'model.modes': 5,
        'load.tip_force_x.table.time': [0.0, 1.0],
        'load.tip_force_x.table.value': [0.0, -900.0],
        'load.tip_force_y.piecewise.time': [0.0],
        'load.tip_force_y.piecewise.value': [2.0]}, 3000),
    'buckles on a carrier': ({
        'arm.length': 2.2482, 'arm.height': 0.066878, 'arm.width': 0.16744, 'arm.density': 1600.0,
        'arm.young_modulus': 60000000000.0, 'arm.shear_modulus': 4000000000.0,
        'carrier.mass': 149.05, 'motor.mass': 24.856, 'motor.shaft_inertia': 18.618,
        'end_effector.mass': 13.397, 'end_effector.inertia': 0.012546, 'initial.shaft':
        0.0, 'motor.shaft': 'locked', 'carrier.held': 'y', 'load.tip_force_x.table.time':
        [0.0, 0.276], 'load.tip_force_x.table.value': [0.0, -159030.0],
        'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value':
        [464.99], 'model.modes': 3, 'model.axial_modes': 1, 'integrator.step': 0.00023}, 4000),
    'stands': ({
        'arm.length': 0.9699, 'arm.height': 0.036018, 'arm.width': 0.068316, 'arm.density': 1200.0,
        'arm.young_modulus': 2400000000.0, 'arm.shear_modulus': 900000000.0,
        'carrier.mass': 0.98723, 'motor.mass': 1.7494, 'motor.shaft_inertia': 0.15888,
        'end_effector.mass': 1.257, 'end_effector.inertia': 0.00026731, 'initial.shaft':
        1.5720106365574924, 'motor.shaft': 'locked', 'carrier.held': 'both', 'gravity':
        [0.0, -681.69], 'load.tip_force_x.piecewise.time': [0.0, 0.3276],
        'load.tip_force_x.piecewise.value': [31.885, 0.0], 'model.modes': 5,
        'model.axial_modes': 0, 'integrator.step': 0.00063}, 2600),
}
SHARED = {'initial.shaft_velocity': 20.0, 'model.modes': 3}


def quietly(values, duration, every=5, **options):
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        return timo_sim.simulate(timo_sim.load_scene(values), duration, every, **options)


@pytest.mark.usefixtures('any_size')
@pytest.mark.parametrize('name', SCENES)
def test_the_error_is_the_distance_from_finite_elements(name):
    run = quietly(SCENES[name], 0.5)
    tip = spectral_elements.simulate(run.scene, 0.005, 100)[2]
    error = np.linalg.norm(run.position(2.0) - tip, axis=1).max()
    assert run.stats['compared'] and error > second_run.DOUBT
    # Three further modes and one axial mode give most, but not all, of the error.
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.2)
    assert (run.warning is not None) == (error > 1.4e-3)  # 7e-4 of the arm's length


def test_runs_that_are_not_doubtful_have_no_second_run():
    assert 'compared' not in quietly('paper', 1.0).stats
    assert 'compared' not in quietly({**SCENES['stretch'], 'model.modes': 0}, 0.5).stats  # rigid
    rigid = {'model.modes': 0, 'model.formulation': 'newton', 'initial.shaft_velocity': 1.0}
    assert 'compared' not in quietly(rigid, 0.5).stats


@pytest.mark.usefixtures('any_size')
def test_steps_that_do_not_resolve_axial_vibrations_are_compared():
    """Their own estimate misses nine tenths of the error of an arm that starts at full speed."""
    run = quietly(ABRUPT, 2.0)
    tip = spectral_elements.simulate(run.scene, 0.025, 80)[2]
    error = np.linalg.norm(run.position(2.0) - tip, axis=1).max()
    assert run.stats['compared'] and run.stats['step_error_m'] < 0.2 * error
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.5)
    resolved = quietly({**ABRUPT, 'integrator.step': 0.001}, 0.5)
    assert 'compared' not in resolved.stats


@pytest.mark.usefixtures('any_size')
@pytest.mark.parametrize('name', GROWS)
def test_errors_that_grow_are_measured(name):
    """Against spectral elements; the run's own estimate is ten times too low."""
    values, steps = GROWS[name]
    scene = timo_sim.load_scene(values)
    length, every = scene.values['arm.length'], steps // 20
    run = quietly(values, steps * scene.step, every)
    tip = spectral_elements.simulate(scene.vary({'model.axial_modes': 0}), every * scene.step, 20,
                                     order=8)[2]
    error = np.linalg.norm(run.position(length) - tip, axis=1).max()
    assert error > 1e-3 * length and run.warning and steps > 2048
    assert run.stats['step_error_m'] + run.stats['modes_error_m'] < 0.1 * error
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.3)


def test_the_measured_error_does_not_depend_on_the_samples_asked_for():
    """Between samples far apart the tips are compared as well."""
    found = [quietly(SCENES['stretch'], 0.5, every).stats['estimated_tip_error_m']
             for every in (1, 5, 100, 500)]
    assert found == pytest.approx([found[0]] * 4, rel=0.1)


def test_a_comparison_changes_no_model_that_others_use():
    """A later scene of the same bodies has the bits of one that nothing came before."""
    before, _ = timo_sim.Simulator(SHARED).advance(50, sample_every=10)
    finer = second_run.finer(timo_sim.load_scene(SHARED), 2)
    quietly(SHARED, 0.05, compare=True)
    assert finer.build().pack is pack
    assert isinstance(finer.build().packed, np.void)
    again, _ = timo_sim.Simulator(SHARED).advance(50, sample_every=10)
    np.testing.assert_array_equal(again, before)


def test_an_equilibrium_changes_no_model_that_others_use():
    straight = timo_sim.load_scene({'gravity': [0.0, -9.81], 'carrier.held': 'both',
                                    'motor.shaft': 'locked', 'initial.shaft': 0.0})
    model, reach = straight.build(), straight.build().reach.copy()
    bent = straight.vary({'initial.equilibrium': True})
    assert (bent.build().reach != reach).any()
    bent.initial_motion(model)
    assert straight.build() is model and (model.reach == reach).all() and model.rest is None


def test_compare_overrides_the_choice():
    assert quietly('paper', 0.5, compare=True).stats['compared']
    once, twice = (quietly(SCENES['stretch'], 0.5, compare=choice) for choice in (False, None))
    assert 'compared' not in once.stats
    np.testing.assert_array_equal(once.motion, twice.motion)


def test_a_false_alarm_is_withdrawn(monkeypatch):
    monkeypatch.setattr(second_run, 'DOUBT', 0.0)
    scene = timo_sim.load_scene('paper')
    run = second_run.sampled_run(scene, 100)
    alarmed = second_run.replace(run, warning='the steps are too long')
    assert second_run.in_doubt(alarmed)
    assert second_run.compared(alarmed).warning is None


def test_lists_of_modes_grow_with_the_modes():
    scene = timo_sim.load_scene({
        'model.modes': 2, 'model.axial_modes': 1, 'arm.damping_ratio': [0.1, 0.2, 0.3],
        'initial.modal_coordinates': [1e-3, 2e-3, 3e-6], 'initial.modal_rates': [4.0, 5.0, 6.0]})
    finer = second_run.finer(scene, 2)
    assert finer.values['arm.damping_ratio'] == (0.1, 0.2, 0.2, 0.2, 0.2, 0.3, 0.3)
    motion = scene.initial_motion(), finer.initial_motion()
    tips = [each.build().tip(initial) for each, initial in zip((scene, finer), motion)]
    np.testing.assert_allclose(*tips, atol=1e-15)


@pytest.mark.usefixtures('any_size')
def test_one_mode_has_a_second_run_too():
    values = {'model.modes': 1, 'initial.modal_coordinates': [0.2], 'arm.damping_ratio': [0.01]}
    assert quietly(values, 0.1, compare=True).stats['compared']


def test_a_run_that_starts_bent_in_static_modes_has_no_second_run():
    values = {**SCENES['stretch'], 'model.static_modes': 'force'}
    assert quietly(values, 0.1, compare=True).stats['compared']
    bent = {**values, 'initial.modal_coordinates': [1e-3, 0.0, 0.0]}
    assert 'compared' not in quietly(bent, 0.1, compare=True).stats


def test_steps_with_dry_friction_are_fine_enough():
    """A second run at half the step is 1e3 times further off than the first, and cannot see it."""
    run = quietly(DRY, 2.0, compare=True)
    fine = second_run._run(second_run.finer(run.scene, 16), 16, run, None)
    error = np.linalg.norm(run.position(0.329) - fine.position(0.329), axis=1).max()
    assert run.stats['estimated_tip_error_m'] == pytest.approx(error, rel=0.1)
