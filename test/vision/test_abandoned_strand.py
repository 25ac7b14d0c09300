# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A course that turns off a strand which goes straight on is another DLO's."""

import numpy as np
import pytest
from vision_stress import judge

from dlo_ros.vision.tracing.abandoned_strand import abandons_strand

WIDTH = 10.0


def line(start, angle, length, curvature=0.0):
    """An arc from a point [px], about a point a pixel, shape (m, 2)."""
    s = np.arange(0.0, length)
    heading = np.deg2rad(angle) + curvature * s
    steps = np.column_stack([np.cos(heading), np.sin(heading)])
    return np.array(start) + np.cumsum(steps, axis=0)


def turned(angle):
    """A course that runs to the right, and from (300, 0) on into another direction [degrees]."""
    return np.vstack([line((0.0, 0.0), 0.0, 300), line((300.0, 0.0), angle, 200)])


def abandons(course, strands, free=(False, False), seen=None):
    seen = np.ones(len(course), bool) if seen is None else seen
    return abandons_strand(course, seen, strands, WIDTH, free)


ONWARD = line((300.0, 0.0), 0.0, 200)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("angle", [35.0, 60.0, -60.0])
def test_a_turn_off_a_strand_that_goes_straight_on(angle, backwards):
    course = turned(angle)[::-1] if backwards else turned(angle)
    assert abandons(course, [course, ONWARD])
    assert not abandons(course, [course])  # it may bend where nothing else goes on
    assert not abandons(course, [])


def test_a_strand_that_is_crossed_is_not_abandoned():
    course = line((0.0, 0.0), 0.0, 500)
    assert not abandons(course, [course, line((150.0, -150.0), 45.0, 400)])
    assert not abandons(course, [course, line((300.0, 0.0), 60.0, 200)])  # nor one that begins


def test_a_bend_is_carried_on_with_its_curvature():
    course = line((0.0, 0.0), 0.0, 400, 0.01)
    angle = np.rad2deg(0.01 * 200)
    assert not abandons(course, [course, line(course[200], angle, 200)])
    turning = np.vstack([course[:200], line(course[200], angle - 30.0, 200)])
    assert abandons(turning, [turning, course[200:]])


def test_what_was_not_seen_cannot_be_carried_on():
    course = turned(60.0)
    seen = np.ones(len(course), bool)
    seen[150:320] = False
    assert not abandons(course, [course, ONWARD], seen=seen)


def test_a_free_end_is_no_place_on_a_strand_and_a_clamp_may_be():
    course = line((0.0, 0.0), 0.0, 300)
    assert abandons(course, [course, ONWARD], free=(False, True))
    assert not abandons(course, [course, ONWARD], free=(True, False))
    assert not abandons(course, [course, ONWARD[80:]], free=(False, True))  # it is far away


@pytest.mark.parametrize(
    ("ends", "seed"), [("none", 195005), ("none", 241381), ("none", 252645), ("start", 240325)]
)
def test_clutter_that_a_course_turned_into_leaves_the_picture_silent(ends, seed):
    assert judge(seed, "issue", ends).found == "silent"  # wrong without the check


@pytest.mark.parametrize(("ends", "seed"), [("start", 240013), ("none", 241301), ("both", 242581)])
def test_a_course_that_turns_off_leaves_the_other_one_alone(ends, seed):
    assert judge(seed, "issue", ends).found == "right"  # two courses without the check
