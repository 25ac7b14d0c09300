# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Time that the stamps of a recording lack where it lost pictures, see `lost_pictures`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class Gap:
    """An interval between two pictures that took longer than their stamps say.

    Args:
        before, after: their stamps [ns].
        lost: number of pictures between them.
    """

    before: int
    after: int
    lost: int

    @property
    def missing(self) -> int:
        """Time that the stamps after it lack [ns]."""
        return self.lost * (self.after - self.before)


def true_stamps(stamps: Stamps, gaps: Sequence[Gap]) -> Stamps:
    """Instants of stated stamps [ns], shape (k,); within a gap time goes on evenly.

    Args:
        stamps: [ns], shape (k,).
        gaps: by growing stamp.
    """
    if not gaps:
        return stamps
    stated, true = _course(gaps)
    return stamps + _shift(stamps - stated[0], stated - stated[0], true - stated)


def stated_stamps(stamps: Stamps, gaps: Sequence[Gap]) -> Stamps:
    """The inverse of `true_stamps`."""
    if not gaps:
        return stamps
    stated, true = _course(gaps)
    return stamps - _shift(stamps - true[0], true - true[0], true - stated)


def _course(gaps: Sequence[Gap]) -> tuple[Stamps, Stamps]:
    """Stated stamps and instants [ns] at both ends of each gap, shape (2 G,)."""
    stated = np.array([t for gap in gaps for t in (gap.before, gap.after)], dtype=np.int64)
    late = np.repeat(np.cumsum([gap.missing for gap in gaps]), 2)
    late[::2] -= [gap.missing for gap in gaps]
    return stated, stated + late


def _shift(at: Stamps, ends: Stamps, late: Stamps) -> Stamps:
    return np.rint(np.interp(at, ends, late)).astype(np.int64)
