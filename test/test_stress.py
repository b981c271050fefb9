# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The quick part of the matrix of scenes of `make stress`: nothing is wrong and silent."""

import math

import numpy as np
import pytest

from benchmark.stress.numerics import cells, judge, LEVELS

PLAIN = {name: levels[0] for name, levels in LEVELS.items()}
# What was wrong and silent once: with an embedded estimate of third order, or looked at too late.
SILENT_ONCE = [
    {'formulation': 'newton', 'slenderness': 10.0},
    {'formulation': 'newton', 'step': 0.005, 'speed': 0.0, 'slenderness': 50.0, 'tip mass': 0.0,
     'carrier': 1e-3, 'damping': 0.01, 'load': 'near resonance 1'},
    {'formulation': 'newton', 'step': 0.02, 'vibration': 1e-3, 'slenderness': 4.0,
     'tip mass': 100.0, 'tip inertia': 100.0, 'carrier': 1e-3, 'damping': 1.0, 'load': 'torque'},
    {'modes': 5, 'vibration': 1.0},
    {'modes': 5, 'step': 0.001, 'speed': 0.0, 'vibration': 1.0, 'tip mass': 100.0,
     'tip inertia': 0.0, 'carrier': 1e6, 'damping': 0.1, 'load': 'resonance 2'},
]


@pytest.mark.parametrize('differences', SILENT_ONCE, ids=str)
def test_what_was_silent_once(differences):
    for verdict, error, reason, _ in judge({**PLAIN, **differences}):
        assert verdict != 'silent', (error, reason)


def test_no_cell_is_wrong_and_silent():
    chosen = [cell for cell in cells(150, seed=2)
              if cell['modes'] == 3 and cell['carrier'] != 'held']
    found = [judge(cell) for cell in chosen]
    for cell, verdicts in zip(chosen, found):
        for verdict, error, reason, _ in verdicts:
            assert verdict != 'silent', (cell, error)
            assert bool(reason) or verdict == 'accurate'
    given, within = zip(*found)
    assert sum(verdict == 'accurate' for verdict, *_ in within) > 0.95 * len(chosen)
    errors = [[error for _, error, *_ in verdicts if math.isfinite(error)]
              for verdicts in (given, within)]
    assert np.median(errors[1]) < np.median(errors[0])
