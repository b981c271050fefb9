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

from contextlib import ExitStack
import fcntl
import hashlib
from pathlib import Path
import shutil
import time
import uuid

import numpy as np
import pyarrow
from pyarrow import compute, parquet
from tqdm import tqdm

from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.sweep.jobs import SUMMARY
from timo_sim.sweep.many import done
from timo_sim.sweep.plan import read_plan
from timo_sim.sweep.workers import executor_of

_TYPES = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(),
          str: pyarrow.string(), tuple: pyarrow.list_(pyarrow.float64())}
_ROW_GROUP = 64  # parts


def run_sweep(file, output=None, workers=None, scheduler=None):
    """
    Do the sweep of a file, or those jobs of it that are missing.

    Parameters
    ----------
    file : str
        See config/sweep.yaml.
    output : str, optional
        Parquet file; by default named after `file`, in the working directory.
    workers, scheduler
        As for `simulate_many`.

    Raises
    ------
    ParameterError, OSError
        As `read_plan` and `Store`.
    ConnectionError
        As `simulate_many`.

    """
    plan = read_plan(file)
    output = output or Path(file).with_suffix('.parquet').name
    start = time.monotonic()
    with Store(output, plan) as store:
        _do(plan, store, workers, scheduler)
        failed, warned = store.finish()
    print(f'{plan.count} runs in {time.monotonic() - start:.1f} s, {failed} failed, '
          f'{warned} with a warning: {output}')


def _do(plan, store, workers, scheduler):
    with executor_of(workers, scheduler) as executor, tqdm(
            total=plan.count, unit='run', disable=None) as bar:

        def missing():
            for job in plan.jobs():
                if store.has(job):
                    bar.update(len(job.variations))
                else:
                    yield job

        for job, table in done(executor, missing()):
            store.add(job, table)
            bar.update(len(job.variations))


class Store:
    """
    The parts of a sweep on disk, and the file they are joined to; locked until it is closed.

    Parameters
    ----------
    output : str or Path
        The file; its parts are in a folder beside it.
    plan : Plan

    Raises
    ------
    ParameterError
        If the file exists, or the parts belong to another sweep, or are in use by a running one.

    """

    def __init__(self, output, plan):
        self._output, self._count = Path(output), plan.count
        self._parts = self._output.with_name(self._output.name + '.parts')
        self._schema = _schema(plan)
        self._found = []  # parts that are whole
        self._refuse_output()
        self._parts.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            self._lock = stack.enter_context(open(self._parts / 'sweep', 'a+b', buffering=0))
            self._claim(plan.fingerprint.encode())
            self._refuse_output()  # a sweep that has just ended may have written it
            stack.pop_all()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._lock.close()

    def _refuse_output(self):
        if self._output.exists():
            raise ParameterError(f'{self._output} exists: remove it or choose another --output')

    def _claim(self, fingerprint):
        """Lock the parts for this process and its sweep, or raise ParameterError."""
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ParameterError(f'another sweep is running with {self._parts}: wait for its end '
                                 'or choose another --output') from None
        except OSError:  # a file system without locks
            pass
        self._lock.seek(0)
        found = self._lock.read()
        if not fingerprint.startswith(found):  # a killed process may have written a part of it
            raise ParameterError(f'{self._parts} belongs to another sweep: remove it or choose '
                                 'another --output')
        self._lock.write(fingerprint[len(found):])

    def has(self, job):
        """Return whether the part of a job exists and is complete."""
        path = self._part(job.first)
        try:
            checksum = _checksum_of(path)
            if checksum.exists() and checksum.read_bytes() != _digest(path):
                return False
            part = self._read(path)
        except (OSError, ValueError, pyarrow.ArrowException):
            return False
        whole = part.schema == self._schema and part['run'].to_pylist() == [
            *range(job.first, job.first + len(job.variations))]
        if whole:
            self._found.append(path)
        return whole

    def add(self, job, table):
        """Write the part of a job."""
        part, path = pyarrow.table(table, schema=self._schema), self._part(job.first)
        self._write_whole(
            path, lambda file: parquet.write_table(part, file, write_page_checksum=True))
        # Parquet's checksums do not cover its metadata.
        self._write_whole(_checksum_of(path), lambda file: file.write_bytes(_digest(path)))
        self._found.append(path)

    def finish(self):
        """
        Join the parts.

        Returns
        -------
        tuple of int
            How many runs failed, and how many have a warning.

        """
        parts, runs, counts = sorted(self._found), 0, {'reason': 0, 'warning': 0}

        def join(path):
            nonlocal runs
            with parquet.ParquetWriter(path, self._schema) as writer:
                for first in range(0, len(parts), _ROW_GROUP):
                    table = pyarrow.concat_tables(
                        self._read(part) for part in parts[first:first + _ROW_GROUP])
                    expected = np.arange(runs, runs + len(table))
                    if not np.array_equal(table['run'].to_numpy(), expected):
                        raise RuntimeError(f'{self._parts}: runs from {runs} on are not complete')
                    for name in counts:
                        counts[name] += compute.sum(compute.not_equal(table[name], '')).as_py()
                    runs += len(table)
                    writer.write_table(table)
            if runs != self._count:
                raise RuntimeError(f'{self._parts}: {runs} of {self._count} runs')

        self._write_whole(self._output, join)
        shutil.rmtree(self._parts, ignore_errors=True)  # another process may be opening them
        return tuple(counts.values())

    def _write_whole(self, path, write):
        unfinished = self._parts / uuid.uuid4().hex
        write(unfinished)
        unfinished.replace(path)

    @staticmethod
    def _read(part):
        # Not `read_table`, which would read a folder of this name as a table in pieces.
        with parquet.ParquetFile(part, page_checksum_verification=True) as file:
            return file.read()

    def _part(self, first):
        return self._parts / f'{first:012d}.parquet'


def _checksum_of(part):
    return part.with_suffix('.sha256')


def _digest(part):
    return hashlib.sha256(part.read_bytes()).digest()


def _schema(plan):
    fields = [_field('run', pyarrow.int64(), '', 'number of the run, from 0')]
    for name in plan.names:
        parameter = PARAMETERS[name]
        fields.append(_field(name, _TYPES[type(parameter.default)], parameter.unit,
                             parameter.meaning))
    fields += [_field(column.name, pyarrow.float64(), column.unit, column.meaning)
               for column in SUMMARY]
    fields += [_field('warning', pyarrow.string(), '', 'why not to trust the run, or empty'),
               _field('reason', pyarrow.string(), '', 'why the run failed, or empty')]
    return pyarrow.schema(fields, {'duration': f'{plan.duration!r} s',
                                   'scene': repr(plan.scene.values)})


def _field(name, kind, unit, meaning):
    return pyarrow.field(name, kind, metadata={'unit': unit, 'meaning': meaning})
