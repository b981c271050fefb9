"""
What results are compared with: other models, other engines, closed forms, damaged files.

Tests and benchmarks share it and import it as `oracles`. It may import timo_sim, whose scenes it
takes, but neither tests nor benchmarks.
"""
