# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Stress test of the numerics: scenes from the corners of what can be asked for.

Each cell is a scene drawn from `LEVELS`, besides all that differ from the first of each in one
or two of them. It is run with its fixed step, and with an `integrator.tolerance`; the tip is
compared with a run at a tenth of the step and a thousandth of the tolerance. A cell is

- accurate: the tip stays within a thousandth of the arm's length of the reference;
- flagged: it does not, and the run says so (`ModelWarning`), or its reference does;
- refused: a ParameterError or a DivergenceError says why;
- silent: none of these. There must be none.
"""

import os
for threads in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'NUMBA_NUM_THREADS'):
    os.environ[threads] = '1'

from collections import Counter  # noqa: E402
import itertools  # noqa: E402
import math  # noqa: E402

import numpy as np  # noqa: E402

from benchmark.command import parser  # noqa: E402
import timo_sim  # noqa: E402
from timo_sim.runs.simulate import sampled_run  # noqa: E402

LENGTH = 2.0  # of the arm [m]
ACCURATE, TOLERANCE = 1e-3 * LENGTH, 1e-6 * LENGTH  # [m]
# The first level of each is that of the plain scene.
LEVELS = {
    'modes': [3, 0, 1, 5, 8, 12, 20, 40],
    'formulation': ['exact', 'newton'],
    'step': [0.01, 1e-4, 1e-3, 5e-3, 0.02],          # [s]
    'speed': [1.0, 0.0, 10.0, 30.0, 100.0],          # of the shaft [rad/s]
    'vibration': [0.01, 1e-3, 0.1, 1.0],             # of the tip, in the first mode [m]
    'slenderness': [100.0, 4.0, 10.0, 50.0, 500.0],  # length over height
    'tip mass': [1.0, 0.0, 10.0, 100.0],             # arm masses
    'tip inertia': [0.01, 0.0, 1.0, 100.0],          # masses of the arm times its length squared
    'carrier': [10.0, 1e-3, 1e6, 'held'],            # [kg]
    'damping': [0.0, 0.01, 0.1, 1.0],                # ratio of all modes
    'load': ['none', 'resonance 1', 'near resonance 1', 'resonance 2', 'resonance 3', 'torque',
             'impulse'],
    'friction': ['none', 'viscous', 'stiff', 'dry', 'sticky'],  # of carrier and shaft
}
# Besides, where all else is plain or one of these steps.
MORE = {'carrier': ['held x'], 'load': ['spike']}
HELD = {'held': 'both', 'held x': 'x'}
VERDICTS = ['accurate', 'flagged', 'refused', 'silent']
DURATION = 2.0  # [s]
# Without loads and damping, at 1 ms.
_DRIFT = {'initial.carrier_x_velocity': 0.4, 'initial.carrier_y_velocity': -0.3}
FREE = {
    'shaft 1.5 rad/s': {**_DRIFT, 'initial.shaft_velocity': 1.5,
                        'initial.modal_rates': [2.0, 1.0, 0.0]},
    'shaft 10 rad/s': {**_DRIFT, 'initial.shaft_velocity': 10.0,
                       'initial.modal_rates': [5.0, 1.0, 0.0]},
    'shaft 30 rad/s': {**_DRIFT, 'initial.shaft_velocity': 30.0,
                       'initial.modal_rates': [5.0, 1.0, 0.0]},
}
# Sizes that are compiled: others would take minutes for nothing new.
_COMPILED = {('exact', 'held'): (3,), ('newton', 'held'): (3,), ('newton', 'free'): (3, 8)}
_MOST = 40000  # steps of a reference, for three modes


def cells(count, seed=1):
    """Return the plain scene, all that differ in one or two levels up to `count`, and others."""
    plain = {name: levels[0] for name, levels in LEVELS.items()}
    found = [plain]
    for name, levels in LEVELS.items():
        found += [{**plain, name: level} for level in levels[1:]]
    found += [{**plain, 'step': step, name: level} for name, levels in MORE.items()
              for level in levels for step in LEVELS['step']]
    random = np.random.default_rng(seed)
    pairs = [{**plain, a: x, b: y} for a, b in itertools.combinations(LEVELS, 2)
             for x in LEVELS[a][1:] for y in LEVELS[b][1:]]
    random.shuffle(pairs)
    found += pairs[:max(0, count // 3)]
    while len(found) < count:
        found.append({name: levels[random.integers(len(levels))]
                      for name, levels in LEVELS.items()})
    return [cell for cell in found[:count] if _is_compiled(cell)]


def _is_compiled(cell):
    kind = 'held' if cell['carrier'] in HELD else 'free'
    return cell['modes'] in _COMPILED.get((cell['formulation'], kind), LEVELS['modes'])


def scene_of(cell, step, tolerance=0.0):
    """Return the scene of a cell."""
    mass = 2710.0 * LENGTH * 0.02 * LENGTH / cell['slenderness']
    values = {
        'model.formulation': cell['formulation'], 'model.modes': cell['modes'],
        'integrator.step': step, 'integrator.tolerance': tolerance,
        'arm.length': LENGTH, 'arm.height': LENGTH / cell['slenderness'],
        'end_effector.mass': mass * cell['tip mass'],
        'end_effector.inertia': mass * LENGTH**2 * cell['tip inertia'],
        'motor.mass': 0.0, 'initial.shaft_velocity': cell['speed'],
        'arm.damping_ratio': [cell['damping']],
        **({'carrier.held': HELD[cell['carrier']]} if cell['carrier'] in HELD else
           {'carrier.mass': cell['carrier']})}
    scene = timo_sim.load_scene(values)
    formulation = scene.build()
    if cell['modes']:
        shape = np.zeros(cell['modes'])
        shape[0] = cell['vibration'] / formulation.reach[3]
        values['initial.modal_coordinates'] = shape.tolist()
    values.update(_load(cell['load'], formulation, mass, cell['step']))
    values.update(_friction(cell['friction'], mass))
    if cell['friction'] in ('dry', 'sticky'):  # whose steps cannot be split
        values['integrator.tolerance'] = 0.0
    return timo_sim.load_scene(values)


def _load(kind, formulation, mass, step):
    torque = 0.3 * mass * LENGTH**2
    if kind == 'none':
        return {}
    if kind == 'torque':
        return {'load.torque.piecewise.time': [0.0, 0.2],
                'load.torque.piecewise.value': [torque, 0.0]}
    if kind == 'impulse':
        return {'load.torque.piecewise.time': [0.1, 0.12],
                'load.torque.piecewise.value': [20.0 * torque, 0.0]}
    if kind == 'spike':  # inside one of the cell's steps, and then one of its reference's
        begin = (round(0.1 / step) + 0.13) * step
        return {'load.torque.table.time': [begin, begin + 0.3 * step, begin + 0.4 * step],
                'load.torque.table.value': [0.0, torque / step, 0.0]}
    vibrating = np.sort(np.linalg.eigvals(formulation.linear).imag)
    vibrating = vibrating[vibrating > 1.0]  # carrier and shaft do not
    number = int(kind[-1]) - 1
    if number >= len(vibrating):
        return {}
    off = 1.05 if kind.startswith('near') else 1.0
    return {'load.torque.harmonic.amplitude': [torque],
            'load.torque.harmonic.frequency': [off * vibrating[number] / (2.0 * np.pi)]}


def _friction(kind, mass):
    if kind == 'none':
        return {}
    # Viscous: a second to come to rest, or a tenth of a millisecond. Dry: against what turns the
    # shaft by 30 degrees in a second, or a hundred times as much.
    law, size = {'viscous': ('viscous', 1.0), 'stiff': ('viscous', 1e4), 'dry': ('coulomb', 1.0),
                 'sticky': ('coulomb', 100.0)}[kind]
    return {f'carrier.{law}_friction': size * mass,
            f'motor.{law}_friction': size * mass * LENGTH**2 / 3.0}


def tip(scene, steps, every):
    """Return the path of the tip, shape (n, 2) [m], the run's warning and estimated error [m]."""
    run = sampled_run(scene, steps, every)
    return run.position(LENGTH), run.warning, run.stats['step_error_m']


def judge(cell):
    """
    Return what became of a cell, for fixed steps and for split ones.

    Returns
    -------
    list of tuple
        Verdict, error [m], reason, estimated error [m].

    """
    step = cell['step']
    # Less time for what costs more: a step takes about N^2.
    most = _MOST / max(1.0, cell['modes'] / 3.0)**2
    steps = max(20, math.floor(min(DURATION, most * step / 10.0) / step))
    every = max(1, steps // 20)
    steps -= steps % every
    try:
        fixed = scene_of(cell, step)
    except timo_sim.ParameterError as error:
        return [('refused', math.nan, str(error), math.nan)] * 2
    reference, doubt, _ = _reference(cell, step / 10.0, 10 * steps, 10 * every)
    found = []
    for scene in fixed, scene_of(cell, step, TOLERANCE):
        try:
            path, warning, estimate = tip(scene, steps, every)
        except timo_sim.DivergenceError as error:
            found.append(('refused', math.nan, str(error), math.nan))
            continue
        error = math.inf if reference is None else np.abs(path - reference).max()
        # A reference with a warning cannot tell a wrong run from a right one.
        verdict = ('accurate' if error <= ACCURATE else 'flagged' if warning or doubt else
                   'silent')
        found.append((verdict, error, warning or '', estimate))
    return found


def _reference(cell, step, steps, every):
    try:
        return tip(scene_of(cell, step, TOLERANCE / 1000.0), steps, every)
    except timo_sim.DivergenceError:
        return None, None, None


def matrix(count, seed=1):
    """Return what became of cells, with fixed and with split steps: two lists, as of `judge`."""
    return list(zip(*[judge(cell) for cell in cells(count, seed)]))


def rows(quick=False):
    """Yield the rows of the matrix, for steps as they are given and with a tolerance."""
    names = 'steps as given', f'with integrator.tolerance = {TOLERANCE:g} m'
    for name, found in zip(names, matrix(40 if quick else 400)):
        tally = Counter(verdict for verdict, *_ in found)
        false = sum(verdict == 'accurate' and bool(warning) for verdict, _, warning, _ in found)
        errors = [error for verdict, error, *_ in found if verdict == 'accurate']
        ratios = np.array([estimate / error for _, error, _, estimate in found
                           if 1e-6 * LENGTH < error < LENGTH])
        near = np.mean((0.2 < ratios) & (ratios < 5.0)) if len(ratios) else math.nan
        yield (name, len(found), *(tally[verdict] for verdict in VERDICTS),
               f'{false} of the accurate ones carry a warning; median of their errors '
               f'{np.median(errors):.1e} m; the estimated error is within a factor of five of '
               f'{100 * near:.0f} % of the {len(ratios)} errors above 1e-6 arm lengths')


def long_rows(quick=False):
    """Yield energy drift and error of momentum of scenes without loads, over an hour."""
    hour = 60.0 if quick else 3600.0
    for name, values in FREE.items():
        for formulation in 'exact', 'newton':
            scene = timo_sim.load_scene({'model.formulation': formulation, **values})
            try:
                run = sampled_run(scene, round(hour / scene.step), 1000)
            except timo_sim.DivergenceError as error:
                yield name, formulation, '', '', str(error).split(':')[0]
                continue
            energy, momentum = run.energy(), run.momentum()
            yield (name, formulation, f'{np.abs(energy / energy[0] - 1.0).max():.0e}',
                   f'{np.abs(momentum[:, :2] / momentum[0, :2] - 1.0).max():.0e}',
                   (run.warning or '').split(':')[0])


def main():
    """Print both tables."""
    quick = parser(__spec__, __doc__, 'a tenth').parse_args().quick
    for row in itertools.chain(rows(quick), long_rows(quick)):
        print('| ' + ' | '.join(map(str, row)) + ' |', flush=True)


if __name__ == '__main__':
    main()
