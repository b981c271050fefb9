# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What `work_precision.py` measures: scenes with a reference, and methods with their settings."""

from dataclasses import dataclass, field
import math
import statistics
import time
from typing import Any, Callable

import exudyn
import numpy as np

from benchmark import ROOT
from benchmark.accuracy import rivals
from oracles import finite_elements, floating_frame, peers
from oracles.references import CANTILEVER, read, spin_up, TORQUE, world
import timo_sim
from timo_sim.model import FORMULATIONS
from timo_sim.simulation.simulator import Simulator

OWN = tuple(FORMULATIONS)
ENGINE, REDUCED = 'exudyn, geometrically exact', 'exudyn, reduced floating frame'
CHAIN, ROD, DISCRETE, SOFT = (
    'MuJoCo, hinged links', 'PyElastica', 'dismech-newton', 'soromox')


@dataclass
class Scene:
    """A scene with its reference."""

    name: str
    title: str
    source: Any         # for `load_scene`
    duration: float     # [s]
    period: float       # of the reference [s]
    drive: tuple | None  # of the shaft: angle, speed, acceleration as functions of time
    arm: str            # of the reference, in words
    goals: tuple = (1e-3, 1e-4, 1e-5)  # errors in the tip deflection to be reached [m]
    columns: dict = field(default_factory=dict)

    def load(self, overrides=None):
        """Return the scene with overrides by dotted name."""
        return timo_sim.load_scene(self.source, overrides)

    @property
    def held(self):
        """Whether the carrier is held and the shaft driven or locked."""
        return 'theta_rad' not in read(self.name)[1]

    @property
    def length(self):
        """Length of the arm [m]."""
        return self.load().manipulator.arm.length


SCENES = [
    Scene('paper', "the paper's scene, Table 4, 10 s", ROOT / 'config' / 'paper.yaml', 10.0,
          0.01, None, 'that stretches (E A of its section)'),
    Scene('torque', 'torque steps, +20, -20, 0 N m, 5 s', TORQUE, 5.0, 0.01, None,
          'that stretches (E A of its section)'),
    Scene('spin_up', 'spin-up of a 10 m arm, 20 s', ROOT / 'config' / 'spin_up.yaml', 20.0, 0.02,
          spin_up(), 'that does not stretch'),
    Scene('cantilever', 'a clamped 10 m arm let go under its weight, 3 s', CANTILEVER, 3.0, 0.02,
          None, 'that stretches (E A of its section)', (1e-2, 1e-3, 1e-4)),
]


@dataclass
class Case:
    """A method with its settings: what to run, and what came out."""

    method: str
    settings: str
    run: Callable    # () -> (seconds, function() -> dict of columns), or None if it diverges
    order: tuple = ()
    times: list = field(default_factory=list)
    errors: dict | None = None

    @property
    def seconds(self):
        """Median time [s]."""
        return statistics.median(self.times)


def tip_columns(theta, carrier, along, across):
    """Return what is compared, by name: theta [rad], tip deflection and tip position [m]."""
    return {'theta': theta, 'w_l': across, 'tip': world(theta, carrier, along, across)}


def of_motions(model, scene, motions):
    """Return `tip_columns` of motions, shape (n, 2 (3 + N))."""
    tip = model.at([scene.length])
    count = len(model.modes)
    place = model.centre_line(motions[:, 3:3 + count], tip)[:, 0]
    return tip_columns(motions[:, 2], motions[:, :2], *place.T)


def of_reference(scene):
    """Return the comment of the stored reference, and its `tip_columns`."""
    comment, stored = read(scene.name)
    theta = stored.get('theta_rad')
    carrier = np.zeros((len(stored['t']), 2))
    if theta is None:
        theta = np.array([scene.drive[0](t) if scene.drive else 0.0 for t in stored['t']])
    else:
        carrier = np.column_stack([stored['x_c_m'], stored['y_c_m']])
    return comment, tip_columns(theta, carrier, scene.length + stored['u_l_m'], stored['w_l_m'])


def errors_of(columns, truth, stride):
    """Return the largest and root mean square differences from each stride-th reference sample."""
    result = {}
    for name, values in columns.items():
        difference = values - truth[name][stride::stride][:len(values)]
        size = np.abs(difference) if difference.ndim == 1 else np.hypot(*difference.T)
        result[name] = float(size.max())
        result[f'{name}_rms'] = float(np.sqrt(np.mean(size**2)))
    return result


def own_case(scene, formulation, modes, step):
    """Return a case of this package."""
    period = max(scene.period, step)
    simulator = Simulator(scene.load({
        'model.formulation': formulation, 'model.modes': modes, 'integrator.step': step}))
    simulator.warm_up()

    def run():
        simulator.reset()
        steps, every = round(scene.duration / step), round(period / step)
        start = time.process_time()
        try:
            samples = simulator.advance(steps, sample_every=every)[0][1:]
        except timo_sim.DivergenceError:
            return None
        seconds = time.process_time() - start
        return seconds, lambda: of_motions(simulator.model, scene, samples)
    return Case(formulation, f'N = {modes}, h = {1e3 * step:g} ms', run, (modes, step))


def fixed_step_case(scene, method, modes, step):
    """Return a case of a compiled peer on the `exact` equations."""
    checked = scene.load({'model.modes': modes, 'integrator.step': step})
    model, start = checked.build(), checked.initial_motion()
    peers.fixed_step(method, model, start, checked.load.stages(0, 1, step), step, 1)  # compiles

    def run():
        begin = time.process_time()
        loads = checked.load.stages(0, round(scene.duration / step), step)
        samples = peers.fixed_step(method, model, start, loads, step,
                                   round(max(scene.period, step) / step))
        seconds = time.process_time() - begin
        if samples is None:
            return None
        return seconds, lambda: of_motions(model, scene, samples)
    return Case(method, f'N = {modes}, h = {1e3 * step:g} ms', run, (modes, step))


def adaptive_case(scene, method, modes, tolerance):
    """Return a case of a SciPy solver on the `exact` equations."""
    checked = scene.load({'model.modes': modes})
    model, start = checked.build(), checked.initial_motion()
    load, jumps = peers.load_function(checked, scene.drive)
    model.rate(model.state(start), load(0.0))  # compiles
    times = np.arange(round(scene.duration / scene.period) + 1) * scene.period

    def run():
        begin = time.process_time()
        samples = peers.adaptive(method, model, start, load, jumps, times, tolerance)
        seconds = time.process_time() - begin
        return seconds, lambda: of_motions(model, scene, samples)
    return Case(method, f'N = {modes}, rtol = {tolerance:g}', run, (modes, tolerance))


def engine_case(scene, elements, step):
    """Return a case of exudyn with geometrically exact elements."""
    checked = scene.load({'initial.shaft': 0.0} if scene.drive else None)

    def run():
        try:
            found = finite_elements.simulate(
                checked, elements, step, scene.duration,
                round(max(scene.period, step) / step), scene.drive,
                # The reference of the driven arm is inextensible, as the other methods are.
                axial_factor=100.0 if scene.drive else 1.0)
        except exudyn.SolverError:
            return None
        return found['solver_seconds'], lambda: _of_engine(scene, found)
    return Case(ENGINE, f'{elements} elements, h = {1e3 * step:g} ms', run, (elements, step))


def _of_engine(scene, found):
    # `tip_columns` of what `finite_elements` or `floating_frame` found, after the start.
    theta = found['theta_rad'][1:]
    carrier = np.column_stack([found['x_c_m'], found['y_c_m']])[1:]
    along = found['u_l_m'][1:] if 'u_l_m' in found else np.zeros(len(theta))
    return tip_columns(theta, carrier, scene.length + along, found['w_l_m'][1:])


def reduced_case(scene, modes, step):
    """Return a case of exudyn's modally reduced floating frame."""
    checked = scene.load()

    def run():
        found = floating_frame.simulate(checked, modes, step, scene.duration,
                                        round(scene.period / step))
        return found['solver_seconds'], lambda: _of_engine(scene, found)
    return Case(REDUCED, f'{modes} modes, h = {1e3 * step:g} ms', run, (modes, step))


def rival_case(scene, method, label, size, step, function, *more):
    """Return a case of a function of `rivals` or `soft_rods`."""
    checked = scene.load({'initial.shaft': 0.0} if scene.drive else None)

    def run():
        seconds, *found = function(checked, size, step, scene.duration,
                                   round(scene.period / step), scene.drive, *more)
        return seconds, lambda: tip_columns(*found)
    scaled = ''.join(f', {factor:g} {name}' for factor, name in zip(more, ('E A', 'rho I'))
                     if factor != 1)
    return Case(method, f'{label}, h = {1e3 * step:.3g} ms{scaled}', run, (size, step))


def chain_case(scene, links):
    """Return a case of MuJoCo in its longest stable step: it has errors of the mesh alone."""
    longest = rivals.longest_step(scene.load(), links)
    step = scene.period / math.ceil(scene.period / longest)
    return rival_case(scene, CHAIN, f'{links} links', links, step, rivals.chain)


def rod_case(scene, elements, *factors):
    """Return a case of PyElastica with factors of E A and rho I, in its longest stable step."""
    longest = 0.97 * rivals.longest_step_of_rod(scene.load(), elements, *factors)
    step = scene.period / math.ceil(scene.period / longest)
    return rival_case(scene, ROD, f'{elements} elements', elements, step, rivals.elastica,
                      *factors)


def rods_of(scene, quick):
    """Return the cases of a scene, if its carrier is held; the best found of each, by hand."""
    if not scene.held:
        return []
    from benchmark.accuracy import soft_rods  # JAX is slow to import
    if scene.drive:
        scaled = [(7, 1, 400), (10, 1, 400), (14, 1, 200), (20, 1, 1), (24, 1, 50), (40, 2, 10),
                  (60, 2, 4)]
        discrete = [(10, 0.01, 0.1), (20, 0.01, 0.1), (20, 0.005, 1), (30, 0.004, 1)]
    else:
        scaled = [(elements, 1, factor) for elements in (10, 20, 40, 60, 100)
                  for factor in (100, 10, 1)]
        discrete = [(elements, step, 1) for elements in (10, 20, 40)
                    for step in (0.01, 0.005, 0.0025)]
    soft = [(2, 0.01), (3, 0.004), (4, 0.002), (5, 0.0005), (6, 0.0005)]
    few = slice(1) if quick else slice(None)
    return [*(rod_case(scene, *settings) for settings in scaled[few]),
            *(rival_case(scene, DISCRETE, f'{elements} elements', elements, step, rivals.dismech,
                         factor) for elements, step, factor in discrete[few]),
            *(rival_case(scene, SOFT, f'order {order}', order, step, soft_rods.soft_rod)
              for order, step in soft[few])]


def cases_of(scene, quick):
    """Return the cases of a scene."""
    steps = [0.02, 0.01, 0.005, 0.002, 0.001]
    cases = [own_case(scene, formulation, modes, step)
             for formulation in (OWN[:2] if quick else OWN)
             for modes in ((2, 3, 5) if quick else range(1, 9))
             for step in steps + ([] if quick else [0.0005, 0.0002, 0.0001])]
    cases += [fixed_step_case(scene, method, modes, step) for method in peers.FIXED_STEP
              for modes in ((5,) if quick else (3, 5))
              for step in ([0.001] if quick else [0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001])]
    cases += [adaptive_case(scene, method, modes, tolerance) for method in ('DOP853', 'Radau')
              for modes in ((3,) if quick else (3, 5))
              for tolerance in ((1e-4,) if quick else (1e-2, 1e-4, 1e-6, 1e-8))]
    meshes = (20, 40) if quick else (20, 40, 60, 100, 200, 400)
    coarse = [0.02, 0.01, 0.005, 0.002] if scene.drive else [0.005, 0.002, 0.001, 0.0005]
    if not (quick and scene.drive):
        cases += [engine_case(scene, elements, step) for elements in meshes
                  for step in (coarse[1:3] if quick else coarse + (
                      [0.001] if scene.drive else [0.0002, 0.0001]))]
    if not scene.held:
        cases += [reduced_case(scene, modes, step) for modes in ((5,) if quick else (3, 5, 8))
                  for step in ([0.001] if quick else [0.005, 0.002, 0.001, 0.0005])]
    cases += [chain_case(scene, links) for links in ((5, 10) if quick else (5, 10, 20, 40))]
    return cases + rods_of(scene, quick)
