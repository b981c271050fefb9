# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

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
