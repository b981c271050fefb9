# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A sweep from its file to its Parquet file, with a progress bar."""

from pathlib import Path
import time

from tqdm import tqdm

from timo_sim.sweep.jobs import jobs_of
from timo_sim.sweep.many import executor_of, outcomes
from timo_sim.sweep.plan import read_plan
from timo_sim.sweep.table import table_of


def run_sweep(file, output=None, workers=None, scheduler=None):
    """
    Do the sweep of a file, or what is missing of it.

    Parameters
    ----------
    file : str
        See config/sweep.yaml.
    output : str, optional
        Parquet file.
    workers, scheduler
        As for `simulate_many`.

    Raises
    ------
    ParameterError, OSError
        As `read_plan` and `Store`.
    ConnectionError
        As `simulate_many`.

    """
    from timo_sim.sweep.store import Store
    plan = read_plan(file)
    output = output or Path(file).with_suffix('.parquet').name
    store = Store(output, plan)
    start = time.monotonic()
    with executor_of(workers, scheduler) as executor, tqdm(
            total=plan.count, unit='run', disable=None) as bar:

        def missing():
            for job in jobs_of(plan.scene, plan.duration, plan.count, plan.variations()):
                if store.has(job):
                    bar.update(len(job.variations))
                else:
                    yield job

        for job, outcome in outcomes(executor, missing()):
            store.add(job, table_of(job, plan.names, outcome))
            bar.update(len(job.variations))
    failed = store.finish()
    print(f'{plan.count} runs in {time.monotonic() - start:.1f} s, {failed} failed: {output}')
