# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures accuracy, speed and robustness of this package, and makes the pictures of its pages.

Run from the root of the repository, as in `python -m benchmark.speed --quick`. `accuracy` has run
time against error, references and fits, `figures` the pictures of doc/, `speed` times, memory and
latencies, `stress` random scenes, attacks and damage. They share `report`, `timing` and `process`
and import timo_sim, the examples and the tests' `oracles`, which import nothing from here.
"""

import os
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / 'test'))  # `oracles`: what tests and benchmarks share
# Libraries read these when they are imported: one thread each, and pictures without a screen.
os.environ.update(OMP_NUM_THREADS='1', OPENBLAS_NUM_THREADS='1', NUMBA_NUM_THREADS='1')
os.environ.setdefault('MPLBACKEND', 'Agg')
