# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Patterns, corners, and the camera from them, on pictures of known truth."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibration_scenes import (
    DISTORTION,
    GROUND,
    MATRIX,
    SIZE,
    TEXELS,
    charuco,
    chessboard,
    pixels_of,
    poses,
    turned,
    usual_lens,
)
from ordinary import some_of

from dlo_ros.errors import InputError, VisionError
from dlo_ros.vision.calibration.camera_calibration import calibrate, check_camera
from dlo_ros.vision.calibration.camera_file import camera_file, read_camera_file
from dlo_ros.vision.calibration.camera_fit import LENSES, Intrinsics, fit_camera, fit_lenses, locate
from dlo_ros.vision.calibration.pattern_search import PatternView, board_size, find_pattern
from dlo_ros.vision.calibration.patterns import Charuco, Pattern, parse_pattern
from dlo_ros.vision.calibration.print_pattern import INCH, RESOLUTION, print_pattern
from dlo_ros.vision.calibration.view_collection import ViewCollector
from dlo_ros.vision.calibration.view_coverage import LEAST_VIEWS, Coverage

BOARD = parse_pattern("chessboard:9x6:0.025")
LENS_MODELS = {
    "no distortion": (0.0,), "k1": (-0.2,), "k1 k2": (-0.28, 0.1), "k1 k2 p1 p2": DISTORTION,
}  # fmt: skip
TRUE = Intrinsics(MATRIX, DISTORTION, "plumb_bob", *SIZE)


def true_views(count, noise, seed, coefficients=DISTORTION, **options):
    """Views whose corners are known up to noise [px]; no picture is made."""
    rng = np.random.default_rng(seed)
    views = []
    for k, (rotation, translation) in enumerate(poses(count, BOARD.points, rng, **options)):
        p = pixels_of(BOARD.points, rotation, translation, MATRIX, coefficients)
        p = p + rng.normal(0.0, noise, p.shape)
        views.append(PatternView(f"view {k}", *SIZE, np.arange(len(p)), p, 2.5))
    return views


def seen(texture, texel, rotation, translation, seed=0, **look):
    rng = np.random.default_rng(seed)
    return usual_lens().picture(texture, texel, rotation, translation, rng, **look)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("chess:9x6:0.025", "no such kind"),
        ("chessboard", "0 fields"),
        ("chessboard:9x6", "1 fields"),
        ("chessboard:9by6:0.025", "'9by6' is no grid"),
        ("chessboard:9x6:25mm", "'25mm' is no length"),
        ("chessboard:9x6:25", "in metres"),
        ("chessboard:9x6:nan", "in metres"),
        ("chessboard:9x6:-0.025", "in metres"),
        ("chessboard:2x6:0.025", "3 to 100"),
        ("charuco:9x6:0.025", "4 are needed"),
        ("charuco:9x6:0.025:0.025:4X4_50", "0.3 to 0.95 times"),
        ("charuco:9x6:0.025:0.018:9X9_50", "known are"),
        ("charuco:12x9:0.025:0.018:4X4_50", "65 markers; 4X4_50 has 50"),
        ("", "no such kind"),
    ],
)
def test_a_malformed_pattern_is_told(text, reason):
    with pytest.raises(InputError, match=reason):
        parse_pattern(text)


def test_a_pattern_reads_what_it_writes():
    charuco_text = "charuco:8x5:0.03:0.022:5X5_100"
    for text in ("chessboard:9x6:0.025", charuco_text, f"{charuco_text}:old"):
        assert parse_pattern(text).text == text
    assert parse_pattern("charuco:8x5:0.03:0.022:DICT_5X5_100").text.endswith(":5X5_100")


@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_chessboard_corners_are_subpixel(blur):
    errors = []
    for k, (rotation, shift) in enumerate(poses(4, BOARD.points, np.random.default_rng(1))):
        picture = seen(chessboard(9, 6), 0.025 / TEXELS, rotation, shift, k, blur=blur)
        view = find_pattern(picture, BOARD)
        true = pixels_of(BOARD.points, rotation, shift)
        # Half a turn of the board is read as well as none.
        errors.append(min((view.pixels - true, view.pixels[::-1] - true), key=np.linalg.norm))
        assert view.edge_width == pytest.approx(2.5 * np.hypot(blur, 0.6), rel=0.3)
    rms = np.sqrt(np.mean(np.sum(np.array(errors) ** 2, axis=2)))
    assert rms < (0.05 if blur < 1.0 else 0.08)
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.02  # no bias


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("grid", [(8, 5), (7, 6)])
def test_charuco_corners_have_their_numbers(grid, old):
    """Drawn by OpenCV in both of its layouts; the camera sees a part of it."""
    board = Charuco(*grid, 0.03, 0.022, "5X5_100", old)
    texture = charuco(*grid, 0.022 / 0.03, "5X5_100", old)
    rotation, shift = turned(0.3, -0.35, 0.6), np.array([-0.13, 0.05, 0.32])
    view = find_pattern(seen(texture, 0.03 / TEXELS / 2, rotation, shift), board)
    assert 12 < len(view.corners) < len(board.points)
    error = view.pixels - pixels_of(board.points[view.corners], rotation, shift)
    assert np.median(np.linalg.norm(error, axis=1)) < 0.06


@pytest.mark.slow
def test_a_part_of_a_larger_chessboard_is_refused():
    rotation, shift = turned(0.2, -0.2, 0.1), np.array([0.0, 0.0, 0.4])
    picture = seen(chessboard(9, 6), 0.025 / TEXELS, rotation, shift)
    for columns, rows in ((8, 6), (9, 5), (7, 5), (10, 7), (9, 7)):
        with pytest.raises(VisionError):
            find_pattern(picture, Pattern(columns, rows, 0.025))
    assert board_size(picture) == (9, 6)
    assert len(find_pattern(picture, Pattern(6, 9, 0.025)).corners) == 54


def test_another_charuco_board_is_named():
    texture = charuco(8, 5, 0.7, "5X5_100")
    picture = seen(texture, 0.03 / TEXELS / 2, np.eye(3), np.array([0.0, 0.0, 0.35]))
    with pytest.raises(VisionError, match="they fit --pattern charuco:8x5:"):
        find_pattern(picture, Charuco(9, 6, 0.03, 0.021, "5X5_100"))  # squares instead of corners
    with pytest.raises(VisionError, match=r"they fit --pattern charuco:8x5:.*_100$"):
        find_pattern(picture, Charuco(8, 5, 0.03, 0.021, "5X5_100", old_layout=True))
    texture = charuco(8, 5, 0.7, "5X5_100", old=True)
    old = seen(texture, 0.03 / TEXELS / 2, np.eye(3), np.array([0.0, 0.0, 0.35]))
    with pytest.raises(VisionError, match=r"they fit --pattern charuco:8x5:.*:old$"):
        find_pattern(old, Charuco(8, 5, 0.03, 0.021, "5X5_100"))
    with pytest.raises(VisionError, match="no ChArUco board"):
        find_pattern(picture, Charuco(8, 5, 0.03, 0.021, "6X6_100"))


def test_nothing_is_found_where_nothing_is():
    blank = np.full((*SIZE[::-1], 3), GROUND, dtype=np.uint8)
    for pattern in (BOARD, Charuco(8, 5, 0.03, 0.021, "5X5_100")):
        with pytest.raises(VisionError, match="found"):
            find_pattern(blank, pattern)


@pytest.mark.parametrize("lens", some_of(LENS_MODELS, ["k1", "k1 k2 p1 p2"]))
def test_the_lens_model_is_no_larger_than_needed(lens):
    found = calibrate(true_views(18, 0.05, 5, LENS_MODELS[lens]), BOARD)
    assert found.lens is not None and found.lens.name == lens
    assert len(found.used) == 18
    assert found.intrinsics.matrix == pytest.approx(MATRIX, rel=2e-3, abs=1e-9)


def test_a_lens_too_simple_does_not_mislead_the_next_ones():
    views = true_views(6, 0.03, 3)
    plain, *others = fit_lenses(views[:1] + views[2:], BOARD, TRUE)
    assert plain is not None and not 0.0 < plain.intrinsics.matrix[0, 2] < SIZE[0]
    for fit in others:
        assert fit is not None and fit.intrinsics.matrix == pytest.approx(MATRIX, rel=0.05)


@pytest.mark.slow
def test_a_strong_lens_is_followed_to_the_border():
    strong = (0.3, 0.0, 0.0003, 0.0001, 0.0, 0.8, 0.05, 0.0)
    found = calibrate(true_views(20, 0.02, 2, strong), BOARD)
    assert found.rms < 0.032
    assert found.intrinsics.invertible
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.4, 0.4, 7)), -1)
    points = np.column_stack([grid.reshape(-1, 2), np.ones(63)])
    true = pixels_of(points, np.eye(3), np.zeros(3), MATRIX, strong)
    matrix, d = found.intrinsics.matrix, found.intrinsics.distortion
    computed = pixels_of(points, np.eye(3), np.zeros(3), matrix, d)
    assert np.abs(computed - true).max() < 0.5


def test_standard_deviations_are_honest():
    scores = []
    for seed in range(12):
        fit = fit_camera(true_views(10, 0.1, seed), BOARD, LENSES[3])
        error = (fit.intrinsics.matrix - MATRIX)[[0, 1, 0, 1], [0, 1, 2, 2]]
        scores.append(error / fit.std)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.35


def test_wrong_views_are_left_out_and_corners_too():
    views = true_views(16, 0.05, 7)
    rng = np.random.default_rng(0)
    stretched = views[3].pixels * [1.05, 1.0]
    bent = views[8].pixels + 2.0 * np.sin(views[8].pixels / 40.0)
    noisy = views[11].pixels + rng.normal(0.0, 1.0, views[11].pixels.shape)
    shifted = views[13].pixels.copy()
    shifted[:27] += (2.0, 1.0)  # the board moved while the sensor was read
    for k, pixels in ((3, stretched), (8, bent), (11, noisy), (13, shifted)):
        views[k] = replace(views[k], pixels=pixels)
    glare = views[5].pixels.copy()
    glare[[4, 30]] += 3.0
    views[5] = replace(views[5], pixels=glare)
    views[1] = replace(views[1], edge_width=14.0)
    found = calibrate(views, BOARD)
    assert {k for k, v in enumerate(found.views) if not v.used} == {1, 3, 8, 11, 13}
    assert "blurred" in found.views[1].reason and "does not fit" in found.views[3].reason
    assert found.views[5].used and found.views[5].dropped == 2
    assert all(v.dropped == 0 for k, v in enumerate(found.views) if v.used and k != 5)
    assert found.intrinsics.matrix == pytest.approx(MATRIX, rel=2e-3)


@pytest.mark.slow
def test_views_without_tilt_leave_the_focal_length_open():
    views = []
    rng = np.random.default_rng(0)
    for k in range(10):
        shift = np.array([0.01 * k - 0.05, 0.004 * k - 0.02, 0.45])
        p = pixels_of(BOARD.points, np.eye(3), shift)
        p = p + rng.normal(0.0, 0.05, p.shape)
        views.append(PatternView(f"{k}", *SIZE, np.arange(54), p, 2.5))
    try:
        found = calibrate(views, BOARD)
    except InputError as err:
        assert "tilted" in str(err)
    else:
        assert found.std is not None and found.std[0] > 3.0
        assert any("tilted" in hint for hint in found.hints)
        assert any("focal length is known to" in hint for hint in found.hints)


def test_too_few_views_says_how_many_more():
    with pytest.raises(InputError, match=f"take {LEAST_VIEWS - 4} more"):
        calibrate(true_views(4, 0.05, 0), BOARD)


def test_sizes_must_agree():
    views = true_views(8, 0.05, 0)
    views[4] = replace(views[4], width=640)
    with pytest.raises(InputError, match="view 4: is 640 x 600 px, view 0 800 x 600"):
        calibrate(views, BOARD)
    collector = ViewCollector(BOARD)
    collector.offer("a", np.zeros((60, 80), np.uint8))
    with pytest.raises(InputError, match="b: is 90 x 60 px, a 80 x 60"):
        collector.offer("b", np.zeros((60, 90), np.uint8))


def test_coverage_names_what_is_missing():
    coverage = Coverage(BOARD)
    shifts = [(-0.10, -0.08), (0.10, -0.08), (0.0, 0.0)]
    for x, y in shifts:
        p = pixels_of(BOARD.points, np.eye(3), np.array([x, y, 0.4]))
        coverage.add(PatternView("", *SIZE, np.arange(54), p, 2.5))
    hints = " | ".join(coverage.hints())
    assert "bottom left and bottom right" in hints and "top left" not in hints
    assert "top or bottom tilted" in hints and "left or right side" in hints
    assert "same distance" in hints and "9 more" in hints
    assert coverage.missing() == [
        "corners bottom left, bottom right",
        "tilted up or down",
        "turned sideways",
        "nearer or farther",
    ]
    for view in true_views(40, 0.0, 3, margin=5):
        coverage.add(view)
    assert not coverage.hints() and not coverage.missing()


def test_tilts_are_told_apart():
    for angles, there in (((0.6, 0.0, 0.0), "top or"), ((0.0, 0.6, 0.0), "left or")):
        coverage = Coverage(BOARD)
        for _ in range(3):
            p = pixels_of(BOARD.points, turned(*angles), np.array([0.0, 0.0, 0.4]))
            coverage.add(PatternView("", *SIZE, np.arange(54), p, 2.5))
        hints = " | ".join(coverage.hints())
        assert ("top or" in hints) != ("left or" in hints) and there not in hints


def test_copies_and_stills_of_a_film_count_once():
    texture, texel = chessboard(9, 6), 0.025 / TEXELS
    collector = ViewCollector(BOARD)
    rotation = turned(0.3, 0.2, 0.0)
    first = seen(texture, texel, rotation, np.array([0.0, 0.0, 0.4]))
    near = seen(texture, texel, rotation, np.array([0.006, 0.0, 0.4]), seed=1)
    far = seen(texture, texel, rotation, np.array([0.05, 0.0, 0.4]), seed=2)
    assert collector.offer("first", first, moving=True)
    assert not collector.offer("near", near, moving=True)
    assert collector.offer("far", far, moving=True)
    assert [s.reason for s in collector.skipped] == ["like first"]
    assert not collector.offer("copy", first)
    assert collector.offer("near", near)  # somebody chose this one


def test_a_given_camera_is_checked():
    views = true_views(6, 0.05, 0)
    right = check_camera(views, BOARD, TRUE)
    assert right.rms < 0.1 and right.std is None and not right.hints
    wrong = replace(TRUE, matrix=MATRIX * [[1.1], [1.0], [1.0]])
    found = check_camera(views, BOARD, wrong)
    assert found.rms > 1.0 and "does not fit these views" in found.hints[0]
    with pytest.raises(InputError, match="calibrated for 640 x 480"):
        check_camera(views, BOARD, replace(TRUE, width=640, height=480))


def test_the_pose_and_its_uncertainty():
    rng = np.random.default_rng(4)
    rotation, shift = turned(0.3, -0.2, 0.1), np.array([0.05, -0.02, 0.9])
    p = pixels_of(BOARD.points, rotation, shift)
    scores = []
    for _ in range(60):
        view = PatternView("", *SIZE, np.arange(54), p + rng.normal(0.0, 0.1, p.shape), 2.5)
        pose = locate(view, BOARD, TRUE)
        turn = cv2.Rodrigues(pose.rotation @ rotation.T)[0].ravel()
        error = np.concatenate([turn, pose.translation - shift])
        scores.append(error @ np.linalg.solve(pose.covariance, error) / 6.0)
    assert np.mean(scores) == pytest.approx(1.0, abs=0.35)


def test_what_ros_wrote_is_read(tmp_path):
    file = tmp_path / "ost.yaml"
    file.write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: narrow_stereo\ncamera_matrix:\n"
        "  rows: 3\n  cols: 3\n  data: [520.1, 0, 321.5, 0, 521.2, 240.25, 0, 0, 1]\n"
        "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
        "  data: [0.05, -0.1, 0.001, 0.002, 0]\nrectification_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nprojection_matrix:\n  rows: 3\n  cols: 4\n"
        "  data: [520.1, 0, 321.5, 0, 0, 521.2, 240.25, 0, 0, 0, 1, 0]\n"
    )
    found = read_camera_file(file)
    assert found.matrix.ravel().tolist() == [520.1, 0, 321.5, 0, 521.2, 240.25, 0, 0, 1]
    assert found.distortion == (0.05, -0.1, 0.001, 0.002, 0.0)
    assert (found.width, found.height, found.model) == (640, 480, "plumb_bob")


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial"])
def test_a_camera_file_reads_what_it_writes(tmp_path, model):
    d = (-0.28, 0.1, 9e-4, -7e-4, 0.01, 0.02, 0.03, 0.004)[: 5 if model == "plumb_bob" else 8]
    camera = Intrinsics(MATRIX, d, model, *SIZE)
    file = tmp_path / "camera_info.yaml"
    file.write_text(camera_file(camera, "left", "a comment\nof two lines"))
    found = read_camera_file(file)
    assert found.matrix == pytest.approx(MATRIX) and found.distortion == pytest.approx(d)
    assert (found.width, found.height, found.model) == (*SIZE, model)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "has no image_width"),
        ("[1, 2", "no valid YAML"),
        ("image_width: 640\nimage_height: 480\n", "has no camera_matrix"),
        (camera_file(TRUE).replace("plumb_bob", "equidistant"), "'equidistant'; known are"),
        (camera_file(TRUE).replace("702.0", "0.0"), "not calibrated"),
        (camera_file(TRUE).replace("702.0", ".nan"), "not finite"),
        (camera_file(TRUE).replace("data:", "values:"), "no list of numbers"),
    ],
)
def test_an_unusable_camera_file_is_told(tmp_path, text, reason):
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        read_camera_file(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("text", ["chessboard:9x6:0.025", "charuco:8x5:0.028:0.02:5X5_100"])
def test_a_printed_pattern_is_found_in_its_true_size(tmp_path, text):
    pattern = parse_pattern(text)
    file = tmp_path / "pattern.png"
    assert print_pattern(pattern, file) == "A4"
    picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    assert picture.shape == pytest.approx(
        (0.210 / INCH * RESOLUTION, 0.297 / INCH * RESOLUTION), abs=1
    )
    view = find_pattern(picture, pattern)
    assert len(view.corners) == len(pattern.points)
    flat = view.pixels * INCH / RESOLUTION
    centred = flat - flat.mean(axis=0)
    # A chessboard reads the same after half a turn.
    error = min(np.abs(centred - sign * pattern.points[:, :2]).max() for sign in (1, -1))
    assert error < 1e-4


def test_patterns_are_printed_as_vectors_too(tmp_path):
    for suffix in ("pdf", "svg"):
        print_pattern(BOARD, tmp_path / f"pattern.{suffix}")
    assert b"/MediaBox [ 0 0 841.8" in (tmp_path / "pattern.pdf").read_bytes()
    assert 'width="841.8' in (tmp_path / "pattern.svg").read_text()
    assert print_pattern(Pattern(30, 20, 0.1), tmp_path / "large.pdf") == "3220 x 2230 mm"
    with pytest.raises(InputError, match=r"ends in \.pdf, \.png, \.svg"):
        print_pattern(BOARD, tmp_path / "pattern.gif")
