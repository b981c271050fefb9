# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Figs. 11 and 12: errors against finite elements, over time and over the number of modes."""

import matplotlib.pyplot as plt

from benchmark.figures.paper.style import (
    BLACK, BLUE, COLOURS, GREEN, MODES, NAMES, ORANGE, RED, save)
from benchmark.report import table
from oracles.references import errors, motion_of, simulate, STATIONS
from timo_sim.model import FORMULATIONS


def error_histories(t, runs, truth):
    """Return Fig. 11 and its verdicts."""
    figure, axes = plt.subplots(3, 2, figsize=(9, 6.5), sharex=True)
    verdicts, rows = [], []
    names = ('horizontal', 'vertical', 'angular')
    found = {name: errors(motion_of(run), truth) for name, run in runs.items()}
    for column, (formulation, error) in enumerate(found.items()):
        for row, name in enumerate(names):
            axis = axes[row, column]
            for key, colour in zip(STATIONS, (BLACK, ORANGE, BLUE, GREEN, RED)):
                axis.semilogy(t[1:], error[key][1:, row], color=colour, lw=0.8,
                              label=f'xi = {NAMES[key]}')
            axis.axhline((0.08, 0.15, 0.15)[row], color=BLACK, ls=':', lw=1)
            axis.set_ylim(1e-7, 1)
            axis.set_title(f'{name}, {formulation}', fontsize=9)
    for axis in axes[2]:
        axis.set_xlabel('t [s]')
    for axis in axes[:, 0]:
        axis.set_ylabel('error [%]')
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=5)
    text = save(figure, '11', f'Fig. 11: errors against finite elements, N = {MODES}, of newton '
                '(left) and exact (right); dotted: the bound printed in the paper')
    for row, (name, bound) in enumerate(zip(names, (0.08, 0.15, 0.15))):
        largest = {formulation: {key: error[key][:, row].max() for key in STATIONS}
                   for formulation, error in found.items()}
        for formulation, each in largest.items():
            rows.append([name, formulation,
                         *(f'{each[key]:.4f}' if each[key] > 1e-3 else f'{each[key]:.1e}'
                           for key in STATIONS)])
        shown = {formulation: max(each.values()) for formulation, each in largest.items()}
        over = [NAMES[key] for key in STATIONS if largest['newton'][key] > bound]
        verdicts.append((f'Fig. 11: {name} position', f'< {bound:g} %',
                         f'{shown["newton"]:.2f} %', f'{shown["exact"]:.1e} %',
                         'exact: yes; newton: ' + (f'not at xi = {", ".join(over)}' if over
                                                   else 'yes')))
    text += '\n' + table(['position', 'formulation', *(f'xi = {NAMES[key]}, %' for key in
                                                       STATIONS)], rows) + '\n'
    return text, verdicts


def errors_over_modes(truth):
    """Return Fig. 12 and its verdict."""
    counts = range(1, 8)
    found = {name: [{key: error.max(axis=0) for key, error in errors(
        motion_of(simulate(name, count)), truth).items()} for count in counts]
        for name in FORMULATIONS}
    figure, axes = plt.subplots(3, 3, figsize=(9, 7), sharex=True, sharey=True)
    for row, label in enumerate(('horizontal', 'vertical', 'angular')):
        for axis, key in zip(axes[row], ('l4', 'l2', 'l')):
            for (name, each), marker in zip(found.items(), 'os^v'):
                axis.semilogy(counts, [error[key][row] for error in each], marker + '-', ms=4,
                              color=COLOURS[name], label=name)
            axis.axhline(3.0, color=BLACK, ls=':', lw=1)
            axis.set_title(f'{label}, xi = {NAMES[key]}', fontsize=9)
    for axis in axes[2]:
        axis.set_xlabel('N')
    for axis in axes[:, 0]:
        axis.set_ylabel('largest error [%]')
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
    text = save(figure, '12', 'Fig. 12: largest error over 10 s against the number of modes; '
                'dotted: 3 %') + '\n'
    worst = {name: [max(error[key].max() for key in STATIONS) for error in each]
             for name, each in found.items()}
    text += table(['formulation, largest error % of any position at any section',
                   *(f'N = {count}' for count in counts)],
                  [[name, *(f'{value:.2g}' for value in values)]
                   for name, values in worst.items()]) + '\n'
    verdict = ('Fig. 12: all positions with three modes', '< 3 %', f'{worst["newton"][2]:.2f} %',
               f'{worst["exact"][2]:.3f} %',
               'agrees' if max(worst['newton'][2], worst['exact'][2]) < 3.0 else 'does not agree')
    return text, verdict
