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
neither strings nor lists, and writes x * x for a square. A loop over an array that has one row or
none, `for n in range(len(tables.gear))`, is an `if` that is decided when code is compiled for a
size: without a row nothing is left of it.

What `numba.cfunc` does not do, for which this package exists:

- one intermediate code serves all sizes, and is shipped; numba would compile for each;
- the same source is compiled for vectors of runs (`lanes`) and for derivatives (`duals`);
- code of any processor is made, and object files that call nothing, for C and FMUs;
- no reference is counted (NRT), and bits do not depend on what else is compiled beside.

For that `emit` has a target of its own, of classes for which numba promises nothing:
`codegen.AOTCodeLibrary`, `AOTCPUCodegen`, `cpu.CPUContext` and `registry.CPUTarget` have
subclasses; of their private names it uses `_optimize_functions`, `_linking_libraries`,
`_get_module_for_linking`, `_finalized`, `_final_module`, `_codegen`, `_data_layout`, `_tm`,
`_library_class`, `_internal_codegen`, `_toplevel_typing_context`, `_toplevel_target_context`,
`_target_name`, `_impl_keys` and the option `_nrt`. `_UNUSED` names passes of its pipeline that are
left out.

Tried with numba 0.62.0 (`make test-lowest`) and 0.68.1. With another version first pass
test/physics/test_compiled.py and test_code_store.py: they fail if numba has renamed one of these.
Then compare steps of many runs with single ones (test_batch.py), an exported arm with `Simulator`
to the last bit (test_export.py), and the times of doc/speed.md.

This package imports NumPy, LLVM, numba and small libraries, and nothing of timo_sim.
"""
