# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`timo_sim sweep`: file in, Parquet out; refusals; killed; on a Dask cluster."""

from contextlib import chdir
import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from command_line import call
import numpy as np
from pyarrow import parquet
import pytest
import yaml

import timo_sim
from timo_sim.runs.sweep import executor_of, jobs_of, read_plan, run_job

# With -P as the installed command: neither has the working directory among its paths.
COMMAND = [sys.executable, '-P', '-c', 'from timo_sim.cli import main; main(prog_name="timo_sim")']
ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 300.0  # [s]; a longer wait is a hang
RANDOM = {'seed': 7, 'count': 96, 'ranges': {
    'end_effector.mass': [0.5, 5.0], 'load.torque.harmonic.amplitude': [[1.0], [8.0]]}}


@pytest.fixture
def write(tmp_path, paper):
    """Return a function that writes the file of a sweep, by default of the paper's scene."""
    def write(**entries):
        given = {'scene': str(paper), 'duration': 2.0, 'parameters': {'integrator.step': 0.01},
                 **entries}
        path = tmp_path / 'study.yaml'
        path.write_text(yaml.safe_dump({key: value for key, value in given.items()
                                        if value is not None}, sort_keys=False))
        return path
    return write


def start(folder, *arguments):
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    return subprocess.Popen([*COMMAND, 'sweep', *map(str, arguments)], cwd=folder, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            env={**os.environ, 'PYTHONPATH': path})


def end(command):
    output, errors = command.communicate(timeout=PATIENCE)
    return command.returncode, output, errors


def refused(path, folder):
    """Return the output of `timo_sim sweep` in this process; it must end with code 2."""
    with chdir(folder):
        return call('sweep', path, code=2)


def rows(path):
    return {name: [math.nan if cell is None else cell for cell in column]
            for name, column in parquet.read_table(path).to_pydict().items()}


def children_of(process):
    """Return the ids of a process's own processes as soon as it has two."""
    for _ in range(round(PATIENCE / 0.01)):
        found = [int(pid) for task in Path(f'/proc/{process.pid}/task').iterdir()
                 for pid in (task / 'children').read_text().split()]
        if len(found) >= 2:
            return found
        time.sleep(0.01)
    raise TimeoutError(f'{len(found)} processes')


TABLES = {}  # of `many`, by the text of the file


def many(path):
    """Return what `simulate_many` gives for the file of a sweep."""
    text = path.read_text()
    if text not in TABLES:
        plan = read_plan(path)
        table = timo_sim.simulate_many(plan.scene, plan.variations, plan.duration, workers=1)
        TABLES[text] = {name: [list(cell) if isinstance(cell, tuple) else cell
                               for cell in column.tolist()] for name, column in table.items()}
    return TABLES[text]


def test_file_in_parquet_out(write, tmp_path):
    """Modules of the working directory are not executed."""
    (tmp_path / 'timo_sim').mkdir()
    for name in ('yaml.py', 'socket.py', 'timo_sim/__init__.py'):
        (tmp_path / name).write_text('raise SystemExit("foreign code")')
    path = write(grid={'end_effector.mass': [1.0, 2.0],
                       'initial.shaft_velocity': [0.0, 20.0],
                       'initial.modal_rates': [[1.0, 0.0, 0.0], [1e200, 0.0, 0.0]]},
                 parameters={'integrator.step': 0.01, 'model.formulation': 'newton'})
    code, output, errors = end(start(tmp_path, path, '--workers', '2'))
    assert (code, errors) == (0, '')
    table = rows(tmp_path / 'study.parquet')
    assert [bool(reason) for reason in table['reason']] == 4 * [False, True]
    # What newton leaves out is told of each run that did not fail.
    warned = [bool(warning) for warning in table['warning']]
    assert warned == 4 * [True, False]
    assert output.startswith('8 runs in ')
    assert re.search(r' s, 4 failed \(the first: the values of this scene are too large .*\), '
                     f'{sum(warned)} with a warning: study.parquet', output)
    direct = many(path)
    assert list(table) == list(direct)
    for name, column in table.items():
        np.testing.assert_array_equal(column, direct[name])

    assert refused(path, tmp_path) == (
        'timo_sim: study.parquet exists: remove it or choose another name\n')


def test_a_sweep_of_which_every_run_fails_has_an_exit_code(write, tmp_path):
    path = write(runs=[{'initial.modal_rates': [1e200, 0.0, 0.0]}])
    code, output, _ = end(start(tmp_path, path, '--workers', '1'))
    assert code == 1 and '1 failed (the first: the values of this scene' in output


def test_the_example_can_be_read_as_it_is_and_with_each_of_its_ways_to_vary(write):
    text = (ROOT / 'config' / 'sweep.yaml').read_text()
    plan = read_plan(ROOT / 'config' / 'sweep.yaml')
    assert len(plan.variations) == 80
    assert plan.scene.step == 0.01 and plan.duration == 10.0
    assert plan.variations[0] == {
        'end_effector.mass': 0.5, 'load.torque.harmonic.amplitude': [1.0]}
    for kind, count in ('random', 10000), ('runs', 2):
        block = text[text.index(f'# {kind}:'):].split('\n\n')[0].replace('\n# ', '\n')[2:]
        given = yaml.safe_load(text.split('grid:')[0] + block)
        del given['scene']
        assert len(read_plan(write(**given)).variations) == count


def test_a_grid_is_all_combinations_the_last_fastest(write):
    plan = read_plan(write(grid={'end_effector.mass': [1.0, 2.0], 'model.modes': [1, 2, 3]}))
    assert [tuple(values.values()) for values in plan.variations] == [
        (1.0, 1), (1.0, 2), (1.0, 3), (2.0, 1), (2.0, 2), (2.0, 3)]


def test_random_values_fill_their_ranges_and_repeat_with_their_seed(write):
    first, again = (read_plan(write(random=RANDOM)).variations for _ in range(2))
    other = read_plan(write(random={**RANDOM, 'seed': 8})).variations
    assert first == again and first != other
    for name, low, high in (('end_effector.mass', 0.5, 5.0),
                            ('load.torque.harmonic.amplitude', 1.0, 8.0)):
        share = (np.ravel([values[name] for values in first]) - low) / (high - low)
        assert share.min() > 0.0 and share.max() < 1.0 and len(set(share)) == 96
        # The mean of 96 even values: 0.5 within 3.4 times sqrt(1 / 12 / 96).
        assert abs(share.mean() - 0.5) < 0.1


BAD_FILES = [
    ({}, 'one of runs, grid, random; got scene, duration, parameters'),
    ({'grid': {'model.modes': [1]}, 'runs': [{}]}, 'one of runs, grid, random'),
    ({'grids' * 99: {}}, 'a sweep: gridsgrids'),
    ({'scene': None, 'runs': [{}]}, 'must have a scene'),
    ({'scene': 'none.yaml', 'runs': [{}]}, 'none.yaml'),
    ({'scene': [3] * 99, 'runs': [{}]}, 'scene must be the name of a file, or parameters, got [3'),
    ({'duration': -1.0, 'runs': [{}]}, 'duration must be a finite number > 0 s, got -1.0'),
    ({'runs': 'all' * 99}, "runs must be a list of sets of parameters, got 'all"),
    ({'runs': [{'arm.lenght': 1.0}]}, 'arm.lenght = 1.0 is not a parameter of timo_sim (runs[0])'),
    ({'runs': [{'record': True}]}, 'record is a parameter of the node, not of the scene'),
    ({'grid': {'model.modes': 3}}, 'grid: model.modes must be a list of values, got 3'),
    ({'random': {'seed': 1}}, "random must have seed, count and ranges, got ['seed']"),
    ({'random': {**RANDOM, 'ranges': {'end_effector.mass': [5.0, 0.5]}}}, 'in ascending order'),
    ({'random': {**RANDOM, 'ranges': {'motor.torque_limit': [1.0, np.inf]}}}, 'finite ends'),
    ({'random': {**RANDOM, 'ranges': {'arm.length': [1.0] * 99}}}, 'a lower and an upper end'),
    ({'random': {**RANDOM, 'ranges': {'model.modes': [1.5, 3]}}}, 'model.modes must be a whole'),
    # What is drawn between two whole numbers is none.
    ({'random': {**RANDOM, 'ranges': {'model.modes': [1, 3]}}}, 'model.modes must be a whole')
]


def test_files_that_are_refused_in_a_short_line(write):
    for entries, words in BAD_FILES:
        path = write(**entries)
        with pytest.raises((timo_sim.ParameterError, FileNotFoundError)) as caught:
            read_plan(path)
        told = str(caught.value)
        assert words in told and 'yaml' in told
        assert len(told.removesuffix(f' ({path})')) < 250 and '\n' not in told


def test_workers_end_with_a_sweep_that_is_killed_and_no_part_of_a_table_is_left(write, tmp_path):
    sweep = start(tmp_path, write(random={**RANDOM, 'count': 10**5}), '--workers', '2')
    workers = children_of(sweep)
    sweep.send_signal(signal.SIGKILL)
    assert end(sweep)[0] == -signal.SIGKILL
    for _ in range(round(PATIENCE / 0.01)):
        if not any(Path(f'/proc/{pid}').exists() for pid in workers):
            break
        time.sleep(0.01)
    assert not any(Path(f'/proc/{pid}').exists() for pid in workers)
    assert [path.name for path in tmp_path.iterdir()] == ['study.yaml']


def test_on_a_cluster_a_killed_worker_loses_and_repeats_nothing(write, tmp_path):
    from distributed import Client, LocalCluster
    plan = read_plan(write(random=RANDOM, duration=10.0))
    jobs = jobs_of(plan.scene, plan.duration, plan.variations, ())
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            pids = list(client.run(os.getpid).values())
        with executor_of(scheduler=cluster.scheduler_address) as executor:
            tables = []
            for table in executor.map(run_job, jobs):
                tables.append(table)
                if len(tables) == 1:
                    os.kill(pids[0], signal.SIGKILL)
        with Client(cluster) as client:
            client.run(lambda: setattr(__import__('timo_sim'), '__version__', '0'))
        with pytest.raises(ConnectionError, match='worker .* must have timo_sim .*, got 0'):
            with executor_of(scheduler=cluster.scheduler_address):
                pass
    assert len(tables) == len(jobs) > 2
    for name, column in many(write(random=RANDOM, duration=10.0)).items():
        if name in tables[0]:
            np.testing.assert_equal(np.concatenate([each[name] for each in tables]), column)


def test_no_scheduler_is_one_line_and_code_1(write, tmp_path):
    import dask
    with dask.config.set({'distributed.comm.timeouts.connect': '0.3s'}):
        with pytest.raises(ConnectionError, match='no Dask scheduler at tcp://127.0.0.1:1'):
            with executor_of(scheduler='tcp://127.0.0.1:1'):
                pass
