# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time of a step and run of a `Batch`, beside that of the scalar step in the same process."""

from collections import Counter
import math
import os
import re
from statistics import median
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import numpy as np

from benchmark import ROOT
from benchmark.command import parser
from benchmark.speed.step import paper, Prepared, STEPS
import timo_sim

LANES = 64
TARGETS = ((3, 0.35e-6), (5, 0.7e-6), (10, 3e-6))
RATIO = 3.5  # least speed beside the scalar step
COUNTS = (1, 8, 64, 512)
HORIZONS = (100, 1000, 10000)


class Together:
    """A batch of the paper's scene; with `alike` false, the mass at the tip differs."""

    def __init__(self, modes, count, alike=True):
        scenes = [paper(modes=modes)] * count
        if not alike:
            scenes = [scene.vary({'end_effector.mass': mass})
                      for scene, mass in zip(scenes, np.linspace(1.0, 3.0, count))]
        self.batch, self.count = timo_sim.Batch(scenes), count

    def run(self, steps=STEPS):
        """Do the steps of the paper's 10 s, or as many as given."""
        self.batch.reset()
        self.batch.advance(steps)

    def assembly(self):
        """Return the machine code of the steps as text, if this process has compiled it."""
        self.run(1)
        function = self.batch._lanes._advance
        return function.inspect_asm(function.signatures[0])


def in_turns(scalar, together, rounds=15):
    """Return least time of a step and run [s] of a batch, and the median ratio of the scalar's."""
    scalar.run()
    together.run()
    times, ratios = [], []
    for _ in range(rounds):
        spans = []
        for each in (scalar, together):
            start = time.perf_counter()
            each.run()
            spans.append(time.perf_counter() - start)
        times.append(spans[1] / (STEPS * together.count))
        ratios.append(spans[0] / STEPS / times[-1])
    return min(times), median(times), median(ratios)


def instructions():
    """Return the numbers of floating-point instructions for N = 3 by bits of their registers."""
    with TemporaryDirectory() as folder:  # the code of stored functions cannot be read
        text = subprocess.run(
            [sys.executable, '-c', 'from benchmark.speed.lanes import Together; '
             'print(Together(3, 8).assembly())'], env={**os.environ, 'NUMBA_CACHE_DIR': folder},
            cwd=ROOT, check=True, capture_output=True, text=True).stdout
    found = Counter()
    for name, register in re.findall(r'^\s+(v?\w+[ps]d)\s.*%([xyz])mm', text, re.MULTILINE):
        scalar = name.endswith('sd') and register == 'x'
        found['one' if scalar else 128 * 2**'xyz'.index(register)] += 1
    return found


def by_horizon():
    """Return the least time of a step and run [s] by the number of steps of a call."""
    together, found = Together(3, LANES), {}
    for steps in HORIZONS:
        spans = []
        for _ in range(15):
            start = time.perf_counter()
            together.run(steps)
            spans.append(time.perf_counter() - start)
        found[steps] = min(spans) / (steps * LANES)
    return found


def rows(quick=False):
    """Return rows of the table, (line, target, measured, met, remark)."""
    table, times = [], {}
    for modes, target in TARGETS:
        scalar = Prepared(paper(modes=modes))
        for alike in (True, False):
            least, middle, ratio = in_turns(scalar, Together(modes, LANES, alike))
            times[modes, alike] = least
            table.append((
                f'a step and run of a batch, N = {modes}' + ', masses differ' * (not alike),
                f'{1e6 * target:g} us, {RATIO:g} times the speed of the scalar step',
                f'{1e6 * least:.2g} us (median {1e6 * middle:.2g}), {ratio:.1f} times',
                least <= target and ratio >= RATIO, f'{LANES} runs'))
    counts = {count: in_turns(Prepared(paper()), Together(3, count))[0]
              for count in (COUNTS[1:3] if quick else COUNTS)}
    table.append(('the same, N = 3, by number of runs', '', ', '.join(
        f'{count}: {1e6 * least:.2g} us' for count, least in counts.items()), None,
        'a group of lanes has 8; a last group that is not full takes as long'))
    table.append(('the same, by number of steps of a call', '', ', '.join(
        f'{steps}: {1e6 * least:.2g} us' for steps, least in by_horizon().items()), None,
        'a reset and the table of loads included'))
    (least, *_, most), names = (modes for modes, _ in TARGETS), (True, False)
    growth = [math.log(times[most, alike] / times[least, alike]) / math.log(most / least)
              for alike in names]
    table.append((f'growth from N = {least} to {most}', '',
                  f'N^{growth[0]:.1f}; if masses differ N^{growth[1]:.1f}', None,
                  'matrices of 2 (3 + N) rows; constants of lanes that differ leave the first '
                  'cache'))
    counts = instructions()
    table.append(('floating-point instructions of the compiled step, N = 3, by bits of their '
                  'registers', '', ', '.join(f'{bits}: {counts[bits]}' for bits in (
                      512, 256, 128, 'one')), None, '"one": a single number; '
                  f'{sum(counts.values()) / (8e9 * times[3, True]):.1f} of them a nanosecond'))
    return table


if __name__ == '__main__':
    parser(__spec__, __doc__).parse_args()
    for row in rows():
        print(*row, sep=' | ')
