# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What the user knows of where the DLO is: region, colour, masks, the empty board."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ribbons import even, holding, looking, picture, settings_of
from vision_scenes import Scene, across_errors, bow, curve_from_curvature, render, settings

from dlo_ros.cli import main as cli
from dlo_ros.cli.observe import observe_recording
from dlo_ros.errors import InputError, ParameterError, VisionError
from dlo_ros.parameters import Settings, VisionParameters
from dlo_ros.recordings import BAG_MESSAGES, BagWriter, command_message
from dlo_ros.recordings.image_building import camera_info_message, depth_message, image_message
from dlo_ros.recordings.images import CameraInfo
from dlo_ros.vision import Camera, Observer
from dlo_ros.vision.photograph import find_dlos
from dlo_ros.vision.segmentation.user_hints import Hints

# Two ropes alike, side by side: without a hint nobody knows which one is meant.
OWN = bow()
TWIN = bow() + np.array([0.0, 0.09])
BLUE, RED = (170, 70, 40), (40, 50, 190)


def scene_with(other):
    return Scene(rope=BLUE, extra=[("below", TWIN, other)], size=(960, 900))


def find(scene, image, mask=None, **known):
    parameters = replace(settings(scene), vision=VisionParameters(**known))
    observer = Observer(parameters, scene.camera())
    observer.mask = mask
    result = observer.observe(0, image)
    across, _ = across_errors(result.observation.points.positions[:, [0, 2]], OWN)
    return np.abs(across).max() * scene.width_px / scene.diameter


def test_without_a_hint_two_ropes_alike_are_ambiguous():
    scene = scene_with(BLUE)
    with pytest.raises(VisionError, match="equally plausible"):
        find(scene, render(OWN, scene))


def own_mask(scene, image):
    pixels = scene.camera().project(np.insert(OWN, 1, 0.0, axis=1))
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.polylines(mask, [np.int32(pixels)], False, 255, 12)
    return mask


def test_mask_tells_which_rope(tmp_path):
    scene = scene_with(BLUE)
    image = render(OWN, scene)
    mask = own_mask(scene, image)
    assert find(scene, image, mask=mask) < 1.0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    known = VisionParameters(mask=str(tmp_path / "mask.png"))
    observer = Observer(replace(settings(scene), vision=known), scene.camera())
    assert observer.observe(0, image).fraction_seen > 0.9
    assert observer.observe(33_000_000, image).tracked


def test_colour_tells_which_rope():
    scene = scene_with(RED)
    image = render(OWN, scene)
    blue = {"colour_low": (95.0, 60.0, 40.0), "colour_high": (130.0, 255.0, 255.0)}
    assert find(scene, image, **blue) < 1.0
    # The hues of the other one, over red.
    with pytest.raises((VisionError, AssertionError)):
        red = {"colour_low": (165.0, 60.0, 40.0), "colour_high": (15.0, 255.0, 255.0)}
        assert find(scene, image, **red) < 1.0


def test_region_tells_which_rope():
    scene = scene_with(BLUE)
    image = render(OWN, scene)
    pixels = scene.camera().project(np.insert(OWN, 1, 0.0, axis=1))
    low, high = pixels.min(axis=0) - 20, pixels.max(axis=0) + 20
    region = tuple(float(v) for v in (*low, *(high - low)))
    assert find(scene, image, region=region) < 1.0


def test_empty_board_tells_the_rope_from_what_lies_there(tmp_path):
    scene = scene_with(BLUE)
    board = render(None, replace(scene, seed=5))
    cv2.imwrite(str(tmp_path / "board.png"), board)
    brighter = cv2.convertScaleAbs(render(OWN, scene), alpha=1.06)
    assert find(scene, brighter, empty_board=str(tmp_path / "board.png")) < 1.0


def test_gripper_of_the_ropes_colour_is_left_out_where_a_mask_says_so():
    # A free end that goes on into a bar of its own colour has no end without the mask.
    away = OWN[-1] - OWN[-9]
    tail = curve_from_curvature(0.0, OWN[-1], np.arctan2(away[1], away[0]), 0.05)
    scene = Scene(rope=BLUE, extra=[("below", tail, BLUE)])
    image = render(OWN, scene)
    mask = np.full(image.shape[:2], 255, np.uint8)
    end = scene.camera().project(np.array([[*OWN[-1][:1], 0.0, OWN[-1][1]]]))[0]
    pixels = scene.camera().project(np.insert(tail[40:], 1, 0.0, axis=1))
    cv2.polylines(mask, [np.int32(pixels)], False, 0, 16)
    known = Observer(settings(scene), scene.camera())
    known.mask = mask
    result = known.observe(0, image)
    ends = result.pixels[[0, -1]]
    assert np.hypot(*(ends - end).T).min() < 8.0


def test_unusable_hints_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"vision\.empty_board is 'nowhere\.png'"):
        Hints(VisionParameters(empty_board="nowhere.png"))
    scene = Scene()
    cv2.imwrite(str(tmp_path / "small.png"), np.full((200, 300), 255, np.uint8))
    for name in ("mask", "empty_board"):
        hints = Hints(VisionParameters(**{name: str(tmp_path / "small.png")}))
        hints.check_size(300, 200)
        with pytest.raises(InputError, match=rf"vision\.{name} is 300 x 200 px"):
            hints.check_size(960, 540)
    with pytest.raises(InputError, match="300 x 200 px"):
        find(scene, render(OWN, scene), mask=np.zeros((200, 300), np.uint8))
    for given, name in (
        ({"mask": np.zeros((540, 960), np.uint8)}, "the mask"),
        ({"region": (2000.0, 0.0, 50.0, 50.0)}, r"vision\.region"),
        ({"colour_low": (0.0, 255.0, 255.0)}, r"vision\.colour_low, vision\.colour_high"),
    ):
        with pytest.raises(VisionError, match=f"^{name}: nothing of the picture is left"):
            find(scene, render(OWN, scene), **given)
    flat = {**settings(scene).flat(), "vision.region": [0.0, 0.0, -1.0, 0.0]}
    with pytest.raises(ParameterError, match=r"vision\.region"):
        Settings.from_mapping(flat)


def test_a_mask_file_that_leaves_nothing_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((540, 960), np.uint8))
    black = VisionParameters(mask=str(tmp_path / "black.png"))
    with pytest.raises(InputError, match=r"vision\.mask is '.*', which is black all over; it must"):
        Hints(black)
    replace(settings(Scene()), vision=black).dump(tmp_path / "params.yaml")
    cv2.imwrite(str(tmp_path / "one.png"), render(OWN, Scene()))
    words = ["observe", "--params", str(tmp_path / "params.yaml"), "--output", str(tmp_path / "o")]
    assert cli.main([*words, str(tmp_path / "one.png")]) == 2


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("white", [1, 255])
def test_a_mask_file_may_hold_labels(tmp_path, depth, white):
    scene = scene_with(BLUE)
    image = render(OWN, scene)
    mask = (own_mask(scene, image) > 0).astype(depth) * depth(white)
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    known = VisionParameters(mask=str(tmp_path / "mask.png"))
    observer = Observer(replace(settings(scene), vision=known), scene.camera())
    found = observer.observe(0, image).observation.points
    across, _ = across_errors(found.positions[:, [0, 2]], OWN)
    assert np.abs(across).max() * scene.width_px / scene.diameter < 1.0


def test_hints_serve_image_files_too(tmp_path):
    scene = scene_with(RED)
    cv2.imwrite(str(tmp_path / "two.png"), render(OWN, scene))
    assert len(find_dlos(render(OWN, scene))) == 2
    known = VisionParameters(colour_low=(95.0, 60.0, 40.0), colour_high=(130.0, 255.0, 255.0))
    replace(settings(scene), vision=known).dump(tmp_path / "params.yaml")
    words = ["observe", "--params", str(tmp_path / "params.yaml"), "--output", str(tmp_path / "o")]
    assert cli.main([*words, str(tmp_path / "two.png")]) == 0
    rows = (tmp_path / "o" / "two.csv").read_text().splitlines()[1:]
    assert {row.split(",")[0] for row in rows} == {"0"}


def test_recorded_masks_hold_for_a_camera_with_depth(tmp_path):
    """The second picture comes with a mask that leaves nothing of it."""
    at = np.linspace(0.0, 1.0, 300)
    curve, length = even(np.column_stack([0.4 * at - 0.2, 0.05 * np.sin(5.0 * at)]))
    camera = Camera(np.array([[900.0, 0, 320], [0, 900.0, 240], [0, 0, 1]]), (0.0,) * 5, 640, 480,
                    looking(translation=(0.0, 0.0, 1.0)))  # fmt: skip
    image = picture(curve, 0.006, camera)
    depth = np.where(image.mean(axis=2) < 120.0, 997, 1020).astype(np.uint16)
    k = tuple(camera.matrix.ravel().tolist())
    info = CameraInfo(640, 480, "plumb_bob", (0.0,) * 5, k, "eye")
    with BagWriter(tmp_path / "bag") as writer:
        for stamp in (10**9, 2 * 10**9):
            writer.write("camera_info", camera_info_message(BAG_MESSAGES, stamp, info), stamp)
            if stamp > 10**9:
                black = np.zeros((480, 640), np.uint8)
                writer.write("image_mask", image_message(BAG_MESSAGES, stamp, "eye", black), stamp)
            writer.write("image_raw", image_message(BAG_MESSAGES, stamp, "eye", image), stamp)
            writer.write("depth/image_raw", depth_message(BAG_MESSAGES, stamp, "eye", depth), stamp)
        (held,) = holding(curve, ("start",)).commands
        writer.write("dlo/command", command_message(BAG_MESSAGES, held), 1)
    known = replace(settings_of(length, 0.006), camera=camera.pose)
    free, masked = observe_recording(tmp_path / "bag", known)
    assert free.result is not None, free.reason
    assert masked.result is None and "nothing of the picture is left" in masked.reason
