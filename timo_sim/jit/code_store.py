# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Machine code on disk, a file for each function and signature, in place of numba's cache.

numba believes the files that it finds and needs those that it writes: one that a crash or a full
disk left short, or a folder that is gone, ends the process. Here a file appears under its name
when it is whole and begins with a checksum; whatever is wrong, the function is compiled.
"""

from contextlib import contextmanager, suppress
import functools
import gc
import hashlib
import os
from pathlib import Path
import pickle
import sys
import tempfile
import uuid
import warnings

from filelock import FileLock
import numba
from numba.core import compiler, serialize
import platformdirs

from timo_sim.jit.corrections import compile_powers

_CHECKSUM = 32  # [B] of SHA-256
# The sources of which machine code is made: this package and the physics.
_SOURCES = [Path(__file__).parents[1] / folder for folder in ('jit', 'physics')]


@functools.cache
def store_directory():
    """
    Return the folder of this version's machine code, or None if none can be written.

    numba tells a stale entry by the date of one file only. The physics calls across files, so the
    folder is named after the contents of all of them.
    """
    digest = hashlib.sha256(f'{numba.__version__} {sys.implementation.cache_tag}'.encode())
    for source in sorted(path for folder in _SOURCES for path in folder.rglob('*.py')):
        digest.update(source.read_bytes())
    base = os.environ.get('NUMBA_CACHE_DIR') or platformdirs.user_cache_dir('timo_sim')
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


def size_mark(*constants):
    """Return the file that marks machine code for constants of these sizes, or None."""
    # Those of any size are known by their type.
    return _mark_of(*(str(getattr(entry, 'dtype', type(entry))) for entry in constants))


def is_compiled(*constants):
    """Return whether machine code for constants of these sizes is on disk."""
    mark = size_mark(*constants)
    return mark is not None and mark.exists()


@functools.lru_cache
def _mark_of(*layouts):
    sizes = hashlib.sha256(repr(layouts).encode()).hexdigest()[:16]
    return store_directory() and store_directory() / f'{sizes}.compiled'


@contextmanager
def compiling(*constants):
    """Let one process compile for constants of these sizes, while others wait for its code."""
    mark = size_mark(*constants)
    if mark is None or mark.exists():
        yield
        return
    with lock(f'{mark.stem}.lock'), _no_garbage_collection():
        yield
        with suppress(OSError):
            mark.touch()


@contextmanager
def _no_garbage_collection():
    # It finds little while numba compiles, and takes a tenth of the time.
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextmanager
def lock(name):
    """Let one process at a time do something, among all that share the folder of machine code."""
    held = FileLock(store_directory() / name)
    # Without the folder, on a full disk or one without locks there is nothing to share.
    with suppress(OSError, NotImplementedError):
        held.acquire()
    try:
        yield
    finally:
        held.release()


class CodeStore:
    """
    Machine code of one function, as numba's dispatcher asks for it.

    Parameters
    ----------
    function : function
        Not compiled.

    """

    def __init__(self, function):
        self._name = f'{function.__module__}.{function.__qualname__}'
        self._code = function.__code__.co_code

    def _path(self, signature, codegen):
        fields = [[*getattr(kind, 'fields', ())] for kind in signature]
        key = repr((self._code, signature, fields, codegen.magic_tuple()))
        return store_directory() / f'{self._name}-{hashlib.sha256(key.encode()).hexdigest()}.code'

    def load_overload(self, signature, target):
        """Return what was saved, or None: then the function is compiled."""
        target.refresh()
        try:
            content = self._path(signature, target.codegen()).read_bytes()
        except OSError:
            content = b''
        checksum, data = content[:_CHECKSUM], content[_CHECKSUM:]
        if hashlib.sha256(data).digest() != checksum:
            compile_powers()
            return None
        return compiler.CompileResult._rebuild(target, *pickle.loads(data))

    def save_overload(self, signature, result):
        """Save machine code, or warn that it is not."""
        data = serialize.dumps(result._reduce())
        unfinished = store_directory() / uuid.uuid4().hex
        try:
            unfinished.write_bytes(hashlib.sha256(data).digest() + data)
            unfinished.replace(self._path(signature, result.codegen))
        except OSError as error:
            with suppress(OSError):
                unfinished.unlink()
            warnings.warn(f'machine code is not kept, it will be compiled again: {error}')
