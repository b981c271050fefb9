# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Lanes: numbers of several runs that compiled functions handle as one value.

A function that is compiled for floats can be compiled for lanes, too, if it takes no branch on
them: where it would need one it uses a function of `functions`. A value of type LANES is a
vector of WIDTH floats; an operation on it is one vector instruction, or a few where the
processor's registers are narrower. No operation mixes lanes or changes the order of a sum, and
what is fused is chosen here and not by the optimiser, so the bits of a lane depend on its own
numbers only. A value of type SHARED is the same for all lanes: one float in memory.

In NumPy lanes are the last axis of an array, of length WIDTH.
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

from timo_sim.compiled.functions import WIDTH

VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
# The sign of zero may change. Operations without flags would get numba's fast-math flags, which
# allow reordering.
_FLAGS = ('nsz',)


def is_number(kind: types.Type) -> bool:
    """Return whether a type is that of a float or a whole number."""
    return isinstance(kind, (types.Float, types.Integer))


class _Lanes(types.Type):
    bitwidth = 64 * WIDTH

    def __init__(self):
        super().__init__(f'Lanes({WIDTH})')

    def unify(self, context, other):
        return LANES if is_number(other) or other == SHARED else None

    def can_convert_from(self, context, other):
        return Conversion.safe if is_number(other) else None


class _Shared(types.Type):
    bitwidth = 64

    def __init__(self):
        super().__init__(f'Shared({WIDTH})')

    def unify(self, context, other):
        return LANES if is_number(other) or other == LANES else None

    def can_convert_to(self, context, other):
        return Conversion.safe if other == LANES else None


class _Mask(types.Type):
    def __init__(self):
        super().__init__(f'Mask({WIDTH})')

    # While types are inferred, a sum may be a float before it becomes one of lanes.
    def unify(self, context, other):
        return self if other == types.boolean else None

    def can_convert_from(self, context, other):
        return Conversion.safe if other == types.boolean else None


LANES, SHARED, MASK = _Lanes(), _Shared(), _Mask()


def represent(kind: type, type_of: Callable[[Any], ir.Type]) -> None:
    """Represent values of a type of numba by a type of LLVM."""
    class Model(models.PrimitiveModel):
        def __init__(self, manager, each):
            super().__init__(manager, each, type_of(each))

    register_default(kind)(Model)


represent(_Lanes, lambda _: VECTOR)
represent(_Shared, lambda _: VECTOR)
represent(_Mask, lambda _: ir.VectorType(ir.IntType(1), WIDTH))


def infer(function: Any) -> Callable[[Callable[..., Any]], None]:
    """Return a decorator for what returns the signature of a function, or None, for types."""
    def register(signature_for):
        infer_global(function)(type('Template', (AbstractTemplate,), {
            'generic': lambda _, given, __: signature_for(*given)}))
    return register


def spread(builder: ir.IRBuilder, value: ir.Value, vector: ir.VectorType = VECTOR) -> ir.Value:
    """Return a vector with the same float in all places."""
    nothing, index = ir.Constant(vector, ir.Undefined), ir.IntType(32)
    single = builder.insert_element(nothing, value, ir.Constant(index, 0))
    return builder.shuffle_vector(single, nothing, ir.Constant(
        ir.VectorType(index, vector.count), vector.count * [0]))


@lower_cast(types.Float, LANES)
@lower_cast(types.Integer, LANES)
def _lanes_of_number(context, builder, source, _, value):
    return spread(builder, context.cast(builder, value, source, types.float64))


@lower_cast(SHARED, LANES)
def _lanes_of_shared(context, builder, source, _, value):
    return value


def _define(operators, kinds, result, generate):
    """Define operators of lanes or masks; `generate` takes an IRBuilder and the operands."""
    def signature_for(*given):
        ours = any(kind in (LANES, SHARED, MASK) for kind in given)
        return signature(result, *kinds) if ours and len(given) == len(kinds) and all(
            kind == wanted or wanted == LANES and (kind == SHARED or is_number(kind))
            for kind, wanted in zip(given, kinds)) else None

    for each in operators:
        infer(each)(signature_for)
        lower_builtin(each, *kinds)(
            lambda context, builder, _, operands: generate(builder, *operands))


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
    fused = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(a.type, 3 * [a.type]),
        f'llvm.fmuladd.v{a.type.count}f64')
    return builder.call(fused, [*b.operands, a])


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
        _define((getattr(operator, name), getattr(operator, f'i{name}')), (LANES, LANES), LANES,
                generate)
    for compare, sign in ((operator.eq, '=='), (operator.lt, '<'), (operator.le, '<='),
                          (operator.gt, '>'), (operator.ge, '>=')):
        _define((compare,), (LANES, LANES), MASK,
                lambda builder, a, b, sign=sign: builder.fcmp_ordered(sign, a, b))
    _define((operator.ne,), (LANES, LANES), MASK,
            lambda builder, a, b: builder.fcmp_unordered('!=', a, b))
    _define((operator.neg,), (LANES,), LANES, lambda builder, a: builder.fneg(a))
    for both, instruction in ((operator.and_, 'and_'), (operator.or_, 'or_')):
        _define((both,), (MASK, MASK), MASK,
                lambda builder, a, b, instruction=instruction: getattr(builder, instruction)(a, b))


_define_arithmetic()
