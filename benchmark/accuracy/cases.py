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
CHAIN = 'MuJoCo, hinged links'


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
        theta = found['theta_rad'][1:]
        carrier = np.column_stack([found['x_c_m'], found['y_c_m']])[1:]
        return found['solver_seconds'], lambda: tip_columns(
            theta, carrier, scene.length + found['u_l_m'][1:], found['w_l_m'][1:])
    return Case(ENGINE, f'{elements} elements, h = {1e3 * step:g} ms', run, (elements, step))


def reduced_case(scene, modes, step):
    """Return a case of exudyn's modally reduced floating frame."""
    checked = scene.load()

    def run():
        found = floating_frame.simulate(checked, modes, step, scene.duration,
                                        round(scene.period / step))
        theta = found['theta_rad'][1:]
        carrier = np.column_stack([found['x_c_m'], found['y_c_m']])[1:]
        return found['solver_seconds'], lambda: tip_columns(
            theta, carrier, np.full(len(theta), scene.length), found['w_l_m'][1:])
    return Case(REDUCED, f'{modes} modes, h = {1e3 * step:g} ms', run, (modes, step))


def chain_case(scene, links, step):
    """Return a case of MuJoCo."""
    checked = scene.load({'initial.shaft': 0.0} if scene.drive else None)

    def run():
        seconds, *found = rivals.chain(checked, links, step, scene.duration,
                                       round(scene.period / step), scene.drive)
        return seconds, lambda: tip_columns(*found)
    return Case(CHAIN, f'{links} links, h = {1e3 * step:.3g} ms', run, (links, step))


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
    for links in (5, 10) if quick else (5, 10, 20, 40):
        # In its longest stable step it has errors of the mesh alone.
        longest = rivals.longest_step(scene.load(), links)
        cases.append(chain_case(scene, links, scene.period / math.ceil(scene.period / longest)))
    return cases
