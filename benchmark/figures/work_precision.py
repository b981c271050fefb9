# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Draws doc/benchmark/*.png, run time against error, from doc/benchmark/work_precision.json.

Each picture has the fastest methods of each family; *_all.png has all methods. `make benchmark`
writes that file and these pictures; `make picture` draws them without measuring.
"""

import json

from matplotlib.figure import Figure
import numpy as np

from benchmark import ROOT
from benchmark.report import BLACK, BLUE, GREEN, parser, RED

FOLDER = ROOT / 'doc' / 'benchmark'
# Families of methods: kinds, in words, and how they are drawn.
FAMILIES = (({'timo_sim'}, 'timo_sim', BLUE, 'o'),
            ({'integrator'}, 'other integrators of our equations', GREEN, '^'),
            ({'links', 'links, our step'}, 'links by hand', BLACK, 'D'),
            ({'engine'}, 'engines', RED, 's'))
APART = 0.043  # least distance of labels, in heights of the axes


def draw(run, everything):
    """Return a figure of the fastest settings of a run, by error, of the best or all methods."""
    goals, methods = run['goals_m'], run['methods']
    reached = {method: [each and each['seconds'] for each in found['best']]
               for method, found in methods.items() if found['best'][0]}
    figure = Figure(figsize=(10.5, 6.0), layout='constrained')
    axes = figure.subplots()
    axes.set(yscale='log', xlim=(-1.75, len(goals) - 0.9), xticks=range(len(goals)),
             xticklabels=[f'{goal:g} m' for goal in goals],
             xlabel='for an error of the tip deflection below',
             ylabel='CPU time of the solver [s]')
    labels, times = [], []
    for kinds, words, colour, marker in FAMILIES:
        family = {method: values for method, values in reached.items()
                  if methods[method]['kind'] in kinds}
        best = {min((values[k], method) for method, values in family.items() if values[k])[1]
                for k in range(len(goals)) if any(values[k] for values in family.values())}
        if not everything:
            family = {method: family[method] for method in best}
        axes.plot([], [], color=colour, marker=marker, label=words)
        for method, values in family.items():
            style = {'lw': 2.4, 'ms': 7, 'zorder': 3} if method in best else {
                'lw': 0.9, 'ms': 4, 'alpha': 0.5}
            count = sum(value is not None for value in values)
            axes.plot(range(count), values[:count], color=colour, marker=marker, **style)
            labels.append((values[0], method, colour, method in best))
            times += values[:count]
    axes.set_ylim(0.6 * min(times), 1.6 * max(times))
    _label(axes, sorted(labels))
    missed = everything and [method for method in methods if method not in reached]
    axes.set_title('not reached: ' + '; '.join(missed) if missed else '', fontsize=9, loc='left')
    axes.grid(alpha=0.3)
    figure.legend(loc='outside lower center', ncols=len(FAMILIES), fontsize=9, frameon=False)
    return figure


def save(name, run):
    """Write both pictures of a scene."""
    for everything, end in ((False, ''), (True, '_all')):
        draw(run, everything).savefig(FOLDER / f'{name}{end}.png', dpi=110)


def _label(axes, labels):
    """Write names beside the first points of lines, ascending by height and apart from another."""
    low, high = np.log(axes.get_ylim())
    steps = APART * np.arange(len(labels))
    wanted = (np.log([value for value, *_ in labels]) - low) / (high - low) - steps
    # Pushed up or down, or between the two, heights keep their order and distance.
    moved = 0.5 * (np.maximum.accumulate(wanted) + np.minimum.accumulate(wanted[::-1])[::-1])
    heights = steps + np.clip(moved, 0.03, 0.97 - steps[-1])
    for (value, method, colour, bold), height in zip(labels, heights):
        axes.annotate(method, (0.0, value), (0.305, height), textcoords='axes fraction',
                      color=colour, ha='right', va='center', fontsize=9,
                      fontweight='bold' if bold else 'normal',
                      arrowprops={'arrowstyle': '-', 'color': colour, 'lw': 0.6, 'alpha': 0.6,
                                  'shrinkA': 0, 'shrinkB': 3, 'relpos': (1.0, 0.5)})


def main():
    """Draw each scene's last run."""
    parser(__spec__, __doc__).parse_args()
    stored = json.loads((FOLDER / 'work_precision.json').read_text(encoding='utf-8'))
    for name, runs in stored.items():
        if 'methods' in runs[-1]:
            save(name, runs[-1])


if __name__ == '__main__':
    main()
