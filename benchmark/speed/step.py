# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Time of a step, of a run and of what surrounds it; cost against N, n_g and horizon."""

import ctypes
import itertools
from pathlib import Path
import shutil
import subprocess
import tempfile
from xml.etree import ElementTree
import zipfile

from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
import numpy as np

from benchmark import ROOT
from benchmark.drawing import BLUE, save, sheet
from benchmark.report import table
from benchmark.timing import seconds, timed
from oracles.references import read
import timo_sim
from timo_sim.compiled.constants import pack
from timo_sim.model import formulation_class
from timo_sim.model.layout import LOADS
from timo_sim.simulation.loads import unit_loads
from timo_sim.steps import etdrk4
from timo_sim.steps.bristles import MEMORY
from timo_sim.steps.derivatives import step_derivatives
from timo_sim.steps.steps import matrices_of, Steps

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
        self._advance = etdrk4.advance.of(
            self.model.packed, pack(matrices_of(self.model.linear, scene.step)),
            Steps(self.model, scene.step).bristles)

    def run(self, every=0):
        """Do the steps; return motions at the start and after each `every` of them."""
        samples = np.empty((1 + len(self._loads) // every if every else 0, self.model.size))
        self._advance(np.zeros(MEMORY), self._start.copy(), self._loads[0, 0], self._loads,
                      len(self._loads), every, 0, samples, np.zeros(len(samples)))
        return samples

    def time_of_step(self):
        """Return the time of a step without samples."""
        return timed(self.run, units=self.steps)

    def tip_error(self):
        """Return the largest error in w(l) over the paper's 10 s [m]."""
        samples, count = self.run(every=1), len(self.model.modes)
        tip = self.model.at([self.model.manipulator.arm.length])
        deflection = self.model.centre_line(samples[:, 3:3 + count], tip)[:, 0, 1]
        return np.abs(deflection - read('paper')[1]['w_l_m']).max()


def rows():
    """Return rows (line, target, measured, met, remark) of steps and of a whole run."""
    found = []
    for formulation, modes, target in TARGETS:
        prepared = Prepared(paper(formulation=formulation, modes=modes))
        time = prepared.time_of_step()
        nodes = f', n_g = {len(prepared.model.quadrature.nodes)}' * (formulation == 'exact')
        found.append((f'a step of `{formulation}`, N = {modes}{nodes}', f'{1e6 * target:g} us',
                      time.shown(), time.middle <= target,
                      f'w(l) within {prepared.tip_error():.1e} m'))
    scene = paper()
    prepared = Prepared(scene)
    compiled = timed(lambda: prepared.run(every=1), units=1)
    return [*found, exported(), in_an_fmu(), differentiated(), observed(), (
        '10 s of the paper, 10 ms, every step sampled', '2 ms', compiled.shown(1e-3, 'ms'),
        compiled.middle <= 2e-3, 'the compiled part')]


def exported():
    """Return the row of a step in C, beside one of `Simulator.advance`."""
    name = 'a step of `exact`, N = 3, in C by `export-c`'
    if shutil.which('cc') is None:
        return name, '', 'no C compiler', None, ''
    scene, simulator = paper(), timo_sim.Simulator(paper())
    with tempfile.TemporaryDirectory() as folder:
        shared = Path(timo_sim.export_c(scene, folder), 'libarm.so')
        subprocess.run(['cc', '-shared', '-o', shared, Path(folder, 'arm.o')], check=True)
        library = ctypes.CDLL(str(shared))
    library.arm_size.restype = ctypes.c_size_t
    size = library.arm_size()
    memory = (ctypes.c_double * (size // 8))()
    assert library.arm_create(memory, ctypes.c_size_t(size)) == 0
    count, single = ctypes.c_int64(STEPS), ctypes.c_int64(1)
    assert library.arm_step(memory, single) == 0
    value = ctypes.c_double()
    assert library.arm_get_output(memory, 3, ctypes.byref(value)) == 0
    simulator.advance(1)
    assert abs(value.value - simulator.motion.shaft) < 1e-15  # the same up to a sine of the load
    in_c, together = timed(lambda: library.arm_step(memory, count),
                           lambda: simulator.advance(STEPS), units=STEPS)
    one, commanded = timed(lambda: [simulator.advance(1) for _ in range(STEPS)],
                           lambda: [simulator.step(torque=0.0) for _ in range(STEPS)], units=STEPS)
    return (name, '', in_c.shown(1e-9, 'ns'), None,
            f'`Simulator.advance`: {1e9 * together.middle:.0f} ns for each of {STEPS} steps at '
            f'once, {1e9 * one.middle:.0f} ns for one at a time, {1e9 * commanded.middle:.0f} ns '
            'for `Simulator.step` with a torque')


def in_an_fmu():
    """Return the row of a step in an FMU of FMI 3.0, beside one of `Simulator.advance`."""
    name = 'a step of `exact`, N = 3, in an FMU by `export-fmu`'
    if shutil.which('cc') is None:
        return name, '', 'no C compiler', None, ''
    scene, simulator = paper(), timo_sim.Simulator(paper())
    with tempfile.TemporaryDirectory() as folder:
        path = timo_sim.export_fmu(scene, Path(folder, 'paper.fmu'), estimate=False)
        with zipfile.ZipFile(path) as file:
            file.extractall(folder)
        token = ElementTree.parse(Path(folder, 'modelDescription.xml')).getroot().get(
            'instantiationToken')
        library = ctypes.CDLL(str(*Path(folder).glob('binaries/*/*.so')))
    library.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
    nothing, flags = ctypes.c_void_p(), [ctypes.c_bool() for _ in range(3)]
    instance = ctypes.c_void_p(library.fmi3InstantiateCoSimulation(
        b'arm', token.encode(), None, False, False, False, False, None, ctypes.c_size_t(0),
        nothing, nothing, nothing))
    times, last = itertools.count(), ctypes.c_double()
    assert library.fmi3EnterInitializationMode(
        instance, False, ctypes.c_double(), ctypes.c_double(), False, ctypes.c_double()) == 0
    assert library.fmi3ExitInitializationMode(instance) == 0
    size = STEPS * scene.step

    def step():
        assert library.fmi3DoStep(
            instance, ctypes.c_double(next(times) * size), ctypes.c_double(size), True,
            *map(ctypes.byref, flags), ctypes.byref(last)) == 0
    in_an_fmu, together = timed(step, lambda: simulator.advance(STEPS), units=STEPS)
    return (name, '', in_an_fmu.shown(1e-9, 'ns'), None,
            f'`Simulator.advance`: {1e9 * together.middle:.0f} ns; both {STEPS} steps at once')


def differentiated():
    """Return the row of the derivatives of a step, beside the step."""
    scene, count = paper(), 1000
    simulator = timo_sim.Simulator(scene)
    unit = unit_loads(scene.values, ['force', 'torque'])
    state, loads = simulator.model.state(simulator.motion.values), np.zeros((count, 4, LOADS))
    steps, none = simulator.integration, simulator.integration.samples(0, 0)
    found, alone = timed(
        lambda: step_derivatives(steps, state, simulator.load, loads, unit),
        lambda: steps.advance(state.copy(), simulator.load, loads, none), units=count)
    ratio = found.middle / alone.middle
    return ('derivatives of a step of `exact`, N = 3, by its motion and 3 inputs', '10 steps',
            found.shown(), ratio <= 10.0, f'as long as {ratio:.1f} steps')


def observed():
    """Return the row of an observer of an arm on a bench, which sees encoder and strain gauge."""
    scene, count = paper().vary({'carrier.held': 'both', 'sensor.encoder.noise': 1e-4,
                                 'sensor.root_strain.noise': 1e-6}), 100
    observer = timo_sim.observer(scene, sensors=['encoder', 'root_strain'])
    shown = {name: float(observer.expected(name)[0]) for name in ('encoder', 'root_strain')}
    time = timed(lambda: [observer.update(shown, {'torque': 0.0}, scene.step)
                          for _ in range(count)], units=count)
    return ('an update of an observer, N = 3, by encoder and strain gauge', '30 us', time.shown(),
            time.middle <= 30e-6, 'one step of 10 ms, its derivatives, and the correction')


def exponent(x, y):
    """Return the slope of a straight line through the logarithms."""
    return f'{np.polyfit(np.log(x), np.log(y), 1)[0]:.2f}'


def least_of_step(runs):
    """Return the least time of a step of each Prepared, which take turns, shape (n,) [s]."""
    return np.array([each.least for each in timed(*(run.run for run in runs),
                                                  units=runs[0].steps)])


def curves(quick):
    """Return a table of exponents of the cost over N, n_g and the length of a run; draw it."""
    modes = np.array([1, 3, 10, 14] if quick else [*range(1, 9), 10, 14, 20, 28, 40])
    runs = [Prepared(paper(modes=int(n)), 200) for n in modes]
    over_modes = least_of_step(runs)
    nodes = np.array([6, 16] if quick else [6, 8, 12, 16, 24, 32, 48])
    over_nodes = least_of_step([Prepared(paper(), 200, int(g)) for g in nodes])
    horizons = np.array([1, 10, 100] if quick else [1, 3, 10, 30, 100, 300, 1000, 3000])
    # In turns: a slow while of the machine is one of all horizons.
    over_horizon = np.min([[seconds(lambda: timo_sim.simulate(
        paper(), float(horizon), sample_every=100, estimate=False)) for horizon in horizons]
        for _ in range(5)], axis=0)
    if not quick:
        _draw((modes, 1e6 * over_modes, 'modes N', 'time of a step [us]'),
              (nodes, 1e6 * over_nodes, 'quadrature nodes, N = 3', 'time of a step [us]'),
              (horizons, over_horizon, 'sim time [s], h = 10 ms', 'time of a run [s]'))
    few, many, half = modes <= 5, modes >= 10, len(nodes) // 2
    plain = table(['N', 'nodes', 'least time of a step'], [
        (n, len(run.model.quadrature.nodes), f'{1e6 * time:.2f} us')
        for n, run, time in zip(modes, runs, over_modes) if n <= 10])
    exponents = table(['', 'exponent', 'why'], [
        ('modes, N <= 5', exponent(modes[few], over_modes[few]),
         'latency: a step is a chain of four rates, each one of sines, a kernel, a factorisation'),
        ('modes, N >= 10', exponent(modes[many], over_modes[many]),
         'the kernel takes N n_g^2 = O(N^3) operations, M and its factor too, the nine products '
         'of the step O(N^2)'),
        ('nodes, the larger half', exponent(nodes[half:], over_nodes[half:]),
         'the kernel takes n_g^2 for each mode, everything else n_g'),
        ('sim time', exponent(horizons[-3:], over_horizon[-3:]),
         'every step costs the same; samples are streamed in blocks')])
    return f'![Cost](speed/cost.png)\n\n{plain}\n\n{exponents}'


def _draw(*panels):
    figure, axes = sheet(1, 3, 3.2)
    for axis, (x, y, label, unit) in zip(axes, panels):
        axis.loglog(x, y, 'o-', color=BLUE)
        axis.set(xlabel=label)
        axis.set_title(unit, loc='left')
        axis.grid(alpha=0.3, which='both')
        axis.set_xticks(x[::2], [f'{value:g}' for value in x[::2]])
        axis.set_xticks([], minor=True)
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
        axis.yaxis.set_minor_formatter(NullFormatter())
    save(figure, 'speed/cost')
