# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Decorators for compiled functions: NaN-safe fast math, machine code on disk, bodies by type.

Loops over modes and nodes are short. They are fast if the compiler knows their lengths and knows
that no two arrays overlap, see `constants`. The price is machine code for each size of a model.
"""

from collections.abc import Callable
import inspect
from typing import Any

import numba
from numba.core import config
from numba.core.types import containers
from numba.extending import overload

from timo_sim.compiled.cache import (
    CodeStore, compile_powers, correct_names, jit_enabled, store_directory)

correct_names()

# Sums may be reordered and fused, which vectorises the short loops; NaN and Inf keep their
# meaning, so that a diverged state is still seen ('fast' would assume them away).
FASTMATH = {'reassoc', 'contract', 'nsz'}
# error_model: a division by zero gives Inf or NaN and raises nothing. no_cfunc_wrapper: a wrapper
# for C would contain a copy of the function, which LLVM would optimise once more.
_OPTIONS = {'fastmath': FASTMATH, 'error_model': 'numpy', 'no_cfunc_wrapper': True}


def _optimise_less_for_any_size(compiled):
    # For constants that are not packed LLVM makes further versions of each loop for arrays that do
    # not overlap. They take most of its time and gain nothing for short arrays.
    compiler = compiled._compiler
    compile_as_usual = compiler.compile

    @jit_enabled()
    def compile_signature(arguments, return_type):
        usual = config.OPT
        if isinstance(arguments[0], containers.BaseNamedTuple):
            config.OPT = type(usual)(1)
        try:
            return compile_as_usual(arguments, return_type)
        finally:
            config.OPT = usual

    compiler.compile = compile_signature


@jit_enabled()
def entry_point(function: Callable) -> Any:
    """Compile a module-level function that Python calls; keep its machine code on disk."""
    compiled = numba.njit(**_OPTIONS)(function)
    _optimise_less_for_any_size(compiled)
    if store_directory() is not None:
        compiled._cache = CodeStore(function)
    else:
        compile_powers()
    return compiled


@jit_enabled()
def inner(function: Callable) -> Any:
    """Compile a function that only compiled functions call; it becomes part of its callers."""
    return numba.njit(**_OPTIONS, forceinline=True, no_cpython_wrapper=True)(function)


@jit_enabled()
def strict(function: Callable) -> Any:
    """Compile a function that only compiled functions call, without any fast math."""
    # fastmath is set to False and not left out: then it would be inherited from the first caller.
    return numba.njit(**{**_OPTIONS, 'fastmath': False}, forceinline=True,
                      no_cpython_wrapper=True)(function)


@jit_enabled()
def inlined(function: Callable) -> Any:
    """Compile a function that numba inlines into its callers, before LLVM sees them."""
    # `inner` would be slower: LLVM finds out too late that the arrays do not overlap.
    return numba.njit(**_OPTIONS, inline='always')(function)


def dispatch(declaration: Any, otherwise: Callable | None = None) -> Any:
    """
    Declare a function whose body is chosen, at compile time, by the fields of its first argument.

    A compiled function that takes other compiled functions as arguments cannot be kept on disk;
    one that calls a declared function can. `@declared.of(Fields, ...)` registers a body for
    constants with the fields of a NamedTuple `Fields`; `otherwise` is the body for all others.
    """
    bodies = {}

    def of(*kinds):
        def add(body):
            bodies.update((frozenset(kind._fields), body) for kind in kinds)
            return body
        return add

    def choose(*types):
        return bodies.get(frozenset(getattr(types[0], 'fields', ())), otherwise)

    setattr(choose, '__signature__', inspect.signature(declaration))
    # The body is inlined into its callers. If it were linked, the last bits could differ between
    # the process that compiles and one that loads from disk.
    overload(declaration, jit_options={**_OPTIONS, 'forceinline': True})(choose)
    declaration.of = of
    return declaration


def optional(declaration: Callable) -> Any:
    """Declare a function as `dispatch` does, with its own body where none is registered."""
    return dispatch(declaration, declaration)
