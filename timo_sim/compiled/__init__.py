# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

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
