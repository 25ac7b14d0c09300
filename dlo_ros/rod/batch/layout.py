# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameter sets as compiled code of the lanes takes them: eight to a vector register."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dlo_ros.rod.batch.simd_step import BatchState, Room, Sets
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.elements.rod_tables import DOF, Stiffness
from dlo_ros.rod.held_tables import held_tables
from dlo_ros.rod.lanes import spatial_kernels
from dlo_ros.rod.lanes.simd_kernels import (
    COLUMN,
    BatchLaw,
    Frame,
    Scratch,
)  # fmt: skip
from dlo_ros.rod.lanes.span_lanes import with_room
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar_model import IN_PLANE, reduce
from dlo_ros.rod.simd.eight_lanes import LANES, rows
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray


class Layout:
    """Constants of parameter sets, and room for their motion.

    Args:
        models: one for each set, with the same basis.
        boundary: common to all sets.
        flat: whether they move in the plane y = 0, with x and z only.

    Attributes:
        dof: numbers of a control point.
        place: where the rows of each part of a state begin, in the order of `BatchState`.
        order: number of the set in each lane, (C, LANES); the last one fills up.
    """

    def __init__(self, models: Sequence[RodModel], boundary: Boundary, *, flat: bool) -> None:
        self.flat = flat
        first, points = models[0], len(models[0].rule.weight)
        n, d = first.basis.control_points, 2 if flat else DOF
        self.dof = d
        tables = held_tables(first.discretisation, boundary, flat=flat, alone=len(models) == 1)
        self.tables = tables._replace(together=with_room(tables.together, d))
        self.order = np.minimum(np.arange(-(-len(models) // LANES) * LANES), len(models) - 1)
        self.order = self.order.reshape(-1, LANES)
        stiff, weight = [model.stiffness for model in models], first.rule.weight
        bend, rest = zip(*(bending(s, flat=flat) for s in stiff), strict=True)
        self.sets = Sets(
            BatchLaw(
                self.lanes([weight * s.stretch for s in stiff]),
                self.lanes([s.stretch_rest for s in stiff]),
                self.lanes([weight[:, None] * b for b in bend]),
                self.lanes(rest),
            ),
            self.lanes([model.mass for model in models]),
            self.lanes([model.drag for model in models]),
            self.lanes([model.spin for model in models]),
            self.lanes([reduce(model.load, flat) for model in models]),
            self.lanes([[model.body.relaxation_time] for model in models]),
        )
        size, bends = d * n, points if flat else 3 * points
        many = size + 4 * d - 1  # the factorisation reaches beyond the last column
        scratch = (
            (size, many, COLUMN * many, 42, 16, 2 * points) if flat
            else (size, many, spatial_kernels.BLOCKS * n, 3 * spatial_kernels.POINT,
                  spatial_kernels.SPAN, 3 * points)
        )  # fmt: skip
        frame = [0] * 4 if flat else [3 * points, 3 * points, 3 * points, points]
        parts = [size] * 4 + [points] * 2 + [bends] * 2 + frame + [points]
        self.place = np.concatenate([[0], np.cumsum(parts)])
        self.room = Room(
            BatchLaw(rows(points), rows(points), rows(bends), rows(bends)),
            Scratch(*(rows(count) for count in scratch)),
            rows(2 * size), rows(size), rows(size), rows(size), rows(size), rows(size), rows(size),
            np.zeros((n, d)),
        )  # fmt: skip

    def lanes(self, values: Sequence[object] | FloatArray) -> FloatArray:
        """Values of each set as an array (C, rows, LANES)."""
        flat = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
        result = rows(len(self.order), flat.shape[1])
        result[...] = flat[self.order].transpose(0, 2, 1)
        return result

    def motion(self, states: Sequence[State]) -> FloatArray:
        """A copy of states, one for each set, as rows of `place`, (C, rows, LANES)."""
        flat = np.empty((len(states), self.place[-1]))
        for k, state in enumerate(states):
            moving = np.concatenate((state.q, state.velocity, state.acceleration, state.auxiliary))
            now, before, frame = state.strains, state.previous, state.reference
            if self.flat:
                parts = [moving[:, :: IN_PLANE[1]], now.stretch, before.stretch, now.other[:, 0],
                         before.other[:, 0]]  # fmt: skip
            else:
                parts = [moving, now.stretch, before.stretch, now.other, before.other, *frame]
            np.concatenate([part.ravel() for part in parts], out=flat[k, : self.place[-2]])
        return self.lanes(flat)

    def unpacked(self, motion: FloatArray) -> BatchState:
        """Views of what `motion` gives."""
        parts = [motion[:, a:b] for a, b in pairwise(self.place)]
        return BatchState._make([*parts[:8], Frame(*parts[8:12]), parts[12]])


def bending(stiffness: Stiffness, *, flat: bool) -> tuple[FloatArray, FloatArray]:
    """Bending stiffness and curvatures at rest that a rod has in lanes, (..., nb, 1 or 3).

    Args:
        stiffness: of the rod, or its derivatives by P parameters, (P, ...).
        flat: whether the rod moves in the plane; in space twist stands behind both bendings.
    """
    if flat:
        return stiffness.bend[..., :1], stiffness.bend_rest[..., :1]
    return (
        np.concatenate([stiffness.bend[..., :2], stiffness.twist[..., None]], axis=-1),
        np.concatenate([stiffness.bend_rest, stiffness.twist_rest[..., None]], axis=-1),
    )
