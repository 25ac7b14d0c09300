# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures for the calibration of a camera: image files, folders, bags."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rosbags.interfaces import Connection

from dlo_ros.errors import InputError, RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise, open_bag
from dlo_ros.recordings.images import MAX_PIXELS, Image, read_image

LOG = logging.getLogger(__name__)

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
INTERVAL = 200_000_000  # [ns] between the pictures of a bag that are looked at


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture.

    Args:
        name: name of the file, or the bag's name and the time.
        image: BGR, shape (h, w, 3), in the sensor's raster.
        moving: whether it is one of a bag, of which many look alike.
    """

    name: str
    image: Image
    moving: bool = False


def read_picture(path: Path) -> Image:
    """An image file as BGR; a rotation noted in EXIF is not applied, pixels are the sensor's.

    Raises:
        InputError: it is missing, no image, damaged or too large.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give image files, folders of them, or a bag")
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    data = np.fromfile(path, dtype=np.uint8)
    image = None
    if data.size:
        try:
            image = cv2.imdecode(data, flags)
        except cv2.error:
            image = None
    if image is None or image.size > 3 * MAX_PIXELS:
        raise InputError(f"{path}: is no image that can be read; JPEG, PNG, TIFF, BMP or WebP can")
    return np.asarray(image, dtype=np.uint8)


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag2 rather than images."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(
            p.suffix in (".mcap", ".db3") for p in path.iterdir()
        )
    return path.suffix in (".mcap", ".db3")


def count_pictures(path: Path, camera: str = "") -> int:
    """Upper bound of the number of pictures in an input; the images of a bag count all.

    Args:
        path: the input.
        camera: name of the camera, which matters where a bag has images of several.

    Raises:
        InputError: there is no such file, or it has none.
    """
    if is_bag(path):
        with open_bag(path) as bag:
            return sum(c.msgcount for c in _images(bag, camera))
    return len(_files(path))


def pictures(
    path: Path,
    camera: str = "",
    on_skip: Callable[[str], None] = LOG.warning,
    on_seen: Callable[[], None] = lambda: None,
) -> Iterator[Picture]:
    """The pictures of an image file, a folder of them, or a bag, one after the other.

    Args:
        path: the input. Of a bag, pictures at least `INTERVAL` apart are taken.
        camera: name of the camera, which matters where a bag has images of several.
        on_skip: function that is called with one line for each unusable picture of a folder or bag.
        on_seen: function that is called for each picture that was read, used or not.

    Raises:
        InputError: nothing there, or a file that was named is no image.
    """
    if is_bag(path):
        yield from _of_bag(path, camera, on_skip, on_seen)
        return
    usable = 0
    for file in _files(path):
        on_seen()
        try:
            image = read_picture(file)
        except InputError as err:
            if file == path:
                raise
            on_skip(str(err))
            continue
        usable += 1
        yield Picture(file.name, image)
    if not usable:
        raise InputError(f"{path}: none of its images can be read")


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: no such file; give image files, folders of them, or a bag")
    if not path.is_dir():
        return [path]
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    if not files:
        raise InputError(f"{path}: has no images ({', '.join(s[1:] for s in SUFFIXES)}), no bag")
    return files


def _images(bag: Bag, camera: str) -> list[Connection]:
    """The images of a bag; where it has those of several cameras, of the one that is named."""
    names = sorted(
        {c.topic for c in bag.connections if c.msgcount and c.msgtype in topics.IMAGE_TYPES}
    )
    own = topics.of_camera(camera, "")
    if camera and any(f"/{own}" in f"/{c.topic}" for c in bag.connections):
        found = bag.find(own + topics.COMPRESSED) or bag.find(own + topics.IMAGE)
        if not found:
            raise RecordingError(
                f"{bag.path}: has no images of the camera '{camera}' (it has "
                f"{', '.join(names) or 'none'}); record {own}{topics.IMAGE}, or name another "
                "camera with --camera-name"
            )
        return found
    try:
        return bag.find(topics.COMPRESSED) or bag.find(topics.IMAGE)
    except RecordingError as err:
        raise RecordingError(
            f"{bag.path}: has images of several cameras ({', '.join(names)}); say which of them is "
            "calibrated, as --camera-name left for left/image_raw"
        ) from err


def _of_bag(
    path: Path, camera: str, on_skip: Callable[[str], None], on_seen: Callable[[], None]
) -> Iterator[Picture]:
    with open_bag(path) as bag:
        found = _images(bag, camera)
        if not found:
            raise RecordingError(
                f"{path}: has no images; record {topics.IMAGE} or {topics.COMPRESSED}"
            )
        last, usable = None, 0
        reason: InputError | None = None
        for raw in bag.messages(found):
            on_seen()
            if last is not None and abs(raw.stamp - last) < INTERVAL:
                continue
            try:
                image = read_image(deserialise(raw))
            except InputError as err:
                reason = err
                on_skip(f"{path}: {raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
                continue
            last = raw.stamp
            usable += 1
            seconds = (raw.stamp - bag.start) / 1e9
            yield Picture(f"{path.resolve().name} {seconds:.2f} s", image, moving=True)
        if not usable:
            raise RecordingError(f"{path}: no image is usable ({reason})")
