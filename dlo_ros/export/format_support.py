# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that a format cannot represent, by what each effect changes; all are listed by name."""

from __future__ import annotations

import copy
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from dlo_ros.effects import Body, Effect, build
from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.rod_settings import STANDARD_GRAVITY
from dlo_ros.spline import SplineBasis


def body_fields(names: str) -> frozenset[str]:
    """Fields of `Body` by their names, with spaces between."""
    found = frozenset(names.split())
    assert found <= {field.name for field in fields(Body)}
    return found


CHAIN = body_fields(
    "bend bend_rest line_density relaxation_time gravity masses kinks grip_compliance lengthening"
)
"""Fields of `Body` that every chain of links with elastic joints has."""
SECTION = "section_angle"  # field of a section with two bending stiffnesses
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # that a camera may move


@dataclass(frozen=True)
class Unsupported:
    """The parts of a model that a format leaves out.

    Args:
        settings: the model without the effects that are left out.
        lines: one line for each thing that is left out or approximated, each with its name.
    """

    settings: Settings
    lines: tuple[str, ...]


def unsupported(settings: Settings, supported: frozenset[str]) -> Unsupported:
    """The parts of a model that a format cannot represent.

    Args:
        settings: the parameter file.
        supported: fields of `Body` that the format can express; others count as unsupported, so
            that no new effect is lost silently.
    """
    kept, lines = dict(settings.effects), []
    for effect in build(settings.effects):
        missing = sorted(_changed(settings, effect) - supported)
        seen = _measures(effect)
        if not missing and not seen:
            continue
        why = (
            "a chain of links has no such thing" if missing else "it is the camera's or the clock's"
        )
        called = f"{EFFECTS_PREFIX}{effect.name} ({effect.called()})"
        lines.append(f"{called} is left out: {why}")
        del kept[effect.name]
    damping = settings.damping
    if damping.air_drag > 0.0 and "air_drag" not in supported:
        lines.append(f"damping.air_drag, {damping.air_drag:g} N s/m^2, is left out")
    stretch = _stretch(settings)
    lines.append(f"stretch: links are rigid; hanging straight the DLO is {stretch:.2g} % longer")
    return Unsupported(replace(settings, effects=kept), tuple(lines))


def _changed(settings: Settings, effect: Effect) -> set[str]:
    """Fields of the rod that an effect changes."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    before = settings.with_effects({}).body(basis)
    after = copy.deepcopy(before)
    effect.shape_body(after)
    # Two bending stiffnesses are a flat section, which is no less than where its axes are.
    flat = {SECTION} if not np.array_equal(*after.bend.T) else set()
    return flat | {
        field.name
        for field in fields(Body)
        if field.name != "basis"
        and not _same(getattr(before, field.name), getattr(after, field.name))
    }


def _same(a: Any, b: Any) -> bool:
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else bool(a == b)


def _measures(effect: Effect) -> bool:
    """Whether it changes how or when the DLO is seen."""
    return effect.later() != 0.0 or not np.array_equal(effect.measured(POINTS), POINTS)


def _stretch(settings: Settings) -> float:
    """Relative lengthening of a DLO that hangs from one end, by its own weight [%]."""
    rod = settings.rod
    weight = rod.linear_density * STANDARD_GRAVITY * rod.length
    return 100.0 * 0.5 * weight / (rod.young_modulus * rod.area)
