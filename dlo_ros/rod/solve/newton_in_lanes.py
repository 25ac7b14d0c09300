# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Newton's method for a step of one planar rod, eight of its knot spans at a time.

It does what `newton_iteration.implicit_step` does, for any law of bending and any surroundings: in
each iteration the law is taken for the straight line that touches it at the present curvature,
which leaves gradient and Hessian as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.constitutive_law import moments_in_plane
from dlo_ros.rod.elements.contact_and_friction import any_surroundings, may_be_touched
from dlo_ros.rod.lanes.simd_kernels import (
    COLUMN,
    BatchLaw,
    Scratch,
    assemble,
    counts,
    strains,
)  # fmt: skip
from dlo_ros.rod.lanes.simd_solver import residual, solve
from dlo_ros.rod.lanes.simd_tables import Tables, addresses
from dlo_ros.rod.lanes.span_lanes import with_room
from dlo_ros.rod.simd.eight_lanes import LANES, address, entry, load, put_entry, rows, spread, store
from dlo_ros.rod.solve.newton_iteration import MAX_NEWTON, PATIENCE
from dlo_ros.rod.solve.step_back import SHORTENINGS, press, remaining_share, work_unforeseen
from dlo_ros.spline import FloatArray

PLANE = 2
UNKNOWN_PACE = (1.0, 0.0)
AGEING = 0.8  # exponent by which a pace that was not measured anew loses its worth (Hairer, Wanner)
BEHIND = 4 * PLANE - 1  # numbers behind the last column, beyond which the factorisation reaches


class PlanarLanes(NamedTuple):
    """Tables of a planar rod in lanes, and room to work in; in compiled code arrays are addresses.

    Where not `usable`, as of a rod in space or with pins, there is nothing in them.
    """

    usable: bool
    tables: Tables
    law: BatchLaw  # of one iteration
    scratch: Scratch
    matrix: FloatArray  # (4 n, LANES)
    rhs: FloatArray  # (2 n, LANES)
    q: FloatArray  # (2 n, LANES)
    stretch: FloatArray  # (nb, LANES)
    bend: FloatArray  # (nb, LANES)
    tension: FloatArray  # (nb, LANES) times weights


class Response(NamedTuple):
    """Moments of a law that is not linear, and forces of the surroundings, in a planar shape."""

    curvature: FloatArray  # (nb,) [1/m]
    moment: FloatArray  # (nb,) [N m]
    tangent: FloatArray  # (nb,) [N m^2]
    forces: FloatArray  # (2 n,) [N], by which the gradient is larger
    stiffness: FloatArray  # (2 n, 8) [N/m], lower rows of their tangent


def planar_lanes(tables: Tables, *, usable: bool) -> PlanarLanes:
    """A planar rod in lanes, with room of its own.

    Args:
        tables: those of the plane, of one rod that all lanes hold.
        usable: whether the rod stays in the plane, and has no pins.
    """
    held = tables.fixed.reshape(-1, PLANE)[tables.lo : tables.hi]
    usable = usable and len(held) > 0 and not held.any()
    n, points = (tables.n, 3 * tables.spans) if usable else (0, 0)
    size, many = PLANE * n, PLANE * n + BEHIND
    scratch = Scratch(*(rows(k) for k in (size, many, COLUMN * many, 42, 16, PLANE * points)))
    return PlanarLanes(
        usable, tables._replace(together=with_room(tables.together, PLANE)),
        BatchLaw(*(rows(points) for _ in range(4))), scratch, rows(2 * size), rows(size),
        rows(size), rows(points), rows(points), rows(points),
    )  # fmt: skip


@njit(from_python=False)
def lane_addresses(lanes):
    """The tables and the room as addresses."""
    law, s = lanes.law, lanes.scratch
    return PlanarLanes(
        lanes.usable, addresses(lanes.tables),
        BatchLaw(address(law.stretch), address(law.stretch_rest), address(law.bend),
                 address(law.bend_rest)),
        Scratch(address(s.gradient), address(s.step), address(s.band), address(s.point),
                address(s.line), address(s.tangent)),
        address(lanes.matrix), address(lanes.rhs), address(lanes.q), address(lanes.stretch),
        address(lanes.bend), address(lanes.tension),
    )  # fmt: skip


@linked()
def implicit_step(lanes, q, target, fixed, rule, matter, stretch, longer, inertia, rhs, length,
                  tolerance, pace):  # fmt: skip
    """Solve inertia q + elastic gradient(q) = rhs for one step in time.

    Args:
        lanes: addresses, see `PlanarLanes`.
        q, target, fixed, rule, matter, inertia, rhs, length, tolerance: as in
            `newton_iteration.implicit_step`, with x and z of control points.
        stretch: strains before the step, (nb,), by which the first iteration judges tension.
        longer: free length after the step over that before, which is no strain.
        pace: by what the last correction of a former step was smaller than the one before, and
            that one over L, or `UNKNOWN_PACE`; becomes those of this step, (2,). They tell what a
            first correction leaves, as in implicit Runge-Kutta methods (Hairer and Wanner, Solving
            Ordinary Differential Equations II, 1996, section IV.8).

    Returns:
        Iterations (negative: not converged) and the number of negative pivots at the end, at most
        one.
    """
    tables, law, scratch = lanes.tables, lanes.law, lanes.scratch
    n, lo, hi = tables.n, tables.lo, tables.hi
    _begin(lanes, q, target, fixed, rule, matter, stretch, longer, inertia, rhs)
    linear = matter.law.active == 0.0 and matter.law.slide == 0.0
    surrounded, touching = any_surroundings(matter.around), may_be_touched(matter.around)
    smooth = linear and not touching
    points, size = 0 if linear else 3 * tables.spans, PLANE * n if surrounded else 0
    here, line = _no_response(points, size), _no_response(points, size)
    pull, promised = np.empty(0 if smooth else PLANE * n), 0.0
    # A DLO may touch a body in this step that was far away before; and where it slips through a
    # grip, the tension of its false stretch differs from step to step.
    before, ratio = 0.0, 1.0 if touching or longer != 1.0 else pace[0] ** AGEING
    for iteration in range(1, MAX_NEWTON + 1):
        if surrounded or not smooth:
            _respond(lanes, q, rule, matter, here)
            if iteration > 1 and not smooth:
                before *= _retreat(lanes, q, rule, matter, promised, line, here)
            _take(lanes, rule, here, line)
        assemble(lanes.q, tables, law, scratch, lanes.matrix, lanes.tension, iteration == 1)
        if surrounded:
            _add(tables, scratch, line.forces, line.stiffness)
        residual(lanes.q, lanes.matrix, lanes.rhs, scratch, tables)
        for i in range(pull.size):
            pull[i] = entry(scratch.step, LANES * i)
        pivot = solve(scratch, tables)
        move, promised = 0.0, 0.0
        for i in range(lo, hi):
            for c in range(PLANE):
                x = entry(scratch.step, LANES * (PLANE * i + c))
                if not smooth:
                    promised += x * pull[PLANE * i + c]
                q[i, c] += x
                store(lanes.q, PLANE * i + c, spread(q[i, c]))
                move = max(move, abs(x))
                if x != x:
                    return -iteration, 1
        if move > length:
            return -iteration, 1
        now = move / length
        if iteration > 1:
            ratio = now / before
            pace[0], pace[1] = ratio, before
        elif now > pace[1]:  # quadratic convergence: a larger correction leaves more
            ratio *= now / max(pace[1], tolerance)
        if now < tolerance or (ratio < 1.0 and now * ratio < tolerance * (1.0 - ratio)):
            if iteration == 1:
                pace[0] = pace[0] ** AGEING
            return iteration, 0 if pivot > 0.0 else 1
        if iteration > PATIENCE and now > 0.9 * before:
            return -iteration, 0
        before = now
    return -MAX_NEWTON, 0


@njit(from_python=False)
def _begin(lanes, q, target, fixed, rule, matter, stretch, longer, inertia, rhs):
    """Write what stays the same in all iterations, and the tension of the first."""
    tables, law, material = lanes.tables, lanes.law, matter.stiffness
    for i in range(tables.n):
        for c in range(PLANE):
            if fixed[PLANE * i + c]:
                q[i, c] = target[i, c]
            store(lanes.q, PLANE * i + c, spread(q[i, c]))
            store(lanes.rhs, PLANE * i + c, spread(rhs[i, c]))
        for k in range(4):
            store(lanes.matrix, 4 * i + k, spread(inertia[i, k]))
    for e in range(3 * tables.spans):
        weight, line = rule.weight[e], entry(tables.linear, e // 3)
        stiff = weight * material.stretch[e]
        store(law.stretch, e, spread(stiff))
        store(law.stretch_rest, e, spread(material.stretch_rest[e]))
        store(law.bend, e, spread(weight * material.bend[e, 0]))
        store(law.bend_rest, e, spread(material.bend_rest[e, 0]))
        stretched = longer * (1.0 + stretch[e]) - 1.0 - material.stretch_rest[e]
        store(lanes.tension, e, spread(counts(line, 1.0 - line, e % 3) * stiff * stretched))


@njit(from_python=False)
def _no_response(points, size):
    """Room for the moments and forces in a shape."""
    return Response(
        np.empty(points), np.empty(points), np.empty(points), np.empty(size),
        np.empty((size, COLUMN)),
    )  # fmt: skip


@linked()
def _respond(lanes, q, rule, matter, here):
    """Write moments and forces in the present shape."""
    if here.moment.size > 0:
        strains(lanes.q, lanes.tables, lanes.stretch, lanes.bend)
        for e in range(here.curvature.size):
            here.curvature[e] = entry(lanes.bend, LANES * e)
        moments_in_plane(here.curvature, matter, here.moment, here.tangent)
    press(q, rule, matter, here.forces, here.stiffness)


@linked()
def _retreat(lanes, q, rule, matter, promised, line, here):
    """Take back what of the last correction goes too far, see `remaining_share`.

    Args:
        promised: work of the forces along the correction, at its start.
        line: what law and surroundings were taken for.
        here: what they are after the correction; becomes what it is after what stays of it.

    Returns:
        The share of the correction that stays.
    """
    share, tables, step = 1.0, lanes.tables, lanes.scratch.step
    moved = np.zeros(here.forces.size)
    for _ in range(SHORTENINGS):
        unforeseen, stiffer = 0.0, 0.0
        for e in range(here.curvature.size):
            change = here.curvature[e] - line.curvature[e]
            more = here.moment[e] - line.moment[e] - line.tangent[e] * change
            unforeseen += rule.weight[e] * more * change
            stiffer += rule.weight[e] * (here.tangent[e] - line.tangent[e]) * change * change
        if here.forces.size > 0:
            for i in range(PLANE * tables.lo, PLANE * tables.hi):
                moved[i] = share * entry(step, LANES * i)
            against, more = work_unforeseen(
                moved, line.forces, line.stiffness, here.forces, here.stiffness
            )
            unforeseen += against
            stiffer += more
        stays = remaining_share(promised, unforeseen / share, stiffer / share**2, share)
        if stays == share:
            break
        for i in range(tables.lo, tables.hi):
            for c in range(PLANE):
                k = PLANE * i + c
                q[i, c] -= (share - stays) * entry(step, LANES * k)
                store(lanes.q, k, spread(q[i, c]))
        share = stays
        _respond(lanes, q, rule, matter, here)
    return share


@njit(from_python=False)
def _take(lanes, rule, here, line):
    """Take law and surroundings for the straight lines that touch them at the present shape."""
    law = lanes.law
    for e in range(here.curvature.size):
        line.curvature[e], line.moment[e] = here.curvature[e], here.moment[e]
        line.tangent[e] = here.tangent[e]
        store(law.bend, e, spread(rule.weight[e] * line.tangent[e]))
        store(law.bend_rest, e, spread(line.curvature[e] - line.moment[e] / line.tangent[e]))
    for i in range(here.forces.size):
        line.forces[i] = here.forces[i]
        for k in range(COLUMN):
            line.stiffness[i, k] = here.stiffness[i, k]


@njit(from_python=False)
def _add(tables, scratch, forces, stiff):
    """Add forces (2 n,) and their tangent, lower rows (2 n, 8), to what is assembled."""
    first, last = PLANE * tables.lo, PLANE * tables.hi
    for row in range(first, last):
        store(scratch.gradient, row, load(scratch.gradient, row) + spread(forces[row]))
        for m in range(min(COLUMN, row - first + 1)):
            x = stiff[row, COLUMN - 1 - m]
            if x != 0.0:
                at = COLUMN * (row - m) + m
                put_entry(scratch.band, at, entry(scratch.band, at) + x)
