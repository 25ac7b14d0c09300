# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A stretch of a DLO is as long as several knot spans of the simulation that tells its numbers."""

from dataclasses import dataclass

import pytest
from rods import PAPER

from dlo_ros.diagnosis.findings.resolved_extents import with_resolved_extents


@dataclass(frozen=True)
class Simulated:
    spans: int | None


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ({}, [7, 28, None]),
        ({"point_mass": {"mass": 0.1, "position": 0.05}}, [7, 28, None]),
        ({"stiff_segment": {"centre": 0.2, "extent": 0.1, "ratio": 2.0, "taper": 0.2}},
         [16, 28, None]),
        ({"connector": {"mass": 0.1, "extent": 0.05}}, [32, 32, None]),
        ({"stiff_segment": {"centre": 0.2, "extent": 0.0, "ratio": 2.0}}, [7, 28, None]),
        ({"obstacle": {"x": 0.1, "z": -0.2, "radius": 0.002}}, [7, 28, None]),
    ],
    ids=["nothing", "a point", "a segment", "a plug", "nothing of a segment", "a peg"],
)  # fmt: skip
def test_spans_resolve_the_shortest_extent(effects, expected):
    settings = PAPER.with_effects(effects)
    assert settings.rod.length == 0.4
    found = with_resolved_extents([Simulated(s) for s in (7, 28, None)], settings, effects)
    assert [r.spans for r in found] == expected


def test_what_is_not_told_needs_no_more_spans():
    both = {"connector": {"mass": 0.1, "extent": 0.01}, "stiff_segment": {"extent": 0.1}}
    settings = PAPER.with_effects(both)
    (found,) = with_resolved_extents([Simulated(7)], settings, {"stiff_segment"})
    assert found.spans == 16
