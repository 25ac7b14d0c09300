# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of one rod's steps for eight parameters at once; see `propagation`.

All lanes of the rod itself hold the same numbers, those of its derivatives one parameter each. The
tangent matrix of a converged step is assembled and factorised once for all groups of LANES
parameters. It serves rods that their linear numbers describe (`sensitivity_state.LINEAR`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch import planar_sensitivity, spatial_sensitivity
from dlo_ros.rod.batch.simd_step import BatchState, Sets, add_inertia_and_drag
from dlo_ros.rod.batch.stress_sensitivity import strains_ago, strains_beyond
from dlo_ros.rod.boundary.conditions import Imposed, impose
from dlo_ros.rod.lanes import common_matrix, spatial_kernels
from dlo_ros.rod.lanes.simd_kernels import BatchLaw, Frame, assemble
from dlo_ros.rod.lanes.simd_tables import Tables
from dlo_ros.rod.simd.eight_lanes import (
    LANES,
    address,
    entry,
    load,
    row_address,
    store,
)  # fmt: skip
from dlo_ros.rod.simd.vector_algebra import INLINE
from dlo_ros.rod.solve.equation_system import variant
from dlo_ros.rod.solve.generalised_alpha import ALPHA_F, ALPHA_M, BETA, GAMMA, weights
from dlo_ros.spline import FloatArray


class Variations(NamedTuple):
    """Changes of a rod and of its command by P parameters, and the derivatives of its state.

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
    increments: FloatArray  # (G, d n, LANES) derivatives of what is imposed
    right: FloatArray  # (G, d (n + 4) - 1, LANES) right-hand sides and solutions, zeros behind
    turn: FloatArray  # (2 nb, LANES) of a group, see `subtract_stresses`; none in the plane
    gradients: FloatArray  # numbers of the points that all parameters share, see `strain_gradients`
    stresses: FloatArray  # those of stretch, of bending and twist, see `STRESS`
    frame: FloatArray  # (1, 10 nb, LANES) reference frame before the step; none in the plane
    target: FloatArray  # (2, n, d) where the held control points must be, above and below
    theta: FloatArray  # (2,) twist angles of the ends before the step [rad]
    free: FloatArray  # (d n, LANES) zeros: nothing is held


@linked()
def remember(tables, motion, variations):
    """Keep what `simd_step.accept` forgets: the strains one step ago, frame and twist angles."""
    points, out = 3 * tables.spans, address(variations.stresses)
    strains_ago(motion.stretch_before, points, 0, out)
    strains_ago(motion.bend_before, points * (1 if tables.dof == 2 else 3), points, out)
    if tables.dof == 2:
        return
    frame = _frame_before(tables, variations)
    for e in range(3 * points):
        store(frame.tangent, e, load(motion.frame.tangent, e))
        store(frame.rate, e, load(motion.frame.rate, e))
        store(frame.director, e, load(motion.frame.director, e))
    for e in range(points):
        store(frame.twist, e, load(motion.frame.twist, e))
    variations.theta[0] = entry(motion.q, 3 * LANES)
    variations.theta[1] = entry(motion.q, (4 * tables.n - 1) * LANES)


@njit(from_python=False)
def _frame_before(tables, variations):
    """Reference frame before the step, as addresses."""
    rows, points = variations.frame, 3 * tables.spans
    return Frame(
        row_address(rows, 0), row_address(rows, 3 * points), row_address(rows, 6 * points),
        row_address(rows, 9 * points),
    )  # fmt: skip


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
    v, dof, theta, pins = variations, tables.dof, np.zeros(2), np.zeros((0, 3))
    for a in range(v.moves.size):
        if v.moves[a] == 0.0:
            continue
        g, lane = a // LANES, a % LANES
        for side in range(2):
            k, d = 1 + 2 * a + side, v.step[a] if side == 0 else -v.step[a]
            if dof == 4:
                theta[0] = v.theta[0] + d * v.changes[g, 3, lane]
                theta[1] = v.theta[1] + d * v.changes[g, 4 * tables.n - 1, lane]
            impose(
                variant(v.imposed, k), time, theta, v.reach[k], v.frames[a, side], v.target[side],
                pins,
            )  # fmt: skip
        share = 0.5 / v.step[a]
        for i in range(tables.n):
            for c in range(dof):
                if entry(tables.fixed, dof * i + c) != 0.0:
                    change = share * (v.target[0, i, c] - v.target[1, i, c])
                    v.increments[g, dof * i + c, lane] = change


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
    v, scratch, law, dof = variations, room.scratch, room.law, tables.dof
    whole = Tables(
        tables.n, dof, tables.spans, 0, tables.n, address(v.free), tables.linear,
        tables.twist_linear, tables.b, tables.b1, tables.b2, tables.products, tables.together,
    )  # fmt: skip
    gradients, stresses, frame = address(v.gradients), address(v.stresses), _frame_before(tables, v)
    points, own = 3 * tables.spans, sets.law
    if dof == 4:
        spatial_kernels.assemble(
            motion.q, whole, frame, law, scratch, room.matrix, motion.tension, True
        )
        spatial_sensitivity.strain_gradients(motion.q, tables, frame, law, motion.bend, gradients)
    else:
        assemble(motion.q, whole, law, scratch, room.matrix, motion.tension, True)
        planar_sensitivity.strain_gradients(motion.q, tables, gradients)
    strains_beyond(own.stretch, own.stretch_rest, sets.relaxation_time, motion.stretch,
                   motion.stretch_before, rate_weights, points, 0, stresses)  # fmt: skip
    strains_beyond(own.bend, own.bend_rest, sets.relaxation_time, motion.bend, motion.bend_before,
                   rate_weights, points * (1 if dof == 2 else 3), points, stresses)  # fmt: skip
    t_r = entry(sets.relaxation_time, 0)
    groups, size, band = v.heavier.size, dof * tables.n, scratch.band
    for g in range(groups):
        right, increments, loads = (
            _group(v.right, g), _group(v.increments, g), _group(v.rates.load, g),
        )  # fmt: skip
        for i in range(size):
            store(right, i, load(loads, i))
        common_matrix.subtract_imposed(tables, band, increments, right)
    common_matrix.hold(tables, band, 0, size)
    common_matrix.factorise(tables, band, scratch.line)
    turn, (c_mass, c_drag) = address(v.turn), weights(h)
    # Group by group from here on, so that what one of them has stays near the processor.
    for g in range(groups):
        rates, right = sets_at(v.rates, g), _group(v.right, g)
        change = state_at(v.changes, g, place)
        pace = load(rates.relaxation_time, 0), t_r * rate_weights[1], t_r * rate_weights[2]
        if dof == 4:
            spatial_sensitivity.subtract_stresses(
                tables, rates, change, pace, gradients, stresses, turn, right
            )
        else:
            planar_sensitivity.subtract_stresses(
                tables, rates, change, pace, gradients, stresses, right
            )
        for i in range(size):
            q_star, v_star, lag = _extrapolated(change, h, i)
            store(room.q_star, i, c_mass * q_star + lag)
            store(room.v_star, i, c_drag * q_star - v_star)
        add_inertia_and_drag(sets, tables, room.q_star, room.v_star, 1.0, right)
        if v.heavier[g] != 0.0:
            add_inertia_and_drag(rates, tables, motion.acceleration, motion.velocity, -1.0, right)
        _hold(tables, right, address(v.free))
        common_matrix.substitute(tables, band, right)
        _hold(tables, right, _group(v.increments, g))
        _move_on(tables, change, h, right)
        if dof == 4:
            spatial_sensitivity.vary_strains(tables, gradients, turn, change, right)
        else:
            planar_sensitivity.vary_strains(tables, gradients, change, right)


@njit(from_python=False)
def _hold(tables, right, values):
    """Give what is held rows of values."""
    for i in range(tables.dof * tables.n):
        if entry(tables.fixed, i) != 0.0:
            store(right, i, load(values, i))


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
def _move_on(tables, change, h, d_q):
    """Let the derivatives of the motion become those after a step, given those of the shape."""
    c_mass, c_drag = weights(h)
    for k in range(tables.dof * tables.n):
        q_star, v_star, lag = _extrapolated(change, h, k)
        x = load(d_q, k)
        moved = x - q_star
        store(change.q, k, x)
        store(change.velocity, k, v_star + c_drag * moved)
        store(change.acceleration, k, c_mass * moved - lag)
        store(change.auxiliary, k, (1.0 / (BETA * h * h)) * moved)
