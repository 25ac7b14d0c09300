# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Knot spans of one rod in lanes: where all lanes hold the same rod, eight spans cost as one.

Their numbers are gathered to rows as if each were a rod of four control points, in a lane of its
own; forces are scattered back to all lanes, stiffness to `common_matrix`. Spans whose stretch or
twist is a straight line come first, so that few groups have to look at such lines.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.rod_tables import Quadrature
from dlo_ros.rod.simd.eight_lanes import LANES, entry, load, put_entry, rows, spread, store
from dlo_ros.spline import FloatArray

POINTS = 3  # of a span
BASIS = 12  # rows of basis functions at a span's points
PRODUCT_ROWS = 120  # rows of their products, see `simd_tables.Tables`


class SpanLanes(NamedTuple):
    """Tables of spans in lanes, groups of LANES of them; the last span fills up."""

    groups: int  # 0 where lanes hold several rods
    size: int  # spans in them
    numbers: FloatArray  # (LANES groups,) numbers of the spans
    linear: FloatArray  # (groups, 1, LANES) see `simd_tables.Tables`
    twist_linear: FloatArray
    b: FloatArray  # (groups, BASIS, LANES)
    b1: FloatArray
    b2: FloatArray
    products: FloatArray  # (groups, PRODUCT_ROWS, LANES)
    none: FloatArray  # (16,) zeros: nothing is held
    work: FloatArray  # (rows, LANES)


def span_lanes(rule: Quadrature, products: FloatArray, *, alone: bool) -> SpanLanes:
    """The spans of one rod in lanes, without room to work in; see `with_room`.

    Args:
        rule: points and basis functions of all spans.
        products: see `simd_tables.Tables`.
        alone: whether all lanes hold the same rod; else there are no groups.
    """
    spans = len(rule.weight) // POINTS
    groups = -(-spans // LANES) if alone else 0
    order = np.argsort(~(rule.stretch_linear | rule.twist_linear), kind="stable")
    numbers = order[np.minimum(np.arange(groups * LANES), spans - 1)]

    def lanes(table: NDArray[Any]) -> FloatArray:
        flat = table.reshape(spans, -1)
        result = rows(groups, flat.shape[1])
        result[...] = flat[numbers].reshape(groups, LANES, flat.shape[1]).transpose(0, 2, 1)
        return result

    return SpanLanes(
        groups, spans if alone else 0, numbers.astype(np.float64), lanes(rule.stretch_linear),
        lanes(rule.twist_linear), lanes(rule.b), lanes(rule.b1), lanes(rule.b2), lanes(products),
        np.zeros(16), rows(0),
    )  # fmt: skip


def with_room(tables: SpanLanes, dof: int) -> SpanLanes:
    """The tables with room of their own, which rods that move at the same time cannot share.

    Args:
        dof: numbers of a control point.
    """
    return tables._replace(work=rows(work_rows(dof)))


def work_rows(dof: int) -> int:
    """Number of rows of `SpanLanes.work`, in the order in which kernels' `_add_group` has them.

    They are those of a span's four control points, stretching stiffness and rest stretch, bending
    stiffness and rest strains, tensions, tangents, in space the reference frame, then gradient and
    Hessian of the span.
    """
    if dof == 4:
        return 16 + 6 + 18 + 3 + 9 + 30 + 16 + 256
    return 8 + 6 + 6 + 3 + 6 + 8 + 64


@linked()
def gather(numbers, group, source, stride, count, out):
    """Write rows of a group's spans to lanes.

    Args:
        numbers: see `SpanLanes`.
        source: rows of the rod, the same in all lanes.
        stride, count: rows from one span to the next, and how many belong to one.
        out: output, (count, LANES).
    """
    for lane in range(LANES):
        first = LANES * stride * int(entry(numbers, LANES * group + lane))
        for r in range(count):
            put_entry(out, LANES * r + lane, entry(source, first + LANES * r))


@linked()
def scatter(numbers, group, spans, source, stride, count, low, high, target):
    """Write rows of a group's spans to rows of the rod, to what is there already where stride < 0.

    Args:
        numbers, group, stride, count: as in `gather`.
        spans: how many spans the group has.
        source: rows (count, LANES).
        low, high: rows of the rod that are written.
        target: rows of the rod.
    """
    added = stride < 0
    for lane in range(spans):
        first = abs(stride) * int(entry(numbers, LANES * group + lane))
        for r in range(count):
            to = first + r
            if low <= to < high:
                x = entry(source, LANES * r + lane)
                store(target, to, load(target, to) + x if added else spread(x))


@linked()
def scatter_numbers(numbers, group, size, source, count, target):
    """Write rows of a group's spans to numbers that the rod has once.

    Args:
        size: spans of all groups.
        source: rows (count, LANES).
        target: numbers (spans, count).
    """
    for lane in range(min(LANES, size - LANES * group)):
        first = count * int(entry(numbers, LANES * group + lane))
        for r in range(count):
            put_entry(target, first + r, entry(source, LANES * r + lane))
