# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings simulated with knot spans that resolve how far an effect extends along the DLO.

Few knot spans do for a DLO that is even. A stretch shorter than one of them is smeared over two,
and what is fitted as its extent and ratio then does not hold in a simulation with more.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

from dlo_ros.effects import quantities
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import value_of
from dlo_ros.parameters import Settings

RESOLVED = 4
"""Knot spans over the shortest extent: its ends, which reach a span to either side, are apart."""


def with_resolved_extents(
    recordings: Sequence[Recording], settings: Settings, told: Collection[str]
) -> Sequence[Recording]:
    """The recordings with enough knot spans for those effects of a model whose numbers are told.

    What stands at a point of the board, such as a peg, has no extent along the DLO.

    Args:
        settings: settings of the model.
        told: names of the effects.
    """
    extents = [
        value_of(settings, f"effects.{effect}.{q.name}")
        for effect, block in settings.effects.items()
        if effect in told
        if not any(q.role == "point" for q in quantities(effect).values())
        for q in quantities(effect).values()
        if q.role == "extent" and q.unit == "m" and q.name in block
    ]
    shortest = min((e for e in extents if e > 0.0), default=math.inf)
    least = math.ceil(RESOLVED * settings.rod.length / shortest)
    return tuple(
        r if r.spans is None else replace(r, spans=max(r.spans, least)) for r in recordings
    )
