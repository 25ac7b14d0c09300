# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of a recording, small enough for a report, with the curves in their pixels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dlo_ros.demo.outcome import LiveOutcome
from dlo_ros.nodes.received_data import ReceivedData
from dlo_ros.parameters import CameraPose, Settings
from dlo_ros.recordings import iterate_images
from dlo_ros.recordings.camera_bags import iterate_together
from dlo_ros.recordings.images import CameraInfo, Image
from dlo_ros.report import Photograph
from dlo_ros.report.shape_player import MOST_FRAMES
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.camera.pinhole import Camera

WIDTH = 640  # px, at most
QUALITY = 75
MARGIN = 0.25  # around the curves, of their extent
CURVE_POINTS = 80


Curves = Mapping[str, FloatArray]
"""Curves of one instant by name, [px], the first pixel's centre at (0, 0), shape (m, 2)."""


@dataclass(frozen=True)
class ImageWindow:
    """The part of the images that is shown, columns and rows [px]."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def around(cls, points: FloatArray, width: int, height: int) -> ImageWindow:
        """The part of an image that holds the points, shape (m, 2), with a margin."""
        low, high = points.min(axis=0), points.max(axis=0)
        margin = MARGIN * float((high - low).max()) + 10.0
        left, top = np.clip(np.floor(low - margin).astype(int), 0, (width - 2, height - 2))
        right, bottom = np.clip(
            np.ceil(high + margin).astype(int), (left + 2, top + 2), (width, height)
        )
        return cls(int(left), int(top), int(right), int(bottom))

    def show(self, picture: Image, curves: Curves) -> Photograph:
        """The window of a picture, not larger than WIDTH."""
        part = picture[self.top : self.bottom, self.left : self.right]
        scale = min(WIDTH / part.shape[1], 1.0)
        size = max(round(part.shape[1] * scale), 1), max(round(part.shape[0] * scale), 1)
        small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        done, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        assert done
        # Pixels count from the centre of the first one, drawings from its corner.
        corner = np.array([self.left, self.top]) - 0.5

        moved = {name: (curve - corner) * scale for name, curve in curves.items()}
        return Photograph(jpeg.tobytes(), *size, **moved)


def photographs(
    bag: Path, settings: Settings, received: ReceivedData, outcome: LiveOutcome, camera: str = ""
) -> dict[int, Photograph]:
    """Pictures by the stamp of the observed spline [ns], for as many as a report shows.

    Args:
        bag: the bag that was played.
        settings: the initial guess, with the cameras' poses.
        received: the messages that the nodes published.
        outcome: the outcome, which holds the prediction of the initial guess.
        camera: name of one of several cameras; empty: the one camera.

    Raises:
        RecordingError: the bag cannot be read or has no images.
    """
    stamps = sorted(received.observed)
    chosen = np.linspace(0, len(stamps) - 1, min(MOST_FRAMES, len(stamps))).round().astype(int)
    shapes = {
        stamps[k]: {
            "observed": received.observed[stamps[k]],
            "predicted": received.predicted_at(stamps[k]),
            "initial": outcome.initial.get(stamps[k]),
        }
        for k in chosen
    }
    curves: dict[int, Curves] = {}
    window: ImageWindow | None = None
    result = {}
    pose = settings.cameras[camera] if camera else settings.camera
    for stamp, picture, info in _pictures(bag, settings, camera):
        if stamp not in shapes:
            continue
        if window is None:
            curves = {s: _in_pixels(shape, info, pose, settings) for s, shape in shapes.items()}
            points = np.concatenate([line for c in curves.values() for line in c.values()])
            finite = points[np.all(np.isfinite(points), axis=1)]
            window = ImageWindow.around(finite, info.width, info.height)
        result[stamp] = window.show(picture, curves[stamp])
    return result


def _pictures(
    bag: Path, settings: Settings, camera: str
) -> Iterator[tuple[int, Image, CameraInfo]]:
    """Pictures of a camera with the stamp [ns] of the spline that they belong to.

    A spline of several cameras has the stamp of the first one's picture.
    """
    if not camera:
        yield from iterate_images(bag)
        return
    names = list(settings.cameras)
    for images in iterate_together(bag, names):
        yield images[names[0]].stamp, images[camera].image, images[camera].info


def _in_pixels(
    shapes: Mapping[str, FloatArray | None], info: CameraInfo, pose: CameraPose, settings: Settings
) -> Curves:
    camera = Camera.from_info(info.k, info.d, info.distortion_model, info.width, info.height, pose)
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    matrix = basis.matrix(np.linspace(0.0, settings.rod.length, CURVE_POINTS))
    return {
        name: camera.project(matrix @ shape[:, :3])
        for name, shape in shapes.items()
        if shape is not None
    }
