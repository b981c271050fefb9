# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Store of code on disk.

A file begins with a checksum and gets its name when it is complete; if anything is wrong with it,
it is as if it did not exist.

Code from the store is executed: nothing is read from a folder or file that another user owns or
may write to, or that is a symbolic link. Code that was made when the package was built is a part
of the package, which is trusted.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack, suppress
import errno
import fcntl
import functools
import hashlib
import os
from pathlib import Path
import stat
import sys
import tempfile
import uuid
import warnings

import platformdirs

_CHECKSUM = 32  # length of a SHA-256 checksum [B]
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
PREBUILT = Path(__file__).with_name('prebuilt')  # see `export/prebuilt.py`
# Folders with the sources of compiled functions.
_SOURCES = [Path(__file__).parents[1] / folder for folder in ('compiled', 'model', 'steps')]


@functools.cache
def _own_sources():
    # They call across files.
    paths = sorted(path for folder in _SOURCES for path in folder.rglob('*.py'))
    return paths, b''.join(path.read_bytes() for path in paths)


@functools.cache
def digest_of_sources(*modules: str) -> str:
    """Return a checksum of the sources of compiled functions, and of the files of modules."""
    paths, text = _own_sources()
    files = (getattr(sys.modules[name], '__file__', None) for name in modules)
    for path in sorted({Path(file) for file in files if file} - {*paths}):
        text += path.read_bytes()
    return hashlib.sha256(text).hexdigest()[:16]


@functools.cache
def store_directory() -> Path | None:
    """Return the folder for code of these sources; warn and return None if none is usable."""
    from importlib.metadata import version  # 20 ms that prebuilt code spares
    name = f'{digest_of_sources()}-{version("numba")}-{version("llvmlite")}'
    refused = []
    for root in _roots():
        try:
            directory = root.absolute() / name
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


def read(name: str) -> bytes | None:
    """Return the contents of a file of the package or the store, None if there is no whole one."""
    for file in (PREBUILT / name).open, functools.partial(_file, name):
        with suppress(OSError), file('rb') as opened:
            content = opened.read()
            data = content[_CHECKSUM:]
            if hashlib.sha256(data).digest() == content[:_CHECKSUM]:
                return data
    return None


def _sealed(data):
    return hashlib.sha256(data).digest() + data


def copy(name: str, path: Path) -> None:
    """Copy a file of the package or the store to a new path, if there is a whole one."""
    data = read(name)
    if data is not None:
        path.write_bytes(_sealed(data))


def write(name: str, data: bytes) -> None:
    """Write a file of the store, or warn; without a folder, of which is warned, do nothing."""
    if store_directory() is None:
        return
    unfinished = uuid.uuid4().hex
    try:
        with _file(unfinished, 'xb') as file:
            file.write(_sealed(data))
        with _opened(store_directory()) as folder:
            os.replace(unfinished, name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError as error:
        with suppress(OSError), _opened(store_directory()) as folder:
            os.unlink(unfinished, dir_fd=folder)
        warnings.warn(f'machine code is not kept, it will be compiled again: {error}')


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


def read_or_make(name: str, make: Callable[[], bytes]) -> bytes:
    """Return the contents of a file; if there is none, one process makes it and others wait."""
    data = read(name)
    if data is None:
        with lock(f'{name}.lock'):
            data = read(name)
            if data is None:
                data = make()
                write(name, data)
    return data
