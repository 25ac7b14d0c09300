# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Chains are cut where strands join them, and nowhere else."""

import numpy as np

from dlo_ros.vision.tracing.chain_junctions import cut_at_junctions
from dlo_ros.vision.tracing.ridge_tracing import Chain

WIDTH = 5.0
BLACK = np.zeros(3)


def chain(first, last, strength=200.0):
    first, last = np.array(first, dtype=float), np.array(last, dtype=float)
    count = int(np.hypot(*(last - first))) + 1
    return Chain(first + np.linspace(0.0, 1.0, count)[:, None] * (last - first), strength, BLACK)


# A ridge that came on one strand and went on along the other, and what is left of both.
BENT = Chain(
    np.vstack([chain((0, 0), (100, 0)).points, chain((101, 0), (190, -40)).points]), 200.0, BLACK
)
BEFORE, BEHIND = chain((10, 41), (93, 4)), chain((108, 1), (200, 1))


def test_a_chain_is_cut_beside_the_ends_of_strands_that_join_it():
    pieces = cut_at_junctions([BENT, BEFORE, BEHIND], WIDTH)
    assert len(pieces) == 5
    ends = sorted(piece.points[-1, 0] for piece in pieces)[:3]
    assert np.abs(ends[1] - 93.0) < WIDTH  # beside the end of the strand that came
    assert np.abs(ends[2] - 107.0) < WIDTH  # beside the start of the one that goes on


def test_a_chain_is_cut_by_no_spot_no_faint_line_and_not_at_its_own_ends():
    spot, faint = chain((50, 3), (50, 9)), chain((50, 3), (50, 60), 80.0)
    further, ahead = chain((50, 9), (50, 60)), chain((197, -45), (260, -80))
    for other in (spot, faint, further, ahead):
        kept, same = cut_at_junctions([BENT, other], WIDTH)
        assert kept.points is not other.points
        assert len(kept.points) == len(BENT.points)
        assert len(same.points) == len(other.points)
    assert cut_at_junctions([], WIDTH) == []
