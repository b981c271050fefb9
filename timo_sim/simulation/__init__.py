# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
A scene advanced in time: loads and actuators, time steps, sensors, warnings, energy.

This package may import `scene` and what is below it.
"""
