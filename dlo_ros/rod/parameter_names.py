# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Names of effects' numbers, `effects.NAME.KEY` or `effects.NAME.KEY[i]`, and their meaning."""

from __future__ import annotations

import re
from functools import lru_cache

from dlo_ros.effects import effects, quantities
from dlo_ros.effects.base import MEASUREMENT, Part
from dlo_ros.rod_settings import EFFECTS_PREFIX, RodSettings


@lru_cache(maxsize=1024)
def parsed(name: str) -> tuple[str, str, int | None]:
    """Effect, key and index of a known name; no index where the key has one number."""
    found = re.fullmatch(r"effects\.(\w+)\.(\w+)(?:\[(\d+)\])?", name)
    assert found is not None  # it is among the known names
    effect, key, index = found.groups()
    return effect, key, None if index is None else int(index)


def acts_on(name: str, part: Part) -> bool:
    """Whether a parameter is a number of an effect that acts on a part of the experiment."""
    return name.startswith(EFFECTS_PREFIX) and part in effects()[parsed(name)[0]].acts_on


def acts_on_measurement(name: str) -> bool:
    """Whether a parameter is a number of an effect that acts on nothing but the measurement."""
    return name.startswith(EFFECTS_PREFIX) and effects()[parsed(name)[0]].acts_on == {MEASUREMENT}


def sideways(settings: RodSettings, name: str) -> bool:
    """Whether a parameter (see `sensitivity_parameters`) acts out of the plane y = 0."""
    if not name.startswith(EFFECTS_PREFIX):
        return False
    effect, key, index = parsed(name)
    value = settings.effects[effect][key]
    count = len(value) if isinstance(value, tuple) else 1
    return quantities(effect)[key].sideways(index, count)
