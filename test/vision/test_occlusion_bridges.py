# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What lies under a part of the course where the DLO was not seen."""

import numpy as np
import pytest
from vision_scenes import Scene, bow, render, to_board
from vision_stress import judge

from dlo_ros.errors import VisionError
from dlo_ros.vision.fit.planar_credibility import SHARPEST, sharpest_turn
from dlo_ros.vision.tracing.occlusion_bridges import check_bridges


def course(scene, aside):
    """The true course, moved aside by some widths along a middle part that was not seen."""
    curve = bow()
    pixels = scene.camera().project(to_board(curve))[::4]
    seen = np.ones(len(pixels), dtype=bool)
    part = slice(220, 270)
    seen[part] = False
    tangent = np.gradient(pixels, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normal /= np.hypot(*normal.T)[:, None]
    bump = np.zeros(len(pixels))
    bump[part] = np.sin(np.linspace(0.0, np.pi, 50)) ** 0.5
    return render(curve, scene), pixels + aside * scene.width_px * bump[:, None] * normal, seen


def test_a_course_over_bare_board_is_refused():
    picture, pixels, seen = course(Scene(), 2.5)
    with pytest.raises(VisionError, match=r"widths of bare board"):
        check_bridges(picture, pixels, seen, 10.0)


@pytest.mark.parametrize("aside", [0.0, 2.5])
def test_a_bridge_below_something_stands(aside):
    scene = Scene()
    picture, pixels, seen = course(scene, aside)
    low, high = pixels[~seen].min(axis=0) - 25, pixels[~seen].max(axis=0) + 25
    picture[int(low[1]) : int(high[1]), int(low[0]) : int(high[0])] = (80, 160, 190)
    check_bridges(picture, pixels, seen, 10.0)
    # On the DLO itself nothing is bare, though for some reason it was not seen.
    if not aside:
        check_bridges(render(bow(), scene), pixels, seen, 10.0)


@pytest.mark.parametrize("aside", [0.0, 2.5])
def test_a_bridge_below_a_pale_sheet_stands(aside):
    picture, pixels, seen = course(Scene(), aside)
    low, high = pixels[~seen].min(axis=0) - 5, pixels[~seen].max(axis=0) + 5
    seen = np.any((pixels < low) | (pixels > high), axis=1)
    part = slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
    picture[part] = (203, 220, 208)  # 10 grey levels from the board, where the rope has 280
    noise = np.random.default_rng(1).normal(0.0, 2.0, picture[part].shape)
    picture[part] = np.clip(picture[part] + noise, 0, 255).astype(np.uint8)
    check_bridges(picture, pixels, seen, 10.0)


def test_a_shade_on_bare_board_does_not_hide_the_rope():
    picture, pixels, seen = course(Scene(), 2.5)
    middle = pixels[~seen].mean(axis=0)
    x, y = np.meshgrid(np.arange(picture.shape[1]), np.arange(picture.shape[0]))
    far = np.hypot(x - middle[0], y - middle[1])
    shade = 1.0 - 0.15 * np.exp(-0.5 * (far / 100.0) ** 2)  # 30 grey levels, soft over ten widths
    picture = (picture * shade[:, :, None]).astype(np.uint8)
    with pytest.raises(VisionError, match=r"widths of bare board"):
        check_bridges(picture, pixels, seen, 10.0)


def test_what_lies_beside_the_rope_is_no_point_of_it():
    # Near its end the rope touches itself beside a hole.
    assert judge(82058, "issue", "start").found == "right"


def test_a_course_with_a_corner_is_sharper_than_a_rope_bends():
    corner = np.vstack(
        [np.linspace([0.0, 0.0], [0.1, 0.0], 50), np.linspace([0.1, 0], [0.1, 0.1], 50)]
    )
    angle = np.linspace(0.0, np.pi, 100)
    bend = 3.0 * 0.004 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert sharpest_turn(bend, 0.004) < SHARPEST < sharpest_turn(corner, 0.004)


@pytest.mark.slow
def test_a_dark_rope_on_dark_cloth_is_right_or_silent():
    found = [judge(seed, "dark", "start").found for seed in range(83000, 83012)]
    assert found.count("wrong") <= 2
    assert found.count("right") >= 7
    assert judge(83000, "dark", "start").found == "silent"  # with its shadow it is 5.3 mm wide


@pytest.mark.slow
@pytest.mark.long
def test_a_rope_in_a_robots_cell_is_right_or_silent():
    found = [judge(seed, "cell", "start").found for seed in range(83100, 83112)]
    assert found.count("right") >= 10
    assert found.count("wrong") <= 1
