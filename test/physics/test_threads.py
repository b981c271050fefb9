# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Two threads, of a program or of BLAS, give the bits of one."""

from concurrent.futures import ThreadPoolExecutor
import os
import subprocess
import sys
from threading import Barrier

import numpy as np
import pytest

import timo_sim
from timo_sim.scene import scene as scenes

TURNING = {'initial.shaft_velocity': 3.0, 'load.tip_force_x.harmonic.amplitude': [2.0],
           'load.tip_force_x.harmonic.frequency': [1.3]}
SCENES = {
    # Its linear parts by sectors are made while the shaft turns.
    'one axis held': {**TURNING, 'carrier.held': 'x'},
    'dry friction': {**TURNING, 'motor.coulomb_friction': 2.0, 'carrier.coulomb_friction': 1.0},
    # Another model after 0.1 s, in the modes of the first.
    'payload': {**TURNING, 'payload.time': [0.1], 'payload.mass': [3.0], 'payload.inertia': [0.6],
                'end_effector.pick_up': 'at_rest'},
}


def fresh(name):
    """Return a scene whose models nobody has used."""
    scenes._shared_model.cache_clear()
    return timo_sim.load_scene(SCENES[name])


def numbers(scene, begin=lambda: None):
    """Return what runs show, as bytes: of `simulate`, and of short steps under commands."""
    begin()
    run = timo_sim.simulate(scene, 0.2, estimate=False)
    simulator, found = timo_sim.Simulator(scene), [run.values, run.friction_heat]
    for number in range(40):
        simulator.step(tip_force=(0.1 * number, 1.0), duration=0.005)
        found += [simulator.motion.values, simulator.sensors.tip_acceleration, simulator.effort]
    return np.concatenate([np.ravel(each) for each in found]).tobytes()


@pytest.fixture
def hurried():
    """Let threads take turns every microsecond, a thousand times as often as usual."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


@pytest.mark.parametrize('names', [
    *((name, name) for name in SCENES), ('one axis held', 'dry friction')], ids=' and '.join)
def test_threads_give_the_bits_of_one_run_after_the_other(names, hurried):
    first = fresh(names[0])
    both = first, first if names[0] == names[1] else timo_sim.load_scene(SCENES[names[1]])
    start = Barrier(2)
    with ThreadPoolExecutor(2) as pool:
        together = [*pool.map(lambda scene: numbers(scene, start.wait), both)]
    assert together == [numbers(fresh(name)) for name in names]


def test_a_snapshot_is_of_one_step_while_another_thread_advances():
    """A rigid arm that turns freely at 3 rad/s tells the time by its angle."""
    simulator = timo_sim.Simulator({'model.modes': 0, 'initial.shaft_velocity': 3.0})
    start, step = simulator.motion.shaft, simulator.scene.step
    with ThreadPoolExecutor(1) as pool:
        ends = pool.submit(lambda: [simulator.advance(50) for _ in range(1000)])
        while not ends.done():
            seen = simulator.snapshot()
            assert abs(seen.joint_positions[2] - start - 3.0 * seen.step * step) < 1e-6
        ends.result()  # it has raised nothing
    assert 0 < seen.step <= simulator.steps == 50_000


def test_a_batch_shows_one_step_while_other_threads_advance():
    batch, alone = (timo_sim.Batch({'initial.shaft_velocity': 3.0}, n=3) for _ in range(2))
    angles, places = [], [alone.position()[0].tolist()]
    for _ in range(6000):
        angles.append(alone.step().shaft[0])
        places.append(alone.position()[0].tolist())
    with ThreadPoolExecutor(2) as pool:
        ends = [pool.submit(lambda: [batch.step().shaft[0] for _ in range(3000)])
                for _ in range(2)]
        while not all(each.done() for each in ends):
            assert batch.position()[0].tolist() in places
        seen = [shaft for each in ends for shaft in each.result()]
    assert sorted(seen) == sorted(angles)  # each step is shown to the thread that did it


def test_an_observer_shows_one_update_while_another_thread_makes_the_next():
    scene = timo_sim.load_scene({'carrier.held': 'both', 'sensor.encoder.noise': 1e-4})
    observer, alone = (timo_sim.observer(scene) for _ in range(2))
    angle, roots = {'encoder': scene.values['initial.shaft']}, {}
    for _ in range(2000):
        motion = alone.update(angle, {'torque': 1.0})
        roots[motion.values.tobytes()] = alone.covariance.tobytes()
    with ThreadPoolExecutor(1) as pool:
        ends = pool.submit(lambda: [observer.update(angle, {'torque': 1.0}).values.tobytes()
                                    for _ in range(2000)])
        known = {*roots.values(), timo_sim.observer(scene).covariance.tobytes()}
        while not ends.done():
            assert observer.covariance.tobytes() in known
        assert ends.result() == [*roots]


# Prints the constants that machine code gets: nothing else in a step comes from BLAS.
_CONSTANTS = """
import hashlib, timo_sim
for values in ({}, {'model.modes': 11, 'model.static_modes': 'both'},
               {'model.modes': 10, 'model.formulation': 'newton'},
               {'model.modes': 40, 'model.formulation': 'newton'},
               {'model.modes': 40, 'model.static_modes': 'both'},
               *({'model.modes': count, 'arm.length': 2.0, 'arm.profile.position': [0.0, 2.0],
                  'arm.profile.height': [0.1, 0.05]} for count in (10, 16, 40)),
               {'model.axial_modes': 2, 'arm.length': 2.0,  # many spans
                'arm.profile.position': [0.05 * k for k in range(41)],
                'arm.profile.height': [0.1 - 0.04 * (k % 2) for k in range(41)]}):
    model = timo_sim.load_scene('paper', values).build()
    print(hashlib.sha256(model.packed.memory.tobytes() + model.linear.tobytes() + b''.join(
        each.tobytes() for each in model.points)).hexdigest())
"""


def test_bits_do_not_depend_on_the_number_of_blas_threads():
    one, two = (subprocess.run(
        [sys.executable, '-c', _CONSTANTS], check=True, stdout=subprocess.PIPE,
        env={**os.environ, 'OPENBLAS_NUM_THREADS': threads}).stdout for threads in '12')
    assert len(one.split()) == 9
    assert one == two
