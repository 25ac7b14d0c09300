# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Points of another tracker (`dlo/points`) of a bag, in the board's frame."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from dlo_ros.errors import InputError, RecordingError
from dlo_ros.observation import PointList
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import deserialise, open_bag
from dlo_ros.recordings.command_spans import check_stamped
from dlo_ros.recordings.messages import read_point_list
from dlo_ros.recordings.transforms import Transforms, same_frame, transforms_of

LOG = logging.getLogger(__name__)


def points_on_board(message: Any, settings: Settings, transforms: Transforms) -> PointList:
    """The points of a sensor_msgs/PointCloud2, in `frame_id`.

    Args:
        message: the message, with x, y, z (u, std) in a frame of its own.
        settings: settings whose `frame_id` is the board.
        transforms: transforms that lead from the message's frame to the board, unless it is the
            same.

    Raises:
        InputError: the message is malformed, or nothing leads from its frame to the board.
    """
    seen, frame = read_point_list(message), str(message.header.frame_id)
    if same_frame(frame, settings.frame_id):
        return seen
    try:
        transforms.check(frame, settings.frame_id, seen.stamp)
        turned, moved = transforms.lookup(frame, settings.frame_id, [seen.stamp])
    except InputError as err:
        raise InputError(f"{topics.POINTS} is in frame '{frame[:60]}': {err}") from err
    return replace(seen, positions=seen.positions @ turned[0].T + moved[0])


def iterate_points(
    path: Path | str, settings: Settings, on_skip: Callable[[str], None] = LOG.warning
) -> Iterator[PointList]:
    """The lists of points of a bag in the order of recording.

    Args:
        path: rosbag2 folder.
        settings: settings whose `frame_id` is the board.
        on_skip: function that is called with one line for each unusable list.

    Raises:
        RecordingError: no bag, damaged, or no list is usable.
    """
    with open_bag(path) as bag:
        transforms, usable, last = transforms_of(bag), 0, "it has none"
        found = bag.find(topics.POINTS)
        if found:
            check_stamped(bag, found[0].topic)
        for raw in bag.messages(found):
            try:
                seen = points_on_board(deserialise(raw), settings, transforms)
            except InputError as err:
                last = str(err)
                on_skip(f"{path}: {raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
                continue
            usable += 1
            yield seen
        if not usable:
            raise RecordingError(f"{path}: no message on {topics.POINTS} is usable ({last})")
