# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Fit a scene to a measured record: parameters of the arm, with intervals, and what they predict.

`record` holds what was measured; `mapping` and `logs` read it. `problem` predicts it by runs,
`objective` compares, `search` finds the parameters, and `posterior` says how certain they are;
`result` has `fit`, which does all this, and its report.
"""
