# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Measures all speed targets: step, run, memory, node, start, sweep, and what simple scenes save.

`make benchmark-speed` writes doc/speed.md and its plot (a quarter of an hour), `--quick` the same
in a few minutes to run/speed.
"""

import os
for threads in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'NUMBA_NUM_THREADS'):
    os.environ[threads] = '1'

from benchmark import ROOT  # noqa: E402
from benchmark.command import parser  # noqa: E402
from benchmark.report import machine, table  # noqa: E402
from benchmark.speed import (  # noqa: E402
    around, lanes, learning, memory, node, skipping, step, sweep)
from benchmark.speed.timing import product  # noqa: E402

INTRODUCTION = """# Speed

Made by `make benchmark-speed`. A time is a median; in brackets its least value and its ratio to a
calibrating loop, a compiled product of a 16 x 16 matrix and a vector timed in between, since
machines change their speed. `python -m benchmark.speed --sections Learning` measures some sections
anew.
"""
LIMITS = """What limits the speed. At N = 10 the kernel, the mass matrix and its factor are most of
a step (see the exponent below). The step of a batch is vector code throughout, see the count of
its instructions: it is limited by their number. If bodies differ, constants differ from lane to
lane, too, and loading them takes longer. In a sweep whose bodies differ, checks, modes and tables,
which are made run by run (see their set-up), take longer than the steps. A cold start is type
inference and optimisation by numba for one size.
"""
SECTIONS = [('Step and run', step), ('Around a run', around), ('Many at once', lanes),
            ('Learning', learning), ('Memory', memory), ('Node', node), ('Sweep', sweep)]


def sections_of(page):
    """Return the sections of an earlier page by title, with their text."""
    text = page.read_text(encoding='utf-8') if page.exists() else ''
    return dict(part.split('\n', 1) for part in text.split('\n## ')[1:])


def main():
    """Measure, and write the page; sections that are left out stay as they are."""
    makers = {title: lambda folder, quick, module=module: table(
        ['', 'target', 'measured', 'met', 'remark'],
        [(line, target, measured, {True: 'yes', False: 'no', None: ''}[met], remark)
         for line, target, measured, met, remark in module.rows(quick)])
        for title, module in SECTIONS}
    makers['What the cost grows with'] = lambda folder, quick: (
        '![Cost](speed/cost.png)\n\n' + table(
            ['', 'exponent', 'why'], step.curves(folder / 'speed' / 'cost.png', quick)))
    makers["What a scene doesn't need"] = lambda folder, quick: table(
        ['left out', 'how', 'time', 'saved'], skipping.rows())
    options = parser(__spec__, __doc__, 'a few minutes')
    options.add_argument('--sections', nargs='+', choices=makers, default=list(makers))
    given = options.parse_args()
    folder = ROOT / 'run' / 'speed' if given.quick else ROOT / 'doc'
    (folder / 'speed').mkdir(parents=True, exist_ok=True)
    page = folder / 'speed.md'
    kept = sections_of(page)
    for title in given.sections:
        facts = {**machine(), 'calibrating product': f'{1e9 * product():.0f} ns'}
        text = makers[title](folder, given.quick)
        measured = ', '.join(f'{name} {value}' for name, value in facts.items())
        kept[title] = f'\n{text}\n\nMeasured on: {measured}.\n'
        print(f'## {title}\n{kept[title]}', flush=True)
        page.write_text('\n'.join([INTRODUCTION, LIMITS, *(
            f'## {each}\n{kept[each]}' for each in makers if each in kept)]), encoding='utf-8')


if __name__ == '__main__':
    main()
