# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Stress test of arms at rest under a load on a light tip, against equilibria that are not of modes.

Random clamped arms at rest (`initial.equilibrium`) under a torque, where the arm is an arc; under
a force across it, where a boundary value solver knows the tip; or pulled along, where the tip is
at L (1 + F / (E A)). The resistance to shear, kappa G A L^2 / (E I), is 20 to 1e5.
`python -m benchmark.stress.at_rest --kind torque --only 17` does number 17 of a kind alone.
"""

import json
import math

import numpy as np

from benchmark.report import parser
from oracles.elastica import boundary_value
import timo_sim
from timo_sim.runs.run import run_scene
from timo_sim.runs.simulate import measure_error

KINDS = {'torque': 300, 'force': 100, 'pull': 60}
_MODES, _PULLED_MODES = (3, 5, 8, 16, 36), (3, 38, 40)  # each number is compiled once
_SILENT, _SEEN, _FACTOR = 1e-3, 1e-7, 2.0
VERDICTS = 'tried', 'refused', 'silent', 'estimates within 2x', 'worst error', 'worst estimates'


def drawn(kind, number, seed=1):
    """Return the values of a random scene, and where its tip is [m]."""
    random = np.random.default_rng([seed, 4, list(KINDS).index(kind), number])

    def log(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    length, slenderness, young = log(0.1, 10.0), log(20.0, 300.0), log(1e8, 4e11)
    # kappa G A L^2 / (E I) is `bending` G / E, and G / E is below a half.
    bending = 12.0 * 0.85 * slenderness**2
    height, pulled = length / slenderness, kind == 'pull'
    values = {
        'arm.length': length, 'arm.section.height': height, 'arm.section.width': 2.0 * height,
        'arm.density': 2700.0, 'arm.young_modulus': young, 'arm.section.shear_correction': 0.85,
        'arm.shear_modulus': young * (  # an arm that resists shear less buckles when pulled, too
            0.35 if pulled else log(20.0, min(1e5, 0.5 * bending)) / bending),
        'model.modes': int(random.choice(_PULLED_MODES if pulled else _MODES)),
        'model.axial_modes': int(random.integers(4)) if pulled else 0,
        'model.static_modes': str(random.choice(['auto', 'none'])),
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'initial.shaft': 0.0,
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.equilibrium': True}
    if random.random() < 0.5 and not pulled:
        mass = 2700.0 * length * 2.0 * height**2 * log(1e-6, 1e-2)
        values.update({'end_effector.mass': mass,
                       'end_effector.inertia': mass * length**2 * log(1e-3, 0.2)})
    section = timo_sim.load_scene(values).manipulator.arm.section
    if pulled:
        strain = log(1e-4, 0.05)
        load, tip = strain * section.axial_stiffness, length * np.array([1.0 + strain, 0.0])
    elif kind == 'torque':
        turn = log(0.01, 1.5)
        load = turn * section.bending_stiffness / length
        tip = length * np.array([math.sin(turn), 1.0 - math.cos(turn)]) / turn
    else:
        load = 2.0 * log(0.01, 1.5) * section.bending_stiffness / length**2
        _, across, short = boundary_value(section, load, 0.0, length, stretches=True)
        tip = length * np.array([1.0 - short, across])
    channel = {'torque': 'tip_torque', 'force': 'tip_force_y', 'pull': 'tip_force_x'}[kind]
    return {**values, f'load.{channel}.piecewise.time': [0.0],
            f'load.{channel}.piecewise.value': [float(load)]}, tip


def judge(kind, number, seed=1):
    """Return what becomes of a scene: error and estimate [arm lengths], and its warning."""
    values, tip = drawn(kind, number, seed)
    found = {'number': number, 'modes': values['model.modes'],
             'axial': values['model.axial_modes'], 'static': values['model.static_modes']}
    try:
        run = measure_error(run_scene(timo_sim.load_scene(values), 4, 1))
    except (timo_sim.ParameterError, timo_sim.DivergenceError) as error:
        return {**found, 'error': math.nan, 'estimate': math.nan, 'warning': str(error)}
    error = float(np.hypot(*(run.position() - tip).T).max())
    estimate = run.stats.get('estimated_tip_error_m', math.nan)
    return {**found, 'error': error / values['arm.length'],
            'estimate': estimate / values['arm.length'], 'warning': run.warning}


def rows(quick=False):
    """Yield the rows of the table: kind, static modes and `VERDICTS`."""
    for kind, count in KINDS.items():
        found = [judge(kind, number) for number in range(count // 10 if quick else count)]
        for static in 'auto', 'none':
            yield kind, static, *counts([each for each in found if each['static'] == static])


def counts(found, seen=_SEEN):
    """Return `VERDICTS` of what was found; estimates are those of errors above `seen`."""
    error, estimate = (np.array([each[name] for each in found]) for name in ('error', 'estimate'))
    warned = np.array([bool(each['warning']) for each in found])
    doubt = np.array([each.get('doubt', 0.0) for each in found])  # about the reference
    known = (error > seen) & (doubt < error / 3.0) & np.isfinite(estimate)
    ratio = estimate[known] / error[known]
    near = (1.0 / _FACTOR < ratio) & (ratio < _FACTOR)
    return (len(found), int(np.isnan(error).sum()), int(((error > _SILENT) & ~warned).sum()),
            f'{near.sum()} of {len(ratio)}', f'{np.nanmax(error, initial=0.0):.1e}',
            f'{ratio.min():.2g} to {ratio.max():.2g}' if len(ratio) else '')


def print_some(spec, text, scene, judge, kinds=()):
    """Print random scenes that the command line names, and what is found of them."""
    words = parser(spec, text)
    if kinds:
        words.add_argument('--kind', choices=kinds, required=True)
    words.add_argument('--seed', type=int, default=1, help='of the random scenes')
    words.add_argument('--only', type=int, nargs='+', required=True, help='numbers of scenes')
    given = words.parse_args()
    for number in given.only:
        which = (*([given.kind] if kinds else []), number, given.seed)
        print(scene(*which))
        print(json.dumps(judge(*which)))


if __name__ == '__main__':
    print_some(__spec__, __doc__, lambda *which: json.dumps(drawn(*which)[0], indent=1), judge,
               KINDS)
