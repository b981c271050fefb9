"""Many runs of one scene: `simulate_many`."""

from collections import deque

from timo_sim.parameters import ParameterError, whole_ratio
from timo_sim.sweep.chunk import chunks_of, run_chunk
from timo_sim.sweep.table import joined, table_of, varied


def simulate_many(scene, variations, duration, workers=None, scheduler=None):
    """
    Simulate variations of a scene on all cores, or on a Dask cluster, and keep a summary of each.

    A row is to the last bit what `simulate` gives for that variation alone, whoever works on it.
    A run that fails is a row with a reason. The first run with other numbers of modes than before
    compiles for some seconds; the machine code is kept.

    Parameters
    ----------
    scene : Scene
    variations : iterable of dict
        Overrides of each run, by (nested or dotted) name of a parameter.
    duration : float
        [s], a whole multiple of the time step.
    workers : int, optional
        Number of processes; by default that of the cores this process may use.
    scheduler : str, optional
        Address of a Dask scheduler, instead of processes of this machine.

    Returns
    -------
    dict of ndarray, shape (n,)
        Columns by name, one row for each run: `run`, its number from 0; each varied parameter
        (NaN or None for a value that breaks its rule); `peak_deflection`, `peak_time`,
        `rms_deflection`, `final_deflection`, `peak_rotation`, `final_carrier_x`,
        `final_carrier_y`, `final_shaft`, see `timo_sim.sweep.chunk.SUMMARY` (NaN for a run that
        failed); `caution`, that of `ModelWarning` or ''; `reason`, why the run failed, or ''.

    Raises
    ------
    ParameterError
        If the duration does not fit the step of the scene, or there are no variations.
    ConnectionError
        If the scheduler cannot be reached, or workers end time and again.

    """
    variations = list(variations)
    if not variations:
        raise ParameterError('variations must have at least one element, got none')
    whole_ratio('duration', duration, 'integrator.step', scene.step)
    names = varied(variations)
    chunks = chunks_of(scene, duration, len(variations), variations)
    with executor_of(workers, scheduler) as executor:
        return joined([table_of(chunk, names, outcome)
                       for chunk, outcome in outcomes(executor, chunks)])


def executor_of(workers=None, scheduler=None):
    """Return who works: an executor with its `width`, to be used as a context."""
    if scheduler is None:
        from timo_sim.sweep.local import LocalExecutor
        return LocalExecutor(workers)
    from timo_sim.sweep.cluster import cluster_executor
    return cluster_executor(scheduler)


def outcomes(executor, chunks):
    """
    Yield each chunk with its outcome, in their order.

    No more chunks are made than keep all workers busy, so that memory stays bounded.
    """
    pending = deque()
    for chunk in chunks:
        pending.append((chunk, executor.submit(run_chunk, chunk)))
        if len(pending) > 3 * executor.width:
            first, future = pending.popleft()
            yield first, future.result()
    for first, future in pending:
        yield first, future.result()
