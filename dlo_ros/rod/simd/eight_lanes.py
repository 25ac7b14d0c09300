# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Vectors of eight numbers for compiled code: one lane for each parameter set.

Numba knows numbers and arrays; a loop over eight lanes becomes vector instructions only where
LLVM's vectoriser sees through it. Here the vector is a type of its own, so that a kernel reads as
if it were for one rod and works on eight: `load` and `store` move rows of arrays (rows, LANES),
the operators and `root` act on all lanes. Processors with narrower registers use several for one.

Counting references to arrays would take as long as the mathematics. So kernels get the addresses
of rows (`address`) in place of arrays; whoever takes an address keeps the array alive.
"""

from __future__ import annotations

import math
import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray

LANES = 8
WIDTH = 8 * LANES  # bytes of a row
DOUBLE, WIDE = ir.DoubleType(), ir.VectorType(ir.DoubleType(), LANES)
FUSED = ("contract", "nsz", "arcp")  # a product and a sum may become one instruction


class Vector(types.Type):  # type: ignore[misc]
    """LANES numbers in double precision."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector({LANES})")


vector = Vector()


@register_model(Vector)
class VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    """It is held in vector registers."""

    def __init__(self, manager, kind):
        super().__init__(manager, kind, WIDE)


def _broadcast(builder, number):
    first = builder.insert_element(
        ir.Constant(WIDE, ir.Undefined), number, ir.Constant(ir.IntType(32), 0)
    )
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, ir.Constant(WIDE, ir.Undefined), mask)


def _define(operators, name):
    """Let operators act on two vectors, or on a vector and a number, on either side."""
    forms = [(vector, vector), (vector, types.float64), (types.float64, vector)]

    class VectorOperation(ConcreteTemplate):
        cases = [signature(vector, *form) for form in forms]  # noqa: RUF012

    def implementation(context, builder, sig, args):
        wide = [
            arg if kind is vector else _broadcast(builder, arg)
            for arg, kind in zip(args, sig.args, strict=True)
        ]
        return getattr(builder, name)(*wide, flags=FUSED)

    for function in operators:
        infer_global(function)(VectorOperation)
        for form in forms:
            lower_builtin(function, *form)(implementation)


_define((operator.add, operator.iadd), "fadd")
_define((operator.sub, operator.isub), "fsub")
_define((operator.mul, operator.imul), "fmul")
_define((operator.truediv, operator.itruediv), "fdiv")


@infer_global(operator.neg)
class _Negation(ConcreteTemplate):  # type: ignore[misc]
    cases = [signature(vector, vector)]  # noqa: RUF012


@lower_builtin(operator.neg, vector)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0])


ADDRESS = types.CPointer(types.float64)
TABLE = types.CPointer(vector)  # address of rows of which `entry` gives whole ones


def _data(context, builder, kind, array):
    """Address of the first number of an array, or of what is an address already."""
    if isinstance(kind, types.CPointer):
        return array
    return context.make_array(kind)(context, builder, array).data


def _row(context, builder, sig, args):
    """Row args[1] as a vector in memory."""
    return builder.bitcast(_row_start(context, builder, sig, args), WIDE.as_pointer())


def _row_start(context, builder, sig, args):
    """Address of the first number of row args[1]."""
    index = context.cast(builder, args[1], sig.args[1], types.intp)
    first = builder.mul(index, ir.Constant(index.type, LANES))
    return builder.gep(_data(context, builder, sig.args[0], args[0]), [first])


@intrinsic
def address(_, array):
    """Address of a contiguous array of float64, for `load`, `store` and `entry`."""

    def generate(context, builder, sig, args):
        return _data(context, builder, sig.args[0], args[0])

    return ADDRESS(array), generate


@intrinsic
def row_address(_, array, row):
    """Address of a row of a contiguous array (..., rows, LANES), counted through all its axes."""
    return ADDRESS(array, row), _row_start


@intrinsic
def number_address(_, array, number):
    """Address of a number of a contiguous array, where rows begin for `load` and `store`."""

    def generate(context, builder, sig, args):
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        return builder.gep(_data(context, builder, sig.args[0], args[0]), [at])

    return ADDRESS(array, number), generate


@intrinsic
def table_address(_, array, row):
    """The same, for `entry`: what is one number for all lanes elsewhere is one for each there."""

    def generate(context, builder, sig, args):
        return _row(context, builder, sig, args)

    return TABLE(array, row), generate


@intrinsic
def put_entry(_, array, index, value):
    """Write a number of a contiguous array; the index is not checked."""

    def generate(context, builder, sig, args):
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        builder.store(args[2], builder.gep(_data(context, builder, sig.args[0], args[0]), [at]))
        return context.get_dummy_value()

    return types.void(array, index, types.float64), generate


@intrinsic
def entry(_, array, index):
    """A number of a contiguous array, counted through all its axes; the index is not checked.

    Of a `table_address`: a row.
    """
    if array == TABLE:

        def generate_row(context, builder, sig, args):
            at = context.cast(builder, args[1], sig.args[1], types.intp)
            return builder.load(builder.gep(args[0], [at]), align=8)

        return vector(array, index), generate_row

    def generate(context, builder, sig, args):
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        return builder.load(builder.gep(_data(context, builder, sig.args[0], args[0]), [at]))

    return types.float64(array, index), generate


@intrinsic
def load(_, array, row):
    """Row of a contiguous array (rows, LANES); the row is not checked."""

    def generate(context, builder, sig, args):
        return builder.load(_row(context, builder, sig, args), align=8)

    return vector(array, row), generate


@intrinsic
def store(_, array, row, value):
    """Write a row of a contiguous array (rows, LANES); the row is not checked."""

    def generate(context, builder, sig, args):
        builder.store(args[2], _row(context, builder, sig, args), align=8)
        return context.get_dummy_value()

    return types.void(array, row, value), generate


@intrinsic
def spread(_, number):
    """The same number in all lanes."""

    def generate(context, builder, sig, args):
        return _broadcast(builder, context.cast(builder, args[0], sig.args[0], types.float64))

    return vector(number), generate


def _square_root(context, builder, sig, args):
    kind = ir.FunctionType(WIDE, [WIDE])
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.sqrt.v{LANES}f64")
    return builder.call(function, args)


@intrinsic
def root(_, value):
    """Square root."""
    return vector(value), _square_root


class _Root(ConcreteTemplate):  # type: ignore[misc]
    key = np.sqrt
    cases = [signature(vector, vector)]  # noqa: RUF012


infer_global(np.sqrt, types.Function(_Root))  # see `four_lanes`
lower_builtin(np.sqrt, vector)(_square_root)


@intrinsic
def smaller(_, a, b):
    """The smaller one, lane by lane."""

    def generate(context, builder, sig, args):
        return builder.select(builder.fcmp_ordered("<", *args), *args)

    return vector(a, b), generate


@intrinsic
def somewhere(_, value):
    """Whether a number is not 0, or one of a vector's lanes."""

    def generate(context, builder, sig, args):
        zero = ir.Constant(args[0].type, [0.0] * LANES if sig.args[0] is vector else 0.0)
        differs = builder.fcmp_unordered("!=", args[0], zero)
        if sig.args[0] is not vector:
            return differs
        bits = builder.bitcast(differs, ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(value), generate


@intrinsic
def lane(_, value, number):
    """One of the numbers."""

    def generate(context, builder, sig, args):
        index = context.cast(builder, args[1], sig.args[1], types.int32)
        return builder.extract_element(args[0], index)

    return types.float64(value, number), generate


@njit(from_python=False)
def largest(value):
    """The largest of the numbers; NaN where one is."""
    result = lane(value, 0)
    for k in range(1, LANES):
        x = lane(value, k)
        if x > result or np.isnan(x):
            result = x
        # A NaN stays, for nothing is larger.
    return result


def rows(*shape: int) -> FloatArray:
    """An array of zeros (*shape, LANES), each row in one line of the processor's cache."""
    size = math.prod(shape) * LANES
    room = np.zeros(size + LANES)
    first = (-room.__array_interface__["data"][0] % WIDTH) // 8
    return room[first : first + size].reshape(*shape, LANES)
