"""
Run time against error, with other integrators and another engine in the same run.

`make benchmark` writes doc/benchmark.md, its plots and a JSON file with every figure;
`make benchmark-quick` (`--quick`) a small selection in less than two minutes, to run/benchmark.

The time is that of the solver alone, processor time of one thread, median over repetitions in
which all methods take turns. The error is the largest over the run against the extrapolated
finite-element reference, at its samples.
"""

import os
for threads in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'NUMBA_NUM_THREADS'):
    os.environ[threads] = '1'

import argparse  # noqa: E402
from dataclasses import dataclass, field  # noqa: E402
import json  # noqa: E402
import platform  # noqa: E402
import statistics  # noqa: E402
import time  # noqa: E402
from typing import Callable  # noqa: E402
import warnings  # noqa: E402

import elastica  # noqa: E402
import exudyn  # noqa: E402
import finite_elements  # noqa: E402
import matplotlib  # noqa: E402
matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
import numba  # noqa: E402
import numpy as np  # noqa: E402
import peers  # noqa: E402
from references import read, ROOT, spin_up, TORQUE  # noqa: E402
import scipy  # noqa: E402

import timo_sim  # noqa: E402
from timo_sim.physics import FORMULATIONS  # noqa: E402
from timo_sim.simulation import Simulator  # noqa: E402

GOALS = (1e-3, 1e-4, 1e-5)  # errors in the tip deflection of the headline [m]
OWN = tuple(FORMULATIONS)
ENGINE, REDUCED = 'exudyn, geometrically exact', 'exudyn, reduced floating frame'


@dataclass
class Scene:
    """A scene with its reference."""

    name: str
    title: str
    source: object      # for `load_scene`
    duration: float     # [s]
    period: float       # of the reference [s]
    drive: tuple | None
    columns: dict = field(default_factory=dict)

    def load(self, **overrides):
        """Return the scene with overrides, dots written as double underscores."""
        values = {name.replace('__', '.'): value for name, value in overrides.items()}
        return timo_sim.load_scene(self.source, values)

    @property
    def length(self):
        """Length of the arm [m]."""
        return self.load().manipulator.arm.length


SCENES = [
    Scene('paper', "the paper's scene, Table 4, 10 s", ROOT / 'config' / 'paper.yaml', 10.0,
          0.01, None),
    Scene('torque', 'torque steps, +20, -20, 0 N m, 5 s', TORQUE, 5.0, 0.01, None),
    Scene('spin_up', 'spin-up of a 10 m arm, 20 s', ROOT / 'config' / 'spin_up.yaml', 20.0, 0.02,
          spin_up()),
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
    """Return what errors are taken of: theta, tip deflection and tip position."""
    cosine, sine = np.cos(theta), np.sin(theta)
    position = carrier + np.column_stack([cosine * along - sine * across,
                                          sine * along + cosine * across])
    return {'theta': theta, 'w_l': across, 'tip': position}


def of_motions(model, scene, motions):
    """Return the same of motions, shape (n, 2 (3 + N))."""
    tip = model.at([scene.length])
    count = len(model.modes)
    place = model.centre_line(motions[:, 3:3 + count], tip)[:, 0]
    return tip_columns(motions[:, 2], motions[:, :2], *place.T)


def of_reference(scene):
    """Return the same of the stored reference, and its comment."""
    comment, stored = read(scene.name)
    theta = stored.get('theta_rad')
    carrier = np.zeros((len(stored['t']), 2))
    if theta is None:
        theta = np.array([scene.drive[0](t) for t in stored['t']])
    else:
        carrier = np.column_stack([stored['x_c_m'], stored['y_c_m']])
    return comment, tip_columns(theta, carrier, scene.length + stored['u_l_m'], stored['w_l_m'])


def errors_of(columns, truth, stride):
    """Return the largest differences from every stride-th sample of the reference."""
    result = {}
    for name, values in columns.items():
        difference = values - truth[name][stride::stride][:len(values)]
        size = np.abs(difference) if difference.ndim == 1 else np.hypot(*difference.T)
        result[name] = float(size.max())
    return result


def own_case(scene, formulation, modes, step):
    """Return a case of this package."""
    period = max(scene.period, step)
    simulator = Simulator(scene.load(model__formulation=formulation, model__modes=modes,
                                     integrator__step=step))
    simulator.warm_up()

    def run():
        simulator.reset()
        steps, every = round(scene.duration / step), round(period / step)
        samples = np.empty((steps // every, simulator.formulation.size))
        start = time.process_time()
        try:
            simulator.advance(simulator.scene_loads(steps), every, samples)
        except timo_sim.DivergenceError:
            return None
        seconds = time.process_time() - start
        return seconds, lambda: of_motions(simulator.formulation, scene, samples)
    return Case(formulation, f'N = {modes}, h = {1e3 * step:g} ms', run, (modes, step))


def fixed_step_case(scene, method, modes, step):
    """Return a case of a compiled peer on the `exact` equations."""
    checked = scene.load(model__modes=modes, integrator__step=step)
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
    checked = scene.load(model__modes=modes)
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
    checked = scene.load(initial__shaft=0.0) if scene.drive else scene.load()

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
        found = finite_elements.reduced(checked, modes, step, scene.duration,
                                        round(scene.period / step))
        theta = found['theta_rad'][1:]
        carrier = np.column_stack([found['x_c_m'], found['y_c_m']])[1:]
        return found['solver_seconds'], lambda: tip_columns(
            theta, carrier, np.full(len(theta), scene.length), found['w_l_m'][1:])
    return Case(REDUCED, f'{modes} modes, h = {1e3 * step:g} ms', run, (modes, step))


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
    if not scene.drive:
        cases += [reduced_case(scene, modes, step) for modes in ((5,) if quick else (3, 5, 8))
                  for step in ([0.001] if quick else [0.005, 0.002, 0.001, 0.0005])]
    return cases


def measure(scene, quick):
    """Run all cases of a scene, taking turns; return the cases and the reference's comment."""
    comment, truth = of_reference(scene)
    cases = cases_of(scene, quick)
    budget, most = (1.0, 3) if quick else (2.0, 5)  # [s] for a case, and its repetitions
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


def cheapest(cases, method, goal, lasting=False):
    """
    Return the cheapest case of a method with at most this error in the tip deflection.

    Errors of the mesh and of the step have opposite signs and can cancel; with `lasting`, all
    finer cases must be as good.
    """
    cases = [case for case in cases if case.method == method]
    good = [case for case in cases if case.errors and case.errors['w_l'] <= goal]
    if lasting:
        good = [case for case in good if all(
            other in good for other in cases
            if other.order[0] >= case.order[0] and other.order[1] <= case.order[1])]
    return min(good, key=lambda case: case.seconds, default=None)


def shown(case):
    """Return a case as text."""
    return f'{case.seconds:.2g} s ({case.settings})' if case else 'not reached'


def goal_table(cases):
    """Return the Markdown table of the cheapest cases, and the ratios to exudyn by goal."""
    methods = list(dict.fromkeys(case.method for case in cases))
    lines = ['| cheapest for an error in w(l) of | ' + ' | '.join(f'{goal:g} m' for goal in GOALS)
             + ' |', '|---|' + '---|' * len(GOALS)]
    for method in methods:
        lines.append(f'| {method} | ' + ' | '.join(
            shown(cheapest(cases, method, goal)) for goal in GOALS) + ' |')
    lines.append(f'| {ENGINE}, lasting | ' + ' | '.join(
        shown(cheapest(cases, ENGINE, goal, lasting=True)) for goal in GOALS) + ' |')
    ratios = {}
    for name, own, lasting in (('exudyn over `exact`', ('exact',), False),
                               ('exudyn over the cheapest formulation', OWN, False),
                               ('exudyn over `exact`, both lasting', ('exact',), True)):
        ratios[name] = []
        for goal in GOALS:
            engine = cheapest(cases, ENGINE, goal, lasting)
            ours = min((case.seconds for case in (cheapest(cases, formulation, goal, lasting)
                                                  for formulation in own) if case), default=None)
            ratios[name].append(engine.seconds / ours if engine and ours else None)
        lines.append(f'| **{name}** | ' + ' | '.join(
            f'**{ratio:.0f}**' if ratio else '-' for ratio in ratios[name]) + ' |')
    return '\n'.join(lines), ratios


def front(cases):
    """Return those cases that no other one beats in both time and error, by time."""
    best, result = np.inf, []
    for case in sorted(cases, key=lambda case: case.seconds):
        if case.errors['w_l'] < best:
            best = case.errors['w_l']
            result.append(case)
    return result


def plot(scene, cases, path):
    """Draw error in the tip deflection against time."""
    colours = {'exact': '#0072B2', 'newton': '#E69F00', 'newton_root_stress': '#009E73',
               'RK4': '#56B4E9', 'implicit midpoint': '#CC79A7', 'generalized-alpha': '#999999',
               'DOP853': '#000000', 'Radau': '#B8860B', ENGINE: '#D55E00', REDUCED: '#8B2500'}
    markers = dict(zip(colours, 'os^Dvp*hXP'))
    figure, axis = plt.subplots(figsize=(8.5, 5.5))
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
    axis.set_ylim(1e-8, 10.0)
    axis.set_xlabel('time of the solver [s]')
    axis.set_ylabel('largest error of the tip deflection [m]')
    axis.set_title(f'{scene.title}: faint, all settings; lines, the best ones', fontsize=10)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc='upper right')
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def machine():
    """Return what this was measured on."""
    try:
        with open('/proc/cpuinfo', encoding='utf-8') as file:
            model = next(line.split(':')[1].strip() for line in file if 'model name' in line)
    except (OSError, StopIteration):
        model = platform.processor()
    return {'processor': model, 'cores': os.cpu_count(), 'machine': platform.machine(),
            'python': platform.python_version(), 'numpy': np.__version__,
            'scipy': scipy.__version__, 'numba': numba.__version__,
            'exudyn': exudyn.__version__, 'timo_sim': timo_sim.__version__}


def main():
    """Measure, and write the page, the plots and the figures."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--quick', action='store_true', help='less than two minutes')
    parser.add_argument('--scene', choices=[scene.name for scene in SCENES], action='append')
    arguments = parser.parse_args()
    folder = ROOT / 'run' / 'benchmark' if arguments.quick or arguments.scene else ROOT / 'doc'
    pictures = folder / 'benchmark'
    pictures.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    facts, sections, record = machine(), [], {}
    for scene in SCENES:
        if arguments.scene and scene.name not in arguments.scene:
            continue
        cases, comment = measure(scene, arguments.quick)
        table, ratios = goal_table(cases)
        plot(scene, cases, pictures / f'{scene.name}.png')
        sections.append(f'## {scene.title[0].upper()}{scene.title[1:]}\n\n'
                        f'![Run time against error](benchmark/{scene.name}.png)\n\n{table}\n\n'
                        f'Reference: {comment}\n')
        record[scene.name] = {
            'reference': comment, 'goals': GOALS, 'ratios': ratios,
            'cases': [{'method': case.method, 'settings': case.settings, 'errors': case.errors,
                       'seconds': case.times} for case in cases]}
        print(sections[-1], flush=True)
    angle, rows = elastica.rows(3.2, (1, 3, 5) if arguments.quick else (1, 2, 3, 4, 5, 6, 8))
    body = '\n'.join('| ' + ' | '.join(map(str, row)) + ' |' for row in rows)
    sections.append(f"""## Large deflection, tip rotation {angle:.1f} deg

A 2 m arm, 5 mm high, bent by the inertia of its 2 kg end effector (`benchmark/elastica.py`):
critically damped until it rests in the accelerating frame, against SciPy's boundary value solver
for the same arm, which itself agrees with the closed form of the elastica where shear and
the arm's mass do nothing.

| formulation | N | tip rotation, deg off | tip deflection, m off | tip shortening, m off |
|---|---|---|---|---|
{body}
""")
    print(sections[-1])
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
        'fastest in `finite_elements.py`; its times exclude the assembly of the model, those of '
        'this package the tables of a scene. Errors of the mesh and of the step have opposite '
        'signs and can cancel: "lasting" is the cheapest case that no refinement makes worse '
        'than the goal.\n\n' + '\n'.join(sections), encoding='utf-8')


if __name__ == '__main__':
    main()
