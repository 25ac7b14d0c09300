# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The tool `calibrate`: files and bags in; camera_info.yaml, board.yaml, report and reasons out."""

import contextlib
import io
import os
import re

import cv2
import numpy as np
import pytest
import yaml
from calibration_scenes import (
    DISTORTION,
    MATRIX,
    SIZE,
    TEXELS,
    charuco,
    chessboard,
    poses,
    turned,
    usual_lens,
)
from conftest import ROOT
from ordinary import some_of
from scipy.spatial.transform import Rotation

from dlo_ros.cli import main as cli
from dlo_ros.parameter_file import read_parameter_file
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    compressed_message,
    float_message,
    image_message,
)
from dlo_ros.vision.calibration.camera_file import read_camera_file
from dlo_ros.vision.calibration.patterns import parse_pattern

PATTERN = "chessboard:9x6:0.025"
CHARUCO = "charuco:8x5:0.03:0.022:5X5_100"
# The board's axes x, y, z (columns) in the pattern's frame: right, into the sheet, up.
BOARD_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
BOARD_ROTATION, BOARD_SHIFT = turned(0.25, -0.2, 0.04), np.array([0.06, -0.04, 1.0])


def run(capsys, *words):
    """Status, and what was printed; never a traceback."""
    status = cli.main(["calibrate", *map(str, words)])
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err
    return status, printed.out, printed.err


def refused(capsys, *words):
    status, _, err = run(capsys, *words)
    lines = [line for line in err.splitlines() if not line.startswith("WARNING")]
    assert status == 2 and len(lines) == 1, err
    return lines[0]


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """A folder of good chessboard views, with one blurred, one torn and one stretched."""
    folder = tmp_path_factory.mktemp("views")
    rng = np.random.default_rng(11)
    texture, texel, lens = chessboard(9, 6), 0.025 / TEXELS, usual_lens()
    points = parse_pattern(PATTERN).points
    for k, (rotation, shift) in enumerate(poses(17, points, rng)):
        picture = lens.picture(texture, texel, rotation, shift, rng)
        if k == 4:
            picture = cv2.blur(picture, (15, 1))
        if k == 9:  # the board moved while the sensor was read, row after row
            slid = cv2.warpAffine(picture, np.array([[1.0, 0.012, -3.0], [0.0, 1.0, 0.0]]), SIZE)
            picture = np.where(np.arange(SIZE[1])[:, None] < 300, picture, slid)
        if k == 13:
            stretch = np.array([[1.06, 0.0, -24.0], [0.0, 1.0, 0.0]])
            picture = cv2.warpAffine(picture, stretch, SIZE)
        cv2.imwrite(str(folder / f"view{k:02d}.png"), picture)
    (folder / "notes.txt").write_text("not a picture")
    return folder


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """The pattern on the board, a metre away."""
    file = tmp_path_factory.mktemp("board") / "board.png"
    rng = np.random.default_rng(5)
    texture, texel = chessboard(9, 6), 0.025 / TEXELS
    picture = usual_lens().picture(texture, texel, BOARD_ROTATION, BOARD_SHIFT, rng)
    cv2.imwrite(str(file), picture)
    return file


@pytest.fixture(scope="module")
def true_camera(tmp_path_factory):
    """What ROS would have written of the true camera."""
    file = tmp_path_factory.mktemp("camera") / "ost.yaml"
    tree = {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": "narrow",
        "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX.ravel().tolist()},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": list(DISTORTION)},
    }
    file.write_text(yaml.safe_dump(tree))
    return file


def pose_error(file, rotation=BOARD_ROTATION, shift=BOARD_SHIFT):
    """Distance [m] and angle [deg] of a board.yaml from the pattern's true pose."""
    values = read_parameter_file(file)
    found = Rotation.from_quat(values["camera.rotation"])
    angle = (found.inv() * Rotation.from_matrix(rotation @ BOARD_AXES)).magnitude()
    return np.linalg.norm(np.array(values["camera.translation"]) - shift), np.degrees(angle)


@pytest.fixture(scope="module")
def result(tmp_path_factory, views, board):
    """What the tool makes of the views and the board, and what it prints."""
    output = tmp_path_factory.mktemp("result") / "new" / "camera"
    printed = io.StringIO()
    words = ["--pattern", PATTERN, "--output", output, "--board", board, views]
    with contextlib.redirect_stdout(printed):
        assert cli.main(["calibrate", *map(str, words)]) == 0
    return output, printed.getvalue()


def test_the_camera_and_the_board_are_found(result):
    output, out = result
    camera = read_camera_file(output / "camera_info.yaml")
    focal = camera.matrix[[0, 1], [0, 1]]
    assert focal == pytest.approx(MATRIX[[0, 1], [0, 1]], rel=2e-3)
    assert camera.matrix[:2, 2] == pytest.approx(MATRIX[:2, 2], abs=1.5)
    distance, angle = pose_error(output / "board.yaml")
    assert distance < 1e-3 and angle < 0.1
    for name, reason in (("view04", "blurred"), ("view13", "does not fit")):
        assert re.search(rf"{name}\.png.*left out, {reason}", out)
    assert not re.search(r"view0[0-3]\.png.*left out", out)
    assert "error [px]" in out
    assert re.search(r"view09\.png.*(left out|no chessboard)", out)
    html = (output / "report.html").read_text()
    assert "fx" in html and "view13.png" in html and "data:image/jpeg;base64," in html
    assert "http://" not in html and "https://" not in html
    assert "src=" in html and 'src="data:' in html


def test_camera_info_is_what_camera_info_manager_reads(result):
    tree = yaml.safe_load((result[0] / "camera_info.yaml").read_text())
    shapes = {
        "camera_matrix": (3, 3),
        "rectification_matrix": (3, 3),
        "projection_matrix": (3, 4),
        "distortion_coefficients": (1, 5),
    }
    for name, (rows, columns) in shapes.items():
        matrix = tree[name]
        assert (matrix["rows"], matrix["cols"], len(matrix["data"])) == (
            rows,
            columns,
            rows * columns,
        )
        assert all(isinstance(v, float) for v in matrix["data"])
    assert (tree["image_width"], tree["image_height"]) == SIZE
    assert tree["distortion_model"] == "plumb_bob" and tree["camera_name"] == "camera"


def test_board_yaml_merges_into_a_parameter_file(capsys, tmp_path, board, true_camera):
    words = ("--pattern", PATTERN, "--output", tmp_path, "--board", board)
    status, out, _ = run(capsys, *words, "--camera-info", true_camera)
    assert status == 0 and "the board at 1.00" in out
    values = read_parameter_file(ROOT / "config" / "default.yaml")
    settings = Settings.from_mapping(values | read_parameter_file(tmp_path / "board.yaml"))
    assert settings.camera.translation == pytest.approx(BOARD_SHIFT, abs=1e-3)
    # ROS 2 takes numbers of a list only where all are of one type.
    tree = yaml.safe_load((tmp_path / "board.yaml").read_text())
    for numbers in tree["/**"]["ros__parameters"]["camera"].values():
        assert all(isinstance(v, float) for v in numbers)


@pytest.mark.parametrize("turn", some_of([0.0, 90.0, 180.0, 270.0], [90.0]))
@pytest.mark.parametrize("pattern", [PATTERN, "chessboard:7x7:0.03", CHARUCO])
def test_up_does_not_depend_on_how_the_pattern_lies(capsys, tmp_path, true_camera, pattern, turn):
    """The pattern may lie in any of its four ways; the camera says what is up."""
    read = parse_pattern(pattern)
    if pattern == CHARUCO:
        texture, texel = charuco(8, 5, 0.022 / 0.03, "5X5_100"), 0.03 / TEXELS / 2
    else:
        texture, texel = chessboard(read.columns, read.rows), read.square / TEXELS
    rotation, shift = turned(0.2, 0.25, 0.1), np.array([0.02, 0.01, 0.6])
    laid = rotation @ turned(0.0, 0.0, np.radians(turn))
    picture = usual_lens().picture(texture, texel, laid, shift, np.random.default_rng(0))
    cv2.imwrite(str(tmp_path / "board.png"), picture)
    words = ("--pattern", pattern, "--output", tmp_path, "--board", tmp_path / "board.png")
    assert run(capsys, *words, "--camera-info", true_camera)[0] == 0
    distance, angle = pose_error(tmp_path / "board.yaml", rotation, shift)
    assert distance < 1e-3 and angle < 0.15
    for up, degrees in (("right", 90.0), ("bottom", 180.0), ("left", 270.0)):
        assert run(capsys, *words, "--camera-info", true_camera, "--up", up)[0] == 0
        turned_board = rotation @ turned(0.0, 0.0, np.radians(degrees))
        assert pose_error(tmp_path / "board.yaml", turned_board, shift)[1] < 0.15


def test_the_origin_is_where_it_is_wanted(capsys, tmp_path, board, true_camera):
    at = np.array([0.3, 0.002, -0.1])
    words = ("--pattern", PATTERN, "--output", tmp_path, "--board", board)
    assert run(capsys, *words, "--camera-info", true_camera, "--pattern-at", *at)[0] == 0
    origin = BOARD_SHIFT - BOARD_ROTATION @ BOARD_AXES @ at
    distance, angle = pose_error(tmp_path / "board.yaml", BOARD_ROTATION, origin)
    assert distance < 1.2e-3 and angle < 0.1


@pytest.mark.slow
def test_views_of_a_bag(capsys, tmp_path, views):
    bag = tmp_path / "recording"
    files = sorted(views.glob("view0*.png"))
    with BagWriter(bag) as writer:
        for k, file in enumerate(files):
            for repeat in range(4):  # held still, at 10 Hz; every other picture is looked at
                stamp = 1_000_000_000 + (4 * k + repeat) * 100_000_000
                message = compressed_message(BAG_MESSAGES, stamp, "camera", file.read_bytes())
                writer.write("image_raw/compressed", message, stamp)
    words = ("--pattern", PATTERN, "--output", tmp_path / "out")
    status, out, err = run(capsys, *words, bag)
    assert status == 0, err
    camera = read_camera_file(tmp_path / "out" / "camera_info.yaml")
    assert camera.matrix[0, 0] == pytest.approx(MATRIX[0, 0], rel=2e-3)
    assert re.search(r"over [78] of (9|10) views", out) and "like recording" in out


def test_the_camera_of_a_bag_with_several_is_chosen(capsys, tmp_path):
    bag, nothing = tmp_path / "recording", np.full((48, 64, 3), 128, dtype=np.uint8)
    with BagWriter(bag) as writer:
        for k, name in enumerate(("left", "right")):
            for stamp in range(10**9, (2 + k) * 10**9, 10**9):
                image = image_message(BAG_MESSAGES, stamp, name, nothing)
                writer.write(f"{name}/image_raw", image, stamp)
        writer.write("top/dlo/err", float_message(BAG_MESSAGES, 0.0), 10**9)
    words = ("--pattern", PATTERN, "--output", tmp_path / "out", bag)
    said = refused(capsys, *words)
    assert "has images of several cameras (/left/image_raw, /right/image_raw); say which" in said
    assert "--camera-name left for left/image_raw" in said
    assert "in none of 1 images" in refused(capsys, "--camera-name", "left", *words)
    assert "in none of 2 images" in refused(capsys, "--camera-name", "right", *words)
    said = refused(capsys, "--camera-name", "top", *words)
    assert "has no images of the camera 'top' (it has /left/image_raw, /right/image_raw)" in said
    assert "record top/image_raw" in said


@pytest.mark.slow
def test_a_charuco_board_seen_in_part(capsys, tmp_path):
    """Views that run over the image's border, so that its corners are reached."""
    rng = np.random.default_rng(4)
    texture, texel, lens = charuco(8, 5, 0.022 / 0.03, "5X5_100"), 0.03 / TEXELS / 2, usual_lens()
    for k, pose in enumerate(poses(12, parse_pattern(CHARUCO).points, rng, margin=-90)):
        picture = lens.picture(texture, texel, *pose, rng)
        cv2.imwrite(str(tmp_path / f"view{k:02d}.png"), picture)
    output = tmp_path / "out"
    status, out, _ = run(capsys, "--pattern", CHARUCO, "--output", output, tmp_path)
    assert status == 0 and re.search(r"over 1[12] of 12 views", out)
    matrix = read_camera_file(output / "camera_info.yaml").matrix
    assert matrix[[0, 1], [0, 1]] == pytest.approx(MATRIX[[0, 1], [0, 1]], rel=2e-3)
    assert matrix[:2, 2] == pytest.approx(MATRIX[:2, 2], abs=1.5)


@pytest.mark.slow
def test_a_given_camera_is_checked_and_kept(capsys, tmp_path, views, true_camera):
    words = ("--pattern", PATTERN, "--output", tmp_path, "--camera-info", true_camera)
    status, out, _ = run(capsys, *words, views)
    assert status == 0 and "view00.png" in out
    camera = read_camera_file(tmp_path / "camera_info.yaml")
    assert camera.matrix == pytest.approx(MATRIX)
    assert camera.distortion == pytest.approx(DISTORTION)


def test_one_view_checks_a_given_camera(capsys, tmp_path, views, true_camera):
    words = ("--pattern", PATTERN, "--output", tmp_path, "--camera-info", true_camera)
    status, out, _ = run(capsys, *words, views / "view00.png")
    assert status == 0 and "px over 1 of 1 views" in out


@pytest.mark.slow
def test_hints_name_missing_views(capsys, tmp_path, views):
    files = sorted(views.glob("*.png"))[:9]
    status, out, _ = run(capsys, "--pattern", PATTERN, "--output", tmp_path, *files)
    assert status == 0 and re.search(r"hint: \d views; \d more", out)
    assert not (tmp_path / "board.yaml").exists()  # nobody showed the board
    assert "more make the result safer" in (tmp_path / "report.html").read_text()


def test_a_pattern_to_print(capsys, tmp_path):
    status, out, _ = run(capsys, "--pattern", PATTERN, "--print-pattern", tmp_path / "p.pdf")
    assert status == 0 and "250 x 175 mm, on A4" in out
    assert (tmp_path / "p.pdf").read_bytes().startswith(b"%PDF")


def test_bad_arguments_are_told_in_a_line(capsys, tmp_path, views, true_camera):
    output = ("--output", tmp_path)
    assert "no INPUT" in refused(capsys, "--pattern", PATTERN, *output)
    assert "--output is missing" in refused(capsys, "--pattern", PATTERN, views)
    assert "9x6 such" not in refused(capsys, "--pattern", "chessboard:9:0.025", *output, views)
    line = refused(capsys, "--pattern", PATTERN, *output, "--camera-info", true_camera)
    assert "--board" in line
    line = refused(capsys, "--pattern", PATTERN, *output, "--camera-info", tmp_path / "no", views)
    assert "no: cannot be read" in line
    nan = ("--pattern-at", "nan", "0", "0")
    assert "three lengths" in refused(capsys, "--pattern", PATTERN, *output, *nan, views)


def test_bad_inputs_are_told_in_a_line(capsys, tmp_path, views):
    words = ("--pattern", PATTERN, "--output", tmp_path / "out")
    assert "nowhere: no such file" in refused(capsys, *words, tmp_path / "nowhere")
    assert "notes.txt: is no image" in refused(capsys, *words, views / "notes.txt")
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "has no images" in refused(capsys, *words, empty)
    cut = tmp_path / "cut.png"
    cut.write_bytes((views / "view00.png").read_bytes()[:30])
    assert "cut.png: is no image" in refused(capsys, *words, cut)
    assert "board.png: no such file" in refused(
        capsys, *words, "--board", tmp_path / "board.png", views
    )
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.full((300, 400), 90, np.uint8))
    line = refused(capsys, *words, views / "view00.png", small)
    assert "small.png: is 400 x 300 px, view00.png 800 x 600" in line
    line = refused(capsys, *words, small)
    assert "chessboard of 9 x 6 inner corners: in none of 1 images" in line
    few = [views / f"view0{k}.png" for k in range(4)]
    assert "take 2 more" in refused(capsys, *words, *few)
    assert "take 5 more" in refused(capsys, *words, *[few[0]] * 8)


def test_a_wrong_size_is_told_with_the_right_one(capsys, tmp_path, views):
    words = ("--output", tmp_path, *sorted(views.glob("view0[0-2].png")))
    line = refused(capsys, "--pattern", "chessboard:10x7:0.025", *words)
    assert "they show a chessboard of 9 x 6 inner corners" in line


@pytest.mark.slow
def test_a_broken_picture_in_a_folder_is_passed_over(capsys, tmp_path, views, caplog):
    folder = tmp_path / "mixed"
    folder.mkdir()
    for k in range(8):
        (folder / f"view{k}.png").symlink_to(views / f"view{k:02d}.png")
    (folder / "aaa.jpg").write_bytes(b"\xff\xd8 no picture")
    assert run(capsys, "--pattern", PATTERN, "--output", tmp_path / "out", folder)[0] == 0
    assert "aaa.jpg: is no image" in caplog.text


def test_an_unusable_output_is_told_before_the_work(capsys, tmp_path, views, monkeypatch):
    monkeypatch.setattr("dlo_ros.cli.calibrate.ViewCollector", None)  # nothing is looked at
    words = ("--pattern", PATTERN, views, "--output")
    file = tmp_path / "file"
    file.write_text("")
    assert "file: is a file" in refused(capsys, *words, file)
    assert "cannot be written" in refused(capsys, *words, file / "below")
    if os.geteuid():  # root may write everywhere
        closed = tmp_path / "closed"
        closed.mkdir(mode=0o500)
        assert "cannot be written" in refused(capsys, *words, closed)


def test_the_board_must_show_the_pattern(capsys, tmp_path, true_camera, board):
    words = ("--pattern", PATTERN, "--output", tmp_path, "--camera-info", true_camera, "--board")
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full(SIZE[::-1], 90, np.uint8))
    assert "blank.png: no chessboard of 9 x 6" in refused(capsys, *words, blank)
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), cv2.resize(cv2.imread(str(board)), (640, 480)))
    assert "small.png: is 640 x 480 px; the camera was calibrated" in refused(capsys, *words, small)
