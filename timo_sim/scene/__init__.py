# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Scenes: parameters and their rules, files, and what is made of them: bodies, loads, a Scene.

This package may import `model`, the compiled loads of `steps`, and `topics` for the parameters of
topics and sensors. Values are checked here, once, whether they come from YAML, Python or ROS.
"""
