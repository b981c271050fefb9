# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Topics as data: their names, types and contents, the meaning of commands, and serialisation.

This package may import NumPy and `model.layout`; it uses neither ROS nor files. A topic is an
entry in `outputs.outputs`, a sensor one in `outputs.SENSORS`, a command one in
`commands.COMMANDS`.
"""
