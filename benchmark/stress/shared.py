# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Attacks on what processes share on a disk: the folder of machine code, parts of a sweep."""

from contextlib import ExitStack
import os
import subprocess
import sys
import tempfile
import time
from unittest import mock
import warnings

from pyarrow import parquet

from benchmark import ROOT
from benchmark.process import ENVIRONMENT
from benchmark.stress.tally import ensure, Tally
from oracles.hostile_caches import FILES, FOLDERS, plant
from timo_sim.compiled import cache
from timo_sim.compiled.functions import entry_point

SWEEP = f"""
scene: {ROOT / 'config' / 'paper.yaml'}
duration: 5.0
parameters: {{integrator.step: 0.01}}
random: {{seed: 7, count: 96, ranges: {{end_effector.mass: [0.5, 5.0]}}}}
"""


def _tripled(number):
    return 3.0 * number


def hostile_caches(folder):
    """Plant machine code where another user can, while a process runs and before one begins."""
    tally, look = Tally('hostile cache folders'), cache.store_directory.__wrapped__
    for number, (name, attack) in enumerate({**FOLDERS, **FILES}.items()):
        with tally.trial(name), ExitStack() as stack:
            def patch(*what):
                stack.enter_context(mock.patch.object(*what))

            temporary, proof = folder / f'temporary {number}', folder / f'proof {number}'
            temporary.mkdir()
            patch(tempfile, 'tempdir', str(temporary))
            stack.enter_context(mock.patch.dict(
                os.environ, {'NUMBA_CACHE_DIR': str(folder / f'root {number}')}))
            stack.enter_context(warnings.catch_warnings(action='ignore'))
            store = look()
            patch(cache, 'store_directory', lambda: store)
            entry_point(_tripled)(1.0)
            attack(plant(store, proof) if name in FILES else plant(store, proof).parent, patch)
            for _ in range(2):
                ensure(entry_point(_tripled)(2.0) == 6.0 and not proof.exists(), 'its code is run')
                store = look()
    return tally.row(f'code run: {len([*folder.glob("proof *")])}')


def sweeps_at_once(folder, count, generator):
    """Start the same sweep two or three times at once, in turns; kill one of the three."""
    tally, refused, expected = Tally('two sweeps at once, or three, one killed'), 0, None
    (folder / 'study.yaml').write_text(SWEEP)
    for number in range(count):
        place = folder / f'sweeps {number}'
        place.mkdir()
        with tally.trial(f'sweeps {number}'):
            sweeps = [_sweep(place) for _ in range(2 + number % 2)]
            if number % 2:
                time.sleep(generator.uniform(0.0, 4.0))
                generator.choice(sweeps).kill()
            codes = [_end(sweep) for sweep in sweeps]
            refused += codes.count(2)
            ensure(codes.count(0) <= 1, 'two have done it')
            ensure(0 in codes or number % 2 and _end(_sweep(place)) == 0, 'none has done it')
            table = parquet.read_table(place / 'study.parquet')
            expected = expected or table
            ensure(table.equals(expected) and len(table) == 96, 'another result')
            ensure([path.name for path in place.iterdir()] == ['study.parquet'], 'parts are left')
    return tally.row(f'one result each, {refused} refused in one line')


def _sweep(place):
    return subprocess.Popen(
        [sys.executable, '-m', 'timo_sim', 'sweep', '../study.yaml', '--workers', '1'], cwd=place,
        env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _end(sweep):
    _, errors = sweep.communicate(timeout=300.0)
    code = sweep.returncode
    # The resource tracker of one that is killed may report what it cleans up.
    ensure(code == -9 or (code, errors.count('\n')) in ((0, 0), (2, 1)), errors)
    return code
