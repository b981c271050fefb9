# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Executors for a sweep: processes of this machine, or a Dask cluster."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
import os
import pickle
import signal
import socket
import subprocess
import threading

from timo_sim.child import start_python
from timo_sim.extras import optional
from timo_sim.scene.parameter import Parameter, ParameterError
from timo_sim.version import __version__

_ATTEMPTS = 3  # a call fails when so many processes have died over it
_WIDTH = Parameter('workers', 1, '', 'processes', low=1)
_ONE_THREAD = dict.fromkeys(('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'), '1')


def executor_of(workers=None, scheduler=None):
    """Return an executor, a context manager; it does `width` calls at a time."""
    return LocalExecutor(workers) if scheduler is None else cluster_executor(scheduler)


@contextmanager
def cluster_executor(address):
    """
    Yield an executor of the Dask scheduler at an address, such as `tcp://host:8786`.

    If a worker dies, the scheduler repeats its calls and computes lost results again; one call
    gives one result. Raises ConnectionError if the scheduler cannot be reached, or a worker has
    another version of this package.
    """
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
        executor = client.get_executor(pure=False)
        executor.width = max(1, sum(client.nthreads().values()))
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


class LocalExecutor:
    """
    An executor with a thread for each worker process, which sends it calls and waits for results.

    The processes are not those of `multiprocessing`: the caller's script needs no
    `if __name__ == '__main__'`, each process has one BLAS thread from the start, and the call of a
    process that is killed is repeated.

    Parameters
    ----------
    width : int, optional
        Number of processes; by default the number of cores that this process may use.

    """

    def __init__(self, width=None):
        self.width = len(os.sched_getaffinity(0)) if width is None else _WIDTH.check(width)
        self._threads = ThreadPoolExecutor(self.width, 'sweep')
        self._own = threading.local()
        self._workers = []  # processes, each with the file that calls and answers go through
        self._closing = False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._closing = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._kill()
        self._threads.shutdown()
        self._kill()  # one that was just being started
        for child, channel in self._workers:
            child.wait()
            with suppress(BrokenPipeError):
                channel.close()

    def _kill(self):
        for child, _ in self._workers:
            child.kill()

    def submit(self, function, *arguments):
        """Return the future of a call; raise ParameterError if the call cannot be pickled."""
        try:
            call = pickle.dumps((function, arguments))
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise ParameterError(f'calls of worker processes must be picklable: {error}') from None
        return self._threads.submit(self._call, call)

    def _call(self, call):
        for _ in range(_ATTEMPTS):
            child, channel = getattr(self._own, 'worker', None) or self._start()
            try:
                channel.write(call)
                channel.flush()
                result, error = pickle.load(channel)
            except (EOFError, ConnectionError, pickle.UnpicklingError):
                self._own.worker = None
                if self._closing:
                    break
                continue
            if error is not None:
                raise error
            return result
        raise ConnectionError(f'worker processes ended {_ATTEMPTS} times over the same runs, the '
                              f'last with code {child.wait()}')

    def _start(self):
        # Not its standard streams: anything that is imported may print to them.
        ours, theirs = socket.socketpair()
        with ours, theirs:
            number = theirs.fileno()
            child = start_python(f'from {__name__} import serve; serve({number})',
                                 env=_ONE_THREAD, pass_fds=[number], stdin=subprocess.DEVNULL,
                                 stdout=2)  # what it prints goes to standard error
            self._own.worker = child, ours.makefile('rwb')
        self._workers.append(self._own.worker)
        return self._own.worker


def serve(number):
    """Answer calls from the socket with this file descriptor until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it, too, and ends this process
    with socket.socket(fileno=number) as connection, connection.makefile('rwb') as channel:
        while True:
            try:
                function, arguments = pickle.load(channel)
            except (EOFError, ConnectionError):
                return
            result, error = None, None
            try:
                result = function(*arguments)
            except Exception as raised:  # the caller raises it again
                error = raised
            pickle.dump((result, error), channel)
            channel.flush()
