# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Integration in time: the step ETDRK4, for one run and for lanes, dry friction, loads.

This package may import `compiled` and `model`, of which it knows the layout of motions, the
declared functions and `Formulation`.
"""
