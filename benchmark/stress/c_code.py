# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Random scenes as C libraries: is each number of the state that of `Simulator`?"""

from pathlib import Path
import subprocess
import tempfile
import warnings

import numpy as np

from benchmark import ROOT
from benchmark.report import table
from benchmark.stress.scenes import cell
import timo_sim
from timo_sim.export.c import write_c
from timo_sim.export.constants import interface_of
from timo_sim.model.layout import LOADS
from timo_sim.scene.loads import Harmonic
from timo_sim.export.instance import SAVED

CALLS, STEPS = 10, 20  # of `arm_step`, with new commands each, and time steps of a call
_COMMAND = 1e-3  # standard deviation of commands, besides the loads of the scenes [SI]
_HEADER = ['loads of the scene', 'tried', 'same bits', 'largest relative difference']


def rows(count, seed=1):
    """Return rows of the table: scenes with the same bits, others with the largest difference."""
    found, refused, diverged = {}, 0, 0
    for number in range(count):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', timo_sim.ModelWarning)
                scene = timo_sim.load_scene(cell(number, seed).values)
                difference = _compare(scene, np.random.default_rng(number))
        except timo_sim.ParameterError:
            refused += 1
            continue
        except timo_sim.DivergenceError:
            diverged += 1
            continue
        driven = scene.load.terms['angle'] and scene.constraints.locked is None
        waves = any(isinstance(term, Harmonic) for terms in scene.load.terms.values()
                    for term in terms)
        found.setdefault('harmonic, or a drive' if driven or waves else 'none of these',
                         []).append(difference)
    return [*((name, len(each), each.count(0.0), f'{max(each):.1e}')
              for name, each in sorted(found.items())),
            ('the export is refused', refused, '', ''), ('the run diverges', diverged, '', '')]


def _compare(scene, random):
    # The largest difference of a number of the state from that of Simulator, in parts of the
    # largest size of this number in the run.
    lines, states = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_c(scene, folder, derivatives=False)
        subprocess.run(['cc', f'-I{folder}', '-o', folder / 'run', ROOT / 'test/data/run_arm.c',
                        folder / 'arm.o'], check=True)
        simulator = timo_sim.Simulator(scene)
        for _ in range(CALLS):
            commanded = np.zeros(LOADS)
            for number, each in enumerate(interface_of(scene, False).inputs):
                commanded[each.column] = _COMMAND * random.normal()
                lines.append(f'i {number} {commanded[each.column].hex()}')
            lines += [f's {STEPS}', 'w']
            simulator.advance(STEPS, commanded)
            states.append(simulator._state.copy())
        text = subprocess.run([folder / 'run'], input='\n'.join(lines), text=True, check=True,
                              stdout=subprocess.PIPE).stdout
    found = np.array([[float.fromhex(word) for word in line.split()[SAVED:]]
                      for line in text.splitlines()])
    size = np.abs(states).max(axis=0)
    return float((np.abs(found - states) / np.where(size > 0.0, size, 1.0)).max())


def part(quick):
    """Return the table."""
    return table(_HEADER, rows(34 if quick else 1000))
