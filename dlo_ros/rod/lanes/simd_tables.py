# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tables that all rods in lanes have in common: basis functions, and what is held."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.rod.elements.rod_tables import Quadrature
from dlo_ros.rod.lanes.span_lanes import BASIS, PRODUCT_ROWS, SpanLanes, span_lanes
from dlo_ros.rod.simd.eight_lanes import address, table_address
from dlo_ros.spline import FloatArray

TARGET, KEPT = 1.0, 2.0  # a number that the command imposes, or that stays what it is
PAIRS = 10  # of the four basis functions of a span, each with itself and the ones before


class Tables(NamedTuple):
    """Tables that all sets have in common; here and below, arrays are addresses in compiled
    code.
    """

    n: int  # control points
    dof: int  # numbers of a control point: 2 in the plane, 4 in space
    spans: int  # of the knots, with three points each
    lo: int  # first control point with something free
    hi: int  # one after the last one
    fixed: FloatArray  # (dof n,) 0: free, TARGET or KEPT
    linear: FloatArray  # (spans,) 1 where the straight line through a span's stretches counts, or 0
    twist_linear: FloatArray  # (spans,) the same for twist
    b: FloatArray  # (nb, 4)
    b1: FloatArray  # (nb, 4)
    b2: FloatArray  # (nb, 4)
    products: FloatArray  # (spans, PAIRS, 3, 4) of b1 and b2: 11, 12, 21, 22
    together: SpanLanes  # spans that are assembled together


def tables_of(rule: Quadrature, fixed: FloatArray, *, alone: bool = False) -> Tables:
    """The tables of a quadrature, without room for spans that are assembled together.

    Args:
        fixed: for each number of a control point 0 where it is free, `TARGET` or `KEPT`, (n, d).
        alone: whether all lanes hold the same rod; then spans are assembled together.
    """
    spans = len(rule.weight) // 3
    free = np.flatnonzero(~fixed.all(axis=1))
    lo, hi = (int(free[0]), int(free[-1]) + 1) if len(free) else (len(fixed), len(fixed))
    b1, b2 = rule.b1.reshape(spans, 3, 4), rule.b2.reshape(spans, 3, 4)
    i, j = np.tril_indices(4)
    products = np.stack([x[:, :, i] * y[:, :, j] for x, y in product((b1, b2), repeat=2)], axis=-1)
    products = np.ascontiguousarray(products.transpose(0, 2, 1, 3))
    linear, twisted = rule.stretch_linear.astype(np.float64), rule.twist_linear.astype(np.float64)
    together = span_lanes(rule, products, alone=alone)
    return Tables(
        len(fixed), fixed.shape[1], spans, lo, hi, fixed.astype(np.float64).ravel(), linear,
        twisted, rule.b, rule.b1, rule.b2, products, together,
    )  # fmt: skip


@njit(from_python=False)
def addresses(tables):
    """The tables as addresses."""
    s = tables.together
    return Tables(
        tables.n, tables.dof, tables.spans, tables.lo, tables.hi, address(tables.fixed),
        address(tables.linear), address(tables.twist_linear), address(tables.b),
        address(tables.b1), address(tables.b2), address(tables.products),
        SpanLanes(
            s.groups, s.size, address(s.numbers), address(s.linear), address(s.twist_linear),
            address(s.b), address(s.b1), address(s.b2), address(s.products), address(s.none),
            address(s.work),
        ),
    )  # fmt: skip


@njit(from_python=False)
def local_tables(tables, group):
    """Tables of a group of spans in lanes, as those of a rod of one span."""
    s = tables.together
    return Tables(
        4, tables.dof, 1, 0, 4, s.none, table_address(s.linear, group),
        table_address(s.twist_linear, group), table_address(s.b, BASIS * group),
        table_address(s.b1, BASIS * group), table_address(s.b2, BASIS * group),
        table_address(s.products, PRODUCT_ROWS * group), s,
    )  # fmt: skip
