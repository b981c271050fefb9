# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Run time against error, with other integrators and other engines, and cold starts.

`make benchmark` writes the figures of the last two runs to doc/benchmark/work_precision.json,
draws the plots, and fills the tables of doc/benchmark.md and README.md; `--quick` prints a small
selection. Each method searches its grid of settings by itself, the cheapest first, until its
budget of the solver's CPU time is used or nothing cheaper is left to find. A goal is reached by a
setting, or by the extrapolation of two or three, whose error is below it, if that of its next
finer neighbour is, too. The cheapest of these are timed again, all methods taking turns; a time is
the least CPU time.
"""

from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
import itertools
import json
import os
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
import warnings

import numpy as np

from benchmark import ROOT
from benchmark.accuracy.cases import INTEGRATOR, Method, methods_of, OWN, Scene, SCENES
from benchmark.figures.work_precision import FOLDER, save
from benchmark.process import install
from benchmark.report import machine, parser
from benchmark.timing import product, seconds
from oracles import elastica
from oracles.references import read
import timo_sim

RIVALS = ('exudyn', 'mujoco-core', 'pyelastica', 'dismech-newton', 'soromox', 'jax')
BUDGET, QUICK = 12.0, 0.5  # CPU time of the search of a method on a scene, on a calm machine [s]
CALM = 7e-8  # time of the calibrating product on it [s]
REPEATED, TURNS = 2.0, 25  # CPU time of a setting that is timed again [s], and at most how often
CANDIDATES = 3             # settings for a goal that are timed again
COLD_STARTS, LONG = 3, 10.0  # the least counts; one that takes so long [s] is not repeated
# What a new process does for 0.1 s of a scene: code that is not timed, and the code for it.
PAPER = f"import timo_sim; scene = timo_sim.load_scene('{ROOT}/config/paper.yaml'); "
CLAMPED = ('import timo_sim; from oracles.references import CANTILEVER; '
           'scene = timo_sim.load_scene(CANTILEVER); ')
RIVAL = 'from benchmark.accuracy import rivals; rivals.'
COLD = {
    'timo_sim': PAPER + 'timo_sim.simulate(scene, 0.1)',
    'exudyn': PAPER + ('from oracles import finite_elements; '
                       'finite_elements.simulate(scene, 20, 1e-3, 0.1, 10)'),
    'MuJoCo': PAPER + RIVAL + 'chain(scene, 10, 4e-4, 0.1, 25)',
    'PyElastica': CLAMPED + RIVAL + 'elastica(scene, 20, 1e-5, 0.1, 2000)',
    'dismech-newton': CLAMPED + RIVAL + 'dismech(scene, 20, 0.01, 0.1, 2)',
    'soromox': CLAMPED + ('from benchmark.accuracy import soft_rods; '
                          'soft_rods.soft_rod(scene, 3, 4e-3, 0.1, 5)')}


_UNUSED = itertools.count(1)


@dataclass
class Trial:
    """A setting of a method on a scene, and what came out."""

    scene: Scene
    method: Method
    size: float
    step: float
    deflection: np.ndarray | None = None  # of the tip [m], None if the run failed
    solver: list = field(default_factory=list)  # CPU times [s]
    whole: list = field(default_factory=list)   # of all that follows a loaded scene [s]
    file: list = field(default_factory=list)    # the same and, for our code, loading its file [s]

    @property
    def settings(self):
        """The setting in words."""
        return self.method.label(self.scene.resting, self.size, self.step)

    def load(self):
        """Return the scene; for our code with a body that nothing has been computed for."""
        if self.method.kind not in (OWN, INTEGRATOR):
            return self.scene.resting
        density = self.scene.arm.section.density * (1.0 + 1e-13 * next(_UNUSED))
        return self.scene.load({**self.method.values(self.size, self.step),
                                'arm.density': density})

    def run(self):
        """Run once; return the CPU time, assembly included [s]."""
        checked, begun = self.load(), time.process_time()
        found = self.method.run(self.scene, checked, self.size, self.step)
        span = time.process_time() - begun
        if found:
            self.solver.append(found[0])
            self.deflection = found[1]
        return span

    def repeat(self):
        """Run once more, and do what a user would."""
        loading, whole = 0.0, self.run()
        if self.method.simulate:
            begun = time.process_time()
            checked = self.load()
            loading = time.process_time() - begun
            self.method.simulate(self.scene, checked, self.size, self.step)
            whole = time.process_time() - begun - loading
        self.whole.append(whole)
        self.file.append(whole + loading)


class Search:
    """The settings of a method on a scene that are tried within a budget."""

    def __init__(self, scene, method, truth):
        self.scene, self.method, self.truth = scene, method, truth
        self.trials = {}   # by index in the grid
        self.errors = {}   # in w(l) [m], by entry: one index, or two or three extrapolated

    def explore(self, budget):
        """Run settings, the cheapest first, until the budget [s] is used or all goals reached."""
        self._trial((0, 0)).run()  # compiles
        ahead, spent = {(0, 0): 0.0}, 0.0
        while ahead:
            index = min(ahead, key=lambda each: ahead[each])
            found = [self.reached(goal)[:1] for goal in self.scene.goals]
            dearest = max(self.seconds(*each) if each else np.inf for each in found)
            # What is cheaper than the dearest may have a neighbour that is not.
            if spent + ahead[index] > budget or ahead[index] > 3.0 * dearest:
                return
            del ahead[index]
            trial = self.trials[index] = self._trial(index)
            span = trial.run()
            spent += trial.solver[0] if trial.solver else span
            while sum(trial.solver) < 0.02 and 0 < len(trial.solver) < 3:
                trial.run()
            self._compare(index)
            # A neighbour takes at least 4/3 times as long.
            for further in ((index[0] + 1, index[1]), (index[0], index[1] + 1)):
                if further not in self.trials and all(
                        i < n for i, n in zip(further, self._shape())):
                    ahead[further] = max(ahead.get(further, 0.0),
                                         4.0 / 3.0 * min(trial.solver, default=span))

    def _shape(self):
        return len(self.method.sizes), len(self.method.steps)

    def _trial(self, index):
        return Trial(self.scene, self.method, self.method.sizes[index[0]],
                     self.method.steps[index[1]])

    def _compare(self, index):
        # The errors of a new setting, and of its pairs and threes with the others.
        kin = sorted(each for each in self.trials if each == index
                     or self._factor(each, index) or self._factor(index, each))
        for entry in (entry for count in (1, 2, 3) for entry in itertools.combinations(kin, count)
                      if index in entry):
            found = self._deflection(entry)
            if found is not None:
                every = len(self.truth) // len(found)
                with np.errstate(all='ignore'):
                    error = float(np.abs(found - self.truth[every - 1::every]).max())
                if error < 1e3:
                    self.errors[entry] = error

    def _factor(self, coarse, fine):
        """Return how many times the error of a setting is that of another, None if unknown."""
        (few, long), (many, short) = (
            (self.method.sizes[i] - self.method.outside, self.method.steps[j])
            for i, j in (coarse, fine))
        factors = [order and ratio**order for order, ratio in zip(
            self.method.orders, (many / few, long / short)) if ratio != 1.0]
        known = factors and min(factors) >= 1.1 and max(factors) <= 1.1 * min(factors)
        return factors[0] if known else None

    def _deflection(self, entry):
        # Extrapolated to no error: two runs know its first power, three the second one, too.
        runs = [self.trials[index].deflection for index in entry]
        factors = [self._factor(*pair) for pair in itertools.combinations(entry, 2)]
        if any(each is None for each in (*runs, *factors)) or (
                len(entry) == 3 and factors[1] < 0.9 * factors[0] * factors[2]):
            return None
        count = min(map(len, runs))
        if any(len(run) % count for run in runs):
            return None
        errors = 1.0 / np.array([1.0, *factors[:len(entry) - 1]])
        weights = np.linalg.solve(np.vander(errors, increasing=True).T, np.eye(len(entry))[0])
        return sum(weight * run[len(run) // count - 1::len(run) // count]
                   for weight, run in zip(weights, runs))

    def reached(self, goal):
        """Return the entries below a goal [m] whose next finer neighbours are, too, by time."""
        one = [int(n > 1) for n in self._shape()]

        def finer(entry):
            return tuple(tuple(i + k for i, k in zip(index, one)) for index in entry)
        return sorted((entry for entry, error in self.errors.items() if error <= goal
                       and self.errors.get(finer(entry), np.inf) <= goal),
                      key=lambda entry: self.seconds(entry))

    def seconds(self, entry):
        """Return the CPU time of the solver [s]."""
        return sum(min(self.trials[index].solver) for index in entry)

    def figures(self, entry):
        """Return what is stored of an entry."""
        trials = [self.trials[index] for index in entry]
        return {'settings': ' and '.join(trial.settings for trial in trials),
                'error_m': self.errors[entry], 'seconds': self.seconds(entry),
                'whole_s': sum(min(trial.whole) for trial in trials),
                'file_s': sum(min(trial.file) for trial in trials)}


def measure(scene, quick):
    """Return the figures of a scene."""
    comment, stored = read(scene.name)
    searches = []
    # On a slow machine, too, each method gets as far as on a calm one.
    budget = (QUICK if quick else BUDGET) * max(1.0, min(product() for _ in range(5)) / CALM)
    for method in methods_of(scene):
        search = Search(scene, method, stored['w_l_m'][1:])
        begun = time.process_time()
        search.explore(budget)
        print(f'{scene.name}, {method.name}: {len(search.trials)} settings in '
              f'{time.process_time() - begun:.1f} s', flush=True)
        searches.append(search)
    # Candidates are timed again, taking turns.
    again = [search.trials[index] for search in searches for index in sorted({
        index for goal in scene.goals for entry in search.reached(goal)[:CANDIDATES]
        for index in entry})]
    for turn in range(2 if quick else TURNS):
        for trial in again:
            if turn < 2 or sum(trial.whole) < REPEATED:
                trial.repeat()
    found = {}
    for search in searches:
        best = [search.reached(goal)[:1] for goal in scene.goals]
        errors = search.errors
        found[search.method.name] = {
            'kind': search.method.kind, 'least_error_m': min(errors.values(), default=None),
            'best': [search.figures(*each) if each else None for each in best]}
    return {'reference': comment, 'goals_m': scene.goals, 'methods': found}


def large_deflection(quick):
    """Return errors of an arm that rests bent by 60 degrees, by number of modes."""
    angle, rows = elastica.rows(3.2, (1, 3, 5) if quick else (1, 2, 3, 4, 5, 6, 8))
    return {'angle_deg': angle, 'rows': rows}


def cold_starts(quick):
    """Return the least wall times of new processes, without and with compiled code on disk."""
    result = {}
    with TemporaryDirectory() as folder:
        install(folder)
        for name, code in COLD.items():
            found = []
            while len(found) < (1 if quick else COLD_STARTS) and not (
                    found and found[-1][0] > LONG):
                with TemporaryDirectory() as cache:
                    environment = {
                        **os.environ, 'NUMBA_CACHE_DIR': cache, 'WARP_CACHE_PATH': cache,
                        'PYTHONPATH': os.pathsep.join([folder, str(ROOT), str(ROOT / 'test')])}
                    found.append([seconds(partial(
                        subprocess.run, [sys.executable, '-c', code], check=True, cwd=folder,
                        env=environment, capture_output=True)) for _ in range(2)])
            result[name] = [min(column) for column in zip(*found)]
            print(name, *result[name], flush=True)
    return {'seconds': result}


PARTS = {**{scene.name: partial(measure, scene) for scene in SCENES},
         'large_deflection': large_deflection, 'cold_starts': cold_starts}


def main():
    """Measure, write the figures and fill the pages."""
    command = parser(__spec__, __doc__, 'a small selection, printed only')
    command.add_argument('--parts', nargs='+', choices=PARTS, help='measure these alone')
    given = command.parse_args()
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    path = FOLDER / 'work_precision.json'
    for name in given.parts or (('paper', 'large_deflection') if given.quick else PARTS):
        figures = PARTS[name](given.quick)
        if given.quick:
            print(json.dumps({name: figures}, indent=1), flush=True)
            continue
        stored = json.loads(path.read_text(encoding='utf-8')) if path.exists() else {}
        facts = {**machine(), **{rival: version(rival) for rival in RIVALS}}
        stored[name] = [*stored.get(name, []), {'machine': facts, **figures}][-2:]
        path.write_text(json.dumps(stored, indent=1) + '\n', encoding='utf-8')
        if 'methods' in figures:
            save(name, figures)
    if not given.quick:
        subprocess.run([sys.executable, ROOT / 'doc' / 'tables.py'], check=True)


if __name__ == '__main__':
    main()
