# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Lanes: numbers of several runs that compiled functions handle as one value.

A function that is compiled for floats can be compiled for lanes, too, if it takes no branch on
them: where it would need one it uses a function of `functions`. A value of type LANES is a
vector of WIDTH floats; an operation on it is one vector instruction, or a few where the
processor's registers are narrower. No operation mixes lanes or changes the order of a sum, and
what is fused is chosen here and not by the optimiser, so the bits of a lane depend on its own
numbers only. A value of type Shared is the same for all lanes: one float in memory.

In NumPy lanes are the last axis of an array, of length WIDTH. On a GPU each is a thread: values
are of type THREAD, of one lane, and the last axis is of length WARP, so that threads side by side
read numbers that are side by side.
"""

from collections.abc import Callable
import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models, register_default
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast

from timo_sim.compiled.functions import WARP, WIDTH

# The sign of zero may change. Operations without flags would get numba's fast-math flags, which
# allow reordering.
_FLAGS = ('nsz',)


def is_number(kind: types.Type) -> bool:
    """Return whether a type is that of a float or a whole number."""
    return isinstance(kind, (types.Float, types.Integer))


class Lanes(types.Type):
    """Numbers of as many runs as its width."""

    def __init__(self, width: int) -> None:
        self.width, self.bitwidth = width, 64 * width
        self.vector = ir.VectorType(ir.DoubleType(), width)
        # How far apart the vectors of a field or array are in memory.
        self.stride = 1 if width == WIDTH else WARP // width
        super().__init__(f'Lanes({width})')

    def unify(self, context, other):
        return self if is_number(other) or other == Shared(self.width) else None

    def can_convert_from(self, context, other):
        return Conversion.safe if is_number(other) else None


class Shared(types.Type):
    """A number that is the same in lanes of a width."""

    bitwidth = 64

    def __init__(self, width: int) -> None:
        self.width, self.vector = width, ir.VectorType(ir.DoubleType(), width)
        super().__init__(f'Shared({width})')

    def unify(self, context, other):
        return Lanes(self.width) if is_number(other) or other == Lanes(self.width) else None

    def can_convert_to(self, context, other):
        return Conversion.safe if other == Lanes(self.width) else None


class Mask(types.Type):
    """Conditions of lanes of a width."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(f'Mask({width})')

    # While types are inferred, a sum may be a float before it becomes one of lanes.
    def unify(self, context, other):
        return self if other == types.boolean else None

    def can_convert_from(self, context, other):
        return Conversion.safe if other == types.boolean else None


LANES, THREAD = Lanes(WIDTH), Lanes(1)


def lanes_of(*given: types.Type) -> Lanes | None:
    """Return the type of lanes among types of numbers and masks; None if there is none."""
    return next((Lanes(kind.width) for kind in given if isinstance(
        kind, (Lanes, Shared, Mask))), None)


def represent(kind: type, type_of: Callable[[Any], ir.Type]) -> None:
    """Represent values of a type of numba by a type of LLVM."""
    class Model(models.PrimitiveModel):
        def __init__(self, manager, each):
            super().__init__(manager, each, type_of(each))

    register_default(kind)(Model)


represent(Lanes, lambda kind: kind.vector)
represent(Shared, lambda kind: kind.vector)
represent(Mask, lambda kind: ir.VectorType(ir.IntType(1), kind.width))


def infer(function: Any) -> Callable[[Callable[..., Any]], None]:
    """Return a decorator for what returns the signature of a function, or None, for types."""
    def register(signature_for):
        infer_global(function)(type('Template', (AbstractTemplate,), {
            'generic': lambda _, given, __: signature_for(*given)}))
    return register


def lower(function: Any, *kinds: Any) -> Callable[[Callable], Callable]:
    """Return a decorator for what takes an IRBuilder and the arguments of a function."""
    def register(generate):
        lower_builtin(function, *kinds)(
            lambda context, builder, _, arguments: generate(builder, *arguments))
        return generate
    return register


def intrinsic(builder: ir.IRBuilder, name: str, *values: ir.Value) -> ir.Value:
    """Return what an intrinsic function of LLVM makes of floats or vectors."""
    kind = values[0].type
    length = f'v{kind.count}' if isinstance(kind, ir.VectorType) else ''
    return builder.call(cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, len(values) * [kind]),
        f'llvm.{name}.{length}f64'), values)


def spread(builder: ir.IRBuilder, value: ir.Value, vector: ir.VectorType) -> ir.Value:
    """Return a vector with the same float in all places."""
    nothing, index = ir.Constant(vector, ir.Undefined), ir.IntType(32)
    single = builder.insert_element(nothing, value, ir.Constant(index, 0))
    return builder.shuffle_vector(single, nothing, ir.Constant(
        ir.VectorType(index, vector.count), vector.count * [0]))


@lower_cast(types.Float, Lanes)
@lower_cast(types.Integer, Lanes)
def _lanes_of_number(context, builder, source, lanes, value):
    return spread(builder, context.cast(builder, value, source, types.float64), lanes.vector)


@lower_cast(Shared, Lanes)
def _lanes_of_shared(context, builder, source, _, value):
    return value


def _define(operators, kinds, result, generate):
    """Define operators of lanes or masks; `generate` takes an IRBuilder and the operands."""
    def signature_for(*given):
        lanes = lanes_of(*given)
        return signature(*(kind(lanes.width) for kind in (result, *kinds))) if (
            lanes and len(given) == len(kinds)) and all(
            isinstance(kind, wanted) or wanted is Lanes and (
                isinstance(kind, Shared) or is_number(kind))
            for kind, wanted in zip(given, kinds)) else None

    for each in operators:
        infer(each)(signature_for)
        lower(each, *kinds)(generate)


def _is_product(value):
    return getattr(value, 'opname', None) == 'fmul'


# Sums and products of vectors of any length.

def add(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    """
    Return a sum, with which a product is fused where the processor can do that.

    The choice is made here, by the source alone, so that it does not depend on what else the
    optimiser sees.
    """
    if _is_product(a) and not _is_product(b):
        a, b = b, a
    if not _is_product(b):
        return builder.fadd(a, b, flags=_FLAGS)
    return intrinsic(builder, 'fmuladd', *b.operands, a)


def subtract(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    """Return a difference, fused as a sum is."""
    if _is_product(b):
        return add(builder, a, multiply(builder, builder.fneg(b.operands[0]), b.operands[1]))
    if _is_product(a):
        return add(builder, a, builder.fneg(b))
    return builder.fsub(a, b, flags=_FLAGS)


def multiply(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    """Return a product."""
    return builder.fmul(a, b, flags=_FLAGS)


def _define_arithmetic():
    for name, generate in (
            ('add', add), ('sub', subtract), ('mul', multiply),
            ('truediv', lambda builder, a, b: builder.fdiv(a, b, flags=_FLAGS))):
        _define((getattr(operator, name), getattr(operator, f'i{name}')), (Lanes, Lanes), Lanes,
                generate)
    for compare, sign in ((operator.eq, '=='), (operator.lt, '<'), (operator.le, '<='),
                          (operator.gt, '>'), (operator.ge, '>=')):
        _define((compare,), (Lanes, Lanes), Mask,
                lambda builder, a, b, sign=sign: builder.fcmp_ordered(sign, a, b))
    _define((operator.ne,), (Lanes, Lanes), Mask,
            lambda builder, a, b: builder.fcmp_unordered('!=', a, b))
    _define((operator.neg,), (Lanes,), Lanes, lambda builder, a: builder.fneg(a))
    for both, instruction in ((operator.and_, 'and_'), (operator.or_, 'or_')):
        _define((both,), (Mask, Mask), Mask,
                lambda builder, a, b, instruction=instruction: getattr(builder, instruction)(a, b))


_define_arithmetic()
