# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Runs the observer in space on a recording of several cameras, or of one with depth images."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from dlo_ros.command import Motion
from dlo_ros.errors import VisionError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import open_bag
from dlo_ros.recordings.camera_bags import has_depth, iterate_together
from dlo_ros.recordings.images import CameraInfo, Image
from dlo_ros.recordings.read import HeldMasks
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.space import SpaceObserver
from dlo_ros.vision.space.spatial_observer import Frame
from dlo_ros.vision.space.view import cameras_of

LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ObservedFrame:
    """One image of a recording, or those of several cameras of one instant.

    Args:
        stamp: stamp of the first image [ns].
        views: image (BGR), the camera that took it, and what was found, None where nothing credible
            was; by the camera's name, which is empty for the only one.
        reason: the reason why nothing was found.
        offset: largest difference of the stamps [s].
    """

    stamp: int
    views: Mapping[str, tuple[Image, Camera, VisionResult | None]]
    reason: str = ""
    offset: float = 0.0

    @property
    def image(self) -> Image:
        """The first camera's."""
        return next(iter(self.views.values()))[0]

    @property
    def camera(self) -> Camera:
        """The first camera."""
        return next(iter(self.views.values()))[1]

    @property
    def result(self) -> VisionResult | None:
        """The first camera's result; its observation is that of all cameras."""
        return next(iter(self.views.values()))[2]


def watches_space(path: Path, settings: Settings) -> bool:
    """Whether a recording is one of several cameras, or of one whose depth images are used."""
    return bool(settings.cameras) or (settings.vision.depth == "auto" and has_depth(path))


def _has_masks(path: Path) -> bool:
    with open_bag(path) as bag:
        return bag.holds(topics.MASK)


def observe_together(
    path: Path, settings: Settings, motion: Motion, on_skip: Callable[[str], None]
) -> Iterator[ObservedFrame]:
    """Run the observer in space on a recording, one instant after the other.

    Args:
        path: rosbag2 folder with the images and camera_infos.
        settings: parameter file of the recording.
        motion: the commands.
        on_skip: function that is called with one line for each unusable image.

    Raises:
        DloError: the bag or a camera_info is unusable.
    """
    poses = settings.camera_poses
    observer: SpaceObserver | None = None
    known: dict[str, CameraInfo] = {}
    depth = not settings.cameras
    masks = None
    if depth:
        masks = HeldMasks(path, on_skip)
    elif _has_masks(path):
        on_skip(f"{path}: {topics.MASK} is that of one camera; with several it is not used")
    for images in iterate_together(path, list(poses), depth=depth, on_skip=on_skip):
        infos = {name: images[name].info for name in poses}
        if observer is None or infos != known:
            observer, known = SpaceObserver(settings, cameras_of(infos, poses), motion), infos
        if masks is not None:
            observer.hints.mask = masks.at(images[""].stamp)
        frames = {name: Frame(i.stamp, i.image, i.depth) for name, i in images.items()}
        stamps = [frame.stamp for frame in frames.values()]
        found: Mapping[str, VisionResult] = {}
        reason = ""
        try:
            found = observer.observe(frames).views
        except VisionError as err:
            reason = str(err)
            LOG.info("%s: images at %d ns: %s", path, next(iter(frames.values())).stamp, err)
        views = {
            name: (frames[name].image, observer.cameras[name], found.get(name)) for name in poses
        }
        offset = (max(stamps) - min(stamps)) * 1e-9
        yield ObservedFrame(frames[next(iter(poses))].stamp, views, reason, offset)
