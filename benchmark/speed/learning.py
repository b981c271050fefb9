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
from timo_sim.gym import ReachVectorEnv
from timo_sim.gym.reach_vector import SCENE

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
    run = timo_sim.simulate(scene, DURATION, sample_every=every, compare=False)
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
    return table


if __name__ == '__main__':
    quick = parser(__spec__, __doc__, 'only 64 at once').parse_args().quick
    for row in rows(quick):
        print(*row, sep=' | ')
