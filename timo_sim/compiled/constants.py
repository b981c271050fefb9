# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Constants and local arrays of compiled functions, with shapes that the compiler knows."""

import functools
import math
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import _empty_nd_impl
import numpy as np

from timo_sim.compiled.lanes import LANES, SHARED, WIDTH

_CACHE_LINE = 64  # alignment of lanes in memory [B]


@functools.cache
def _unique(layout):
    # One dtype object per layout, because numba keeps every one that it has seen.
    return layout


def pack(fields: Any) -> Any:
    """
    Return a NamedTuple of numbers and arrays as one block of memory with known shapes.

    Returns
    -------
    numpy.void
        A NumPy record; names and shapes of its fields are part of its type.

    """
    values = {name: np.asarray(value) for name, value in fields._asdict().items()}
    packed = np.zeros((), _unique(np.dtype([
        (name, value.dtype.str, value.shape) for name, value in values.items()])))
    for name, value in values.items():
        packed[name] = value
    return packed[()]


def pack_lanes(fields: Any) -> np.ndarray:
    """
    Return a NamedTuple of arrays whose first axis is that of lanes as records with known shapes.

    Parameters
    ----------
    fields : NamedTuple
        Of arrays for a multiple of WIDTH lanes; whole numbers must be the same in all.

    Returns
    -------
    ndarray, shape (lanes // WIDTH,)
        Records; numbers have the lanes as last axis.

    """
    values = {name: np.asarray(value) for name, value in fields._asdict().items()}
    count = len(next(iter(values.values()))) // WIDTH
    for name, stack in values.items():
        if stack.dtype == float:
            values[name] = np.moveaxis(stack.reshape(count, WIDTH, *stack.shape[1:]), 1, -1)
        else:
            values[name] = stack[:count]
    sizes = [_CACHE_LINE * math.ceil(stack[0].nbytes / _CACHE_LINE) for stack in values.values()]
    layout = np.dtype({'names': list(values), 'itemsize': sum(sizes),
                       'formats': [(stack.dtype, stack.shape[1:]) for stack in values.values()],
                       'offsets': np.cumsum([0, *sizes[:-1]]).tolist()})
    memory = np.zeros(count * layout.itemsize + _CACHE_LINE, dtype=np.uint8)
    begin = -memory.ctypes.data % _CACHE_LINE
    packed = memory[begin:begin + count * layout.itemsize].view(_unique(layout))
    for name, stack in values.items():
        packed[name] = stack
    return packed


def of_any_size(fields: Any) -> Any:
    """Return a NamedTuple of numbers and arrays for which all sizes share one machine code."""
    values = (np.array(value, order='C') for value in fields)
    return fields._make(value if value.ndim else value.item() for value in values)


@intrinsic
def local(_, like):
    """
    Return a work array, not initialised, for the current call of a compiled function.

    Parameters
    ----------
    like : tuple of arrays
        Fields of constants; the length of the new array's k-th axis is that of the k-th field's
        first axis. If the constants are packed, the array is on the stack, else on the heap.

    """
    # Its numbers are of the kind of the constants: floats, or lanes.
    lanes = any(array.dtype in (LANES, SHARED) for array in like)
    dtype = LANES if lanes else types.float64
    kind, width = types.Array(dtype, len(like), 'C', aligned=not lanes), dtype.bitwidth // 8
    packed = all(isinstance(array, types.NestedArray) for array in like)
    shape = tuple(array.shape[0] for array in like) if packed else ()

    def allocate(context, builder, signature, arguments):
        arrays = (context.make_array(array)(context, builder, value) for array, value in zip(
            like, cgutils.unpack_tuple(builder, arguments[0])))
        lengths = [builder.extract_value(array.shape, 0) for array in arrays]
        return _empty_nd_impl(context, builder, kind, lengths)._getvalue()

    def generate(context, builder, signature, arguments):
        size = ir.Constant(ir.IntType(64), max(1, math.prod(shape)))
        data = cgutils.alloca_once(builder, context.get_data_type(dtype), size=size)
        data.align = max(32, width)  # [B], the width of 256-bit vector registers, or of lanes
        array = context.make_array(kind)(context, builder)
        number = functools.partial(context.get_constant, types.intp)
        context.populate_array(
            array, data=data, shape=[number(length) for length in shape],
            strides=[number(width * math.prod(shape[axis + 1:])) for axis in range(len(shape))],
            itemsize=number(width), meminfo=None)
        return array._getvalue()

    return kind(like), generate if packed else allocate
