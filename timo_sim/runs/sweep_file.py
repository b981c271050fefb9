# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Do the sweep of a file: write a part for each job, and join all parts to a Parquet file.

A part appears under its name only when it is whole. A sweep that was killed goes on with the parts
that are missing; each job is in the result once.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import fcntl
import hashlib
import itertools
import math
import os
from pathlib import Path
import shutil
import time
from typing import Any

import numpy as np
import pyarrow
from pyarrow import parquet
from tqdm import tqdm

from timo_sim.runs.sweep import executor_of, Job, jobs_of, run_jobs, SUMMARY
from timo_sim.scene.files import flatten, read_yaml, whole_file
from timo_sim.scene.parameters import (
    check, Parameter, ParameterError, PARAMETERS, SCENE, short, steps_in)
from timo_sim.scene.scene import load_scene, Scene
from timo_sim.version import __version__

_KINDS = ('runs', 'grid', 'random')
_ENTRIES = ('scene', 'parameters', 'duration', *_KINDS)
_DURATION = Parameter('duration', 1.0, 's', 'sim time of each run', low=0.0, open_low=True)
_RANDOM = {'seed': Parameter('random: seed', 0, '', 'seed of the random values', low=0),
           'count': Parameter('random: count', 1, '', 'number of runs', low=1)}


@dataclass(frozen=True)
class Plan:
    """The checked content of a sweep's file."""

    scene: Scene
    duration: float  # [s]
    names: list[str]  # of the parameters that vary
    count: int       # number of runs
    kind: str        # one of _KINDS
    given: Any       # the file's entry of this kind

    def variations(self) -> Iterator[dict[str, Any]]:
        """Yield the overrides of each run, the same ones each time."""
        if self.kind == 'runs':
            yield from self.given
        elif self.kind == 'grid':
            for values in itertools.product(*self.given.values()):
                yield dict(zip(self.given, values))
        else:
            random = np.random.default_rng(self.given['seed'])
            for _ in range(self.count):
                yield {name: np.asarray(random.uniform(*ends)).tolist()
                       for name, ends in self.given['ranges'].items()}

    def jobs(self) -> Iterator[Job]:
        """Yield the jobs of the sweep, the same ones each time."""
        return jobs_of(self.scene, self.duration, self.count, self.variations(), self.names)

    @property
    def fingerprint(self) -> str:
        """A text that differs for plans whose results may differ."""
        content = __version__, self.scene.values, self.duration, self.kind, self.given
        return hashlib.sha256(repr(content).encode()).hexdigest()


def read_plan(path: Path | str) -> Plan:
    """Read and check the file of a sweep; raise OSError or ParameterError."""
    content = read_yaml(path)
    try:
        return _plan(content, Path(path).parent)
    except ParameterError as error:
        raise ParameterError(f'{error} ({path})') from None


def _plan(content, folder):
    if not isinstance(content, dict) or not set(content) <= set(_ENTRIES):
        shown = [*set(content) - set(_ENTRIES)] if isinstance(content, dict) else content
        raise ParameterError(f'a sweep has the entries {", ".join(_ENTRIES)}; got {short(shown)}')
    kinds = [kind for kind in _KINDS if kind in content]
    if len(kinds) != 1 or 'scene' not in content:
        raise ParameterError('a sweep must have a scene and one of runs, grid, random; got '
                             + ', '.join(content))
    scene, kind = content['scene'], kinds[0]
    if not isinstance(scene, (str, dict)):
        raise ParameterError('scene must be the name of a file, or parameters, got '
                             + short(scene))
    scene = load_scene(folder / scene if isinstance(scene, str) else scene,
                       _mapping('parameters', content.get('parameters') or {}))
    duration = _DURATION.check(content.get('duration'))
    steps_in(duration, scene.step)
    names, count = {'runs': _runs, 'grid': _grid, 'random': _random}[kind](content[kind])
    return Plan(scene, duration, names, count, kind, content[kind])


def _runs(given):
    if not isinstance(given, list) or not given:
        raise ParameterError(f'runs must be a list of sets of parameters, got {short(given)}')
    for run, values in enumerate(given):
        _check(f'runs[{run}]', flatten(_mapping(f'runs[{run}]', values)))
    names = dict.fromkeys(name for values in given for name in flatten(values))
    return list(names), len(given)


def _grid(given):
    for name, values in _mapping('grid', given).items():
        if not isinstance(values, list) or not values:
            raise ParameterError(f'grid: {short(name, str)} must be a list of values, got '
                                 + short(values))
        for value in values:
            _check('grid', {name: value})
    return list(given), math.prod(len(values) for values in given.values())


def _random(given):
    if set(_mapping('random', given)) != {*_RANDOM, 'ranges'}:
        raise ParameterError(f'random must have seed, count and ranges, got {short(list(given))}')
    for name, parameter in _RANDOM.items():
        parameter.check(given[name])
    for name, ends in _mapping('random: ranges', given['ranges']).items():
        try:
            low, high = np.array(ends, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(
                f'random: {short(name, str)} must have a lower and an upper end, numbers or lists '
                f'of equal length, got {short(ends)}') from None
        if not np.all(low <= high):
            raise ParameterError(f'random: {short(name, str)} must have ends in ascending order, '
                                 f'got {short(ends)}')
        for end in ends:
            _check('random', {name: end})
    return list(given['ranges']), given['count']


def _mapping(entry, given):
    if not isinstance(given, dict):
        raise ParameterError(f'{entry} must be parameters with values, got {short(given)}')
    return given


def _check(entry, values):
    check(values, entry)
    for name in values:
        if PARAMETERS[name].scope != SCENE:
            raise ParameterError(f'{name} is a parameter of the node, not of the scene ({entry})')


_PART = '{:012d}.parquet'  # of the first run of a job
_TYPES = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(),
          str: pyarrow.string(), tuple: pyarrow.list_(pyarrow.float64())}


def run_sweep(file: Path | str, output: Path | str | None = None, workers: int | None = None,
              scheduler: str | None = None) -> None:
    """
    Do the sweep of a file, see config/sweep.yaml, or those jobs of it that are missing.

    `output` is a Parquet folder, by default named after `file`, in the working directory;
    `workers` and `scheduler` are as for `simulate_many`, with its ConnectionError. Raises
    ParameterError or OSError as `read_plan`, or if the output exists, or its parts belong to
    another sweep or are in use by a running one.
    """
    plan = read_plan(file)
    output = Path(output or Path(file).with_suffix('.parquet').name)
    start, schema = time.monotonic(), schema_of(plan)
    with parts_of(output) as parts:
        with executor_of(workers, scheduler) as (executor, width), tqdm(
                total=plan.count, unit='run', disable=None) as bar:

            def missing():
                for job in plan.jobs():
                    if has_part(parts, job, schema):
                        bar.update(len(job.variations))
                    else:
                        yield job

            for job, table in run_jobs(executor, width, missing()):
                with whole_file(parts / _PART.format(job.first)) as path:
                    parquet.write_table(pyarrow.table(table, schema), path)
                bar.update(len(job.variations))
        for unfinished in parts.glob('.*'):  # a part that a killed process was writing
            shutil.rmtree(unfinished)
        parts.rename(output)
    texts = parquet.read_table(output, columns=['reason', 'warning']).to_pydict()
    failed, warned = (sum(map(bool, texts[name])) for name in ('reason', 'warning'))
    print(f'{plan.count} runs in {time.monotonic() - start:.1f} s, {failed} failed, '
          f'{warned} with a warning: {output}')


@contextmanager
def parts_of(output: Path) -> Iterator[Path]:
    """Yield the folder of the parts of an output, which no other process has meanwhile."""
    parts = output.with_name(output.name + '.parts')

    def refuse():
        if output.exists():
            raise ParameterError(f'{output} exists: remove it or choose another --output')

    refuse()
    parts.mkdir(parents=True, exist_ok=True)
    lock = os.open(parts, os.O_RDONLY)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ParameterError(f'another sweep is running with {parts}: wait for its end or '
                                 'choose another --output') from None
        except OSError:  # a file system without locks
            pass
        refuse()  # a sweep that has just ended may have made it
        yield parts
    finally:
        os.close(lock)


def has_part(parts: Path, job: Job, schema: pyarrow.Schema) -> bool:
    """Return whether the part of a job exists; raise ParameterError if it is of another sweep."""
    try:
        found = parquet.read_schema(parts / _PART.format(job.first))
    except (OSError, pyarrow.ArrowException):  # missing, or damaged: done again
        return False
    if found.metadata != schema.metadata:
        raise ParameterError(f'{parts} belongs to another sweep: remove it or choose another '
                             '--output')
    return True


def schema_of(plan: Plan) -> pyarrow.Schema:
    """Return the columns of a sweep, with units and meanings; its metadata identify the sweep."""
    fields = [_field('run', pyarrow.int64(), '', 'number of the run, from 0')]
    for name in plan.names:
        parameter = PARAMETERS[name]
        fields.append(_field(name, _TYPES[type(parameter.default)], parameter.unit,
                             parameter.meaning))
    fields += [_field(column.name, pyarrow.float64(), column.unit, column.meaning)
               for column in SUMMARY]
    fields += [_field('warning', pyarrow.string(), '', 'why not to trust the run, or empty'),
               _field('reason', pyarrow.string(), '', 'why the run failed, or empty')]
    return pyarrow.schema(fields, {'duration': f'{plan.duration!r} s', 'sweep': plan.fingerprint,
                                   'scene': repr(plan.scene.values)})


def _field(name, kind, unit, meaning):
    return pyarrow.field(name, kind, metadata={'unit': unit, 'meaning': meaning})
