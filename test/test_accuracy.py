# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`model.accuracy`: the stated tip error holds against finite elements, at the least cost."""

import json

from mcap.reader import make_reader
import numpy as np
import pytest

from oracles.references import read, spin_up as shaft_of_spin_up, TORQUE, world
import timo_sim
from timo_sim.simulation import resolution
from timo_sim.simulation.resolution import choose_resolution, PERIOD

SCENES = {'paper': 10.0, 'torque': 5.0, 'spin_up': 20.0}  # name, duration [s]


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
                            sample_every=round(PERIOD / choice.scene.step))
    length = choice.scene.manipulator.arm.length
    ours = np.stack([run.position(length),
                     run.model.centre_line(run.q, run.model.at([length]))[:, 0]])
    error = np.linalg.norm(ours - tip_of_reference(name, length), axis=2).max()
    assert error <= goal
    # The estimate is no guess either (it was within 6 %: the rest is the finite elements' and
    # that of twelve modes), nor is the choice much finer than it must be.
    assert error == pytest.approx(choice.estimate, rel=0.15)
    assert choice.scene.values['model.modes'] <= 5 and choice.scene.step >= 0.01


def test_simulate_chooses_and_the_run_says_what(paper):
    run = timo_sim.simulate(timo_sim.load_scene(paper, {'model.accuracy': 1e-3}), 2.0)
    values = run.scene.values
    assert values['model.accuracy'] == 0.0
    assert (values['model.modes'], values['integrator.step']) == (len(run.model.modes),
                                                                  run.t[1])


def test_a_step_must_suit_jumps_and_the_caller(paper):
    jump = {'load.torque.piecewise.time': [0.011], 'load.torque.piecewise.value': [1.0]}
    choice = choose_resolution(timo_sim.load_scene({'model.accuracy': 1e-3, **jump}), 1.0)
    assert choice.scene.step == 0.001
    choice = choose_resolution(timo_sim.load_scene(paper, {'model.accuracy': 1e-3}), 1.0,
                               lambda step: step <= 0.002)
    assert choice.scene.step == 0.002


@pytest.mark.parametrize('values, message', [
    ({}, 'model.accuracy = 0.001 m needs a scene that moves'),
    ({'initial.modal_rates': [1.0, 0.0, 0.0]}, 'for a stated model.accuracy'),
    ({'initial.shaft_velocity': 3.0, 'load.torque.harmonic.amplitude': [50.0],
      'load.torque.harmonic.frequency': [31.0], 'model.accuracy': 1e-12}, 'is not reached, but'),
])
def test_what_cannot_be_chosen_is_refused(values, message, monkeypatch):
    monkeypatch.setattr(resolution, 'MOST_MODES', 5)  # not a size that nobody else compiles
    with pytest.raises(timo_sim.ParameterError, match=message):
        choose_resolution(timo_sim.load_scene({'model.accuracy': 1e-3, **values}), 1.0)


def test_the_node_chooses_what_its_rates_allow_and_says_it(start, paper):
    node = start('--params-file', str(paper), duration=1.0, real_time_factor=0.0,
                 **{'model.accuracy': 1e-3, 'rate.tip_pose': 200.0})
    code, output = node.wait()
    assert code == 0 and 'model.accuracy = 0.001 m: N = ' in output
    with open(node.log, 'rb') as file:
        notes = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    values = json.loads(notes['timo_sim']['parameters'])
    assert values['integrator.step'] == 0.005 and values['model.accuracy'] == 0.0
    assert f'N = {values["model.modes"]} modes' in output
