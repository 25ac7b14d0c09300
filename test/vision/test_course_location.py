# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A shadow that stands out more than the DLO which casts it."""

import numpy as np
import pytest
from vision_stress import judge

from dlo_ros.vision.segmentation.edge_profile import locate
from dlo_ros.vision.tracing.course_location import not_shaded, side_of_caster

GROUND, ROPE = np.array([70.0, 30.0, 64.0]), np.array([37.0, 46.0, 43.0])
WIDTH = 10


def stripes(*tones, first=25):
    """A picture of horizontal stripes, a width thick each, on the ground."""
    picture = np.full((60, 200, 3), GROUND)
    for k, tone in enumerate(tones):
        picture[first + k * WIDTH : first + (k + 1) * WIDTH] = tone
    return np.rint(picture).astype(np.uint8)


def located(picture):
    curve = np.column_stack([np.arange(10.0, 190.0), np.full(180, 29.5)])
    return locate(picture, curve, WIDTH, known_width=True)


def test_the_rope_lies_beside_a_shadow_that_was_located():
    picture = stripes(0.35 * GROUND, ROPE)
    found = located(picture)
    side = side_of_caster(picture, found)
    assert side * found.normals[0, 1] == pytest.approx(1.0)
    upside_down = np.ascontiguousarray(picture[::-1])
    curve = np.column_stack([np.arange(10.0, 190.0), np.full(180, 29.5)])
    turned = locate(upside_down, curve, WIDTH, known_width=True)
    assert side_of_caster(upside_down, turned) * turned.normals[0, 1] == pytest.approx(-1.0)


@pytest.mark.parametrize(
    "tones",
    [
        (ROPE, 0.5 * GROUND),  # the rope's own shadow beside it
        (0.3 * GROUND, 0.6 * GROUND),  # a rope of the ground's hue, and its shadow
        (0.3 * GROUND,),  # nothing beside it
        (0.3 * GROUND, ROPE, ROPE, ROPE),  # other ground beside it
        (ROPE, 0.4 * ROPE),  # another rope beside it
    ],
)
def test_a_rope_is_no_shadow(tones):
    picture = stripes(*tones)
    assert side_of_caster(picture, located(picture)) == 0


def test_a_shadow_only_takes_light_away():
    assert not_shaded(0.4 * GROUND, GROUND) == pytest.approx(0.0)
    assert not_shaded(1.5 * GROUND, GROUND) == pytest.approx(0.5 * np.linalg.norm(GROUND))
    assert not_shaded(np.zeros(3), np.zeros(3)) == 0.0


def test_a_rope_is_found_beside_its_shadow():
    assert judge(351014, "dark", "start").found == "right"  # 8.7 px beside it in the shadow


def test_edges_that_change_their_distance_beside_a_shadow_are_in_doubt():
    # For a third of its length the rope's shadow, of its own tone, moves one edge by 2 px.
    picture = stripes(0.3 * GROUND)
    picture[35:37, 70:130] = picture[30, 100]
    for known, least in ((True, 0.8), (False, 0.0)):
        curve = np.column_stack([np.arange(10.0, 190.0), np.full(180, 29.5)])
        doubt = locate(picture, curve, WIDTH, known_width=known).doubt
        assert doubt[85:95].min() > least
        assert max(doubt[:30].max(), doubt[-30:].max()) < 0.1


def test_the_std_contains_edges_that_change_over_to_a_shadow():
    verdict = judge(800024, "dark", "start")
    # Rounding decides whether it is found: the rope and its shadow are lost in turn.
    assert verdict.found == "silent" or verdict.across < 1.5  # 3.0 without it


def test_a_strip_of_the_rope_or_of_its_shadow_is_not_the_rope():
    verdict = judge(902005, "dark", "both")  # the dark flank beside a highlight, 6 of 10 px wide
    assert verdict.found == "right" or "a part of it" in verdict.reason
    assert judge(902042, "dark", "both").found == "right"  # the shadow, 8 px beside it
