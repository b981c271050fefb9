# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Time the best that exudyn can do for an error on the paper's scene, two runs extrapolated included.

Errors of second order cancel in a mean of two runs: (4 fine - coarse) / 3, where the fine one has
twice the elements and half the step. The figures go to doc/benchmark/pair.json, from which
`make pages` fills the table of README.md and doc/benchmark.md.
"""

import json
import warnings

from benchmark import ROOT
from benchmark.accuracy.cases import engine_case, errors_of, of_reference, own_case, SCENES
from benchmark.report import machine, parser
import timo_sim

GOALS, TURNS = (1e-3, 1e-4, 1e-5), 5
OWN = (3, 0.02), (5, 0.02)         # modes, step [s]
ENGINE = (20, 0.002), (40, 0.001)  # elements, step [s]


def main():
    """Measure, taking turns, and write the figures."""
    parser(__spec__, __doc__).parse_args()
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    scene = next(scene for scene in SCENES if scene.name == 'paper')
    truth = of_reference(scene)[1]
    own = [own_case(scene, 'exact', *size) for size in OWN]
    engine, columns = [engine_case(scene, *size) for size in ENGINE], {}
    for _ in range(TURNS):
        for case in own + engine:
            seconds, found = case.run()
            case.times.append(seconds)
            columns[case.settings] = found()

    def row(case):
        stride = max(1, round(case.order[1] / scene.period))
        return {'settings': case.settings, 'seconds': case.seconds,
                'error_m': errors_of(columns[case.settings], truth, stride)['w_l']}

    coarse, fine = (columns[case.settings] for case in engine)
    both = {name: (4.0 * fine[name] - coarse[name]) / 3.0 for name in fine}
    pair = {'settings': ' and '.join(case.settings for case in engine) + ', extrapolated',
            'seconds': sum(case.seconds for case in engine),
            'error_m': errors_of(both, truth, 1)['w_l']}
    text = json.dumps({
        'machine': machine(), 'goals_m': GOALS, 'timo_sim': [*map(row, own)],
        'exudyn': [*map(row, engine), pair]}, indent=1, default=str)
    (ROOT / 'doc' / 'benchmark' / 'pair.json').write_text(text + '\n', encoding='utf-8')
    print(text)


if __name__ == '__main__':
    main()
