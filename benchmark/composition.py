# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Try each effect in each use of a scene, pairs of effects, and random scenes; fill doc/design.md.

A cell works if the use gives what `Simulator` gives, or what another oracle says; it may be
without meaning, for a reason that stands here; or it is refused, with the text of the error.
"""

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
import contextlib
import ctypes
from itertools import combinations
import math
import multiprocessing
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import NamedTuple
from unittest.mock import patch
import warnings

import numpy as np

from benchmark.report import make_page, table
from oracles.processor import Processor
import timo_sim
from timo_sim.export.c import link, write_c
from timo_sim.export.constants import interface_of
from timo_sim.model.layout import Motion
from timo_sim.export.ros2_control import write_hardware
from timo_sim.runs.sweep import run_lanes
from timo_sim.scene.files import scene_text
from timo_sim.scene.parameters import NODE, PARAMETERS
from timo_sim.simulation.batch import DEVICES
from timo_sim.simulation.finer import tip_distances

# Tolerances of cells are some ten times the errors of the differences, steps or linear models that
# they compare with; where bits must be equal, bits are compared.
STEPS, STEP = 60, 0.001  # of a run, and their length [s]
DURATION = STEPS * STEP
# An arm that moves, of which every value is stated.
BASE = {
    'arm.length': 1.0, 'arm.section.width': 0.02, 'arm.section.height': 0.01,
    'arm.material': 'aluminium', 'arm.damping_ratio': [0.01], 'carrier.mass': 5.0,
    'motor.mass': 1.0, 'motor.shaft_inertia': 0.1, 'motor.viscous_friction': 0.1,
    'end_effector.mass': 0.5, 'end_effector.inertia': 0.01, 'model.modes': 3,
    'integrator.step': STEP, 'initial.shaft': 0.3, 'motor.torque_limit': 50.0}
MOVING = {'initial.shaft_velocity': 0.5, 'initial.carrier_x_velocity': 0.1}
GEAR = {'motor.gear.stiffness': 900.0, 'motor.gear.damping': 2.0, 'motor.rotor.inertia': 0.05}
_TIMES = [0.0, 0.1]
EFFECTS = {
    'section kinds and profile': {
        'arm.section.shape': 'box', 'arm.section.wall': 0.002,
        'arm.profile.position': [0.0, 0.4, 1.0], 'arm.profile.height': [0.014, 0.01, 0.008]},
    'hub': {'hub.radius': 0.1},
    'elastic gear': GEAR,
    'backlash': {**GEAR, 'motor.gear.backlash': 0.002},
    'friction of the shaft': {
        'motor.coulomb_friction': 0.3, 'motor.coulomb_presliding': 2e-3},
    'friction of the carrier': {
        'carrier.coulomb_friction': 1.0, 'carrier.coulomb_presliding': 1e-3},
    'friction of the rotor': {
        **GEAR, 'motor.rotor.coulomb_friction': 0.2, 'motor.rotor.coulomb_presliding': 2e-3},
    'smooth friction': {'motor.coulomb_friction': 0.3, 'motor.coulomb_speed': 0.1},
    'current limit': {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5,
                      'motor.dc.gear_ratio': 2.0, 'motor.dc.current_limit': 0.8},
    'axial modes': {'model.axial_modes': 1},
    'static modes': {'model.static_modes': 'both', 'end_effector.mass': 0.0,
                     'end_effector.inertia': 0.0},
    'one axis held': {'carrier.held': 'x', 'initial.carrier_x_velocity': 0.0},
    'payload that changes': {'payload.time': [0.005], 'payload.mass': [1.0],
                             'payload.inertia': [0.02], 'payload.offset': [0.0]},
    'gravity and equilibrium': {'gravity': [0.0, -9.81], 'carrier.held': 'both',
                                'initial.carrier_x_velocity': 0.0, 'initial.equilibrium': True,
                                'initial.shaft_velocity': 0.0},
    'driven shaft': {'motor.shaft': 'driven', 'motor.drive.time': _TIMES,
                     'motor.drive.angle': [0.3, 0.4], 'motor.drive.speed': [0.5, 1.5],
                     'motor.drive.acceleration': [0.0, 0.0]},
    'push': {'push.position': 0.6, 'load.push_y.piecewise.time': [0.0],
             'load.push_y.piecewise.value': [2.0]},
    "sensors' noise": {'sensor.root_strain.position': 0.3, 'sensor.tip_imu.position': 0.5, **{
        f'sensor.{name}.noise': 1e-6 for name in (
            'encoder', 'root_strain', 'gyro', 'tip_acceleration')}},
    'limits and rates': {'motor.torque_limit': 0.4, 'motor.torque_rate_limit': 20.0,
                         'carrier.force_limit': 3.0, 'carrier.force_rate_limit': 500.0},
    'newton': {'model.formulation': 'newton'},
    'end effector off the tip': {'end_effector.offset': 0.1},
    'clamp that gives': {'arm.root_stiffness': 400.0},
    'spring on the shaft': {'motor.spring.stiffness': 30.0, 'motor.spring.rest': 0.3},
    'driven carrier': {
        'initial.carrier_x_velocity': 0.0, 'carrier.drive.harmonic.frequency': [3.0],
        'carrier.drive.harmonic.x': [0.01], 'carrier.drive.time': _TIMES,
        'carrier.drive.x': [0.0, 0.02], 'carrier.drive.x_speed': [0.1, 0.3],
        'carrier.drive.x_acceleration': [0.0, 0.0]},
}
_NO_MOTOR = 'the motion of a driven shaft is given, whatever the motor does'
_GIVEN = 'an axis along which the carrier is driven is not held'
_ONE_HOLD = 'one axis of the carrier is held, or both'
WITHOUT_MEANING = {
    **{pair: _NO_MOTOR for pair in (
        ('backlash', 'driven shaft'), ('current limit', 'driven shaft'),
        ('driven shaft', 'elastic gear'), ('driven shaft', 'friction of the rotor'),
        ('driven shaft', 'friction of the shaft'), ('driven shaft', 'smooth friction'))},
    ('driven shaft', 'gym'): 'an action is a torque, which does not move a driven shaft',
    ('friction of the shaft', 'smooth friction'): 'they are two laws of the same joint',
    ('friction of the carrier', 'gravity and equilibrium'): 'a carrier that is held has none',
    ('gravity and equilibrium', 'one axis held'): _ONE_HOLD,
    ('axial modes', 'newton'): '`newton` has no axial modes: its arm keeps its length',
    ('driven shaft', 'gravity and equilibrium'): 'an equilibrium is at rest, a drive moves',
    ('driven carrier', 'gravity and equilibrium'): _GIVEN,
    ('driven carrier', 'one axis held'): _GIVEN,
}
WITHOUT_MEANING = {frozenset(pair): text for pair, text in WITHOUT_MEANING.items()}


class Cell(NamedTuple):
    """What came of a cell: 'works', 'without meaning', 'refused' or 'wrong', and its text."""

    state: str
    text: str = ''


def scene_of(*effects, **changes):
    """Return the scene that moves with some effects."""
    values = {**BASE, **MOVING}
    for effect in effects:
        values.update(EFFECTS[effect])
    if 'one axis held' in effects and 'initial.equilibrium' in values:
        values['carrier.held'] = 'x'
    return timo_sim.load_scene(values, {name.replace('__', '.'): value
                                        for name, value in changes.items()})


def commands(scene):
    """Return what acts, as for `Simulator.step`."""
    found = {}
    if scene.values['motor.shaft'] == 'free':
        found.update({'voltage': 3.0} if scene.values['motor.dc.resistance'] else {'torque': 0.8})
    if scene.values['carrier.held'] not in ('y', 'both'):
        found['force'] = [0.0, 2.0]
    return found


def _single(given):
    # Commands as single numbers, forces by axis.
    forces = dict(zip(('force_x', 'force_y'), given.get('force', ())))
    return {**{name: value for name, value in given.items() if name != 'force'}, **forces}


def expected(scene, steps=STEPS, **others):
    """Return the motions of a Simulator after each step, shape (1 + steps, 2 (3 + N))."""
    simulator, found = timo_sim.Simulator(scene), []
    for _ in range(steps):
        found.append(simulator.motion.values)
        simulator.step(**{**commands(scene), **others})
    return np.array([*found, simulator.motion.values])


def close(found, wanted, most):
    """Raise AssertionError unless two arrays are as close as that, of the largest number."""
    off = np.abs(np.subtract(found, wanted)).max() / max(np.abs(wanted).max(), 1e-12)
    assert off <= most, f'off by {off:.1e} of the largest number'


def simulator(scene):
    """Steps of an eighth of the length bring the same motion."""
    fine = scene.vary({'integrator.step': STEP / 8})
    other = timo_sim.Simulator(fine)
    other.step(duration=DURATION, **commands(scene))
    close(other.motion.values[:3], expected(scene)[-1, :3], 2e-4)


def node(scene):
    """A node of its own process runs as fast as it can; its log has the motion of Simulator."""
    from benchmark.process import ENVIRONMENT, options
    with tempfile.TemporaryDirectory() as folder:
        path, log = Path(folder, 'scene.yaml'), Path(folder, 'run.mcap')
        path.write_text(scene_text(scene.values), encoding='utf-8')
        given = options(duration=DURATION, real_time_factor=0.0, record_file=log)
        subprocess.run([str(Path(sys.executable).parent / 'sim_node'), '--ros-args',
                        '--params-file', path, *given], env=ENVIRONMENT, check=True,
                       capture_output=True, timeout=120)
        run, other = timo_sim.open_log(log), timo_sim.Simulator(scene)
        other.step(duration=DURATION)
        close(run.values[-1], other.motion.values, 1e-13)


def replay(scene):
    """A saved run is replayed to the last bit."""
    from timo_sim.runs.replay import replay as again
    with tempfile.TemporaryDirectory() as folder:
        path = timo_sim.simulate(scene, DURATION, estimate=False).save(Path(folder, 'run.mcap'))
        said = []
        assert again(path, show=said.append), ' '.join(said)


def estimate(scene):
    """The estimated error is known, and covers that beside more modes and shorter steps."""
    run = timo_sim.simulate(scene, DURATION)
    found = run.stats['estimated_tip_error_m']
    more = {'model.modes': 9, 'integrator.step': STEP / 8, 'model.formulation': 'exact'}
    other = timo_sim.simulate(scene.vary(more), DURATION, sample_every=8, estimate=False)
    true, _ = tip_distances(run.model, run.values, other.model, other.values)
    assert math.isfinite(found) and true <= 3.0 * found + 1e-6, f'{found:.1e}, {true:.1e} m'


def batch(scene):
    """Each lane moves as a Simulator, beside another one."""
    lanes = timo_sim.Batch([scene, scene.vary({'initial.shaft': 0.5})])
    for _ in range(3):
        lanes.step(duration=DURATION / 3, **commands(scene))
    close(lanes.motion.values[0], expected(scene)[-1], 1e-9)
    run_lanes([scene] * 2, 10)


def gpu(scene):
    """The kernel of a GPU, compiled for the CPU, gives the bits of a Batch on the CPU."""
    scenes, found = [scene, scene.vary({'initial.shaft': 0.5})], []
    with patch.dict(DEVICES, cuda=Processor):
        for device in 'cpu', 'cuda':
            lanes = timo_sim.Batch(scenes, device=device)
            lanes.step(duration=DURATION, **commands(scene))
            found.append(lanes.motion.values)
    assert (found[0] == found[1]).all()
    close(found[0][0], expected(scene)[-1], 1e-9)


def gym(scene):
    """An environment moves as a Simulator under the same torque."""
    from timo_sim.gym import ReachVectorEnv
    environments = ReachVectorEnv(2, scene, period=0.02)
    environments.reset(seed=1)
    share = 0.4
    for _ in range(3):
        environments.step(np.full((2, 1), share))
    other = timo_sim.Simulator(scene)
    other.step(duration=DURATION, torque=share * scene.values['motor.torque_limit'])
    close(environments.batch.motion.values[0], other.motion.values, 1e-9)


def linear(scene):
    """A small torque or force moves model and Simulator alike, and there are modes."""
    play = scene.values['motor.gear.backlash'] > 0.0
    contact = {'contact': 'closed'} if play else {}
    still = scene.vary({name: 0.0 for name in MOVING})
    if still.values['motor.shaft'] == 'driven':
        still = still.vary({'motor.drive.angle': [0.3, 0.3], 'motor.drive.speed': [0.0, 0.0]})
    model = timo_sim.linearize(still, **contact)
    assert timo_sim.modes(still, **contact).frequency[-1] > 1.0
    free = still.values['motor.shaft'] == 'free'
    name, unit = ('torque', 1e-4) if free else ('force', [0.0, 0.01])
    column = model.inputs.index('torque_N_m' if name == 'torque' else 'force_y_N')
    x, one = np.zeros(len(model.states)), model.to_discrete(STEP)
    for _ in range(20):
        x = one.A @ x + one.B[:, column] * np.max(unit)
    if play:
        still = still.vary({'motor.gear.backlash': 0.0})

    def end(given):
        other = timo_sim.Simulator(still)
        other.set_motion(model.equilibrium)
        return other.step(duration=20 * STEP, **given).values
    change = model.to_motion(x).values - model.equilibrium
    close((end({name: unit}) - end({}))[:3], change[:3], 1e-3)


def derivatives(scene):
    """Derivatives of ten steps are differences of runs that begin a little off."""
    given, name = commands(scene), next(iter(commands(scene)))
    one = timo_sim.Simulator(scene)
    found = one.step_derivatives([name], duration=10 * STEP, **given)
    start, size = timo_sim.Simulator(scene).motion.values, 1e-7

    def end(motion, more=0.0):
        other = timo_sim.Simulator(scene)
        other.set_motion(motion)
        return other.step(duration=10 * STEP, **{
            **given, name: np.add(given[name], more).tolist()}).values

    places = [k for k in range(len(start)) if found.by_motion[:, k].any()]
    columns = [(end(start + size * row) - end(start - size * row)) / (2.0 * size)
               for row in np.eye(len(start))[places]]
    close(found.by_motion[:, places], np.array(columns).T, 1e-5)
    if np.isfinite(scene.values['motor.torque_rate_limit']):
        return  # derivatives are by what acts after limits
    first = np.array([1.0, 0.0]) if name == 'force' else 1.0
    close(found.by_input[:, 0], (end(start, size * first) - end(start, -size * first))
          / (2.0 * size), 1e-5)


def observer(scene):
    """An observer that begins right, and is shown the truth, stays there."""
    noisy = scene.vary({'sensor.encoder.noise': 1e-5, 'sensor.root_strain.noise': 1e-7})
    names = ['encoder', 'root_strain']
    found, truth = timo_sim.observer(noisy, names), timo_sim.Simulator(scene)
    for _ in range(10):
        truth.step(**commands(scene))
        sensors = truth.sensors
        found.update({name: getattr(sensors, name) for name in names}, commands(scene), STEP)
    close(found.motion.values[:3], truth.motion.values[:3], 1e-3)


def _run_shared(library, scene):
    # Step an exported arm; compare its motion with that of Simulator, bit by bit.
    interface, other = interface_of(scene, False), timo_sim.Simulator(scene)
    arm = ctypes.CDLL(str(library))
    arm.arm_size.restype = ctypes.c_size_t
    memory = (ctypes.c_double * (arm.arm_size() // 8 + 1))()
    assert arm.arm_create(memory, ctypes.c_size_t(arm.arm_size())) == 0
    given = _single(commands(scene))
    for number, each in enumerate(interface.inputs):
        assert arm.arm_set_input(memory, number, ctypes.c_double(given.get(each.title, 0.0))) == 0
    outputs = (ctypes.c_double * len(interface.outputs))()
    for _ in range(STEPS):
        other.step(**commands(scene))
    assert arm.arm_step(memory, ctypes.c_long(STEPS)) == 0
    assert arm.arm_get_outputs(memory, outputs) == 0
    found = dict(zip([each.title for each in interface.outputs], outputs))
    motion = Motion(other.motion.values)
    assert [found['carrier_x'], found['carrier_y'], found['shaft'], found['encoder']] == (
        [*motion.carrier, motion.shaft, other.sensors.encoder])


def c_and_fmu(scene):
    """A C library has the bits of Simulator, and there is an FMU."""
    with tempfile.TemporaryDirectory() as folder:
        write_c(scene, folder, derivatives=False)  # of which another column is
        library = Path(folder, 'arm.so')
        library.write_bytes(link(folder, ['arm.o'], 'arm_*'))
        _run_shared(library, scene)
        assert timo_sim.export_fmu(scene, Path(folder, 'arm.fmu'), estimate=False).exists()


def ros2_control(scene):
    """The library of a ros2_control plugin has the bits of Simulator."""
    values = {name: each.default for name, each in PARAMETERS.items() if each.scope == NODE}
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, 'arm.so')
        write_hardware(scene, {**values, **scene.values}, library)
        _run_shared(library, scene)


def fit(scene):
    """A parameter is found again from a record without noise."""
    t, begin, other = STEP * np.arange(1 + STEPS), STEPS // 4, timo_sim.Simulator(scene)
    motions = [other.motion] + [other.step(**(commands(scene) if k >= begin else {}))
                                for k in range(STEPS)]
    acts = {name: np.where(np.arange(1 + STEPS) < begin, 0.0, number)
            for name, number in _single(commands(scene)).items()}
    free = scene.values['motor.shaft'] == 'free'
    moved, name = ('shaft', 'motor.viscous_friction') if free else ('carrier_y', 'carrier.mass')
    values = [each.shaft if free else each.carrier[1] for each in motions]
    record = timo_sim.Record.of({each: (t, numbers) for each, numbers in acts.items()},
                                {moved: (t, np.array(values))})
    found = timo_sim.fit(scene.vary({name: 1.1 * BASE[name]}), record, [name], quick=True,
                         starts=1)
    close(found.values[name], BASE[name], 1e-3)


def sensitivities(scene):
    """The derivative of the tip's place by a stiffness is a difference of runs."""
    name, size = 'arm.young_modulus', 1e7
    found = timo_sim.sensitivities(scene.vary({'arm.material': 'none', name: 7e10}), 0.02,
                                   parameters=[name])

    def tip(value):
        other = timo_sim.Simulator(scene.vary({'arm.material': 'none', name: value}))
        other.step(duration=0.02)
        return other.position()
    close(found.jacobian[-1, :, 0], (tip(7e10 + size) - tip(7e10 - size)) / (2.0 * size), 1e-4)


USES = {'Simulator': simulator, 'node': node, 'replay': replay, 'estimate of the error': estimate,
        'Batch, sweeps in lanes': batch, 'Batch on a GPU': gpu, 'gym': gym,
        '`linearize`, `modes`': linear, 'derivatives of a step': derivatives, 'observer': observer,
        'C, FMU': c_and_fmu, 'ros2_control': ros2_control, 'fit': fit,
        'sensitivities': sensitivities}
PAIRED = {'S': simulator, 'B': batch, 'D': derivatives}


def reason_against(*names):
    """Return why some effects, or effects and a use, are without meaning together; '' if not."""
    return next((reason for pair, reason in WITHOUT_MEANING.items() if pair <= {*names}), '')


def try_cell(use, *effects):
    """Return the Cell of a use, a name in USES or PAIRED, of a scene with some effects."""
    if reason := reason_against(use, *effects):
        return Cell('without meaning', reason)
    with warnings.catch_warnings(), contextlib.chdir(tempfile.gettempdir()):
        warnings.simplefilter('ignore')
        try:
            {**USES, **PAIRED}[use](scene_of(*effects))
        except timo_sim.ParameterError as error:
            return Cell('refused', str(error))
        except (AssertionError, ArithmeticError, subprocess.SubprocessError) as error:
            return Cell('wrong', f'{type(error).__name__}: {error}')
    return Cell('works')


def _try_all(cells):
    # Each process compiles, too; those of nodes must not have the threads of others.
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context('spawn')) as executor:
        return dict(zip(cells, executor.map(_try_one, cells)))


def _try_one(cell):
    return try_cell(*cell)


class _Notes:
    # The marks of cells in a table, and what stands below it.

    def __init__(self):
        self.texts, self.states = {}, Counter()

    def mark(self, cells, letters=('',)):
        """Return the mark of cells that stand in one place of a table, each with its letter."""
        self.states.update(cell.state for cell in cells)
        marks = []
        for letter, cell in zip(letters, cells):
            if cell.state != 'works':
                number = self.texts.setdefault(cell.text, len(self.texts) + 1)
                word = '-' if cell.state == 'without meaning' else f'**{cell.state}** {letter}'
                marks.append(f'{word.strip()} ({number})')
        return '; '.join(dict.fromkeys(marks)) or 'yes'

    def below(self):
        """Return the counts and what the numbers in brackets say."""
        counted = sum(self.states.values()) - self.states['without meaning']
        lines = [f'{self.states["works"]} of {counted} cells work '
                 f'({self.states["works"] / counted:.1%}), {self.states["refused"]} are refused, '
                 f'{self.states["wrong"]} are wrong; {self.states["without meaning"]} more are '
                 'without meaning (-).']
        return '\n\n'.join([*lines, '\n'.join(
            f'- ({number}) {" ".join(text.split())}' for text, number in self.texts.items())])


def by_use(quick):
    """Return the table of effects and uses; if `quick` one use of each effect."""
    names, notes = [*USES], _Notes()
    found = _try_all(latin_square() if quick else [
        (use, effect) for effect in EFFECTS for use in names])
    rows = [(effect, *(notes.mark([found[use, effect]]) if (use, effect) in found else ''
                       for use in names)) for effect in EFFECTS]
    return f'{table(["", *names], rows)}\n\n{notes.below()}'


def latin_square():
    """Return one use of each effect, and one effect of each use; each a pair of names."""
    uses = [*USES]  # in this order most of them need no machine code of their own
    return [(uses[(k + 9) % len(uses)], effect) for k, effect in enumerate(EFFECTS)]


def by_effect(quick):
    """Return the table of pairs of effects, in Simulator (S), Batch (B) and derivatives (D)."""
    pairs = [*combinations(EFFECTS, 2)][::40 if quick else 1]
    notes, found = _Notes(), _try_all([(use, *pair) for pair in pairs for use in PAIRED])
    numbers = {effect: str(k) for k, effect in enumerate(EFFECTS, 1)}
    rows = [(f'{numbers[row]} {row}', *(notes.mark(
        [found[use, column, row] for use in PAIRED], PAIRED) if (column, row) in pairs else ''
        for column in EFFECTS)) for row in [*EFFECTS][1:]]
    return f'{table(["", *numbers.values()], rows)}\n\n{notes.below()}'


def at_random(quick):
    """Return what came of random scenes with three to five effects, each in a random use."""
    random, cells, states = np.random.default_rng(1), [], Counter()
    while len(cells) < (4 if quick else 40):
        effects = random.choice([*EFFECTS], random.integers(3, 6), replace=False).tolist()
        cell = (random.choice([*USES]), *effects)
        if not reason_against(*cell):
            cells.append(cell)
    lines = []
    for cell, found in _try_all(cells).items():
        states[found.state] += 1
        if found.state != 'works':
            lines.append(f'- {", ".join(cell[1:])}, {cell[0]}: {found.state}, {found.text}')
    return '\n\n'.join([f'Of {len(cells)} random scenes with three to five effects, each in a '
                        f'random use, {states["works"]} work.', '\n'.join(lines)])


if __name__ == '__main__':
    make_page(__spec__, __doc__, 'design.md', {
        'effects and uses': by_use, 'effects and effects': by_effect, 'random scenes': at_random},
        quick='try a few cells, and only print them')
