# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of one planar rod for eight parameters at once; see `simd_sensitivity`."""

from __future__ import annotations

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.stress_sensitivity import stress
from dlo_ros.rod.elements.strains import MIDDLE
from dlo_ros.rod.lanes.simd_kernels import slopes, span_stretch
from dlo_ros.rod.lanes.simd_tables import local_tables
from dlo_ros.rod.lanes.span_lanes import gather, scatter_numbers
from dlo_ros.rod.simd.eight_lanes import entry, load, root, row_address, store

GRADIENTS = 6  # numbers of a point: derivatives of stretch by p, of curvature by p and s
ROOM = 37  # rows of `SpanLanes.work` from which on there is room for a group's numbers


@linked()
def strain_gradients(q, tables, out):
    """Write the derivatives of the strains at every point, see `GRADIENTS`, eight spans at a time.

    Args:
        out: output, (GRADIENTS nb,).
    """
    lanes = tables.together
    room = row_address(lanes.work, ROOM)
    for group in range(lanes.groups):
        gather(lanes.numbers, group, q, 2, 8, row_address(lanes.work, 0))
        local = local_tables(tables, group)
        for k in range(3):
            px, pz, sx, sz = slopes(row_address(lanes.work, 0), local, k)
            r2 = 1.0 / (px * px + pz * pz)
            r = root(r2)
            g = r2 * r
            f, at = 3.0 * (pz * sx - px * sz) * g * r2, GRADIENTS * k
            store(room, at, px * r)
            store(room, at + 1, pz * r)
            store(room, at + 2, -(sz * g) - f * px)
            store(room, at + 3, sx * g - f * pz)
            store(room, at + 4, pz * g)
            store(room, at + 5, -(px * g))
        scatter_numbers(lanes.numbers, group, lanes.size, room, 3 * GRADIENTS, out)


@linked()
def subtract_stresses(tables, rates, change, pace, gradients, stresses, right):
    """Subtract the forces of the stresses' derivatives, the shape held, from `right`.

    Args:
        rates, change: derivatives of the rod's numbers and of its state before the step.
        pace, stresses: see `stress_sensitivity.stress`.
        gradients: see `strain_gradients`.
    """
    points, more = 3 * tables.spans, rates.law
    for e in range(points):
        span = e // 3
        bent = stress((more.bend, more.bend_rest, change.bend, change.bend_before), e, stresses,
                      points + e, pace)  # fmt: skip
        at = GRADIENTS * e
        px, pz = bent * entry(gradients, at + 2), bent * entry(gradients, at + 3)
        sx, sz = bent * entry(gradients, at + 4), bent * entry(gradients, at + 5)
        linear = entry(tables.linear, span) > 0.0
        if linear or e % 3 == 1:
            pull = stress((more.stretch, more.stretch_rest, change.stretch, change.stretch_before),
                          e, stresses, e, pace)  # fmt: skip
            if not linear:
                pull *= 1.0 / MIDDLE
            px += pull * entry(gradients, at)
            pz += pull * entry(gradients, at + 1)
        for i in range(4):
            u, v, k = entry(tables.b1, 4 * e + i), entry(tables.b2, 4 * e + i), 2 * (span + i)
            store(right, k, load(right, k) - u * px - v * sx)
            store(right, k + 1, load(right, k + 1) - u * pz - v * sz)


@linked()
def vary_strains(tables, gradients, change, d_q):
    """Let the derivatives of the strains become those after a step.

    Args:
        gradients: see `strain_gradients`.
        change: derivatives, of which these are changed.
        d_q: derivatives of the shape.
    """
    for e in range(3 * tables.spans):
        store(change.stretch_before, e, load(change.stretch, e))
        store(change.bend_before, e, load(change.bend, e))
        px, pz, sx, sz = slopes(d_q, tables, e)
        at = GRADIENTS * e
        store(change.stretch, e, entry(gradients, at) * px + entry(gradients, at + 1) * pz)
        bent = entry(gradients, at + 2) * px + entry(gradients, at + 3) * pz
        bent += entry(gradients, at + 4) * sx + entry(gradients, at + 5) * sz
        store(change.bend, e, bent)
        if e % 3 == 2:
            span_stretch(change.stretch, e - 2, entry(tables.linear, e // 3))
