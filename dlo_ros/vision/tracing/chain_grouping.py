# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Joins chains into whole DLOs where neither their number nor their lengths are known."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_map import RidgeMap
from dlo_ros.vision.tracing.chain_linking import Linker, bridge
from dlo_ros.vision.tracing.chain_ordering import Path
from dlo_ros.vision.tracing.metric_lengths import PlaneGrid
from dlo_ros.vision.tracing.ridge_tracing import Chain

LINK_LIMIT = 3.0  # a dearer link is none
FURTHEST = 8.0  # [widths] the longest gap that is bridged without knowing the length


def join(chains: list[Chain], bars: RidgeMap) -> list[Path]:
    """Pair the ends of chains, the cheapest links first, and follow them.

    At a crossing four ends meet; straight on costs least, and what is left is paired then.

    Returns:
        Courses in pixels of the bar map, the longest first.
    """
    if not chains:
        return []
    plane = PlaneGrid.of_pixels(bars)
    linker = Linker(chains, bars, plane)
    ends = linker.ends
    candidates = [
        (link.cost, k, link.end)
        for k in range(len(ends))
        for link in linker.from_end(k, LINK_LIMIT)
        if link.length < FURTHEST * bars.width
    ]
    candidates.sort()
    partner: dict[int, int] = {}
    group = list(range(len(chains)))

    def root(c: int) -> int:
        while group[c] != c:
            c = group[c]
        return c

    for _, k, j in candidates:
        if k in partner or j in partner or root(k // 2) == root(j // 2):
            continue
        partner[k], partner[j] = j, k
        group[root(k // 2)] = root(j // 2)

    paths = []
    done: set[int] = set()
    for k in range(len(ends)):
        if k in partner or k // 2 in done:
            continue
        states = [k]
        while (exit_ := states[-1] ^ 1) in partner:
            states.append(partner[exit_])
        done.update(s // 2 for s in states)
        paths.append(_course(states, chains, ends.positions, ends.directions))
    paths.sort(key=lambda path: -path.length)
    return paths


def _course(
    states: list[int], chains: list[Chain], positions: FloatArray, directions: FloatArray
) -> Path:
    pieces, seen = [], []
    for index, state in enumerate(states):
        points = chains[state // 2].points
        pieces.append(points if state % 2 == 0 else points[::-1])
        seen.append(np.ones(len(points), dtype=np.bool_))
        if index + 1 < len(states):
            k, j = state ^ 1, states[index + 1]
            gap = bridge(positions[k], directions[k], positions[j], -directions[j])[1:-1]
            pieces.append(gap)
            seen.append(np.zeros(len(gap), dtype=np.bool_))
    points = np.vstack(pieces)
    members = [chains[s // 2] for s in states]
    weights = np.array([len(c.points) for c in members], dtype=np.float64)
    return Path(
        points,
        np.concatenate(seen),
        0.0,
        float(np.sum(np.hypot(*np.diff(points, axis=0).T))),
        float(np.average([c.strength for c in members], weights=weights)),
        np.average([c.colour for c in members], axis=0, weights=weights),
    )
