# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Many arms at once: a `Batch`, environments for learning beside other engines, sweeps."""

import math
import os
from statistics import median
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from distributed import LocalCluster
import numpy as np

from benchmark import ROOT
from benchmark.accuracy import rivals
from benchmark.accuracy.links import rigid_links
from benchmark.accuracy.rivals import chain_of, longest_step
from benchmark.speed.step import paper, PAPER, Prepared, STEPS
from benchmark.timing import seconds, timed
from oracles import finite_elements
from oracles.references import world
import timo_sim
from timo_sim.gym import ReachVectorEnv, SCENE
from timo_sim.simulation.simulator import Simulator

# A batch, N = 3, 5 and 10: time of a step and run [s].
LANES, TARGETS = 64, ((3, 0.35e-6), (5, 0.7e-6), (10, 3e-6))
# Learning: a period of control is 20 ms of one arm on a held carrier.
PERIOD, DURATION, LINKS = 0.02, 2.0, 2  # [s], [s], hinges of the chain
TORQUE = {'load.torque.piecewise.time': [0.0, 0.5, 1.0],
          'load.torque.piecewise.value': [8.0, -8.0, 0.0]}
# Sweeps of the paper's 10 s at 10 ms, N = 3: time of 10 000 runs [s]. That of bodies, and those on
# Dask, are withdrawn for what the remarks say.
SWEEPS = {'bodies differ': 6.0, 'loads and states differ': 3.0}


def batch_of(modes, count, alike=True):
    """Return a function that does the paper's 10 s by a batch; or the mass at the tip differs."""
    scenes = [paper(modes=modes)] * count
    if not alike:
        scenes = [scene.vary({'end_effector.mass': mass})
                  for scene, mass in zip(scenes, np.linspace(1.0, 3.0, count))]
    batch = timo_sim.Batch(scenes)

    def run():
        batch.reset()
        batch.advance(STEPS)
    return run


def batches(quick):
    """Return rows (line, target, measured, met, remark) of steps of a `Batch`."""
    found, ratios = [], []
    for modes, target in TARGETS:
        scalar = Prepared(paper(modes=modes)).run
        for alike in (True, False):
            ours, theirs = timed(batch_of(modes, LANES, alike), scalar, units=STEPS, rounds=15)
            span = ours.least / LANES
            ratios.append(f'{LANES * theirs.products / ours.products:.1f}')
            found.append((
                f'a step and run of a batch, N = {modes}' + ', masses differ' * (not alike),
                f'{1e6 * target:g} us',
                f'{1e6 * span:.2g} us (median {1e6 * ours.middle / LANES:.2g})',
                span <= target, f'{LANES} runs'))
    found.append((
        'their speeds over that of the scalar step', '3.5 is withdrawn', ', '.join(ratios), None,
        'the ratio fell because the scalar step became faster; a batch takes as long as before'))
    counts = (8, 64) if quick else (1, 8, 64, 512)
    times = [timed(batch_of(3, count), units=STEPS * count, rounds=15).least for count in counts]
    found.append(('a step and run, N = 3, by number of runs', '', ', '.join(
        f'{count}: {1e6 * span:.2g} us' for count, span in zip(counts, times)), None,
        'a group of lanes has 8; a last group that is not full takes as long'))
    return found


def environment_rate(count):
    """Return steps of environments per second, with actions, observations, rewards, resets."""
    environments = ReachVectorEnv(count, duration=DURATION)
    environments.reset(seed=1)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (100, count, 1))
    return 1.0 / timed(lambda: [environments.step(each) for each in actions],
                       units=count * len(actions), rounds=5).least


def tip(scene, **overrides):
    """Return the tip of the torque's run each 20 ms, (n, 2) [m]."""
    scene = scene.vary(overrides)
    run = timo_sim.simulate(scene, DURATION, round(PERIOD / scene.step), estimate=False)
    return run.position(scene.manipulator.arm.length)[1:]


def _rate(count, step):
    # Periods of control a second of CPU time, with an action for each arm and period.
    actions, spans = np.random.default_rng(1).uniform(-1.0, 1.0, (100, count)), []
    for _ in range(9):
        begun = time.process_time()
        for each in actions:
            step(each)
        spans.append(time.process_time() - begun)
    return actions.size / min(spans)


def own_rate(scene, count):
    """Return the arms' periods of control a second, by a `Batch` or, of one arm, a `Simulator`."""
    arms = timo_sim.Batch(scene, count) if count > 1 else Simulator(scene)
    return _rate(count, lambda torque: arms.step(
        duration=PERIOD, torque=torque if count > 1 else torque[0]))


def narrow_rate(count):
    """Return that of a `Batch` in a new process whose code is for 256 bits, x86-64-v3."""
    code = ('import llvmlite.binding as llvm; llvm.get_host_cpu_name = lambda: "x86-64-v3"; '
            'llvm.get_host_cpu_features = llvm.FeatureMap; from benchmark.speed import many; '
            f'print(many.own_rate(many.arm(), {count}))')
    with TemporaryDirectory() as folder:
        return float(subprocess.run(
            [sys.executable, '-c', code], check=True, cwd=ROOT, capture_output=True, text=True,
            env={**os.environ, 'NUMBA_CACHE_DIR': folder}).stdout.split()[-1])


def mujoco_rate(scene, count):
    """Return that of MuJoCo: of one arm by `mj_step`, of many by its `Batch` on one thread."""
    import mujoco
    from mujoco.batch import Batch

    steps, step = _steps_of(scene)
    model = rivals.chain_model(chain_of(scene, LINKS), step)
    if count > 1:
        batch = Batch(model, count, 1)
        control = batch.bind('ctrl')

        def advance(torque):
            control[:, 0] = torque
            batch.step(nstep=steps)
    else:
        data = mujoco.MjData(model)

        def advance(torque):
            data.ctrl[0] = torque[0]
            mujoco.mj_step(model, data, steps)
    return _rate(count, advance)


def _steps_of(scene):
    steps = math.ceil(PERIOD / longest_step(scene, LINKS))
    return steps, PERIOD / steps


def arm():
    """Return the scene of the environments, with a torque that steps; a step is a period."""
    return timo_sim.load_scene({**SCENE, **TORQUE}, {'integrator.step': PERIOD})


def whole_runs(scene):
    """Yield name, seconds of a run in one compiled call, and the tip each 20 ms."""
    simulator, count = Simulator(scene), round(DURATION / scene.step)
    simulator.warm_up()
    spans = []
    for _ in range(9):
        simulator.reset()
        begun = time.process_time()
        simulator.advance(count)
        spans.append(time.process_time() - begun)
    yield 'timo_sim', min(spans), tip(scene)
    steps, step = _steps_of(scene)
    for name, simulate in (f'MuJoCo, {LINKS} hinged links', rivals.chain), (
            f'{LINKS} hinged links in numba', rigid_links):
        found = [simulate(scene, LINKS, step, DURATION, steps) for _ in range(9)]
        yield name, min(each[0] for each in found), world(*found[0][1:])
    found = finite_elements.simulate(scene, 2, 0.005, DURATION, 4, kind='quadratic')
    place = world(found['theta_rad'], 0.0, scene.manipulator.arm.length + found['u_l_m'],
                  found['w_l_m'])
    yield 'exudyn, 2 quadratic elements, h = 5 ms', found['solver_seconds'], place[1:]


def learning(quick):
    """
    Return rows of the periods of control a second, each of 20 ms, in this and other engines.

    Each is at about the cheapest setting for a tip within a millimetre. Like is beside like: one
    arm that Python calls in each period, whole runs in one call, and batches on one thread; the
    time is that of the processor.
    """
    scene = arm()
    truth = tip(scene, **{'model.modes': 8, 'integrator.step': 0.0005})
    runs = {name: (DURATION / PERIOD / span,
                   f'{1e3 * np.linalg.norm(place - truth, axis=1).max():.2g} mm')
            for name, span, place in whole_runs(scene)}
    own, rival = list(runs)[:2]
    many = 64 if quick else 512
    called = 'one arm, a call in each period'
    rows = [(called, own, own_rate(scene, 1), own),
            (called, f'{rival}, `mj_step`', mujoco_rate(scene, 1), rival),
            *(('one arm, a whole run in a call', name, rate, name)
              for name, (rate, _) in runs.items()),
            (f'{many} arms', f'{own}, `Batch`', own_rate(scene, many), own),
            (f'{many} arms', f'{own}, `Batch` in vectors of 256 bits', narrow_rate(many), own),
            (f'{many} arms', f'{rival}, `mujoco.batch`', mujoco_rate(scene, many), rival)]
    found = [(f'{what}: {name}', '', f'{rate:,.0f}', None, f'the tip is within {runs[key][1]}')
             for what, name, rate, key in rows]
    return found + [(f'steps of environments, {count} at once', '',
                     f'{environment_rate(count):,.0f}', None,
                     'actions, observations, rewards and resets, N = 3, h = 5 ms')
                    for count in ((64,) if quick else (1, 64, 512))]


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


def sweeps(quick):
    """
    Return rows of sweeps that differ in torque and initial speed, or in the mass at the tip, too.

    The time is that of the whole call, start of the processes included, the median of three. The
    peer is a loop over `simulate`.
    """
    scene = timo_sim.load_scene(PAPER, {'model.modes': 3, 'integrator.step': 0.01})
    count, cores, found = 400 if quick else 10_000, len(os.sched_getaffinity(0)), []
    few = variations(96)
    table = timo_sim.simulate_many(scene, few, 10.0)  # compiles
    timo_sim.simulate(scene, 10.0, estimate=False)
    runs = []
    loop = seconds(lambda: runs.extend(timo_sim.simulate(
        scene.vary(values), 10.0, estimate=False) for values in few)) / len(few)
    assert np.allclose(table['final_shaft'], [run.shaft[-1] for run in runs], rtol=1e-10)
    timo_sim.simulate_many(scene, variations(96, bodies=False), 10.0)
    bodies = seconds(lambda: [scene.vary(values) for values in few]) / len(few)
    with LocalCluster(n_workers=cores, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        timo_sim.simulate_many(scene, few, 10.0, scheduler=address)  # imports
        for kind, target in SWEEPS.items():
            many, tables = variations(count, kind == 'bodies differ'), []
            for way, scheduler in (f'{cores} cores', None), (f'{cores} workers of Dask', address):
                begun = time.process_time()
                spans = [seconds(lambda: tables.append(timo_sim.simulate_many(
                    scene, many, 10.0, scheduler=scheduler))) for _ in range(3)]
                span, own = median(spans), (time.process_time() - begun) / len(spans)
                alike = kind != 'bodies differ'
                aimed = alike and not scheduler
                remark = (f'a loop over `simulate` takes {1e3 * loop:.1f} ms a run, '
                          f'{loop * count / span:.1f} times as long')
                if not alike:
                    remark += f'; the set-up of bodies takes {bodies * count / cores:.1f} s of it'
                if scheduler:
                    remark += f'; client and scheduler take {own:.1f} s of the same cores'
                found.append((
                    f'{count} runs of 10 s, N = 3, h = 10 ms, {kind}, {way}',
                    '' if quick else f'{target:g} s' + ' is withdrawn' * (not aimed),
                    f'{span:.1f} s (min {min(spans):.1f})',
                    span <= target if aimed and not quick else None, remark))
            assert not any(tables[0]['reason'])
            for name, column in tables[0].items():  # errors that are not measured are NaN
                np.testing.assert_array_equal(column, tables[-1][name])
    return found
