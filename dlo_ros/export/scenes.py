# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Motions in which another simulator is compared with the rod: a standard and a recorded one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from dlo_ros.command import NANOSECONDS, START, Command, Motion
from dlo_ros.errors import SimulationError
from dlo_ros.export.grips import Pose, pose_at
from dlo_ros.inference.forecast import Manipulation, motion_of
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.spline import FloatArray, SplineBasis

CONTROL_POINTS = 40  # of the standard motion's shapes, at least
STROKE = 0.25  # of the length, by which the standard motion goes to and fro
POINTS = 51  # of its command
FRAMES = 61  # at which shapes are compared
REST_MOTION = 1e-3  # of the length: what moves less stands still
INSTANT = 1_000_000  # [ns] in which the velocity of a moving start is seen


@dataclass(frozen=True)
class ComparedMotion:
    """A motion of the rod, and its observed shapes.

    Args:
        name: the motion's name in messages.
        settings: settings of the rod that was simulated.
        motion: motion of the clamps as commanded.
        stamps: stamps of the shapes [ns], the first when the motion begins.
        basis: spline basis of the shapes.
        shapes: control points of the rod, shape (F, n, 3) [m].
        fine: basis of `first`.
        first: the rod when the motion begins, in the simulation's own basis, shape (m, 4).
        soon: the same `INSTANT` later; None: it begins at rest.
        settled: whether it begins in equilibrium.
        start: shapes from which the simulation started.
        observed: control points of what was seen, shape (F, n, 3), as the camera measures it.
        camera: the camera that measured `observed`.
    """

    name: str
    settings: Settings
    motion: Motion
    stamps: tuple[int, ...]
    basis: SplineBasis
    shapes: FloatArray
    fine: SplineBasis
    first: FloatArray
    soon: FloatArray | None
    settled: bool
    start: tuple[Observation, ...]
    observed: FloatArray | None = None
    camera: MeasurementMap | None = None

    @property
    def moves(self) -> bool:
        """Whether the rod moves by more than a shape's rounding."""
        return float(np.ptp(self.shapes, axis=0).max()) > REST_MOTION * self.basis.length

    @property
    def command(self) -> Command:
        """The command when the motion begins."""
        found = self.motion.at(self.stamps[0])
        assert found is not None
        return found

    def beginning(self, settings: Settings) -> tuple[SplineBasis, FloatArray]:
        """The shape of another cable when the motion begins.

        Args:
            settings: settings of that cable, of the same configured length.

        Returns:
            As `fine` and `first`.

        Raises:
            SimulationError, InputError: the grips cannot hold that cable.
        """
        rod = replace(settings.rod, control_points=self.settings.rod.control_points)
        settings = replace(settings, rod=rod, simulation=self.settings.simulation)
        simulation = simulation_of(settings, self.motion)
        simulation.start(self.start, self.stamps[0])
        return simulation.basis, simulation.true_shape()

    def pose(self, end: str, stamp: int) -> Pose:
        """Pose of a held end at a stamp [ns]."""
        command = self.motion.at(stamp)
        assert command is not None
        return pose_at(command, end, stamp)


def standard_scene(settings: Settings) -> ComparedMotion:
    """The standard motion: clamped level at its start, moved to and fro once, then watched as long.

    The clamp goes by a quarter of the length in the time of a pendulum's swing, smoothly.

    Raises:
        SimulationError: the rod cannot be simulated.
    """
    rod = replace(settings.rod, control_points=max(settings.rod.control_points, CONTROL_POINTS))
    start = replace(settings.simulation, start="equilibrium")
    settings = replace(settings, rod=rod, simulation=start)
    period = 2.0 * math.pi * math.sqrt(rod.length / max(_gravity(settings), 1.0))
    times = np.linspace(0.0, period, POINTS)
    phase = 2.0 * math.pi * times / period
    positions, velocities = np.zeros((2, POINTS, 1, 3))
    positions[:, 0, 0] = 0.5 * STROKE * rod.length * (1.0 - np.cos(phase))
    velocities[:, 0, 0] = STROKE * rod.length * math.pi / period * np.sin(phase)
    rotations = np.zeros((POINTS, 1, 4))
    rotations[:, :, 3] = 1.0
    command = Command(
        0, (START,), times, positions, rotations, velocities, rod.control_points,
        settings.frame_id,
    )  # fmt: skip
    stamps = [round(t * NANOSECONDS) for t in np.linspace(0.0, 2.0 * period, FRAMES)]
    failure: SimulationError | None = None
    for droop in (1.0, 0.0):
        observation = Observation(0, _drooping(settings, droop))
        try:
            return _simulated("standard motion", settings, Motion([command]), [observation], stamps)
        except SimulationError as err:
            failure = err
    assert failure is not None
    raise failure


def recorded_scene(
    manipulation: Manipulation, settings: Settings, full: Settings
) -> ComparedMotion:
    """A recording's motion, from its first observed shape until other parts of the DLO are held.

    An exported cable keeps its grips: where a command lets an end go or takes another, the rest of
    the recording cannot be compared, and the scene's name says so.

    Args:
        settings: settings of the rod, without effects of the measurement.
        full: settings with effects of the measurement.

    Raises:
        SimulationError, InputError: it cannot be simulated.
    """
    camera = MeasurementMap(full)
    seen = [
        Observation(o.stamp - camera.later, camera.true(o.control_points))
        for o in manipulation.observations
    ]
    begin = 1 if settings.simulation.start == "moving" and len(seen) > 1 else 0
    stamps = [o.stamp for o in seen[begin:]]
    motion = motion_of(manipulation)
    kept, name = _alike(motion, stamps), manipulation.name
    if len(kept) < len(stamps):
        name += f", up to {(kept[-1] - stamps[0]) / NANOSECONDS:.2f} s, where its grips change"
    scene = _simulated(name, settings, motion, seen[:2], kept)
    used = manipulation.observations[begin : begin + len(kept)]
    observed = np.array([o.control_points[:, :3] for o in used])
    return replace(scene, observed=observed, camera=camera)


def _alike(motion: Motion, stamps: Sequence[int]) -> list[int]:
    """The stamps [ns] until what is held is no more what is held at the first of them."""

    def held(stamp: int) -> frozenset[str]:
        command = motion.at(stamp)
        return frozenset(command.names if command else ())

    first = held(stamps[0])
    return list(takewhile(lambda stamp: held(stamp) == first, stamps))


def _simulated(
    name: str, settings: Settings, motion: Motion, observations: Sequence[Observation],
    stamps: Sequence[int],
) -> ComparedMotion:  # fmt: skip
    simulation = simulation_of(settings, motion)
    simulation.start(observations, stamps[-1])
    fine, first = simulation.basis, simulation.true_shape()
    shapes, soon = [simulation.prediction()], None
    settled = settings.simulation.start == "equilibrium"
    if settings.simulation.start == "moving":
        probe = simulation.fork(settings)
        probe.advance(stamps[0] + INSTANT)
        soon = probe.true_shape()
    if len(stamps) > 1:
        shapes += simulation.advance_through(stamps[1:])
    points = np.array([s.control_points[:, :3] for s in shapes])
    return ComparedMotion(
        name, settings, motion, tuple(stamps), simulation.published, points, fine, first, soon,
        settled, tuple(observations),
    )  # fmt: skip


def _gravity(settings: Settings) -> float:
    return float(np.linalg.norm(settings.gravity))


def _drooping(settings: Settings, droop: float) -> FloatArray:
    """A shape (n, 4) from which a level cantilever finds its equilibrium; 0: straight.

    Its direction falls off over the length at which weight and bending stiffness are in balance.
    """
    rod = settings.rod
    basis = SplineBasis(rod.control_points, rod.length)
    weight = rod.linear_density * _gravity(settings)
    scale = (rod.bending_stiffness / weight) ** (1.0 / 3.0) if weight > 0.0 else math.inf
    deep = droop * min(0.9 * 0.5 * math.pi, (rod.length / scale) ** 3 / 6.0)
    u = np.linspace(0.0, rod.length, 400)
    angle = deep * (1.0 - np.exp(-u / min(scale, rod.length)))
    step = u[1] - u[0]
    result = np.zeros((rod.control_points, 4))
    x, z = (np.cumsum(f(angle)) * step - f(angle[0]) * step for f in (np.cos, np.sin))
    result[:, [0, 2]] = basis.fit(u, np.column_stack([x, -z]))
    result[0, :3] = 0.0
    return result
