# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Parts of controllers, made from a scene or its linear model.

It may import all folders but `ros` and `cli`.
"""
