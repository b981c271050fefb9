# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Tables of the pages that the code, or another page, knows: `make pages` writes them anew.

A page has them between `<!-- table: NAME -->` and `<!-- end -->`.
"""

import json
import math
from pathlib import Path
import re
from statistics import median

from timo_sim.scene.parameters import MATERIALS, NODE, PARAMETERS
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs, TRANSFORMS

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'doc').rglob('*.md'))]
_TABLE = re.compile(r'(<!-- table: (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)


def _table(*rows):
    head, *rest = [f'| {" | ".join(row)} |' for row in rows]
    return '\n'.join([head, f'|{len(rows[0]) * "---|"}', *rest]) + '\n'


def _short(type_name):
    return type_name.replace('/msg/', '/')


def commands():
    """Return the table of the topics that the node subscribes to."""
    return _table(('topic', 'type', 'sets'), *(
        (f'`{each.name}`', _short(each.type_name), each.meaning) for each in COMMANDS))


def published():
    """Return the table of the topics that carry the motion."""
    rows = []
    for output in [*outputs(1), TRANSFORMS]:
        names = [re.sub('mode_1', 'mode_N', name) for name in output.columns]
        rows.append((f'`{output.name}`', _short(output.type_name),
                     ', '.join(f'`{name}`' for name in names) or 'sim time',
                     f'{PARAMETERS[output.rate].default:g} Hz'))
    return _table(('topic', 'type', 'numbers, with units', 'default of `rate.TOPIC`'),
                  *rows)


def parameters():
    """Return a table of parameters for each group."""
    groups = {}
    for parameter in PARAMETERS.values():
        group, dot, _ = parameter.name.partition('.')
        groups.setdefault('node' if not dot and parameter.scope == NODE else group,
                          []).append(parameter)
    return '\n'.join(f'## {group}\n\n' + _table(
        ('parameter', 'default', 'rule', 'meaning'), *map(_row, entries))
        for group, entries in groups.items())


def materials():
    """Return the table of the materials that have names."""
    return _table(('`arm.material`', 'density [kg/m3]', "Young's modulus [GPa]",
                   "Poisson's ratio"), *(
        (name, *(f'{value:g}' for value in (density, 1e-9 * young, poisson)))
        for name, (density, young, poisson) in MATERIALS.items()))


def _row(parameter):
    default = parameter.default
    shown = {bool: str(default).lower(), str: default or "''"}.get(type(default))
    if isinstance(default, tuple):
        shown = f'[{", ".join(f"{value:g}" for value in default)}]'
    elif shown is None:
        shown = '.inf' if default == math.inf else f'{default:g}'
    unit = f' [{parameter.unit}]' if parameter.unit else ''
    live = '; *live*' if parameter.runtime else ''
    return f'`{parameter.name}`', shown, parameter.rule, f'{parameter.meaning}{unit}{live}'


def _measured(part):
    """Return the last two runs of a part of `make benchmark`, None before the first one."""
    runs = json.loads((ROOT / 'doc' / 'benchmark' / 'work_precision.json').read_text())[part]
    return [None, *runs][-2:]


def _two_digits(value):
    return f'{float(f"{value:.2g}"):g}'


def _time(seconds):
    return f'{_two_digits(seconds)} s' if seconds >= 1.0 else f'{_two_digits(1e3 * seconds)} ms'


def _goals(run):
    return [f'{goal:g} m' for goal in run['goals_m']]


# Of the solver, from a loaded scene, from the file.
TIMES = 'seconds', 'whole_s', 'file_s'
# Kinds of methods, by what they are called.
RIVALS = {'the best engine': ['engine'], 'links by hand': ['links', 'links, our step']}


def _best(run, *kinds, key='seconds'):
    """Return the name and figures of the cheapest method of some kinds for each goal, or None."""
    cheapest = []
    for column in range(len(run['goals_m'])):
        found = [(name, each['best'][column]) for name, each in run['methods'].items()
                 if each['kind'] in kinds and each['best'][column]]
        cheapest.append(min(found, key=lambda each: each[1].get(key, 0.0), default=None))
    return cheapest


def _ratio(above, below, key='seconds'):
    known = above and below and key in above and key in below
    return _two_digits(above[key] / below[key]) if known else '-'


def _ratios(part):
    """Return rows of the times of the best of each rival kind over ours, in two runs."""
    rows = []
    for words, kinds in RIVALS.items():
        before, now = (zip(*([_ratio(other and other[1], own, key) for other, own in zip(
            _best(run, *kinds, key=key), run['methods']['exact']['best'])] for key in TIMES))
            if run else 3 * [3 * ['no run']] for run in _measured(part))
        rows.append((f'ratio to {words} (in the run before)',
                     *('**{}**, {}, {} ({}, {}, {})'.format(*each, *earlier)
                       for each, earlier in zip(now, before))))
    return rows


def _cell(found):
    if not found:
        return 'not reached'
    times = [found[key] for key in TIMES if key in found]
    if times[1] == times[-1]:  # no file is loaded
        del times[2:]
    return f'{", ".join(map(_time, times))}: {found["settings"]}'


def benchmark():
    """Return what the paper's scene takes by `exact` and by the best of others."""
    _, run = _measured('paper')
    return _table(
        ('for an error in w(l) below', *_goals(run)),
        ('timo_sim, `exact`', *map(_cell, run['methods']['exact']['best'])),
        *((words, *(f'{each[0]}: {_cell(each[1])}' if each else 'not reached'
                    for each in _best(run, *kinds))) for words, kinds in RIVALS.items()),
        *_ratios('paper'),
        ('solver, by the reduced model (links by RK4) x by the step', *_gains(run)))


def in_short():
    """Return what the README says of truth, speed and real arms."""
    _, run = _measured('paper')
    engine, links = (
        {key: [_ratio(other and other[1], own, key) for other, own in zip(
            _best(run, *kinds, key=key), run['methods']['exact']['best'])] for key in TIMES[:2]}
        for kinds in RIVALS.values())
    solver, whole, goals = engine['seconds'], engine['whole_s'], _goals(run)
    scores = json.loads((ROOT / 'doc' / 'real_arm' / 'scores.json').read_text())
    held = {name: {output: r2 for output, (_, r2) in own.items()}
            for name, (own, *_) in scores.items()}
    shaft, tip = (sorted(r2 for own in held.values() for output, r2 in own.items() if at(output))
                  for at in (lambda name: name == 'shaft', lambda name: name != 'shaft'))
    good = sum(len(own) == 2 and min(own.values()) >= 0.95 for own in held.values())
    alone = [r2 for own in json.loads((ROOT / 'doc' / 'real_arm' / 'auto.json').read_text(
        )).values() for r2 in own.get('blind', {}).values()]
    return _table(
        ('', ''),
        ('truth', 'With five modes the tip agrees with extrapolated finite elements to 2 µm in a '
                  'deflection of 88.7 mm ([picture](doc/arm.png), `make picture`).'),
        ('speed', f'Processor time at tip errors of {goals[0]}, {goals[1]} and {goals[2]}: the '
                  f'best engine (MuJoCo, exudyn) takes {solver[0]}, {solver[1]} and {solver[2]} '
                  f'times ours for the steps alone, and {whole[0]}, {whole[1]} and {whole[2]} '
                  'times ours from a loaded scene to a result, although our time then includes '
                  'the measured error. Rigid links, programmed by hand for this arm, take '
                  f'{links["seconds"][0]}, {links["seconds"][1]} and {links["seconds"][2]} times '
                  'ours for the steps alone. They measure no error, so from scene to result they '
                  f'take {links["whole_s"][0]}, {links["whole_s"][1]} and {links["whole_s"][2]} '
                  'times ours. [How](doc/benchmark.md)'),
        ('real arms', f'{len(held)} fits to records of six laboratories predict the part of the '
                      f'record that was held out with R^2 from {shaft[0]:.2f} to {shaft[-1]:.2f} '
                      f'for the shaft and from {tip[0]:.2f} to {tip[-1]:.3f} for tip, strain or '
                      f'cart; {good} of the fits reach 0.95 for both outputs. In blind tests on '
                      'new records the automatic fit reached an R^2 of 0.9 for '
                      f'{sum(r2 >= 0.9 for r2 in alone)} of {len(alone)} outputs. '
                      '[How](doc/real_arm.md)'))


def _scene(part):
    """Return the function that makes the tables of a scene."""
    def tables():
        _, run = _measured(part)
        rows = [(name, *map(_cell, each['best']),
                 f'{each["least_error_m"]:.1e} m' if each['least_error_m'] else '-')
                for name, each in run['methods'].items()]
        return (_table(('error in w(l) below', *_goals(run), 'least error'), *rows) + '\n'
                + _table(('times over those of `exact`', *_goals(run)), *_ratios(part))
                + f'\nReference: {run["reference"]}.\n\n' + _machine(run))
    return tables


def _machine(run):
    shown = ', '.join(f'{name} {value}' for name, value in run['machine'].items())
    return f'Measured on: {shown}.\n'


def benchmark_gain():
    """Return how much of the ratio the reduced model gives, and how much the time step."""
    rows = []
    for part in 'paper', 'torque', 'spin_up', 'cantilever':
        _, run = _measured(part)
        rows.append((part, *(f'{goal}: {gain}' for goal, gain in zip(_goals(run), _gains(run)))))
    return _table(('scene', *3 * ('reduced model x step',)), *rows)


def _gains(run):
    """
    Return, for each goal, the times of the best other method over RK4 and of RK4 over ours.

    Links that take our step are not among the others.
    """
    peers, ours = (run['methods'][name]['best'] for name in ('RK4', 'exact'))
    return [f'{_ratio(best and best[1], peer)} x {_ratio(peer, own)}' for best, peer, own in zip(
        _best(run, 'engine', 'links'), peers, ours)]


def benchmark_bend():
    """Return errors of an arm that rests far bent."""
    _, run = _measured('large_deflection')
    return f'The tip turns by {run["angle_deg"]:.1f} degrees.\n\n' + _table(
        ('formulation', 'N', 'tip rotation, deg off', 'tip deflection, m off',
         'tip shortening, m off'), *(map(str, row) for row in run['rows']))


def benchmark_cold():
    """Return the times from the start of a process to its first result."""
    before, run = (run and run['seconds'] for run in _measured('cold_starts'))
    return _table(('', 'cold start', 'in the run before', 'the next process'), *(
        (name, f'{cold:.1f} s', f'{before[name][0]:.1f} s' if before else 'no run',
         f'{warm:.1f} s')
        for name, (cold, warm) in run.items()))


def cold_start():
    """Return the sentence about the cold start of this package."""
    cold, warm = _measured('cold_starts')[1]['seconds']['timo_sim']
    return (f'A cold start takes {cold:.1f} s of wall time, the same process again {warm:.1f} s: '
            'from the start of Python to the result of `simulate` with its measured error, in an '
            'installation without machine code on disk (`make benchmark`).\n')


def _fits(part):
    """Return figures of doc/benchmark/fits.json, which `make benchmark-fit` writes."""
    return json.loads((ROOT / 'doc' / 'benchmark' / 'fits.json').read_text())[part]


def _yes(good):
    return 'yes' if good else '**no**'


def _factor(value):
    return '-' if value is None else f'{value:.2f}'


def _percent(part):
    return '-' if part is None else f'{100.0 * part:.0f} %'


def fit_machine():
    """Return the line that says on which machine fits were measured."""
    shown = ', '.join(f'{name} {value}' for name, value in _fits('machine').items())
    return (f'Measured by `make benchmark-fit` on: {shown}. '
            'Every figure is in `benchmark/fits.json`.\n')


def fit_coverage():
    """Return how many 95 % intervals hold the truth, and deviations over the bound."""
    each, noise = _fits('coverage'), _fits('noise')
    rows = []
    for name, found in each['parameters'].items():
        held, ratio = 100.0 * found['held'] / each['count'], found['deviation'] / found['bound']
        rows.append((f'`{name}`', f'{found["truth"]:g}', f'{found["guess"]:g}',
                     f'{found["held"]} of {each["count"]}', f'{ratio:.2f}',
                     _yes(90.0 <= held <= 99.0 and ratio <= 1.3)))
    shown = ' and '.join(f'{value:g} {unit} ({name})' for (name, value), unit in zip(
        noise.items(), ('rad', 'm')))
    return (f'{each["count"]} records of {each["duration"]:g} s of an arm with dry friction, with '
            f'noise of {shown}: how many of the 95 % intervals hold the truth, 90 to 99 % being '
            'the target, and the standard deviation of the estimates over the least that is '
            'possible, by Cramer and Rao, 1.3 being the target. The records were made with a step '
            f'{_fits("finer")} times as fine as that of the fits and the same modes.\n\n' + _table(
                ('parameter', 'truth', 'first guess', 'intervals with the truth',
                 'deviation over bound', 'target met'), *rows))


def fit_unidentified():
    """Return what fits say of parameters that a record cannot tell apart."""
    rows = []
    for each in _fits('unidentifiable'):
        named = ['+'.join(f'`{name}`' for name in parts) for parts in each['named']]
        good = (any({*parts} == {*each['expected']} for parts in each['named'])
                and {*each['without_number']} == {*each['expected']})
        rows.append((f'{each["input"]}; {", ".join(each["outputs"])}',
                     ', '.join(f'`{name}`' for name in each['expected']),
                     '; '.join(named).replace('+', ', ') or 'none',
                     f'{len({*each["without_number"]} & {*each["expected"]})} of '
                     f'{len(each["expected"])}', _yes(good)))
    return ('Parameters of which a record shows a combination alone: whether the fit names '
            'it (`Fit.unidentified`) and gives no numbers for them.\n\n' + _table(
                ('input; outputs', 'one of these must be fixed', 'named together',
                 'returned without numbers', 'as it should be'), *rows))


def fit_time():
    """Return the time of a fit."""
    each = _fits('time')
    return (f'A fit of {each["parameters"]} parameters to {each["duration"]:g} s at '
            f'{1.0 / _fits("period"):g} Hz with 3 modes, the second call in a process: wall time '
            f'of {len(each["times"])} fits.\n\n' + _table(
                ('least', 'median', 'runs of the scene', 'one run', 'target', 'target met'),
                (f'{each["least"]:.1f} s', f'{each["median"]:.1f} s', str(each['runs']),
                 f'{1e3 * each["run"]:.1f} ms', f'{each["target"]:g} s',
                 _yes(each['median'] <= each['target']))))


def fit_starts():
    """Return how many fits with wrong guesses end where those do that start with the truth."""
    each = _fits('starts')
    kinds = each['kinds']
    rows = [(kind, str(row['count']), str(row['same']), *(
        f'{seconds:.1f} s' for seconds in row['seconds'])) for kind, row in kinds.items()]
    same = sum(row['same'] for row in kinds.values())
    return (f'{each["count"]} made records of {each["duration"]:g} s, whose first guesses are all '
            f'wrong by a factor of {each["wrong"]:g} up or down: how many fits end where the fit '
            'that starts with the truth does (residuals within 1 %), and the median of the '
            f'processor time of both. The target is 95 %; {same} of {each["count"]} do.\n\n'
            + _table(('input', 'records', 'same minimum', 'time from the truth',
                      'time from the guess'), *rows))


def _errors_of(part, names):
    return _table(('fit', 'estimates that are numbers', 'rms error over bound',
                   'intervals with the truth'), *(
        (names[kind], _percent(each['numbers']), _factor(each['error']), _percent(each['held']))
        for kind, each in _fits(part)['kinds'].items()))


def fit_suspects():
    """Return what fits to records with an effect that the scene lacks suspect."""
    each = _fits('suspects')
    times = [time for row in each['effects'].values() for time in row['times']]
    rows = [(name, f'{row["named"]} of {each["count"]}', *(
        f'{row[part]} of {each["count"]}' if row['words'] else '' for part in (
            'first', 'alone')), *(
                 f'{100.0 * median(row[part]):.0f} %' if row[part] else ''
                 for part in ('shares', 'rivals')), ', '.join(row['others']))
            for name, row in each['effects'].items()]
    return (f'{each["count"]} records of {each["duration"]:g} s for each effect, of arms and '
            'sizes of the effect that differ, fitted with six free parameters by a scene without '
            'it: how many fits name a suspect, how many the right one first, and how many one '
            'alone; the share of the right one of the squares, and that of the best wrong one '
            'over it (medians). In the last three rows nothing is lacking, but a held value is '
            'wrong by a factor of 1.3. To find suspects takes up to '
            f'{100.0 * max(times):.0f} % of the time of the rest of the fit (median '
            f'{100.0 * median(times):.0f} %).\n\n' + _table(
                ('effect', 'a suspect is named', 'the right one first', 'one alone', 'share',
                 'of the best wrong one', 'wrong ones that are first'), *rows))


def fit_loops():
    """Return how often predicted intervals hold what the closed loop of the true arm does."""
    each = _fits('loops')
    rows = [(name, f'{row["held"]} of {each["count"]}', '{:.1f} to {:.1f} %'.format(
        *(100.0 * end for end in row['interval'])), f'{100.0 * row["width"]:.2g} %')
        for name, row in each['loops'].items()]
    return (f'The loop of example/certify.py on {each["count"]} made arms, each fitted to '
            f'{each["duration"]:g} s of its own record: how many 95 % intervals of '
            f'{each["samples"]} samples hold what the true arm does, which runs with a quarter of '
            'the step.\n\n' + _table(
                ('quantity', 'intervals with the truth', '95 % interval of this share',
                 'width over the value, median'), *rows))


def fit_outliers():
    """Return errors of fits to records with outliers, by loss."""
    each, (part, size) = _fits('outliers'), _fits('outlier')
    return (f'{each["count"]} records of which {100.0 * part:g} % of the samples are outliers of '
            f'{size:g} standard deviations: rms error of all parameters over the bound of '
            'records without outliers.\n\n' + _errors_of('outliers', {
                'plain': 'no outliers, `linear`', 'linear': '`linear`', 'soft_l1': '`soft_l1`'}))


def fit_moving():
    """Return errors of fits to records that begin in motion."""
    each = _fits('moving')
    return (f'{each["count"]} records that begin {_fits("begun"):g} s after the arm has, so their '
            'initial state is unknown, with dry friction: rms error of all parameters over the '
            'bound of records that begin at rest.\n\n' + _errors_of('moving', {
                'rest': 'taken to be at rest', 'initial': '`initial` is free'}))


TABLES = {'commands': commands, 'outputs': published, 'parameters': parameters,
          'materials': materials,
          'in_short': in_short, 'benchmark': benchmark, 'benchmark_gain': benchmark_gain,
          **{part: _scene(part) for part in ('paper', 'torque', 'spin_up', 'cantilever')},
          'benchmark_bend': benchmark_bend, 'benchmark_cold': benchmark_cold,
          'cold_start': cold_start, 'fit_machine': fit_machine, 'fit_coverage': fit_coverage,
          'fit_unidentified': fit_unidentified, 'fit_time': fit_time,
          'fit_starts': fit_starts, 'fit_outliers': fit_outliers, 'fit_suspects': fit_suspects,
          'fit_loops': fit_loops, 'fit_moving': fit_moving}


def filled(text):
    """Return the text of a page with its tables made anew."""
    return _TABLE.sub(lambda found: found[1] + TABLES[found[2]]() + found[3], text)


if __name__ == '__main__':
    for page in PAGES:
        page.write_text(filled(page.read_text()))
