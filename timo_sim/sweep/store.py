# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Do the sweep of a file: a Parquet folder with a part for each job.

The folder gets its name when all parts are there. A sweep that was killed goes on with the parts
that are missing.
"""

from contextlib import contextmanager
import fcntl
import os
from pathlib import Path
import shutil
import time

import pyarrow
from pyarrow import parquet
from tqdm import tqdm

from timo_sim.scene.files import whole_file
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.sweep.jobs import SUMMARY
from timo_sim.sweep.many import done
from timo_sim.sweep.plan import read_plan
from timo_sim.sweep.workers import executor_of

_TYPES = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(),
          str: pyarrow.string(), tuple: pyarrow.list_(pyarrow.float64())}


def run_sweep(file, output=None, workers=None, scheduler=None):
    """
    Do the sweep of a file, or those jobs of it that are missing.

    Parameters
    ----------
    file : str
        See config/sweep.yaml.
    output : str, optional
        Parquet folder; by default named after `file`, in the working directory.
    workers, scheduler
        As for `simulate_many`.

    Raises
    ------
    ParameterError, OSError
        As `read_plan`, or if the output exists, or its parts belong to another sweep or are in
        use by a running one.
    ConnectionError
        As `simulate_many`.

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

            for job, table in done(executor, width, missing()):
                add_part(parts, job, table, schema)
                bar.update(len(job.variations))
        for unfinished in parts.glob('.*'):  # a part that a killed process was writing
            shutil.rmtree(unfinished)
        parts.rename(output)
    texts = parquet.read_table(output, columns=['reason', 'warning']).to_pydict()
    failed, warned = (sum(map(bool, texts[name])) for name in ('reason', 'warning'))
    print(f'{plan.count} runs in {time.monotonic() - start:.1f} s, {failed} failed, '
          f'{warned} with a warning: {output}')


@contextmanager
def parts_of(output):
    """Yield the folder of the parts of an output, which no other process has meanwhile."""
    parts = output.with_name(output.name + '.parts')
    _refuse(output)
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
        _refuse(output)  # a sweep that has just ended may have made it
        yield parts
    finally:
        os.close(lock)


def _refuse(output):
    if output.exists():
        raise ParameterError(f'{output} exists: remove it or choose another --output')


def has_part(parts, job, schema):
    """Return whether the part of a job exists; raise ParameterError if it is of another sweep."""
    try:
        found = parquet.read_schema(_path(parts, job))
    except (OSError, pyarrow.ArrowException):  # missing, or damaged: done again
        return False
    if found.metadata != schema.metadata:
        raise ParameterError(f'{parts} belongs to another sweep: remove it or choose another '
                             '--output')
    return True


def add_part(parts, job, table, schema):
    """Write the table of a job."""
    with whole_file(_path(parts, job)) as path:
        parquet.write_table(pyarrow.table(table, schema), path)


def _path(parts, job):
    return parts / f'{job.first:012d}.parquet'


def schema_of(plan):
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
