# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What recordings look like, and from where every effect of the registry is looked for in them.

Each effect says itself where (`Effect.starts`): one with a useful derivative where it does nothing
starts there, at several places where it has one; others (yield, friction) with a few plausible
sizes. Pegs are looked for in `contact`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, START
from dlo_ros.effects import Quantity, Scene, Start, effects, quantities
from dlo_ros.parameters import Settings
from dlo_ros.rod.tangents import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

DAMPING = MATERIAL[2:]  # the parameters of `Settings.damping`


def scene(settings: Settings, names: Sequence[str], predicted: Sequence[FloatArray]) -> Scene:
    """Look at recordings.

    Args:
        names: everything that any command imposes.
        predicted: control points of each recording [m], shape (F, n, 3 or more).
    """
    n, length = settings.rod.control_points, settings.rod.length
    basis = SplineBasis(n, length)
    u = np.linspace(0.02, 0.98, 50) * length
    largest = []
    for shapes in predicted:
        slope = np.einsum("qn,fnc->fqc", basis.matrix(u, 1), shapes[..., :3])
        bend = np.einsum("qn,fnc->fqc", basis.matrix(u, 2), shapes[..., :3])
        speed = np.linalg.norm(slope, axis=2)
        largest.append((np.linalg.norm(np.cross(slope, bend), axis=2) / speed**3).max(axis=1))
    ends = ((START, 1, 2), (END, n, n - 1))  # with their outer and inner control point

    def imposed(*points: int) -> tuple[str, ...]:
        return tuple(
            end for end, *own in ends
            if end in names or any(f"{CONTROL_POINT}{own[k]}" in names for k in points)
        )  # fmt: skip

    return Scene(
        rope=settings.scale,
        clamps=imposed(1),
        held=imposed(0, 1),
        curvature=float(np.percentile(np.concatenate(largest), 90.0)),
        known=tuple(n for n in DAMPING if getattr(settings.damping, f"{n}_std") > 0.0),
    )


def starts(scene: Scene, present: Sequence[str] = ()) -> list[Start]:
    """All beginnings, of effects that the model does not contain yet."""
    result: list[Start] = []
    for name, effect in effects().items():
        if name not in present:
            result += effect.starts(scene)
    return result


def moved(start: Start, amounts: Sequence[float]) -> Start:
    """A start with the screened numbers changed by amounts, as a fit sees them.

    Args:
        amounts: in the order of the block's keys; of the logarithm where that is fitted.
    """
    left = list(amounts)
    return _changed(start, lambda q, v: q.restored(q.transformed(v) + left.pop(0)))


def shrunk(start: Start, share: float) -> Start:
    """A start with a share of what its screened numbers differ by from neutral."""

    def part(q: Quantity, value: float) -> float:
        neutral = q.transformed(q.neutral)
        return q.restored(neutral + share * (q.transformed(value) - neutral))

    return _changed(start, part)


def within_range(start: Start, amounts: FloatArray) -> FloatArray:
    """Amounts of `moved` with which every number stays in its range, shape (P,)."""
    keys = quantities(start.effect)
    lower, upper = [], []
    for key in start.screened:
        q = keys[key]
        for value in np.atleast_1d(np.asarray(start.block[key])):
            here = q.transformed(float(value))
            lower.append(q.transformed(q.lower) - here)
            upper.append(q.transformed(q.upper) - here)
    return np.asarray(np.clip(amounts, lower, upper))


def _changed(start: Start, change: Callable[[Quantity, float], float]) -> Start:
    """A start of which every screened number is changed."""
    block, keys = dict(start.block), quantities(start.effect)
    for key in start.screened:
        value, q = block[key], keys[key]
        if isinstance(value, tuple):
            block[key] = tuple(change(q, v) for v in value)
        else:
            block[key] = change(q, value)
    return replace(start, block=block)
