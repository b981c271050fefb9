# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Many runs of one scene with varied parameters, on many cores or machines; sweeps of a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
import itertools
import math
import multiprocessing
from multiprocessing.context import SpawnContext, SpawnProcess
import os
from pathlib import Path
import pickle
import signal
import sys
import threading
import time
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from timo_sim.compiled.functions import WIDTH
from timo_sim.extras import optional
from timo_sim.runs.run import run_scene
from timo_sim.runs.simulate import measure_error, resolve
from timo_sim.scene.files import flatten, read_yaml
from timo_sim.scene.parameters import (
    check, check_keys, checked, Parameter, ParameterError, PARAMETERS, SCENE, short, steps_in,
    TEXT, warn)
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.simulation.batch import Batch, lane_size
from timo_sim.simulation.warnings import unseen_load
from timo_sim.steps.steps import CHUNK
from timo_sim.version import __version__

# Most steps and runs of a job, and about the fewest jobs of a sweep. A job takes well below a
# second, so that little is lost if a worker dies, and all workers end at about the same time.
_MAX_STEPS, _MAX_RUNS, _MIN_JOBS = 100_000, 96, 32
_FAILURES = ArithmeticError, ValueError, MemoryError  # of a run, not of the program
_MEASURED_EVERY = 4096  # runs from one whose error is measured to the next


# Numbers of a row, with their meanings.
SUMMARY = {
    'peak_deflection': 'largest |w(l)| at a time step [m]',
    'peak_time': 'time of peak_deflection [s]',
    'rms_deflection': 'root mean square of w(l) over the time steps [m]',
    'final_deflection': 'w(l) at the end [m]',
    'peak_rotation': 'largest |phi(l)|, rotation of the tip relative to the shaft [rad]',
    'final_carrier_x': 'carrier position at the end [m]',
    'final_carrier_y': 'carrier position at the end [m]',
    'final_shaft': 'shaft angle at the end, not wrapped [rad]',
    'tip_error': 'distance of the tip from that of a finer run; NaN if not measured [m]'}


@checked(scheduler=TEXT)
def simulate_many(scene: SceneLike, variations: Iterable[Mapping[str, Any]], duration: float,
                  workers: int | None = None,
                  scheduler: str | None = None) -> dict[str, np.ndarray]:
    """
    Simulate variations of a scene on all cores, or on a Dask cluster, and keep a summary of each.

    Runs of the `exact` formulation whose steps need no special care are done together, as lanes of
    a vector (see `Batch`), several times faster. Their numbers are those of `simulate` for that
    variation to about 1e-11; those of other runs to the last bit, on the same kind of processor
    and with one BLAS thread. No bit of a row depends on the other runs or on the number of
    workers. The error of the first of each 4096 runs is measured by a finer run. The first run
    with a new number of modes compiles for a second or two.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    variations : iterable of dict
        Overrides of each run, by (nested or dotted) name of a parameter.
    duration : float
        Sim time of each run [s], a whole multiple of the time step.
    workers : int, optional
        Number of processes; by default the number of cores that this process may use.
    scheduler : str, optional
        Address of a Dask scheduler, such as `tcp://host:8786`, whose workers are used instead.

    Returns
    -------
    dict of ndarray, shape (n,)
        Columns by name, one row for each run: `run`, its number from 0; each varied parameter (NaN
        or None for a value that breaks its rule); the numbers of `timo_sim.runs.sweep.SUMMARY`
        (NaN for a run that failed), such as `peak_deflection`; `warning`, as `Run.warning`, or '';
        `reason`, why the run failed, or ''. If runs failed, a ModelWarning says so.

    Raises
    ------
    ParameterError
        If the duration does not fit the step of the scene, there are no variations, one of them
        cannot be sent to a process, or `workers` is less than 1.
    ConnectionError
        If the scheduler cannot be reached, or a worker process is killed.

    Examples
    --------
    >>> import timo_sim
    >>> variations = [{'end_effector.mass': mass} for mass in (1.0, 2.0)]
    >>> table = timo_sim.simulate_many(timo_sim.load_scene('paper'), variations, duration=1.0)
    >>> table['peak_deflection'].shape
    (2,)

    """
    if not isinstance(variations, Iterable) or isinstance(variations, Mapping):
        raise ParameterError('variations must be a list of values by name, got '
                             + short(variations))
    variations = list(variations)
    if not variations:
        raise ParameterError('variations must have at least one element, got none')
    try:
        pickle.dumps(variations)
    except (AttributeError, TypeError, pickle.PicklingError) as error:
        raise ParameterError(f'variations must be picklable: {error}') from None
    table = _simulate(load_scene(scene), duration, variations, workers, scheduler, quiet=True)
    failed = table['reason'][table['reason'] != '']
    if len(failed):
        warn(f'{len(failed)} of {len(variations)} runs failed, the first because: {failed[0]}')
    return table


def _simulate(scene, duration, variations, workers, scheduler, quiet):
    # Columns are in order of appearance. An unknown name has none, and is in a row's `reason`.
    names = tuple(name for name in {name: None for each in variations for name in flatten(each)}
                  if name in PARAMETERS and PARAMETERS[name].scope == SCENE)
    jobs = jobs_of(scene, duration, variations, names)
    with executor_of(workers, scheduler) as executor, tqdm(
            total=len(variations), unit='run', disable=quiet) as shown:
        tables = []
        for table in executor.map(run_job, jobs):
            tables.append(table)
            shown.update(len(table['run']))
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


class Job(NamedTuple):
    """Runs `first`, `first + 1`, ... of a sweep over a scene."""

    first: int
    scene: Scene
    duration: float    # [s]
    variations: tuple  # of dictionaries of overrides
    names: tuple       # of the parameters that have a column


def jobs_of(scene: Scene, duration: float, variations: list[Mapping[str, Any]],
            names: tuple[str, ...]) -> list[Job]:
    """Return the jobs of a sweep, which do not depend on the number of workers."""
    steps, count = max(1, steps_in(duration, scene.step)), len(variations)
    length = max(1, min(_MAX_RUNS, _MAX_STEPS // steps, math.ceil(count / _MIN_JOBS)))
    length = WIDTH * math.ceil(length / WIDTH)
    return [Job(first=first, scene=scene, duration=duration, names=names,
                variations=tuple(variations[first:first + length]))
            for first in range(0, count, length)]


def run_job(job: Job) -> dict[str, np.ndarray]:
    """Return the columns of a row for each run of a job, by name, see `simulate_many`."""
    numbers = np.full((len(job.variations), len(SUMMARY)), np.nan)
    table = {'run': job.first + np.arange(len(job.variations))}
    shown: list[Any] = [{**job.scene.values, **flatten(variation)} for variation in job.variations]
    table.update(dict.fromkeys(job.names), **dict(zip(SUMMARY, numbers.T)))
    table['warning'], table['reason'] = np.full((2, len(shown)), '', dtype=object)
    groups: dict[Any, list[Any]] = {}  # of (row, Scene, steps), by kind of lane, or alone
    with np.errstate(all='ignore'):
        for row, variation in enumerate(job.variations):
            with _record_reason(table, row):
                scene = job.scene.vary(variation)
                shown[row] = scene.values  # such as the modulus of a material
                scene, steps = resolve(scene, job.duration)
                key = lane_kind(scene, steps) or ('alone', row)
                groups.setdefault(key, []).append((row, scene, steps))
        for key, runs in groups.items():
            try:
                _fill_rows(table, numbers, key, runs)
            except _FAILURES:  # One of them failed: each is done alone, for a reason of its own.
                for run in runs:
                    with _record_reason(table, run[0]):
                        _fill_rows(table, numbers, key, [run])
        failed = table['reason'] != ''
        numbers[failed], table['warning'][failed] = np.nan, ''
    table.update((name, _column_of(PARAMETERS[name], [values[name] for values in shown]))
                 for name in job.names)
    return table


def _fill_rows(table, numbers, key, runs):
    """Do runs, of (row, Scene, steps), together if the key is a kind of lanes; fill their rows."""
    rows, scenes, (steps, *_) = (list(part) for part in zip(*runs))
    if key != ('alone', rows[0]):
        numbers[rows, :-1], batch = run_lanes(scenes, steps)
        for lane in np.flatnonzero(batch.failed):
            table['reason'][rows[lane]] = batch.reason(int(lane))
        table['warning'][rows] = [unseen_load(scene) or '' for scene in scenes]
    else:
        run = run_scene(scenes[0], steps)
        table['warning'][rows] = run.warning or ''
        tips = run.model.tips(run.values)[np.newaxis]
        numbers[rows, :-1] = *_summary([tips], run.scene.step)[0], *run.values[-1, :3]
    for row, scene, _ in runs:
        if table['run'][row] % _MEASURED_EVERY == 0 and not table['reason'][row]:
            run = measure_error(run_scene(scene, steps), with_remedy=False)
            numbers[row, -1] = run.stats['estimated_tip_error_m']
            table['warning'][row] = run.warning or ''


@contextmanager
def _record_reason(table, row):
    """Keep the text of an error as the reason why the run of a row failed."""
    try:
        yield
    except _FAILURES as error:
        table['reason'][row] = ' '.join(str(error).split()) or type(error).__name__


def _column_of(parameter, values):
    # A value that breaks its rule becomes NaN or None; the `reason` of its row names it.
    cells: list[Any] = [None] * len(values)
    for row, value in enumerate(values):
        with suppress(ParameterError):
            cells[row] = parameter.check(value)
    kind = type(parameter.default)
    if kind is float or kind is int and None not in cells:
        return np.array(cells, dtype=kind)
    column = np.empty(len(cells), dtype=object)
    column[:] = cells
    return column


def lane_kind(scene: Scene, steps: int) -> tuple[Any, ...] | None:
    """Return the key by which runs are grouped into lanes; None if a run must be done alone."""
    if (scene.values['model.formulation'] != 'exact' or not scene.modal_count
            or scene.build().sectors):  # which make lanes slower than single runs
        return None
    return steps, *lane_size(scene).values()


def run_lanes(scenes: list[Scene], steps: int) -> tuple[np.ndarray, Batch]:
    """Do runs of one kind together; return `SUMMARY` but for its end, (n, 8), and their Batch."""
    batch = Batch(scenes)

    def tips():
        yield np.column_stack([batch.deflection(), batch.rotation()])[:, np.newaxis]
        while batch.steps < steps:
            yield batch.advance_tips(min(CHUNK, steps - batch.steps))

    return np.hstack([_summary(tips(), scenes[0].step), batch.motion.values[:, :3]]), batch


def _summary(blocks, step):
    """Return the first numbers of `SUMMARY`, (n, 5), of blocks of tips at steps, (n, k, 3)."""
    count, (peak, peak_time, rotation, squares) = 0, np.zeros((4, 1))
    for tips in blocks:
        # The order in memory is always the same, because the last bits of sums depend on it.
        across = np.ascontiguousarray(tips)[:, :, 1]
        size = np.abs(across)
        at, found = np.argmax(size, axis=1), size.max(axis=1)
        peak_time = np.where(found > peak, step * (count + at), peak_time)
        peak = np.maximum(peak, found)
        rotation = np.maximum(rotation, np.abs(tips[:, :, 2]).max(axis=1))
        squares = squares + np.sum(size**2, axis=1)
        count += size.shape[1]
    return np.column_stack([peak, peak_time, np.sqrt(squares / count), across[:, -1], rotation])


_WORKERS = Parameter('workers', 1, '', 'processes', low=1, high=10000)
_ENVIRONMENT = {'PYTHONSAFEPATH': '1', 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1',
                'MKL_NUM_THREADS': '1'}
_STARTING = threading.Lock()


@contextmanager
def executor_of(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """
    Yield an executor; see `simulate_many`.

    Raises ConnectionError if a worker process ends early, the scheduler cannot be reached, or a
    worker of Dask has another version of this package.
    """
    if scheduler is not None:
        with _client(scheduler) as client:
            yield client.get_executor(pure=False)
        return
    count = len(os.sched_getaffinity(0)) if workers is None else _WORKERS.check(workers)
    executor = ProcessPoolExecutor(count, _Context(), _start_work, (__version__,))
    try:
        yield executor
    except BrokenProcessPool:
        raise ConnectionError('a worker process was killed or could not start; the system kills '
                              'processes when memory is short (try fewer workers)') from None
    finally:
        executor.shutdown(cancel_futures=True)


@contextmanager
def _client(address):
    with optional():
        from distributed import Client
        from distributed.comm import get_address_host_port
    try:
        get_address_host_port(address)  # a Client reports a malformed address too late
        client = Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f'no Dask scheduler at {address}: {error}') from None
    with client:
        # A lambda is sent by value: a function of this module would be the worker's own version.
        found = client.run(lambda: __import__('timo_sim').__version__, on_error='return')
        for worker, version in found.items():
            if version != __version__:
                raise ConnectionError(f'the Dask worker {worker} must have timo_sim {__version__}'
                                      f', got {version}')
        yield client


class _Worker(SpawnProcess):
    """
    A process that runs neither the caller's script nor modules of the working directory.

    A script therefore needs no `if __name__ == '__main__'`. The process has one BLAS thread.
    """

    def start(self):
        """Start the process."""
        # multiprocessing imports in the new process what is `__main__` here.
        with (_STARTING, _temporarily(sys.modules, {'__main__': ModuleType('__main__')}),
              _temporarily(os.environ, _ENVIRONMENT)):
            super().start()


class _Context(SpawnContext):
    Process = _Worker


@contextmanager
def _temporarily(mapping, values):
    before = {key: mapping[key] for key in values if key in mapping}
    mapping.update(values)
    try:
        yield
    finally:
        mapping.update(before)
        for key in values.keys() - before.keys():
            del mapping[key]


def _start_work(version):
    """Prepare a worker process: it ends with its parent, and at once if it is interrupted."""
    if version != __version__:
        raise RuntimeError(f'this program began with timo_sim {version}, and {__version__} is '
                           'installed now: start it anew')
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent():
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


_DURATION = Parameter('duration', 1.0, 's', 'sim time of each run', low=0.0, open_low=True)
_RANDOM = {'seed': Parameter('random: seed', 0, '', 'seed of the random values', low=0),
           'count': Parameter('random: count', 1, '', 'number of runs', low=1)}


class Plan(NamedTuple):
    """The checked content of a sweep's file; `variations` are the overrides of each run."""

    scene: Scene
    duration: float  # [s]
    variations: list[dict[str, Any]]


def read_plan(path: Path | str) -> Plan:
    """Read and check the file of a sweep; raise OSError or ParameterError."""
    content = read_yaml(path)
    try:
        return _plan(content, Path(path).parent)
    except ParameterError as error:
        raise ParameterError(f'{error} ({path})') from None


def _plan(content, folder):
    kinds = {'runs': _runs, 'grid': _grid, 'random': _random}
    entries = ('scene', 'parameters', 'duration', *kinds)
    check_keys('a sweep', content, entries)
    kind, *others = [*kinds.keys() & content.keys()] or ['']
    if others or not kind or 'scene' not in content:
        raise ParameterError('a sweep must have a scene and one of runs, grid, random; got '
                             + ', '.join(content))
    scene = content['scene']
    if not isinstance(scene, (str, dict)):
        raise ParameterError('scene must be the name of a file, or parameters, got '
                             + short(scene))
    scene = load_scene(folder / scene if isinstance(scene, str) else scene,
                       _check_mapping('parameters', content.get('parameters') or {}))
    duration = _DURATION.check(content.get('duration'))
    steps_in(duration, scene.step)
    return Plan(scene, duration, kinds[kind](content[kind]))


# For each kind of sweep, the overrides of each run.

def _runs(given):
    if not isinstance(given, list) or not given:
        raise ParameterError(f'runs must be a list of sets of parameters, got {short(given)}')
    for run, values in enumerate(given):
        _check_values(f'runs[{run}]', flatten(_check_mapping(f'runs[{run}]', values)))
    return given


def _grid(given):
    for name, values in _check_mapping('grid', given).items():
        if not isinstance(values, list) or not values:
            raise ParameterError(f'grid: {short(name, str)} must be a list of values, got '
                                 + short(values))
        for value in values:
            _check_values('grid', {name: value})
    return [dict(zip(given, values)) for values in itertools.product(*given.values())]


def _random(given):
    if set(_check_mapping('random', given)) != {*_RANDOM, 'ranges'}:
        raise ParameterError(f'random must have seed, count and ranges, got {short(list(given))}')
    seed, count = (rule.check(given[name]) for name, rule in _RANDOM.items())
    ranges = _check_mapping('random: ranges', given['ranges'])
    for name, ends in ranges.items():
        try:
            low, high = np.array(ends, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(
                f'random: {short(name, str)} must have a lower and an upper end, numbers or lists '
                f'of equal length, got {short(ends)}') from None
        with np.errstate(over='ignore', invalid='ignore'):
            finite = np.isfinite(high - low).all()
        if not (finite and np.all(low <= high)):
            raise ParameterError(f'random: {short(name, str)} must have finite ends in ascending '
                                 f'order, got {short(ends)}')
        for end in low, high:
            _check_values('random', {name: end.tolist()})

    random = np.random.default_rng(seed)
    return [{name: np.asarray(random.uniform(*ends)).tolist() for name, ends in ranges.items()}
            for _ in range(count)]


def _check_mapping(entry, given):
    if not isinstance(given, dict):
        raise ParameterError(f'{entry} must be parameters with values, got {short(given)}')
    return given


def _check_values(entry, values):
    check(values, entry)
    for name in values:
        if PARAMETERS[name].scope != SCENE:
            raise ParameterError(f'{name} is a parameter of the node, not of the scene ({entry})')


def run_sweep(file: Path | str, output: Path | str | None = None, workers: int | None = None,
              scheduler: str | None = None) -> bool:
    """
    Do the sweep of a file, see config/sweep.yaml, and write its table, *.parquet or *.csv.

    Return whether any run is good.

    `output` is by default named after `file`, in the working directory; `workers` and `scheduler`
    are as for `simulate_many`, with its ConnectionError. Raises ParameterError or OSError as
    `read_plan`, LogError or FileExistsError as `check_table`.
    """
    from timo_sim.log.tables import check_table, write_table
    plan = read_plan(file)
    output = Path(output or Path(file).with_suffix('.parquet').name)
    check_table(output)
    start = time.monotonic()
    table = _simulate(plan.scene, plan.duration, plan.variations, workers, scheduler,
                      quiet=None)  # a bar is for terminals alone
    write_table(table, output)
    failed, warned = (np.count_nonzero(table[name]) for name in ('reason', 'warning'))
    first = f' (the first: {next(filter(None, table["reason"]))})' if failed else ''
    print(f'{len(plan.variations)} runs in {time.monotonic() - start:.1f} s, {failed} failed'
          f'{first}, {warned} with a warning: {output}')
    return bool(failed < len(plan.variations))
