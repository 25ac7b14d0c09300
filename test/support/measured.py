# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Manipulations measured with noise on a discrete rod: another discretisation than the model's."""

from __future__ import annotations

import numpy as np
from rods import SECOND, command

from dlo_ros.identification import Manipulation
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis import discrete_rod, rod_simulation
from dlo_ros.synthesis.rod_reactions import measured as sensed
from dlo_ros.synthesis.rod_reactions import reactions


def spline_through(rod, nodes, basis, noise, rng):
    """Observed spline of a noisy centreline of 120 points, shape (n, 4)."""
    u = np.linspace(0.0, basis.length, 120)
    points = discrete_rod.centreline(rod, nodes, u)
    points = points + noise * rng.normal(size=points.shape) * np.array([1.0, 0.0, 1.0])
    shape = np.zeros((basis.control_points, 4))
    shape[:, :3] = basis.fit(u, points)
    return shape


def swing(
    settings: Settings, *, seconds=2.0, rate=30.0, noise=3e-4, seed=0, edges=120, sensor=None
):
    """A rod clamped at its start, turned from horizontal to 60 degrees down within 0.3 s.

    With a sensor its forces and torques at the clamp, at the instants of the pictures.
    """
    rng = np.random.default_rng(seed)
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    rod = discrete_rod.DiscreteRod.uniform(settings.rod, settings.damping, edges=edges)
    turn = np.radians(60.0)

    def angle(t):
        return turn * np.clip(t / 0.3, 0.0, 1.0)

    def boundary(t):
        return rod_simulation.ImposedNodes({0: np.zeros(2)}, start=float(angle(t)))

    straight = np.column_stack([rod.u, np.zeros(len(rod.u))])
    simulation = rod_simulation.DiscreteRodSimulation(rod, boundary, straight, step=1e-3)
    simulation.settle()
    observations, borne = [], []
    for k in range(int(seconds * rate) + 1):
        if k:
            simulation.advance(k / rate)
        borne.append(reactions(simulation) if sensor else {})
        stamp = round(k / rate * SECOND)
        observations.append(
            Observation(stamp, spline_through(rod, simulation.x, basis, noise, rng))
        )
    times = np.linspace(0.0, 0.3, 31)
    rotations = [[[0.0, np.sin(angle(t) / 2), 0.0, np.cos(angle(t) / 2)]] for t in times]
    imposed = command(["start"], times, np.zeros((31, 3)), rotations, n=basis.control_points)
    wrenches = ()
    if sensor:
        stamps, still = [o.stamp for o in observations], np.zeros((len(borne), 3))
        wrenches = tuple(sensed(sensor, stamps, borne, {"start": still}, seed))
    return Manipulation("swing", (imposed,), tuple(observations), wrenches)


def at_rest(settings: Settings, *, frames=5, noise=3e-4, seed=0, same=True):
    """A settled cantilever, observed several times: the same picture, or each with its noise."""
    rng = np.random.default_rng(seed)
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    rod = discrete_rod.DiscreteRod.uniform(settings.rod, settings.damping, edges=120)
    hold = rod_simulation.ImposedNodes({0: np.zeros(2)}, start=0.0)
    straight = np.column_stack([rod.u, np.zeros(len(rod.u))])
    nodes = rod_simulation.DiscreteRodSimulation(rod, lambda _: hold, straight).settle()
    shapes = [spline_through(rod, nodes, basis, noise, rng) for _ in range(frames)]
    observations = tuple(
        Observation(k * SECOND // 4, shapes[0] if same else shapes[k]) for k in range(frames)
    )
    imposed = command(["start"], [0.0], np.zeros((1, 3)), n=basis.control_points)
    return Manipulation("at_rest", (imposed,), observations)
