# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Stress tests of numerics, node and log: `make stress` fills doc/stress.md.

That takes an hour and a half; `--quick` prints a part of it; `--parts Node` makes a part anew.
"""

import warnings

from benchmark.report import make_page, table
from benchmark.stress import at_rest, axial, c_code, in_motion, log, node, numerics
from benchmark.stress.scenes import cell, hard_cell, laden_cell
from timo_sim import ModelWarning


def scenes(make, full, quick_part):
    """Return what makes the table of the first scenes that `make` draws."""
    return lambda quick: table(
        ['equations', 'against', 'tried', *numerics.VERDICTS, 'remark'],
        numerics.rows(full // quick_part if quick else full, make))


def faults(module):
    """Return what makes the table of the faults of a module."""
    return lambda quick: table(['fault', 'tried', 'survived', 'remark'], module.rows(quick))


PARTS = {
    'Numerics': scenes(cell, 1020, 10),
    'Gravity and loads that change': scenes(laden_cell, 68, 4),
    'Errors that grow': scenes(hard_cell, 504, 12),
    'Linear models': lambda quick: table(
        ['modes', 'tried', *numerics.OUTPUTS], numerics.linear_rows(quick)),
    'By hand': lambda quick: table(
        ['scenes', 'tried', 'gain', 'frequencies'], numerics.by_hand_rows(quick)),
    'Loads at rest': lambda quick: table(
        ['load', 'static modes', *at_rest.VERDICTS], at_rest.rows(quick)),
    'Loads in motion': lambda quick: table(
        ['load', 'static modes', *in_motion.MOVED], in_motion.rows(quick)),
    'Axial modes': lambda quick: table(['scenes', *axial.VERDICTS], axial.rows(quick)),
    'An hour': lambda quick: table(
        ['scene', 'formulation', 'energy', 'momentum', 'remark'], numerics.long_rows(quick)),
    'C code': c_code.part, 'Node': faults(node), 'Log': faults(log)}

if __name__ == '__main__':
    warnings.filterwarnings('ignore', 'is this meant', ModelWarning)  # random values are not
    make_page(__spec__, __doc__, 'stress.md', PARTS, 'a few minutes')
