# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults that machine code and sweeps must survive; see log.py."""

import os
import subprocess
import sys

from benchmark.stress import shared
from benchmark.stress.tally import ensure, small_disk, Tally
from timo_sim.compiled import cache as code_store
from timo_sim.compiled.functions import entry_point


def _tripled(number):
    return 3.0 * number


def machine_code(folder, count, generator):
    """Damage machine code on disk."""
    tally, store_folder = Tally('machine code on disk flipped, cut, replaced'), folder / 'code'
    store_folder.mkdir(mode=0o700)
    before, code_store.store_directory = code_store.store_directory, lambda: store_folder
    try:
        for number in range(count):
            function = entry_point(_tripled)
            function(1.0)
            file, = store_folder.glob('*.code')
            content = bytearray(file.read_bytes())
            place = generator.randrange(len(content))
            content[place] ^= 1 << generator.randrange(8)
            file.write_bytes([content, content[:place], os.urandom(place)][number % 3])
            with tally.trial(f'byte {place}, kind {number % 3}'):
                again = entry_point(_tripled)
                ensure(again(2.0) == 6.0 and not sum(again._cache_hits.values()), 'it is used')
    finally:
        code_store.store_directory = before
    return tally.row('compiled again')


RUN = """
import os, pathlib, shutil, sys, timo_sim
from timo_sim.compiled.cache import store_directory
folder = store_directory()
if sys.argv[1] == 'removed':
    shutil.rmtree(folder)
elif sys.argv[1] == 'full':
    with open(folder / 'ballast', 'wb', buffering=0) as ballast:
        try:
            for _ in range(2048):  # at most eight times the small disk, if this is another one
                ballast.write(bytes(4096))
        except OSError:
            pass
scene = timo_sim.load_scene({'model.formulation': 'newton', 'model.modes': 1,
                             'initial.shaft_velocity': 1.0})
print(timo_sim.simulate(scene, 0.1).motion[-1].tobytes().hex())
"""


def runs_without_a_cache(folder):
    """Take the folder of machine code away from a run, in several ways."""
    tally, expected = Tally('run whose machine code cannot be kept'), set()

    def run(how, cache):
        done = subprocess.run([sys.executable, '-c', RUN, how], capture_output=True, text=True,
                              timeout=200.0, env={**os.environ, 'NUMBA_CACHE_DIR': str(cache)})
        ensure(not done.returncode, done.stderr)
        expected.add(done.stdout)
        ensure(len(expected) == 1, 'another result')

    with tally.trial('removed while it runs'):
        run('removed', folder / 'removed')
    with tally.trial('all files cut'):
        run('', folder / 'cut')
        for file in (folder / 'cut').rglob('*.code'):
            file.write_bytes(file.read_bytes()[:-100])
        run('', folder / 'cut')
    with tally.trial('on a full disk'), small_disk(folder, 1 << 20) as disk:
        if disk:
            run('full', disk)
    return tally.row('the same result to the last bit')


def rows(folder, quick, generator):
    """Try all faults; yield what, how many were tried and survived, and a remark."""
    yield machine_code(folder, 9 if quick else 100, generator)
    if not quick:
        yield runs_without_a_cache(folder)
    yield shared.hostile_caches(folder)
    yield shared.sweeps_at_once(folder, 2 if quick else 10, generator)
