# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of several cameras, of a depth sensor, or of a rope in space, written to a bag."""

from __future__ import annotations

import logging
from collections.abc import Iterable

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError
from dlo_ros.recordings import topics
from dlo_ros.recordings.image_building import camera_info_message, compressed_message, depth_message
from dlo_ros.recordings.images import CameraInfo
from dlo_ros.recordings.message_building import BAG_MESSAGES
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.experiment import Experiment
from dlo_ros.synthesis.picture_settings import SimulatedCamera
from dlo_ros.synthesis.render import Renderer
from dlo_ros.synthesis.spatial_render import SpatialRenderer
from dlo_ros.synthesis.true_motion import Truth

LOG = logging.getLogger(__name__)

CAMERA_FRAME = "camera"
BLUR_INSTANTS = 8
SAMPLES = 801
"""Points of the rope that are projected; the renderer interpolates between them."""


def record_pictures(
    experiment: Experiment, truth: Truth, writer: BagWriter, frames: Iterable[int], seed: int
) -> None:
    """Draw all frames for every camera of an experiment, and their depth images.

    Args:
        experiment: experiment with its cameras.
        truth: the motion.
        writer: writer of the bag.
        frames: indices of the frames.
        seed: seed of noise and texture.

    Raises:
        InputError: the rope comes behind the board.
    """
    rod, look = experiment.truth.rod, experiment.look
    u = np.linspace(0.0, rod.length, SAMPLES)
    furthest = max(float(truth.centreline(i, u)[:, 1].max()) for i in range(len(truth.stamps)))
    if furthest > look.board_distance - 0.5 * rod.diameter:
        raise InputError(
            f"{experiment.name}: the rope comes to y = {furthest:.3f} m, behind the board; "
            f"look.board_distance is {look.board_distance:g} m, give more"
        )
    cameras = experiment.cameras or {"": (experiment.camera, experiment.truth.camera)}
    drawing = []
    for k, (name, (camera, stated)) in enumerate(cameras.items()):
        geometry = Geometry(camera, experiment.hidden.camera(stated))
        warn_out_of_sight(geometry, truth)
        renderer = SpatialRenderer(
            geometry, look, rod.diameter, look.board_distance, seed + 1000 * k
        )
        frame = name or CAMERA_FRAME
        drawing.append((f"{name}/" if name else "", renderer, camera_info(camera, frame)))
    for i in frames:
        stamp = truth.stamps[i]
        for prefix, renderer, info in drawing:
            lines = _exposed(truth, i, u, renderer.geometry.camera.exposure)
            data = renderer.encode(renderer.frame(lines, u))
            message = camera_info_message(BAG_MESSAGES, stamp, info)
            writer.write(prefix + topics.CAMERA_INFO, message, stamp)
            message = compressed_message(BAG_MESSAGES, stamp, info.frame_id, data)
            writer.write(prefix + topics.COMPRESSED, message, stamp)
            if experiment.depth is not None:
                depth = renderer.depth(truth.centreline(i, u), u, experiment.depth)
                message = camera_info_message(BAG_MESSAGES, stamp, info)
                writer.write(topics.DEPTH_INFO, message, stamp)
                message = depth_message(BAG_MESSAGES, stamp, info.frame_id, depth)
                writer.write(topics.DEPTH, message, stamp)


def record_board_pictures(
    experiment: Experiment, truth: Truth, writer: BagWriter, frames: Iterable[int],
    renderer: Renderer, held: FloatArray,
) -> None:  # fmt: skip
    """Draw all frames of a rope in front of its board, as the one camera sees them.

    Args:
        experiment: experiment with its camera.
        truth: the motion.
        writer: writer of the bag.
        frames: indices of the frames.
        renderer: renderer of the board.
        held: material coordinates [m] where a pin holds the rope, shape (k,).
    """
    u = renderer.spacing(experiment.truth.rod.length)
    info = camera_info(experiment.camera, CAMERA_FRAME)
    for i in frames:
        stamp = truth.stamps[i]
        lines = _exposed(truth, i, u, experiment.camera.exposure)
        data = renderer.encode(renderer.frame(lines, u, held))
        message = camera_info_message(BAG_MESSAGES, stamp, info)
        writer.write(topics.CAMERA_INFO, message, stamp)
        message = compressed_message(BAG_MESSAGES, stamp, CAMERA_FRAME, data)
        writer.write(topics.COMPRESSED, message, stamp)


def _exposed(truth: Truth, frame: int, u: FloatArray, exposure: float) -> list[FloatArray]:
    """The rope's axis at instants spread over an exposure [s] about a frame's stamp."""
    instants = BLUR_INSTANTS if exposure > 0.0 else 1
    within = exposure * ((np.arange(instants) + 0.5) / instants - 0.5)
    return [truth.centreline(frame, u, later=float(dt)) for dt in within]


def camera_info(camera: SimulatedCamera, frame_id: str) -> CameraInfo:
    """Intrinsics of a simulated camera."""
    return CameraInfo(
        width=camera.width,
        height=camera.height,
        distortion_model=camera.model,
        d=camera.distortion,
        k=tuple(float(v) for v in camera.matrix.ravel()),
        frame_id=frame_id,
    )


def warn_out_of_sight(geometry: Geometry, truth: Truth) -> None:
    """Warn when the rope leaves the picture, since nothing would show it afterwards."""
    u = np.linspace(0.0, truth.u[-1], 100)
    size = np.array([geometry.camera.width, geometry.camera.height]) - 1
    for i, stamp in enumerate(truth.stamps):
        pixels = geometry.project(truth.centreline(i, u))
        if np.any((pixels < 0) | (pixels > size)):
            LOG.warning(
                "the rope leaves the picture %.2f s after the start; move the camera",
                (stamp - truth.stamps[0]) / NANOSECONDS,
            )
            return
