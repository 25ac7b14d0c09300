# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Changes in time that the interface has no name for: tests of "none of the above"."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.rod_simulation import Change

SHAPES = 4  # of a gust along the rope
TONES = 12  # of a gust in time


def stiffness_drift(rate: float) -> Change:
    """Bending stiffness that grows steadily from its value at the start: B (1 + rate t).

    Args:
        rate: [1/s]; the stiffness stays above a hundredth of what it was.
    """

    def change(rod: DiscreteRod, time: float) -> DiscreteRod:
        factor = max(1.0 + rate * time, 0.01)
        return replace(rod, bending_stiffness=factor * rod.bending_stiffness)

    return change


def gusts(force: float, correlation_time: float, seed: int, axes: int = 2) -> Change:
    """A random force, smooth in time and along the rope, that rises from nothing at the start.

    Args:
        force: root mean square of each component of the force per length [N/m].
        correlation_time: time within which the force changes [s].
        seed: seed of the random numbers.
        axes: coordinates of a node: 2 in the plane, 3 in space.
    """
    rng = np.random.default_rng(seed)
    size = (SHAPES, TONES, axes)
    tones = rng.uniform(0.0, 1.0 / correlation_time, size)  # [rad/s]
    phases = rng.uniform(0.0, 2.0 * np.pi, size)
    # The mean square of cos^2 is 1/2 in time and, but for the uniform shape, 1/2 along the rope.
    weights = force * np.sqrt(2.0 / TONES / (1.0 + 0.5 * (SHAPES - 1)))

    def change(rod: DiscreteRod, time: float) -> DiscreteRod:
        rise = 1.0 - np.exp(-((time / correlation_time) ** 2))
        amplitudes = rise * weights * np.cos(tones * time + phases).sum(axis=1)  # (SHAPES, axes)
        along = np.cos(np.pi * np.outer(rod.u / rod.u[-1], np.arange(SHAPES)))  # (N + 1, SHAPES)
        return replace(rod, force=rod.force + rod.vertex_lengths[:, None] * (along @ amplitudes))

    return change
