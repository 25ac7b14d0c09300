# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Photographs without parameters, the tool `observe`, and measured photographs."""

import json
import sys

import cv2
import numpy as np
import pytest
from picture_bags import STAMP, write_bag
from scipy.spatial import cKDTree
from vision_scenes import Scene, bow, clamps, loop, render, settings

from dlo_ros.cli import main as cli
from dlo_ros.recordings import (
    read_recording,
)
from dlo_ros.spline import SplineBasis
from dlo_ros.vision import contact_sheet
from dlo_ros.vision.contact_sheet import sheet
from dlo_ros.vision.overlay import OBSERVED, draw_overlay
from dlo_ros.vision.photograph import find_dlos
from dlo_ros.vision.segmentation.picture_strip import resample


def share_within(truth, pixels, limit):
    """Share of a true centreline that lies within a distance [px] of an observed one."""
    distance, _ = cKDTree(resample(pixels, 0.5)).query(truth)
    return np.mean(distance < limit)


def read_table(path):
    assert path.read_text().splitlines()[0] == "dlo,u,x_px,y_px"
    rows = path.read_text().splitlines()[1:]
    return np.array([[float(v) for v in row.split(",")] for row in rows])


def true_pixels(xz, scene):
    return scene.camera().project(np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]]))


def test_photograph_of_one_rope():
    scene, xz = Scene(noise=4.0, texture=15.0, gradient=40.0), loop()
    (dlo,) = find_dlos(render(xz, scene))
    truth = true_pixels(xz, scene)
    assert share_within(truth, dlo.pixels, 0.7) > 0.98
    assert dlo.u[0] == 0.0 and dlo.u[-1] == 1.0 and np.all(np.diff(dlo.u) > 0)
    assert dlo.pixels[0, 0] < dlo.pixels[-1, 0]
    # Right through the crossing: the points of equal u are the same points.
    expected = np.column_stack(
        [np.interp(dlo.u, np.linspace(0, 1, len(truth)), c) for c in truth.T]
    )
    assert np.max(np.hypot(*(dlo.pixels - expected).T)) < 8.0


def test_two_ropes_that_cross_stay_apart():
    scene, xz = Scene(), bow()
    other = np.column_stack([np.linspace(-0.08, 0.05, 500), np.linspace(-0.09, 0.04, 500)])
    scene.extra = [("below", other, (60, 60, 160))]
    dlos = find_dlos(render(xz, scene))
    assert len(dlos) == 2
    for truth, dlo in ((xz, dlos[0]), (other, dlos[1])):
        assert share_within(true_pixels(truth, scene), dlo.pixels, 1.0) > 0.97


def test_holes_edges_and_noise_are_no_ropes():
    scene = Scene(holes=0.03, extra=[("box", 100, 100, 400, 300, (120, 130, 140))])
    assert find_dlos(render(None, scene)) == []
    noise = np.random.default_rng(1).integers(0, 255, (300, 400, 3)).astype(np.uint8)
    assert find_dlos(noise) == []


def test_observe_image_files(tmp_path, capsys):
    scene, xz = Scene(), bow()
    cv2.imwrite(str(tmp_path / "rope.png"), render(xz, scene))
    cv2.imwrite(str(tmp_path / "empty.jpg"), np.full((200, 300, 3), 150, np.uint8))
    out = tmp_path / "out"
    files = [str(tmp_path / "rope.png"), str(tmp_path / "empty.jpg")]
    assert cli.main(["observe", "--output", str(out), *files]) == 0
    table = read_table(out / "rope.csv")
    assert set(table[:, 0]) == {0.0}
    assert table[0, 1] == 0.0 and table[-1, 1] == 1.0
    assert share_within(true_pixels(xz, scene), table[:, 2:], 0.7) > 0.98
    assert len(read_table(out / "empty.csv")) == 0
    marked = cv2.imread(str(out / "rope.png"))
    assert marked.shape == (540, 960, 3)
    green = np.all(np.abs(marked.astype(int) - OBSERVED) < 40, axis=2)
    assert 500 < np.count_nonzero(green) < 20000
    assert "no credible DLO found" in capsys.readouterr().out


def test_exif_rotation_is_obeyed(tmp_path):
    scene, xz = Scene(), bow()
    image = render(xz, scene)
    data = cv2.imencode(".jpg", np.ascontiguousarray(np.rot90(image)))[1].tobytes()
    # Orientation 6: the picture is to be turned by 90 degrees clockwise.
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    (tmp_path / "phone.jpg").write_bytes(data[:2] + segment + data[2:])
    assert cli.main(["observe", "--output", str(tmp_path), str(tmp_path / "phone.jpg")]) == 0
    table = read_table(tmp_path / "phone.csv")
    assert share_within(true_pixels(xz, scene), table[:, 2:], 1.0) > 0.98


def test_observe_a_bag(tmp_path, capsys):
    scene, xz = Scene(), bow()
    blank = np.full((540, 960, 3), 200, np.uint8)
    command = clamps(xz).commands[0]
    pictures = [render(xz, scene), blank, render(xz, scene)]
    write_bag(tmp_path / "bag", scene, pictures, command)
    known = settings(scene)
    known.dump(tmp_path / "params.yaml")
    words = ["observe", "--params", str(tmp_path / "params.yaml"), "--overlays"]
    words += [str(tmp_path / "marked"), "--output", str(tmp_path / "out"), str(tmp_path / "bag")]
    assert cli.main(words) == 0
    assert "2 of 3 images" in capsys.readouterr().out
    recording = read_recording(tmp_path / "out", known)
    assert [o.stamp for o in recording.observations] == [STAMP, STAMP + 66_000_000]
    assert len(recording.commands) == 1 and recording.has_images
    observation = recording.observations[0]
    assert observation.points is not None
    assert np.hypot(*(observation.control_points[-1, [0, 2]] - xz[-1])) < 0.001
    assert len(list((tmp_path / "marked").glob("*.png"))) == 3
    # The output stays as it is without --force, and gives way with it.
    assert cli.main(words) == 2
    assert cli.main([*words, "--force"]) == 0


def test_bag_without_a_rope_says_why(tmp_path, capsys):
    scene = Scene()
    write_bag(tmp_path / "bag", scene, [np.full((540, 960, 3), 200, np.uint8)])
    settings(scene).dump(tmp_path / "params.yaml")
    out = tmp_path / "out"
    words = ["observe", "--params", str(tmp_path / "params.yaml"), "--output", str(out)]
    assert cli.main([*words, str(tmp_path / "bag")]) == 2
    assert "no image shows a credible DLO" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.jpg", None, "no such file"),
        ("broken.jpg", b"\xff\xd8\xff\xe0 no picture", "no image that can be read"),
        ("empty.png", b"", "no image that can be read"),
        ("text.csv", b"a,b\n", "no image that can be read"),
    ],
)
def test_unreadable_files_are_refused(tmp_path, capsys, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert cli.main(["observe", "--output", str(tmp_path / "out"), str(tmp_path / name)]) == 2
    message = capsys.readouterr().err
    assert words in message and name in message and message.count("\n") == 1


def test_misuse_is_explained(tmp_path, capsys):
    scene = Scene()
    picture = tmp_path / "rope.png"
    cv2.imwrite(str(picture), render(bow(), scene))
    write_bag(tmp_path / "bag", scene, [render(bow(), scene)])
    (tmp_path / "views").mkdir()
    (tmp_path / "views" / "rope.png").write_bytes(picture.read_bytes())
    out = str(tmp_path / "out")
    cases = [
        (["observe", "--output", str(tmp_path), str(picture)], "would be overwritten"),
        (["observe", "--output", out, str(tmp_path / "bag")], "--params"),
        (["observe", "--output", out, str(tmp_path / "bag"), str(picture)], "one bag"),
        (["observe", "--output", out, str(picture), str(picture)], "same name"),
        (["observe", "--output", out, str(tmp_path / "views")], "views: is a folder of pictures"),
        (["observe", "--output", out, "--overlays", out, str(picture)], "--overlays and"),
        (["observe", "--output", out, "--control-points", "9", str(picture)], "are for bags"),
        (["observe", "--output", str(picture), str(picture)], "is a file"),
    ]
    for words, expected in cases:
        assert cli.main(words) == 2
        assert expected in capsys.readouterr().err


def test_overlay_and_contact_sheet(tmp_path):
    scene, xz = Scene(), bow()
    image = render(xz, scene)
    drawn = draw_overlay(image, scene.camera(), 0.4, None, message="nothing found")
    assert drawn.shape == image.shape and np.any(drawn != image)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    picture = sheet([tmp_path / "a.png", tmp_path / "a.png"])
    assert picture.shape == (480, 960, 3)


def test_contact_sheet_as_a_command(tmp_path, monkeypatch, capsys):
    cv2.imwrite(str(tmp_path / "a.png"), render(bow(), Scene()))

    def make(output: str, *photos: str) -> int:
        words = ["contact_sheet", "--output", str(tmp_path / output)]
        monkeypatch.setattr(sys, "argv", [*words, *(str(tmp_path / p) for p in photos)])
        return contact_sheet.main()

    assert make("sheet.png", "a.png") == 0
    assert cv2.imread(str(tmp_path / "sheet.png")).shape == (480, 480, 3)
    assert make("other.png", "a.png", "none.png") == 2
    assert "none.png: is no image that can be read" in capsys.readouterr().err
    assert make("sheet.xyz", "a.png") == 2
    assert "sheet.xyz: is written as PNG" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "sheet.png"]


def test_black_wire_and_not_the_bracket(shared_data, tmp_path):
    folder = shared_data / "hanging_loop" / "black"
    words = ["observe", "--params", str(folder / "params.yaml"), "--output", str(tmp_path / "out")]
    assert cli.main([*words, str(folder / "photo0")]) == 0
    from dlo_ros.cli.observe import observe_recording
    from dlo_ros.parameters import Settings

    known = Settings.load(folder / "params.yaml")
    recording = read_recording(tmp_path / "out", known)
    assert len(recording.observations) == 3
    frame = next(iter(observe_recording(folder / "photo0", known)))
    upright = np.loadtxt(folder / "photo0_centreline_upright_px.csv", delimiter=",")
    truth = np.column_stack([upright[:, 1], 2999 - upright[:, 0]])
    pixels = frame.camera.project(recording.observations[0].points.positions)
    distance, _ = cKDTree(resample(pixels, 0.5)).query(truth)
    assert np.mean(distance < 3.0) > 0.95
    assert np.mean(np.sort(distance)[: int(0.95 * len(distance))]) < 1.0
    # Fourteen control points cannot follow this wire; what they can is across it, not along.
    spline = SplineBasis(known.rod.control_points, known.rod.length).evaluate(
        recording.observations[0].control_points[:, :3], np.linspace(0.0, known.rod.length, 4000)
    )
    beside, _ = cKDTree(frame.camera.project(spline)).query(truth)
    assert np.mean(np.sort(beside)[: int(0.95 * len(beside))]) < 3.0
    # On to the clamp, in front of the bracket.
    clamp = frame.camera.project(np.array([[-0.12546634, 0.0, 0.0025606]]))
    assert np.hypot(*(frame.result.pixels[-1] - clamp[0])) < 10.0


def test_translucent_wire_is_right_or_not_found(shared_data, tmp_path, capsys):
    folder = shared_data / "hanging_loop" / "white"
    words = ["observe", "--params", str(folder / "params.yaml"), "--output", str(tmp_path / "out")]
    status = cli.main([*words, str(folder / "photo0")])
    if status == 2:
        assert "no image shows a credible DLO" in capsys.readouterr().err
        return
    from dlo_ros.cli.observe import observe_recording
    from dlo_ros.parameters import Settings

    frame = next(iter(observe_recording(folder / "photo0", Settings.load(folder / "params.yaml"))))
    clicks = np.loadtxt(folder / "photo0_clicked_upright_px.csv", delimiter=",")
    truth = np.column_stack([clicks[:, 1], 2999 - clicks[:, 0]])
    assert share_within(truth, frame.result.pixels, 25.0) > 0.9


def test_photographs_on_plain_ground(shared_data):
    folder = shared_data / "images"
    info = {entry["file"]: entry for entry in json.loads((folder / "info.json").read_text())}
    for name in ("S1_0", "S1_10", "S1_50", "S2_0", "S3_0"):
        image = cv2.imread(str(folder / "mbest_GPL3" / f"{name}.jpg"))
        labels = cv2.imread(str(folder / "mbest_GPL3" / f"{name}_labels.png"), -1)
        dlos = find_dlos(image)
        assert len(dlos) == info[f"mbest_GPL3/{name}.jpg"]["instances"]
        height, width = labels.shape
        covered = set()
        for dlo in dlos:
            x, y = np.rint(dlo.pixels.T).astype(int).clip(0, [[width - 1], [height - 1]])
            on = labels[y, x]
            label = np.bincount(on[on > 0]).argmax()
            covered.add(label)
            # One DLO from end to end: off its own label at crossings only.
            assert np.mean(on == label) > 0.93
            assert np.mean(on == 0) < 0.02
        assert len(covered) == len(dlos)


def test_photographs_of_the_black_wire(shared_data):
    folder = shared_data / "images" / "hanging_wires_MIT"
    (dlo,) = find_dlos(cv2.imread(str(folder / "black0.jpg")))
    truth = np.loadtxt(folder / "black0_centreline_px.csv", delimiter=",")
    assert share_within(truth, dlo.pixels, 3.0) > 0.95
    assert find_dlos(cv2.imread(str(folder / "white0.jpg"))) == []
