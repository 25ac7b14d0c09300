# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Conversion of ROS 1 bags to rosbag2 with the names of the interface's topics.

rosbags converts the messages. A topic is recognised by its name, where that ends like one of the
interface's, by its type, where only one topic has it, or is named by the user.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from rosbags.convert import convert
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from dlo_ros.errors import InputError, RecordingError
from dlo_ros.parameter_cameras import CAMERAS
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import TYPESTORE, brief, deserialise, open_bag
from dlo_ros.recordings.write import BagWriter

LOG = logging.getLogger(__name__)

IMPORTED_TOPICS = (
    topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO, topics.DEPTH, topics.DEPTH_INFO,
    topics.MASK, topics.POINTS, topics.COMMAND, topics.START_POSE, topics.END_POSE,
    topics.WRENCH_START, topics.WRENCH_END, topics.OBSERVED, topics.OBSERVED_POINTS,
    topics.TRANSFORMS, topics.MOVING_TRANSFORMS,
)  # fmt: skip
"""Topics that a recording of an experiment may have."""

OF_CAMERAS = (topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO)
"""Topics that each of several cameras has."""

BY_TYPE = (
    topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO, topics.POINTS, topics.COMMAND,
)  # fmt: skip
"""Topics that are recognised by their type where only one topic of the bag has it."""


def imported_topics(cameras: Sequence[str]) -> tuple[str, ...]:
    """Topics that a recording with these cameras may have, by the interface's names."""
    if not cameras:
        return IMPORTED_TOPICS
    own = [topics.of_camera(name, topic) for name in cameras for topic in OF_CAMERAS]
    depth = (topics.DEPTH, topics.DEPTH_INFO, topics.MASK)
    return (*own, *(t for t in IMPORTED_TOPICS if t not in (*OF_CAMERAS, *depth)))


def kind_of(topic: str) -> str:
    """Message type of a topic that is imported."""
    fixed = topic in (topics.TRANSFORMS, topics.MOVING_TRANSFORMS)
    return topics.TRANSFORMS_TYPE if fixed else topics.type_of(topic)


def chosen(
    held: Mapping[str, str], named: Mapping[str, str], cameras: Sequence[str] = ()
) -> dict[str, str]:
    """The topic of a bag for each topic of the interface.

    Args:
        held: type of each topic of the bag.
        named: the user's choice: name of the interface to name in the bag.
        cameras: names of several cameras, as `vision.cameras`; empty: one camera.

    Returns:
        Our name by the bag's.

    Raises:
        InputError: what the user says does not fit, several topics could be one of ours, or images
            of some of the cameras are missing.
    """
    result: dict[str, str] = {}
    ours = imported_topics(cameras)
    for own, name in named.items():
        if own.lstrip("/") not in {t.lstrip("/") for t in ours}:
            raise InputError(f"--topic {own}={name}: '{own}' is none of {', '.join(ours)}")
        own = next(t for t in ours if t.lstrip("/") == own.lstrip("/"))
        if name not in held:
            raise InputError(f"--topic {own}={name}: the bag has {', '.join(sorted(held))}")
        if held[name] != kind_of(own):
            raise InputError(
                f"--topic {own}={name}: is of type {held[name]}, {kind_of(own)} is needed"
            )
        result[name] = own
    free = {name: kind for name, kind in held.items() if name not in result}
    for own in (t for t in ours if t not in result.values()):
        same = [n for n, kind in free.items() if kind == kind_of(own) and _seen(n, own)]
        found = [n for n in same if topics.is_topic(n, own.lstrip("/"))]
        # camera/depth/image_raw is no camera/image_raw.
        longer = [t for t in ours if t != own and t.endswith(own)]
        found = [n for n in found if not any(topics.is_topic(n, t) for t in longer)]
        if len(found) > 1:
            _several(own, found)
        for name in found:
            result[name] = own
            del free[name]
    for own in (t for t in BY_TYPE if t in ours and t not in result.values()):
        found = [n for n, kind in free.items() if kind == kind_of(own) and _seen(n, own)]
        if len(found) > 1 and own != topics.CAMERA_INFO:
            _several(own, found)
        if len(found) == 1:
            result[found[0]] = own
            del free[found[0]]
    _check_cameras(held, result, cameras)
    return result


def _seen(name: str, own: str) -> bool:
    """Whether a topic may be one of ours: one of depth images is none of a camera's."""
    return "depth" not in name or "depth" in own or kind_of(own) not in topics.CAMERA_TYPES


def _several(own: str, found: Sequence[str]) -> None:
    cameras = f", or name the cameras in {CAMERAS}" if own in OF_CAMERAS else ""
    raise InputError(
        f"{', '.join(sorted(found))} may each be {own}; say which, as --topic {own}={found[0]}"
        f"{cameras}"
    )


def _check_cameras(
    held: Mapping[str, str], result: Mapping[str, str], cameras: Sequence[str]
) -> None:
    """Refuse a bag with images that has none of one of several cameras, or no intrinsics."""
    ours = set(result.values())
    images = [n for n, kind in held.items() if kind in topics.IMAGE_TYPES]
    for name in cameras if images else ():
        own = [topics.of_camera(name, topic) for topic in OF_CAMERAS]
        for needed in (own[:2], own[2:]):
            if not ours & set(needed):
                kinds = {kind_of(t) for t in needed}
                left = [
                    n for n, kind in held.items()
                    if kind in kinds and n not in result and _seen(n, needed[0])
                ]  # fmt: skip
                raise InputError(
                    f"no topic is {' or '.join(needed)} of the camera '{name}' ({CAMERAS}); say "
                    f"which, as --topic {needed[0]}={(sorted(left) or ['/NAME'])[0]} (not taken: "
                    f"{', '.join(sorted(left)) or 'none of that type'})"
                )


def held_topics(path: Path) -> dict[str, str]:
    """Topics of a ROS 1 bag with messages, and the names of their types in ROS 2.

    Raises:
        RecordingError: no bag, or damaged.
    """
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; give a ROS 1 bag, NAME.bag")
    try:
        with Reader(path) as reader:
            return {c.topic: c.msgtype for c in reader.connections if c.msgcount}
    except Exception as err:  # a damaged file surfaces as whatever the parser meets first
        raise RecordingError(
            f"{path}: is no ROS 1 bag that can be read ({brief(err)}); 'rosbag reindex' mends one "
            "that was not finished"
        ) from err


def import_ros1(
    inputs: Sequence[Path],
    output: Path,
    named: Mapping[str, str],
    cameras: Sequence[str] = (),
    *,
    force: bool = False,
) -> tuple[dict[str, str], list[str]]:
    """Convert ROS 1 bags of one recording to one rosbag2.

    Args:
        inputs: the bags.
        output: the bag to write.
        named: topics as the user names them, our name to the bag's.
        cameras: names of several cameras, as `vision.cameras`; empty: one camera.
        force: whether an older bag is replaced.

    Returns:
        Our name of each topic that was taken, and the topics that were not.

    Raises:
        InputError: a bag cannot be read, no topic can be used, or the output cannot be written.
    """
    held: dict[str, str] = {}
    for path in inputs:
        held |= held_topics(path)
    names = chosen(held, named, cameras)
    if not names:
        listed = ", ".join(f"{n} ({k})" for n, k in sorted(held.items())) or "no messages"
        raise InputError(
            f"{inputs[0]}: has no topic that can be used ({listed}); say which is which with "
            "--topic dlo/points=/tracker/points"
        )
    with (
        BagWriter(output, force=force) as writer,
        tempfile.TemporaryDirectory(dir=output.absolute().parent, prefix=".ros1.") as folder,
    ):
        half = Path(folder) / "bag"
        try:
            convert(
                srcs=list(inputs), dst=half, dst_storage="sqlite3", dst_version=8, compress=None,
                compress_mode="file", default_typestore=get_typestore(Stores.ROS1_NOETIC),
                typestore=TYPESTORE, exclude_topics=(), include_topics=list(names),
                exclude_msgtypes=(), include_msgtypes=(),
            )  # fmt: skip
        except Exception as err:  # as above
            raise RecordingError(f"{inputs[0]}: cannot be converted ({brief(err)})") from err
        with open_bag(half) as bag:
            for raw in bag.messages():
                writer.write(names[raw.topic], deserialise(raw), raw.stamp)
    return names, sorted(set(held) - set(names))
