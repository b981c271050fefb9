# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Measures the time that simple scenes save: a table of doc/speed.md."""

import time

from benchmark.command import parser
from benchmark.speed.step import PAPER, Prepared
from benchmark.speed.timing import timed
import timo_sim
from timo_sim.runs.accuracy import choose_resolution
from timo_sim.simulation.simulator import Simulator

STEPS = 1000
LEAVING_OUT = [  # name, how, parameters without it, and with it
    ('held carrier', 'its coordinates and momenta are struck out of state and matrices',
     {'carrier.held': 'both'}, {}),
    ('locked shaft', 'its coordinate and momentum are struck out', {'motor.shaft': 'locked'},
     {}),
    ('rigid arm', 'no modes: the state is that of the rigid body', {'model.modes': 0}, {}),
    ('no damping', 'damping is in the matrices of the step: nothing is left to skip; the saving '
     'is over `arm.damping_ratio: [0.01]`', {}, {'arm.damping_ratio': [0.01]}),
    ('no gravity', 'the weight is two constants of the model: nothing is left to skip', {},
     {'gravity': [0.0, -9.81]}),
]


def time_of_step(overrides):
    """Return the time of a step of the paper's scene with other parameters."""
    scene = timo_sim.load_scene(PAPER, {'integrator.step': 0.01, **overrides})
    return Prepared(scene, STEPS).time_of_step(15)


def rows():
    """Return (what, how, time of a step, saved) for each."""
    table = [('nothing', '', time_of_step({}).shown(), '')]
    for name, how, without, given in LEAVING_OUT:
        lean, base = time_of_step(without), time_of_step(given)
        table.append((name, how, lean.shown(), saved(lean.products, base.products)))
    return table + [rest_row(), accuracy_row()]


def saved(lean, full):
    """Return a saving as text."""
    return f'{100.0 * (1.0 - lean / full):.0f} %'


def rest_row():
    """Return the row of a scene at rest: the time of `advance` over 1000 steps."""
    still, moving = (Simulator(timo_sim.load_scene(values)) for values in (
        {}, {'initial.shaft_velocity': 0.1}))
    times = []
    for simulator in (still, moving):
        simulator.warm_up()
        times.append(timed(lambda: simulator.advance(STEPS), STEPS, 15))
    return ('at rest, no load', 'time advances, no step is computed until a command comes',
            times[0].shown(), saved(times[0].products, times[1].products))


def accuracy_row():
    """Return the row of `model.accuracy`: the time of 10 s against 5 modes at 1 ms."""
    lean = choose_resolution(timo_sim.load_scene(PAPER, {'model.accuracy': 1e-3})).scene
    full = timo_sim.load_scene(PAPER, {'model.modes': 5})
    times = []
    for scene in (lean, full):
        timo_sim.simulate(scene, 10.0, estimate=False)
        start = time.perf_counter()
        timo_sim.simulate(scene, 10.0, estimate=False)
        times.append(time.perf_counter() - start)
    values = lean.values
    return ('modes and steps beyond `model.accuracy`',
            f'1 mm on the paper\'s scene: N = {values["model.modes"]} at '
            f'{1e3 * lean.step:g} ms instead of N = 5 at 1 ms',
            f'{1e3 * times[0]:.1f} ms for 10 s instead of {1e3 * times[1]:.1f}',
            saved(times[0], times[1]))


if __name__ == '__main__':
    parser(__spec__, __doc__).parse_args()
    for row in rows():
        print(' | '.join(row))
