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
call, start of the processes included. The sweep's peer is a loop over `simulate`.
"""

import os
import time

from distributed import LocalCluster
import numpy as np

from benchmark import ROOT
from benchmark.command import parser
import timo_sim

PAPER = ROOT / 'config' / 'paper.yaml'
DURATION, STEP = 10.0, 0.01
TARGETS = {'bodies differ': 6.0, 'loads and states differ': 3.0}  # of 10 000 runs [s]


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


def rows(quick=False):
    """
    Measure.

    Returns
    -------
    list of tuple
        (line, target, measured, met, remark); met is None without a target.

    """
    scene = timo_sim.load_scene(PAPER, {'model.modes': 3, 'integrator.step': STEP})
    count, cores, found = 400 if quick else 10_000, len(os.sched_getaffinity(0)), []
    few = variations(96)
    table = timo_sim.simulate_many(scene, few, DURATION)  # and machine code of lanes
    timo_sim.simulate(scene, DURATION, estimate=False)
    start = time.perf_counter()
    # Runs of a sweep are not compared with finer ones either.
    runs = [timo_sim.simulate(scene.vary(values), DURATION, estimate=False) for values in few]
    loop = (time.perf_counter() - start) / len(few)
    assert np.allclose(table['final_shaft'], [run.shaft[-1] for run in runs], rtol=1e-10)
    timo_sim.simulate_many(scene, variations(96, bodies=False), DURATION)
    with LocalCluster(n_workers=cores, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        timo_sim.simulate_many(scene, few, DURATION, scheduler=address)  # imports
        for kind, target in TARGETS.items():
            many, tables = variations(count, kind == 'bodies differ'), []
            for way, scheduler in (f'{cores} cores', None), (f'{cores} workers of Dask', address):
                start = time.perf_counter()
                tables.append(timo_sim.simulate_many(scene, many, DURATION, scheduler=scheduler))
                span = time.perf_counter() - start
                found.append((
                    f'{count} runs of 10 s, N = 3, h = 10 ms, {kind}, {way}',
                    '' if quick else f'{target:g} s', f'{span:.1f} s',
                    None if quick else span <= target,
                    f'a loop over `simulate` takes {1e3 * loop:.1f} ms a run, '
                    f'{loop * count / span:.1f} times as long'))
            assert not any(tables[0]['reason'])
            assert all(np.array_equal(tables[0][name], tables[1][name]) for name in tables[0])
    return found


if __name__ == '__main__':
    quick = parser(__spec__, __doc__, '400 runs').parse_args().quick
    print('| | target | measured | met | |\n|---|---|---|---|---|')
    for row in rows(quick):
        print('| ' + ' | '.join(map(str, row)) + ' |')
