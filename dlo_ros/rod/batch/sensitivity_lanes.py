# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivity parameters as compiled code of the lanes takes them: eight to a vector register."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dlo_ros.rod.batch import planar_sensitivity, spatial_sensitivity
from dlo_ros.rod.batch.layout import Layout, bending
from dlo_ros.rod.batch.simd_kernels import COLUMN, BatchLaw
from dlo_ros.rod.batch.simd_sensitivity import Variations
from dlo_ros.rod.batch.simd_step import Sets
from dlo_ros.rod.batch.stress_sensitivity import STRESS
from dlo_ros.rod.boundary.conditions import FRAME, Imposed
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import varying_of
from dlo_ros.rod.sensitivity.sensitivity_state import Rates, SensitivityState
from dlo_ros.rod.sensitivity_parameters import Compiled
from dlo_ros.rod.simd.eight_lanes import LANES, rows
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray


def _no_parameters() -> Variations:
    """The variations of a rod by no parameter."""
    none, group = np.zeros(0), rows(0, 0)
    many, table = np.zeros((0, 0, 0, 3)), np.zeros((0, 0))
    imposed = Imposed(table, many, many, many, np.zeros(0, dtype=np.int64), table, table)
    rates = Sets(BatchLaw(group, group, group, group), group, group, group, group, group)
    return Variations(
        rates, none, group, imposed, none, none, none, many, group, group, rows(0), none, none,
        none, group, np.zeros((0, 0, 0)), none, rows(0),
    )  # fmt: skip


NO_PARAMETERS = _no_parameters()


class SensitivityLanes:
    """The derivatives of a rod's state by P parameters, in lanes.

    Args:
        model: the rod.
        rod: the rod for compiled code, with the variants of its parameters, at least one.
        layout: of the rod as the only one of its sets.
    """

    def __init__(self, model: RodModel, rod: Compiled, layout: Layout) -> None:
        self._rod, self._place, self._flat = rod, layout.place, layout.flat
        self.count = len(rod.step)
        self.groups = -(-self.count // LANES)
        n, points, d = model.basis.control_points, len(model.rule.weight), layout.dof
        heavier = np.zeros(self.groups * LANES, dtype=np.bool_)
        for x in (rod.rates.mass, rod.rates.drag, rod.rates.spin):
            heavier[: self.count] |= x.any(axis=(1, 2))
        kernels = planar_sensitivity if self._flat else spatial_sensitivity
        self.variations = Variations(
            self._rates(rod.rates, model.rule.weight),
            np.array(heavier.reshape(self.groups, LANES).any(axis=1), dtype=np.float64),
            rows(self.groups, self._place[-1]), rod.imposed, rod.system.reach, rod.step, rod.moves,
            np.zeros((self.count, 2, 2, FRAME)), rows(self.groups, d * n),
            rows(self.groups, d * n + (COLUMN - 1 if self._flat else 0)),
            rows(0 if self._flat else 2 * points), np.zeros(len(layout.room.scratch.band)),
            np.zeros(kernels.GRADIENTS * points),
            np.zeros(STRESS * points * (2 if self._flat else 4)),
            rows(1, 0 if self._flat else 10 * points), np.zeros((2, n, d)), np.zeros(2),
            rows(d * n),
        )  # fmt: skip

    def _lanes(self, values: FloatArray) -> FloatArray:
        """Numbers of each parameter (P, ...) as an array (G, rows, LANES)."""
        flat = np.zeros((self.groups * LANES, values[0].size))
        flat[: self.count] = values.reshape(flat[: self.count].shape)
        result = rows(self.groups, flat.shape[1])
        result[...] = flat.reshape(self.groups, LANES, -1).transpose(0, 2, 1)
        return result

    def _rates(self, rates: Rates, weight: FloatArray) -> Sets:
        """Derivatives of the constants that `Layout.sets` has."""
        s = rates.stiffness
        bend, rest = bending(s, flat=self._flat)
        return Sets(
            BatchLaw(
                self._lanes(weight * s.stretch), self._lanes(s.stretch_rest),
                self._lanes(weight[:, None] * bend), self._lanes(rest),
            ),
            self._lanes(rates.mass), self._lanes(rates.drag), self._lanes(rates.spin),
            self._lanes(rates.load), self._lanes(rates.relaxation_time),
        )  # fmt: skip

    def begin(self, state: State) -> None:
        """Start from the derivatives that a state carries, by P parameters."""
        v = self._before = self._rod.mark(varying_of(state, flat=self._flat))
        bends = 1 if self._flat else 3
        parts = [v.q, v.velocity, v.acceleration, v.auxiliary, v.stretch, v.stretch_before,
                 v.other[:, :, :bends], v.other_before[:, :, :bends]]  # fmt: skip
        parts += [] if self._flat else v.reference
        flat = np.concatenate([x.reshape(self.count, -1) for x in parts], axis=1)
        self.variations.changes[:, : flat.shape[1]] = self._lanes(flat)
        self.variations.frames[...] = v.frames
        self.variations.increments[...] = 0.0

    def derivatives(self, lanes: FloatArray) -> FloatArray:
        """Derivatives of shapes (S, P, n, d), given the lanes (S, G, d n, LANES)."""
        stamps, groups, size = lanes.shape[:3]
        flat = lanes.transpose(0, 1, 3, 2).reshape(stamps, groups * LANES, size)
        return flat[:, : self.count].reshape(stamps, *self._before.q.shape)

    def end(self) -> SensitivityState:
        """The derivatives of the state at the last stamp; those of its shape (P, n, d)."""
        changes = self.variations.changes.transpose(0, 2, 1).reshape(self.groups * LANES, -1)
        parts = [changes[: self.count, a:b].copy() for a, b in pairwise(self._place)]
        v = self._before
        q, velocity, acceleration, auxiliary = (x.reshape(v.q.shape) for x in parts[:4])
        other, before = np.zeros(v.other.shape), np.zeros(v.other.shape)
        bends = 1 if self._flat else 3
        for out, part in zip((other, before), parts[6:8], strict=True):
            out[:, :, :bends] = part.reshape(*out.shape[:2], bends)
        reference = v.reference
        if not self._flat:
            shaped = zip(parts[8:12], reference, strict=True)
            reference = Reference._make(x.reshape(like.shape) for x, like in shaped)
        return v._replace(
            q=q, velocity=velocity, acceleration=acceleration, auxiliary=auxiliary,
            reference=reference, frames=self.variations.frames.copy(), stretch=parts[4],
            stretch_before=parts[5], other=other, other_before=before,
        )  # fmt: skip
