# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Run time against error, with other integrators and other engines in the same run.

`make benchmark` fills doc/benchmark.md and writes its plots and a JSON file with every figure;
`make benchmark-quick` (`--quick`) prints a small selection in less than two minutes.

The time is that of the solver alone, processor time of one thread, median over repetitions in
which all methods take turns. The error is the largest over the run against the extrapolated
finite-element reference, at its samples; root mean squares are stated, too.
"""

from functools import partial
from importlib.metadata import version
import json
import os
import subprocess
import sys
from tempfile import TemporaryDirectory
import warnings

import matplotlib.pyplot as plt
import numpy as np

from benchmark import ROOT
from benchmark.accuracy.cases import (
    cases_of, CHAIN, DISCRETE, ENGINE, errors_of, of_reference, REDUCED, ROD, SCENES, SOFT)
from benchmark.report import machine, make_page, table
from benchmark.timing import seconds
from oracles import elastica
import timo_sim

RIVALS = ('exudyn', 'mujoco-core', 'pyelastica', 'dismech-newton', 'soromox', 'jax')
FOLDER = ROOT / 'doc' / 'benchmark'
# What a new process does for 0.1 s of a scene, the scene first.
PAPER = "import timo_sim; scene = timo_sim.load_scene('config/paper.yaml'); "
CLAMPED = ('import timo_sim; from oracles.references import CANTILEVER; '
           'scene = timo_sim.load_scene(CANTILEVER); ')
RIVAL = 'from benchmark.accuracy import rivals; rivals.'
COLD = {
    'timo_sim': ('', PAPER + 'timo_sim.simulate(scene, 0.1, estimate=False)'),
    ENGINE: (PAPER, 'from oracles import finite_elements; '
                    'finite_elements.simulate(scene, 20, 1e-3, 0.1, 10)'),
    CHAIN: (PAPER, RIVAL + 'chain(scene, 10, 4e-4, 0.1, 25)'),
    ROD: (CLAMPED, RIVAL + 'elastica(scene, 20, 1e-5, 0.1, 2000)'),
    DISCRETE: (CLAMPED, RIVAL + 'dismech(scene, 20, 0.01, 0.1, 2)'),
    SOFT: (CLAMPED, 'from benchmark.accuracy import soft_rods; '
                    'soft_rods.soft_rod(scene, 3, 4e-3, 0.1, 5)')}
STYLES = dict(zip(
    ('exact', 'newton', 'newton_root_stress', 'RK4', 'implicit midpoint', 'generalized-alpha',
     'DOP853', 'Radau', ENGINE, REDUCED, CHAIN, ROD, DISCRETE, SOFT),
    zip('os^Dvp*hXP<>d8', (
        '#0072B2', '#E69F00', '#009E73', '#56B4E9', '#CC79A7', '#999999', '#000000', '#B8860B',
        '#D55E00', '#8B2500', '#4B0082', '#117733', '#AA4499', '#332288'))))


def measure(scene, quick):
    """Run all cases of a scene, taking turns; return the cases and the reference's comment."""
    comment, truth = of_reference(scene)
    cases = cases_of(scene, quick)
    budget, most = (1.0, 3) if quick else (2.0, 5)  # [s] for a case, and most repetitions of it
    for turn in range(most):
        for case in cases:
            if turn and (not case.errors or sum(case.times) * (1 + 1 / turn) > budget):
                continue
            result = case.run()
            if result is None:
                continue
            span, columns = result
            case.times.append(span)
            if not turn:
                step = case.order[1] if 'h =' in case.settings else 0.0
                with np.errstate(all='ignore'):
                    case.errors = errors_of(columns(), truth,
                                            max(1, round(step / scene.period)))
                if not np.isfinite(case.errors['w_l']) or case.errors['w_l'] > 1e3:
                    case.errors = None
        print(f'{scene.name}: turn {turn + 1} of {most}', flush=True)
    return cases, comment


def by_method(cases):
    """Return, by method, its cases that gave an error."""
    found = {case.method: [] for case in cases}
    for case in cases:
        if case.errors:
            found[case.method].append(case)
    return found


def goal_table(cases, goals):
    """Return the Markdown table of each method's cheapest case for errors of w(l)."""
    rows = []
    for method, good in by_method(cases).items():
        best = [min((case for case in good if case.errors['w_l'] <= goal),
                    key=lambda case: case.seconds, default=None) for goal in goals]
        rows.append([method, *(f'{case.seconds:.2g} s ({case.settings})' if case else
                               'not reached' for case in best)])
    return table(['cheapest for an error in w(l) of', *(f'{goal:g} m' for goal in goals)], rows)


def best_table(cases):
    """Return the Markdown table of each method's most accurate case, with both errors."""
    best = {method: min(good, key=lambda case: case.errors['w_l'])
            for method, good in by_method(cases).items() if good}
    return table(['most accurate of', 'settings', 'time', 'largest error in w(l)',
                  'root mean square'],
                 [(method, case.settings, f'{case.seconds:.2g} s', f'{case.errors["w_l"]:.1e} m',
                   f'{case.errors["w_l_rms"]:.1e} m') for method, case in best.items()])


def plot(scene, cases):
    """Draw error in the tip deflection against time."""
    figure, axis = plt.subplots(figsize=(10.5, 5.5), layout='constrained')
    found = by_method(cases)
    for method, (marker, colour) in STYLES.items():
        good = sorted(found.get(method, ()), key=lambda case: case.seconds)
        points = np.array([(case.seconds, case.errors['w_l']) for case in good]).reshape(-1, 2).T
        axis.loglog(*points, marker, color=colour, ms=3, alpha=0.3)
        # The cases that no other one beats in both time and error.
        best = points[:, points[1] < np.concatenate([
            [np.inf], np.minimum.accumulate(points[1])[:-1]])[:len(good)]]
        if good:
            axis.loglog(*best, marker + '-', color=colour, ms=5,
                        lw=2.2 if method == 'exact' else 1.2, label=method)
    axis.set(ylim=(1e-7, 1.0), xlabel='time of the solver [s]',
             ylabel='largest error of the tip deflection [m]')
    axis.set_title(f'{scene.title}: faint, all settings; lines, the best ones', fontsize=10)
    axis.grid(alpha=0.3)
    figure.legend(fontsize=8, loc='outside right upper')
    figure.savefig(FOLDER / f'{scene.name}.png', dpi=110)
    plt.close(figure)


def scene_part(scene, quick):
    """Return the part of the page about a scene; draw it, and write its figures."""
    cases, comment = measure(scene, quick)
    if not quick:
        plot(scene, cases)
        path = FOLDER / 'work_precision.json'
        found = json.loads(path.read_text()) if path.exists() else {'scenes': {}}
        found['machine'] = {**machine(), **{name: version(name) for name in RIVALS}}
        found['scenes'][scene.name] = {
            'reference': comment, 'goals': scene.goals,
            'cases': [{'method': case.method, 'settings': case.settings, 'errors': case.errors,
                       'seconds': case.times} for case in cases]}
        path.write_text(json.dumps(found, indent=1, default=str), encoding='utf-8')
    return '\n\n'.join([
        f'![Run time against error](benchmark/{scene.name}.png)', goal_table(cases, scene.goals),
        best_table(cases), f'Reference, an arm {scene.arm}: {comment}'])


def large_deflection(quick):
    """Return errors of an arm that rests bent by 60 degrees, by number of modes."""
    angle, rows = elastica.rows(3.2, (1, 3, 5) if quick else (1, 2, 3, 4, 5, 6, 8))
    return f'The tip turns by {angle:.1f} degrees.\n\n' + table(
        ['formulation', 'N', 'tip rotation, deg off', 'tip deflection, m off',
         'tip shortening, m off'], rows)


def cold_starts(quick):
    """Return the time from the start of a process to its first result."""
    rows = []
    for name, (scene, code) in COLD.items():
        with TemporaryDirectory() as folder:
            environment = {**os.environ, 'NUMBA_CACHE_DIR': folder, 'WARP_CACHE_PATH': folder,
                           'PYTHONPATH': os.pathsep.join([str(ROOT), str(ROOT / 'test')])}
            _, first, again = (seconds(lambda: subprocess.run(
                [sys.executable, '-c', text], check=True, cwd=ROOT, env=environment,
                capture_output=True)) for text in (scene, scene + code, scene + code))
        rows.append((name, f'{first:.1f} s', f'{again:.1f} s'))
    return table(['first result of a new process', 'for the first time', 'again'], rows)


PARTS = {**{scene.name: partial(scene_part, scene) for scene in SCENES},
         'large deflection': large_deflection, 'cold starts': cold_starts}

if __name__ == '__main__':
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    make_page(__spec__, __doc__, 'benchmark.md', PARTS, 'less than two minutes',
              **{name: partial(version, name) for name in RIVALS})
