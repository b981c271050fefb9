"""
What compiled code is made with: numba, cached on disk, NaN-safe fast math, known shapes.

Loops of a reduced model are short. They become fast where the compiler knows their ends, and that
no two arrays overlap: constants are packed into a `record`, of which the shapes are part of the
type, and what a function computes on the way is `local` to it. One machine code per size follows.
"""

from contextlib import contextmanager, ExitStack, suppress
import fcntl
import functools
import hashlib
import inspect
import math
import os
from pathlib import Path
import pickle
import sys
import tempfile
import uuid
import warnings

from llvmlite import ir
import numba
from numba.core import cgutils, compiler, serialize, types
from numba.extending import intrinsic, overload
import numpy as np

# Sums may be reordered and fused, which vectorises the short loops; NaN and Inf keep their
# meaning, so that a diverged state is still seen ('fast' would assume them away).
FASTMATH = {'reassoc', 'contract', 'nsz'}
# A division by zero gives Inf or NaN, too, and raises nothing.
_OPTIONS = {'fastmath': FASTMATH, 'error_model': 'numpy'}
_CHECKSUM = 32  # [B] of SHA-256


def _name_by_contents(kind):
    # numba names machine code after the types of its arguments, records by the order in which a
    # process has met them, nested arrays without their shape. Two sizes compiled in different
    # processes and loaded from disk into one would then call each other's code.
    return f'{type(kind).__name__}{hashlib.sha256(kind.name.encode()).hexdigest()[:16]}', ()


for _kind in (types.Record, types.NestedArray):
    setattr(_kind, 'mangling_args', property(_name_by_contents))


@functools.cache
def cache_directory():
    """
    Return the folder of this version's machine code, or None if none can be written.

    numba tells a stale entry by the date of one file only. The physics calls across files, so the
    folder is named after the contents of all of them.
    """
    digest = hashlib.sha256(f'{numba.__version__} {sys.implementation.cache_tag}'.encode())
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


def size_mark(*records):
    """Return the file that stands for machine code on disk for records of these sizes, or None."""
    return _mark_of(*(entry.dtype for entry in records))


@functools.lru_cache
def _mark_of(*layouts):
    sizes = hashlib.sha256(repr(layouts).encode()).hexdigest()[:16]
    return cache_directory() and cache_directory() / f'{sizes}.compiled'


@contextmanager
def alone(name):
    """Let one process at a time do something, among all that share the folder of machine code."""
    with ExitStack() as held:
        # Without the folder, or on a full disk, there is nothing to share.
        with suppress(OSError):
            lock = held.enter_context(open(cache_directory() / name, 'w', encoding='utf-8'))
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def compiling(*records):
    """Let one process compile for records of these sizes, while others wait for its code."""
    mark = size_mark(*records)
    if mark is None or mark.exists():
        yield
        return
    with alone(f'{mark.stem}.lock'):
        yield
        with suppress(OSError):
            mark.touch()


class _Shelf:
    """
    Machine code of a function on disk, a file for each signature, in place of numba's cache.

    numba believes the files that it finds and needs those that it writes: one that a crash or a
    full disk left short, or a folder that is gone, ends the process. Here a file appears under its
    name when it is whole and begins with a checksum; whatever is wrong, the function is compiled.
    """

    def __init__(self, function):
        self._name = f'{function.__module__}.{function.__qualname__}'
        self._code = function.__code__.co_code

    def _path(self, signature, codegen):
        key = repr((self._code, signature, codegen.magic_tuple()))
        return cache_directory() / f'{self._name}-{hashlib.sha256(key.encode()).hexdigest()}.code'

    def load_overload(self, signature, target):
        """Return what was saved, or None."""
        target.refresh()
        try:
            content = self._path(signature, target.codegen()).read_bytes()
        except OSError:
            return None
        checksum, data = content[:_CHECKSUM], content[_CHECKSUM:]
        if hashlib.sha256(data).digest() != checksum:
            return None
        return compiler.CompileResult._rebuild(target, *pickle.loads(data))

    def save_overload(self, signature, result):
        """Save machine code, or warn that it is not."""
        data = serialize.dumps(result._reduce())
        unfinished = cache_directory() / uuid.uuid4().hex
        try:
            unfinished.write_bytes(hashlib.sha256(data).digest() + data)
            unfinished.replace(self._path(signature, result.codegen))
        except OSError as error:
            with suppress(OSError):
                unfinished.unlink()
            warnings.warn(f'machine code is not kept, it will be compiled again: {error}')


def entry_point(function):
    """Compile a function of a module that Python calls, and keep its machine code on disk."""
    compiled = numba.njit(**_OPTIONS)(function)
    if cache_directory() is not None:
        compiled._cache = _Shelf(function)
    return compiled


def inner(function):
    """Compile a function that only compiled functions call; it becomes part of its callers."""
    return numba.njit(**_OPTIONS, forceinline=True, no_cpython_wrapper=True)(function)


def strict(function):
    """Compile a function that only compiled functions call, without any fast math."""
    # Said, not left out: what is not said is inherited from the function that calls first.
    return numba.njit(**{**_OPTIONS, 'fastmath': False}, forceinline=True,
                      no_cpython_wrapper=True)(function)


def pasted(function):
    """Compile a function whose text takes the place of its calls in compiled functions."""
    # As `inner` it would be slower: that arrays it is given do not overlap is found out too late.
    return numba.njit(**_OPTIONS, inline='always')(function)


@functools.cache
def _layout(fields):
    # One dtype object per layout: numba keeps each that it has seen.
    return np.dtype(list(fields))


def record(fields):
    """
    Return a NamedTuple of numbers and arrays as a record: one block of memory, known shapes.

    Returns
    -------
    numpy.void

    """
    values = {name: np.asarray(value) for name, value in fields._asdict().items()}
    packed = np.zeros((), _layout(tuple((name, value.dtype.str, value.shape)
                                        for name, value in values.items())))
    for name, value in values.items():
        packed[name] = value
    return packed[()]


@intrinsic
def local(_, like):
    """
    Return an array that lives as long as the call of the compiled function that asks for it.

    Parameters
    ----------
    like : tuple of arrays
        Of a record; the new array is as long along each axis as one of them along its first. It
        is not initialised.

    """
    shape = tuple(array.shape[0] for array in like)
    kind = types.Array(types.float64, len(shape), 'C')

    def generate(context, builder, signature, arguments):
        size = ir.Constant(ir.IntType(64), max(1, math.prod(shape)))
        data = cgutils.alloca_once(builder, ir.DoubleType(), size=size)
        data.align = 32  # of the widest registers
        array = context.make_array(kind)(context, builder)
        number = functools.partial(context.get_constant, types.intp)
        context.populate_array(
            array, data=data, shape=[number(length) for length in shape],
            strides=[number(8 * math.prod(shape[axis + 1:])) for axis in range(len(shape))],
            itemsize=number(8), meminfo=None)
        return array._getvalue()

    return kind(like), generate


def dispatch(declaration):
    """
    Declare a function whose body is chosen, at compile time, by the fields of its first argument.

    A compiled function that takes other compiled functions as arguments cannot be kept on disk;
    one that calls a declared function can. `@declared.of(Fields)` above a body adds it for the
    records of a NamedTuple.
    """
    bodies = {}

    def of(fields):
        def add(body):
            bodies[frozenset(fields._fields)] = body
            return body
        return add

    def choose(*types):
        return bodies.get(frozenset(getattr(types[0], 'fields', ())))

    choose.__signature__ = inspect.signature(declaration)
    # Part of its callers: code that is linked may be compiled, and so rounded, apart from them in
    # the process that compiles and not in one that loads from disk.
    overload(declaration, jit_options={**_OPTIONS, 'forceinline': True})(choose)
    declaration.of = of
    return declaration
