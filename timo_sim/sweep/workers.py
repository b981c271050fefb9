# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Who works on a sweep: processes of this machine, or a Dask cluster."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
import os
import pickle
import signal
import subprocess
import sys
import threading

from timo_sim.scene.parameter import Parameter, ParameterError
from timo_sim.version import __version__

_ATTEMPTS = 3  # processes that may die over the same call
_WIDTH = Parameter('workers', 1, '', 'processes', low=1)
_ONE_THREAD = dict.fromkeys(('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'), '1')


def executor_of(workers=None, scheduler=None):
    """Return who works: an executor with its `width`, to be used as a context."""
    return LocalExecutor(workers) if scheduler is None else cluster_executor(scheduler)


@contextmanager
def cluster_executor(address):
    """
    Yield an executor of the Dask scheduler at an address, such as `tcp://host:8786`.

    The scheduler repeats the calls of a worker that dies, and computes results anew that died with
    it; one call gives one result. If it cannot be reached, or a worker has another version of this
    package, that is a ConnectionError.
    """
    from distributed import Client
    from distributed.comm import get_address_host_port
    try:
        get_address_host_port(address)  # a Client of an address that is none would complain later
        client = Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f'no Dask scheduler at {address}: {error}') from None
    with client:
        # By value, because it must not be the worker's own function of this name.
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
    Calls in processes of their own, one for each of some threads that wait for them.

    They are not those of `multiprocessing`: they need no `if __name__ == '__main__'` in the
    caller's script, have one BLAS thread each from the start, and one that is killed loses
    nothing.

    Parameters
    ----------
    width : int, optional
        Number of processes; by default that of the cores this process may use.

    """

    def __init__(self, width=None):
        self.width = len(os.sched_getaffinity(0)) if width is None else _WIDTH.check(width)
        self._threads = ThreadPoolExecutor(self.width, 'sweep')
        self._own = threading.local()
        self._children = []
        self._closing = False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._closing = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._kill()
        self._threads.shutdown()
        self._kill()  # one that was just being started
        for child in self._children:
            with suppress(BrokenPipeError), child:
                pass

    def _kill(self):
        for child in self._children:
            child.kill()

    def submit(self, function, *arguments):
        """Return the future of a call; what cannot be pickled is a ParameterError."""
        try:
            call = pickle.dumps((function, arguments))
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise ParameterError(f'what worker processes get must be plain values: {error}'
                                 ) from None
        return self._threads.submit(self._call, call)

    def _call(self, call):
        for _ in range(_ATTEMPTS):
            child = getattr(self._own, 'child', None) or self._start()
            try:
                child.stdin.write(call)
                child.stdin.flush()
                result, error = pickle.load(child.stdout)
            except (EOFError, BrokenPipeError, pickle.UnpicklingError):
                self._own.child = None
                if self._closing:
                    break
                continue
            if error is not None:
                raise error
            return result
        raise ConnectionError(f'worker processes ended {_ATTEMPTS} times over the same runs, the '
                              f'last with code {child.wait()}')

    def _start(self):
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        self._own.child = subprocess.Popen(
            [sys.executable, '-c', f'from {__name__} import serve; serve()'],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, **_ONE_THREAD, 'PYTHONPATH': path})
        self._children.append(self._own.child)
        return self._own.child


def serve():
    """Answer calls from standard input until it ends; what they print goes to standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's affair
    with os.fdopen(os.dup(1), 'wb') as answers:
        os.dup2(2, 1)
        while True:
            try:
                function, arguments = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            result, error = None, None
            try:
                result = function(*arguments)
            except Exception as raised:  # and raised again where the call was made
                error = raised
            pickle.dump((result, error), answers)
            answers.flush()
