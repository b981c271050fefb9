# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Times sweeps: 10 000 runs of the paper's 10 s scene, N = 3, h = 10 ms, summary of the tip.

Amplitude of the torque and initial shaft speed differ from run to run, and in half of the sweeps
the mass at the tip, too, so that nothing is shared but the arm. The time is that of the whole
call, start of the processes included. A compiled product of a 16 x 16 matrix and a vector, timed
on as many cores at once right before and after, measures the speed of the machine. The sweep's
peer is a loop over `simulate`.
"""

import os
from pathlib import Path
import statistics
import threading
import time

from distributed import LocalCluster
import numpy as np

from benchmark import ROOT
from benchmark.command import parser
from benchmark.speed.clocks import clocks
from benchmark.speed.timing import product
import timo_sim
from timo_sim.physics.arm.modes import UniformModes
from timo_sim.physics.integrate.lane_steps import LaneSteps
from timo_sim.simulation.lane_loads import LaneLoads
from timo_sim.sweep.jobs import jobs_of, run_job
from timo_sim.sweep.workers import LocalExecutor

PAPER = ROOT / 'config' / 'paper.yaml'
DURATION, STEP = 10.0, 0.01
TARGETS = {'bodies differ': 6.0, 'loads and states differ': 3.0}  # of 10 000 runs [s]
COUNTS, QUICK_COUNTS, LONG = (1000, 2000, 5000, 10000), (200, 400), 100_000
PRODUCTS = 25


def variations(count, bodies=True):
    """Return overrides that differ in all their parameters from run to run."""
    random = np.random.default_rng(1)
    found = [{'end_effector.mass': random.uniform(0.5, 5.0),
              'load.torque.harmonic.amplitude': [random.uniform(1.0, 8.0)],
              'initial.shaft_velocity': random.uniform(-1.0, 1.0)} for _ in range(count)]
    for each in found:
        if not bodies:
            del each['end_effector.mass']
    return found


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


def parts(scene, kind):
    """Return the parts of the time of a run in a sweep, as text."""
    for _ in range(2):  # all caches are filled at the second time
        jobs = list(jobs_of(scene, DURATION, 960, variations(960, kind == 'bodies differ'), []))
        start = time.perf_counter()
        with clocks(scene=(timo_sim.Scene, 'vary'), modes=(UniformModes, '__init__'),
                    steps=(LaneSteps, 'advance'), matrices=(LaneSteps, '__init__'),
                    loads=(LaneLoads, 'varying')) as spent:
            for job in jobs:
                run_job(job)
        whole = time.perf_counter() - start
    ms = {name: 1e3 * span / 960 for name, span in spent.items()}
    rest = 1e3 * whole / 960 - sum(ms.values()) + ms['modes']
    return (f'scene and tables {ms["scene"]:.2f} ms (modes {ms["modes"]:.2f}), '
            f'steps {ms["steps"]:.2f}, matrices {ms["matrices"]:.2f}, loads {ms["loads"]:.2f}, '
            f'rest {rest:.2f}')


def by_dask(scene, count, kind, cores):
    """Return the time of a sweep by Dask with local workers [s]; assert its numbers."""
    runs = variations(count, kind == 'bodies differ')
    with LocalCluster(n_workers=cores, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        timo_sim.simulate_many(scene, runs[:960], DURATION, scheduler=address)  # imports
        start = time.perf_counter()
        table = timo_sim.simulate_many(scene, runs, DURATION, scheduler=address)
        seconds = time.perf_counter() - start
    ours = timo_sim.simulate_many(scene, runs, DURATION)
    assert all(np.array_equal(table[name], ours[name]) for name in ours)
    return seconds


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
    few = variations(96)
    table = timo_sim.simulate_many(scene, few, DURATION)  # and machine code of lanes
    timo_sim.simulate(scene, DURATION, estimate=False)
    start = time.perf_counter()
    # Runs of a sweep are not compared with finer ones either.
    runs = [timo_sim.simulate(timo_sim.load_scene(scene.values, values), DURATION, estimate=False)
            for values in few]
    loop = (time.perf_counter() - start) / len(few)
    assert all(np.isclose(table['final_shaft'][k], run.shaft[-1], rtol=1e-10)
               and np.isclose(table['peak_deflection'][k],
                              np.abs(run.deflection(2.0)[:, 1]).max(), rtol=1e-10)
               for k, run in enumerate(runs))
    del runs
    timo_sim.simulate_many(scene, variations(96, bodies=False), DURATION)
    with LocalExecutor() as executor:
        unit = [products(executor)]
    seconds, memories = {}, {}
    for kind in TARGETS:
        for count in counts if quick or kind == 'bodies differ' else (*counts, LONG):
            with Memory() as memory:
                start = time.perf_counter()
                table = timo_sim.simulate_many(
                    scene, variations(count, kind == 'bodies differ'), DURATION)
                seconds[kind, count] = time.perf_counter() - start
            memories[kind, count] = memory
            assert len(table['run']) == count and not any(table['reason'])
    with LocalExecutor() as executor:
        unit.append(products(executor))
    unit, most, found = statistics.mean(unit), counts[-1], []
    for kind, target in TARGETS.items():
        last = seconds[kind, most]
        found.append((
            f'{most} runs of 10 s, N = 3, h = 10 ms, {kind}', '' if quick else f'{target:g} s',
            f'{last:.1f} s', None if quick else last <= target,
            f'{cores} cores; {last / most * cores / unit:.0f} products of a core for a run, a '
            f'product takes {1e9 * unit:.0f} ns with all cores busy'))
        slope, offset = np.polyfit(counts, [seconds[kind, count] for count in counts], 1)
        found.append((
            f'linear in runs, {kind}', '', f'{1e3 * slope:.2f} ms a run and {offset:.1f} s', None,
            ', '.join(f'{count}: {span:.1f} s' for (each, count), span in seconds.items()
                      if each == kind)))
    for (kind, count), memory in memories.items():
        if count in (counts[0], LONG) and kind != 'bodies differ':
            found.append((f'memory of this process and of a worker, {count} runs', '',
                          f'{memory.own:.0f} MB, {memory.children:.0f} MB', None,
                          'the table and the list of variations are kept here'))
    for kind, target in TARGETS.items():
        taken = by_dask(scene, most, kind, cores)
        found.append((f'{most} runs by Dask, {cores} local workers, {kind}',
                      '' if quick else f'{target:g} s', f'{taken:.1f} s',
                      None if quick else taken <= target,
                      'workers have started; the same numbers to the last bit'))
    found += [(f'parts of a run, alone on a core, {kind}', '', parts(scene, kind), None,
               'the modes are a part of the tables')
              for kind in TARGETS]
    last = seconds['bodies differ', most]
    return [*found, (
        'loop over `simulate` for as many runs, bodies differ', '', f'{loop * most:.0f} s', None,
        f'{loop * most / last:.1f} times as long; {1e3 * loop:.1f} ms a run')]


if __name__ == '__main__':
    quick = parser(__spec__, __doc__, f'{QUICK_COUNTS[-1]} runs').parse_args().quick
    print('| | target | measured | met | |\n|---|---|---|---|---|')
    for row in rows(quick):
        print('| ' + ' | '.join(map(str, row)) + ' |')
