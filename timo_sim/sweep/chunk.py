"""A chunk of a sweep: runs one after another, and what is kept of each."""

import itertools
import math
from typing import NamedTuple

import numpy as np

from timo_sim.parameters import whole_ratio
from timo_sim.simulation import sampled_run, settled

# Steps and runs of a chunk: a fraction of a second, so that little is lost with a worker, and the
# last one is not waited for.
_STEPS, _RUNS, _FEWEST_CHUNKS = 100_000, 100, 32


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


class Chunk(NamedTuple):
    """Runs `first`, `first + 1`, ... of a sweep over a scene."""

    first: int
    scene: object      # Scene
    duration: float    # [s]
    variations: tuple  # of dictionaries of overrides


class Outcome(NamedTuple):
    """What n runs gave."""

    numbers: np.ndarray  # (n, len(SUMMARY)), NaN for a run that failed
    cautions: list       # why a run should not be trusted, or '', see `simulation.Simulator`
    reasons: list        # why it failed, or ''


def chunks_of(scene, duration, count, variations):
    """
    Divide a sweep into chunks.

    What is in a chunk does not depend on who works on it.

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
    Chunk

    """
    steps = max(1, whole_ratio('duration', duration, 'integrator.step', scene.step))
    length = max(1, min(_RUNS, _STEPS // steps, math.ceil(count / _FEWEST_CHUNKS)))
    rest = iter(variations)
    for first in range(0, count, length):
        yield Chunk(first, scene, duration, tuple(itertools.islice(rest, length)))


def summary(run):
    """Return the numbers of `SUMMARY` of a run, a tuple."""
    tip = run.formulation.at([run.scene.manipulator.arm.length])
    deflection = run.formulation.centre_line(run.q, tip)[:, 0, 1]
    rotation = run.formulation.section_rotation(run.q, tip)[:, 0]
    size = np.abs(deflection)
    peak = np.argmax(size)
    return (size[peak], run.t[peak], np.sqrt(np.mean(deflection**2)), deflection[-1],
            np.abs(rotation).max(), *run.carrier[-1], run.shaft[-1])


def run_chunk(chunk):
    """
    Do the runs of a chunk.

    Returns
    -------
    Outcome
        A run that fails, for whatever its values lead to, is a row with a reason.

    """
    numbers = np.full((len(chunk.variations), len(SUMMARY)), np.nan)
    cautions, reasons = [], []
    for row, variation in zip(numbers, chunk.variations):
        caution, reason = None, ''
        try:
            with np.errstate(all='ignore'):
                scene, steps = settled(chunk.scene.vary(variation), chunk.duration)
                run, caution = sampled_run(scene, steps)
                row[:] = summary(run)
        except (ArithmeticError, ValueError, MemoryError) as error:
            reason = ' '.join(str(error).split()) or type(error).__name__
        cautions.append(caution or '')
        reasons.append(reason)
    return Outcome(numbers, cautions, reasons)
