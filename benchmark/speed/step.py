# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time of a step and of a run: rows of doc/speed.md, and cost against N, n_g and horizon."""

import time

import matplotlib
matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: E402
import numpy as np  # noqa: E402

from benchmark import ROOT  # noqa: E402
from benchmark.command import parser  # noqa: E402
from benchmark.speed.timing import timed  # noqa: E402
from oracles.references import read  # noqa: E402
import timo_sim  # noqa: E402
from timo_sim.compiled.constants import pack  # noqa: E402
from timo_sim.model import formulation_class  # noqa: E402
from timo_sim.steps import etdrk4  # noqa: E402
from timo_sim.steps.etdrk4 import propagator  # noqa: E402

PAPER = ROOT / 'config' / 'paper.yaml'
STEPS = 1000  # of 10 ms
TARGETS = [('exact', 3, 1.5e-6), ('exact', 5, 2.5e-6), ('exact', 10, 8e-6), ('newton', 3, 0.6e-6)]


def paper(**overrides):
    """Return the paper's scene at 10 ms, with values of `model` by name."""
    values = {f'model.{name}': value for name, value in overrides.items()}
    return timo_sim.load_scene(PAPER, {'integrator.step': 0.01, **values})


class Prepared:
    """A formulation of a scene, compiled, and the loads of a run."""

    def __init__(self, scene, steps=STEPS, nodes=None):
        kind = formulation_class(scene.values['model.formulation'])
        self.model = kind(scene.manipulator, scene.values['model.modes'],
                          scene.values['arm.damping_ratio'] or 0.0, scene.constraints, nodes,
                          gravity=scene.values['gravity'])
        self.steps = steps
        self._start = self.model.state(scene.initial_motion())
        self._loads = scene.load.stages(0, steps, scene.step)
        self._remainder = np.empty(len(self._start))
        self._propagator = pack(propagator(self.model.linear, scene.step))

    def run(self, every=0):
        """Do the steps; return motions at the start and after each `every` of them."""
        samples = np.empty((1 + len(self._loads) // every if every else 0, self.model.size))
        etdrk4.advance(self.model.packed, self._propagator, self._start.copy(),
                       self._loads[0, 0], self._loads, every, 0, samples, self._remainder)
        return samples

    def time_of_step(self, rounds=25):
        """Return the time of a step without samples."""
        return timed(self.run, self.steps, rounds)

    def tip_error(self):
        """Return the largest error in w(l) over the paper's 10 s [m]."""
        samples, count = self.run(every=1), len(self.model.modes)
        tip = self.model.at([self.model.manipulator.arm.length])
        deflection = self.model.centre_line(samples[:, 3:3 + count], tip)[:, 0, 1]
        return np.abs(deflection - read('paper')[1]['w_l_m']).max()


def rows(quick=False):
    """Return rows of the table, (line, target, measured, met, remark)."""
    table = []
    for formulation, modes, target in TARGETS:
        prepared = Prepared(paper(formulation=formulation, modes=modes))
        middle = prepared.time_of_step()
        nodes = f', n_g = {len(prepared.model.quadrature.nodes)}' * (formulation == 'exact')
        table.append((f'a step of `{formulation}`, N = {modes}{nodes}', f'{1e6 * target:g} us',
                      middle.shown(), middle.middle <= target,
                      f'w(l) within {prepared.tip_error():.1e} m'))
    return table + run_rows()


def run_rows():
    """Return the rows of a whole run."""
    scene = paper()
    prepared = Prepared(scene)
    compiled = timed(lambda: prepared.run(every=1), 1)
    compared = timed(lambda: timo_sim.simulate(scene, 10.0, estimate=True), 1)
    return [
        ('10 s of the paper, 10 ms, every step sampled', '2 ms', compiled.shown(1e-3, 'ms'),
         compiled.middle <= 2e-3, 'the compiled part'),
        ('the same, compared with a second, finer run', '', compared.shown(1e-3, 'ms'), None,
         'what `simulate` does by itself with runs that are in doubt')]


def exponent(x, y):
    """Return the slope of a straight line through the logarithms."""
    return np.polyfit(np.log(x), np.log(y), 1)[0]


def run_time(horizon):
    """Return the time of a run of the paper's scene with a sample every second [s]."""
    scene, start = paper(), time.perf_counter()
    timo_sim.simulate(scene, horizon, sample_every=100, estimate=False)
    return time.perf_counter() - start


def curves(path, quick=False):
    """Draw the cost over N, n_g and the length of a run; return rows of exponents."""
    modes = np.array([1, 3, 10, 14] if quick else [1, 2, 3, 4, 5, 6, 8, 10, 14, 20, 28, 40])
    over_modes = np.array([Prepared(paper(modes=int(n)), 200).time_of_step(25).least
                           for n in modes])
    nodes = np.array([6, 16] if quick else [6, 8, 12, 16, 24, 32, 48])
    over_nodes = np.array([Prepared(paper(), 200, int(g)).time_of_step(25).least for g in nodes])
    horizons = np.array([1, 10, 100] if quick else [1, 3, 10, 30, 100, 300, 1000, 3000])
    over_horizon = np.array([run_time(float(horizon)) for horizon in horizons])

    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
    for axis, x, y, label, unit in (
            (axes[0], modes, 1e6 * over_modes, 'modes N', 'least time of a step [us]'),
            (axes[1], nodes, 1e6 * over_nodes, 'quadrature nodes, N = 3',
             'least time of a step [us]'),
            (axes[2], horizons, over_horizon, 'sim time [s], h = 10 ms',
             'time of a run [s]')):
        axis.loglog(x, y, 'o-', color='#0072B2')
        axis.set_xlabel(label)
        axis.set_ylabel(unit)
        axis.grid(alpha=0.3, which='both')
        axis.set_xticks(x[::2], [f'{value:g}' for value in x[::2]])
        axis.set_xticks([], minor=True)
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
        axis.yaxis.set_minor_formatter(NullFormatter())
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
    few, many, half = modes <= 5, modes >= 10, len(nodes) // 2
    return [
        ('modes, N <= 5', f'{exponent(modes[few], over_modes[few]):.2f}',
         'latency: a step is a chain of four rates, each one of sines, a kernel, a factorisation'),
        ('modes, N >= 10', f'{exponent(modes[many], over_modes[many]):.2f}',
         'the kernel takes N n_g^2 = O(N^3) operations, M and its factor too, the nine products '
         'of the step O(N^2)'),
        ('nodes, the larger half', f'{exponent(nodes[half:], over_nodes[half:]):.2f}',
         'the kernel takes n_g^2 for each mode, everything else n_g'),
        ('sim time', f'{exponent(horizons[-3:], over_horizon[-3:]):.2f}',
         'every step costs the same; samples are streamed in blocks')]


if __name__ == '__main__':
    parser(__spec__, __doc__).parse_args()
    for row in rows():
        print(*row, sep=' | ')
