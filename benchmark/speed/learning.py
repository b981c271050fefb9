# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Steps per second of environments for learning, beside the same arm in other engines.

A step of an environment is 20 ms of one arm on a held carrier. Ours are those of `timo_sim.gym`,
with observations and rewards. The others only integrate, each in the way and at the setting that
is about the cheapest for a tip within a millimetre; all errors of the tip are stated.
"""

import math
import time

import numpy as np

from benchmark.accuracy import rivals
from benchmark.command import parser
from oracles import finite_elements
import timo_sim
from timo_sim.gym import ReachVectorEnv, SCENE

PERIOD, DURATION = 0.02, 2.0
TORQUE = {'load.torque.piecewise.time': [0.0, 0.5, 1.0],
          'load.torque.piecewise.value': [8.0, -8.0, 0.0]}
COUNTS, QUICK_COUNTS = (1, 64, 512), (64,)
LINKS = 5  # of MuJoCo's chain


def environment_rate(count):
    """Return steps of environments per second, with actions, observations, rewards, resets."""
    environments = ReachVectorEnv(count, duration=DURATION)
    environments.reset(seed=1)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (100, count, 1))
    rates = []
    for _ in range(5):
        start = time.perf_counter()
        for each in actions:
            environments.step(each)
        rates.append(count * len(actions) / (time.perf_counter() - start))
    return max(rates)


def tip(scene, **overrides):
    """Return the tip of the torque's run each 20 ms, (n, 2) [m]."""
    scene = scene.vary(overrides)
    every = round(PERIOD / scene.step)
    run = timo_sim.simulate(scene, DURATION, sample_every=every, estimate=False)
    return run.position(scene.manipulator.arm.length)[1:]


def others(scene):
    """Yield name, seconds for the run, and tip each 20 ms of other engines."""
    step = PERIOD / math.ceil(PERIOD / rivals.longest_step(scene, LINKS))
    seconds, theta, _, along, across = rivals.chain(scene, LINKS, step, DURATION,
                                                    round(PERIOD / step))
    yield (f'MuJoCo, {LINKS} hinged links, h = {1e3 * step:.2g} ms', seconds,
           _world(theta, along, across))
    found = finite_elements.simulate(scene, 20, 0.005, DURATION, round(PERIOD / 0.005))
    place = _world(found['theta_rad'], scene.manipulator.arm.length + found['u_l_m'],
                   found['w_l_m'])
    yield 'exudyn, 20 elements, h = 5 ms', found['solver_seconds'], place[1:]


def soft_rods(count=64, order=2, points=6, steps=10):
    """
    Return rate, compile time [s], whether it stays finite, and settings of rods of soromox.

    A batch by vmap, one compiled call for each control period, each in `steps` steps of Tsit5. A
    torque turns each shaft, a joint of its own; the tip carries nothing, unlike ours.
    """
    from benchmark.accuracy import soft_rods as soromox
    import diffrax
    import jax
    import jax.numpy as jnp
    from soromox.systems.components import JointSpec
    scene = timo_sim.load_scene({**SCENE, 'end_effector.mass': 0.0, 'end_effector.inertia': 0.0})
    joint = JointSpec('revolute', axis='z')
    model = soromox.rod(scene, 1, order, points=points, joint=joint)
    rate = soromox.rate_with_shaft(model, scene.values['motor.shaft_inertia'])

    def advance(y, torque):
        term = diffrax.ODETerm(lambda t, y, torque: rate(y, torque))
        return diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, PERIOD, PERIOD / steps, y,
                                   torque).ys[-1]

    step = jax.jit(jax.vmap(advance))
    torques = jnp.array(8.0 * np.random.default_rng(1).uniform(-1.0, 1.0, (100, count)))
    states = jnp.zeros((count, 2 * model.num_velocities))
    start = time.perf_counter()
    step(states, torques[0]).block_until_ready()
    compilation, rates = time.perf_counter() - start, []
    for _ in range(5):
        found, start = states, time.perf_counter()
        for each in torques:
            found = step(found, each)
        found.block_until_ready()
        rates.append(count * len(torques) / (time.perf_counter() - start))
    return (max(rates), compilation, bool(jnp.isfinite(found).all()),
            f'order {order}, h = {1e3 * PERIOD / steps:.2g} ms')


def soft_row(best):
    """Return the row of `soft_rods`, or one that says that soromox is not installed."""
    name = 'rods without a load by soromox (JAX), 64 at once'
    try:
        rate, compilation, finite, settings = soft_rods()
    except ImportError as error:
        return name, '', 'not measured', None, f'{error.name} is not installed'
    return (name, '', f'{rate:,.0f}', None,
            f'{best / rate:.0f} times fewer; {settings}, compiled in {compilation:.1f} s'
            + ('' if finite else '; diverges'))


def _world(theta, along, across):
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.column_stack([cosine * along - sine * across, sine * along + cosine * across])


def rows(quick=False):
    """Return rows of the table, (line, target, measured, met, remark)."""
    scene = timo_sim.load_scene({**SCENE, **TORQUE})
    truth = tip(scene, **{'model.modes': 8, 'integrator.step': 0.0005})
    rates = {count: environment_rate(count) for count in (QUICK_COUNTS if quick else COUNTS)}
    best = max(rates.values())
    error = 1e3 * np.linalg.norm(tip(scene) - truth, axis=1).max()
    table = [(f'steps of environments a second, {count} at once', '', f'{rate:,.0f}', None,
              f'N = 3, h = 5 ms; the tip is within {error:.2g} mm')
             for count, rate in rates.items()]
    for name, seconds, place in others(scene):
        rate = DURATION / PERIOD / seconds
        error = 1e3 * np.linalg.norm(place - truth, axis=1).max()
        table.append((f'the same arm by {name}', '', f'{rate:,.0f}', None,
                      f'{best / rate:.0f} times fewer; the tip is within {error:.2g} mm'))
    table.append(soft_row(best))
    return table


if __name__ == '__main__':
    quick = parser(__spec__, __doc__, 'only 64 at once').parse_args().quick
    for row in rows(quick):
        print(*row, sep=' | ')
