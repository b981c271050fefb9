# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Draws doc/benchmark/*.png, run time against error, from doc/benchmark/work_precision.json.

Each picture has, for each error, the fastest method of each family; the tables of doc/benchmark.md
have all.
`make benchmark` writes that file and these pictures; `make picture` draws them without measuring.
"""

import json

from benchmark import drawing, ROOT
from benchmark.drawing import BLACK, BLUE, GREEN, name_ends, RED, sheet
from benchmark.report import parser

FOLDER = ROOT / 'doc' / 'benchmark'
# Families of methods: kinds, in words, and how they are drawn.
FAMILIES = (({'timo_sim'}, 'timo_sim', BLUE, 'o'),
            ({'integrator'}, 'other integrators of our equations', GREEN, '^'),
            ({'links', 'links, our step'}, 'links by hand', BLACK, 'D'),
            ({'engine'}, 'engines', RED, 's'))


def draw(run):
    """Return a figure of the fastest setting of each family of methods, by error, of a run."""
    goals, methods = run['goals_m'], run['methods']
    reached = {method: [each['seconds'] for each in found['best'] if each]
               for method, found in methods.items() if found['best'][0]}
    figure, axes = sheet(height=4.4)
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position('right')
    axes.set(yscale='log', xlim=(-0.1, len(goals) - 0.9), xticks=range(len(goals)),
             xticklabels=[f'{goal:g} m' for goal in goals],
             xlabel='for an error of the tip deflection below',
             ylabel='CPU time of the solver [s]')
    for kinds, words, colour, marker in FAMILIES:
        family = [values for method, values in reached.items() if methods[method]['kind'] in kinds]
        best = [min(values[k] for values in family if len(values) > k)
                for k in range(max(map(len, family), default=0))]
        if best:
            axes.plot(best, color=colour, marker=marker, lw=2.0, ms=7, label=words)
    axes.grid(alpha=0.3)
    name_ends(axes, first=True)
    return figure


def save(name, run):
    """Write the picture of a scene."""
    drawing.save(draw(run), f'benchmark/{name}')


def main():
    """Draw each scene's last run."""
    parser(__spec__, __doc__).parse_args()
    stored = json.loads((FOLDER / 'work_precision.json').read_text(encoding='utf-8'))
    for name, runs in stored.items():
        if 'methods' in runs[-1]:
            save(name, runs[-1])


if __name__ == '__main__':
    main()
