# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Models made with one thread of BLAS, so that their last bits do not depend on how many there are.

OpenBLAS, of NumPy's wheels and of Ubuntu, shares large products and decompositions out among
threads, which changes the order of sums. Another BLAS is left as it is.
"""

from collections.abc import Callable
import ctypes
import functools
from importlib import import_module
import os
import threading
from typing import Any

_lock = threading.RLock()  # the number of threads is that of the process


def _after_fork():
    global _lock
    _lock = threading.RLock()  # another thread may have held it


os.register_at_fork(after_in_child=_after_fork)


@functools.cache
def _functions() -> tuple[Any, Any]:
    """Return the functions of OpenBLAS that get and set its number of threads, if it is there."""
    # Symbols are also looked up in the libraries that this one is linked to.
    library = ctypes.CDLL(import_module('numpy.linalg._umath_linalg').__file__)
    for name in ('scipy_openblas_{}_num_threads64_', 'openblas_{}_num_threads64_',
                 'scipy_openblas_{}_num_threads', 'openblas_{}_num_threads'):
        if hasattr(library, name.format('set')):
            return tuple(getattr(library, name.format(verb)) for verb in ('get', 'set'))
    return lambda: 1, lambda count: None


def with_one_thread(function: Callable) -> Callable:
    """Return the function, called with one thread of BLAS."""
    @functools.wraps(function)
    def call(*args, **keywords):
        count_of, set_count = _functions()
        with _lock:
            count = count_of()
            set_count(1)
            try:
                return function(*args, **keywords)
            finally:
                set_count(count)
    return call
