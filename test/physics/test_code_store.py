# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The store of machine code loads nothing that other users may have planted."""

import os
import pwd
import stat
import subprocess
import sys
import tempfile

import platformdirs
import pytest

from oracles.hostile_caches import FILES, FOLDERS, plant
from timo_sim.compiled import cache
from timo_sim.compiled.cache import compiling, is_compiled, lock, size_mark
from timo_sim.compiled.functions import entry_point


def tripled(number):
    return 3.0 * number


def call():
    """Compile or load a function as a new process would; return whether it was loaded."""
    function = entry_point(tripled)
    assert function(1.5) == 4.5
    return sum(function._cache_hits.values()) == 1


@pytest.fixture
def find(tmp_path, monkeypatch):
    """Return a function that looks for the store anew: below `root`, else in `temporary`."""
    look = cache.store_directory.__wrapped__

    def find():
        store = look()
        monkeypatch.setattr(cache, 'store_directory', lambda: store)
        return store

    (tmp_path / 'temporary').mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'temporary'))
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'root'))
    return find


@pytest.mark.parametrize('attack', FOLDERS)
def test_a_folder_that_others_may_write_to_is_not_read(find, tmp_path, monkeypatch, attack):
    """The attack comes while a process runs; then a new search must avoid the folder."""
    store = find()
    call()
    plant(store, tmp_path / 'proof')
    FOLDERS[attack](store, monkeypatch.setattr)
    with pytest.warns(UserWarning, match='machine code is not kept'):
        assert not call()
    assert find().is_relative_to(tmp_path / 'temporary')
    assert not call()
    assert call()
    assert not (tmp_path / 'proof').exists()


@pytest.mark.parametrize('attack', FILES)
def test_a_file_that_others_may_write_to_is_not_unpickled(find, tmp_path, monkeypatch, attack):
    store = find()
    call()
    file = plant(store, tmp_path / 'proof')
    with monkeypatch.context() as patch:
        FILES[attack](file, patch.setattr)
        assert not call()
    assert not (tmp_path / 'proof').exists()
    assert call() and stat.filemode(file.lstat().st_mode) == '-rw-------'


def test_locks_and_marks_follow_no_links(find, tmp_path):
    store, target = find(), tmp_path / 'target'
    for name in ('a.lock', f'{size_mark(1.0)}.lock', size_mark(1.0)):
        (store / name).symlink_to(target)
    with lock('a.lock'), compiling(1.0):
        pass
    assert not target.exists()
    target.touch()
    assert not is_compiled(1.0)


@pytest.mark.parametrize('umask', [0, 0o2, 0o277])
def test_folders_have_mode_0700_whatever_the_umask(find, tmp_path, umask):
    before = os.umask(umask)
    try:
        store = find()
    finally:
        os.umask(before)
    assert store.parent == tmp_path / 'root'
    assert [stat.S_IMODE(path.stat().st_mode) for path in (store, store.parent)] == [0o700] * 2


def test_code_is_kept_below_a_folder_of_earlier_versions(
        find, tmp_path, monkeypatch):
    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    (tmp_path / 'timo_sim').mkdir()
    (tmp_path / 'timo_sim').chmod(0o775)
    assert find().is_relative_to(tmp_path / 'timo_sim')


def old_platformdirs(name):
    return os.path.expanduser(f'~/.cache/{name}')


@pytest.mark.parametrize('default', [platformdirs.user_cache_dir, old_platformdirs])
@pytest.mark.parametrize('given', [None, '~/cache'])
def test_without_a_home_no_folder_named_tilde_is_made(
        find, tmp_path, monkeypatch, default, given):
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
from timo_sim.compiled.cache import compiling, is_compiled, lock, store_directory
from timo_sim.compiled.functions import entry_point
import timo_sim

def tripled(number):
    return 3.0 * number

with lock('a.lock'), compiling(1.0):
    print(entry_point(tripled)(1.5), is_compiled(1.0), store_directory())
"""


def test_without_a_safe_folder_the_program_goes_on_with_one_warning(tmp_path):
    fallback = tmp_path / f'timo_sim-{os.geteuid()}'
    for folder in (tmp_path / 'root', fallback):
        folder.mkdir()
        folder.chmod(0o1777)
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT], text=True, capture_output=True, check=True,
        env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'root'), 'TMPDIR': str(tmp_path)})
    assert done.stdout == '4.5 False None\n'
    assert done.stderr.count('Warning: ') == 1
    assert 'UserWarning: machine code is not kept' in done.stderr
    assert str(fallback) in done.stderr
    assert not [*fallback.iterdir(), *(tmp_path / 'root').iterdir()]
