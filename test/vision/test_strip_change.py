# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses that change over from the DLO to its shadow."""

import numpy as np
import pytest
from vision_stress import judge

from dlo_ros.errors import VisionError
from dlo_ros.vision.tracing.strip_change import check_strips

WIDTH = 10
GROUND, ROPE, SHADOW = 60, 40, 20


def picture(rope=(40, 50), shadow=(50, 60)):
    """Grey ground with a rope and its shadow, in some rows each, from left to right."""
    image = np.full((100, 400, 3), GROUND, np.uint8)
    image[slice(*shadow)] = SHADOW
    image[slice(*rope)] = ROPE
    return image


def course(first, second):
    """Points along a row to the left, along another one to the right, unseen in between."""
    x = np.arange(20.0, 380.0)
    return np.column_stack([x, np.interp(x, [180.0, 220.0], [first, second])]), (x < 180) | (
        x > 220
    )


def test_a_course_that_goes_on_in_the_shadow_is_refused():
    for rows in ((44.5, 54.5), (54.5, 44.5)):
        points, seen = course(*rows)
        with pytest.raises(VisionError, match="changes over"):
            check_strips(picture(), points, seen, WIDTH, 20.0)


def test_a_course_on_the_rope_is_accepted():
    points, seen = course(44.5, 44.5)
    check_strips(picture(), points, seen, WIDTH, 20.0)
    check_strips(picture(), points, np.ones_like(seen), WIDTH, 20.0)
    # In the shade of something else all of it is darker.
    image = picture()
    image[:, 200:] = image[:, 200:] // 2
    check_strips(image, points, seen, WIDTH, 20.0)


def test_a_short_part_shows_nothing_of_what_lies_beside_it():
    points, seen = course(44.5, 54.5)
    check_strips(picture(), points, seen & (points[:, 0] < 235.0), WIDTH, 20.0)


def test_a_rope_that_was_found_in_its_shadow_for_a_third_of_its_length():
    assert judge(910130, "dark", "start").found == "silent"  # 9 px beside it
