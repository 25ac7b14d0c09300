# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of several cameras, or of one with its depth images, from a rosbag2."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise, open_bag
from dlo_ros.recordings.command_spans import check_stamped
from dlo_ros.recordings.images import (
    CameraInfo,
    DepthImage,
    Image,
    check_image_size,
    read_camera_info,
    read_depth,
    read_image,
)
from dlo_ros.recordings.messages import stamp_of
from dlo_ros.recordings.synchronisation import ApproximateTime

LOG = logging.getLogger(__name__)

PACKED_DEPTH = f"{topics.DEPTH}/compressedDepth"
DEPTH = " depth"  # beside the names of cameras, which have no spaces


@dataclass(frozen=True, eq=False)
class TimedImage:
    """A camera's picture.

    Args:
        stamp: [ns].
        image: BGR.
        info: intrinsics.
        depth: aligned depth [m], NaN where there is none, shape (h, w); None without a sensor.
    """

    stamp: int
    image: Image
    info: CameraInfo
    depth: DepthImage | None = None


def has_depth(path: Path) -> bool:
    """Whether a bag holds depth images of the one camera; compressed ones do not count.

    Raises:
        RecordingError: no bag, or damaged.
    """
    with open_bag(path) as bag:
        found = bag.holds(topics.DEPTH)
        packed = [c.topic for c in bag.connections if topics.is_topic(c.topic, PACKED_DEPTH)]
    if packed and not found:
        LOG.warning(
            "%s: %s is not read, so the DLO is taken to lie in the board's plane; republish it as "
            "%s (ros2 run image_transport republish compressedDepth raw) and record that",
            path, packed[0], topics.DEPTH,
        )  # fmt: skip
    return found


def count_images(path: Path, camera: str) -> int:
    """Number of a camera's pictures in a bag."""
    with open_bag(path) as bag:
        return sum(connection.msgcount for connection in _images(bag, camera))


def iterate_together(
    path: Path | str,
    cameras: Sequence[str],
    *,
    depth: bool = False,
    on_skip: Callable[[str], None] = LOG.warning,
) -> Iterator[dict[str, TimedImage]]:
    """Pictures of several cameras, in sets of one instant, paired by their stamps.

    Args:
        path: rosbag2.
        cameras: names as in `vision.cameras`; the empty name is the one camera.
        depth: whether depth images belong to the first one.
        on_skip: function that is called with one line for each unusable message, and with the
            number of messages without a partner.

    Yields:
        Pictures by the cameras' names.

    Raises:
        RecordingError: no bag, damaged, a camera is missing, or no pictures of one instant.
    """
    path = Path(path)
    with open_bag(path) as bag:
        wanted: dict[str, str] = {}
        connections = []
        for name in cameras:
            found = _images(bag, name)
            if not found:
                topic = topics.of_camera(name, topics.IMAGE)
                raise RecordingError(
                    f"{path}: has no images of camera '{name}'; record {topic} "
                    f"or {topic}/compressed"
                )
            check_stamped(bag, found[0].topic)
            wanted[found[0].topic] = name
            connections += found
        if depth:
            found = bag.find(topics.DEPTH)
            wanted[found[0].topic] = DEPTH
            connections += found
        names = {topic: name for topic, name in wanted.items() if name != DEPTH}
        infos = {name: _info(bag, name, topic) for topic, name in names.items()}
        together: ApproximateTime[Any] = ApproximateTime([*cameras, *([DEPTH] if depth else [])])
        used = 0
        begun: dict[str, int] = {}
        reasons: dict[str, str] = {}
        for raw in bag.messages(connections):
            name = wanted[raw.topic]
            try:
                message = deserialise(raw)
                stamp = stamp_of(message)
                picture: Any = read_depth(message) if name == DEPTH else read_image(message)
                info = infos[cameras[0] if name == DEPTH else name]
                check_image_size(picture, info)
            except InputError as err:
                on_skip(f"{path}: {raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
                reasons[raw.topic] = str(err)
                continue
            begun.setdefault(raw.topic, stamp)
            for one in together.add(name, stamp, picture):
                used += 1
                yield _frames(one, infos)
        for one in together.rest():
            used += 1
            yield _frames(one, infos)
        if together.unmatched:
            on_skip(f"{path}: {together.unmatched} images have no partner of about their stamp")
        if not used:
            for topic, reason in reasons.items():
                if topic not in begun:
                    raise RecordingError(f"{path}: no message on {topic} is usable ({reason})")
            starts = ", ".join(f"{t} from {s / NANOSECONDS:.3f} s on" for t, s in begun.items())
            raise RecordingError(
                f"{path}: no images of {', '.join(filter(None, cameras)) or 'camera and depth'} "
                f"were taken at about one time ({starts}); are the cameras' clocks the same?"
            )


def _frames(
    found: dict[str, tuple[int, Any]], infos: dict[str, CameraInfo]
) -> dict[str, TimedImage]:
    depth = found[DEPTH][1] if DEPTH in found else None
    return {
        name: TimedImage(stamp, picture, infos[name], depth)
        for name, (stamp, picture) in found.items()
        if name != DEPTH
    }


def _images(bag: Bag, camera: str) -> list[Any]:
    return bag.find(topics.of_camera(camera, topics.COMPRESSED)) or bag.find(
        topics.of_camera(camera, topics.IMAGE)
    )


def _info(bag: Bag, camera: str, image_topic: str) -> CameraInfo:
    """The first usable intrinsics: those of a camera of several do not change."""
    topic = topics.of_camera(camera, topics.CAMERA_INFO)
    reason = "none there"
    for raw in bag.messages(bag.find(topic, near=image_topic)):
        try:
            return read_camera_info(deserialise(raw))
        except InputError as err:
            reason = str(err)
    raise RecordingError(f"{bag.path}: no usable {topic} ({reason}); record it, or calibrate")
