# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Whole runs: simulated, measured by finer ones, replayed, linearised, varied.

This package may import `simulation`, `log`, `view` (when a run is saved or shown) and what is
below them.
"""
