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


def error_of(step, every, duration=4.0, axial=1, **values):
    """Return the true error of the tip, the estimate and the run."""
    scene = timo_sim.load_scene({'integrator.step': step, 'model.modes': 8, **values})
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        run = timo_sim.simulate(scene, duration, every)
        finest = {'integrator.step': 0.001, 'model.modes': 12, 'model.axial_modes': axial}
        fine = timo_sim.simulate(scene.vary(finest), duration, round(1000 * step) * every,
                                 estimate=False)
    error = np.linalg.norm(run.position(2.0) - fine.position(2.0), axis=1).max()
    return error, run.stats['estimated_tip_error_m'], run


TORQUE_STEPS = {'load.torque.piecewise.time': [0.0, 0.5, 1.0],
                'load.torque.piecewise.value': [60.0, -40.0, 0.0]}
SHAKEN = {'load.torque.harmonic.amplitude': [50.0], 'load.torque.harmonic.frequency': [3.0]}


@pytest.mark.parametrize('values', [
    {**SHAKEN, **TORQUE_STEPS, 'carrier.held': 'x'},
    {**SHAKEN, 'carrier.held': 'both', 'initial.shaft_velocity': 5.0},
    {'load.torque.table.time': [0.0, 0.203, 1.1, 1.517, 2.0],
     'load.torque.table.value': [0.0, 60.0, -60.0, 20.0, 0.0]},
    {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0, 2.03],
     'motor.drive.angle': [0.0, 3.0, 1.0], 'motor.drive.speed': [0.0, 5.0, 0.0],
     'motor.drive.acceleration': [0.0, 0.0, 0.0]}])
def test_the_estimate_is_the_error_where_steps_cause_it(values):
    error, estimate, run = error_of(0.02, 1, **values)
    assert estimate == pytest.approx(error, rel=0.5)
    assert (run.warning is not None) == (estimate > 1.4e-3)


def test_the_error_of_a_single_event_is_estimated():
    """A spike inside one of 100 steps."""
    error, estimate, _ = error_of(0.01, 1, 1.0, axial=0, **{
        'load.torque.table.time': [0.501, 0.504, 0.508], 'model.modes': 3,
        'load.torque.table.value': [0.0, 8000.0, 0.0], 'carrier.held': 'both'})
    assert error > 5e-4 and estimate == pytest.approx(error, rel=0.5)


def test_memory_does_not_grow_with_the_steps():
    scene = timo_sim.load_scene({'initial.shaft_velocity': 1.0})
    timo_sim.simulate(scene, 1.0, 1000, estimate=False)
    tracemalloc.start()
    try:
        timo_sim.simulate(scene, 100.0, 100000, estimate=False)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4e6


def test_a_load_that_is_too_fast_for_the_step_gives_a_warning():
    load = {'load.force_y.harmonic.amplitude': [1.0, 1.0],
            'load.force_y.harmonic.frequency': [1.0, 30.0]}
    with pytest.warns(timo_sim.ModelWarning, match=(
            'load.force_y.harmonic.frequency = 30 Hz is too high for integrator.step = 0.01 s')):
        timo_sim.simulate(
            timo_sim.load_scene({'integrator.step': 0.01, **load}), 1.0, estimate=False)
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
    reach, length = block.model.tip_travel, 2.0
    assert np.abs(block.motion.values[3:6]) @ reach[3:] < 10.0 * length


def test_steps_are_not_split_any_more():
    with pytest.raises(timo_sim.ParameterError, match='any more: .* smaller integrator.step'):
        timo_sim.load_scene({'integrator.tolerance': 1e-6})
