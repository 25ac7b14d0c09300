# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The starting values at which every effect of the registry is tried on recordings.

Each effect names its own (`Effect.starts`): an effect whose derivative at its neutral value is
useful starts there, at several places where it has a place; others (yield, friction) start with a
few plausible sizes. Pegs are found by `contact_search`.
"""

from __future__ import annotations

from collections.abc import Sequence

from dlo_ros.effects import Scene, Start, effects


def starts(scene: Scene, present: Sequence[str] = ()) -> list[Start]:
    """Starting values of all effects that the model does not contain yet."""
    result: list[Start] = []
    for name, effect in effects().items():
        if name not in present:
            result += effect.starts(scene)
    return result
