# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A job of a sweep: some runs, and their rows of the result table."""

from contextlib import contextmanager
import itertools
import math
from typing import NamedTuple

import numpy as np

from timo_sim.jit.lanes import WIDTH
from timo_sim.runs.error import measured
from timo_sim.runs.sampled import sampled_run
from timo_sim.scene.files import flatten
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.scene.values import steps_in
from timo_sim.simulation.resolution import resolved
from timo_sim.sweep.together import kind_of, Together

# Most steps and runs of a job, and about the fewest jobs of a sweep. A job takes well below a
# second, so that little is lost if a worker dies, and all workers end at about the same time.
_STEPS, _RUNS, _FEWEST_JOBS = 100_000, 96, 32
_FAILURES = ArithmeticError, ValueError, MemoryError  # of a run, not of the program
_MEASURED = 256  # runs from one whose error is measured to the next
_MANY = 64  # least number of runs of a sweep for which the machine code of lanes pays


class Column(NamedTuple):
    """A number of a run's summary."""

    name: str
    unit: str
    meaning: str


SUMMARY = (
    Column('peak_deflection', 'm', 'largest |w(l)| at a time step'),
    Column('peak_time', 's', 'time of peak_deflection'),
    Column('rms_deflection', 'm', 'root mean square of w(l) over the time steps'),
    Column('final_deflection', 'm', 'w(l) at the end'),
    Column('peak_rotation', 'rad', 'largest |phi(l)|, rotation of the tip relative to the shaft'),
    Column('final_carrier_x', 'm', 'carrier position at the end'),
    Column('final_carrier_y', 'm', 'carrier position at the end'),
    Column('final_shaft', 'rad', 'shaft angle at the end, not wrapped'),
    Column('tip_error', 'm', 'distance of the tip from that of a finer run; NaN if not measured'),
)


class Job(NamedTuple):
    """Runs `first`, `first + 1`, ... of a sweep over a scene."""

    first: int
    scene: object      # Scene
    duration: float    # [s]
    variations: tuple  # of dictionaries of overrides
    names: tuple       # of the parameters that have a column
    together: bool = False  # whether runs that can be lanes are


def jobs_of(scene, duration, count, variations, names):
    """Yield the jobs of a sweep of `count` runs, which do not depend on the number of workers."""
    steps, together = max(1, steps_in(duration, scene.step)), count >= _MANY
    length = max(1, min(_RUNS, _STEPS // steps, math.ceil(count / _FEWEST_JOBS)))
    if together:
        length = WIDTH * math.ceil(length / WIDTH)
    rest = iter(variations)
    for first in range(0, count, length):
        yield Job(first, scene, duration, tuple(itertools.islice(rest, length)), tuple(names),
                  together)


def _summary(run):
    # The numbers of `SUMMARY`.
    tip = run.model.tip_point
    deflection = run.model.centre_line(run.q, tip)[:, 0, 1]
    rotation = run.model.section_rotation(run.q, tip)[:, 0]
    size = np.abs(deflection)
    peak = np.argmax(size)
    return (size[peak], run.t[peak], np.sqrt(np.mean(deflection**2)), deflection[-1],
            np.abs(rotation).max(), *run.carrier[-1], run.shaft[-1],
            run.stats['estimated_tip_error_m'])


def _summaries(runs, steps):
    # The numbers of `SUMMARY` for each of some runs that were done together.
    return np.column_stack([
        runs.peak, runs.peak_time, np.sqrt(runs.squares / (steps + 1)),
        runs.deflection, runs.rotation, runs.motion[:, :3], np.full(len(runs.peak), np.nan)])


def run_job(job):
    """
    Do the runs of a job.

    Returns
    -------
    dict of ndarray
        A row for each run: `run`, its number; the varied parameters; the numbers of `SUMMARY`,
        NaN for a run that failed; `warning` and `reason`, texts or ''.

    """
    numbers = np.full((len(job.variations), len(SUMMARY)), np.nan)
    table = {'run': job.first + np.arange(len(job.variations))}
    flat = [flatten(variation) for variation in job.variations]
    for name in job.names:
        table[name] = _cells(PARAMETERS[name], [values.get(name, job.scene.values[name])
                                                for values in flat])
    table.update((column.name, numbers[:, k]) for k, column in enumerate(SUMMARY))
    table['warning'], table['reason'] = np.full((2, len(flat)), '', dtype=object)
    found = {}
    with np.errstate(all='ignore'):
        for row, variation in enumerate(job.variations):
            with _reasons(table['reason'], [row]):
                scene, steps = resolved(job.scene.vary(variation), job.duration)
                kind = kind_of(scene, steps) if job.together else None
                found.setdefault((kind, None if kind else row), []).append((row, scene))
        for (kind, _), runs in found.items():
            try:
                _fill(table, numbers, kind, runs, job.duration)
            except _FAILURES:  # of one of them: each gets a reason of its own, alone
                for run in runs:
                    with _reasons(table['reason'], [run[0]]):
                        _fill(table, numbers, kind, [run], job.duration)
        for (kind, _), runs in found.items():
            for row, scene in runs:
                if (job.first + row) % _MEASURED == 0 and not table['reason'][row]:
                    _measure(table, numbers, row, scene, job.duration)
        failed = table['reason'] != ''
        numbers[failed], table['warning'][failed] = np.nan, ''
    return table


def _fill(table, numbers, kind, runs, duration):
    """Do runs, of (row, Scene), together if they are of a Kind; fill in their rows."""
    rows, scenes = (list(part) for part in zip(*runs))
    if kind:
        done = Together(scenes, kind)
        table['reason'][rows] = done.reasons
        table['warning'][rows] = [text or '' for text in done.warnings]
        numbers[rows] = _summaries(done, kind.steps)
    else:
        run = sampled_run(scenes[0], steps_in(duration, scenes[0].step))
        table['warning'][rows] = run.warning or ''
        numbers[rows] = _summary(run)


def _measure(table, numbers, row, scene, duration):
    """Measure the error of a run, and fill it in with the warning that it calls for."""
    run = measured(sampled_run(scene, steps_in(duration, scene.step)))
    numbers[row, -1] = run.stats['estimated_tip_error_m']
    table['warning'][row] = run.warning or ''


@contextmanager
def _reasons(reasons, rows):
    """Keep the text of an error as the reason why the runs of some rows failed."""
    try:
        yield
    except _FAILURES as error:
        reasons[rows] = ' '.join(str(error).split()) or type(error).__name__


def _cells(parameter, values):
    # A value that breaks its rule becomes NaN or None; the `reason` of its row names it.
    cells = []
    for value in values:
        try:
            cells.append(parameter.check(value))
        except ParameterError:
            cells.append(None)
    kind = type(parameter.default)
    if kind is float:
        return np.array(cells, dtype=float)
    if kind is int and None not in cells:
        return np.array(cells)
    column = np.empty(len(cells), dtype=object)
    column[:] = cells
    return column
