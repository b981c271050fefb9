# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Command lines, Markdown tables, and the parts of a page of doc/ that a script writes."""

import argparse
import os
import platform
import time

import numba
import numpy as np
import scipy

from benchmark import ROOT
import timo_sim


def parser(spec, words, quick=None):
    """
    Return a parser of the command line of a module, given its `__spec__` and its docstring.

    The first paragraph of the docstring is shown; `quick` is the help of `--quick`, if it has it.
    """
    result = argparse.ArgumentParser(prog=f'python -m {spec.name.removesuffix(".__main__")}',
                                     description=words.strip().split('\n\n')[0])
    if quick:
        result.add_argument('--quick', action='store_true', help=quick)
    return result


def machine():
    """Return what a benchmark was measured on: processor, cores and versions by name."""
    try:
        with open('/proc/cpuinfo', encoding='utf-8') as file:
            model = next(line.split(':')[1].strip() for line in file if 'model name' in line)
    except (OSError, StopIteration):
        model = platform.processor()
    return {'processor': model, 'cores': os.cpu_count(), 'machine': platform.machine(),
            'python': platform.python_version(), 'numpy': np.__version__,
            'scipy': scipy.__version__, 'numba': numba.__version__,
            'timo_sim': timo_sim.__version__}


def measured_on(**more):
    """Return a line that says on which machine, and with what else, figures were measured."""
    facts = ', '.join(f'{name} {value}'
                      for name, value in {**machine(), **more}.items())
    return f'Measured on: {facts}.'


def table(header, rows):
    """Return a Markdown table."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join('| ' + ' | '.join(map(str, line)) + ' |' for line in lines)


def targets(rows):
    """Return the Markdown table of rows (line, target, measured, met or None, remark)."""
    met = {True: 'yes', False: 'no', None: ''}
    return table(['', 'target', 'measured', 'met', 'remark'],
                 [(line, target, measured, met[good], remark)
                  for line, target, measured, good, remark in rows])


def fill(page, part, text):
    """Put a text between `<!-- made: PART -->` and the next `<!-- end -->` of a page of doc/."""
    path = ROOT / 'doc' / page
    head, begin, rest = path.read_text(encoding='utf-8').partition(f'<!-- made: {part} -->\n')
    _, end, tail = rest.partition('<!-- end -->')
    if not end:
        raise ValueError(f'doc/{page} must have a part {part!r}')
    path.write_text(f'{head}{begin}{text.strip()}\n{end}{tail}', encoding='utf-8')


def make_page(spec, words, page, parts, quick=None, **facts):
    """
    Make parts of a page of doc/ as the command line says; with `--quick` only print them.

    `parts` has functions by name that return the text of a part; their argument is whether they
    shall be quick. `facts` are functions of further facts about the machine, called for each part.
    """
    command = parser(spec, words, quick)
    command.add_argument('--parts', nargs='+', choices=parts, default=list(parts),
                         help='make these alone')
    given = command.parse_args()
    short = quick is not None and given.quick
    for name in given.parts:
        begun = time.monotonic()
        text = parts[name](short)
        text += '\n\n' + measured_on(**{fact.replace('_', ' '): value()
                                        for fact, value in facts.items()})
        print(f'## {name}, in {time.monotonic() - begun:.0f} s\n\n{text}\n', flush=True)
        if not short:
            fill(page, name, text)
