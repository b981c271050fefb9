# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Oracles for tests and benchmarks: other models, other engines, closed forms, damaged files.

Both import this package as `oracles`. It may import timo_sim, whose scenes it takes, but neither
tests nor benchmarks.
"""
