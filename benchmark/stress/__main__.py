# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Stress tests of numerics, node, log and files: `make stress` writes doc/stress.md.

That takes long; `--quick` does a part of each and writes to run/stress.md. With `--parts` only
some parts are made again, and the others stay on the page as they are.
"""

import time

from benchmark import ROOT
from benchmark.command import parser
from benchmark.report import machine, table
from benchmark.stress import log, node, numerics
from benchmark.stress.hard import hard_cell
from benchmark.stress.laden import laden

TITLE = '# Stress\n\nMade by `make stress`, each part on the machine named below it.\n'
NUMERICS = """\
Random scenes in which all parameters vary (`benchmark/stress/scenes.py`, a scene by its number):
besides what is drawn for all of them, some have knots of tables and drives inside steps, 1 to 200
steps, samples at odd steps, one axis held, shafts that are locked or driven, thin arms that spin,
little stiffness in shear, an arm that stretches by speed, a heavy tip, a resonance, dry friction,
or the ends of the ranges. Each is run as `simulate` does, and compared
(`benchmark/stress/truth.py`) with a finer run of `exact`: twelve modes, a tenth of the step, and
an arm that stretches; one
round in sixteen with finite elements of an arm that stretches, too. Accurate: within 1/1000 of the
arm's length. Flagged: not so, but the run warns. Refused: an error says why. Silent: none of
these, a defect. Open: the reference itself is not known to a third of the distance;
sensitive scenes, in which a tip that begins 1e-9 lengths off ends 1e-5 lengths off or more, are
among them, unless the run is accurate all the same.
Scenes that were silent once are tests now (`test/test_stress.py`).
"""
LADEN = """\
The first scenes of those above, in gravity of any direction by which the clamped arm would sag by
1e-3 to 0.3 lengths, with one or two changes of the load at the tip (`benchmark/stress/laden.py`),
picked up moving or from rest, or both."""
_LADEN_CELLS = 68
HARD = """\
Scenes of more than 2048 steps in which errors grow (`benchmark/stress/hard.py`): arms that buckle,
are pressed or stand near their critical load, vibrate in resonance, bend far, or pick up loads at
rest, and ordinary scenes that run long. As `simulate` does by itself, runs in doubt are compared
with finer ones."""
_HARD_CELLS = 504
PARTS = [
    ('Node', node, """Real processes over real DDS (`benchmark/stress/node.py`). Survived:
the node goes on, or has ended with code 0, has counted what it should, does not leak, and
its log can be read to the end. A leak: the lowest memory of a window of 4 s, in soaks a fifth of
the time, grows by more than 1 MB in each of three windows in a row, however long one looks (at
most ten windows). Pools of memory stop growing when they are full, and are no leaks."""),
    ('Log and files', log, """Damage and full disks (`benchmark/stress/log.py`). Survived: the
simulation goes on unharmed, and what was written is readable, or is refused in one line."""),
]


def numerics_part(quick):
    """Return the text of the part that compares runs with references."""
    return '\n\n'.join([
        NUMERICS.rstrip(),
        table(['equations', 'against', 'tried', *numerics.VERDICTS, 'remark'],
              numerics.rows(quick)),
        'Frequency responses of arms with heavy tips (`linearize`), up to the second clamped '
        'frequency, against linear finite elements: relative error, median and largest.',
        table(['modes', 'tried', *numerics.OUTPUTS], numerics.linear_rows(quick)),
        f'Without loads and damping, at 1 ms, {"a minute" if quick else "an hour"}: '
        'relative drift of energy and of linear momentum.',
        table(['scene', 'formulation', 'energy', 'momentum', 'remark'],
              numerics.long_rows(quick))])


def laden_part(quick):
    """Return the text of the part in gravity and with loads that change."""
    return LADEN + '\n\n' + table(
        ['equations', 'against', 'tried', *numerics.VERDICTS, 'remark'],
        numerics.rows(quick, count=_LADEN_CELLS // (4 if quick else 1), change=laden))


def hard_part(quick):
    """Return the text of the part in which errors grow."""
    return HARD + '\n\n' + table(
        ['equations', 'against', 'tried', *numerics.VERDICTS, 'remark'],
        numerics.rows(quick, count=_HARD_CELLS // (12 if quick else 1), change=hard_cell))


def main():
    """Run all of it, or some parts, and write the page."""
    makers = {'Numerics': numerics_part, 'Gravity and loads that change': laden_part,
              'Errors that grow': hard_part}
    for title, module, words in PARTS:
        makers[title] = lambda quick, module=module, words=words: words + '\n\n' + table(
            ['fault', 'tried', 'survived', 'remark'], module.rows(quick))
    options = parser(__spec__, __doc__, 'a few minutes')
    options.add_argument('--parts', nargs='+', choices=makers, default=list(makers))
    given = options.parse_args()
    target = ROOT / ('run' if given.quick else 'doc') / 'stress.md'
    target.parent.mkdir(exist_ok=True)
    page = target.read_text(encoding='utf-8') if target.exists() else ''
    kept = dict(part.split('\n\n', 1) for part in page.split('\n## ')[1:])
    facts = ', '.join(f'{name} {value}' for name, value in machine().items())
    for title in given.parts:
        start = time.monotonic()
        text = makers[title](given.quick)
        minutes = (time.monotonic() - start) / 60.0
        kept[title] = f'{text.strip()}\n\n{minutes:.0f} minutes on: {facts}.\n'
        print(kept[title], flush=True)
        target.write_text(TITLE + ''.join(
            f'\n## {each}\n\n{kept[each].strip()}\n' for each in makers if each in kept),
            encoding='utf-8')
    print(f'written to {target}')


if __name__ == '__main__':
    main()
