# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Curves of known length and what a tracker of points makes of them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import Command, Motion
from dlo_ros.observation import PointList
from dlo_ros.parameters import RodParameters, Settings

LENGTH = 0.8
N = 12
SETTINGS = Settings(RodParameters(LENGTH, 0.006, 5e6, 1500.0, control_points=N))


@dataclass(frozen=True)
class Curve:
    """A smooth curve: places s [m], points (m, 3) and unit tangents (m, 3)."""

    s: np.ndarray
    points: np.ndarray
    tangents: np.ndarray

    def at(self, u):
        return np.column_stack([np.interp(u, self.s, self.points[:, c]) for c in range(3)])

    def motion(self, start=True, end=False):
        """The command that holds its ends."""
        held = [(name, k) for name, k, on in (("start", 0, start), ("end", -1, end)) if on]
        if not held:
            return None
        turn = [
            Rotation.align_vectors([self.tangents[k]], [[1, 0, 0]])[0].as_quat() for _, k in held
        ]
        none = np.full((1, len(held), 3), np.nan)
        names, places = tuple(name for name, _ in held), [self.points[k] for _, k in held]
        return Motion(
            [Command(1, names, np.zeros(1), np.array([places]), np.array([turn]), none, N)]
        )


def bent(seed, space=False, turns=1.5):
    """A random curve, of which the direction turns by about so many radians."""
    random = np.random.default_rng(seed)
    s = np.linspace(0.0, LENGTH, 2001)

    def wave(count, size):
        parts = [
            random.normal() * size / k * np.sin(np.pi * k * s / LENGTH + random.uniform(0.0, 6.0))
            for k in range(1, count + 1)
        ]
        return np.sum(parts, axis=0)

    a = wave(3, turns) + random.uniform(-3.0, 3.0)
    e = wave(2, 0.5 * turns) if space else np.zeros_like(s)
    t = np.column_stack([np.cos(a) * np.cos(e), np.sin(e), np.sin(a) * np.cos(e)])
    steps = 0.5 * (t[1:] + t[:-1]) * s[1]
    return Curve(s, np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]), t)


def tracked(curve, seed, count=150, noise=0.003, outliers=0.05, stamp=10, given=False):
    """Points in no order, some of them anywhere; in the plane where the curve is."""
    random = np.random.default_rng(10_000 + seed)
    u = random.uniform(0.0, LENGTH, count)
    axes = np.array([1.0, float(np.any(curve.points[:, 1])), 1.0])
    points = curve.at(u) + axes * random.normal(0.0, noise, (count, 3))
    bad = random.random(count) < outliers
    low, high = curve.points.min(axis=0) - 0.1, curve.points.max(axis=0) + 0.1
    points[bad] = axes * random.uniform(low, high, (count, 3))[bad]
    return PointList(stamp, points, u if given else None)
