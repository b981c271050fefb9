# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What surrounds the steps, from a file to a result: processor times, the least of many calls."""

import itertools
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
import warnings

import numpy as np

from benchmark import ROOT
from benchmark.accuracy import fits
from benchmark.process import ENVIRONMENT, install, processor_time
import timo_sim
from timo_sim.steps.steps import matrices_of

PAPER = ROOT / 'config' / 'paper.yaml'
DURATION = 10.0  # of runs [s]
COLD = 'import timo_sim; timo_sim.simulate(timo_sim.load_scene({!r}, {}), 10.0)'
_UNUSED = itertools.count(1)


def settings(modes=3, step=0.02):
    """Return overrides of the paper's scene with a body that nothing has been computed for."""
    return {'model.modes': modes, 'integrator.step': step,
            'arm.density': 2700.0 * (1.0 + 1e-13 * next(_UNUSED))}


def least(work, *given, count=50):
    """Return the least processor time [s] of a call with what functions give; one compiles."""
    spans = []
    for _ in range(count + 1):
        values = [each() for each in given]
        begun = time.process_time()
        work(*values)
        spans.append(time.process_time() - begun)
    return min(spans[1:])


def loading():
    """Load the paper's scene from its file, and from its values."""
    values = dict(timo_sim.load_scene(PAPER).values)
    yield ('`load_scene` of config/paper.yaml', least(timo_sim.load_scene, lambda: PAPER),
           f'from a dict of its values {1e3 * least(timo_sim.load_scene, lambda: values):.2g} ms')


def simulated(modes, step=0.02):
    """Simulate a new body with its measured error, and without."""
    def scene():
        return timo_sim.load_scene(PAPER, settings(modes, step))
    whole = least(lambda each: timo_sim.simulate(each, DURATION), scene)
    alone = least(lambda each: timo_sim.simulate(each, DURATION, estimate=False), scene)
    yield (f'`simulate` of a loaded scene, 10 s, N = {modes}, {1e3 * step:g} ms', whole,
           f'{1e3 * alone:.2g} ms without its error: {whole / alone:.1f} times as long with it')


def estimated():
    """Simulate scenes whose errors cost more than usual to measure, with and without."""
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    for what, source, values in (
            ('dry friction', 'paper', {'motor.coulomb_friction': 0.5}),
            ('a table that bends inside of steps', 'paper', {
                'load.torque.table.time': [0.0, 0.9996, 10.0],
                'load.torque.table.value': [0.0, 2.0, 0.0]}),
            ('a warning', 'paper', {'initial.shaft_velocity': 20.0}),
            ('a load that is picked up', 'pick_and_place', {})):
        scene = timo_sim.load_scene(source, values)
        whole = least(lambda: timo_sim.simulate(scene, DURATION), count=3)
        alone = least(lambda: timo_sim.simulate(scene, DURATION, estimate=False), count=3)
        yield (f'`simulate` of a scene that has run, {what}', whole,
               f'{1e3 * alone:.2g} ms without its error: {whole / alone:.0f} times as long')


def varied():
    """Change a scene that has run: its tip mass, or its loads, and simulate it again."""
    scene, random = timo_sim.load_scene(PAPER, settings()), np.random.default_rng(1)
    timo_sim.simulate(scene, DURATION)
    warnings.simplefilter('ignore', timo_sim.ModelWarning)  # some of these arms stretch

    def mass():
        return {'end_effector.mass': random.uniform(0.5, 5.0)}

    def loads():
        return {'load.torque.harmonic.amplitude': [random.uniform(1.0, 8.0)],
                'initial.shaft_velocity': random.uniform(1.0, 8.0)}
    for name, change in ('another tip mass', mass), ('other loads and another speed', loads):
        alone = least(scene.vary, change)
        yield (f'the same, `vary` and `simulate` with {name}, N = 3',
               least(lambda each: timo_sim.simulate(scene.vary(each), DURATION), change),
               f'`vary` alone {1e3 * alone:.2g} ms')


def from_the_file():
    """Load a file and simulate its scene, a new body."""
    yield ('file to result: `load_scene` and `simulate`, 10 s, N = 3, 20 ms', least(
        lambda each: timo_sim.simulate(timo_sim.load_scene(PAPER, each), DURATION), settings), '')


def propagators(modes):
    """Compute the matrices of a step with an axial mode."""
    model = timo_sim.load_scene(PAPER, {'model.modes': modes, 'model.axial_modes': 1}).build()
    yield (f'propagator, N = {modes} and an axial mode',
           least(lambda: matrices_of(model.linear, 0.02)), '')


def saving(quick):
    """Write runs as logs, and open one."""
    scene = timo_sim.load_scene(PAPER, {'integrator.step': 0.001})
    few, many = (timo_sim.simulate(scene, 0.001 * count - 0.001, estimate=False)
                 for count in (10_000, 10_000 if quick else 300_000))
    with TemporaryDirectory() as folder:
        yield ('`Run.save` as a log, 10 000 samples',
               least(few.save, lambda: Path(folder, f'{next(_UNUSED)}.mcap'), count=3), '')
        path = many.save(Path(folder, 'many.mcap'))
        size = 1e-6 * path.stat().st_size
        span = least(timo_sim.open_log, lambda: path, count=3)
        yield (f'`open_log`, {size:.3g} MB', span,
               f'{len(many.t)} samples; {1e3 / size * span:.2g} s for a GB at this rate')


def fitted(quick):
    """Fit a made record."""
    made = fits.record(0, DURATION)
    span = least(lambda: fits.quiet(timo_sim.fit, fits.guess(), made, fits.FREE),
                 count=1 if quick else 5)
    yield f'`fit` of {len(fits.FREE)} parameters to 10 s at 500 Hz', span, ''


def first(quick):
    """Start processes of an installation, each without machine code of its own on disk."""
    with TemporaryDirectory() as folder:
        building = install(folder, *['editable'] * quick)

        def started(code):
            with TemporaryDirectory() as cache:
                return processor_time(lambda: subprocess.run(
                    [sys.executable, '-c', code], check=True, cwd=folder,
                    env={**ENVIRONMENT, 'PYTHONPATH': folder, 'NUMBA_CACHE_DIR': cache}))
        for name, *scene in (("the paper's scene", 'paper', {}),
                             ('that of `timo_sim new`', 'arm', {}),
                             ('N = 9, of which no machine code is there', 'paper',
                              {'model.modes': 9})):
            yield (f'first result of a process, {name}',
                   min(started(COLD.format(*scene)) for _ in range(2 if quick else 5)),
                   'imports, file, `simulate` of 10 s')
    if not quick:
        yield 'machine code of an installation', building, 'all processes of the build'


def rows(quick):
    """Return rows (line, processor time, remark)."""
    parts = (loading(), simulated(3), simulated(5), simulated(5, 0.005), estimated(), varied(),
             from_the_file(), propagators(3), propagators(5), saving(quick), fitted(quick),
             first(quick))
    return [(line, f'{span:.2g} s' if span >= 0.1 else f'{1e3 * span:.2g} ms', remark)
            for part in parts for line, span, remark in part]
