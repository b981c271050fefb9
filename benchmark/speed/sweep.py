# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Times a sweep: 10 000 runs of the paper's 10 s scene, N = 3, h = 10 ms, summary of the tip.

Mass at the tip, amplitude of the torque and initial shaft speed all differ from run to run, so
nothing is shared but the arm. The time is that of the whole call, start of the processes
included. A compiled product of a 16 x 16 matrix and a vector, timed on as many cores at once right
before and after, measures the speed of the machine. The sweep's peer is a loop over `simulate`.
"""

import os
from pathlib import Path
import statistics
import threading
import time

import numpy as np

from benchmark import ROOT
from benchmark.command import parser
from benchmark.speed.timing import product
import timo_sim
from timo_sim.sweep.workers import LocalExecutor

PAPER = ROOT / 'config' / 'paper.yaml'
DURATION, STEP, TARGET = 10.0, 0.01, 20.0
COUNTS, QUICK_COUNTS = (1000, 2000, 5000, 10000), (200, 400)
PRODUCTS = 25


def variations(count):
    """Return overrides that differ in all three parameters from run to run."""
    random = np.random.default_rng(1)
    return [{'end_effector.mass': random.uniform(0.5, 5.0),
             'load.torque.harmonic.amplitude': [random.uniform(1.0, 8.0)],
             'initial.shaft_velocity': random.uniform(-1.0, 1.0)} for _ in range(count)]


def products(executor):
    """Return the median time of the product on all workers at once [s]."""
    futures = [executor.submit(product) for _ in range(PRODUCTS * executor.width)]
    return statistics.median(future.result() for future in futures)


class Memory(threading.Thread):
    """Finds the largest memory of this process and of any one child, while it runs [MB]."""

    def __init__(self):
        super().__init__(daemon=True)
        self.own, self.children, self._over = 0.0, 0.0, threading.Event()

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self.join()

    def run(self):
        """Look ten times a second."""
        while not self._over.wait(0.1):
            self.own = max(self.own, _resident('self'))
            children = [child for task in Path('/proc/self/task').iterdir()
                        for child in (task / 'children').read_text().split()]
            self.children = max([self.children, *map(_resident, children)])


def _resident(process):
    try:
        pages = int(Path(f'/proc/{process}/statm').read_text().split()[1])
    except (OSError, IndexError):  # it has just ended
        return 0.0
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def rows(quick=False):
    """
    Measure.

    Returns
    -------
    list of tuple
        (line, target, measured, met, remark); met is None without a target.

    """
    scene = timo_sim.load_scene(PAPER, {'model.modes': 3, 'integrator.step': STEP})
    counts = QUICK_COUNTS if quick else COUNTS
    cores = len(os.sched_getaffinity(0))
    timo_sim.simulate_many(scene, variations(4), DURATION)  # machine code

    few = variations(100)
    start = time.perf_counter()
    # Runs of a sweep are not compared with finer ones either.
    runs = [timo_sim.simulate(timo_sim.load_scene(scene.values, values), DURATION, compare=False)
            for values in few]
    loop = (time.perf_counter() - start) / len(few)
    table = timo_sim.simulate_many(scene, few, DURATION)
    assert all(table['final_shaft'][k] == run.shaft[-1] and table['peak_deflection'][k]
               == np.abs(run.deflection(2.0)[:, 1]).max() for k, run in enumerate(runs))

    seconds, memories = [], []
    with LocalExecutor() as executor:
        unit = [products(executor)]
    for count in counts:
        with Memory() as memory:
            start = time.perf_counter()
            table = timo_sim.simulate_many(scene, variations(count), DURATION)
            seconds.append(time.perf_counter() - start)
        memories.append(memory)
        assert len(table['run']) == count and not any(table['reason'])
    with LocalExecutor() as executor:
        unit.append(products(executor))

    slope, offset = np.polyfit(counts, seconds, 1)
    most, last = counts[-1], seconds[-1]
    shown = ', '.join(f'{count}: {span:.1f} s' for count, span in zip(counts, seconds))
    per_run = last / most * cores / statistics.mean(unit)
    return [
        (f'{most} runs of 10 s, N = 3, h = 10 ms', '' if quick else f'{TARGET:g} s',
         f'{last:.1f} s', None if quick else last <= TARGET,
         f'{cores} cores; mass, torque and shaft speed differ in all runs'),
        ('time of a core for a run, in 16 x 16 products', '', f'{per_run:.0f}', None,
         f'a product: {1e9 * statistics.mean(unit):.0f} ns with all cores busy'),
        ('linear in runs', '', f'{1e3 * slope:.2f} ms a run and {offset:.1f} s', None,
         shown),
        ('memory of this process and of a worker', '',
         f'{memories[-1].own:.0f} MB, {memories[-1].children:.0f} MB', None,
         f'{counts[0]} runs: {memories[0].own:.0f} MB, {memories[0].children:.0f} MB'),
        ('loop over `simulate` for as many runs', '', f'{loop * most:.0f} s', None,
         f'{loop * most / last:.1f} times as long; {1e3 * loop:.1f} ms a run'),
    ]


if __name__ == '__main__':
    quick = parser(__spec__, __doc__, f'{QUICK_COUNTS[-1]} runs').parse_args().quick
    print('| | target | measured | met | |\n|---|---|---|---|---|')
    for row in rows(quick):
        print('| ' + ' | '.join(map(str, row)) + ' |')
