# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Faults that logs and other files must survive: `python -m benchmark.stress.log`.

A fault is survived if the simulation goes on unharmed and what was written is readable, or if the
file is refused in one line. `--quick` tries a few of each. The seed is shown and can be given, to
reproduce a failure.
"""

import os
from pathlib import Path
import random
import signal
import sys
import tempfile

from benchmark.command import parser
from benchmark.stress import files
from benchmark.stress.disks import full_disks, places_that_are_none
from benchmark.stress.kills import kills
from benchmark.stress.tally import ensure, Tally
from oracles.logs import outcome, places, record
import timo_sim

MEMORY_DISK = '/dev/shm' if os.access('/dev/shm', os.W_OK) else None  # three times as fast


def cuts(folder, quick):
    """Cut a log within and between its records."""
    tally = Tally('log cut anywhere')
    intact = record(folder / 'intact.mcap')
    step = 97 if quick else 23
    for cut in sorted({*range(0, len(intact), step),
                       *(place for place, _, _ in places(intact))}):
        with tally.trial(f'at byte {cut}'):
            path = folder / 'cut.mcap'
            path.write_bytes(intact[:cut])
            ensure(outcome(path) != 'complete', 'it is said to be complete')
    return tally.row('recovered or, without any record, refused')


def flips(folder, count, generator):
    """Flip bits of a log."""
    tally, seen = Tally('one or more bits of a log flipped'), {}
    intact = record(folder / 'whole.mcap')
    for number in range(count):
        damaged = bytearray(intact)
        bits = [generator.randrange(8 * len(damaged)) for _ in range(1 + number % 4 * number % 9)]
        for bit in bits:
            damaged[bit // 8] ^= 1 << bit % 8
        with tally.trial(f'bits {bits}'):
            path = folder / 'flipped.mcap'
            path.write_bytes(damaged)
            what = outcome(path)
            ensure(what != 'complete' or damaged == intact, 'it is said to be complete')
            seen[what] = seen.get(what, 0) + 1
    return tally.row(', '.join(f'{number} {what}' for what, number in seen.items()))


def rows(quick=False, seed=None):
    """
    Try all faults.

    Yields
    ------
    what : str
    tried, survived : int
    remark : str

    """
    generator = random.Random(seed)
    sync, os.fsync = os.fsync, lambda number: None  # thousands of logs need not wait for the disk
    try:
        with tempfile.TemporaryDirectory(dir=MEMORY_DISK) as name:
            folder = Path(name)
            yield kills(4 if quick else 100, generator)
            yield cuts(folder, quick)
            yield flips(folder, 300 if quick else 10000, generator)
            yield full_disks(_made(folder / 'full'), quick)
            yield places_that_are_none(_made(folder / 'none'))
            yield from files.rows(_made(folder / 'files'), quick, generator)
    finally:
        os.fsync = sync


def _made(folder):
    folder.mkdir()
    return folder


def main():
    """Print the table."""
    command = parser(__spec__, __doc__, 'a few of each')
    command.add_argument('--seed', type=int, default=random.SystemRandom().randrange(1 << 30))
    given = command.parse_args()
    print(f'timo_sim {timo_sim.__version__}, seed {given.seed}\n')
    print('| fault | tried | survived | remark |\n|---|---|---|---|')
    fallen = 0
    for what, tried, survived, remark in rows(given.quick, given.seed):
        fallen += tried - survived
        print(f'| {what} | {tried} | {survived} | {remark} |', flush=True)
    return fallen > 0


if __name__ == '__main__':
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.exit(main())
