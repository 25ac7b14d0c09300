# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivity parameters as compiled code of the lanes takes them: eight to a vector register."""

from __future__ import annotations

import numpy as np

from dlo_ros.rod.batch import planar_sensitivity, spatial_sensitivity
from dlo_ros.rod.batch.layout import Layout, bending
from dlo_ros.rod.batch.simd_sensitivity import Variations
from dlo_ros.rod.batch.simd_step import Sets
from dlo_ros.rod.batch.stress_sensitivity import STRESS
from dlo_ros.rod.boundary.conditions import FRAME, Imposed
from dlo_ros.rod.compiled_rod import Compiled
from dlo_ros.rod.lanes.simd_kernels import BatchLaw
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.simd.eight_lanes import LANES, rows
from dlo_ros.spline import FloatArray


def _no_parameters() -> Variations:
    """The variations of a rod by no parameter."""
    none, group = np.zeros(0), rows(0, 0)
    many, table = np.zeros((0, 0, 0, 3)), np.zeros((0, 0))
    imposed = Imposed(table, many, many, many, np.zeros(0, dtype=np.int64), table, table)
    rates = Sets(BatchLaw(group, group, group, group), group, group, group, group, group)
    return Variations(
        rates, none, group, imposed, none, none, none, many, group, group, rows(0), none, none,
        group, np.zeros((0, 0, 0)), none, rows(0),
    )  # fmt: skip


NO_PARAMETERS = _no_parameters()


def variations_of(model: RodModel, rod: Compiled, layout: Layout) -> Variations:
    """The parameters of a rod in lanes, and room for the derivatives of its state.

    Args:
        model: the rod.
        rod: the rod for compiled code, with the variants of its parameters, at least one.
        layout: of the rod as the only one of its sets.
    """
    count, flat, rates = len(rod.step), layout.flat, rod.rates
    groups = -(-count // LANES)
    n, points, d = model.basis.control_points, len(model.rule.weight), layout.dof
    heavier = np.zeros(groups * LANES, dtype=np.bool_)
    for x in (rates.mass, rates.drag, rates.spin):
        heavier[:count] |= x.any(axis=(1, 2))
    bend, rest = bending(rates.stiffness, flat=flat)
    weight, s = model.rule.weight, rates.stiffness
    law = BatchLaw(
        _lanes(weight * s.stretch), _lanes(s.stretch_rest), _lanes(weight[:, None] * bend),
        _lanes(rest),
    )  # fmt: skip
    kernels = planar_sensitivity if flat else spatial_sensitivity
    return Variations(
        Sets(
            law, _lanes(rates.mass), _lanes(rates.drag), _lanes(rates.spin), _lanes(rates.load),
            _lanes(rates.relaxation_time),
        ),
        np.array(heavier.reshape(groups, LANES).any(axis=1), dtype=np.float64),
        rows(groups, layout.place[-1]), rod.imposed, rod.system.reach, rod.step, rod.moves,
        np.zeros((count, 2, 2, FRAME)), rows(groups, d * n),
        rows(groups, d * (n + 4) - 1), rows(0 if flat else 2 * points),
        np.zeros(kernels.GRADIENTS * points), np.zeros(STRESS * points * (2 if flat else 4)),
        rows(1, 0 if flat else 10 * points), np.zeros((2, n, d)), np.zeros(2), rows(d * n),
    )  # fmt: skip


def _lanes(values: FloatArray) -> FloatArray:
    """Numbers of each parameter (P, ...) as an array (G, rows, LANES)."""
    groups = -(-len(values) // LANES)
    flat = np.zeros((groups * LANES, values[0].size))
    flat[: len(values)] = values.reshape(len(values), -1)
    result = rows(groups, flat.shape[1])
    result[...] = flat.reshape(groups, LANES, -1).transpose(0, 2, 1)
    return result
