"""
Measurements of this package: how true, how fast, how robust; and the pictures of its pages.

Run from the root of the repository, as in `python -m benchmark.speed --quick`. Modules here import
timo_sim, the examples and the tests' `oracles`. The folders share `command`, `process` and
`report`, and import nothing from each other; timo_sim and the oracles import nothing from here.
"""

from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / 'test'))  # `oracles`: what tests and benchmarks share
