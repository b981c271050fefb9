# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Measures all speed targets: step, run, memory, node, start, learning, sweep.

`make benchmark-speed` fills doc/speed.md and draws its plot (a quarter of an hour); `--quick`
prints the same in a few minutes; `--parts Learning` measures one part anew.
"""

from benchmark.report import make_page, targets
from benchmark.speed import many, node, step
from benchmark.timing import product

PARTS = {
    'Step and run': lambda quick: targets(step.rows()),
    'Around a run': lambda quick: targets(step.around(quick)),
    'Many at once': lambda quick: targets(many.batches(quick)),
    'Learning': lambda quick: targets(many.learning(quick)),
    'Memory': lambda quick: targets(node.memory(quick)),
    'Node': lambda quick: targets(node.rows(quick)),
    'Sweep': lambda quick: targets(many.sweeps(quick)),
    'What the cost grows with': step.curves}

if __name__ == '__main__':
    make_page(__spec__, __doc__, 'speed.md', PARTS, 'a few minutes',
              calibrating_product=lambda: f'{1e9 * product():.0f} ns')
