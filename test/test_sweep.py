# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Many runs: rows as from `simulate`, failed runs, refusals, jobs, workers that die."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import numpy as np
import pytest

import timo_sim
from timo_sim.runs.run import run_scene
from timo_sim.runs.sweep import executor_of, Job, run_job, run_lanes, SUMMARY
from timo_sim.version import __version__

FAST = {'integrator.step': 0.01}
NUMBERS = [name for name in SUMMARY if name != 'tip_error']

DURATION = 2.0
PULSES = {'load.torque': {'harmonic': {'amplitude': [], 'frequency': [], 'phase': []},
                          'piecewise': {'time': [0.0, 0.5, 1.0], 'value': [20.0, -20.0, 0.0]}}}
BAD = [{'end_effector.mass': -1.0}, {'initial.modal_rates': [1.0]}, {'integrator.step': 0.03}]


@pytest.fixture(scope='module')
def scene(paper):
    return timo_sim.load_scene(paper, FAST)


def expected(run):
    """Return the numbers of a row, computed from a run."""
    deflection, rotation = run.deflection()[:, 1], run.rotation()
    peak = np.argmax(np.abs(deflection))
    return [abs(deflection[peak]), run.t[peak], np.sqrt(np.mean(deflection**2)), deflection[-1],
            np.abs(rotation).max(), *run.carrier[-1], run.shaft[-1]]


def numbers(table, row):
    return [table[name][row] for name in NUMBERS]


def test_rows_are_those_of_simulate_and_the_same_for_one_worker_and_two(scene):
    random = np.random.default_rng(3)
    variations = [{'end_effector.mass': random.uniform(0.5, 5.0), 'initial': {
        'shaft_velocity': random.uniform(-1.0, 1.0), 'carrier_x': 1.0},
        'load.torque.harmonic.amplitude': [random.uniform(1.0, 8.0)]} for _ in range(9)]
    variations += [{'model.formulation': 'newton', 'end_effector.mass': 1.0},
                   {'payload': {'time': [0.5, 1.5], 'mass': [2.1, 1.9], 'inertia': [0.51, 0.5]}},
                   {'model.modes': 0}, {'carrier.held': 'x'}, {'integrator.step': 0.004}, {},
                   {'load.torque.harmonic.amplitude': [], 'load.torque.harmonic.frequency': [],
                    'load.torque.harmonic.phase': []}]
    tables = [timo_sim.simulate_many(scene, iter(variations), DURATION, workers=workers)
              for workers in (1, 2)]
    one, two = tables
    assert one['run'].tolist() == list(range(len(variations)))
    assert not any(one['reason']) and not any(one['warning'])
    for row, variation in enumerate(variations):
        run = timo_sim.simulate(timo_sim.load_scene(scene.values, variation), DURATION,
                                estimate=False)
        np.testing.assert_allclose(numbers(one, row), expected(run), rtol=1e-10, atol=1e-11)
    assert list(one) == list(two)
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])


def test_parameters_are_columns_with_the_scenes_value_where_a_run_does_not_set_them(scene):
    table = timo_sim.simulate_many(scene, [
        {'end_effector': {'mass': 1.0}}, {'load.torque.harmonic.amplitude': [3]},
        {'model.formulation': 'newton'}], 0.1, workers=1)
    assert list(table) == ['run', 'end_effector.mass', 'load.torque.harmonic.amplitude',
                           'model.formulation', *NUMBERS, 'tip_error', 'warning', 'reason']
    assert table['end_effector.mass'].tolist() == [1.0, 2.0, 2.0]
    assert table['load.torque.harmonic.amplitude'].tolist() == [(5.0,), (3.0,), (5.0,)]
    assert table['model.formulation'].tolist() == ['exact', 'exact', 'newton']


def test_columns_have_what_a_material_of_a_run_sets(scene):
    table = timo_sim.simulate_many(scene, [
        {'arm.material': 'steel'}, {'arm.young_modulus': 1e11}, {'model.formulation': 'none'}],
        0.1, workers=1)
    assert table['arm.young_modulus'].tolist() == [
        2.1e11, 1e11, scene.values['arm.young_modulus']]
    assert table['arm.material'].tolist() == ['steel', 'none', 'none']
    assert table['model.formulation'].tolist() == ['exact', 'exact', None]


DIVERGES = {'initial.shaft_velocity': 300.0, 'model.modes': 12}
FAILURES = [
    (DIVERGES, timo_sim.DivergenceError, 'the state diverges after t = '),
    ({'end_effector.mass': -1.0}, timo_sim.ParameterError, 'end_effector.mass must be .* got -1'),
    ({'arm.length': 'two'}, timo_sim.ParameterError, 'arm.length must be .*two'),
    ({'integrator.step': 0.03}, timo_sim.ParameterError, 'duration = 2 must be a whole multiple'),
    ({'model.modes': [3]}, timo_sim.ParameterError, 'model.modes must be a whole number'),
]


def test_a_run_that_fails_is_a_row_with_the_reason(scene):
    variations = [variation for pair in FAILURES for variation in (pair[0], {})]
    with pytest.warns(timo_sim.ModelWarning, match='5 of 10 runs failed.* the state diverges'):
        table = timo_sim.simulate_many(scene, variations, 2.0, workers=2)
    good = expected(timo_sim.simulate(scene, 2.0))
    for row, (variation, kind, words) in enumerate(FAILURES):
        with pytest.raises(kind, match=words) as caught:
            timo_sim.simulate(timo_sim.load_scene(scene.values, variation), 2.0)
        assert table['reason'][2 * row] == ' '.join(str(caught.value).split())
        assert np.isnan(numbers(table, 2 * row)).all()
        assert table['reason'][2 * row + 1] == ''
        np.testing.assert_allclose(numbers(table, 2 * row + 1), good, rtol=1e-10, atol=1e-11)
    assert np.isnan(table['end_effector.mass'][2]) and np.isnan(table['arm.length'][4])
    assert table['model.modes'].tolist()[:2] == [12, 3] and table['model.modes'][8] is None


def test_a_run_with_a_warning_has_it_in_its_row(scene):
    fast = {'model.formulation': 'newton', 'initial.shaft_velocity': 20.0}
    table = timo_sim.simulate_many(scene, [fast, {}], 0.1, workers=1)
    with pytest.warns(timo_sim.ModelWarning) as caught:
        timo_sim.simulate(scene.vary(fast), 0.1, estimate=False)
    first, second = table['warning']
    # The error of the first run was measured, too.
    assert first.startswith('the estimated tip error is')
    assert first.endswith(f'; {caught[0].message}') and not second


BAD_ARGUMENTS = [
    ({'variations': []}, 'at least one element, got none'),
    ({'duration': 0.125}, 'the ratio is 12.5'),
    ({'variations': [{'arm.length': lambda: 2.0}]}, 'variations must be picklable'),
    ({'variations': {'arm.length': [2.0]}}, 'variations must be a list of values by name, got {'),
    ({'variations': [{'arm': {'length': 2.0}, 'arm.length': 3.0}]}, 'arm.length is given twice'),
    ({'workers': 1.5}, 'workers must be a whole number >= 1 and <= 10000, got 1.5')
]


def test_invalid_arguments_are_refused(scene):
    for given, words in BAD_ARGUMENTS:
        with pytest.raises(timo_sim.ParameterError, match=words) as caught:
            timo_sim.simulate_many(scene, **{'variations': [{}], 'duration': 0.1, **given})
        assert '\n' not in str(caught.value)


def test_a_worker_that_dies_is_an_error_and_one_that_prints_is_not():
    with pytest.raises(ConnectionError, match='a worker process was killed'):
        with executor_of(2) as executor:
            assert executor.submit(os.getenv, 'OPENBLAS_NUM_THREADS').result() == '1'
            assert executor.submit(os.system, 'echo noise').result() == 0
            executor.submit(os.abort).result()


def test_a_script_needs_no_guard_and_workers_of_another_version_are_refused(tmp_path):
    place = shutil.copytree(Path(timo_sim.__file__).parent, tmp_path / 'timo_sim')
    script = tmp_path / 'script.py'
    script.write_text(f"""
import pathlib, timo_sim
print('script')
scene = timo_sim.load_scene({{}})
timo_sim.simulate_many(scene, [{{}}], 0.01, workers=1)
pathlib.Path({str(place)!r}, 'version.py').write_text('__version__ = "99.0"')
timo_sim.simulate_many(scene, [{{}}], 0.01, workers=1)
""")
    done = subprocess.run([sys.executable, '-P', script], capture_output=True, text=True,
                          env={**os.environ, 'PYTHONPATH': str(tmp_path)})
    assert (done.returncode, done.stdout) == (1, 'script\n')
    assert f'began with timo_sim {__version__}, and 99.0 is installed now' in done.stderr


def variations():
    """Return variations, most of which can be done together."""
    random = np.random.default_rng(5)
    found = [{'end_effector.mass': random.uniform(0.5, 5.0),
              'initial.shaft_velocity': random.uniform(-1.0, 1.0),
              'load.torque.harmonic.amplitude': [random.uniform(1.0, 8.0)]} for _ in range(53)]
    found += [{**PULSES, 'arm.length': length} for length in np.linspace(1.5, 2.5, 9)]
    found += [*BAD, {'initial.shaft_velocity': 300.0}, {}, {'carrier.held': 'x'},
              {'model.modes': 0},
              {'payload': {'time': [1.0], 'mass': [2.1], 'inertia': [0.51]}},
              {'model.formulation': 'newton'}, {'motor.coulomb_friction': 0.5},
              {'motor.coulomb_friction': 0.5, 'motor.coulomb_speed': 0.2}]
    return found


@pytest.fixture(scope='module')
def table(scene):
    """Return the rows of a sweep over `variations`."""
    return timo_sim.simulate_many(scene, variations(), DURATION, workers=2)


def test_rows_of_lanes_are_those_of_simulate(table, scene):
    for row, variation in enumerate(variations()):
        if row % 4 and row < 53:
            continue
        try:
            run = timo_sim.simulate(scene.vary(variation), DURATION, estimate=False)
        except (timo_sim.ParameterError, timo_sim.DivergenceError) as error:
            assert table['reason'][row] == ' '.join(str(error).split())
            assert np.isnan(numbers(table, row)).all() and table['warning'][row] == ''
            continue
        assert (table['reason'][row], table['warning'][row]) == ('', run.warning or '')
        np.testing.assert_allclose(numbers(table, row), expected(run), rtol=1e-10, atol=1e-11)
    assert sum(map(bool, table['reason'])) == len(BAD) + 1


def test_bits_of_lanes_do_not_depend_on_the_other_runs(table, scene):
    """Jobs of one worker that hold other runs, in the opposite order."""
    every = variations()[::-1]
    parts = [run_job(Job(first, scene, DURATION, tuple(every[first:first + 24]), ()))
             for first in range(0, len(every), 24)]
    for name in (*NUMBERS, 'reason', 'warning'):
        again = np.concatenate([part[name] for part in parts])[::-1]
        np.testing.assert_array_equal(table[name], again)


def test_a_load_that_is_too_fast_gives_a_warning(scene):
    fast = scene.vary({'load.torque.harmonic.frequency': [30.0]})
    warning, = run_job(Job(1, fast, 2.0, ({},), ()))['warning']
    assert warning == run_scene(fast, 200).warning and 'too high' in warning


def test_an_error_of_one_run_is_not_that_of_the_others(scene, monkeypatch):
    """The others have the same numbers, to the last bit, as if none had failed."""
    def failing(scenes, steps):
        if any(scene.values['initial.shaft'] == 1.0 for scene in scenes):
            raise FloatingPointError('a singular matrix')
        return run_lanes(scenes, steps)

    angles = np.linspace(0.0, 1.0, 9)
    job = Job(0, scene, DURATION,
              tuple({'initial.shaft': angle} for angle in angles), ('initial.shaft',))
    usual = run_job(job)
    monkeypatch.setattr('timo_sim.runs.sweep.run_lanes', failing)
    found = run_job(job)
    assert [*found['reason']] == 8 * [''] + ['a singular matrix']
    for name in NUMBERS:
        np.testing.assert_array_equal(found[name][:8], usual[name][:8])
        assert np.isnan(found[name][8])
