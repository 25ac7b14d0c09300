# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of one planar rod's steps for eight parameters at once; see `propagation`.

All lanes of the rod itself hold the same numbers, those of its derivatives one parameter each. The
tangent matrix of a converged step is assembled and factorised once for all groups of LANES
parameters. It serves rods that their linear numbers describe (`sensitivity_state.LINEAR`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.simd_kernels import (
    COLUMN,
    BatchLaw,
    Frame,
    Scratch,
    Tables,
    assemble,
    slopes,
    span_stretch,
)  # fmt: skip
from dlo_ros.rod.batch.simd_solver import solve, solve_again
from dlo_ros.rod.batch.simd_step import BatchState, Sets
from dlo_ros.rod.boundary.conditions import Imposed, impose
from dlo_ros.rod.elements.strains import MIDDLE
from dlo_ros.rod.simd.eight_lanes import (
    LANES,
    address,
    entry,
    load,
    root,
    row_address,
    spread,
    store,
)  # fmt: skip
from dlo_ros.rod.simd.vector_algebra import INLINE
from dlo_ros.rod.solve.equation_system import variant
from dlo_ros.rod.solve.generalised_alpha import ALPHA_F, ALPHA_M, BETA, GAMMA, weights
from dlo_ros.spline import FloatArray

GRADIENTS = 6  # rows of a point: derivatives of stretch by p, of curvature by p and s
STRAINS = 4  # rows of a point: stretch and curvature beyond those at rest, then their rates


class Variations(NamedTuple):
    """What P parameters do to a rod and to its command, and the derivatives of its state by them.

    Parameter a is lane a % LANES of group a // LANES, of which there are G; the last one is filled
    up with parameters that change nothing.
    """

    rates: Sets  # derivatives of the rod's numbers, arrays (G, ..., LANES)
    heavier: FloatArray  # (G,) not 0 where mass or drag change
    changes: FloatArray  # (G, rows, LANES) derivatives of the state, rows as in `layout.Layout`
    imposed: Imposed  # in 1 + 2 P variants, see `equation_system.System`
    reach: FloatArray  # (1 + 2 P,) [m]
    step: FloatArray  # (P,) half the distance of a parameter's two variants
    moves: FloatArray  # (P,) not 0 where the parameter changes what is imposed
    frames: FloatArray  # (P, 2, 2, FRAME) frames of the ends, above and below
    increments: FloatArray  # (G, 2 n, LANES) derivatives of what is imposed
    right: FloatArray  # (G, 2 n + 7, LANES) right-hand sides and solutions
    gradients: FloatArray  # (nb, GRADIENTS, LANES)
    strains: FloatArray  # (STRAINS, nb, LANES)
    target: FloatArray  # (2, n, 2) where the held control points must be, above and below
    free: FloatArray  # (2 n,) zeros: nothing is held


@linked()
def remember(tables, motion, variations):
    """Keep the strains one step ago, before `simd_step.accept` forgets them."""
    points, out = 3 * tables.spans, address(variations.strains)
    for e in range(points):
        store(out, e, load(motion.stretch_before, e))
        store(out, points + e, load(motion.bend_before, e))


@linked()
def last_corner(imposed):
    """When the last of the variants of a command comes to rest [s]."""
    last = -np.inf
    if imposed.times.shape[1] > 0:
        for k in range(imposed.times.shape[0]):
            last = max(last, imposed.times[k, -1])
    return last


@linked()
def impose_variants(tables, variations, time):
    """Write the derivatives of what is imposed at a time to `Variations.increments`."""
    v, theta, pins = variations, np.zeros(2), np.zeros((0, 3))
    for a in range(v.moves.size):
        if v.moves[a] == 0.0:
            continue
        for side in range(2):
            k = 1 + 2 * a + side
            impose(
                variant(v.imposed, k), time, theta, v.reach[k], v.frames[a, side], v.target[side],
                pins,
            )  # fmt: skip
        share = 0.5 / v.step[a]
        for i in range(tables.n):
            for c in range(2):
                if entry(tables.fixed, 2 * i + c) != 0.0:
                    change = share * (v.target[0, i, c] - v.target[1, i, c])
                    v.increments[a // LANES, 2 * i + c, a % LANES] = change


@linked()
def propagate(sets, tables, motion, room, h, rate_weights, place, variations):
    """Propagate the derivatives through a step that has been accepted.

    Args:
        sets: the rod in all lanes.
        motion: its state after the step.
        room: of the step, with its law and matrix.
        h, rate_weights: length of the step [s], weights of its strain rate.
        place: rows of `Variations.changes`.
        variations: derivatives before; become those after.
    """
    v, scratch, size = variations, room.scratch, 2 * tables.n
    whole = Tables(
        tables.n, tables.dof, tables.spans, 0, tables.n, address(v.free), tables.linear,
        tables.twist_linear, tables.b, tables.b1, tables.b2, tables.products,
    )  # fmt: skip
    assemble(motion.q, whole, room.law, scratch, room.matrix, motion.tension, True)
    gradients, strains = address(v.gradients), address(v.strains)
    _strain_gradients(motion.q, tables, gradients)
    _beyond_rest(sets, tables, motion, rate_weights, strains)
    groups, behind = v.heavier.size, size + COLUMN - 1
    for g in range(groups):
        rates, change = sets_at(v.rates, g), state_at(v.changes, g, place)
        right, increments = row_address(v.right, g * behind), row_address(v.increments, g * size)
        for i in range(behind):
            store(right, i, load(rates.load, i) if i < size else spread(0.0))
        _subtract_stresses(sets, tables, rates, change, rate_weights, gradients, strains, right)
        _add_inertia(sets, tables, change, h, right)
        if v.heavier[g] != 0.0:
            _subtract_own_inertia(tables, rates, motion, right)
        _subtract_imposed(tables, scratch.band, increments, right)
    _uncouple(tables, scratch.band)
    for g in range(groups):
        right, increments = row_address(v.right, g * behind), row_address(v.increments, g * size)
        if g == 0:
            solve(
                Scratch(scratch.gradient, right, scratch.band, scratch.point, scratch.line,
                        scratch.tangent),
                tables,
            )  # fmt: skip
        else:
            solve_again(scratch.band, right, tables)
        for i in range(size):
            if entry(tables.fixed, i) != 0.0:
                store(right, i, load(increments, i))
        _move_on(tables, state_at(v.changes, g, place), gradients, h, right)


@njit(from_python=False)
def state_at(rows, c, place):
    """State of group c as addresses, given all rows (C, rows, LANES); see `layout.Layout`."""
    first = c * rows.shape[1]
    return BatchState(
        row_address(rows, first), row_address(rows, first + place[1]),
        row_address(rows, first + place[2]), row_address(rows, first + place[3]),
        row_address(rows, first + place[4]), row_address(rows, first + place[5]),
        row_address(rows, first + place[6]), row_address(rows, first + place[7]),
        Frame(row_address(rows, first + place[8]), row_address(rows, first + place[9]),
              row_address(rows, first + place[10]), row_address(rows, first + place[11])),
        row_address(rows, first + place[12]),
    )  # fmt: skip


@njit(from_python=False)
def sets_at(sets, c):
    """Constants of group c as addresses."""
    law = sets.law
    return Sets(
        BatchLaw(_group(law.stretch, c), _group(law.stretch_rest, c), _group(law.bend, c),
                 _group(law.bend_rest, c)),
        _group(sets.mass, c), _group(sets.drag, c), _group(sets.spin, c), _group(sets.load, c),
        _group(sets.relaxation_time, c),
    )  # fmt: skip


@njit(inline="always")
def _group(rows, c):
    """Address of the first row of group c."""
    return row_address(rows, c * rows.shape[1])


@linked()
def _strain_gradients(q, tables, out):
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
def _beyond_rest(sets, tables, motion, rate_weights, out):
    """Write strains and rates, see `STRAINS`; `remember` has written the strains two steps ago."""
    points, t_r, law = 3 * tables.spans, load(sets.relaxation_time, 0), sets.law
    c0, c1, c2 = rate_weights
    for e in range(points):
        now, k = load(motion.stretch, e), e
        rate = c0 * now + c1 * load(motion.stretch_before, e) + c2 * load(out, k)
        store(out, k, now - load(law.stretch_rest, e) + t_r * rate)
        store(out, 2 * points + k, rate)
        now, k = load(motion.bend, e), points + e
        rate = c0 * now + c1 * load(motion.bend_before, e) + c2 * load(out, k)
        store(out, k, now - load(law.bend_rest, e) + t_r * rate)
        store(out, 2 * points + k, rate)


@linked()
def _subtract_stresses(sets, tables, rates, change, rate_weights, gradients, strains, right):
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


@njit(**INLINE)
def _extrapolated(change, h, k):
    """Number k of the derivatives of `generalised_alpha.extrapolated`."""
    x, v = load(change.q, k), load(change.velocity, k)
    a, w = load(change.acceleration, k), load(change.auxiliary, k)
    return (
        x + h * v + (h * h * (0.5 - BETA)) * w,
        v + (h * (1.0 - GAMMA)) * w,
        (ALPHA_F / (1.0 - ALPHA_F)) * a - (ALPHA_M / (1.0 - ALPHA_F)) * w,
    )


@linked()
def _add_inertia(sets, tables, change, h, right):
    """Add inertia and drag that the derivatives before the step cause to the right-hand side."""
    n, (c_mass, c_drag) = tables.n, weights(h)
    for j in range(n):
        for c in range(2):
            q_star, v_star, lag = _extrapolated(change, h, 2 * j + c)
            past, passing = c_mass * q_star + lag, c_drag * q_star - v_star
            for i in range(max(0, j - 3), min(n, j + 4)):
                at, k = (4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i), 2 * i + c
                x = load(right, k) + load(sets.mass, at) * past
                store(right, k, x + load(sets.drag, at) * passing)


@linked()
def _subtract_own_inertia(tables, rates, motion, right):
    """Subtract what parameters add to the rod's own inertia and drag from the right-hand side."""
    n = tables.n
    for j in range(n):
        for c in range(2):
            a, v = load(motion.acceleration, 2 * j + c), load(motion.velocity, 2 * j + c)
            for i in range(max(0, j - 3), min(n, j + 4)):
                at, k = (4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i), 2 * i + c
                x = load(right, k) - load(rates.mass, at) * a
                store(right, k, x - load(rates.drag, at) * v)


@linked()
def _subtract_imposed(tables, band, increments, right):
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
def _uncouple(tables, band):
    """Take the coupling of what is free to what is held behind it out of the matrix."""
    last = 2 * tables.hi
    for k in range(max(2 * tables.lo, last - COLUMN + 1), last):
        for i in range(last, k + COLUMN):
            store(band, COLUMN * k + i - k, spread(0.0))


@linked()
def _move_on(tables, change, gradients, h, d_q):
    """Let the derivatives become those after a step, of which those of the shape are d_q."""
    c_mass, c_drag = weights(h)
    for k in range(2 * tables.n):
        q_star, v_star, lag = _extrapolated(change, h, k)
        x = load(d_q, k)
        moved = x - q_star
        store(change.q, k, x)
        store(change.velocity, k, v_star + c_drag * moved)
        store(change.acceleration, k, c_mass * moved - lag)
        store(change.auxiliary, k, (1.0 / (BETA * h * h)) * moved)
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
