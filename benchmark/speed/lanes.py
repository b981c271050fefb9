# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time of a step and run of a `Batch`, beside that of the scalar step in the same process."""

from statistics import median
import time

import numpy as np

from benchmark.command import parser
from benchmark.speed.step import paper, Prepared, STEPS
import timo_sim

LANES = 64
TARGETS = ((3, 0.35e-6), (5, 0.7e-6), (10, 3e-6))
RATIO = 3.5  # least speed beside the scalar step
COUNTS = (1, 8, 64, 512)


class Together:
    """A batch of the paper's scene; with `alike` false, the mass at the tip differs."""

    def __init__(self, modes, count, alike=True):
        scenes = [paper(modes=modes)] * count
        if not alike:
            scenes = [scene.vary({'end_effector.mass': mass})
                      for scene, mass in zip(scenes, np.linspace(1.0, 3.0, count))]
        self.batch, self.count = timo_sim.Batch(scenes), count

    def run(self):
        """Do the steps of the paper's 10 s."""
        self.batch.reset()
        self.batch.advance(STEPS)


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


def rows(quick=False):
    """Return rows of the table, (line, target, measured, met, remark)."""
    table = []
    for modes, target in TARGETS:
        scalar = Prepared(paper(modes=modes))
        for alike in (True, False):
            least, middle, ratio = in_turns(scalar, Together(modes, LANES, alike))
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
    return table


if __name__ == '__main__':
    parser(__spec__, __doc__).parse_args()
    for row in rows():
        print(*row, sep=' | ')
