# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One step of eight parameter sets: `adaptive_integration`'s generalised-alpha in lanes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.lanes import spatial_kernels, spatial_strains
from dlo_ros.rod.lanes.simd_kernels import (
    BatchLaw,
    Frame,
    Scratch,
    assemble,
    strains,
    tensions,
)  # fmt: skip
from dlo_ros.rod.lanes.simd_solver import residual, solve
from dlo_ros.rod.lanes.simd_tables import TARGET
from dlo_ros.rod.simd.eight_lanes import entry, largest, load, root, spread, store
from dlo_ros.rod.solve.generalised_alpha import ALPHA_F, ALPHA_M, BETA, GAMMA, SMALLEST_STEP
from dlo_ros.rod.solve.newton_in_lanes import AGEING, UNKNOWN_PACE
from dlo_ros.spline import FloatArray

MAX_NEWTON = 12
TURN = 0.1  # of L: how far an error of theta of 1 rad counts in the convergence


class Sets(NamedTuple):
    """Constants of all sets: arrays (C, ..., LANES), the d numbers of a control point in turn.

    Here and in `BatchState` the first axis counts groups of LANES sets. Steps are those of one
    group, whose arrays are without it, as addresses.
    """

    law: BatchLaw  # without damping
    mass: FloatArray  # (4 n,) lower rows [kg]
    drag: FloatArray  # (4 n,) [N s/m]
    spin: FloatArray  # (4 n,) inertia of theta
    load: FloatArray  # (d n,) [N]
    relaxation_time: FloatArray  # (1,) [s]


class BatchState(NamedTuple):
    """Positions, velocities and strains of all sets; arrays (C, ..., LANES)."""

    q: FloatArray  # (d n,) [m]
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    stretch: FloatArray  # (nb,) now, and one step ago
    stretch_before: FloatArray
    bend: FloatArray  # (nb,), in space (3 nb,)
    bend_before: FloatArray
    frame: Frame
    tension: FloatArray  # (nb,) with weights, as `assemble` takes it


class Room(NamedTuple):
    """Scratch of one step; arrays (..., LANES) but for the target."""

    law: BatchLaw  # of the incremental potential
    scratch: Scratch
    matrix: FloatArray  # (4 n,), in space (8 n,) with that of theta
    rhs: FloatArray  # (d n,)
    q: FloatArray  # (d n,)
    q_star: FloatArray
    v_star: FloatArray
    lag: FloatArray
    auxiliary: FloatArray
    target: FloatArray  # (n, d) where the held control points must be


@linked()
def _damped(points, relaxation, now, before, weights, stiffness, rest, out_stiffness, out_rest):
    """Stiffness and rest strains of one step's incremental potential, as in `generalised_alpha`."""
    t_r = load(relaxation, 0)
    factor = 1.0 + weights[0] * t_r
    inverse = 1.0 / factor
    for e in range(points):
        past = weights[1] * load(now, e) + weights[2] * load(before, e)
        store(out_stiffness, e, load(stiffness, e) * factor)
        store(out_rest, e, (load(rest, e) - t_r * past) * inverse)


@linked()
def _predict(tables, sets, motion, room, h, c_mass, c_drag):
    """Start of the step: predictions, matrix and right-hand side."""
    n, dof = tables.n, tables.dof
    for i in range(4 * n):
        store(room.matrix, i, c_mass * load(sets.mass, i) + c_drag * load(sets.drag, i))
    if dof == 4:
        for i in range(4 * n):
            store(room.matrix, 4 * n + i, c_mass * load(sets.spin, i))
    for i in range(dof * n):
        aux, v = load(motion.auxiliary, i), load(motion.velocity, i)
        q_star = load(motion.q, i) + h * v + (h * h * (0.5 - BETA)) * aux
        v_star = v + (h * (1.0 - GAMMA)) * aux
        store(room.q_star, i, q_star)
        store(room.v_star, i, v_star)
        store(room.q, i, q_star + (h * h * BETA) * aux)
        store(room.lag, i, (ALPHA_F / (1.0 - ALPHA_F)) * load(motion.acceleration, i)
              - (ALPHA_M / (1.0 - ALPHA_F)) * aux)  # fmt: skip
        store(room.rhs, i, load(sets.load, i))
        # Accelerations and velocities that are owed to the past, in rows that are still free.
        store(room.auxiliary, i, c_mass * q_star + load(room.lag, i))
        store(room.scratch.step, i, c_drag * q_star - v_star)
    add_inertia_and_drag(sets, tables, room.auxiliary, room.scratch.step, 1.0, room.rhs)


@linked()
def add_inertia_and_drag(sets, tables, acceleration, velocity, share, out):
    """Add a share of the inertia by accelerations and of the drag by velocities to forces.

    Args:
        acceleration, velocity, out: rows (d n, LANES).
        share: number.
    """
    n, dof = tables.n, tables.dof
    for i in range(n):
        first, last = max(0, i - 3), min(n, i + 4)
        for c in range(dof):
            x = spread(0.0)
            for j in range(first, last):
                k, at = dof * j + c, 4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i
                if c == 3:
                    x += load(sets.spin, at) * load(acceleration, k)
                else:
                    x += load(sets.mass, at) * load(acceleration, k)
                    x += load(sets.drag, at) * load(velocity, k)
            store(out, dof * i + c, load(out, dof * i + c) + share * x)


@linked()
def _newton(tables, room, frame, tension, limit, tolerance, pace):
    """Solve the step's equations from room.q.

    Args:
        frame, tension: reference frame, and see `assemble`.
        limit, tolerance: a control point's root mean square move in the last iteration [m] that
            is too large, as L is, and that is small enough.
        pace: by what the last move of a former step was smaller than the one before, and that
            one [m]; (1, 0) where nothing is known. What one move leaves to the next is estimated by
            it, as in implicit Runge-Kutta methods (Hairer and Wanner, Solving Ordinary Differential
            Equations II, 1996, section IV.8).

    Returns:
        Whether all sets have converged, the smallest pivot and the pace.
    """
    lo, hi, dof = tables.lo, tables.hi, tables.dof
    scratch = room.scratch
    if hi <= lo:
        return True, 1.0, pace
    ratio, before = pace[0] ** AGEING, 0.0
    for iteration in range(MAX_NEWTON):
        first = iteration == 0
        if dof == 4:
            spatial_kernels.assemble(
                room.q, tables, frame, room.law, scratch, room.matrix, tension, first
            )
        else:
            assemble(room.q, tables, room.law, scratch, room.matrix, tension, first)
        residual(room.q, room.matrix, room.rhs, scratch, tables)
        pivot = solve(scratch, tables)
        square = spread(0.0)
        for i in range(dof * lo, dof * hi):
            x = load(scratch.step, i)
            store(room.q, i, load(room.q, i) + x)
            if i % dof == 3:
                x *= TURN * limit
            square += x * x
        move = np.sqrt(largest(square) / (hi - lo))
        if not move < limit:
            return False, pivot, pace
        if not first:
            ratio = move / before
            pace = ratio, before
        elif move > pace[1]:  # quadratic convergence: a larger move leaves more
            ratio *= move / max(pace[1], tolerance)
        if move < tolerance or (ratio < 1.0 and move * ratio < tolerance * (1.0 - ratio)):
            if first:
                pace = pace[0] ** AGEING, pace[1]
            return True, pivot, pace
        before = move
    return False, 0.0, pace


@linked()
def try_step(sets, tables, motion, room, h, weights, limit, newton, pace):
    """Try a step of length h whose target is in place.

    Returns:
        Whether it converged on the branch, the estimated error of the worst set [m], and the pace
        of Newton's method, see `_newton`.
    """
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    base, law, relaxation = sets.law, room.law, sets.relaxation_time
    points, bends = 3 * tables.spans, 3 * tables.spans * (3 if tables.dof == 4 else 1)
    _damped(points, relaxation, motion.stretch, motion.stretch_before, weights, base.stretch,
            base.stretch_rest, law.stretch, law.stretch_rest)  # fmt: skip
    _damped(bends, relaxation, motion.bend, motion.bend_before, weights, base.bend,
            base.bend_rest, law.bend, law.bend_rest)  # fmt: skip
    n, dof = tables.n, tables.dof
    _predict(tables, sets, motion, room, h, c_mass, c_drag)
    for i in range(dof * n):
        held = entry(tables.fixed, i)
        if held == TARGET:
            store(room.q, i, spread(entry(room.target, i)))
        elif held != 0.0:
            store(room.q, i, load(motion.q, i))
    converged, pivot, pace = _newton(
        tables, room, motion.frame, motion.tension, limit, newton, pace
    )
    # A negative pivot: the step has left the branch that a smaller one would follow.
    if not converged or (not pivot > 0.0 and h > 10.0 * SMALLEST_STEP):
        return False, np.inf, UNKNOWN_PACE
    total = spread(0.0)
    rate = 1.0 / (BETA * h * h)
    for i in range(dof * n):
        store(room.auxiliary, i, rate * (load(room.q, i) - load(room.q_star, i)))
    count = 0
    for i in range(n):
        if entry(tables.fixed, dof * i) != 0.0:
            continue
        square, count = spread(0.0), count + 1
        for k in range(dof * i, dof * i + min(dof, 3)):
            x = load(room.auxiliary, k) - load(motion.auxiliary, k)
            square += x * x
        total += root(square)
    jump = largest(total) / max(count, 1)
    return True, abs(BETA - 1.0 / 6.0) * h * h * jump, pace


@linked()
def accept(tables, motion, room, h):
    """Move on to what `try_step` has found."""
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    for i in range(tables.dof * tables.n):
        q = load(room.q, i)
        d = q - load(room.q_star, i)
        store(motion.q, i, q)
        store(motion.velocity, i, load(room.v_star, i) + c_drag * d)
        store(motion.acceleration, i, c_mass * d - load(room.lag, i))
        store(motion.auxiliary, i, load(room.auxiliary, i))
    for e in range(3 * tables.spans):
        store(motion.stretch_before, e, load(motion.stretch, e))
    for e in range(3 * tables.spans * (3 if tables.dof == 4 else 1)):
        store(motion.bend_before, e, load(motion.bend, e))
    if tables.dof == 4:
        spatial_strains.advance(motion.q, tables, motion.frame, motion.stretch, motion.bend)
    else:
        strains(motion.q, tables, motion.stretch, motion.bend)
    tensions(motion.stretch, room.law, tables, motion.tension)


@njit(from_python=False)
def rate_weights(h, last):
    """Weights of the strains now, one and two steps ago in the strain rate [1/s]."""
    if last <= 0.0:
        return 1.0 / h, -1.0 / h, 0.0
    r = h / last
    return (1.0 + 2.0 * r) / (h * (1.0 + r)), -(1.0 + r) / h, r * r / (h * (1.0 + r))
