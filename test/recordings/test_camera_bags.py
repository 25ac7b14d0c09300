# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of several cameras of one instant, and what is said where there are none."""

import re

import cv2
import numpy as np
import pytest

from dlo_ros.errors import RecordingError
from dlo_ros.recordings.camera_bags import has_depth, iterate_together
from dlo_ros.recordings.image_building import (
    camera_info_message,
    compressed_message,
    depth_message,
    image_message,
)
from dlo_ros.recordings.images import CameraInfo
from dlo_ros.recordings.message_building import BAG_MESSAGES
from dlo_ros.recordings.read import iterate_images
from dlo_ros.recordings.synchronisation import ApproximateTime
from dlo_ros.recordings.write import BagWriter


def test_images_meet_by_approximate_stamps():
    together = ApproximateTime(["left", "right"])
    period, sets = 33_000_000, []
    for k in range(20):
        sets += together.add("left", k * period, f"l{k}")
        if k != 7:  # one image of the right camera is lost
            sets += together.add("right", k * period + 6_000_000, f"r{k}")
    sets += together.rest()
    assert [(s["left"][1], s["right"][1]) for s in sets] == [
        (f"l{k}", f"r{k}") for k in range(20) if k != 7
    ]
    assert together.unmatched == 1


def test_a_lost_image_makes_no_pair_of_different_instants():
    """Where each camera loses images beside one another, none is a partner of its neighbours."""
    together = ApproximateTime(["left", "right"])
    period, sets = 33_000_000, []
    for k in range(30):
        if k != 13:
            sets += together.add("right", k * period, k)
        if k not in (10, 11, 12):
            sets += together.add("left", k * period, k)
    sets += together.rest()
    assert [s["left"][1] for s in sets] == [k for k in range(30) if not 10 <= k <= 13]
    assert all(s["left"][1] == s["right"][1] for s in sets)
    assert together.unmatched == 1


def test_a_camera_that_stops_blocks_nothing():
    together = ApproximateTime(["left", "right"])
    for k in range(100):
        assert together.add("left", k * 10_000_000, k) == []
    found = together.add("right", 99 * 10_000_000, 99)
    assert [s["left"][1] for s in found] == [99]
    assert together.unmatched > 90


@pytest.mark.parametrize(
    ("late", "width", "told"),
    [
        (0, 1280, ""),
        (5, 1280, "left/image_raw from 1.000 s on, /right/image_raw from 6.000 s on); are the"),
        (0, 640, "no message on /right/image_raw is usable (image of 1280 x 720 pixels; came"),
    ],
)
def test_pictures_without_a_partner_are_told_with_the_reason(late, width, told, tmp_path):
    second, picture = 10**9, np.full((720, 1280, 3), 200, dtype=np.uint8)
    k = (1500.0, 0.0, 640.0, 0.0, 1500.0, 360.0, 0.0, 0.0, 1.0)
    with BagWriter(tmp_path / "bag") as writer:
        for at in (second, 2 * second):
            for name, stamp, wide in (("left", at, 1280), ("right", at + late * second, width)):
                info = CameraInfo(wide, 720, "plumb_bob", (0.0,) * 5, k, name)
                writer.write(f"{name}/camera_info", camera_info_message(BAG_MESSAGES, 1, info), at)
                image = image_message(BAG_MESSAGES, stamp, name, picture)
                writer.write(f"{name}/image_raw", image, at)
    pairs = iterate_together(tmp_path / "bag", ["left", "right"], on_skip=lambda line: None)
    if not told:
        assert len(list(pairs)) == 2
        return
    with pytest.raises(RecordingError, match=re.escape(told)):
        list(pairs)


@pytest.mark.parametrize("namespace", ["", "camera/"])
def test_compressed_depth_images_are_no_pictures(namespace, tmp_path):
    """image_transport offers `compressed` beside every image, also beside a depth sensor's."""
    picture, depth = np.full((32, 48, 3), 200, np.uint8), np.full((32, 48), 1000, np.uint16)
    k = (50.0, 0.0, 24.0, 0.0, 50.0, 16.0, 0.0, 0.0, 1.0)
    info = camera_info_message(BAG_MESSAGES, 1, CameraInfo(48, 32, "plumb_bob", (0.0,) * 5, k))
    with BagWriter(tmp_path / "bag") as writer:
        for at in (10**9, 2 * 10**9):
            png = compressed_message(
                BAG_MESSAGES, at, "depth", cv2.imencode(".png", depth)[1].tobytes(), "16UC1; png"
            )
            writer.write(f"{namespace}camera_info", info, at)
            writer.write(f"{namespace}depth/image_raw/compressed", png, at)
            image = image_message(BAG_MESSAGES, at, "camera", picture)
            writer.write(f"{namespace}image_raw", image, at)
    assert [image.min() for _, image, _ in iterate_images(tmp_path / "bag")] == [200, 200]


@pytest.mark.parametrize("raw", [False, True])
def test_compressed_depths_are_not_left_out_in_silence(tmp_path, caplog, raw):
    packed = compressed_message(BAG_MESSAGES, 1, "eye", b"", "16UC1; compressedDepth")
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("depth/image_raw/compressedDepth", packed, 1)
        if raw:
            depth = depth_message(BAG_MESSAGES, 1, "eye", np.ones((4, 4), np.uint16))
            writer.write("depth/image_raw", depth, 1)
    assert has_depth(tmp_path / "bag") == raw
    told = "/depth/image_raw/compressedDepth is not read" in caplog.text
    assert told != raw
