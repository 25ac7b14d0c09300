# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO that is not alike on both sides says so in its std; two strands are two courses."""

import numpy as np
import pytest
from vision_scenes import LENGTH, Scene, across_errors, bow, clamps, render, settings
from vision_stress import judge

from dlo_ros.errors import VisionError
from dlo_ros.spline import SplineBasis
from dlo_ros.vision import Observer
from dlo_ros.vision.segmentation.edge_levels import LEVELS, LIKELY, doubt_of_middle
from dlo_ros.vision.segmentation.edge_search import blur_length

WIDTH = 12.0
OFFSETS = np.arange(-14.0, 14.5)


def bar(left=1.0, right=1.0, half=6.0):
    """A dark bar whose edges climb evenly over lengths [px] from -half and half inwards."""
    return 200.0 - 150.0 * np.clip(
        np.minimum((OFFSETS + half) / left, (half - OFFSETS) / right), 0.0, 1.0
    )


def doubt(section, middle=0.0, count=400):
    rows = np.tile(section, (count, 1))
    return doubt_of_middle(rows, OFFSETS, np.full(count, middle), np.ones(count, bool), WIDTH, 1.0)


@pytest.mark.parametrize("edge", [1.0, 2.0, 4.0])
def test_a_section_alike_on_both_sides_leaves_no_doubt(edge):
    assert doubt(bar(edge, edge)).max() < 1e-9


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("middle", [0.0, 0.4, -0.7])
def test_the_doubt_of_a_soft_edge_follows_from_its_length(middle, inverted):
    left, right = 2.0, 5.0
    section = bar(left, right)
    section = 250.0 - section if inverted else section
    # At a share of the climb the edges lie that share of their lengths inwards.
    between = np.array([0.5 * level * (left - right) for level in LEVELS])
    expected = np.sqrt((between - middle) ** 2 @ LIKELY)
    assert doubt(section, middle) == pytest.approx(expected, abs=0.04)


def test_a_highlight_does_not_hide_the_edges():
    # Brighter than the board, beside the middle of a rope that is darker than it.
    line = bar() + 300.0 * np.exp(-(((OFFSETS + 2.0) / 1.2) ** 2))
    assert doubt(line).max() < 0.2
    assert doubt(line, -2.0).min() > 1.8


def test_only_a_part_with_a_soft_edge_is_in_doubt():
    rows = np.vstack([np.tile(bar(), (200, 1)), np.tile(bar(1.0, 6.0), (200, 1))])
    seen = np.ones(400, bool)
    seen[190:210] = False
    found = doubt_of_middle(rows, OFFSETS, np.zeros(400), seen, WIDTH, 1.0)
    assert found[:150].max() < 0.01
    assert found[250:].min() > 0.5
    nothing = doubt_of_middle(rows, OFFSETS, np.zeros(400), ~seen & False, WIDTH, 1.0)
    assert not nothing.any()


def test_an_edge_beyond_where_the_board_should_begin_is_in_doubt():
    # 10 px from the middle on the left, 6 px on the right: the true middle lies 2 px aside.
    section = 200.0 - 150.0 * ((OFFSETS > -10.5) & (OFFSETS < 6.5))
    assert doubt(section).min() > 0.5


def test_a_shade_inside_the_dlo_counts_less_than_one_beside_it():
    # Both take 2 px of one side: the last half of the climb, or the first one.
    climb = np.clip(np.minimum(OFFSETS + 6.0, 6.0 - OFFSETS), 0.0, 1.0)
    inside = 200.0 - 75.0 * climb - 75.0 * np.clip(np.minimum(OFFSETS + 4.0, 6.0 - OFFSETS), 0, 1)
    beside = 200.0 - 75.0 * climb - 75.0 * np.clip(np.minimum(OFFSETS + 8.0, 6.0 - OFFSETS), 0, 1)
    assert doubt(inside).max() < 0.75 * doubt(beside).min()


@pytest.mark.parametrize("lens", [0.3, 0.5])
def test_a_lens_in_focus_is_no_motion(lens):
    step = 0.8
    variance = lens**2 + 1.0 / 12.0 + 1.0 / 6.0 + step**2 / 3.0
    ramp = np.sqrt(2.0 * np.pi * variance) * np.ones(3)
    assert blur_length(ramp, step).max() < 1e-6
    # What a motion adds is found in full.
    moved = np.sqrt(ramp**2 + 2.0 * np.pi * 4.0)
    found = blur_length(moved, step)
    assert found == pytest.approx(2.0 * np.sqrt(2.0 * np.pi), rel=0.04)


@pytest.mark.parametrize(
    ("which", "ends", "seed", "found"),
    [
        ("other", "both", 142034, "right"),
        ("dark", "start", 143005, "right"),
        ("dark", "start", 143077, "right"),
        ("dark", "start", 195013, "right"),
        # Its free end lies in the shadow, and is found 3.1 stds off.
        ("dark", "start", 195035, "wrong"),
    ],
)
def test_a_highlight_beside_the_middle_is_part_of_the_std(which, ends, seed, found):
    verdict = judge(seed, which, ends)
    assert verdict.found in ("right", found)
    assert verdict.across < 2.5  # 6, 29, 20, 5.4 and 2.8 without it


def beside(width):
    """A strand that leaves the bow by some widths, and comes back to it."""
    curve = bow()
    tangent = np.gradient(curve, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.hypot(*tangent.T)[:, None]
    u = np.linspace(0.0, 1.0, len(curve))
    away = np.where(abs(u - 0.5) < 0.25, np.cos(2.0 * np.pi * (u - 0.5)) ** 2, 0.0)
    part = abs(u - 0.5) < 0.3
    return (curve + width * 0.004 * away[:, None] * normal)[part]


def test_a_strand_beside_the_rope_is_another_course_that_an_expected_shape_excludes():
    scene = Scene()
    scene.extra.append(("below", beside(2.0), scene.rope))
    picture = render(bow(), scene)
    known, motion = settings(scene), clamps(bow())
    with pytest.raises(VisionError, match="equally plausible"):
        Observer(known, scene.camera(), motion).observe(0, picture)
    flat = SplineBasis(12, LENGTH).fit(np.linspace(0.0, LENGTH, len(bow())), bow())
    told = np.column_stack([flat[:, 0], np.zeros(12), flat[:, 1]])
    result = Observer(known, scene.camera(), motion).observe(0, picture, told)
    across, _ = across_errors(result.observation.points.positions[:, [0, 2]], bow())
    assert np.abs(across).max() / scene.diameter * scene.width_px < 1.0
    # Between both it tells nothing.
    halfway = told + 1.0 * 0.004 * np.array([0.0, 0.0, 1.0])
    with pytest.raises(VisionError, match="equally plausible"):
        Observer(known, scene.camera(), motion).observe(0, picture, halfway)


@pytest.mark.parametrize("away", [2.5, -2.0, -3.0])
def test_a_strand_that_bends_far_more_than_the_rope_is_no_second_answer(away):
    scene = Scene()
    scene.extra.append(("below", beside(away), scene.rope))
    result = Observer(settings(scene), scene.camera(), clamps(bow())).observe(
        0, render(bow(), scene)
    )
    across, _ = across_errors(result.observation.points.positions[:, [0, 2]], bow())
    assert np.abs(across).max() / scene.diameter * scene.width_px < 1.0
