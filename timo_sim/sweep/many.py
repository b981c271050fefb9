# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The function `simulate_many`: many runs of one scene at a time."""

from collections import deque
from collections.abc import Iterable, Mapping
import pickle
from typing import Any

import numpy as np

from timo_sim.scene.files import flatten
from timo_sim.scene.parameter import ParameterError, SCENE, short
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.sweep.jobs import jobs_of, run_job
from timo_sim.sweep.workers import executor_of


def simulate_many(scene: SceneLike, variations: Iterable[Mapping[str, Any]], duration: float,
                  workers: int | None = None,
                  scheduler: str | None = None) -> dict[str, np.ndarray]:
    """
    Simulate variations of a scene on all cores, or on a Dask cluster, and keep a summary of each.

    From 64 runs on, those of the `exact` formulation whose steps need no special care are done
    together, as lanes of a vector (see `Batch`), several times faster. Their numbers are those of
    `simulate` for that variation to about 1e-11; those of other runs, and of a shorter sweep, to
    the last bit, on the same kind of processor and with one BLAS thread. No bit of a row depends
    on the other runs or on the number of workers. Runs are not compared with finer ones. A run
    that fails has a row with a reason. The first run with a new number of modes compiles for some
    seconds; the machine code is kept.

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
        Address of a Dask scheduler, to use its workers instead of processes of this machine.

    Returns
    -------
    dict of ndarray, shape (n,)
        Columns by name, one row for each run: `run`, its number from 0; each varied parameter
        (NaN or None for a value that breaks its rule); `peak_deflection`, `peak_time`,
        `rms_deflection`, `final_deflection`, `peak_rotation`, `final_carrier_x`,
        `final_carrier_y`, `final_shaft`, see `timo_sim.sweep.jobs.SUMMARY` (NaN for a run that
        failed); `warning`, as `Run.warning`, or ''; `reason`, why the run failed, or ''.

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
    # In order of appearance. An unknown name has no column; the `reason` of its row names it.
    names = [name for name in {name: None for each in variations for name in flatten(each)}
             if name in PARAMETERS and PARAMETERS[name].scope == SCENE]
    jobs = jobs_of(load_scene(scene), duration, len(variations), variations, names)
    with executor_of(workers, scheduler) as (executor, width):
        tables = [table for _, table in done(executor, width, jobs)]
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def done(executor, width, jobs):
    """
    Yield each job with its table, in order.

    About three jobs for each of `width` workers are pending: all are busy, and memory stays
    bounded.
    """
    pending = deque()
    for job in jobs:
        pending.append((job, executor.submit(run_job, job)))
        if len(pending) > 3 * width:
            first, future = pending.popleft()
            yield first, future.result()
    for first, future in pending:
        yield first, future.result()
