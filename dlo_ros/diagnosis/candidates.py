# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From where every effect of the registry is looked for.

An effect with a useful derivative where it does nothing starts there, at several places where it
has one. Others (yield, friction) start with a few plausible sizes. Pegs are looked for in
`contact`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.model import Block
from dlo_ros.effects import effects
from dlo_ros.effects import quantities as quantities_of
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

PLACES = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
"""Of the length."""
PATTERNS = (3, 4, 5)
"""Numbers of values of a curvature at rest that varies along the DLO."""


@dataclass(frozen=True)
class Start:
    """One beginning of a search.

    Args:
        effect: its name.
        block: values of all keys that are set.
        screened: keys in which the effect is linear at first.
        fitted: keys that are fitted.
        neutral: whether the model is still that without the effect.
        form: tells variants of one effect with different open parameters apart.
        own: change of the other open parameters that belongs to it, as the fit sees them; empty:
            none.
    """

    effect: str
    block: Block
    screened: tuple[str, ...]
    fitted: tuple[str, ...]
    neutral: bool = True
    form: str = ""
    own: tuple[float, ...] = ()


@dataclass(frozen=True)
class Scene:
    """What the recordings look like to a model.

    Args:
        settings: of the model.
        clamps: ends whose direction is imposed in some recording.
        curvature: 90th percentile of the largest curvature of each frame [1/m].
    """

    settings: Settings
    clamps: tuple[str, ...]
    curvature: float


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
    clamps = [
        end
        for end, second in (("start", 2), ("end", n - 1))
        if end in names or f"control_point_{second}" in names
    ]
    return Scene(settings, tuple(clamps), float(np.percentile(np.concatenate(largest), 90.0)))


def starts(scene: Scene, present: Sequence[str] = ()) -> list[Start]:
    """All beginnings, of effects that the model does not contain yet."""
    result: list[Start] = []
    for name in effects():
        if name not in present:
            result += SPECIAL.get(name, _plain)(name, scene)
    return result


def _plain(name: str, scene: Scene) -> list[Start]:
    """An effect that is linear at first in all its numbers."""
    keys = quantities_of(name)
    block = {key: q.neutral for key, q in keys.items()}
    return [Start(name, block, tuple(keys), tuple(keys))]


def _curvature(name: str, scene: Scene) -> list[Start]:
    found = [Start(name, {"curvature": 0.0}, ("curvature",), ("curvature",), form="even")]
    for count in PATTERNS:
        key = ("curvature",)
        found.append(Start(name, {"curvature": (0.0,) * count}, key, key, form=f"along {count}"))
    for place in PLACES[:-1]:
        block = {"kink": 0.0, "position": place * scene.settings.rod.length}
        found.append(Start(name, block, ("kink",), ("kink", "position"), form="kink"))
    return found


def _clamps(name: str, scene: Scene) -> list[Start]:
    found = [Start(name, {end: 0.0}, (end,), (end,), form=end) for end in scene.clamps]
    if len(found) == 2:
        both = {"start": 0.0, "end": 0.0}
        found.append(Start(name, both, tuple(both), tuple(both), form="both"))
    return found


def _mass(name: str, scene: Scene) -> list[Start]:
    rod = scene.settings.rod
    keys = ("mass", "position")
    found = [Start(name, {"mass": 0.0, "position": p * rod.length}, keys[:1], keys) for p in PLACES]
    # One that outweighs the rope goes with an E that no linear test finds from here.
    heavy = {"mass": rod.linear_density * rod.length, "position": rod.length}
    return [*found, Start(name, heavy, (), keys, neutral=False, form="heavy")]


def _segment(name: str, scene: Scene) -> list[Start]:
    length = scene.settings.rod.length
    keys = ("centre", "extent", "ratio")
    return [
        Start(name, {"centre": place * length, "extent": 0.2 * length, "ratio": 1.0}, ("ratio",),
              keys)
        for place in PLACES[:-1]
    ]  # fmt: skip


def _nonlinear(name: str, scene: Scene) -> list[Start]:
    key = ("half_curvature",)
    return [
        Start(name, {key[0]: factor * scene.curvature}, key, key, neutral=False)
        for factor in (1.0, 4.0)
    ]


def _plastic(name: str, scene: Scene) -> list[Start]:
    keys = ("yield_curvature", "hardening")
    return [
        Start(name, {keys[0]: share * scene.curvature, keys[1]: 0.35}, keys, keys, neutral=False)
        for share in (0.25, 0.5, 0.85)
    ]


def _friction(name: str, scene: Scene) -> list[Start]:
    weight = scene.settings.rod.linear_density * 9.81
    return [
        Start(name, {"force": share * weight}, ("force",), ("force",), neutral=False)
        for share in (0.01, 0.1)
    ]


def _damping(key: str) -> Callable[[str, Scene], list[Start]]:
    """Damping that is a guess is fitted anyway; only that which is known can be exceeded."""

    def found(name: str, scene: Scene) -> list[Start]:
        known = getattr(scene.settings.damping, f"{key}_std") > 0.0
        return _plain(name, scene) if known else []

    return found


def _forces(name: str, scene: Scene) -> list[Start]:
    keys = ("x", "z")
    return [Start(name, dict.fromkeys(keys, 0.0), keys, keys)]


def _nowhere(name: str, scene: Scene) -> list[Start]:
    """See `contact`."""
    return []


SPECIAL: dict[str, Callable[[str, Scene], list[Start]]] = {
    "intrinsic_curvature": _curvature,
    "clamp_angle": _clamps,
    "point_mass": _mass,
    "stiff_segment": _segment,
    "nonlinear_stiffness": _nonlinear,
    "plasticity": _plastic,
    "surface_friction": _friction,
    "air_drag": _damping("air_drag"),
    "internal_damping": _damping("relaxation_time"),
    "constant_force": _forces,
    "obstacle": _nowhere,
}
"""Effects that need more than their neutral values; all others start there."""


def moved(start: Start, amounts: Sequence[float]) -> Start:
    """A start with the screened numbers changed by amounts, in the order of the block's keys."""
    block = dict(start.block)
    left = list(amounts)
    for key in start.screened:
        value = block[key]
        if isinstance(value, tuple):
            block[key] = tuple(v + left.pop(0) for v in value)
        else:
            block[key] = value + left.pop(0)
    return replace(start, block=block)
