# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Runs on disk: MCAP files that ros2 bag, rerun and other readers open, and tables of them.

`columns` reads tables that others wrote. This package may import `topics`, `scene` and what is
below them. Nothing here needs ROS.
"""
