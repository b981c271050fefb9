# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Runs as pictures: tracks of motions, entities and panels for rerun, plots.

This package may import `simulation`, `log` and what is below them; only `rerun` and `plot` import
what they draw with. It uses no ROS.
"""
