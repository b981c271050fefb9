# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Executors for a sweep: processes of this machine, or a Dask cluster."""

from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
from multiprocessing.context import SpawnContext, SpawnProcess
import os
import signal
import sys
import threading
from types import ModuleType

from timo_sim.extras import optional
from timo_sim.scene.parameter import Parameter
from timo_sim.version import __version__

_WORKERS = Parameter('workers', 1, '', 'processes', low=1)
_ENVIRONMENT = {'PYTHONSAFEPATH': '1', 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1',
                'MKL_NUM_THREADS': '1'}
_STARTING = threading.Lock()


@contextmanager
def executor_of(workers=None, scheduler=None):
    """
    Yield an executor and how many calls it does at a time.

    Parameters
    ----------
    workers : int, optional
        Number of processes; by default the number of cores that this process may use.
    scheduler : str, optional
        Address of a Dask scheduler, such as `tcp://host:8786`, whose workers are used instead.

    Raises
    ------
    ConnectionError
        If a worker process ends early, the scheduler cannot be reached, or a worker of Dask has
        another version of this package.

    """
    if scheduler is not None:
        with _client(scheduler) as client:
            yield client.get_executor(pure=False), max(1, sum(client.nthreads().values()))
        return
    count = len(os.sched_getaffinity(0)) if workers is None else _WORKERS.check(workers)
    executor = ProcessPoolExecutor(count, _Context(), _start_work, (__version__,))
    try:
        yield executor, count
    except BrokenProcessPool:
        raise ConnectionError('a worker process was killed or could not start; the system kills '
                              'processes when memory is short (try fewer workers)') from None
    finally:
        executor.shutdown(cancel_futures=True)


@contextmanager
def _client(address):
    with optional():
        from distributed import Client
        from distributed.comm import get_address_host_port
    try:
        get_address_host_port(address)  # a Client reports a malformed address too late
        client = Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f'no Dask scheduler at {address}: {error}') from None
    with client:
        # A lambda is sent by value: a function of this module would be the worker's own version.
        found = client.run(lambda: __import__('timo_sim').__version__, on_error='return')
        for worker, version in found.items():
            if version != __version__:
                raise ConnectionError(f'the Dask worker {worker} must have timo_sim {__version__}'
                                      f', got {version}')
        yield client


class _Worker(SpawnProcess):
    """
    A process that runs neither the caller's script nor modules of the working directory.

    A script therefore needs no `if __name__ == '__main__'`. The process has one BLAS thread. It
    may be started by a daemonic process, such as a worker of Dask.
    """

    def start(self):
        """Start the process."""
        # multiprocessing imports in the new process what is `__main__` here.
        with (_STARTING, _changed(sys.modules, {'__main__': ModuleType('__main__')}),
              _changed(os.environ, _ENVIRONMENT),
              _changed(vars(multiprocessing.current_process())['_config'], {'daemon': False})):
            super().start()


class _Context(SpawnContext):
    Process = _Worker


@contextmanager
def _changed(mapping, values):
    before = {key: mapping[key] for key in values if key in mapping}
    mapping.update(values)
    try:
        yield
    finally:
        mapping.update(before)
        for key in values.keys() - before.keys():
            del mapping[key]


def _start_work(version):
    """Prepare a worker process: it ends with its parent, and at once if it is interrupted."""
    if version != __version__:
        raise RuntimeError(f'this program began with timo_sim {version}, and {__version__} is '
                           'installed now: start it anew')
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent():
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
