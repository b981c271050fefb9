"""Workers of a Dask cluster, on any number of machines with this package."""

from contextlib import contextmanager

from distributed import Client


@contextmanager
def cluster_executor(address):
    """
    Yield an executor with its `width`, that of the cluster at present.

    The scheduler repeats the calls of a worker that dies, and computes results anew that died with
    it; one call gives one result.

    Parameters
    ----------
    address : str
        Of the scheduler, such as `tcp://host:8786`.

    Raises
    ------
    ConnectionError
        If it cannot be reached.

    """
    try:
        client = Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f'no Dask scheduler at {address}: {error}') from None
    with client:
        executor = client.get_executor(pure=False)
        executor.width = max(1, sum(client.nthreads().values()))
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)
