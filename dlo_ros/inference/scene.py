# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What recordings look like: what is held, how far they bend."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, START
from dlo_ros.effects import Scene
from dlo_ros.effects.start import Reach
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import TRACKER_ERROR
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

DAMPING = MATERIAL[2:]
"""The parameters of `Settings.damping`."""

STRAIGHT = 1e-3
"""Turn along a DLO [rad] that is none: causes whose size is a curvature start at some share of the
one that occurs, and of a DLO that hangs straight that must not be zero."""


def imposed_names(recordings: Iterable[Manipulation]) -> list[str]:
    """Everything that any command of some recordings imposes."""
    return [name for recording in recordings for c in recording.commands for name in c.names]


def free_ends(manipulation: Manipulation, control_points: int) -> tuple[str, ...]:
    """The ends of the DLO that nothing holds."""
    held = _imposed(imposed_names([manipulation]), control_points, (0, 1))
    return tuple(end for end in (START, END) if end not in held)


def _imposed(names: Sequence[str], n: int, points: Sequence[int]) -> tuple[str, ...]:
    """Ends that are imposed by themselves, or by control points.

    Args:
        names: everything that commands impose.
        n: number of control points.
        points: which of an end's control points will do: 0 the outer, 1 the inner one.
    """
    ends = ((START, 1, 2), (END, n, n - 1))
    return tuple(
        end for end, *own in ends
        if end in names or any(f"{CONTROL_POINT}{own[k]}" in names for k in points)
    )  # fmt: skip


def scene_of(settings: Settings, recordings: Sequence[Recording]) -> Scene:
    """Look at recordings as they were observed."""
    names = imposed_names(r.manipulation for r in recordings)
    view = scene(settings, names, [r.observed for r in recordings])
    n = settings.rod.control_points
    held = [
        r.observed[:, 0 if end == START else -1, :3]
        for r in recordings
        for end in _imposed(imposed_names([r.manipulation]), n, (0, 1))
    ]
    return replace(view, held_reach=_reach(np.concatenate(held))) if held else view


def scene(settings: Settings, names: Sequence[str], predicted: Sequence[FloatArray]) -> Scene:
    """Look at recordings.

    Args:
        names: everything that any command imposes.
        predicted: control points of each recording [m], shape (F, n, 3 or more).
    """
    n, length = settings.rod.control_points, settings.rod.length
    basis = SplineBasis(n, length)
    u = np.linspace(0.02, 0.98, 50) * length
    largest, points = [], []
    for shapes in predicted:
        place, slope, bend = (basis.matrix(u, order) @ shapes[..., :3] for order in range(3))
        points.append(place.reshape(-1, 3))
        speed = np.linalg.norm(slope, axis=2)
        largest.append((np.linalg.norm(np.cross(slope, bend), axis=2) / speed**3).max(axis=1))
    reached = np.concatenate(points)
    return Scene(
        rope=settings.scale,
        clamps=_imposed(names, n, (1,)),
        held=_imposed(names, n, (0, 1)),
        curvature=max(float(np.percentile(np.concatenate(largest), 90.0)), STRAIGHT / length),
        reach=_reach(reached),
        spatial=bool(reached[:, 1].std() > TRACKER_ERROR * length),
        known=tuple(n for n in DAMPING if getattr(settings.damping, f"{n}_std") > 0.0),
        in_hands=settings.command.source != "topic",
    )


def _reach(points: FloatArray) -> Reach:
    """Smallest and largest x, smallest z of points [m], shape (M, 3)."""
    return float(points[:, 0].min()), float(points[:, 0].max()), float(points[:, 2].min())
