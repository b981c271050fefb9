# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Errors of steps: their estimate, warnings, divergence."""

import tracemalloc
import warnings

import numpy as np
import pytest

import timo_sim
from timo_sim.simulation.simulator import Simulator


def error_of(step, every, duration=4.0, **values):
    """Return the true error of the tip, the estimate and the run."""
    scene = timo_sim.load_scene({'integrator.step': step, **values})
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        run = timo_sim.simulate(scene, duration, every, compare=False)
        fine = timo_sim.simulate(timo_sim.load_scene({**values, 'integrator.step': step / 8}),
                                 duration, 8 * every, compare=False)
    error = np.linalg.norm(run.position(2.0) - fine.position(2.0), axis=1).max()
    return error, run.stats['step_error_m'], run


TORQUE_STEPS = {'load.torque.piecewise.time': [0.0, 0.5, 1.0],
                'load.torque.piecewise.value': [60.0, -40.0, 0.0]}
SHAKEN = {'load.torque.harmonic.amplitude': [50.0], 'load.torque.harmonic.frequency': [3.0]}


@pytest.mark.parametrize('values', [
    TORQUE_STEPS, SHAKEN, {**SHAKEN, **TORQUE_STEPS, 'carrier.held': 'x'},
    {**SHAKEN, 'carrier.held': 'both', 'initial.shaft_velocity': 5.0},
    {'load.torque.table.time': [0.0, 0.203, 1.1, 1.517, 2.0],
     'load.torque.table.value': [0.0, 60.0, -60.0, 20.0, 0.0]},
    {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0, 2.03],
     'motor.drive.angle': [0.0, 3.0, 1.0], 'motor.drive.speed': [0.0, 5.0, 0.0],
     'motor.drive.acceleration': [0.0, 0.0, 0.0]}])
@pytest.mark.parametrize('step', [0.005, 0.0025])
def test_the_estimate_is_near_the_error_of_the_run(values, step):
    error, estimate, _ = error_of(step, round(0.01 / step), **values)
    assert error / 5.0 < estimate < 5.0 * error


def test_the_estimate_depends_not_on_samples_and_hardly_on_batches():
    scene = timo_sim.load_scene({'integrator.step': 0.005, **SHAKEN, **TORQUE_STEPS})
    estimates = [timo_sim.simulate(scene, 6.0, every).stats['step_error_m']
                 for every in (1, 5, 300, 1200)]
    assert np.ptp(estimates) == 0.0
    simulator = Simulator(scene)
    for _ in range(150):
        simulator.advance(8)
    assert simulator.estimated_error > 0.0
    assert simulator.integration.errors.tip == pytest.approx(estimates[0], rel=0.1)


def test_commands_that_change_often_are_estimated_by_some_steps():
    random = np.random.default_rng(1)
    for ticks, steps in ((1000, 1), (200, 5), (50, 20)):
        commands, paths = random.normal(0.0, 60.0, ticks), []
        for parts in 1, 8:
            simulator = Simulator(timo_sim.load_scene({'integrator.step': 0.005 / parts}))
            for torque in commands:
                simulator.step(torque=torque, duration=0.005 * steps)
            model = simulator.model
            paths.append(model.world(simulator.motion.values[np.newaxis], model.tip_point)[0, 0])
            if parts == 1:
                estimate = simulator.integration.errors.tip if simulator.estimated_error else 0.0
        error = np.linalg.norm(paths[0] - paths[1])
        # One repeated step stands for all since the last, whose errors may add up or cancel.
        assert error / 10.0 < estimate < 300.0 * error


def test_errors_of_short_runs_and_single_events_are_estimated():
    # First 20 steps, one of them at rest; then 100 steps, with a spike inside one.
    for values, duration in (
            ({'load.torque.piecewise.time': [0.01], 'load.torque.piecewise.value': [2000.0]}, 0.2),
            ({'load.torque.table.time': [0.501, 0.504, 0.508],
              'load.torque.table.value': [0.0, 15000.0, 0.0], 'carrier.held': 'both'}, 1.0)):
        error, estimate, run = error_of(0.01, 1, duration, **values)
        assert error > 2e-3 and estimate > 0.1 * error and 'the tip about' in run.warning


def test_slow_growth_of_the_error_gives_a_warning_when_it_matters():
    values = {**SHAKEN, 'carrier.held': 'x', 'load.torque.harmonic.amplitude': [100.0]}
    error, _, run = error_of(0.01, 10, 60.0, **values)
    assert error > 1e-3 and 'take a smaller integrator.step' in run.warning
    error, _, run = error_of(0.01, 10, 2.0, **values)
    assert error < 1e-4 and run.warning is None


def test_memory_does_not_grow_with_the_steps():
    scene = timo_sim.load_scene({'initial.shaft_velocity': 1.0})
    timo_sim.simulate(scene, 1.0, 1000)
    tracemalloc.start()
    try:
        timo_sim.simulate(scene, 100.0, 100000)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4e6


def test_steps_that_are_too_long_give_a_warning_and_others_none():
    wrong = {'initial.shaft_velocity': 40.0, 'initial.modal_rates': [20.0, 0.0, 0.0]}
    scene = timo_sim.load_scene({'integrator.step': 0.01, **wrong})
    with pytest.warns(timo_sim.ModelWarning, match='the steps have put the tip about .* m off'):
        timo_sim.simulate(scene, 10.0)
    simulator = Simulator(timo_sim.load_scene({'integrator.step': 0.001, **wrong}))
    simulator.advance(10000)
    assert 'steps' not in simulator.warning  # it warns of modes and stretch
    assert 0.0 < simulator.integration.errors.tip < 1e-4 < simulator.estimated_error


def test_a_load_that_is_too_fast_for_the_step_gives_a_warning():
    load = {'load.force_y.harmonic.amplitude': [1.0, 1.0],
            'load.force_y.harmonic.frequency': [1.0, 30.0]}
    with pytest.warns(timo_sim.ModelWarning, match=(
            'load.force_y.harmonic.frequency = 30 Hz is too high for integrator.step = 0.01 s')):
        timo_sim.simulate(
            timo_sim.load_scene({'integrator.step': 0.01, **load}), 1.0, compare=False)
    assert Simulator(timo_sim.load_scene({'integrator.step': 0.005, **load})).warning is None


def test_divergence_names_place_time_and_remedy_and_keeps_the_last_good_state():
    scene = timo_sim.load_scene({'integrator.step': 0.02, 'initial.shaft_velocity': 300.0})
    told = (r'diverges after t = \S+ s \(step \d+\), at [a-z ]+\d* = \S+ with the arm bent by '
            r'\S+ m: take a smaller integrator.step')
    single, block = Simulator(scene), Simulator(scene)
    with pytest.raises(timo_sim.DivergenceError, match=told) as first:
        while True:
            single.advance(1)
    with pytest.raises(timo_sim.DivergenceError, match=told) as second:
        block.advance(1000)
    # The time of other warnings depends on how many steps are done at once.
    assert str(first.value).split(';')[0] == str(second.value).split(';')[0]
    assert single.steps == block.steps > 0
    assert single.motion.values.tobytes() == block.motion.values.tobytes()
    reach, length = block.model.reach, 2.0
    assert np.abs(block.motion.values[3:6]) @ reach[3:] < 10.0 * length


def test_steps_are_not_split_any_more():
    with pytest.raises(timo_sim.ParameterError, match='any more: .* smaller integrator.step'):
        timo_sim.load_scene({'integrator.tolerance': 1e-6})
