# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Functions of floats, or of lanes (see `jit.lanes`), that stand in for branches and NumPy's."""

import math

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, overload
import numpy as np

from timo_sim.jit.lanes import LANES, MASK, SHARED, VECTOR, WIDTH

_PLAIN = {'forceinline': True, 'fastmath': False}


def _function_of(name):
    # A function of LLVM that takes and returns lanes.
    @intrinsic
    def call(context, value):
        def generate(context, builder, _, arguments):
            function = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(VECTOR, [VECTOR]), f'llvm.{name}.v{WIDTH}f64')
            return builder.call(function, [context.cast(builder, arguments[0], value, LANES)])
        return LANES(value), generate
    return call


_floor_of_lanes, _magnitude_of_lanes = _function_of('floor'), _function_of('fabs')


@intrinsic
def _select(context, condition, yes, no):
    def generate(context, builder, _, arguments):
        values = [context.cast(builder, value, kind, LANES)
                  for value, kind in zip(arguments[1:], (yes, no))]
        return builder.select(arguments[0], *values)
    return LANES(condition, yes, no), generate


@intrinsic
def _any_of(context, condition):
    def generate(context, builder, _, arguments):
        bits = builder.bitcast(arguments[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned('!=', bits, ir.Constant(bits.type, 0))
    return types.boolean(condition), generate


def floor(value):
    """Return the largest whole number up to a value, as a float."""
    return float(math.floor(value))


@overload(floor, jit_options=_PLAIN)
def _floor(value):
    if value in (LANES, SHARED):
        return lambda value: _floor_of_lanes(value)
    return lambda value: np.floor(value)


def magnitude(value):
    """Return the absolute value."""
    return abs(value)


@overload(magnitude, jit_options=_PLAIN)
def _magnitude(value):
    if value in (LANES, SHARED):
        return lambda value: _magnitude_of_lanes(value)
    return lambda value: abs(value)


def where(condition, yes, no):
    """Return `yes` where a condition holds, else `no`; both have been computed."""
    return yes if condition else no


@overload(where, jit_options=_PLAIN)
def _where(condition, yes, no):
    if condition == MASK:
        return lambda condition, yes, no: _select(condition, yes, no)
    return lambda condition, yes, no: yes if condition else no


def some(condition):
    """Return whether a condition holds, in any lane."""
    return condition


@overload(some, jit_options=_PLAIN)
def _some(condition):
    if condition == MASK:
        return lambda condition: _any_of(condition)
    return lambda condition: condition


def is_lanes(vector):
    """Return whether the numbers of an array are lanes; known to the compiler."""
    return False


@overload(is_lanes, jit_options=_PLAIN)
def _is_lanes(vector):
    if getattr(vector, 'dtype', None) in (LANES, SHARED):
        return lambda vector: True
    return lambda vector: False
