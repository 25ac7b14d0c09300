# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Predicted shapes choose between courses that the picture leaves open, and do nothing else."""

import numpy as np
import pytest
from picture_bags import STAMP, write_bag
from vision_scenes import Scene, across_errors, bow, render, settings

from dlo_ros.cli.observe import observe_recording
from dlo_ros.errors import InputError, VisionError
from dlo_ros.recordings import BAG_MESSAGES, BagWriter
from dlo_ros.recordings.message_building import spline_message
from dlo_ros.recordings.write import copy_topics
from dlo_ros.spline import SplineBasis
from dlo_ros.vision import Observer
from dlo_ros.vision.predictions import KEPT, Predictions

BLUE = (170, 70, 40)
OWN = bow()
TWIN = bow() + np.array([0.0, 0.09])
TWINS = Scene(rope=BLUE, extra=[("below", TWIN, BLUE)], size=(960, 900))
ALONE = Scene(rope=BLUE, size=(960, 900))
FRAME = 33_000_000  # ns


def spline(curve, n=12, off=(0.0, 0.0), length=0.4):
    """Control points (n, 4) of a curve that is shifted by an offset [m]."""
    flat = SplineBasis(n, length).fit(np.linspace(0.0, length, len(curve)), curve + off)
    return np.column_stack([flat[:, 0], 0.0 * flat[:, 0], flat[:, 1], 0.0 * flat[:, 0]])


def largest_error_px(result, curve, scene):
    across, _ = across_errors(result.observation.points.positions[:, [0, 2]], curve)
    return np.abs(across).max() * scene.width_px / scene.diameter


@pytest.fixture(scope="module")
def twins():
    return render(OWN, TWINS)


@pytest.mark.parametrize("curve", [OWN, TWIN], ids=["own", "twin"])
@pytest.mark.parametrize("n", [12, 20])
def test_a_prediction_chooses_between_two_courses_and_is_no_data(twins, curve, n):
    observer = Observer(settings(TWINS), TWINS.camera())
    result = observer.observe(0, twins, spline(curve, n, off=(0.003, -0.004)))
    # It was 5 mm off; what is published lies where the picture shows the rope.
    assert largest_error_px(result, curve, TWINS) < 1.0


@pytest.mark.parametrize(
    "wrong",
    [
        spline(OWN, off=(0.0, 0.045)),
        spline(OWN, off=(0.0, -0.1)),
        spline(0.5 * (OWN + TWIN) @ np.array([[0.0, 1.0], [-1.0, 0.0]])),
        1e3 + spline(OWN),
        0.0 * spline(OWN),
    ],
    ids=["between both", "beside both", "turned", "far away", "a point"],
)
def test_a_wrong_prediction_leaves_two_courses_and_changes_no_single_one(twins, wrong):
    with pytest.raises(VisionError, match="equally plausible"):
        Observer(settings(TWINS), TWINS.camera()).observe(0, twins, wrong)
    picture = render(OWN, ALONE)
    with_it, without = (
        Observer(settings(ALONE), ALONE.camera()).observe(0, picture, hint).observation
        for hint in (wrong, None)
    )
    np.testing.assert_array_equal(with_it.control_points, without.control_points)
    np.testing.assert_array_equal(with_it.points.std, without.points.std)


def test_a_prediction_shows_no_rope_where_there_is_none():
    empty = render(None, ALONE)
    with pytest.raises(VisionError):
        Observer(settings(ALONE), ALONE.camera()).observe(0, empty, spline(OWN))


def test_the_last_picture_chooses_after_a_loss_and_contradicts_a_prediction(twins):
    def lost():
        observer = Observer(settings(ALONE), ALONE.camera())
        observer.observe(0, render(OWN, ALONE))
        with pytest.raises(VisionError):
            observer.observe(FRAME, render(None, ALONE))
        return observer

    result = lost().observe(2 * FRAME, twins)
    assert not result.tracked
    assert largest_error_px(result, OWN, TWINS) < 1.0
    with pytest.raises(VisionError, match="equally plausible"):  # two answers
        lost().observe(2 * FRAME, twins, spline(TWIN))
    with pytest.raises(VisionError, match="equally plausible"):  # too long ago
        lost().observe(40 * FRAME, twins)
    forgetful = lost()
    forgetful.reset()
    with pytest.raises(VisionError, match="equally plausible"):
        forgetful.observe(2 * FRAME, twins)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (np.zeros((3, 4)), "shape"),
        (np.zeros(12), "shape"),
        (np.zeros((12, 2)), "shape"),
        (np.full((12, 4), np.nan), "not finite"),
    ],
)
def test_what_is_no_spline_is_refused(twins, shape, words):
    with pytest.raises(InputError, match=words):
        Observer(settings(TWINS), TWINS.camera()).observe(0, twins, shape)


def test_predictions_are_brought_to_the_image():
    second = 1_000_000_000
    kept = Predictions()
    assert kept.at(0) is None
    shape = spline(OWN)
    kept.add(second, shape + 1.0)
    kept.add(0, shape)  # late
    np.testing.assert_array_equal(kept.at(second // 4), shape)  # the other one is too far away
    kept.add(second // 2, shape + 0.5)
    np.testing.assert_allclose(kept.at(second // 4), shape + 0.25)
    kept.add(second // 2, shape + 0.7)  # anew
    np.testing.assert_allclose(kept.at(second // 2), shape + 0.7)
    np.testing.assert_array_equal(kept.at(-second // 4), shape)
    assert kept.at(-second) is None
    assert kept.at(2 * second) is None
    kept.add(3 * second // 4, spline(OWN, 20))  # of another number of control points
    assert len(kept.at(5 * second // 8)) == 12
    kept.add(100 * second, shape)
    assert kept.at(100 * second - 1) is shape
    np.testing.assert_allclose(kept.at(second // 2), shape + 0.7)
    for _ in range(KEPT):
        kept.add(200 * second, shape)
    assert kept.at(0) is None
    kept.clear()
    assert kept.at(200 * second) is None


def test_predictions_of_a_bag_are_used_and_unusable_ones_skipped(twins, tmp_path):
    write_bag(tmp_path / "images", TWINS, [twins, twins])
    known = settings(TWINS)
    hour = 3600 * 1_000_000_000
    shapes = [(hour, spline(OWN)), (0, spline(TWIN, 20)), (1, spline(OWN)), (2, spline(OWN)[:2])]
    for name, some in (("plain", []), ("told", shapes)):
        with BagWriter(tmp_path / name) as writer:
            for k, (after, shape) in enumerate(some):
                message = spline_message(BAG_MESSAGES, STAMP + after, "board", shape)
                if k == 2:
                    message.poses[3].position.x = np.nan
                writer.write("dlo/predicted", message, STAMP - 4 + k)
            copy_topics(tmp_path / "images", writer)
    skipped: list[str] = []
    frames = list(observe_recording(tmp_path / "plain", known, skipped.append))
    assert [frame.result for frame in frames] == [None, None]
    frames = list(observe_recording(tmp_path / "told", known, skipped.append))
    assert all(largest_error_px(f.result, TWIN, TWINS) < 1.0 for f in frames)
    assert len(skipped) == 2
    assert "not finite" in skipped[0]
    assert "at least 4" in skipped[1]
