# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Stress test of the numerics: random scenes (`scenes.py`) against references (`truth.py`).

`python -m benchmark.stress.numerics --seed 1 --only 17` does number 17 of a seed alone. Of a whole
part of the page all findings go to run/stress_cells.jsonl, and those that are silent or badly
estimated are printed. It also tests linear models of arms with heavy tips, and an hour without
loads.
"""

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
import functools
import json
import math
import multiprocessing
import time

import numpy as np

from benchmark import ROOT
from benchmark.report import parser
from benchmark.stress.scenes import cell, hard_cell, laden_cell
from benchmark.stress.truth import judge, SEEN, VERDICTS
from oracles.linear_beam import LinearBeam
import timo_sim
from timo_sim.runs.run import run_scene

PROCESSES = 2
_FACTOR = 5.0  # a good estimate is within this factor of the true error
LISTED = ROOT / 'run' / 'stress_cells.jsonl'
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
_CAUSES = ('torque_N_m', 'force_y_N', 'tip_force_y_N', 'tip_torque_N_m')
OUTPUTS = ('tip_y_m', 'tip_transverse_m', 'tip_rotation_rad', 'root_strain')


def judged(number, make=cell, seed=1):
    """Return what `truth.judge` finds of a Cell; unexpected errors count as silent."""
    begun = time.process_time()
    try:
        found = judge(make(number, seed))
    except Exception as error:
        found = [{'number': number, 'kind': 'crash', 'family': 'exact',
                  'against': 'finer', 'verdict': 'silent', 'error': math.inf, 'estimate': math.nan,
                  'doubt': 0.0, 'warning': f'{type(error).__name__}: {error}',
                  'sensitive': False}]
    return [{**each, 'seconds': time.process_time() - begun} for each in found]


def ratio(found):
    """Return estimated over true error, each at most a length, or None if this is not known."""
    if found['verdict'] in ('refused', 'open') or math.isnan(found['estimate']) or not (
            found['error'] > SEEN and found['doubt'] < found['error'] / 3.0):
        return None  # an estimate is NaN where finer runs diverge, which the run says
    return min(found['estimate'], 1.0) / min(found['error'], 1.0)


def is_listed(found):
    """Return whether a finding is silent or badly estimated."""
    told = ratio(found)
    return found['verdict'] == 'silent' or (
        told is not None and not 1.0 / _FACTOR < told < _FACTOR)


def rows(count, make=cell):
    """Yield the rows of the table of the first scenes that `make` draws, see `scenes`."""
    LISTED.parent.mkdir(exist_ok=True)
    groups = {}
    with LISTED.open('w', encoding='utf-8') as file, ProcessPoolExecutor(
            PROCESSES, multiprocessing.get_context('spawn')) as pool:
        for each in pool.map(functools.partial(judged, make=make), range(count)):
            for found in each:
                print(json.dumps(found), file=file, flush=True)
                groups.setdefault((found['family'], found['against']), []).append(found)
                if is_listed(found):
                    print(*(found[name] for name in (
                        'number', 'kind', 'against', 'verdict', 'error', 'estimate')), sep=', ')
    for names, group in sorted(groups.items()):
        yield *names, len(group), *_counts(group), _remark(group)


def _counts(group):
    tally = Counter(each['verdict'] for each in group)
    return [tally[verdict] for verdict in VERDICTS]


def _remark(group):
    accurate = [each for each in group if each['verdict'] == 'accurate']
    told = np.array([number for number in map(ratio, group) if number is not None])
    near = (1.0 / _FACTOR < told) & (told < _FACTOR)
    opened = [each for each in group if each['verdict'] == 'open']
    text = (f'{sum(bool(each["warning"]) for each in accurate)} accurate ones carry a warning; '
            f'{sum(each["sensitive"] for each in opened)} open ones are sensitive, '
            f'{sum(not each["warning"] for each in opened)} without a warning')
    if len(told):
        text += (f'; the estimate is within a factor of five of {100 * near.mean():.0f} % of '
                 f'{len(told)} errors above 1e-6, and {told.min():.1g} to {told.max():.1g} times '
                 'the error')
    return text


def linear_rows(quick=False, seed=1):
    """Yield errors of the frequency responses of arms with heavy tips, by number of modes."""
    count = 20 if quick else 200
    for modes in (3, 5, 8):
        errors = [linear_errors(number, modes, seed) for number in range(count)]
        yield (modes, count, *(f'{np.median(each):.0e}, {max(each):.0e}'
                               for each in zip(*errors)))


def linear_errors(number, modes, seed=1):
    """
    Return the largest errors of a random arm with a heavy tip, for each of `OUTPUTS`.

    From a tenth of the first clamped frequency up to the second, relative to the response there
    or, beside antiresonances, to a hundredth of its median.
    """
    random = np.random.default_rng([seed, 1, number])

    def log(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    values = cell(5 * number, seed).values
    values = {name: value for name, value in values.items() if name.startswith(('arm.', 'motor.m',
                                                                                'carrier.mass'))}
    mass = values['arm.density'] * math.prod(values[f'arm.{side}'] for side in (
        'length', 'section.width', 'section.height'))
    held, locked = (bool(random.integers(2)) for _ in range(2))
    free = timo_sim.load_scene({}, {
        **values, 'model.modes': modes, 'initial.shaft': 0.0,
        'model.formulation': ['exact', 'newton'][random.integers(2)],
        'arm.damping_ratio': [], 'carrier.held': 'both' if held else 'none',
        'motor.shaft': 'locked' if locked else 'free',
        'motor.shaft_inertia': mass * values['arm.length']**2 * log(1e-3, 10.0),
        'end_effector.mass': mass * log(1.0, 1e3),
        'end_effector.inertia': mass * values['arm.length']**2 * log(0.1, 100.0)})
    omega = free.build().modes.omega
    damping = 0.1 / omega[-1]  # [s]: a twentieth of critical for the highest mode
    scene = free.vary({'arm.damping_ratio': (0.5 * damping * omega).tolist()})
    causes = [cause for cause in timo_sim.linearize(scene).inputs if cause in _CAUSES]
    cause = causes[random.integers(len(causes))]
    beam = LinearBeam(scene, held=held, locked=locked, stress_damping=damping, elements=2)
    frequencies = omega[0] * np.geomspace(0.1, omega[1] / omega[0], 40) / (2.0 * np.pi)
    found = timo_sim.linearize(scene).select([cause], list(OUTPUTS)).frequency_response(
        frequencies)[:, :, 0]
    expected = [beam.response(cause, frequency) for frequency in frequencies]
    expected = np.array([[each[name] for name in OUTPUTS] for each in expected])
    size = np.maximum(np.abs(expected), 0.01 * np.median(np.abs(expected), axis=0))
    return (np.abs(found - expected) / size).max(axis=0)


def by_hand_rows(quick=False, seed=1):
    """Yield largest errors of gains and frequencies that are known by hand, and refusals."""
    for name, errors in ('measured section', section_errors), ('gear with backlash', gear_errors):
        found = [errors(np.random.default_rng([seed, 3, number]))
                 for number in range(10 if quick else 100)]
        yield name, len(found), *(f'{each:.0e}' for each in np.max(found, axis=0))


def section_errors(random):
    """Return errors of gain and first three frequencies of a beam of Euler and Bernoulli."""
    length, first, mass = np.exp(random.uniform([-2.0, -1.0, -3.0], [3.4, 6.0, 8.0]))
    stiffness = mass * (first * length**2 / 1.87510407**2)**2
    scene = timo_sim.load_scene({
        'arm.length': length, 'arm.section.bending_stiffness': stiffness,
        'arm.section.mass_per_length': mass, 'arm.section.height': 0.01 * length,
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0, 'model.modes': 3,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0})
    gain = timo_sim.linearize(scene).select(['tip_force_y_N'], ['tip_y_m']).frequency_response(
        [0.0])[0, 0, 0].real
    wave = np.array([1.87510407, 4.69409113, 7.85475744])
    omega = wave**2 * math.sqrt(stiffness / mass) / length**2
    return (abs(gain * 3.0 * stiffness / length**3 - 1.0),
            np.abs(timo_sim.modes(scene).omega[:3] / omega - 1.0).max())


def gear_errors(random):
    """Return errors of the shaft's gain far above, and of the frequency of two bodies."""
    spring, inertia, rotor, play = np.exp(random.uniform([2.0, -5.0, -7.0, -7.0],
                                                         [8.0, 1.0, 0.0, -2.0]))
    scene = timo_sim.load_scene({}, {
        'arm.length': 0.4, 'model.modes': 0, 'carrier.held': 'both', 'initial.shaft': 0.0,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'motor.shaft_inertia': inertia,
        'motor.gear.stiffness': spring, 'motor.rotor.inertia': rotor,
        'motor.gear.backlash': play, 'integrator.step': 1e-6})
    for look in timo_sim.linearize, timo_sim.modes:
        try:
            look(scene)
        except timo_sim.ParameterError:
            continue
        return math.inf, math.inf  # it must name the contact
    arm, section = scene.manipulator.arm, scene.manipulator.arm.section
    whole = (inertia + section.mass_per_length * arm.length**3 / 3.0
             + section.inertia_per_length * arm.length)
    omega = math.sqrt(spring * (1.0 / whole + 1.0 / rotor))
    linear = timo_sim.linearize(scene, contact='closed').select(['torque_N_m'], ['shaft_rad'])
    slow = 0.01 * omega
    gain = linear.frequency_response([slow / (2.0 * math.pi)])[0, 0, 0].real
    return (abs(gain * -(whole + rotor) * slow**2 * (1.0 - 1e-4) - 1.0),
            abs(timo_sim.modes(scene, contact='closed').omega[0] / omega - 1.0))


def long_rows(quick=False):
    """Yield energy drift and error of momentum of scenes without loads, over an hour."""
    hour = 60.0 if quick else 3600.0
    for name, values in FREE.items():
        for formulation in 'exact', 'newton':
            scene = timo_sim.load_scene({}, {'model.formulation': formulation, **values})
            try:
                run = run_scene(scene, round(hour / scene.step), 1000)
            except timo_sim.DivergenceError as error:
                yield name, formulation, '', '', str(error).split(':')[0]
                continue
            energy, momentum = run.energy(), run.momentum()
            yield (name, formulation, f'{np.abs(energy / energy[0] - 1.0).max():.0e}',
                   f'{np.abs(momentum[:, :2] / momentum[0, :2] - 1.0).max():.0e}',
                   (run.warning or '').split(':')[0])


def main():
    """Print what is found of some scenes."""
    words = parser(__spec__, __doc__)
    words.add_argument('--seed', type=int, default=1, help='of the random scenes')
    words.add_argument('--only', type=int, nargs='+', required=True, help='numbers of scenes')
    kinds = words.add_mutually_exclusive_group()
    for name, make in ('laden', laden_cell), ('hard', hard_cell):
        kinds.add_argument(f'--{name}', dest='make', action='store_const', const=make,
                           help=make.__doc__.strip().split('\n')[0])
    given = words.parse_args()
    make = given.make or cell
    for number in given.only:
        print(json.dumps(make(number, given.seed)._asdict(), indent=1))
        for found in judged(number, make, given.seed):
            print(json.dumps(found))


if __name__ == '__main__':
    main()
