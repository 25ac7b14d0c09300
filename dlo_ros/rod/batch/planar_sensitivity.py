# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of one planar rod for eight parameters at once; see `simd_sensitivity`."""

from __future__ import annotations

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.simd_kernels import COLUMN, slopes, span_stretch
from dlo_ros.rod.elements.strains import MIDDLE
from dlo_ros.rod.simd.eight_lanes import entry, load, root, spread, store

GRADIENTS = 6  # rows of a point: derivatives of stretch by p, of curvature by p and s


@linked()
def strain_gradients(q, tables, out):
    """Write the derivatives of the strains at every point, see `GRADIENTS`."""
    for e in range(3 * tables.spans):
        px, pz, sx, sz = slopes(q, tables, e)
        r2 = 1.0 / (px * px + pz * pz)
        r = root(r2)
        g = r2 * r
        f, at = 3.0 * (pz * sx - px * sz) * g * r2, GRADIENTS * e
        store(out, at, px * r)
        store(out, at + 1, pz * r)
        store(out, at + 2, -(sz * g) - f * px)
        store(out, at + 3, sx * g - f * pz)
        store(out, at + 4, pz * g)
        store(out, at + 5, -(px * g))


@linked()
def subtract_stresses(sets, tables, rates, change, rate_weights, gradients, strains, right):
    """Subtract the forces of the stresses' derivatives, the shape held, from `right`."""
    points, law, more = 3 * tables.spans, sets.law, rates.law
    t_r, slower = load(sets.relaxation_time, 0), load(rates.relaxation_time, 0)
    past, faster = t_r * rate_weights[1], t_r * rate_weights[2]
    for e in range(points):
        span = e // 3
        bent = load(more.bend, e) * load(strains, points + e) + load(law.bend, e) * (
            slower * load(strains, 3 * points + e) + past * load(change.bend, e)
            + faster * load(change.bend_before, e) - load(more.bend_rest, e)
        )  # fmt: skip
        at = GRADIENTS * e
        px, pz = bent * load(gradients, at + 2), bent * load(gradients, at + 3)
        sx, sz = bent * load(gradients, at + 4), bent * load(gradients, at + 5)
        linear = entry(tables.linear, span) > 0.0
        if linear or e % 3 == 1:
            pull = load(more.stretch, e) * load(strains, e) + load(law.stretch, e) * (
                slower * load(strains, 2 * points + e) + past * load(change.stretch, e)
                + faster * load(change.stretch_before, e) - load(more.stretch_rest, e)
            )  # fmt: skip
            if not linear:
                pull *= 1.0 / MIDDLE
            px += pull * load(gradients, at)
            pz += pull * load(gradients, at + 1)
        for i in range(4):
            u, v, k = entry(tables.b1, 4 * e + i), entry(tables.b2, 4 * e + i), 2 * (span + i)
            store(right, k, load(right, k) - u * px - v * sx)
            store(right, k + 1, load(right, k + 1) - u * pz - v * sz)


@linked()
def subtract_imposed(tables, band, increments, right):
    """Subtract the forces of what is imposed from the right-hand side."""
    size = 2 * tables.n
    for j in range(size):
        if entry(tables.fixed, j) == 0.0:
            continue
        x = load(increments, j)
        for i in range(max(0, j - COLUMN + 1), min(size, j + COLUMN)):
            at = COLUMN * j + i - j if i >= j else COLUMN * i + j - i
            store(right, i, load(right, i) - load(band, at) * x)


@linked()
def uncouple(tables, band):
    """Take the coupling of what is free to what is held behind it out of the matrix."""
    last = 2 * tables.hi
    for k in range(max(2 * tables.lo, last - COLUMN + 1), last):
        for i in range(last, k + COLUMN):
            store(band, COLUMN * k + i - k, spread(0.0))


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
        store(change.stretch, e, load(gradients, at) * px + load(gradients, at + 1) * pz)
        bent = load(gradients, at + 2) * px + load(gradients, at + 3) * pz
        bent += load(gradients, at + 4) * sx + load(gradients, at + 5) * sz
        store(change.bend, e, bent)
        if e % 3 == 2:
            span_stretch(change.stretch, e - 2, entry(tables.linear, e // 3) > 0.0)
