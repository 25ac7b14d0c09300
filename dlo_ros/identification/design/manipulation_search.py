# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Search for the manipulation with the largest expected gain, within a workspace.

A candidate is a list of poses of the held ends at a few moments: they move smoothly (minimum jerk)
from one pose to the next and rest there. Candidates are drawn at random, and the best are varied.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.design.expected_information import Plan
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

# Which ends are held, and whether they give a direction.
KINDS = ("free", "tip", "clamps")
MOMENTS = 3  # places of the held ends: before, between and after two motions
MOVES = ((0.08, 0.42), (0.52, 0.86))  # when they are made, of the duration
PEAK = 1.875  # largest over mean speed of a motion of minimum jerk
SPACING = 0.04  # [s] of a command's points
TAUT = 0.97  # of L: ends are held no further apart
CLOSEST = 0.12  # of L: nor closer
SEARCH_RATE = 10.0  # Hz of the camera while searching
FIRST_SPREAD, LAST_SPREAD = 0.3, 0.04  # of the ranges, by which good candidates are varied
ELITE = 4
TURN = np.pi  # range of a clamp's direction to either side


@dataclass(frozen=True)
class Workspace:
    """The limits of a manipulation.

    Args:
        x, z: bounds of the held ends [m], low and high.
        speed: largest speed of a held end [m/s].
        turn: largest angular speed of a clamp [rad/s].
        duration: duration of a recording [s].
    """

    x: tuple[float, float]
    z: tuple[float, float]
    speed: float = 0.5
    turn: float = 3.0
    duration: float = 3.0

    def __post_init__(self) -> None:
        for name, (low, high) in (("x", self.x), ("z", self.z)):
            if not low < high:
                raise InputError(f"workspace: {name} from {low:g} to {high:g} m is empty")
        for name in ("speed", "turn", "duration"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"workspace: {name} is {getattr(self, name):g}; above 0 is needed")


@dataclass(frozen=True)
class ManipulationCandidate:
    """A manipulation as numbers.

    Args:
        kind: kind of manipulation, one of `KINDS`.
        poses: x, z [m] and direction [rad] of growing u at the start and at the end, positive from
            x towards -z, at `MOMENTS` moments, shape (2, MOMENTS, 3).
    """

    kind: str
    poses: FloatArray


def draw(
    kind: str, workspace: Workspace, length: float, rng: np.random.Generator
) -> ManipulationCandidate:
    """A candidate of a kind at random."""
    low, high = _ranges(workspace)
    poses = low + (high - low) * rng.random((2, MOMENTS, 3))
    return possible(ManipulationCandidate(kind, poses), workspace, length)


def varied(
    candidate: ManipulationCandidate, spread: float, workspace: Workspace, length: float,
    rng: np.random.Generator,
) -> ManipulationCandidate:  # fmt: skip
    """A random variation of a candidate."""
    low, high = _ranges(workspace)
    step = spread * (high - low) * rng.normal(size=candidate.poses.shape)
    return possible(replace(candidate, poses=candidate.poses + step), workspace, length)


def _ranges(workspace: Workspace) -> tuple[FloatArray, FloatArray]:
    low = np.array([workspace.x[0], workspace.z[0], -TURN])
    high = np.array([workspace.x[1], workspace.z[1], TURN])
    return low, high


def possible(
    candidate: ManipulationCandidate, workspace: Workspace, length: float
) -> ManipulationCandidate:
    """The nearest candidate within the bounds that is slow enough and within reach."""
    low, high = _ranges(workspace)
    poses = np.clip(candidate.poses, low, high)
    for k in range(MOMENTS):
        if k:
            a, b = MOVES[k - 1]
            time = (b - a) * workspace.duration / PEAK
            poses[:, k] = poses[:, k - 1] + _slow(poses[:, k] - poses[:, k - 1], time, workspace)
        if candidate.kind != "free":
            start, end = poses[:, k]
            _apart(start, end, length)
            end[:2] = np.clip(end[:2], low[:2], high[:2])
    return replace(candidate, poses=poses)


def _slow(steps: FloatArray, time: float, workspace: Workspace) -> FloatArray:
    """Steps (2, 3) of both ends, no longer than their speeds allow within a time [s]."""
    far = np.column_stack([np.hypot(steps[:, 0], steps[:, 1])] * 2 + [np.abs(steps[:, 2])])
    most = time * np.array([workspace.speed, workspace.speed, workspace.turn])
    return np.asarray(steps * np.minimum(1.0, most / np.maximum(far, 1e-12)))


def _apart(start: FloatArray, end: FloatArray, length: float) -> None:
    """Bring the end to a distance that the DLO can span without lying on itself."""
    way = end[:2] - start[:2]
    far = float(np.hypot(way[0], way[1]))
    if far < 1e-9:
        way, far = np.array([1.0, 0.0]), 1.0
    end[:2] = start[:2] + way * (np.clip(far, CLOSEST * length, TAUT * length) / far)


def waypoints(track: FloatArray, duration: float) -> FloatArray:
    """Time, x, z, angle of a gentle motion through the places of an end, shape (m, 4)."""
    rows = [np.array([[0.0, *track[0]]])]
    for (a, b), (here, there) in zip(MOVES, pairwise(track), strict=True):
        count = max(int(np.ceil((b - a) * duration / SPACING)), 4)
        share = np.arange(count + 1) / count
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        times = (a + share * (b - a)) * duration
        rows.append(np.column_stack([times, here + smooth[:, None] * (there - here)]))
    return np.concatenate(rows)


def imposed(
    candidate: ManipulationCandidate, duration: float, control_points: int
) -> dict[str, FloatArray]:
    """`waypoints` of each name of dlo/command."""
    start, end = (waypoints(track, duration) for track in candidate.poses)
    if candidate.kind == "free":
        return {START: start}
    name = END if candidate.kind == "clamps" else f"{CONTROL_POINT}{control_points}"
    return {START: start, name: end}


def rough_shape(candidate: ManipulationCandidate, length: float) -> FloatArray:
    """A curve x, z [m] of about the DLO's length to settle from, shape (m, 2)."""
    start, end = candidate.poses[:, 0]
    if candidate.kind == "free":
        return _from_start(start, length)
    return hanging(start[:2], end[:2], length)


def _from_start(pose: FloatArray, length: float) -> FloatArray:
    """From the clamp, bending down a little."""
    down = np.pi / 2 + 2.0 * np.pi * np.round((pose[2] - np.pi / 2) / (2.0 * np.pi))
    s = np.linspace(0.0, 1.0, 25)
    angle = pose[2] + 0.4 * s * (down - pose[2])
    along = np.column_stack([np.cos(angle), -np.sin(angle)])
    way = cumulative_trapezoid(along, length * s, axis=0, initial=0.0)
    return np.asarray(pose[:2] + way)


def hanging(a: FloatArray, b: FloatArray, length: float) -> FloatArray:
    """A parabola of a given length that hangs between two points x, z [m], shape (m, 2)."""
    t = np.linspace(0.0, 1.0, 41)

    def curve(sag: float) -> FloatArray:
        line = a + t[:, None] * (b - a)
        line[:, 1] -= 4.0 * sag * t * (1.0 - t)
        return line

    def excess(sag: float) -> float:
        return float(np.linalg.norm(np.diff(curve(sag), axis=0), axis=1).sum()) - length

    # Where the points are too far apart there is none: a straight line.
    return curve(brentq(excess, 0.0, length) if excess(0.0) < 0.0 else 0.0)


def laid(curve: FloatArray, basis: SplineBasis) -> FloatArray:
    """Control points (n, 4) of a DLO that is spread along a rough curve x, z [m]."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    if not s[-1] > 0.0:
        raise InputError("the curve that the DLO is laid along has no length")
    u = np.linspace(0.0, basis.length, 6 * basis.control_points)
    at = u / basis.length * s[-1]
    shape = np.zeros((basis.control_points, 4))
    points = np.column_stack([np.interp(at, s, curve[:, c]) for c in range(2)])
    shape[:, [0, 2]] = basis.fit(u, points)
    return shape


def plan_of(
    candidate: ManipulationCandidate, name: str, workspace: Workspace, settings: Settings
) -> Plan:
    """A candidate as a plan.

    Raises:
        CommandError: the command is malformed.
    """
    rod = settings.rod
    tracks = imposed(candidate, workspace.duration, rod.control_points)
    curve = rough_shape(candidate, rod.length)
    return plan_along(name, tracks, curve, workspace.duration, settings)


def plan_along(
    name: str, tracks: Mapping[str, FloatArray], curve: FloatArray, duration: float,
    settings: Settings,
) -> Plan:  # fmt: skip
    """A plan whose ends are led along tracks.

    Args:
        tracks: time [s], x, z [m] and angle [rad] of each name of dlo/command, at the same times,
            shape (m, 4).
        curve: rough curve x, z [m] from which the DLO settles.
        duration: of the recording [s].

    Raises:
        CommandError: the command is malformed.
    """
    rod = settings.rod
    times = next(iter(tracks.values()))[:, 0]
    positions = np.zeros((len(times), len(tracks), 3))
    rotations = np.zeros((len(times), len(tracks), 4))
    for k, rows in enumerate(tracks.values()):
        positions[:, k, 0], positions[:, k, 2] = rows[:, 1], rows[:, 2]
        rotations[:, k, 1], rotations[:, k, 3] = np.sin(rows[:, 3] / 2), np.cos(rows[:, 3] / 2)
    command = Command(
        0, tuple(tracks), times, positions, rotations, np.full_like(positions, np.nan),
        rod.control_points, settings.frame_id,
    )  # fmt: skip
    shape = laid(curve, SplineBasis(rod.control_points, rod.length))
    return Plan(name, command, shape, duration)


class Judged(Protocol):
    """The expected result of a plan."""

    @property
    def plan(self) -> Plan:
        """The plan."""

    @property
    def gain(self) -> float:
        """What the plan is worth; the larger, the better."""

    @property
    def reliable(self) -> bool:
        """Whether the manipulation stays away from a snap-through."""


Result = TypeVar("Result", bound=Judged)


def search(
    settings: Settings,
    workspace: Workspace,
    judge: Callable[[Plan, int | None], Result],
    *,
    budget: int = 120,
    seed: int = 0,
    finalists: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[ManipulationCandidate, Result]:
    """The manipulation with the largest gain, and its expected result.

    Args:
        settings: settings of the rod.
        workspace: limits of the manipulation.
        judge: function that gives the expected result of a plan, with the knot spans of its
            simulation, None in the end: as simulation.tolerance asks.
        budget: candidates that are simulated.
        seed: seed of the random numbers; the same seed gives the same manipulation.
        finalists: number of the best candidates that are simulated finely, to take the best of.
        progress: function that is called with the fraction of the budget that is used.

    Raises:
        SimulationError: no candidate can be simulated.
    """
    rng = np.random.default_rng(seed)
    length = settings.rod.length
    spans = 2 * SplineBasis(settings.rod.control_points, length).spans
    found: list[tuple[float, ManipulationCandidate]] = []
    reason = "their DLO is about to snap through"
    for tried in range(budget):
        if tried < budget // 3 or not found:
            candidate = draw(KINDS[tried % len(KINDS)], workspace, length, rng)
        else:
            found.sort(key=lambda pair: -pair[0])
            parent = found[int(rng.integers(min(ELITE, len(found))))][1]
            used = (tried - budget // 3) / max(budget - budget // 3, 1)
            spread = FIRST_SPREAD * (LAST_SPREAD / FIRST_SPREAD) ** used
            candidate = varied(parent, spread, workspace, length, rng)
        progress((tried + 1) / budget)
        plan = replace(plan_of(candidate, "search", workspace, settings), rate=SEARCH_RATE)
        try:
            seen = judge(plan, spans)
        except (SimulationError, InputError) as err:
            reason = str(err)
            continue
        if seen.reliable:
            found.append((seen.gain, candidate))
    final: list[tuple[ManipulationCandidate, Result]] = []
    for _, candidate in sorted(found, key=lambda pair: -pair[0]):
        if sum(seen.reliable for _, seen in final) == finalists:
            break
        try:
            seen = judge(plan_of(candidate, "searched", workspace, settings), None)
        except (SimulationError, InputError) as err:
            reason = str(err)
            continue
        final.append((candidate, seen))
    if not final:
        raise SimulationError(
            f"none of {budget} manipulations within the workspace can be used ({reason}); try "
            "more of them (--tries), or widen the workspace (--bounds)"
        )
    return max(final, key=lambda pair: (pair[1].reliable, pair[1].gain))
