# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Runs of a sweep that are done together: rows, reasons, warnings and estimates as from one."""

import numpy as np
import pytest

import timo_sim
from timo_sim.runs.run import run_scene
from timo_sim.runs.sweep import Job, lane_kind, LaneRuns, run_job, SUMMARY

DURATION = 2.0
NUMBERS = [column.name for column in SUMMARY if column.name != 'tip_error']
PULSES = {'load.torque': {'harmonic': {'amplitude': [], 'frequency': [], 'phase': []},
                          'piecewise': {'time': [0.0, 0.5, 1.0], 'value': [20.0, -20.0, 0.0]}}}
BAD = [{'end_effector.mass': -1.0}, {'initial.modal_rates': [1.0]}, {'integrator.step': 0.03}]
DIVERGES = {'initial.shaft_velocity': 300.0}


def scene_of(paper, **more):
    """Return the paper's scene at 10 ms."""
    return timo_sim.load_scene(paper, {'integrator.step': 0.01, **more})


def variations():
    """Return 72 variations, most of which can be done together."""
    random = np.random.default_rng(5)
    found = [{'end_effector.mass': random.uniform(0.5, 5.0),
              'initial.shaft_velocity': random.uniform(-1.0, 1.0),
              'load.torque.harmonic.amplitude': [random.uniform(1.0, 8.0)]} for _ in range(53)]
    found += [{**PULSES, 'arm.length': length} for length in np.linspace(1.5, 2.5, 9)]
    found += [*BAD, DIVERGES, {}, {'carrier.held': 'x'}, {'model.modes': 0},
              {'payload': {'time': [1.0], 'mass': [2.1], 'inertia': [0.51]}},
              {'model.formulation': 'newton'}, {'motor.coulomb_friction': 0.5},
              {'motor.coulomb_friction': 0.5, 'motor.coulomb_speed': 0.2}]
    return found


def shown(run):
    """Return the numbers of a row, computed from a run."""
    length = run.scene.values['arm.length']
    deflection, rotation = run.deflection(length)[:, 1], run.rotation(length)
    peak = np.argmax(np.abs(deflection))
    return [abs(deflection[peak]), run.t[peak], np.sqrt(np.mean(deflection**2)), deflection[-1],
            np.abs(rotation).max(), *run.carrier[-1], run.shaft[-1]]


@pytest.fixture(scope='module')
def table(paper):
    """Return the rows of a sweep over `variations`."""
    return timo_sim.simulate_many(scene_of(paper), variations(), DURATION, workers=2)


def test_rows_are_those_of_simulate(table, paper):
    for row, variation in enumerate(variations()):
        if row % 4 and row < 53:
            continue
        try:
            scene = scene_of(paper).vary(variation)
            run = timo_sim.simulate(scene, DURATION, estimate=False)
        except (timo_sim.ParameterError, timo_sim.DivergenceError) as error:
            # What an estimate warned of just before a divergence is not in it.
            assert table['reason'][row] == ' '.join(str(error).split()).partition('; by t')[0]
            assert all(np.isnan(table[name][row]) for name in NUMBERS)
            assert table['warning'][row] == ''
            continue
        assert (table['reason'][row], table['warning'][row]) == ('', run.warning or '')
        np.testing.assert_allclose([table[name][row] for name in NUMBERS], shown(run), rtol=1e-10,
                                   atol=1e-11)
    assert sum(map(bool, table['reason'])) == len(BAD) + 1


@pytest.mark.parametrize('jobs', [1, 3])
def test_bits_do_not_depend_on_the_other_runs(table, paper, jobs):
    """One worker, and jobs that hold other runs, in the opposite order."""
    every = variations()[::-1]
    size = len(every) // jobs
    parts = [run_job(Job(first, scene_of(paper), DURATION, tuple(every[first:first + size]), (),
                         True)) for first in range(0, len(every), size)]
    for name in (*NUMBERS, 'reason', 'warning'):
        again = np.concatenate([part[name] for part in parts])[::-1]
        np.testing.assert_array_equal(table[name], again)


@pytest.mark.parametrize('base, variation', [
    ({}, [{'end_effector.mass': mass} for mass in (0.5, 2.0, 6.0)]),
    ({}, [{'initial.shaft_velocity': speed} for speed in (0.0, 1.0, 3.0)]),
    (PULSES, [{'arm.length': length} for length in (1.6, 2.0)]),
    ({'carrier.held': 'both', 'motor.shaft': 'driven', 'motor.drive': {
        'time': [0.0, 1.0], 'angle': [0.0, 0.4], 'speed': [0.0, 0.0],
        'acceleration': [0.0, 0.0]}, 'gravity': [0.0, -9.81]},
     [{'end_effector.mass': mass} for mass in (1.0, 2.0)])],
    ids=['masses', 'speeds', 'pulses', 'driven'])
def test_motions_are_those_of_simulate(paper, base, variation):
    scenes = [scene_of(paper, **base).vary(each) for each in variation]
    steps = round(DURATION / 0.01)
    kind, = {lane_kind(scene, steps) for scene in scenes}
    found = LaneRuns(scenes, kind)
    for k, scene in enumerate(scenes):
        run = run_scene(scene, steps)
        assert found.motion[k] == pytest.approx(run.motion[-1], rel=1e-10, abs=1e-11)


def test_a_load_that_is_too_fast_gives_a_warning(paper):
    scene = scene_of(paper, **{'load.torque.harmonic.frequency': [30.0]})
    together, = LaneRuns([scene], lane_kind(scene, 200)).warnings
    assert together == run_scene(scene, 200).warning and 'too high' in together


def test_runs_that_lanes_do_not_know_are_done_alone(paper):
    for more in ({'carrier.held': 'x'}, {'model.formulation': 'newton'},
                 {'model.modes': 0}):
        assert lane_kind(scene_of(paper, **more), 200) is None


def test_an_error_of_one_run_is_not_that_of_the_others(paper, monkeypatch):
    """The others have the same numbers, to the last bit, as if none had failed."""
    class Failing(LaneRuns):
        def __init__(self, scenes, kind):
            if any(scene.values['initial.shaft'] == 1.0 for scene in scenes):
                raise FloatingPointError('a singular matrix')
            super().__init__(scenes, kind)

    angles = np.linspace(0.0, 1.0, 9)
    job = Job(0, scene_of(paper), DURATION,
              tuple({'initial.shaft': angle} for angle in angles), ('initial.shaft',), True)
    usual = run_job(job)
    monkeypatch.setattr('timo_sim.runs.sweep.LaneRuns', Failing)
    found = run_job(job)
    assert [*found['reason']] == 8 * [''] + ['a singular matrix']
    for name in NUMBERS:
        np.testing.assert_array_equal(found[name][:8], usual[name][:8])
        assert np.isnan(found[name][8])
