# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Reading a recording: commands, observed splines and images of a rosbag2."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.errors import CommandError, InputError, RecordingError
from dlo_ros.observation import CentrelinePoints, Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise, open_bag
from dlo_ros.recordings.command_spans import check_stamped, seen_spans, unseen_motion
from dlo_ros.recordings.frame_commands import commands_from_frames
from dlo_ros.recordings.images import (
    CameraInfo,
    Image,
    check_image_size,
    read_camera_info,
    read_image,
    read_mask,
)
from dlo_ros.recordings.messages import (
    read_command,
    read_observation,
    read_points,
    read_spline,
    stamp_of,
    unwrap_in_time,
)
from dlo_ros.recordings.wrenches import read_wrenches
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

Read = TypeVar("Read")


@dataclass(frozen=True)
class BagContents:
    """The contents of a bag: the commands and observations of one manipulation.

    Args:
        name: name of the bag's folder.
        path: the folder.
        commands: commands by growing stamp, without those that later ones replace whole.
        observations: observed splines by growing stamp, each stamp once.
        has_images: whether the bag holds camera images.
        has_points: whether it holds another tracker's points.
        skipped: a line for each message that was unusable.
        wrenches: measured forces and torques of the grips, for each end that has them.
    """

    name: str
    path: Path
    commands: tuple[Command, ...]
    observations: tuple[Observation, ...]
    has_images: bool
    skipped: tuple[str, ...]
    wrenches: tuple[Wrenches, ...] = ()
    has_points: bool = False


def read_recording(
    path: Path | str, settings: Settings, *, require_command: bool = True
) -> BagContents:
    """Read the commands and observed splines of a bag.

    A bag without `dlo/observed` is accepted where it holds images or points of another tracker, so
    that the observer can be run on it; `observations` is empty then.

    Args:
        path: rosbag2 folder.
        settings: settings whose length, control points and frame the messages must fit.
        require_command: whether a bag without a usable `dlo/command` is refused.

    Raises:
        RecordingError: no bag, damaged, a topic missing or of the wrong type, nothing usable.
    """
    path = Path(path)
    skipped: list[str] = []
    with open_bag(path) as bag:
        try:
            commands = _commands(bag, settings, skipped)
            skipped += unseen_motion(commands, seen_spans(bag))
        except CommandError as err:
            if require_command:
                raise RecordingError(str(err)) from err
            skipped.append(str(err).removeprefix(f"{path}: "))
            commands = []
        if require_command and not commands:
            _refuse(bag, topics.COMMAND, skipped, "record the imposed motion on it")
        # Which of several cameras is meant matters only to who reads the images.
        has_images = bag.holds(topics.COMPRESSED) or bag.holds(topics.IMAGE)
        observations = _observations(bag, settings, skipped)
        has_points = bag.holds(topics.POINTS)
        if not (observations or has_images or has_points):
            mend = f"record it, the camera's images, or {topics.POINTS} of another tracker"
            _refuse(bag, topics.OBSERVED, skipped, mend)
        try:
            wrenches = read_wrenches(bag, settings, commands)
        except InputError as err:
            raise RecordingError(str(err)) from err
    for line in skipped:
        LOG.warning("%s: %s", path, line)
    return BagContents(
        name=path.resolve().name,
        path=path,
        commands=tuple(commands),
        observations=tuple(observations),
        has_images=has_images,
        skipped=tuple(skipped),
        wrenches=tuple(wrenches),
        has_points=has_points,
    )


def iterate_images(
    path: Path | str, on_skip: Callable[[str], None] = LOG.warning
) -> Iterator[tuple[int, Image, CameraInfo]]:
    """The camera images of a bag in the order of recording.

    Compressed images are taken where both transports were recorded. Each image comes with the
    camera_info of its stamp, else the one before it, else the first.

    Args:
        on_skip: function that is called with one line for each unusable image.

    Yields:
        Stamp [ns], BGR picture of shape (height, width, 3), intrinsics.

    Raises:
        RecordingError: no bag, damaged, no images, no usable camera_info, or no usable image.
    """
    path = Path(path)
    with open_bag(path) as bag:
        images = bag.find(topics.COMPRESSED) or bag.find(topics.IMAGE)
        if not images:
            raise RecordingError(
                f"{path}: has no images; record {topics.IMAGE} or {topics.COMPRESSED}"
            )
        check_stamped(bag, images[0].topic)
        stamps, infos = _camera_infos(bag, images[0].topic)
        usable = 0
        for raw in bag.messages(images):
            try:
                message = deserialise(raw)
                picture, stamp = read_image(message), stamp_of(message)
                info = infos[max(int(np.searchsorted(stamps, stamp, side="right")) - 1, 0)]
                check_image_size(picture, info)
            except InputError as err:
                on_skip(f"{path}: {raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
                last = err
                continue
            usable += 1
            yield stamp, picture, info
        if not usable:
            raise RecordingError(f"{path}: no image is usable ({last})")


def iterate_masks(
    path: Path | str, on_skip: Callable[[str], None] = LOG.warning
) -> Iterator[tuple[int, Image]]:
    """The masks of a bag in the order of recording; none where it has none.

    Args:
        on_skip: function that is called with one line for each unusable mask.

    Returns:
        Stamp [ns] and mask of shape (height, width), not zero where the DLO may be, of each.

    Raises:
        RecordingError: no bag, or damaged.
    """
    return _usable(Path(path), topics.MASK, read_mask, on_skip)


class HeldMasks:
    """The masks of a bag, each of which holds until the next one.

    Args:
        path: rosbag2 folder.
        on_skip: function that is called with one line for each unusable mask.
    """

    def __init__(self, path: Path | str, on_skip: Callable[[str], None] = LOG.warning) -> None:
        self._masks = iterate_masks(path, on_skip)
        self._coming = next(self._masks, None)
        self._held: Image | None = None

    def at(self, stamp: int) -> Image | None:
        """The mask that holds at a stamp [ns]; stamps grow. None before the first."""
        while self._coming is not None and self._coming[0] <= stamp:
            self._held, self._coming = self._coming[1], next(self._masks, None)
        return self._held


def iterate_predictions(
    path: Path | str, settings: Settings, on_skip: Callable[[str], None] = LOG.warning
) -> Iterator[tuple[int, FloatArray]]:
    """The predicted splines of a bag in the order of recording; none where it has none.

    Args:
        path: rosbag2 folder.
        settings: settings whose frame the splines must have; their number of control points is
            free.
        on_skip: function that is called with one line for each unusable spline.

    Returns:
        Stamp [ns] and control points, shape (n, 4), of each.

    Raises:
        RecordingError: no bag, or damaged.
    """

    def shape(message: Any) -> FloatArray:
        basis = SplineBasis(len(message.poses), settings.rod.length)
        rod = replace(settings.rod, control_points=basis.control_points)
        return read_spline(message, replace(settings, rod=rod), topics.PREDICTED)

    return _usable(Path(path), topics.PREDICTED, shape, on_skip)


def _usable(
    path: Path, topic: str, read: Callable[[Any], Read], on_skip: Callable[[str], None]
) -> Iterator[tuple[int, Read]]:
    """Stamp [ns] and content of each usable message of a topic, in the order of recording."""
    with open_bag(path) as bag:
        for raw in bag.messages(bag.find(topic)):
            try:
                message = deserialise(raw)
                found = stamp_of(message), read(message)
            except InputError as err:
                on_skip(f"{path}: {raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
                continue
            yield found


def _camera_infos(bag: Bag, image_topic: str) -> tuple[list[int], list[CameraInfo]]:
    connections = bag.find(topics.CAMERA_INFO, near=image_topic)
    if not connections:
        raise RecordingError(
            f"{bag.path}: has no {topics.CAMERA_INFO}; record it with the images, "
            "or calibrate the camera"
        )
    found: dict[int, CameraInfo] = {}
    reason: InputError | None = None
    for raw in bag.messages(connections):
        try:
            message = deserialise(raw)
            found[stamp_of(message)] = read_camera_info(message)
        except InputError as err:
            reason = err
    if not found:
        raise RecordingError(f"{bag.path}: no usable camera_info ({reason})")
    stamps = sorted(found)
    return stamps, [found[s] for s in stamps]


def _commands(bag: Bag, settings: Settings, skipped: list[str]) -> list[Command]:
    if settings.command.source != "topic":
        return commands_from_frames(bag, settings, skipped)
    motion = Motion()
    for raw in bag.messages(bag.find(topics.COMMAND)):
        try:
            motion.add(read_command(deserialise(raw), settings, raw.stamp))
        except InputError as err:
            skipped.append(f"{raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
    return motion.commands


def _observations(bag: Bag, settings: Settings, skipped: list[str]) -> list[Observation]:
    found = bag.find(topics.OBSERVED)
    if not found:
        return []
    try:
        check_stamped(bag, found[0].topic)
    except RecordingError as err:
        skipped.append(str(err).removeprefix(f"{bag.path}: "))
        return []
    clouds: dict[int, CentrelinePoints] = {}
    for raw in bag.messages(bag.find(topics.OBSERVED_POINTS, near=found[0].topic)):
        try:
            message = deserialise(raw)
            clouds[stamp_of(message)] = read_points(message, settings)
        except InputError as err:
            skipped.append(f"{raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
    observations: dict[int, Observation] = {}
    for raw in bag.messages(found):
        try:
            observation = read_observation(deserialise(raw), settings)
        except InputError as err:
            skipped.append(f"{raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
            continue
        stamp = observation.stamp
        if stamp in observations:
            skipped.append(f"{raw.topic}: a second spline at {stamp / 1e9:.3f} s is skipped")
            continue
        points = clouds.pop(stamp, None)
        observations[stamp] = Observation(stamp, observation.control_points, points)
    if clouds and observations:
        skipped.append(
            f"{topics.OBSERVED_POINTS}: {len(clouds)} messages skipped that have the stamp of no "
            f"spline; {raw.topic} and it must carry the image's stamp"
        )
    return _continuous([observations[stamp] for stamp in sorted(observations)])


def _continuous(observations: list[Observation]) -> list[Observation]:
    """The splines with the twist unwrapped in time."""
    result: list[Observation] = []
    for observation in observations:
        points = observation.control_points.copy()
        if result:
            points[:, 3] = unwrap_in_time(points[:, 3], result[-1].control_points[:, 3])
        result.append(Observation(observation.stamp, points, observation.points))
    return result


def _refuse(bag: Bag, topic: str, skipped: list[str], mend: str) -> None:
    """Raise the error that a topic is missing, or that none of its messages is usable."""
    if not bag.find(topic):
        held = ", ".join(sorted({c.topic for c in bag.connections})[:8]) or "nothing"
        raise RecordingError(f"{bag.path}: has no {topic} (it has {held}); {mend}")
    first = next((line for line in skipped if topics.relative(line.split(" ")[0]) == topic), "")
    raise RecordingError(f"{bag.path}: no message on {topic} is usable ({first})")
