# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures all speed targets: step, run, memory, node, start, learning, sweep.

`make benchmark-speed` fills doc/speed.md and draws its plot (twenty minutes); `--quick`
prints the same in a few minutes; `--parts Learning` measures one part anew.
"""

from benchmark.report import make_page, table, targets
from benchmark.speed import many, node, result, step
from benchmark.timing import product

PARTS = {
    'Step and run': lambda quick: targets(step.rows()),
    'From a file to a result': lambda quick: table(
        ['', 'processor time', 'remark'], result.rows(quick)),
    'Many at once': lambda quick: targets(many.batches(quick)),
    'Learning': lambda quick: targets(many.learning(quick)),
    'Memory': lambda quick: targets(node.memory(quick)),
    'Node': lambda quick: targets(node.rows(quick)),
    'Sweep': lambda quick: targets(many.sweeps(quick)),
    'What the cost grows with': step.curves}

if __name__ == '__main__':
    make_page(__spec__, __doc__, 'speed.md', PARTS, 'a few minutes',
              calibrating_product=lambda: f'{1e9 * product():.0f} ns')
