"""Pictures of a recording, small enough for a report, with the curves in their pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from dlo_ros.demo.heard import Heard
from dlo_ros.parameters import Settings
from dlo_ros.recordings import iterate_images
from dlo_ros.recordings.images import CameraInfo, Image
from dlo_ros.report import Photograph
from dlo_ros.report.player import MOST_FRAMES
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.camera import Camera

WIDTH = 720  # px, at most
QUALITY = 70
CURVE_POINTS = 80


def photographs(bag: Path, settings: Settings, heard: Heard) -> dict[int, Photograph]:
    """Pictures by stamp [ns], for as many observed splines as a report shows.

    Raises:
        RecordingError: the bag cannot be read or has no images.
    """
    stamps = sorted(heard.observed)
    chosen = np.linspace(0, len(stamps) - 1, min(MOST_FRAMES, len(stamps))).round().astype(int)
    wanted = {stamps[k] for k in chosen}
    result = {}
    for stamp, picture, info in iterate_images(bag):
        if stamp in wanted:
            result[stamp] = _photograph(stamp, picture, info, settings, heard)
    return result


def _photograph(
    stamp: int, picture: Image, info: CameraInfo, settings: Settings, heard: Heard
) -> Photograph:
    camera = Camera.from_info(
        info.k, info.d, info.distortion_model, info.width, info.height, settings.camera
    )
    scale = min(WIDTH / info.width, 1.0)
    size = round(info.width * scale), round(info.height * scale)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    done, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    matrix = basis.matrix(np.linspace(0.0, settings.rod.length, CURVE_POINTS))

    def pixels(control_points: FloatArray | None) -> FloatArray | None:
        if control_points is None:
            return None
        # The centre of the first pixel is (0, 0) for the camera; SVG begins at its corner.
        return (camera.project(matrix @ control_points[:, :3]) + 0.5) * scale

    return Photograph(
        jpeg.tobytes(),
        *size,
        observed=pixels(heard.observed[stamp]),
        predicted=pixels(heard.predicted_at(stamp)),
    )
