# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Corrections to numba, without which machine code depends on what a process has done before.

Names: numba names machine code after the types of its arguments: records by the order in which a
process has met them, nested arrays without their shape. Two sizes that are compiled in different
processes and loaded from disk into one process would then call each other's code. numba names a
NamedTuple without its fields. Here the names depend on the contents of all these types.

Powers: numba compiles `x**2` as a function of its own, once in a process, with the fast math of
whoever uses it first. The last bits would depend on whether the first user is compiled or loaded
from disk. Here powers are compiled first, without fast math.

NUMBA_DISABLE_JIT, also as an entry of .numba_config.yaml: it is for functions of the user. The
physics is compiled all the same, because its lanes and records have no meaning in Python.
"""

from contextlib import contextmanager
import functools
import hashlib

import numba
from numba.core import config, types
from numba.core.types import containers


def _name_by_contents(kind):
    contents = f'{kind.name} {" ".join(getattr(kind, "fields", ()))}'
    return f'{type(kind).__name__}{hashlib.sha256(contents.encode()).hexdigest()[:16]}', ()


def correct_names():
    """Let numba name records, nested arrays and NamedTuples by their contents."""
    for kind in (types.Record, types.NestedArray, containers.NamedTuple):
        setattr(kind, 'mangling_args', property(_name_by_contents))


@contextmanager
def jit_enabled():
    """Let numba compile, whatever NUMBA_DISABLE_JIT says."""
    usual, config.DISABLE_JIT = config.DISABLE_JIT, 0
    try:
        yield
    finally:
        config.DISABLE_JIT = usual


@functools.cache
@jit_enabled()
def compile_powers():
    """Compile x**2 and x**3 without fast math; call this before other functions are compiled."""
    numba.njit(fastmath=False, error_model='numpy')(_powers).compile((types.float64,))


def _powers(x):
    return x**2 + x**3
