# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Errors of steps: estimated, kept below a tolerance by splitting, told when they are alarming."""

import numpy as np
import pytest

import timo_sim
from timo_sim.physics.integrate import etdrk4
from timo_sim.physics.layout import LOADS, TORQUE
from timo_sim.simulation.load_table import LoadTable
from timo_sim.simulation.simulator import Simulator

FAST = {'initial.shaft_velocity': 20.0, 'initial.modal_rates': [5.0, 1.0, 0.0]}
DURATION, PERIOD = 2.0, 0.02


def tip(simulator, motions):
    """Return where the tip is in the world, shape (n, 2) [m]."""
    formulation = simulator.model
    return formulation.world(motions, formulation.at([2.0]))[:, 0]


def path(step, tolerance=0.0, **values):
    """Return simulator and path of the tip over 2 s, every 20 ms."""
    simulator = Simulator(timo_sim.load_scene({
        'integrator.step': step, 'integrator.tolerance': tolerance, **FAST, **values}))
    motions, _ = simulator.advance(round(DURATION / step), sample_every=round(PERIOD / step))
    return simulator, tip(simulator, motions)


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_the_error_follows_the_tolerance(formulation):
    exact = path(1e-4, **{'model.formulation': formulation})[1]
    for tolerance in (1e-4, 1e-6, 1e-8):
        for step in (0.02, 0.005):
            simulator, run = path(step, tolerance, **{'model.formulation': formulation})
            assert np.abs(run - exact).max() <= 10.0 * tolerance
            integration = simulator.integration
            assert (step < 0.02 or integration.splits) and not integration.unresolved
            assert 0.01 * tolerance < integration.largest_error <= tolerance


def test_with_a_tolerance_that_no_step_exceeds_the_halves_count():
    # Other machine code: the compiler may sum up in another order.
    (_, halves), (simulator, bound) = path(0.001), path(0.002, 1.0)
    assert simulator.integration.splits == 0
    np.testing.assert_allclose(bound, halves, atol=1e-11)


@pytest.mark.parametrize('every', [1, 7])
def test_bits_depend_neither_on_how_steps_are_asked_for_nor_on_samples(every):
    whole = path(0.02, 1e-6)[0]
    pieces = Simulator(whole.scene)
    command = np.zeros(LOADS)
    command[TORQUE] = 30.0
    motions, _ = whole.advance(140, command, every)
    pieces.advance(100)
    found = [pieces.motion.values]
    for _ in range(140 // every):
        pieces.advance(every, command)
        found.append(pieces.motion.values)
    assert np.array(found).tobytes() == motions.tobytes()
    assert pieces.integration.splits == whole.integration.splits > 200


def test_loads_are_those_of_the_parts():
    # Ten periods in a step: sampled at its ends and middle the torque would be nothing.
    torque = {'load.torque.harmonic.amplitude': [100.0],
              'load.torque.harmonic.frequency': [500.0], 'initial.shaft_velocity': 5.0}
    drive = {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0],
             'motor.drive.angle': [0.0, 3.0], 'motor.drive.speed': [20.0, 20.0],
             'motor.drive.acceleration': [0.0, 0.0], 'initial.shaft_velocity': 0.0}
    for load in (torque, drive):
        exact = path(1e-4 if load is drive else 1e-5, **load)[1]
        run = path(0.02, 1e-10, **load)[1]
        assert np.abs(run - exact).max() < 1e-5


def test_what_is_too_coarse_in_the_smallest_parts_is_done_and_told():
    simulator, run = path(0.02, 1e-14)
    assert simulator.integration.unresolved == simulator.integration.splits == 100
    assert np.abs(run - path(1e-4)[1]).max() < 1e-6
    assert 'above integrator.tolerance = 1e-14 m when done in 64 parts' in simulator.warning


def test_splitting_carries_over_what_diverges_in_whole_steps():
    wild = {'initial.shaft_velocity': 100.0, 'initial.modal_rates': [40.0, 0.0, 0.0]}
    with pytest.raises(timo_sim.DivergenceError):
        path(0.02, **wild)
    run = path(0.02, 1e-6, **wild)[1]
    assert np.abs(run - path(1e-4, **wild)[1]).max() < 1e-5


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_the_estimate_is_the_error_of_the_next_step(formulation):
    scene = timo_sim.load_scene({
        'integrator.step': 0.01, 'model.formulation': formulation, **FAST})
    simulator, table = Simulator(scene), LoadTable(scene)
    model, integration = simulator.model, simulator.integration
    for _ in range(20):
        start = simulator._state.copy()
        estimate, _ = integration.estimate_error(
            start, table.stages(simulator.steps, 1), table.stages(simulator.steps, 1, 2))
        fine = start.copy()
        etdrk4.advance(model.packed, integration.propagator(5), fine, simulator.load,
                       table.stages(simulator.steps, 1, 2**5), 0, np.empty((0, model.size)))
        simulator.advance(1)
        error = np.abs(integration.shift @ (simulator._state - fine)).sum()
        assert estimate == pytest.approx(error, rel=0.3)


def test_a_run_of_wrong_steps_is_told_and_a_good_one_is_not():
    wrong = {'initial.shaft_velocity': 40.0, 'initial.modal_rates': [20.0, 0.0, 0.0]}
    scene = timo_sim.load_scene({'integrator.step': 0.01, **wrong})
    with pytest.warns(timo_sim.ModelWarning, match='a step is wrong by about .* at the tip'):
        timo_sim.simulate(scene, 10.0)
    simulator = Simulator(timo_sim.load_scene({'integrator.step': 0.001, **wrong}))
    simulator.advance(10000)
    assert simulator.warning is None and 0.0 < simulator.integration.largest_error < 1e-5


def test_a_load_that_vibrates_within_a_step_is_told():
    load = {'load.force_y.harmonic.amplitude': [1.0, 1.0],
            'load.force_y.harmonic.frequency': [1.0, 30.0]}
    with pytest.warns(timo_sim.ModelWarning, match=(
            'load.force_y.harmonic.frequency = 30 Hz is too high for integrator.step = 0.01 s')):
        timo_sim.simulate(timo_sim.load_scene({'integrator.step': 0.01, **load}), 1.0)
    assert Simulator(timo_sim.load_scene({'integrator.step': 0.005, **load})).warning is None


def test_divergence_says_what_when_and_what_to_do_and_keeps_the_state_before():
    scene = timo_sim.load_scene({'integrator.step': 0.02, 'initial.shaft_velocity': 300.0})
    told = (r'diverges after t = \S+ s \(step \d+\), at [a-z ]+\d* = \S+ with the arm bent by '
            r'\S+ m: take a smaller integrator.step, an integrator.tolerance')
    single, block = Simulator(scene), Simulator(scene)
    with pytest.raises(timo_sim.DivergenceError, match=told) as first:
        while True:
            single.advance(1)
    with pytest.raises(timo_sim.DivergenceError, match=told) as second:
        block.advance(1000)
    assert str(first.value) == str(second.value)
    assert single.steps == block.steps > 0
    assert single.motion.values.tobytes() == block.motion.values.tobytes()
    reach, length = block.model.reach, 2.0
    assert np.abs(block.motion.values[3:6]) @ reach[3:] < 10.0 * length
