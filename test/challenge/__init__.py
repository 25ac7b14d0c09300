# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Challenges: recordings with a hidden cause, drawn with a seed, for tools that must find it.

`draw` chooses rope, manipulations, effects and their strength; `Challenge.write` makes the bags and
the parameter file, by the discrete rod of `dlo_ros.synthesis`. `python -m challenge` (from `test/`)
writes one.
"""

from challenge.generate import KINDS, Challenge, draw

__all__ = ["KINDS", "Challenge", "draw"]
