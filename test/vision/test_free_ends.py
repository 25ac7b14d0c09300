# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where a free end lies, and u along a DLO that has one."""

from dataclasses import replace

import numpy as np
import pytest
from vision_ends import PLACES, errors, judge
from vision_scenes import LENGTH, Scene, bow, clamps, render, settings
from vision_stress import judge as judge_stress

from dlo_ros.errors import VisionError
from dlo_ros.vision import Observer
from dlo_ros.vision.fit.material_coordinates import locate_ends, std_along
from dlo_ros.vision.segmentation.edge_profile import locate
from dlo_ros.vision.tracing.tip_likelihood import EDGE, Tip, ends, find_tip

ARC = np.linspace(0.0, 0.4, 401)  # [m] at profiles one millimetre apart
WIDTH = 0.004


def sharp(at):
    """The likelihood of an end that is clearly seen at a profile."""
    places = np.arange(340.0, 460.0)
    return Tip(places, -0.5 * ((places - at) / 0.5) ** 2, at)


FLAT = Tip(np.arange(385.0, 460.0), np.zeros(75), 385.0)  # hidden from profile 385 on


def test_an_end_lies_where_the_dlo_stops_and_the_board_begins():
    seen = np.array([1.0] * 20 + [-1.0] * 20)
    likelihood = ends(seen, np.where(seen < 0.0, 1.0, 0.0), EDGE, True)
    assert int(np.argmax(likelihood)) == 20
    assert likelihood[18] < likelihood[20] - 1.5


def test_something_in_front_of_the_dlo_is_no_end():
    seen = np.array([1.0] * 20 + [-2.0] * 15 + [1.0] * 20 + [-2.0] * 10)
    likelihood = ends(seen, np.where(np.arange(65) >= 55, 1.0, 0.0), EDGE, True)
    assert int(np.argmax(likelihood)) == 55
    # Behind what hides it any place is as likely as another.
    seen = np.array([1.0] * 20 + [-2.0] * 30)
    likelihood = ends(seen, np.zeros(50), EDGE, True)
    assert np.ptp(likelihood[30:]) < 0.1
    assert likelihood[20] > likelihood[30] > likelihood[20] - 10.0


def test_a_dlo_that_was_not_seen_before_may_be_hidden_just_as_well():
    hidden = np.full(40, -1.0)
    sure = ends(hidden, np.zeros(40), EDGE, True)
    unsure = ends(hidden, np.zeros(40), EDGE, False)
    assert np.ptp(sure) > 5.0 > np.ptp(unsure)


def bar(end):
    """A picture of a bar, ten pixels wide, that ends at a column, and the bar located."""
    picture = np.full((120, 400, 3), 200, np.uint8)
    picture[55:65, :end] = 60
    curve = np.column_stack([np.arange(10.0, 330.0, 2.0), np.full(160, 59.5)])
    return picture, locate(picture, curve, 10.0)


def test_the_board_tells_of_an_end_where_the_course_of_the_dlo_is_known():
    picture, located = bar(250)
    tip = find_tip(picture, located, located.points, 120.0, 20.0, from_start=False)
    assert tip.at[np.argmax(tip.likelihood)] == pytest.approx(120.0, abs=1.0)
    clear = np.ptp(tip.likelihood)
    # Not seen any more from 60 px before the end on, and a course that leaves the bar 40 px later.
    lost = replace(located, seen=located.seen & (located.curve[:, 0] < 190.0))
    course = located.points.copy()
    course[:, 1] += np.maximum(course[:, 0] - 230.0, 0.0)
    tip = find_tip(picture, lost, course, 118.0, 20.0, from_start=False)
    assert np.ptp(tip.likelihood[tip.at > 110.0]) < 0.5 * clear


def test_an_end_without_a_cross_section_to_compare_with_may_be_anywhere():
    picture, located = bar(250)
    unseen = replace(located, seen=np.zeros_like(located.seen))
    tip = find_tip(picture, unseen, located.points, 120.0, 20.0, from_start=False)
    assert np.ptp(tip.likelihood) == 0.0
    assert tip.innermost == tip.visible == 120.0
    assert tip.at[0] < 100.0 < 170.0 < tip.at[-1]


@pytest.mark.parametrize("seed", [870032, 890056, 890129, 890134, 890147, 890222])
def test_a_free_end_that_is_lost_on_dark_cloth_is_uncertain(seed):
    verdict = judge_stress(seed, "dark", "start")
    assert verdict.found == "silent" or not verdict.beyond  # 40 to 70 px short, stated as 3 to 13


def test_a_clear_end_tells_and_a_hidden_one_leaves_it_to_the_length():
    clear = locate_ends(ARC, (None, sharp(396.0)), 0.4, 0.0, WIDTH)
    assert clear.places == pytest.approx([0.0, 396.0], abs=0.3)
    assert np.sqrt(clear.covariance[1, 1]) < 1e-3
    hidden = locate_ends(ARC, (None, FLAT), 0.4, 0.0, WIDTH)
    assert hidden.places[1] == pytest.approx(400.0, abs=2.0)
    assert 1.5e-3 < np.sqrt(hidden.covariance[1, 1]) < 6e-3
    # A length that is stated to be poorly known makes it less certain.
    poor = locate_ends(ARC, (None, FLAT), 0.4, 0.01, WIDTH)
    assert poor.covariance[1, 1] > 3.0 * hidden.covariance[1, 1]


def test_of_two_free_ends_the_clear_one_places_the_hidden_one():
    start = Tip(np.arange(-20.0, 40.0), -0.5 * ((np.arange(-20.0, 40.0) - 10.0) / 0.5) ** 2, 10.0)
    found = locate_ends(ARC, (start, FLAT), 0.385, 0.0, WIDTH)
    assert found.places == pytest.approx([10.0, 395.0], abs=2.5)
    std = std_along(np.array([0.0, 0.385]), 0.385, found.covariance, 0.0)
    assert std[0] < 1e-3 < std[1]


def test_u_is_sure_at_a_clamp_and_less_so_along_a_bridge():
    covariance = np.array([[0.0, 0.0], [0.0, 1e-6]])
    u = np.linspace(0.0, 0.4, 5)
    std = std_along(u, 0.4, covariance, 0.0)
    assert std[0] == 0.0
    assert std[-1] == pytest.approx(1e-3)
    assert np.all(np.diff(std) > 0.0)
    assert std_along(u, 0.4, covariance, 0.05)[2] > 2.0 * std[2]


@pytest.mark.long
def test_holes_beside_a_free_end_do_not_stretch_u():
    found = [judge("holes", seed) for seed in range(7000, 7000 + len(PLACES))]
    table = np.array([f for f in found if not isinstance(f, str)])
    assert len(table) >= len(PLACES) - 1
    assert np.mean(table[:, 0] < 0.003) >= 0.85
    assert np.median(table[:, 0]) < 0.001
    assert table[:, 0].max() < 0.012
    assert table[:, 2].mean() > 0.9  # within two stated std


# A hole beside the end draws what is seen last of the DLO aside, and with it the course beyond.
@pytest.mark.parametrize("seed", [1500101, 1600022, 1600062, 1600242])
def test_a_hole_beside_the_end_does_not_lead_the_course_off_it(seed):
    found = judge("holes", seed)
    assert not isinstance(found, str)
    assert abs(found[0]) < 0.003


@pytest.mark.parametrize("kind", ["plain", "shadow", "dark", "hidden", "long"])
def test_stated_std_of_u_covers_the_error(kind):
    found = [judge(kind, seed) for seed in range(7100, 7104)]
    table = np.array([f for f in found if not isinstance(f, str)])
    assert len(table) >= 3
    assert np.mean(table[:, 2]) > 0.8
    if kind in ("plain", "long"):
        assert table[:, 0].max() < 0.003
        assert table[:, 4].max() < 0.003


def hiding(share):
    """A bow whose free end lies under a sheet of paper, and what the observer finds."""
    curve, scene = bow(), Scene()
    hidden = curve[round((1.0 - share) * (len(curve) - 1)) :]
    board = np.column_stack([hidden[:, 0], np.zeros(len(hidden)), hidden[:, 1]])
    pixels = scene.camera().project(board)
    low, high = pixels.min(axis=0).astype(int) - 12, pixels.max(axis=0).astype(int) + 40
    low[1] = pixels[0, 1] if pixels[-1, 1] > pixels[0, 1] else low[1]
    high[1] = pixels[0, 1] if pixels[-1, 1] < pixels[0, 1] else high[1]
    scene.extra.append(("box", *np.maximum(low, 0), *high, (120, 200, 240)))
    observer = Observer(settings(scene, 20), scene.camera(), clamps(curve, 20, ("start",)))
    return curve, observer.observe(0, render(curve, scene))


def test_a_rope_seen_short_is_one_whose_end_is_hidden():
    curve, result = hiding(0.06)
    points = result.observation.points
    along, across = errors(points, curve)
    assert points.u.max() < 0.95 * LENGTH  # what is hidden has no points
    assert np.abs(along).max() < 0.004 * LENGTH
    assert np.abs(across).max() < 2e-4
    assert np.mean(np.abs(along) < 2.0 * points.std_along) > 0.9
    assert points.std_along[-1] > 2e-3 > points.std_along[0]
    assert not result.pixels_seen[-1]


def test_a_rope_seen_much_too_short_is_refused():
    with pytest.raises(VisionError, match="length"):
        hiding(0.13)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_of_a_rope_held_at_both_ends_the_seen_length_is_told(factor):
    curve, scene = bow(), Scene()
    known = settings(scene, 20, factor * LENGTH)
    result = Observer(known, scene.camera(), clamps(curve, 20)).observe(0, render(curve, scene))
    assert result.seen_length == pytest.approx(LENGTH, rel=2e-3)
    assert result.observation.points.std_along is None
    along, _ = errors(result.observation.points, curve, factor)
    assert np.abs(along).max() < 0.002 * LENGTH


def test_a_mask_beside_a_free_end_is_no_board():
    # The end lies where the mask says that the rope can no longer be.
    curve, scene = bow(), Scene()
    pixels = scene.camera().project(np.insert(curve, 1, 0.0, axis=1))
    mask = np.full((540, 960), 255, np.uint8)
    x, y = pixels[-1].astype(int)
    mask[y - 30 : y + 30, x + 3 : x + 60] = 0
    seen = Observer(settings(scene, 20), scene.camera(), clamps(curve, 20, ("start",)))
    seen.mask = mask
    points = seen.observe(0, render(curve, replace(scene, seed=3))).observation.points
    along, _ = errors(points, curve)
    assert np.abs(along).max() < 0.004 * LENGTH
