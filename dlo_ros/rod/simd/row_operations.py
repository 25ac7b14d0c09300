# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rows of fixed width as single vector operations of compiled code.

A loop over four or sixteen neighbours is unrolled by the compiler before it thinks of vectors, and
then stays scalar. Here such a row is one vector from the start; LLVM splits it into whatever the
processor has. Arrays are C-contiguous float64 of any shape and are addressed by flat indices.
Nothing is checked: the caller sees to it that all lies inside.
"""

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

CONTRACT = ("contract",)  # a product and a sum may become one fused operation


def _pointer(context, builder, array_type, array, index, width):
    """Pointer to `width` numbers from a flat index on."""
    data = context.make_array(array_type)(context, builder, array).data
    row = ir.VectorType(ir.DoubleType(), width).as_pointer()
    return builder.bitcast(builder.gep(data, [index]), row)


def _broadcast(builder, value, width):
    row = ir.Constant(ir.VectorType(ir.DoubleType(), width), ir.Undefined)
    row = builder.insert_element(row, value, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(row, row, lanes)


def _check(*arrays):
    for array in arrays:
        if not (isinstance(array, types.Array) and array.layout == "C"
                and array.dtype == types.float64):  # fmt: skip
            raise TypingError(f"rows live in C-contiguous float64 arrays, not in {array}")


def _signature(out, at, factors, rows, start, width):
    """Signature of `set_rows` and `add_rows`; None asks numba for literal types."""
    if not isinstance(width, types.IntegerLiteral):
        return None
    _check(out, rows)
    if not (isinstance(factors, types.UniTuple) and factors.dtype == types.float64):
        raise TypingError(f"factors of rows are a tuple of float64, not {factors}")
    return types.void(out, types.intp, factors, rows, types.intp, width)


def _combine(context, builder, signature, arguments, old):
    """Write the combination of rows, on top of what is there where `old`."""
    out_type, _, factors_type, rows_type, _, width_type = signature.args
    out, at, factors, rows, start, _ = arguments
    width = width_type.literal_value
    target = _pointer(context, builder, out_type, out, at, width)
    total = builder.load(target, align=8) if old else None
    for k in range(factors_type.count):
        index = builder.add(start, ir.Constant(start.type, k * width))
        row = builder.load(_pointer(context, builder, rows_type, rows, index, width), align=8)
        factor = _broadcast(builder, builder.extract_value(factors, k), width)
        term = builder.fmul(factor, row, flags=CONTRACT)
        total = term if total is None else builder.fadd(total, term, flags=CONTRACT)
    builder.store(total, target, align=8)
    return context.get_dummy_value()


@intrinsic
def add_rows(typing, out, at, factors, rows, start, width):
    """Add to out[at : at + width] the sum over k of factors[k] rows[start + k width : ...].

    `width` is a literal, and `factors` a tuple of float64.
    """
    signature = _signature(out, at, factors, rows, start, width)
    if signature is None:
        return None

    def generate(context, builder, signature, arguments):
        return _combine(context, builder, signature, arguments, True)

    return signature, generate


@intrinsic
def set_rows(typing, out, at, factors, rows, start, width):
    """Write what `add_rows` adds."""
    signature = _signature(out, at, factors, rows, start, width)
    if signature is None:
        return None

    def generate(context, builder, signature, arguments):
        return _combine(context, builder, signature, arguments, False)

    return signature, generate


@intrinsic
def copy_numbers(typing, out, source):
    """Copy all numbers of an array to another of the same size."""
    _check(out, source)

    def generate(context, builder, signature, arguments):
        target, there = (
            context.make_array(kind)(context, builder, array)
            for kind, array in zip(signature.args, arguments, strict=True)
        )
        cgutils.raw_memcpy(builder, target.data, there.data, there.nitems, 8)
        return context.get_dummy_value()

    return types.void(out, source), generate


@intrinsic
def set_outer(typing, out, at, left, i, right, j):
    """Write left[i : i + 4] right[j : j + 4]^T to out[at : at + 16]."""
    return _outer_signature(out, left, right), _outer(False)


@intrinsic
def add_outer(typing, out, at, factor, left, i, right, j):
    """Add factor left[i : i + 4] right[j : j + 4]^T to out[at : at + 16]."""
    return _outer_signature(out, left, right, types.float64), _outer(True)


def _outer_signature(out, left, right, *factor):
    _check(out, left, right)
    return types.void(out, types.intp, *factor, left, types.intp, right, types.intp)


def _outer(old):
    def generate(context, builder, signature, arguments):
        out_type, _, *_, left_type, _, right_type, _ = signature.args
        out, at, *factor, left, i, right, j = arguments
        target = _pointer(context, builder, out_type, out, at, 16)
        a = builder.load(_pointer(context, builder, left_type, left, i, 4), align=8)
        b = builder.load(_pointer(context, builder, right_type, right, j, 4), align=8)
        if old:
            a = builder.fmul(a, _broadcast(builder, factor[0], 4), flags=CONTRACT)
        value = builder.fmul(
            _arrange(builder, a, [k // 4 for k in range(16)]),
            _arrange(builder, b, [k % 4 for k in range(16)]),
            flags=CONTRACT,
        )
        if old:
            value = builder.fadd(builder.load(target, align=8), value, flags=CONTRACT)
        builder.store(value, target, align=8)
        return context.get_dummy_value()

    return generate


def _arrange(builder, value, lanes):
    """A vector of chosen lanes of another one."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
    return builder.shuffle_vector(value, value, mask)
