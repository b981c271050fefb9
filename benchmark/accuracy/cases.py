# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What `work_precision.py` measures: scenes with a reference, and methods with their settings."""

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
import math
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any, Callable

import exudyn
import numpy as np

from benchmark import ROOT
from benchmark.accuracy import links, rivals
from oracles import finite_elements, peers
from oracles.references import CANTILEVER, read, spin_up, TORQUE
import timo_sim
from timo_sim.model import FORMULATIONS
from timo_sim.scene.files import scene_text

OWN, INTEGRATOR = 'timo_sim', 'integrator'  # kinds of methods
ENGINE, LINKS = 'engine', 'links'           # those of others: from a library, or by hand
OUR_STEP = 'links, our step'                # by hand, with the exponential step
# Neighbours differ by a factor of 1.5 or 4/3, every other one by 2.
COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
HALVED = tuple(0.02 / 2**k for k in range(8))  # exponential steps [s]
HINGES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32)  # of chains of links


@dataclass
class Scene:
    """A scene with its reference."""

    name: str
    source: Any         # for `load_scene`: a file, or values by dotted name
    duration: float     # [s]
    period: float       # of the reference [s]
    drive: tuple | None  # of the shaft: angle, speed, acceleration as functions of time
    goals: tuple = (1e-3, 1e-4, 1e-5)  # errors in the tip deflection to be reached [m]

    def load(self, values=None):
        """Return the scene of a file, with values by dotted name."""
        return timo_sim.load_scene(self.file, values)

    @cached_property
    def file(self):
        """The file of the scene."""
        if isinstance(self.source, Path):
            return self.source
        self._folder = TemporaryDirectory()
        path = Path(self._folder.name, 'scene.yaml')
        path.write_text(scene_text(timo_sim.load_scene(self.source).values), encoding='utf-8')
        return path

    @cached_property
    def arm(self):
        """The arm."""
        return self.load().manipulator.arm

    @cached_property
    def resting(self):
        """The scene as engines take it: the drive of a shaft begins at 0."""
        return self.load({'initial.shaft': 0.0} if self.drive else None)

    @cached_property
    def held(self):
        """Whether the carrier is held and the shaft driven or locked."""
        return 'theta_rad' not in read(self.name)[1]


SCENES = [
    Scene('paper', ROOT / 'config' / 'paper.yaml', 10.0, 0.01, None),
    Scene('torque', TORQUE, 5.0, 0.01, None),
    Scene('spin_up', ROOT / 'config' / 'spin_up.yaml', 20.0, 0.02, spin_up()),
    Scene('cantilever', CANTILEVER, 3.0, 0.02, None, (1e-2, 1e-3, 1e-4)),
]


@dataclass(frozen=True)
class Method:
    """
    A method with a grid of settings: sizes and steps, both from coarse to fine.

    `run(scene, checked, size, step)` returns the CPU time of the solver [s] and the tip deflection
    [m] at the samples after the start, or None if the run fails; `checked` is the scene with the
    `values(size, step)`. `simulate`, of the same arguments, is what a user calls if that is more
    than `run`. `orders` are those of the error in the size and in the step, by which two runs
    are extrapolated; 0 where they are not.
    """

    name: str
    kind: str
    sizes: tuple
    steps: tuple
    run: Callable
    label: Callable  # (checked, size, step) -> settings in words
    orders: tuple = (0, 0)
    values: Callable = lambda size, step: {}
    simulate: Callable | None = None
    outside: float = 0.0  # part of the size that is not a part of the arm


def of_motions(model, scene, motions):
    """Return the tip deflection [m] of motions, shape (n, 2 (3 + N))."""
    tip = model.at([scene.arm.length])
    return model.centre_line(motions[:, 3:3 + len(model.modes)], tip)[:, 0, 1]


def _every(scene, step):
    return round(max(scene.period, step) / step)


def _own(scene, checked, size, step):
    simulator = timo_sim.Simulator(checked)
    simulator.warm_up()
    begun = time.process_time()
    try:
        samples = simulator.advance(round(scene.duration / step),
                                    sample_every=_every(scene, step))[0][1:]
    except timo_sim.DivergenceError:
        return None
    return time.process_time() - begun, of_motions(simulator.model, scene, samples)


def _simulate(scene, checked, size, step):
    timo_sim.simulate(checked, scene.duration, _every(scene, step))


def _fixed_step(method, scene, checked, size, step):
    model = checked.build()
    peers.system_of(model)  # compiles
    begun = time.process_time()
    loads = checked.load.stages(0, round(scene.duration / step), step)
    samples = peers.fixed_step(method, model, checked.initial_motion(), loads, step,
                               _every(scene, step))
    seconds = time.process_time() - begun
    return None if samples is None else (seconds, of_motions(model, scene, samples))


def _adaptive(method, scene, checked, size, tolerance):
    model, (load, jumps) = checked.build(), peers.load_function(checked, scene.drive)
    times, start = np.arange(round(scene.duration / scene.period) + 1) * scene.period, (
        checked.initial_motion())
    model.rate(model.state(start), load(0.0))  # compiles
    begun = time.process_time()
    samples = peers.adaptive(method, model, start, load, jumps, times, tolerance)
    return time.process_time() - begun, of_motions(model, scene, samples)


def _exudyn(scene, checked, size, step, **more):
    try:
        found = finite_elements.simulate(checked, size, step, scene.duration,
                                         _every(scene, step), **more)
    except exudyn.SolverError:
        return None
    return found['solver_seconds'], found['w_l_m'][1:]


def _rival(function, scene, checked, size, step, *more):
    # A function of `rivals` or `soft_rods`.
    seconds, *_, deflection = function(checked, size, step, scene.duration, _every(scene, step),
                                       scene.drive, *more)
    return seconds, deflection


def _whole_part(period, longest):
    """Return the longest step that is a whole part of a period and at most `longest`."""
    return period / math.ceil(period / longest)


def _with_step(words):
    return lambda checked, size, step: f'{words.format(size)}, h = {1e3 * step:.3g} ms'


def _integrators(scene):
    """Return the methods of this package, and others for the same equations."""
    steps = tuple(0.01 / count for count in COUNTS[:13])

    def sized(modes, step, **more):
        return {'model.modes': modes, 'integrator.step': step, **more}

    for name in FORMULATIONS:
        yield Method(name, OWN, tuple(range(1, 10)), HALVED, _own, _with_step('N = {}'), (0, 4),
                     partial(sized, **{'model.formulation': name}), _simulate)
    for name, order in zip(peers.FIXED_STEP, (4, 2, 2)):
        yield Method(name, INTEGRATOR, (3, 4, 5, 6, 7, 8), steps, partial(_fixed_step, name),
                     _with_step('N = {}'), (0, order), sized)
    for name in ('DOP853', 'Radau'):
        yield Method(name, INTEGRATOR, (3, 5, 8), (1e-2, 1e-4, 1e-6, 1e-8),
                     partial(_adaptive, name),
                     lambda _, modes, tolerance: f'N = {modes}, rtol = {tolerance:g}',
                     values=lambda modes, tolerance: {'model.modes': modes})


def _engines(scene):
    """Return what other engines offer."""
    steps = tuple(scene.period / count for count in COUNTS)

    def engine(name, sizes, steps, run, words, orders, kind=ENGINE, **more):
        return Method(name, kind, sizes, steps, run,
                      words if callable(words) else _with_step(words), orders, **more)

    # The reference of the driven arm is inextensible, as the other methods are.
    driven = {'drive': scene.drive, 'axial_factor': 100.0} if scene.drive else {}
    # A tenth faster or more than with 1e-10, and as accurate to 1e-6 m.
    driven |= {'tolerance': 1e-8}
    fours = tuple(4 * count for count in COUNTS)
    for name, kind, sizes, order in (
            ('exudyn, beams of two nodes', 'linear', fours, 2),
            ('exudyn, beams of three nodes', 'quadratic', COUNTS[1:], 4),
            ('exudyn, ANCF cables', 'cable', fours, 4)):
        yield engine(name, sizes, steps, partial(_exudyn, kind=kind, **driven),
                     '{} elements', (order, 2))

    # Explicit steps are parts of the longest stable one.
    @lru_cache(maxsize=None)
    def stable(gauss, axial_factor, count, part):
        return _whole_part(scene.period, part * rivals.longest_step(
            scene.resting, count, gauss, axial_factor))

    for name, kind, function, words, gauss, axial_factor in (
            ('MuJoCo, links', ENGINE, rivals.chain, 'links', False, None),
            ("MuJoCo, links, Gauss's points", ENGINE, rivals.chain, 'links', True, None),
            ('MuJoCo, rod, RK4', ENGINE, rivals.rod, 'parts', False, 0.01),
            ('rigid links, RK4', LINKS, links.rigid_links, 'links', False, None),
            ("rigid links, Gauss's points, RK4", LINKS, links.rigid_links, 'links', True, None)):
        step = partial(stable, gauss, axial_factor)
        if axial_factor is None:
            function = partial(function, gauss=gauss)
        yield engine(
            name, HINGES, (1.0, 0.5, 0.25),
            lambda scene, checked, count, part, function=function, step=step: _rival(
                function, scene, checked, count, step(count, part)),
            lambda _, count, part, words=words, step=step: (
                f'{count} {words}, h = {1e3 * step(count, part):.3g} ms'), (2, 0), kind)
    for name, gauss in (('rigid links, exponential', False),
                        ("rigid links, Gauss's points, exponential", True)):
        yield engine(name, HINGES, HALVED, partial(_rival, partial(
            links.rigid_links, gauss=gauss, exponential=True)), '{} links', (2, 4), OUR_STEP)
    yield engine('MuJoCo, rod, discrete', COUNTS[1:], steps, partial(
        _rival, partial(rivals.rod, integrator='discrete')), '{} parts', (2, 1))
    if scene.held:
        yield from _rods(scene, engine, steps)


def _rods(scene, engine, steps):
    """Return rods for an arm on a held carrier."""
    # Of PyElastica, the second axis is a factor of rho I, which allows longer steps.
    def rod_step(checked, elements, factor):
        return _whole_part(scene.period, 0.97 * rivals.longest_step_of_rod(
            checked, elements, 1.0, factor))

    yield engine(
        'PyElastica', COUNTS[4:], (400, 100, 25, 6, 1),
        lambda scene, checked, elements, factor: _rival(
            rivals.elastica, scene, checked, elements, rod_step(checked, elements, factor), 1.0,
            factor),
        lambda checked, elements, factor: (
            f'{elements} elements, h = {1e3 * rod_step(checked, elements, factor):.3g} ms, '
            f'{factor} rho I'), (2, 0), outside=0.5)
    yield engine('dismech-newton', COUNTS[4:], steps, partial(_rival, rivals.dismech),
                 '{} elements', (2, 2), outside=0.5)
    from benchmark.accuracy import soft_rods  # JAX is slow to import
    yield engine('soromox', (2, 3, 4, 5, 6), steps, partial(_rival, soft_rods.soft_rod),
                 'order {}', (0, 5))


def methods_of(scene):
    """Return the methods for a scene."""
    return [*_integrators(scene), *_engines(scene)]
