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

KINDS = topics.TYPES | {
    topics.DEPTH: topics.TYPES[topics.IMAGE],
    topics.DEPTH_INFO: topics.TYPES[topics.CAMERA_INFO],
    topics.TRANSFORMS: topics.TRANSFORMS_TYPE,
    topics.MOVING_TRANSFORMS: topics.TRANSFORMS_TYPE,
}

BY_TYPE = (
    topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO, topics.POINTS, topics.COMMAND,
)  # fmt: skip
"""Topics that are recognised by their type where only one topic of the bag has it."""


def chosen(held: Mapping[str, str], named: Mapping[str, str]) -> dict[str, str]:
    """The topic of a bag for each topic of the interface.

    Args:
        held: type of each topic of the bag.
        named: the user's choice: name of the interface to name in the bag.

    Returns:
        Our name by the bag's.

    Raises:
        InputError: what the user says does not fit, or several topics could be one of ours.
    """
    result: dict[str, str] = {}
    for own, name in named.items():
        if own.lstrip("/") not in {t.lstrip("/") for t in IMPORTED_TOPICS}:
            raise InputError(
                f"--topic {own}={name}: '{own}' is none of {', '.join(IMPORTED_TOPICS)}"
            )
        own = next(t for t in IMPORTED_TOPICS if t.lstrip("/") == own.lstrip("/"))
        if name not in held:
            raise InputError(f"--topic {own}={name}: the bag has {', '.join(sorted(held))}")
        if held[name] != KINDS[own]:
            raise InputError(
                f"--topic {own}={name}: is of type {held[name]}, {KINDS[own]} is needed"
            )
        result[name] = own
    free = {name: kind for name, kind in held.items() if name not in result}
    for own in (t for t in IMPORTED_TOPICS if t not in result.values()):
        same = [n for n, kind in free.items() if kind == KINDS[own]]
        found = [n for n in same if topics.is_topic(n, own.lstrip("/"))]
        # camera/depth/image_raw is no camera/image_raw.
        longer = [t for t in IMPORTED_TOPICS if t != own and t.endswith(own)]
        found = [n for n in found if not any(topics.is_topic(n, t) for t in longer)]
        if len(found) > 1:
            _several(own, found)
        for name in found:
            result[name] = own
            del free[name]
    for own in (t for t in BY_TYPE if t not in result.values()):
        found = [n for n, kind in free.items() if kind == KINDS[own] and "depth" not in n]
        if len(found) > 1 and own != topics.CAMERA_INFO:
            _several(own, found)
        if len(found) == 1:
            result[found[0]] = own
            del free[found[0]]
    return result


def _several(own: str, found: Sequence[str]) -> None:
    raise InputError(
        f"{', '.join(sorted(found))} may each be {own}; say which, as --topic {own}={found[0]}"
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
    inputs: Sequence[Path], output: Path, named: Mapping[str, str], *, force: bool = False
) -> tuple[dict[str, str], list[str]]:
    """Convert ROS 1 bags of one recording to one rosbag2.

    Args:
        inputs: the bags.
        output: the bag to write.
        named: topics as the user names them, our name to the bag's.
        force: whether an older bag is replaced.

    Returns:
        Our name of each topic that was taken, and the topics that were not.

    Raises:
        InputError: a bag cannot be read, no topic can be used, or the output cannot be written.
    """
    held: dict[str, str] = {}
    for path in inputs:
        held |= held_topics(path)
    names = chosen(held, named)
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
