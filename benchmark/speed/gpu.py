# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures a Batch on a GPU: steps, whole runs, environments.

It first compares bits with the CPU, and prints Markdown tables that name the card. Without a GPU
it says that nothing is measured.
"""

import time

import numpy as np

from benchmark.report import measured_on, parser, table
import timo_sim
from timo_sim.extras import MissingPackage
from timo_sim.gym import ReachVectorEnv
from timo_sim.simulation.cuda import Cuda

STEPS, BODIES = 500, 64  # of a kernel; different masses at the tip, repeated
STEP = {3: 0.02, 5: 0.005}  # by number of modes [s]


def scenes_of(modes, count, alike):
    """Return scenes of the paper's arm with a torque, or each with one of BODIES masses."""
    scene = timo_sim.load_scene('paper', {
        'model.modes': modes, 'integrator.step': STEP[modes],
        'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [1.0]})
    few = [scene] if alike else [scene.vary({'end_effector.mass': mass})
                                 for mass in np.linspace(1.0, 1.5, BODIES)]
    return [few[k % len(few)] for k in range(count)]


def seconds(device, work):
    """Return the least wall time of three calls, after one that compiles [s]."""
    spans = []
    for _ in range(4):
        begun = time.perf_counter()
        work()
        device.xp.cuda.Device().synchronize()
        spans.append(time.perf_counter() - begun)
    return min(spans[1:])


def check(modes, alike):
    """Raise AssertionError unless the GPU gives the bits of the CPU."""
    scenes = scenes_of(modes, 2 * BODIES, alike)
    there, here = (timo_sim.Batch(scenes, device=name) for name in ('cuda', 'cpu'))
    assert (there.advance(STEPS, sample_every=50) == here.advance(STEPS, sample_every=50)).all()


def steps(device, quick):
    """Return the table of the time of a step."""
    rows = []
    for modes in STEP:
        for alike in (True, False):
            check(modes, alike)
            for count in (1024, 65_536) if quick else (1024, 65_536, 2**18, 2**20):
                if alike or count < 2**20:
                    batch = timo_sim.Batch(scenes_of(modes, count, alike), device='cuda')
                    span = seconds(device, lambda: batch.advance(STEPS))
                    rows.append((modes, 'one' if alike else 'each its own', count,
                                 f'{1e9 * span / STEPS / count:.2f}'))
    return table(['modes', 'model', 'arms', 'ns a step and arm'], rows)


def runs(quick):
    """Return the table of whole runs of 10 s, from `Batch(...)` to the tips."""
    rows = []
    for alike, count in (True, 10**6), (False, 10**5):
        scenes = scenes_of(3, count // 100 if quick else count, alike)
        begun = time.perf_counter()
        batch = timo_sim.Batch(scenes, device='cuda')
        made = time.perf_counter()
        batch.advance(500)
        batch.position()
        rows.append((len(scenes), 'one' if alike else f'{BODIES} models',
                     f'{made - begun:.2f}', f'{time.perf_counter() - made:.2f}'))
    return table(['arms', 'model', 'to make the batch [s]', '10 s of all, to the tips [s]'], rows)


def environments(device, quick):
    """Return the table of steps of environments."""
    rows = []
    for count in (1024,) if quick else (1024, 65_536, 10**6):
        envs = ReachVectorEnv(count, device='cuda')
        envs.reset(seed=1)
        actions = np.random.default_rng(1).uniform(-1.0, 1.0, (count, 1)).astype(np.float32)
        rows.append((count, f'{1e3 * seconds(device, lambda: envs.step(actions)):.2f}'))
    return table(['environments', 'ms a step of 20 ms'], rows)


def main():
    """Measure and print Markdown tables."""
    quick = parser(__spec__, __doc__, 'fewer and smaller batches').parse_args().quick
    try:
        device = Cuda()
    except (MissingPackage, timo_sim.ParameterError) as error:
        print(f'not measured: {error}')
        return
    card = device.xp.cuda.runtime.getDeviceProperties(0)['name'].decode()
    print(measured_on(gpu=card, cupy=device.xp.__version__))
    for found in steps(device, quick), runs(quick), environments(device, quick):
        print('\n' + found, flush=True)


if __name__ == '__main__':
    main()
