# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Why pictures, or lists of points, show no credible DLO: the reasons that come most often."""

from __future__ import annotations

import re
from collections import Counter


class Refusals:
    """Reasons, alike where they differ in their numbers alone, such as a length."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._examples: dict[str, str] = {}

    def add(self, reason: str) -> None:
        """Count one."""
        kind = re.sub(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?", "#", reason)
        self._counts[kind] += 1
        self._examples.setdefault(kind, reason)

    @property
    def total(self) -> int:
        """Number of all."""
        return sum(self._counts.values())

    def commonest(self, most: int) -> list[tuple[str, int]]:
        """The first of each of the commonest kinds, and how many are alike."""
        return [(self._examples[kind], n) for kind, n in self._counts.most_common(most)]

    def main(self, otherwise: str = "") -> str:
        """The first of the commonest kind; `otherwise` where there is none."""
        return next((reason for reason, _ in self.commonest(1)), otherwise)
