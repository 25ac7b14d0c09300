# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Four numbers in the lanes of one vector, for compiled code that treats points alike.

`Quad` is a numba type with the arithmetic of float64. What is written for one quadrature point runs
unchanged for the points of a whole knot span, for the price of one.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing import signature
from numba.core.typing.templates import ConcreteTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, register_model

from dlo_ros.kernel_cache import njit

LANES = 4
VECTOR = ir.VectorType(ir.DoubleType(), LANES)
LOOSE = ("contract", "nsz")  # see `vector_algebra.FLAGS`


class QuadType(types.Type):
    """Type of four float64 in a vector register."""

    def __init__(self) -> None:
        super().__init__(name="Quad")


Quad = QuadType()


@register_model(QuadType)
class _QuadModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, VECTOR)


def _index(k):
    return ir.Constant(ir.IntType(32), k)


def _spread(builder, value, kind):
    """A vector as it is, a number in all lanes."""
    if isinstance(kind, QuadType):
        return value
    first = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), value, _index(0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, first, lanes)


def _register(operation, instruction):
    """Give `Quad` a binary operation, with other Quads and with numbers."""

    class QuadOperation(ConcreteTemplate):
        key = operation
        cases = (
            signature(Quad, Quad, Quad),
            signature(Quad, Quad, types.float64),
            signature(Quad, types.float64, Quad),
        )

    infer_global(operation)(QuadOperation)

    def lower(context, builder, sig, args):
        a, b = (_spread(builder, x, kind) for x, kind in zip(args, sig.args, strict=True))
        return getattr(builder, instruction)(a, b, flags=LOOSE)

    for case in QuadOperation.cases:
        lower_builtin(operation, *case.args)(lower)


_register(operator.add, "fadd")
_register(operator.iadd, "fadd")
_register(operator.sub, "fsub")
_register(operator.mul, "fmul")
_register(operator.truediv, "fdiv")


@infer_global(operator.neg)
class _Negation(ConcreteTemplate):
    key = operator.neg
    cases = (signature(Quad, Quad),)


@lower_builtin(operator.neg, Quad)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0])


class _Root(ConcreteTemplate):
    key = np.sqrt
    cases = (signature(Quad, Quad),)


# Not as a decorator, which asks for the function's module: ufuncs of NumPy 1.26 have none.
infer_global(np.sqrt, types.Function(_Root))


@lower_builtin(np.sqrt, Quad)
def _root(context, builder, sig, args):
    kind = ir.FunctionType(VECTOR, [VECTOR])
    root = cgutils.get_or_insert_function(builder.module, kind, f"llvm.sqrt.v{LANES}f64")
    return builder.call(root, args)


@intrinsic
def quad(typing, a, b, c):
    """A Quad of three numbers, the last one twice."""

    def generate(context, builder, sig, args):
        value = ir.Constant(VECTOR, ir.Undefined)
        for k, x in enumerate((*args, args[2])):
            value = builder.insert_element(value, x, _index(k))
        return value

    return Quad(types.float64, types.float64, types.float64), generate


@intrinsic
def lane(typing, value, k):
    """Number k of a Quad."""

    def generate(context, builder, sig, args):
        return builder.extract_element(*args)

    return types.float64(Quad, types.int32), generate


@njit(from_python=False, forceinline=True)
def lanes(value):
    """The three numbers that `quad` was made of."""
    return lane(value, 0), lane(value, 1), lane(value, 2)
