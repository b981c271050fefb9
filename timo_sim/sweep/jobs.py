# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A job of a sweep: runs one after another, and what is kept of each."""

import itertools
import math
from typing import NamedTuple

import numpy as np

from timo_sim.runs.simulate import sampled_run
from timo_sim.scene.parameter import whole_ratio
from timo_sim.simulation.resolution import resolved

# Steps and runs of a job: a fraction of a second, so that little is lost with a worker, and the
# last one is not waited for.
_STEPS, _RUNS, _FEWEST_JOBS = 100_000, 100, 32


class Column(NamedTuple):
    """A number of a run's summary."""

    name: str
    unit: str
    meaning: str


SUMMARY = (
    Column('peak_deflection', 'm', 'largest |w(l)| at a time step'),
    Column('peak_time', 's', 'when it is reached'),
    Column('rms_deflection', 'm', 'root mean square of w(l) over the time steps'),
    Column('final_deflection', 'm', 'w(l) at the end'),
    Column('peak_rotation', 'rad', 'largest |phi(l)|, rotation of the tip relative to the shaft'),
    Column('final_carrier_x', 'm', 'carrier position at the end'),
    Column('final_carrier_y', 'm', 'carrier position at the end'),
    Column('final_shaft', 'rad', 'shaft angle at the end, not wrapped'),
)


class Job(NamedTuple):
    """Runs `first`, `first + 1`, ... of a sweep over a scene."""

    first: int
    scene: object      # Scene
    duration: float    # [s]
    variations: tuple  # of dictionaries of overrides


class Outcome(NamedTuple):
    """What n runs gave."""

    numbers: np.ndarray  # (n, len(SUMMARY)), NaN for a run that failed
    warnings: list       # why a run should not be trusted, or '', see `Run.warning`
    reasons: list        # why it failed, or ''


def jobs_of(scene, duration, count, variations):
    """
    Divide a sweep into jobs.

    What is in a job does not depend on who works on it.

    Parameters
    ----------
    scene : Scene
    duration : float
        [s]
    count : int
        Number of runs.
    variations : iterable of dict

    Yields
    ------
    Job

    """
    steps = max(1, whole_ratio('duration', duration, 'integrator.step', scene.step))
    length = max(1, min(_RUNS, _STEPS // steps, math.ceil(count / _FEWEST_JOBS)))
    rest = iter(variations)
    for first in range(0, count, length):
        yield Job(first, scene, duration, tuple(itertools.islice(rest, length)))


def summary(run):
    """Return the numbers of `SUMMARY` of a run, a tuple."""
    tip = run.model.at([run.scene.manipulator.arm.length])
    deflection = run.model.centre_line(run.q, tip)[:, 0, 1]
    rotation = run.model.section_rotation(run.q, tip)[:, 0]
    size = np.abs(deflection)
    peak = np.argmax(size)
    return (size[peak], run.t[peak], np.sqrt(np.mean(deflection**2)), deflection[-1],
            np.abs(rotation).max(), *run.carrier[-1], run.shaft[-1])


def run_job(job):
    """
    Do the runs of a job.

    Returns
    -------
    Outcome
        A run that fails, for whatever its values lead to, is a row with a reason.

    """
    numbers = np.full((len(job.variations), len(SUMMARY)), np.nan)
    warnings, reasons = [], []
    for row, variation in zip(numbers, job.variations):
        warning, reason = None, ''
        try:
            with np.errstate(all='ignore'):
                run = sampled_run(*resolved(job.scene.vary(variation), job.duration))
                warning, row[:] = run.warning, summary(run)
        except (ArithmeticError, ValueError, MemoryError) as error:
            reason = ' '.join(str(error).split()) or type(error).__name__
        warnings.append(warning or '')
        reasons.append(reason)
    return Outcome(numbers, warnings, reasons)
