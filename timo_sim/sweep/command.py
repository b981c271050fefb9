"""A sweep from its file to its Parquet file, with a progress bar."""

from pathlib import Path
import time

from tqdm import tqdm

from timo_sim.sweep.chunk import chunks_of
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
            for chunk in chunks_of(plan.scene, plan.duration, plan.count, plan.variations()):
                if store.has(chunk):
                    bar.update(len(chunk.variations))
                else:
                    yield chunk

        for chunk, outcome in outcomes(executor, missing()):
            store.add(chunk, table_of(chunk, plan.names, outcome))
            bar.update(len(chunk.variations))
    failed = store.finish()
    print(f'{plan.count} runs in {time.monotonic() - start:.1f} s, {failed} failed: {output}')
