# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Run time against error, with other integrators and another engine in the same run.

`make benchmark` writes doc/benchmark.md, its plots and a JSON file with every figure;
`make benchmark-quick` (`--quick`) a small selection in less than two minutes, to run/benchmark.

The time is that of the solver alone, processor time of one thread, median over repetitions in
which all methods take turns. The error is the largest over the run against the extrapolated
finite-element reference, at its samples; root mean squares are stated, too.
"""

import os
for threads in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'NUMBA_NUM_THREADS'):
    os.environ[threads] = '1'

from importlib.metadata import version  # noqa: E402
import json  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
from tempfile import TemporaryDirectory  # noqa: E402
import time  # noqa: E402
import warnings  # noqa: E402

import matplotlib  # noqa: E402
matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from benchmark import ROOT  # noqa: E402
from benchmark.accuracy.cases import (  # noqa: E402
    cases_of, CHAIN, ENGINE, errors_of, of_reference, REDUCED, SCENES)
from benchmark.accuracy.rod_cases import DISCRETE, ROD, rods_of, SOFT  # noqa: E402
from benchmark.command import parser  # noqa: E402
from benchmark.report import machine  # noqa: E402
from oracles import elastica  # noqa: E402
import timo_sim  # noqa: E402

RIVALS = ('exudyn', 'mujoco-core', 'pyelastica', 'dismech-newton', 'soromox', 'jax')
# What a new process does for 0.1 s of a scene, the scene first.
PAPER = "import timo_sim; scene = timo_sim.load_scene('config/paper.yaml'); "
CLAMPED = ('import timo_sim; from oracles.references import CANTILEVER; '
           'scene = timo_sim.load_scene(CANTILEVER); ')
COLD = {
    'timo_sim': ('', PAPER + 'timo_sim.simulate(scene, 0.1, estimate=False)'),
    ENGINE: (PAPER, 'from oracles import finite_elements; '
                    'finite_elements.simulate(scene, 20, 1e-3, 0.1, 10)'),
    CHAIN: (PAPER, 'from benchmark.accuracy import rivals; '
                   'rivals.chain(scene, 10, 4e-4, 0.1, 25)'),
    ROD: (CLAMPED, 'from benchmark.accuracy import rods; '
                   'rods.elastica(scene, 20, 1e-5, 0.1, 2000)'),
    DISCRETE: (CLAMPED, 'from benchmark.accuracy import rods; '
                        'rods.dismech(scene, 20, 0.01, 0.1, 2)'),
    SOFT: (CLAMPED, 'from benchmark.accuracy import soft_rods; '
                    'soft_rods.soft_rod(scene, 1, 4e-3, 0.1, 5, order=3)')}


def measure(scene, quick):
    """Run all cases of a scene, taking turns; return the cases and the reference's comment."""
    comment, truth = of_reference(scene)
    cases = cases_of(scene, quick) + rods_of(scene, quick)
    budget, most = (1.0, 3) if quick else (2.0, 5)  # [s] for a case, and most repetitions of it
    for turn in range(most):
        for case in cases:
            if turn and (not case.errors or sum(case.times) * (1 + 1 / turn) > budget):
                continue
            result = case.run()
            if result is None:
                continue
            seconds, columns = result
            case.times.append(seconds)
            if not turn:
                step = case.order[1] if 'h =' in case.settings else 0.0
                with np.errstate(all='ignore'):
                    case.errors = errors_of(columns(), truth,
                                            max(1, round(step / scene.period)))
                if not np.isfinite(case.errors['w_l']) or case.errors['w_l'] > 1e3:
                    case.errors = None
        print(f'{scene.name}: turn {turn + 1} of {most}', flush=True)
    return cases, comment


def cheapest(cases, method, goal):
    """Return the cheapest case of a method with at most this error in the tip deflection."""
    good = [case for case in cases if case.method == method and case.errors
            and case.errors['w_l'] <= goal]
    return min(good, key=lambda case: case.seconds, default=None)


def shown(case):
    """Return a case as text."""
    return f'{case.seconds:.2g} s ({case.settings})' if case else 'not reached'


def goal_table(cases, goals):
    """Return the Markdown table of the cheapest cases."""
    methods = list(dict.fromkeys(case.method for case in cases))
    lines = ['| cheapest for an error in w(l) of | ' + ' | '.join(f'{goal:g} m' for goal in goals)
             + ' |', '|---|' + '---|' * len(goals)]
    for method in methods:
        lines.append(f'| {method} | ' + ' | '.join(
            shown(cheapest(cases, method, goal)) for goal in goals) + ' |')
    return '\n'.join(lines)


def front(cases):
    """Return the cases that no other case beats in both time and error, sorted by time."""
    best, result = np.inf, []
    for case in sorted(cases, key=lambda case: case.seconds):
        if case.errors['w_l'] < best:
            best = case.errors['w_l']
            result.append(case)
    return result


def best_table(cases):
    """Return the Markdown table of each method's most accurate case, with both errors."""
    lines = ['| most accurate of | settings | time | largest error in w(l) | root mean square |',
             '|---|---|---|---|---|']
    for method in dict.fromkeys(case.method for case in cases):
        good = [case for case in cases if case.method == method and case.errors]
        if good:
            case = min(good, key=lambda case: case.errors['w_l'])
            lines.append(f'| {method} | {case.settings} | {case.seconds:.2g} s | '
                         f'{case.errors["w_l"]:.1e} m | {case.errors["w_l_rms"]:.1e} m |')
    return '\n'.join(lines)


def cold_starts():
    """Return the Markdown table of the time from the start of a process to its first result."""
    lines = ['| first result of a new process | for the first time | again |', '|---|---|---|']
    for name, (scene, code) in COLD.items():
        with TemporaryDirectory() as folder:
            environment = {**os.environ, 'NUMBA_CACHE_DIR': folder, 'WARP_CACHE_PATH': folder,
                           'PYTHONPATH': os.pathsep.join([str(ROOT), str(ROOT / 'test')])}
            times = []
            for text in (scene, scene + code, scene + code):
                start = time.perf_counter()
                subprocess.run([sys.executable, '-c', text], check=True, cwd=ROOT,
                               env=environment, capture_output=True)
                times.append(time.perf_counter() - start)
            lines.append(f'| {name} | {times[1]:.1f} s | {times[2]:.1f} s |')
    return '\n'.join(lines)


def plot(scene, cases, path):
    """Draw error in the tip deflection against time."""
    colours = {'exact': '#0072B2', 'newton': '#E69F00', 'newton_root_stress': '#009E73',
               'RK4': '#56B4E9', 'implicit midpoint': '#CC79A7', 'generalized-alpha': '#999999',
               'DOP853': '#000000', 'Radau': '#B8860B', ENGINE: '#D55E00', REDUCED: '#8B2500',
               CHAIN: '#4B0082', ROD: '#117733', DISCRETE: '#AA4499', SOFT: '#332288'}
    markers = dict(zip(colours, 'os^Dvp*hXP<>d8'))
    figure, axis = plt.subplots(figsize=(10.5, 5.5), layout='constrained')
    for method, colour in colours.items():
        good = [case for case in cases if case.method == method and case.errors]
        if not good:
            continue
        axis.loglog([case.seconds for case in good], [case.errors['w_l'] for case in good],
                    markers[method], color=colour, ms=3, alpha=0.3)
        best = front(good)
        axis.loglog([case.seconds for case in best], [case.errors['w_l'] for case in best],
                    markers[method] + '-', color=colour, ms=5,
                    lw=2.2 if method == 'exact' else 1.2, label=method)
    axis.set_ylim(1e-7, 1.0)
    axis.set_xlabel('time of the solver [s]')
    axis.set_ylabel('largest error of the tip deflection [m]')
    axis.set_title(f'{scene.title}: faint, all settings; lines, the best ones', fontsize=10)
    axis.grid(alpha=0.3)
    figure.legend(fontsize=8, loc='outside right upper')
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main():
    """Measure, and write the page, the plots and the figures."""
    command = parser(__spec__, __doc__, 'less than two minutes')
    command.add_argument('--scene', choices=[scene.name for scene in SCENES], action='append')
    arguments = command.parse_args()
    folder = ROOT / 'run' / 'benchmark' if arguments.quick or arguments.scene else ROOT / 'doc'
    pictures = folder / 'benchmark'
    pictures.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    facts, sections, record = machine(), [], {}
    facts.update((name, version(name)) for name in RIVALS)
    for scene in SCENES:
        if arguments.scene and scene.name not in arguments.scene:
            continue
        cases, comment = measure(scene, arguments.quick)
        table = goal_table(cases, scene.goals)
        plot(scene, cases, pictures / f'{scene.name}.png')
        sections.append(f'## {scene.title[0].upper()}{scene.title[1:]}\n\n'
                        f'![Run time against error](benchmark/{scene.name}.png)\n\n{table}\n\n'
                        f'{best_table(cases)}\n\n'
                        f'Reference, an arm {scene.arm}: {comment}\n')
        record[scene.name] = {
            'reference': comment, 'goals': scene.goals,
            'cases': [{'method': case.method, 'settings': case.settings, 'errors': case.errors,
                       'seconds': case.times} for case in cases]}
        print(sections[-1], flush=True)
    angle, rows = elastica.rows(3.2, (1, 3, 5) if arguments.quick else (1, 2, 3, 4, 5, 6, 8))
    body = '\n'.join('| ' + ' | '.join(map(str, row)) + ' |' for row in rows)
    sections.append(f"""## Large deflection, tip rotation {angle:.1f} deg

A 2 m arm, 5 mm high, bent by the inertia of its 2 kg end effector (`test/oracles/elastica.py`):
critically damped until it rests in the accelerating frame, against SciPy's boundary value solver
for the same arm, which itself agrees with the closed form of the elastica where shear and
the arm's mass do nothing.

| formulation | N | tip rotation, deg off | tip deflection, m off | tip shortening, m off |
|---|---|---|---|---|
{body}
""")
    sections.append(f"""## From nothing to a first result

A new process reads the paper's scene, or the clamped arm for the rods, and does 0.1 s of it:
imports, assembly and compilation. "Again", machine code is on disk, of those that keep it. The
first start of an engine finds the code of timo_sim that reads the scene.

{cold_starts()}
""")
    print(sections[-2], sections[-1])
    (pictures / 'work_precision.json').write_text(json.dumps(
        {'machine': facts, 'scenes': record}, indent=1, default=str), encoding='utf-8')
    introduction = __doc__.strip().split('\n\n')[-1].replace('\n', ' ')
    (folder / 'benchmark.md').write_text(
        f'# Run time against error\n\nMade by `make benchmark`. {introduction}\n\n'
        f'Measured on: {", ".join(f"{name} {value}" for name, value in facts.items())}. '
        'Every figure is in `benchmark/work_precision.json`. RK4, the implicit midpoint rule, '
        'generalized-alpha (both with the linear part solved for), DOP853 and Radau '
        'integrate the equations of `exact`; the first three are compiled as this package is, '
        'the last two call the compiled rate from SciPy. exudyn runs with the settings that were '
        'fastest in `test/oracles/engine.py`; its times exclude the assembly of the '
        'model, those of this package the tables of a scene. MuJoCo is what a user might '
        'take instead (`benchmark/accuracy/rivals.py`): a chain of rigid links with springs in '
        'its longest stable Runge-Kutta step, whose length does not change the errors. '
        'PyElastica, dismech-newton and soromox (`rods.py`, `soft_rods.py` beside it) have here '
        'neither a free carrier nor an end effector: they are in the two scenes of a held arm, '
        'with the best settings that a search by hand found. PyElastica is faster with more '
        'rotary inertia than the arm has (`rho I`), both rods with another stretch stiffness '
        '(`E A`); the settings say so. dismech-newton computes in single precision and without '
        'shear, soromox here without shear and stretch. Single runs are not the best that a '
        'rival can do: errors of second order cancel in two runs extrapolated, and the table '
        'below, by `make benchmark-pair`, has that for exudyn. In the tables after it, errors of '
        'the mesh and of the step may cancel by chance, and no ratio is stated.\n\n'
        "## The paper's scene, the best of exudyn's runs and pairs\n\n"
        '<!-- table: benchmark -->\n<!-- end -->\n\n' + '\n'.join(sections), encoding='utf-8')


if __name__ == '__main__':
    main()
