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

To load machine code is to unpickle, which may run anything: nothing is read from a folder or file
that another user owns or may write to, or that a symbolic link names.
"""

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
import uuid
import warnings

import numba
from numba.core import compiler, serialize
import platformdirs

from timo_sim.jit.corrections import compile_powers

_CHECKSUM = 32  # [B] of SHA-256
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
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
    with suppress(RuntimeError):  # no home, said by platformdirs or by Path
        # Earlier versions made the folder `timo_sim` itself, writable to the group by some umasks.
        yield Path(os.environ.get('NUMBA_CACHE_DIR')
                   or Path(platformdirs.user_cache_dir('timo_sim'), 'code')).expanduser()
    with suppress(OSError):  # no folder for temporary files
        yield Path(tempfile.gettempdir(), f'timo_sim-{os.geteuid()}')


def _open(name, flags, folder=None):
    """Return a descriptor of what is ours alone, relative to the descriptor of a folder."""
    # What was put in the place of a file must not make its opening wait.
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
    """Open a folder by way of the one around it, both ours alone; make what is missing."""
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
    """Open a file of the store, that is ours alone, as `open` does."""
    with _opened(store_directory()) as folder, open(
            name, mode, opener=functools.partial(_open, folder=folder)) as file:
        yield file


def size_mark(*constants):
    """Return the name of the file that marks machine code for constants of these sizes."""
    # Those of any size are known by their type.
    layouts = tuple(str(getattr(entry, 'dtype', type(entry))) for entry in constants)
    return f'{hashlib.sha256(repr(layouts).encode()).hexdigest()[:16]}.compiled'


def is_compiled(*constants):
    """Return whether machine code for constants of these sizes is on disk."""
    with suppress(OSError), _file(size_mark(*constants), 'rb'):
        return True
    return False


@contextmanager
def compiling(*constants):
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
    with ExitStack() as stack:
        # Without the folder, on a full disk or one without locks there is nothing to share.
        with suppress(OSError):
            held = stack.enter_context(_file(name, 'ab'))
            fcntl.flock(held, fcntl.LOCK_EX)
            stack.callback(fcntl.flock, held, fcntl.LOCK_UN)  # a fork may have it open, too
        yield


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

    def _file_name(self, signature, codegen):
        fields = [[*getattr(kind, 'fields', ())] for kind in signature]
        key = repr((self._code, signature, fields, codegen.magic_tuple()))
        return f'{self._name}-{hashlib.sha256(key.encode()).hexdigest()}.code'

    def load_overload(self, signature, target):
        """Return what was saved, or None: then the function is compiled."""
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

    def save_overload(self, signature, result):
        """Save machine code, or warn that it is not."""
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
