# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The store of compiled code: it does no harm, and reads nothing that others may have planted."""

import functools
import os
import pwd
import stat
import subprocess
import sys
import tempfile
import threading
import warnings

import platformdirs
import pytest

from timo_sim.compiled import machine, store
from timo_sim.compiled.entry import EntryPoint


def product_by(factor):
    """
    Return 1 times a factor by compiled code, made or loaded as a new process would do it.

    The store has the same name for all factors, so the product tells whose code was run.
    """
    def product(number):
        return factor * number

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, 'ADDRESSES', {})
        patch.setattr(machine, '_engine', functools.cache(machine._engine.__wrapped__))
        return EntryPoint(product, {'number': int})(1)


@pytest.fixture
def find(tmp_path, monkeypatch):
    """Return a function that looks for the store anew: below `root`, else in `temporary`."""
    look = store.store_directory.__wrapped__

    def find():
        folder = look()
        monkeypatch.setattr(store, 'store_directory', lambda: folder)
        return folder

    (tmp_path / 'temporary').mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'temporary'))
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'root'))
    return find


def code_in(folder):
    """Return the files of intermediate code and of machine code."""
    return sorted([*folder.glob('*.bc'), *folder.glob('*.o')])


def test_code_is_loaded_from_disk(find):
    folder = find()
    assert product_by(3) == 3
    intermediate, compiled = code_in(folder)
    assert product_by(2) == 3
    intermediate.unlink()
    assert product_by(2) == 3  # intermediate code is not needed
    compiled.unlink()
    assert product_by(2) == product_by(3) == 2


def test_code_of_another_processor_is_not_loaded(find, monkeypatch):
    """A folder of code or a wheel may come to another computer."""
    folder = find()
    product_by(3)
    intermediate, _ = code_in(folder)
    intermediate.unlink()
    with monkeypatch.context() as patch:
        patch.setattr(machine.llvm, 'get_host_cpu_name', lambda: 'generic')
        assert product_by(2) == 2
    assert product_by(2) == 3


@pytest.mark.parametrize('damage', [
    lambda content: b'', lambda content: content[:-100],
    lambda content: content[:400] + bytes([content[400] ^ 1]) + content[401:]],
    ids=['empty', 'cut', 'one bit'])
def test_damaged_code_is_compiled_again(find, damage):
    folder = find()
    product_by(3)
    for file in code_in(folder):
        file.write_bytes(damage(file.read_bytes()))
    assert product_by(2) == product_by(3) == 2


def test_unreadable_code_is_compiled_and_unwritable_code_gives_a_warning(find):
    folder = find()
    product_by(3)
    for file in code_in(folder):
        file.unlink()
        file.mkdir()
    with pytest.warns(UserWarning, match='machine code is not kept'):
        assert product_by(2) == 2
    assert {file.suffix for file in folder.iterdir()} == {'.bc', '.o', '.lock'}


@pytest.mark.parametrize('kept', [True, False], ids=['made again', 'a file in its place'])
def test_a_folder_of_code_that_disappears_does_no_harm(find, kept):
    folder = find()
    folder.rmdir()
    if not kept:
        folder.touch()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        assert product_by(2) == 2
    assert any('machine code is not kept' in str(each.message) for each in told) != kept
    assert len(code_in(folder)) == 2 * kept


# Attacks by folders and files as another user would plant them.

def give_to_another(path, patch):
    """
    Give a file to another user, or simulate that where this process may not.

    `patch` is a function(object, str, object) that replaces an attribute until the test ends.
    """
    if os.geteuid() == 0:
        os.chown(path, 4321, -1)
        return
    theirs, fstat = path.stat(), os.fstat

    def seen(descriptor):
        status = fstat(descriptor)
        other = status.st_uid + os.path.samestat(status, theirs)
        return os.stat_result((*status[:4], other, *status[5:]))

    patch(os, 'fstat', seen)


def link(path):
    """Put a symbolic link in the place of a file or folder."""
    path.symlink_to(path.rename(path.with_name(f'planted-{path.name}')))


def link_to_root(leaf):
    """Put machine code into the root, and a link to the root in the place of the leaf."""
    for file in leaf.iterdir():
        file.rename(leaf.parent / file.name)
    leaf.rmdir()
    leaf.symlink_to('.')


FOLDERS = {
    'root 1777': lambda leaf, patch: leaf.parent.chmod(0o1777),
    'root 0770': lambda leaf, patch: leaf.parent.chmod(0o770),
    'leaf 0777': lambda leaf, patch: leaf.chmod(0o777),
    'leaf 0720': lambda leaf, patch: leaf.chmod(0o720),
    'root is a link': lambda leaf, patch: link(leaf.parent),
    'leaf is a link': lambda leaf, patch: link(leaf),
    'leaf is a link to the root': lambda leaf, patch: link_to_root(leaf),
    "root is another's": lambda leaf, patch: give_to_another(leaf.parent, patch),
    "leaf is another's": lambda leaf, patch: give_to_another(leaf, patch)}


def another_pipe(file, patch):
    """Put a pipe in the place of a file: to open it for reading would wait for a writer."""
    file.unlink()
    os.mkfifo(file)
    give_to_another(file, patch)


FILES = {
    '0666': lambda file, patch: file.chmod(0o666),
    '0620': lambda file, patch: file.chmod(0o620),
    'link': lambda file, patch: link(file),
    "another's": give_to_another,
    "another's pipe": another_pipe}


@pytest.mark.parametrize('attack', FOLDERS)
def test_a_folder_that_others_may_write_to_is_not_read(find, tmp_path, monkeypatch, attack):
    """The attack comes while a process runs; then a new search must avoid the folder."""
    folder = find()
    product_by(3)
    FOLDERS[attack](folder, monkeypatch.setattr)
    with pytest.warns(UserWarning, match='machine code is not kept'):
        assert product_by(2) == 2
    assert find().is_relative_to(tmp_path / 'temporary')
    assert product_by(2) == product_by(3) == 2


@pytest.mark.parametrize('attack', FILES)
def test_a_file_that_others_may_write_to_is_not_read(find, monkeypatch, attack):
    folder = find()
    product_by(3)
    files = code_in(folder)
    with monkeypatch.context() as patch:
        for file in files:
            FILES[attack](file, patch.setattr)
        assert product_by(2) == 2
    assert product_by(3) == 2
    assert {stat.filemode(file.lstat().st_mode) for file in files} == {'-rw-------'}


def test_locks_follow_no_links(find, tmp_path):
    (find() / 'a.lock').symlink_to(tmp_path / 'target')
    with store.lock('a.lock'):
        pass
    assert not (tmp_path / 'target').exists()


def test_one_process_at_a_time_compiles(find):
    find()
    entered = threading.Event()

    def enter():
        with store.lock('a.lock'):
            entered.set()

    other = threading.Thread(target=enter)
    with store.lock('a.lock'):
        other.start()
        assert not entered.wait(0.2)
    other.join()
    assert entered.is_set()


@pytest.mark.parametrize('umask', [0, 0o2, 0o277])
def test_folders_have_mode_0700_whatever_the_umask(find, tmp_path, umask):
    before = os.umask(umask)
    try:
        folder = find()
    finally:
        os.umask(before)
    assert folder.parent == tmp_path / 'root'
    assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, folder.parent)] == [0o700] * 2


def test_code_is_kept_below_a_folder_of_earlier_versions(find, tmp_path, monkeypatch):
    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    (tmp_path / 'timo_sim').mkdir()
    (tmp_path / 'timo_sim').chmod(0o775)
    assert find().is_relative_to(tmp_path / 'timo_sim')


def old_platformdirs(name):
    return os.path.expanduser(f'~/.cache/{name}')


@pytest.mark.parametrize('default', [platformdirs.user_cache_dir, old_platformdirs])
@pytest.mark.parametrize('given', [None, '~/cache'])
def test_without_a_home_no_folder_named_tilde_is_made(find, tmp_path, monkeypatch, default, given):
    for name in ('HOME', 'XDG_CACHE_HOME', 'NUMBA_CACHE_DIR'):
        monkeypatch.delenv(name, raising=False)
    if given:
        monkeypatch.setenv('NUMBA_CACHE_DIR', given)
    monkeypatch.setattr(pwd, 'getpwuid', {}.__getitem__)
    monkeypatch.setattr(platformdirs, 'user_cache_dir', default)
    monkeypatch.chdir(tmp_path)
    assert find().is_relative_to(tmp_path / 'temporary')
    assert [*tmp_path.iterdir()] == [tmp_path / 'temporary']


WITHOUT = """
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.store import store_directory

@entry_point(number=int)
def tripled(number):
    return 3 * number

print(tripled(2), store_directory())
"""


def test_without_a_safe_folder_the_program_goes_on_with_one_warning(tmp_path):
    fallback = tmp_path / f'timo_sim-{os.geteuid()}'
    for folder in (tmp_path / 'root', fallback):
        folder.mkdir()
        folder.chmod(0o1777)
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT], text=True, capture_output=True, check=True,
        env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'root'), 'TMPDIR': str(tmp_path)})
    assert done.stdout == '6 None\n'
    assert done.stderr.count('Warning: ') == 1
    assert 'UserWarning: machine code is not kept' in done.stderr
    assert str(fallback) in done.stderr
    assert not [*fallback.iterdir(), *(tmp_path / 'root').iterdir()]
