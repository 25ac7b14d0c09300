# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled quadratic drag.

It is a force per length -c |v_n| v_n against the velocity across the DLO. Within a step |v_n| and
the direction are predicted from the past, to second order in the step, so that the force is linear
in the velocity at the step's end, and that velocity in the position: a spring across the DLO to the
place where it would not move. The springs of a step are summed up once.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.element_stiffness import BLOCK, FIRST, add_block, add_forces
from dlo_ros.rod.elements.rod_tables import Springs
from dlo_ros.rod.elements.strains import column, three
from dlo_ros.rod.simd.four_lanes import lanes
from dlo_ros.rod.simd.row_operations import set_outer, set_rows
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE, dot, mix, times

SQUARES = 3 * BLOCK  # numbers of the products of basis functions at the points of a span


@njit(**INLINE)
def _place(values, i, last):
    """x, y and z of a control point; y is 0 in the plane."""
    return values[i, 0], values[i, 1] if last == 2 else 0.0, values[i, last]


@njit(**INLINE)
def points(values, span, table, e, last):
    """A spline at the three points of a span, as a vector in space.

    Args:
        values: control points (n, d).
        table, e: basis functions, or their derivatives, and the first of the points.
        last: column of z, 1 in the plane and 2 in space.
    """
    result = times(column(table, e, 0), _place(values, span, last))
    for i in range(1, 4):
        result = mix(1.0, result, column(table, e, i), _place(values, span + i, last))
    return result


@njit(**INLINE)
def add_pushes(push, rule, e, dof, forces, out):
    """Add forces on the points of a span, a vector in space each, to out (n d,).

    Args:
        forces: room, (FIRST,), of which what belongs to no coordinate of a vector is zero.
    """
    last = dof // 2
    set_rows(forces, 0, lanes(push[0]), rule.b, 4 * e, 4)
    if last == 2:
        set_rows(forces, 4, lanes(push[1]), rule.b, 4 * e, 4)
    set_rows(forces, 4 * last, lanes(push[2]), rule.b, 4 * e, 4)
    add_forces(forces, dof, rule.span[e], out)


@njit(from_python=False)
def no_springs():
    """No quadratic drag."""
    return Springs(np.zeros((0, 0)), np.zeros(0))


@njit(**INLINE)
def _couple(block, c, d, stiff, squares):
    """Write the springs of a span between two of its coordinates, d <= c."""
    set_rows(block, BLOCK * (c * (c + 1) // 2 + d), lanes(stiff), squares, 0, BLOCK)


@linked(**FLAGS)
def drag_springs(rule, coefficient, q, velocity, still, rate):
    """Quadratic drag of one step as springs across the DLO.

    Args:
        coefficient: c, times the true length over that of the basis [N s^2/m^3].
        q, velocity: control points and their velocities by which direction and speed are judged,
            shape (n, d).
        still: control points at which the DLO would not move, shape (n, d).
        rate: velocity over the distance from there [1/s].
    """
    dof = q.shape[1]
    last = dof // 2
    result = Springs(np.zeros((q.size, 4 * dof)), np.zeros(q.size))
    squares, forces, block = np.empty(SQUARES), np.zeros(FIRST), np.zeros(10 * BLOCK)
    for e in range(0, rule.weight.size, 3):
        span = rule.span[e]
        slope, speed = points(q, span, rule.b1, e, last), points(velocity, span, rule.b, e, last)
        t = times(1.0 / np.sqrt(dot(slope, slope)), slope)
        across = mix(1.0, speed, -dot(speed, t), t)
        stiff = three(rule.weight, e) * (coefficient * rate) * np.sqrt(dot(across, across))
        place = points(still, span, rule.b, e, last)
        add_pushes(
            times(stiff, mix(1.0, place, -dot(place, t), t)), rule, e, dof, forces, result.pull
        )
        for k in range(3):
            set_outer(squares, BLOCK * k, rule.b, 4 * (e + k), rule.b, 4 * (e + k))
        _couple(block, 0, 0, stiff * (1.0 - t[0] * t[0]), squares)
        _couple(block, last, 0, -stiff * t[2] * t[0], squares)
        _couple(block, last, last, stiff * (1.0 - t[2] * t[2]), squares)
        if last == 2:
            _couple(block, 1, 0, -stiff * t[1] * t[0], squares)
            _couple(block, 1, 1, stiff * (1.0 - t[1] * t[1]), squares)
            _couple(block, 2, 1, -stiff * t[2] * t[1], squares)
            add_block(block, 4, span, result.stiffness)
        else:
            add_block(block, 2, span, result.stiffness)
    return result


@linked()
def add_springs(q, springs, gradient, band):
    """Add the forces of springs and their tangent to gradient and banded matrix."""
    place, width = q.ravel(), band.shape[1]
    for i in range(place.size):
        stiff = springs.stiffness[i]
        gradient[i] += stiff[width - 1] * place[i] - springs.pull[i]
        band[i, width - 1] += stiff[width - 1]
        for m in range(1, min(width, i + 1)):
            gradient[i] += stiff[width - 1 - m] * place[i - m]
            gradient[i - m] += stiff[width - 1 - m] * place[i]
            band[i, width - 1 - m] += stiff[width - 1 - m]
