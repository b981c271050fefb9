# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A manipulator at rest is not computed, and its motion is the same to the last bit."""

import numpy as np
import pytest

import timo_sim
from timo_sim.model import FORMULATIONS
from timo_sim.model.layout import LOADS, TORQUE
from timo_sim.simulation.simulator import Simulator
from timo_sim.steps.steps import Steps

LONG = 700  # steps


def torque(value):
    """Return the load of a torque."""
    load = np.zeros(LOADS)
    load[TORQUE] = value
    return load


def history(scene):
    """Return motions of a simulator at rest, then under a torque, then without one again."""
    simulator = Simulator(scene)
    motions = list(simulator.advance(LONG, sample_every=1)[0])
    assert simulator.steps == LONG and len(motions) == 1 + LONG
    for k in range(LONG, 2 * LONG):
        simulator.advance(1, torque(2.0 if k < LONG + 50 else 0.0))
        motions.append(simulator.motion.values)
    return np.array(motions)


@pytest.mark.parametrize('formulation', FORMULATIONS)
@pytest.mark.parametrize('held', ['none', 'x', 'both'])
def test_skipped_steps_give_the_same_bits_as_computed_ones(formulation, held, monkeypatch):
    scene = timo_sim.load_scene({
        'model.formulation': formulation, 'carrier.held': held, 'initial.shaft': 0.7,
        'initial.carrier_x': 0.3, 'initial.carrier_y': -1.7, 'arm.damping_ratio': [0.01]})
    skipped = history(scene)
    monkeypatch.setattr(Simulator, '_rests', lambda *_: False)
    assert skipped.tobytes() == history(scene).tobytes()
    assert skipped[LONG + 1, 2] != skipped[LONG, 2] != skipped[-1, 2]


def test_no_step_is_computed_at_rest(monkeypatch):
    computed, advance = [], Steps.advance

    def counting(steps, state, load, loads, *samples):
        computed.append(len(loads))
        return advance(steps, state, load, loads, *samples)

    monkeypatch.setattr(Steps, 'advance', counting)
    simulator = Simulator(timo_sim.load_scene({}))
    simulator.advance(LONG)
    assert simulator.nanoseconds == LONG * 1000000 and not any(computed)
    simulator.advance(1, torque(1.0))
    simulator.advance(5, torque(0.0))
    assert sum(computed) == 6
    # After a reset it rests again.
    simulator.reset()
    simulator.advance(LONG)
    assert simulator.steps == 2 * LONG + 6 and sum(computed) == 6


@pytest.mark.parametrize('moving', [
    {'initial.carrier_x_velocity': 0.1}, {'initial.carrier_y_velocity': 0.1},
    {'initial.shaft_velocity': 0.1}, {'initial.modal_coordinates': [0.0, 0.0, 1e-3]},
    {'initial.modal_rates': [1e-3, 0.0, 0.0]},
    {'load.force_y.piecewise.time': [0.5], 'load.force_y.piecewise.value': [1.0]},
    {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0], 'motor.drive.angle': [0.0, 1.0],
     'motor.drive.speed': [0.0, 0.0], 'motor.drive.acceleration': [0.0, 0.0]}],
    ids=lambda values: next(iter(values)))
def test_scenes_that_move_now_or_later_are_computed(moving):
    motion = timo_sim.simulate(timo_sim.load_scene(moving), 1.0).motion
    assert not np.array_equal(motion[0], motion[-1])
