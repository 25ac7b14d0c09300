# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Results of many parameter sets simulated at once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import SimulationError
from dlo_ros.rod.batch.simd_step import BatchState
from dlo_ros.rod.boundary.conditions import THETA
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar_model import expand, flat_reference
from dlo_ros.rod.simd.eight_lanes import LANES
from dlo_ros.rod.state import State, Strains
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class EndStates:
    """States of all sets at the last stamp, as compiled code left them."""

    models: tuple[RodModel, ...]
    before: tuple[State, ...]
    motion: BatchState
    clock: FloatArray
    frames: FloatArray  # (C, 2, FRAME)
    directed: NDArray[np.bool_]  # (2, 1) whether the command gives an end its direction
    stamp: int
    alone: dict[int, State] = field(default_factory=dict)

    def state(self, number: int) -> State:
        """The state of a set."""
        if number in self.alone:
            return self.alone[number]
        before, model = self.before[number], self.models[number]
        group, lane = divmod(number, LANES)
        *values, frame, _ = self.motion
        n = len(before.q)
        q, velocity, acceleration, auxiliary = (
            expand(x[group, :, lane].reshape(n, -1), before.q) for x in values[:4]
        )
        stretch, stretch_before, bend, bend_before = (x[group, :, lane] for x in values[4:])
        if frame.twist.shape[1]:
            tangent, rate, director, twist = (x[group, :, lane] for x in frame)
            reference = Reference(
                tangent.reshape(-1, 3), rate.reshape(-1, 3), director.reshape(-1, 3), twist.copy()
            )
        else:
            reference = flat_reference(model, q, before.reference)
        frames = np.where(self.directed, self.frames[group], before.frames)
        frames[:, THETA] = q[[0, -1], 3]
        return replace(
            before,
            stamp=self.stamp,
            q=q,
            velocity=velocity,
            acceleration=acceleration,
            auxiliary=auxiliary,
            reference=reference,
            frames=frames,
            strains=_strains(stretch, bend),
            previous=_strains(stretch_before, bend_before),
            last_step=float(self.clock[group, 1]),
            next_step=float(self.clock[group, 2]),
            sensitivity=None,
        )


def _strains(stretch: FloatArray, bend: FloatArray) -> Strains:
    if len(bend) > len(stretch):
        return Strains(stretch.copy(), bend.reshape(-1, 3).copy())
    other = np.zeros((len(bend), 3))
    other[:, 0] = bend
    return Strains(stretch.copy(), other)


@dataclass(frozen=True)
class Tracks:
    """Simulated motions of S parameter sets.

    Args:
        shapes: control points at every stamp, NaN for sets that failed, shape (S, T, n, 4).
        speeds: velocities of the control points, likewise; (S, 0, n, 4) where not requested.
        twists: twist strain [rad/m] at the bending points, shape (S, T, nb); none in the plane.
        steps: number of steps of each set, rejected ones included, shape (S,).
        failures: the reason why a set failed, by its number.
        ends: states of the sets at the last stamp.
    """

    shapes: FloatArray
    speeds: FloatArray
    twists: FloatArray
    steps: NDArray[np.int64]
    failures: dict[int, str]
    ends: EndStates = field(repr=False)

    def state(self, number: int) -> State:
        """The state of a set at the last stamp.

        Raises:
            SimulationError: the set failed.
        """
        if number in self.failures:
            raise SimulationError(f"parameter set {number}: {self.failures[number]}")
        return self.ends.state(number)
