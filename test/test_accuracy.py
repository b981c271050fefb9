# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`model.accuracy`: the stated tip error holds against finite elements, at the least cost."""

import json
import re

from mcap.reader import make_reader
import numpy as np
import pytest

from oracles import spectral_elements
from oracles.references import read, spin_up as shaft_of_spin_up, TORQUE, world
import timo_sim
from timo_sim.runs.simulate import choose_resolution

SCENES = {'paper': 10.0, 'torque': 5.0, 'spin_up': 20.0}  # name, duration [s]
PERIOD = 0.02  # [s]
SWING = {'load.torque.harmonic.amplitude': [50.0], 'load.torque.harmonic.frequency': [3.0]}
HEAVY = {'end_effector.mass': 60.0, 'end_effector.inertia': 12.0, **SWING}
RAPID = {'load.tip_force_y.harmonic.amplitude': [20.0],
         'load.tip_force_y.harmonic.frequency': [200.0], 'initial.shaft': 0.0}
LIGHT = {'end_effector.mass': 0.0, 'end_effector.inertia': 0.0,
         'load.tip_torque.harmonic.amplitude': [5.0], 'load.tip_torque.harmonic.frequency': [4.0]}
FAST = {'arm.section.height': 0.015, 'initial.shaft_velocity': 15.0,
        'load.torque.piecewise.time': [0.0, 0.5, 1.0],
        'load.torque.piecewise.value': [80.0, -80.0, 0.0]}
TIMES = [round(0.05 * k, 2) for k in range(1, 40)]
KINDS = {
    'heavy tip': (HEAVY, 1e-3),
    'sandwich': ({'arm.section.height': 0.04, 'arm.shear_modulus': 1e6, 'arm.density': 300.0,
                  'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, **SWING}, 1e-4),
    'tip force of 200 Hz': (RAPID, 1e-4),
    'fast spin': (FAST, 2e-3),
    'light tip': (LIGHT, 2e-4),
    'rough commands': ({'load.torque.piecewise.time': TIMES, 'load.torque.piecewise.value': list(
        20.0 * np.random.default_rng(4).normal(size=len(TIMES)))}, 1e-4),
}


@pytest.fixture
def source(paper, spin_up):
    return {'paper': paper, 'torque': TORQUE, 'spin_up': spin_up}


def tip_of_reference(name, length):
    """Return the tip in the world and in the arm frame, shape (2, n, 2) [m], every PERIOD."""
    _, columns = read(name)
    stride = round(PERIOD / (columns['t'][1] - columns['t'][0]))
    columns = {key: values[::stride] for key, values in columns.items()}
    if name == 'spin_up':
        theta = np.array([shaft_of_spin_up()[0](t) for t in columns['t']])
        carrier = np.zeros((len(theta), 2))
    else:
        theta = columns['theta_rad']
        carrier = np.column_stack([columns['x_c_m'], columns['y_c_m']])
    along, across = length + columns['u_l_m'], columns['w_l_m']
    return np.stack([world(theta, carrier, along, across), np.column_stack([along, across])])


@pytest.mark.parametrize('name', SCENES)
@pytest.mark.parametrize('goal', [1e-3, 1e-4])
def test_the_stated_error_holds(name, goal, source):
    scene = timo_sim.load_scene(source[name], {'model.accuracy': goal})
    choice = choose_resolution(scene, SCENES[name])
    run = timo_sim.simulate(choice.scene, SCENES[name],
                            sample_every=round(PERIOD / choice.scene.step), estimate=False)
    reference = tip_of_reference(name, scene.manipulator.arm.length)
    error = np.linalg.norm(tip_of(run) - reference, axis=2).max()
    assert error <= goal
    # The estimate is close: for the slowest convergence 33 % are added with three modes, 64 % with
    # five. The choice is not much finer than it must be.
    assert 0.5 * choice.estimate < error < 1.15 * choice.estimate
    assert choice.scene.values['model.modes'] <= 5 and choice.scene.step >= 0.01


def tip_of(run):
    return np.stack([run.position(run.scene.manipulator.arm.length),
                     run.model.centre_line(run.q, run.model.tip_point)[:, 0]])


@pytest.mark.parametrize('values, goal', KINDS.values(), ids=KINDS)
@pytest.mark.filterwarnings('ignore::timo_sim.ModelWarning')  # about stretch
def test_the_estimate_agrees_with_a_much_finer_run(values, goal):
    choice = choose_resolution(timo_sim.load_scene({}, {'model.accuracy': goal, **values}), 2.0)
    finer = {'model.modes': 16, 'integrator.step': 5e-5}  # more modes than the choice tries
    run = timo_sim.simulate(choice.scene, 2.0, round(PERIOD / choice.scene.step), estimate=True)
    truth = choice.scene.vary(finer)
    truth = timo_sim.simulate(truth, 2.0, round(PERIOD / truth.step), estimate=False)
    error = np.linalg.norm(tip_of(run) - tip_of(truth), axis=2).max()
    assert error < goal and error / 5.0 < choice.estimate < 5.0 * error
    assert choice.warning or run.warning is None and run.stats['estimated_tip_error_m'] < goal


def test_the_estimate_with_one_axis_held_agrees_with_spectral_elements():
    scene = timo_sim.load_scene({}, {
        'model.accuracy': 2e-4, **HEAVY, 'carrier.held': 'x', 'end_effector.inertia': 5.0})
    choice = choose_resolution(scene, 1.0)
    run = timo_sim.simulate(choice.scene, 1.0, round(PERIOD / choice.scene.step), estimate=False)
    truth = spectral_elements.simulate(scene, PERIOD, 50, order=8, courant=0.9)[2]
    error = np.linalg.norm(run.position(2.0) - truth, axis=1).max()
    assert error < 2e-4 and error / 5.0 < choice.estimate < 5.0 * error


def test_the_estimate_covers_a_long_run_to_its_end():
    """At 10 ms modes dominate the error for 2 s; by 120 s the error of the steps is larger."""
    goal, end = 3e-4, 120.0
    scene = timo_sim.load_scene({}, {'model.accuracy': goal, **HEAVY, 'end_effector.inertia': 0.5})
    choice = choose_resolution(scene, end)
    assert choice.scene.values['model.modes'] == 5 and choice.looked_at == end < choice.until
    run, truth, coarse = (tip_of(timo_sim.simulate(scene, end, round(PERIOD / scene.step),
                                                   estimate=False))
                          for scene in (choice.scene, choice.scene.vary(
                              {'model.modes': 12, 'integrator.step': 0.001}),
                              choice.scene.vary({'integrator.step': 0.01})))
    error = np.linalg.norm(run - truth, axis=2).max()
    assert error < goal and error / 5.0 < choice.estimate < 5.0 * error
    assert np.linalg.norm(coarse - truth, axis=2).max() > goal


def test_stretch_that_few_rounds_per_second_cause_is_measured():
    """Against spectral elements of an arm that stretches, off by more than the stated 1e-5 m."""
    scene = timo_sim.load_scene({'model.accuracy': 1e-5, 'initial.shaft_velocity': 4.0,
                                 'carrier.held': 'both'})
    choice = choose_resolution(scene, 2.0)
    run = timo_sim.simulate(choice.scene, 2.0, round(PERIOD / choice.scene.step), estimate=False)
    truth = spectral_elements.simulate(choice.scene, PERIOD, 100, order=8, courant=0.9)[2]
    error = np.linalg.norm(run.position(2.0) - truth, axis=1).max()
    assert error > 1e-5 and 'model.axial_modes 1' in choice.warning
    told = float(re.search('the tip is (.*?) m from', choice.warning)[1])
    assert told == pytest.approx(error, rel=0.2)


def test_a_step_must_suit_jumps_and_the_caller(paper):
    jump = {'load.torque.piecewise.time': [0.011], 'load.torque.piecewise.value': [1.0]}
    choice = choose_resolution(timo_sim.load_scene({}, {'model.accuracy': 1e-3, **jump}), 1.0)
    assert choice.scene.step == 0.001
    choice = choose_resolution(timo_sim.load_scene(paper, {'model.accuracy': 1e-3}), 1.0,
                               lambda step: step <= 0.002)
    assert choice.scene.step == 0.002
    # ... and the duration.
    scene = timo_sim.load_scene(paper, {'model.accuracy': 1e-3})
    assert timo_sim.simulate(scene, 0.985).t[1] == 0.005
    with pytest.raises(timo_sim.ParameterError, match='needs a step .* the duration are mult'):
        timo_sim.simulate(scene, 0.98503)


@pytest.mark.parametrize('values, message', [
    ({}, 'model.accuracy = 0.001 m needs a scene that moves'),
    ({'initial.modal_rates': [1.0, 0.0, 0.0]}, 'for a stated model.accuracy'),
    ({**LIGHT, 'model.accuracy': 1e-5, 'model.static_modes': 'none'},
     'is not reached, but .* with N = 12 .* modes limit it'),
    ({**RAPID, 'model.accuracy': 1e-5}, 'is not reached, but .* h = 1 ms: the steps limit it'),
    ({**SWING, 'model.accuracy': 1e-14}, 'is not reached, but .*e-.* m is, with N = '),
    ({**SWING, 'initial.shaft_velocity': 3000.0}, 'with which no run diverges'),
])
def test_scenes_without_a_choice_are_refused(values, message):
    with pytest.raises(timo_sim.ParameterError, match=message):
        choose_resolution(timo_sim.load_scene({}, {'model.accuracy': 1e-3, **values}), 1.0,
                          lambda step: step >= 0.001)


def test_the_node_chooses_a_step_that_its_rates_allow_and_says_so(start, paper):
    node = start('--params-file', str(paper), duration=1.0, real_time_factor=0.0,
                 **{'model.accuracy': 1e-3, 'rate.tip_pose': 200.0})
    code, output = node.wait()
    assert code == 0 and 'model.accuracy = 0.001 m: N = ' in output
    with open(node.log, 'rb') as file:
        notes = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    values = json.loads(notes['timo_sim']['parameters'])
    assert values['integrator.step'] == 0.005 and values['model.accuracy'] == 0.0
    assert f'N = {values["model.modes"]} modes' in output
