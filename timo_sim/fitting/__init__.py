# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Fit a scene to a measured record: parameters of the arm, with intervals, and what they predict.

`record` holds and reads what was measured, `problem` compares it with runs and finds the
parameters, `result` says how certain they are.
"""
