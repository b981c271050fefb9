# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Duals: numbers with their derivatives by several directions, for forward differentiation.

A function that is compiled for floats can be compiled for duals, too, as for lanes. A value of
type Dual is a number, in place 0, and its `size` - 1 derivatives. Constants stay floats, and so
does what is computed of floats alone: an operation of a dual and a float costs one vector
operation, as sums do, a product of two duals two. Comparisons are by the number and `floor` is a
float, so that branches are taken as without derivatives.

In NumPy, and by `with_derivatives`, duals are the last axis of an array of floats.
"""

import operator

from llvmlite import ir
from numba.core import types
from numba.core.typeconv import Conversion
from numba.core.typing.templates import signature
from numba.extending import lower_cast

from timo_sim.compiled import functions
from timo_sim.compiled.functions import WIDTH
from timo_sim.compiled.lanes import (
    add, infer, intrinsic, is_number, lower, multiply, represent, spread, subtract)

_INDEX = ir.IntType(32)


class Dual(types.Type):
    """
    A number and its derivatives by `size` - 1 directions, a multiple of 4 in all.

    LLVM sees vectors of WIDTH floats, of which the last may be half as long.
    """

    def __init__(self, size: int) -> None:
        self.size, self.bitwidth = size, 64 * size
        self.vectors = [ir.VectorType(ir.DoubleType(), min(WIDTH, size - begin))
                        for begin in range(0, size, WIDTH)]
        super().__init__(f'Dual({size})')

    def unify(self, context, other):
        return self if is_number(other) else None

    def can_convert_from(self, context, other):
        return Conversion.safe if is_number(other) else None


class Constant(types.Type):
    """In memory beside duals: a float, which has no derivatives."""

    def __init__(self, size: int) -> None:
        self.size = size
        super().__init__(f'Constant({size})')


represent(Dual, lambda kind: ir.LiteralStructType(kind.vectors))


def dual_of(*given: types.Type) -> Dual | None:
    """Return the first type of duals, or that of duals beside constants; None if there is none."""
    return next((Dual(kind.size) for kind in given if isinstance(kind, (Dual, Constant))), None)


def _dual(builder, parts):
    """Return a dual of vectors; it keeps them, so that sums can see of what they are."""
    made = ir.Constant(ir.LiteralStructType([part.type for part in parts]), ir.Undefined)
    for n, part in enumerate(parts):
        made = builder.insert_value(made, part, n)
    made.parts = parts
    return made


def _parts(builder, dual):
    return getattr(dual, 'parts', None) or [
        builder.extract_value(dual, n) for n in range(len(dual.type.elements))]


def _map(builder, generate, *duals):
    """Return a dual of what `generate` makes of the n-th vectors of some duals, and of n."""
    return _dual(builder, [generate(n, *parts) for n, parts in enumerate(zip(
        *(_parts(builder, dual) for dual in duals)))])


def _place(builder, place, n, vector):
    first = builder.gep(place, [ir.Constant(_INDEX, 0), ir.Constant(_INDEX, WIDTH * n)],
                        inbounds=True)
    return builder.bitcast(first, vector.as_pointer())


def load(builder: ir.IRBuilder, place: ir.Value, kind: Dual) -> ir.Value:
    """Return the dual at a place in memory."""
    parts = [builder.load(_place(builder, place, n, vector))
             for n, vector in enumerate(kind.vectors)]
    for part in parts:
        part.align = 8
    return _dual(builder, parts)


def store(builder: ir.IRBuilder, dual: ir.Value, place: ir.Value) -> None:
    """Write a dual to a place in memory."""
    for n, part in enumerate(_parts(builder, dual)):
        builder.store(part, _place(builder, place, n, part.type)).align = 8


def _value(builder, dual):
    return builder.extract_element(_parts(builder, dual)[0], ir.Constant(_INDEX, 0))


def _with_value(builder, n, derivatives, other):
    """Return derivatives, and in place 0 of the dual what `other` has there."""
    mask = ir.Constant(ir.VectorType(ir.IntType(1), derivatives.type.count),
                       [k > 0 for k in range(derivatives.type.count)])
    return derivatives if n else builder.select(mask, derivatives, other)


def _chain(builder, value, slope, dual):
    """Return a value, with the derivatives of a dual times a slope."""
    return _map(builder, lambda n, part: _with_value(
        builder, n, multiply(builder, spread(builder, slope, part.type), part),
        spread(builder, value, part.type)), dual)


@lower_cast(types.Float, Dual)
@lower_cast(types.Integer, Dual)
def _dual_of_number(context, builder, source, kind, value):
    number = context.cast(builder, value, source, types.float64)
    first, *rest = [ir.Constant(vector, None) for vector in kind.vectors]
    made = _dual(builder, [
        builder.insert_element(first, number, ir.Constant(_INDEX, 0)), *rest])
    made.number = number  # for products with it
    return made


def _negate(builder, a):
    return _map(builder, lambda n, part: builder.fneg(part), a)


def _times(builder, a, number):
    return _map(builder, lambda n, part: multiply(
        builder, part, spread(builder, number, part.type)), a)


def _multiply(builder, a, b):
    """Return a b' + b a'; place 0 takes the first term alone."""
    for number, other in (getattr(a, 'number', None), b), (getattr(b, 'number', None), a):
        if number is not None:
            return _times(builder, other, number)
    left, right = _value(builder, a), _value(builder, b)
    terms = [_times(builder, b, left), _map(builder, lambda n, part: multiply(
        builder, part, _with_value(builder, n, spread(builder, right, part.type),
                                   ir.Constant(part.type, None))), a)]
    made = _add(builder, *terms)
    made.terms = terms
    return made


def _add(builder, a, b, combine=add):
    """Return a + b or, with `combine` = subtract, a - b."""
    if hasattr(a, 'terms') and not hasattr(b, 'terms'):
        # Each product of vectors is fused with a sum.
        return _add(builder, _add(builder, a.terms[0], b, combine), a.terms[1])
    for term in getattr(b, 'terms', [b]):
        a = _map(builder, lambda n, a, b: combine(builder, a, b), a, term)
    return a


def _subtract(builder, a, b):
    return _add(builder, a, b, subtract)


def _divide(builder, a, b):
    """Return the quotient q, with derivatives (a' - q b') / b."""
    inverse = builder.fdiv(ir.Constant(ir.DoubleType(), 1.0), _value(builder, b))
    if hasattr(b, 'number'):
        return _times(builder, a, inverse)
    quotient = builder.fmul(_value(builder, a), inverse)
    rest = _subtract(builder, a, _times(builder, b, quotient))
    return _chain(builder, quotient, inverse, rest)


def _define(operators, count, result, generate):
    """Define operators of duals, of which one may be a number; `result` None: a dual."""
    def signature_for(*given):
        kind = dual_of(*given)
        return signature(result or kind, *count * [kind]) if kind and len(given) == count and all(
            each == kind or is_number(each) for each in given) else None

    for each in operators:
        infer(each)(signature_for)
        lower(each, *count * [Dual])(generate)


def _define_arithmetic():
    for name, generate in (('add', _add), ('sub', _subtract), ('mul', _multiply),
                           ('truediv', _divide)):
        _define((getattr(operator, name), getattr(operator, f'i{name}')), 2, None, generate)
    _define((operator.neg,), 1, None, _negate)
    for compare, sign in ((operator.eq, '=='), (operator.lt, '<'), (operator.le, '<='),
                          (operator.gt, '>'), (operator.ge, '>='), (operator.ne, '!=')):
        _define((compare,), 2, types.boolean, lambda builder, a, b, sign=sign: (
            builder.fcmp_unordered if sign == '!=' else builder.fcmp_ordered)(
                sign, _value(builder, a), _value(builder, b)))


_define_arithmetic()


# Functions of `functions`; those that lanes have, too, are inferred in `emit`.

lower(functions.floor, Dual)(
    lambda builder, dual: intrinsic(builder, 'floor', _value(builder, dual)))
lower(functions.value_of, Dual)(_value)
lower(functions.chain, types.Float, types.Float, Dual)(_chain)


@lower(functions.where, types.Boolean, Dual, Dual)
def _choose(builder, condition, yes, no):
    return _map(builder, lambda n, yes, no: builder.select(condition, yes, no), yes, no)


@lower(functions.magnitude, Dual)
def _magnitude(builder, dual):
    value = _value(builder, dual)
    return _choose(builder, builder.fcmp_ordered('<', value, ir.Constant(value.type, 0.0)),
                   _negate(builder, dual), dual)


@lower(functions.square_root, Dual)
def _square_root(builder, dual):
    root = intrinsic(builder, 'sqrt', _value(builder, dual))
    return _chain(builder, root, builder.fdiv(ir.Constant(root.type, 0.5), root), dual)
