# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A recording whose grips are led along a smooth path through the points of its commands.

Shapes hardly tell the difference, but forces do: at each corner of straight pieces what is held is
accelerated in an instant, and waves run along the DLO's axis that no sensor sees.
"""

from __future__ import annotations

from dataclasses import replace

from dlo_ros.inference.forecast import Manipulation
from dlo_ros.smooth_command import smoothed


def smoothly_led(recording: Manipulation, length: float) -> Manipulation:
    """The recording with commands that are smooth but for their corners, see `smoothed`.

    Args:
        length: length of the DLO [m].
    """
    commands = tuple(smoothed(c, length) for c in recording.commands)
    return replace(recording, commands=commands)
