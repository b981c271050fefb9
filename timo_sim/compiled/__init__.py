# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Tools for compiled code: decorators, constants, and the way from Python to machine code.

The source of a compiled function is Python. `emit` turns it into LLVM's intermediate code with
numba, once for all sizes: numbers of modes, nodes and states are symbols in it. `machine` gives
them their values and makes machine code in which all loops have known lengths. So LLVM alone
compiles for a size, and numba is not imported where intermediate code is on disk.

A compiled function may use whole numbers, floats, tuples, loops, branches, fields of constants
(see `constants`), elements of arrays and the functions of `functions`. It raises nothing, has
neither strings nor lists, and writes x * x for a square.

This package imports NumPy, LLVM, numba and small libraries, and nothing of timo_sim.
"""
