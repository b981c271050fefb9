# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`model.accuracy`: the stated tip error holds against finite elements, at the least cost."""

import json

from mcap.reader import make_reader
import numpy as np
import pytest

from oracles import spectral_elements
from oracles.references import read, TORQUE, world
import timo_sim
from timo_sim.runs.simulate import choose_resolution

SCENES = {'paper': 10.0, 'torque': 5.0}  # name, duration [s]
PERIOD = 0.02  # [s]
COARSE = {'model.modes': 3, 'integrator.step': PERIOD}
SWING = {'load.torque.harmonic.amplitude': [50.0], 'load.torque.harmonic.frequency': [3.0]}
HEAVY = {'end_effector.mass': 60.0, 'end_effector.inertia': 12.0, **SWING}
RAPID = {'load.tip_force_y.harmonic.amplitude': [20.0],
         'load.tip_force_y.harmonic.frequency': [200.0], 'initial.shaft': 0.0,
         'integrator.step': 0.001}
LIGHT = {'end_effector.mass': 0.0, 'end_effector.inertia': 0.0,
         'load.tip_torque.harmonic.amplitude': [5.0], 'load.tip_torque.harmonic.frequency': [4.0]}
FAST = {'arm.section.height': 0.015, 'initial.shaft_velocity': 15.0, 'integrator.step': 0.01,
        'load.torque.piecewise.time': [0.0, 0.5, 1.0],
        'load.torque.piecewise.value': [80.0, -80.0, 0.0]}
TIMES = [round(0.05 * k, 2) for k in range(1, 40)]
ROUGH = {'integrator.step': 0.01, 'load.torque.piecewise.time': TIMES,
         'load.torque.piecewise.value': list(
             20.0 * np.random.default_rng(4).normal(size=len(TIMES)))}
KINDS = {
    'heavy tip': (HEAVY, 1e-3),
    'sandwich': ({'arm.section.height': 0.04, 'arm.shear_modulus': 1e6, 'arm.density': 300.0,
                  'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, **SWING}, 1e-4),
    'tip force of 200 Hz': (RAPID, 1e-4),
    'fast spin': (FAST, 2e-3),
    'light tip': (LIGHT, 2e-4),
    'rough commands': (ROUGH, 1e-4),
}


def tip_of_reference(name, length):
    """Return the tip in the world and in the arm frame, shape (2, n, 2) [m], every PERIOD."""
    _, columns = read(name)
    stride = round(PERIOD / (columns['t'][1] - columns['t'][0]))
    columns = {key: values[::stride] for key, values in columns.items()}
    theta = columns['theta_rad']
    carrier = np.column_stack([columns['x_c_m'], columns['y_c_m']])
    along, across = length + columns['u_l_m'], columns['w_l_m']
    return np.stack([world(theta, carrier, along, across), np.column_stack([along, across])])


def tip_of(run):
    return np.stack([run.position(run.scene.manipulator.arm.length),
                     run.model.centre_line(run.q, run.model.tip_point)[:, 0]])


def estimate_of(run):
    return max(run.stats['estimated_tip_error_m'], run.stats['estimated_deflection_error_m'])


@pytest.mark.parametrize('name', SCENES)
@pytest.mark.parametrize('goal', [1e-3, 1e-4, 1e-5])
def test_the_stated_error_holds(name, goal, paper):
    source = paper if name == 'paper' else TORQUE
    scene = timo_sim.load_scene(source, {**COARSE, 'model.accuracy': goal})
    chosen = choose_resolution(scene, SCENES[name])
    run = timo_sim.simulate(chosen.scene, SCENES[name],
                            sample_every=round(PERIOD / chosen.scene.step), estimate=False)
    reference = tip_of_reference(name, scene.manipulator.arm.length)
    error = np.linalg.norm(tip_of(run) - reference, axis=2).max()
    assert error < goal and (error < 2e-6 or estimate_of(chosen) == pytest.approx(error, rel=0.1))
    # The choice is not much finer than it must be.
    assert chosen.scene.values['model.modes'] <= 5 and chosen.scene.step >= 0.01


@pytest.mark.parametrize('values, goal', KINDS.values(), ids=KINDS)
def test_the_choice_agrees_with_a_much_finer_run(values, goal):
    chosen = choose_resolution(
        timo_sim.load_scene({}, {**COARSE, 'model.accuracy': goal, **values}), 2.0)
    run, truth = (tip_of(timo_sim.simulate(scene, 2.0, round(PERIOD / scene.step), estimate=False))
                  for scene in (chosen.scene, chosen.scene.vary(
                      {'model.modes': 16, 'integrator.step': 1e-4})))
    error = np.linalg.norm(run - truth, axis=2).max()
    assert error < goal and error / 2.0 < estimate_of(chosen) < 2.0 * error


@pytest.mark.parametrize('values, goal', [
    ({**HEAVY, 'carrier.held': 'x', 'end_effector.inertia': 5.0}, 2e-4),
    ({'initial.shaft_velocity': 4.0, 'carrier.held': 'both'}, 1e-4)], ids=['held', 'stretched'])
def test_the_choice_agrees_with_spectral_elements(values, goal):
    chosen = choose_resolution(
        timo_sim.load_scene({}, {**COARSE, 'model.accuracy': goal, **values}), 0.4)
    run = timo_sim.simulate(chosen.scene, 0.4, round(PERIOD / chosen.scene.step), estimate=False)
    truth = spectral_elements.simulate(chosen.scene, PERIOD, 20, order=8, courant=0.9)[2]
    assert np.linalg.norm(run.position(2.0) - truth, axis=1).max() < goal


@pytest.mark.parametrize('values, message', [
    ({}, 'model.accuracy = 0.001 m needs a scene that moves'),
    ({'initial.modal_rates': [1.0, 0.0, 0.0]}, 'for a stated model.accuracy'),
    ({**LIGHT, 'model.accuracy': 1e-5, 'model.static_modes': 'none'},
     'is not reached: .* N = .*: take model.static_modes auto'),
    ({**SWING, 'model.accuracy': 1e-14}, 'is not reached: .*e-.* m is, with N = '),
])
def test_scenes_without_a_choice_are_refused(values, message):
    with pytest.raises(timo_sim.ParameterError, match=message):
        choose_resolution(timo_sim.load_scene({}, {'model.accuracy': 1e-3, **values}), 1.0)


def test_the_node_chooses_and_says_so(start, paper):
    node = start('--params-file', str(paper), duration=1.0, real_time_factor=0.0,
                 **{'model.accuracy': 5e-6, 'model.modes': 3})
    code, output = node.wait()
    assert code == 0 and 'model.accuracy = 5e-06 m: N = ' in output
    with open(node.log, 'rb') as file:
        notes = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    values = json.loads(notes['timo_sim']['parameters'])
    assert values['model.modes'] == 5 and values['model.accuracy'] == 0.0
    assert f'N = {values["model.modes"]} modes' in output
