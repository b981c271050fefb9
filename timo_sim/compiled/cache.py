# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Store of machine code on disk, a file for each function and signature, in place of numba's cache.

numba trusts the files that it finds and needs those that it writes: a file that a crash or a full
disk cut short, or a missing folder, ends the process. Here a file begins with a checksum and gets
its name when it is complete; if anything is wrong with it, the function is compiled.

Loading machine code means unpickling, which can run any code: nothing is read from a folder or
file that another user owns or may write to, or that is a symbolic link.
"""

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, suppress
import errno
import fcntl
import functools
import gc
import hashlib
import os
from pathlib import Path
import pickle
import stat
import sys
import tempfile
from typing import Any
import uuid
import warnings

import numba
from numba.core import compiler, config, serialize, types
from numba.core.types import containers
import platformdirs


# Corrections to numba, without which machine code depends on what a process has done before.
#
# Names: numba names machine code after the types of its arguments: records by the order in which a
# process has met them, nested arrays without their shape. Two sizes that are compiled in different
# processes and loaded from disk into one process would then call each other's code. numba names a
# NamedTuple without its fields. Here the names depend on the contents of all these types.
#
# Powers: numba compiles `x**2` as a function of its own, once in a process, with the fast math of
# whoever uses it first. The last bits would depend on whether the first user is compiled or loaded
# from disk. Here powers are compiled first, without fast math.
#
# NUMBA_DISABLE_JIT, also as an entry of .numba_config.yaml: it is for functions of the user. The
# physics is compiled all the same, because its lanes and records have no meaning in Python.

def _name_by_contents(kind):
    contents = f'{kind.name} {" ".join(getattr(kind, "fields", ()))}'
    return f'{type(kind).__name__}{hashlib.sha256(contents.encode()).hexdigest()[:16]}', ()


def correct_names() -> None:
    """Let numba name records, nested arrays and NamedTuples by their contents."""
    for kind in (types.Record, types.NestedArray, containers.NamedTuple):
        setattr(kind, 'mangling_args', property(_name_by_contents))


@contextmanager
def jit_enabled() -> Iterator[None]:
    """Let numba compile, whatever NUMBA_DISABLE_JIT says."""
    usual, config.DISABLE_JIT = config.DISABLE_JIT, 0
    try:
        yield
    finally:
        config.DISABLE_JIT = usual


@functools.cache
@jit_enabled()
def compile_powers() -> None:
    """Compile x**2 and x**3 without fast math; call this before other functions are compiled."""
    numba.njit(fastmath=False, error_model='numpy')(_powers).compile((types.float64,))


def _powers(x):
    return x**2 + x**3


_CHECKSUM = 32  # length of a SHA-256 checksum [B]
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_TEXTS: dict = {}  # dtypes and their texts by identity
_FOUND = set()  # folders and marks that this process has found
# Folders with the sources of compiled functions.
_SOURCES = [Path(__file__).parents[1] / folder for folder in ('compiled', 'model', 'steps')]


@functools.cache
def store_directory() -> Path | None:
    """
    Return the folder for machine code of these sources; warn and return None if none is usable.

    numba recognises a stale entry by the date of one file. The physics calls across files, so the
    folder is named after the contents of all of them.
    """
    digest = hashlib.sha256(f'{numba.__version__} {sys.implementation.cache_tag}'.encode())
    for source in sorted(path for folder in _SOURCES for path in folder.rglob('*.py')):
        digest.update(source.read_bytes())
    refused = []
    for root in _roots():
        try:
            directory = root.absolute() / digest.hexdigest()[:16]
            with _opened(directory):
                if os.access(directory, os.W_OK):
                    return directory
                refused.append(f'{directory} is not writable')
        except OSError as error:
            refused.append(str(error))
    warnings.warn('machine code is not kept, every process compiles it: ' + '; '.join(refused))
    return None


def _roots():
    with suppress(RuntimeError):  # raised where there is no home folder
        # Not the folder `timo_sim` itself: earlier versions made it, with some umasks writable by
        # the group.
        yield Path(os.environ.get('NUMBA_CACHE_DIR')
                   or Path(platformdirs.user_cache_dir('timo_sim'), 'code')).expanduser()
    with suppress(OSError):  # no folder for temporary files
        yield Path(tempfile.gettempdir(), f'timo_sim-{os.geteuid()}')


def _open(name, flags, folder=None):
    """Return a descriptor; raise PermissionError if others own what is opened or may write it."""
    # O_NONBLOCK: opening must not wait, not even for a named pipe in the place of a file.
    descriptor = os.open(name, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600, dir_fd=folder)
    status = os.fstat(descriptor)
    if status.st_uid == os.geteuid() and not status.st_mode & _OTHERS_WRITE:
        return descriptor
    os.close(descriptor)
    raise PermissionError(errno.EPERM, 'Another user owns it or may write to it', str(name))


def _open_folder(name, parent=None):
    try:
        return _open(name, os.O_DIRECTORY, parent)
    except FileNotFoundError:
        with suppress(FileExistsError):  # another process was faster
            os.mkdir(name, 0o700, dir_fd=parent)
    descriptor = _open(name, os.O_DIRECTORY, parent)
    os.fchmod(descriptor, 0o700)  # whatever the umask
    return descriptor


@contextmanager
def _opened(directory):
    """Open a folder after its parent, both with the checks of `_open`; make missing ones."""
    if directory is None:
        raise FileNotFoundError(errno.ENOENT, 'No folder for machine code')
    directory.parent.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        root = _open_folder(directory.parent)
        stack.callback(os.close, root)
        leaf = _open_folder(directory.name, root)
        stack.callback(os.close, leaf)
        yield leaf


@contextmanager
def _file(name, mode):
    """Open a file of the store as `open` does, with the checks of `_open`."""
    with _opened(store_directory()) as folder, open(
            name, mode, opener=functools.partial(_open, folder=folder)) as file:
        yield file


def size_mark(*constants: Any) -> str:
    """Return the name of the file that exists if code for these sizes of constants is on disk."""
    # Packed constants differ by dtype; those of any size share a type.
    layouts = tuple(_text(getattr(entry, 'dtype', type(entry))) for entry in constants)
    return f'{hashlib.sha256(repr(layouts).encode()).hexdigest()[:16]}.compiled'


def _text(layout):
    # A dtype is found by its identity, because its hash takes as long as its text.
    same, text = _TEXTS.get(id(layout), (None, ''))
    if same is not layout:
        text = str(layout)
        _TEXTS[id(layout)] = layout, text
    return text


def mark_of(*constants: Any) -> tuple[Path | None, str]:
    """Return the folder and the name of the file of `size_mark`."""
    return store_directory(), size_mark(*constants)


def is_compiled(*constants: Any) -> bool:
    """Return whether machine code for constants of these sizes is on disk."""
    mark = mark_of(*constants)
    with suppress(OSError):
        if mark not in _FOUND:
            with _file(mark[1], 'rb'):
                _FOUND.add(mark)
    return mark in _FOUND


@contextmanager
def compiling(*constants: Any) -> Iterator[None]:
    """Let one process compile for constants of these sizes, while others wait for its code."""
    if is_compiled(*constants):
        yield
        return
    mark = size_mark(*constants)
    with lock(f'{mark}.lock'), _no_garbage_collection():
        yield
        with suppress(OSError), _file(mark, 'ab'):
            pass


@contextmanager
def _no_garbage_collection():
    # While numba compiles, the collector frees little and takes a tenth of the time.
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextmanager
def lock(name: str) -> Iterator[None]:
    """Let one process at a time run a block, of all that share the folder of machine code."""
    with ExitStack() as stack:
        # Where no file can be made or locked, the block runs unlocked: code may be compiled twice.
        with suppress(OSError):
            held = stack.enter_context(_file(name, 'ab'))
            fcntl.flock(held, fcntl.LOCK_EX)
            stack.callback(fcntl.flock, held, fcntl.LOCK_UN)  # a forked child may keep it open
        yield


class CodeStore:
    """
    Store of the machine code of one function, called by numba's dispatcher as its cache.

    Parameters
    ----------
    function : function
        The Python function.

    """

    def __init__(self, function: Any) -> None:
        self._name = f'{function.__module__}.{function.__qualname__}'
        self._code = function.__code__.co_code

    def _file_name(self, signature, codegen):
        fields = [[*getattr(kind, 'fields', ())] for kind in signature]
        key = repr((self._code, signature, fields, codegen.magic_tuple()))
        return f'{self._name}-{hashlib.sha256(key.encode()).hexdigest()}.code'

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the saved machine code for a signature, or None: numba then compiles."""
        target.refresh()
        try:
            with _file(self._file_name(signature, target.codegen()), 'rb') as file:
                content = file.read()
        except OSError:
            content = b''
        checksum, data = content[:_CHECKSUM], content[_CHECKSUM:]
        if hashlib.sha256(data).digest() != checksum:
            compile_powers()
            return None
        return compiler.CompileResult._rebuild(target, *pickle.loads(data))

    def save_overload(self, signature: Any, result: Any) -> None:
        """Save the machine code for a signature; warn if that fails."""
        data = serialize.dumps(result._reduce())
        unfinished = uuid.uuid4().hex
        try:
            with _file(unfinished, 'xb') as file:
                file.write(hashlib.sha256(data).digest() + data)
            with _opened(store_directory()) as folder:
                os.replace(unfinished, self._file_name(signature, result.codegen),
                           src_dir_fd=folder, dst_dir_fd=folder)
        except OSError as error:
            with suppress(OSError), _opened(store_directory()) as folder:
                os.unlink(unfinished, dir_fd=folder)
            warnings.warn(f'machine code is not kept, it will be compiled again: {error}')
