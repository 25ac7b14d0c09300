# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A stiff piece beside a grip that gives."""

import pytest
from rods import PAPER

from dlo_ros.spline import SplineBasis

ROD = PAPER.rod


@pytest.mark.parametrize("spans", [14, 28, 56])
@pytest.mark.parametrize("compliance", [0.1, 0.85, 30.0])
def test_a_grip_that_gives_leaves_a_stiff_piece_beside_it_its_compliance(spans, compliance):
    """A plug on an end that is held is a thousand times as stiff as the rest, and no stiffer."""
    basis = SplineBasis(spans + 3, ROD.length)
    plug = {"connector": {"mass": 0.0, "extent": 0.11 * ROD.length}}
    alone = PAPER.with_effects(plug).body(basis).bend
    body = PAPER.with_effects({**plug, "clamp_compliance": {"end": compliance}}).body(basis)
    assert body.bend.min() > 0.0
    assert body.bend.max() < 20.0 * alone.max()
    # Farther off than the knot spans that make up for the grip nothing changes.
    far = body.points < 0.5 * ROD.length
    assert body.bend[far] == pytest.approx(alone[far])
