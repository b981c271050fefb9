"""One decorator for everything that is compiled: numba, cached on disk, NaN-safe fast math."""

from contextlib import contextmanager
import functools
import hashlib
import inspect
import os
from pathlib import Path
import tempfile

import numba
from numba.extending import overload

# Sums may be reordered and fused, which vectorises the short loops; NaN and Inf keep their
# meaning, so that a diverged state is still seen ('fast' would assume them away).
FASTMATH = {'reassoc', 'contract', 'nsz'}


@functools.cache
def cache_directory():
    """
    Return the folder of this version's machine code, or None if none can be written.

    numba tells a stale entry by the date of one file only. The physics calls across files, so the
    folder is named after the contents of all of them.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.glob('*.py')):
        digest.update(source.read_bytes())
    home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    base = os.environ.get('NUMBA_CACHE_DIR') or os.path.join(home, 'timo_sim')
    for root in (base, os.path.join(tempfile.gettempdir(), f'timo_sim-{os.getuid()}')):
        directory = Path(root) / digest.hexdigest()[:16]
        try:
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        # Machine code is loaded from here: only from a folder that is our own.
        ours = all(path.stat().st_uid == os.getuid() for path in (Path(root), directory))
        if ours and os.access(directory, os.W_OK):
            return directory
    return None


def is_cached():
    """Return whether machine code of this version is on disk."""
    directory = cache_directory()
    return directory is not None and any(directory.rglob('*.nbc'))


@contextmanager
def _cache_in(directory):
    previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(directory)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = previous


def entry_point(function):
    """Compile a function that Python calls, and keep its machine code on disk."""
    if cache_directory() is None:
        return numba.njit(fastmath=FASTMATH)(function)
    with _cache_in(cache_directory()):
        return numba.njit(fastmath=FASTMATH, cache=True)(function)


def inner(function):
    """Compile a function that only compiled functions call; it becomes part of its callers."""
    return numba.njit(fastmath=FASTMATH)(function)


def strict(function):
    """Compile a function that only compiled functions call, without any fast math."""
    return numba.njit(function)


def dispatch(declaration):
    """
    Declare a function whose body is chosen, at compile time, by the type of its first argument.

    A compiled function that takes other compiled functions as arguments cannot be kept on disk;
    one that calls a declared function can. `@declared.of(Type)` above a body adds it.
    """
    bodies = {}

    def of(type_):
        def add(body):
            bodies[type_] = body
            return body
        return add

    def choose(*types):
        return bodies.get(getattr(types[0], 'instance_class', None))

    choose.__signature__ = inspect.signature(declaration)
    overload(declaration, jit_options={'fastmath': FASTMATH})(choose)
    declaration.of = of
    return declaration
