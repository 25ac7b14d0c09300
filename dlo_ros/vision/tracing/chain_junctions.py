# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Cuts chains where another strand joins or leaves them.

Where two strands of one look cross at a small angle, the ridges of both are one for some widths,
and tracing may come out of it on the wrong strand. The ends of the chains that are left over there
say where that may be: a chain is cut beside each of them, and `chain_linking` decides anew how the
pieces go on.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from dlo_ros.vision.tracing.ridge_tracing import Chain, chain_end

JOINING = 3.0  # [widths] a shorter chain is no strand
ALIKE = 0.5  # share of a chain's contrast that a strand which joins it has at least
BESIDE = 1.5  # [widths] from a chain to the end of a strand that joins it
INNER = 2.0  # [widths] from a chain's own ends within which it is not cut


def cut_at_junctions(chains: list[Chain], width: float) -> list[Chain]:
    """Chains without those points at which strands join them.

    Args:
        chains: chains of one picture.
        width: width of the DLO in the chains' pixels.
    """
    if not chains:
        return chains
    cuts: list[list[int]] = [[] for _ in chains]
    owner = np.repeat(np.arange(len(chains)), [len(c.points) for c in chains])
    place = np.concatenate([np.arange(len(c.points)) for c in chains])
    tree = cKDTree(np.vstack([c.points for c in chains]))
    margin = INNER * width
    for k, chain in enumerate(chains):
        if len(chain.points) < JOINING * width:
            continue
        for last in (False, True):
            end = chain_end(chain, last, width)
            near = np.array(tree.query_ball_point(end.position, BESIDE * width), dtype=np.int64)
            for other in np.unique(owner[near]):
                if other == k or chain.strength < ALIKE * chains[other].strength:
                    continue
                own = near[owner[near] == other]
                distance = np.hypot(*(tree.data[own] - end.position).T)
                at = int(place[own[np.argmin(distance)]])
                if margin < at < len(chains[other].points) - margin:
                    cuts[other].append(at)
    result: list[Chain] = []
    for chain, inner in zip(chains, cuts, strict=True):
        places = [0, *sorted(inner), len(chain.points)]
        parts = [chain.part(a, b) for a, b in pairwise(places)]
        result.extend(part for part in parts if len(part.points) >= max(4, width))
    return result
