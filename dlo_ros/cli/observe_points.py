# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`observe` on a bag that holds another tracker's points instead of images."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlo_ros.cli.progress import progress_bar
from dlo_ros.cli.refusals import Refusals
from dlo_ros.command import Motion
from dlo_ros.errors import InputError, RecordingError, VisionError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import open_bag
from dlo_ros.recordings.message_building import observation_messages
from dlo_ros.recordings.point_lists import iterate_points
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.write import BagWriter, copy_topics
from dlo_ros.vision.points.point_observer import PointObserver, PointResult

LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ObservedPoints:
    """One list of points of a recording.

    Args:
        stamp: [ns].
        result: the shape that the points show; None where that is not credible.
        reason: the reason why it is not credible.
    """

    stamp: int
    result: PointResult | None
    reason: str = ""


def observes_points(path: Path, *, wanted: bool = False) -> bool:
    """Whether the points of a bag are observed, and not its images.

    Args:
        path: rosbag2 folder.
        wanted: whether they are where the bag has images, too.

    Raises:
        RecordingError: no bag, damaged, or without the points that are wanted.
    """
    with open_bag(path) as bag:
        points = bag.holds(topics.POINTS)
        images = bag.holds(topics.IMAGE) or bag.holds(topics.COMPRESSED)
    if wanted and not points:
        raise RecordingError(f"{path}: has no {topics.POINTS}; leave --points away")
    if points and images and not wanted:
        LOG.warning(
            "%s: has images and %s of another tracker; the images are observed. To use the points, "
            "observe the bag with --points first",
            path, topics.POINTS,
        )  # fmt: skip
    return points and (wanted or not images)


def observe_points(path: Path | str, settings: Settings) -> Iterator[ObservedPoints]:
    """Turn a recording's lists of points into observed splines, one after the other.

    Args:
        path: rosbag2 folder with `dlo/points` and, where motion was imposed, the commands.
        settings: parameter file of the recording.

    Raises:
        RecordingError: the bag is unusable.
    """
    recording = read_recording(path, settings, require_command=False)
    motion = Motion([c.later(settings.command_delay) for c in recording.commands])
    observer = PointObserver(settings, motion)
    for seen in iterate_points(path, settings):
        try:
            yield ObservedPoints(seen.stamp, observer.observe(seen))
        except VisionError as err:
            LOG.info("%s: points at %d ns: %s", path, seen.stamp, err)
            yield ObservedPoints(seen.stamp, None, str(err))


def observe_points_bag(path: Path, settings: Settings, output: Path, *, force: bool) -> int:
    """Write a bag with the observed splines beside the other topics; returns the exit status.

    Raises:
        DloError: the input or the output is unusable.
    """
    if output.exists() and path.exists() and output.resolve() == path.resolve():
        raise RecordingError(f"{output}: is the input; give the output another name")
    with open_bag(path) as bag:
        total = sum(c.msgcount for c in bag.find(topics.POINTS))
    refusals = Refusals()
    found: list[PointResult] = []
    with BagWriter(output, force=force) as writer, progress_bar() as progress:
        task = progress.add_task("Observing", total=total)
        for each in observe_points(path, settings):
            progress.advance(task)
            if each.result is None:
                refusals.add(each.reason)
                continue
            for topic, message in observation_messages(settings.frame_id, each.result.observation):
                writer.write(topic, message, each.stamp)
            found.append(each.result)
        if not found:
            reason = refusals.main()
            raise InputError(f"{path}: no list of points shows a credible DLO ({reason})")
        copy_topics(path, writer, exclude=(topics.OBSERVED, topics.OBSERVED_POINTS))
    beside = 100.0 * float(np.mean([r.outliers for r in found]))
    noise = 1000.0 * float(np.median([r.std for r in found]))
    length = float(np.median([r.seen_length for r in found]))
    print(
        f"{output}: {len(found)} of {len(found) + refusals.total} lists of points show the "
        f"DLO, {length:.4g} m long (rod.length {settings.rod.length:.4g} m), points scatter by "
        f"{noise:.2g} mm (median), {beside:.1f} % of them lie beside it"
    )
    for reason, count in refusals.commonest(5):
        print(f"  {count} without: {reason}")
    return 0
