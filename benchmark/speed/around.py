# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Times what surrounds the steps of a run: set-up, estimates, result and the first compilation."""

import os
import subprocess
import sys
import tempfile

import numpy as np

from benchmark.command import parser
from benchmark.speed.clocks import clocks
from benchmark.speed.step import paper, Prepared
from benchmark.speed.timing import timed
import timo_sim
from timo_sim.model.formulation import Formulation
from timo_sim.model.modes import UniformModes
from timo_sim.scene import scene as scenes
from timo_sim.simulation.simulator import Simulator

# A run of the paper's scene, then one of another size, with no machine code at the start.
FIRST = """
import time
from numba.core import event
import timo_sim

for modes in (3, 4):
    with event.install_timer('numba:compile', print):
        begun = time.perf_counter()
        timo_sim.simulate(timo_sim.load_scene('paper', {'model.modes': modes}), 0.01,
                          estimate=False)
        print(time.perf_counter() - begun)
"""
BLOCK = 40  # variations or runs that are timed together
TARGETS = {'loads': 0.1e-3, 'masses': 0.5e-3, 'simulate': 0.3e-3, 'compilation': 5.0}  # [s]


def varied(scene, values, rounds):
    """Time variations of a scene, each with other values, `BLOCK` at a time."""
    rest = iter(values)
    return timed(lambda: [scene.vary(next(rest)) for _ in range(BLOCK)], BLOCK, rounds)


def first_runs():
    """
    Return the times of the first runs of two sizes, in a process without machine code [s].

    Each is followed by the part of it that numba needs to compile.
    """
    with tempfile.TemporaryDirectory() as folder:
        output = subprocess.run(
            [sys.executable, '-c', FIRST], check=True, text=True, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, env={**os.environ, 'NUMBA_CACHE_DIR': folder}).stdout
    return [float(line) for line in output.split()]


def rows(quick=False):
    """Return rows of the table, (line, target, measured, met, remark)."""
    scene, random = paper(), np.random.default_rng(1)
    rounds = 5 if quick else 25
    number = BLOCK * (1 + rounds)  # a block comes first that is not timed

    def masses_of():
        return [{'end_effector.mass': value} for value in random.uniform(0.5, 5.0, number)]

    def loads_of():
        return [{'load.torque.harmonic.amplitude': [value], 'initial.shaft_velocity': value}
                for value in random.uniform(1.0, 8.0, number)]

    loads = varied(scene, loads_of(), rounds)
    with clocks(rules=(scenes, 'check', 'check_counts', 'check_initial'),
                load=(scenes, 'load_of'), motion=(scenes, 'initial_motion')) as few:
        varied(scene, loads_of(), rounds)
    few = {name: 1e3 * span / number for name, span in few.items()}  # [ms] a run
    masses = varied(scene, masses_of(), rounds)
    with clocks(modes=(UniformModes, '__init__'), model=(Formulation, '__init__')) as anew:
        varied(scene, masses_of(), rounds)
    anew = {name: 1e3 * span / number for name, span in anew.items()}  # [ms] a run
    prepared = Prepared(scene)
    steps = timed(lambda: [prepared.run(every=1) for _ in range(BLOCK)], BLOCK, rounds)
    whole = timed(lambda: [timo_sim.simulate(scene, 10.0, estimate=False) for _ in range(BLOCK)],
                  BLOCK, rounds)
    with clocks(begin=(Simulator, '__init__')) as parts:
        for _ in range(BLOCK):
            timo_sim.simulate(scene, 10.0, estimate=False)
    own, least = whole.middle - steps.middle, whole.least - steps.least
    everything, compiled, further, again = first_runs()
    return [
        ('set-up of a run that differs in loads and initial motion', '0.1 ms',
         loads.shown(1e-3, 'ms'), loads.middle <= TARGETS['loads'],
         f'`Scene.vary`; the loads take {few["load"]:.3f} ms of it, the initial motion '
         f'{few["motion"]:.3f} ms, the rules of the values {few["rules"]:.3f} ms'),
        ('set-up of a run that differs in masses', '0.5 ms', masses.shown(1e-3, 'ms'),
         masses.middle <= TARGETS['masses'],
         f'`Scene.vary`; modes, made anew, take {anew["modes"]:.2f} ms of it, tables '
         f'{anew["model"] - anew["modes"]:.2f} ms'),
        ('`simulate` of a checked scene, beside its steps', '0.3 ms',
         f'{1e3 * own:.2f} ms (min {1e3 * least:.2f})', own <= TARGETS['simulate'],
         f'10 s at 10 ms, every step sampled; the `Simulator` takes '
         f'{1e3 * parts["begin"] / BLOCK:.2f} ms of it, the rest are loads, samples and the Run'),
        ('first run of a size', '5 s', f'{further:.1f} s', further <= TARGETS['compilation'],
         f'N = 4, with no machine code of that size: numba compiles for {again:.1f} s; the very '
         f'first run, N = 3, {everything:.1f} s, of which {compiled:.1f} s')]


if __name__ == '__main__':
    quick = parser(__spec__, __doc__, 'fewer repetitions').parse_args().quick
    for row in rows(quick):
        print(*row, sep=' | ')
