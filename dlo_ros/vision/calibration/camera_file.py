# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""camera_info.yaml: the calibration file of ROS, as camera_info_manager reads it.

What ROS's camera_calibration wrote (ost.yaml) is of the same format.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import yaml

from dlo_ros.errors import InputError
from dlo_ros.files import read_yaml
from dlo_ros.parameters import CameraPose
from dlo_ros.recordings.images import read_camera_info
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.board_pose import BoardPose
from dlo_ros.vision.calibration.camera_fit import Intrinsics


def read_camera_file(path: Path) -> Intrinsics:
    """Intrinsics of a camera_info.yaml or ost.yaml.

    Raises:
        InputError: it cannot be read, is no calibration file, or of an unknown distortion model.
    """
    tree = read_yaml(path)
    needed = ("image_width", "image_height", "camera_matrix", "distortion_coefficients")
    missing = [n for n in needed if not isinstance(tree, dict) or n not in tree]
    if missing:
        raise InputError(f"{path}: has no {missing[0]}; give a camera_info.yaml of ROS")
    try:
        message = SimpleNamespace(
            width=int(tree["image_width"]),
            height=int(tree["image_height"]),
            k=[float(v) for v in tree["camera_matrix"]["data"]],
            d=[float(v) for v in tree["distortion_coefficients"]["data"]],
            distortion_model=str(tree.get("distortion_model", "plumb_bob")),
            binning_x=0,
            binning_y=0,
            roi=SimpleNamespace(width=0, height=0, x_offset=0, y_offset=0),
            header=SimpleNamespace(frame_id=""),
        )
    except (KeyError, TypeError, ValueError) as err:
        raise InputError(
            f"{path}: a matrix in it has no list of numbers 'data'; give a camera_info.yaml of ROS"
        ) from err
    try:
        info = read_camera_info(message)
        found = Intrinsics(
            np.array(info.k).reshape(3, 3), info.d, info.distortion_model, info.width, info.height
        )
        found.camera()
    except InputError as err:
        raise InputError(f"{path}: {err}") from err
    return found


def camera_file(intrinsics: Intrinsics, name: str = "camera", comment: str = "") -> str:
    """Content of a camera_info.yaml.

    Args:
        intrinsics: the camera.
        name: camera_name, which the camera driver compares with its own.
        comment: lines above it.
    """
    k, d = intrinsics.matrix, np.array(intrinsics.distortion)
    size = (intrinsics.width, intrinsics.height)
    # As image_proc expects it of one camera: all pixels of the rectified image are seen.
    projection = np.zeros((3, 4))
    projection[:, :3] = cv2.getOptimalNewCameraMatrix(k, d, size, 0.0)[0]
    tree: dict[str, Any] = {
        "image_width": intrinsics.width,
        "image_height": intrinsics.height,
        "camera_name": name,
        "camera_matrix": _matrix(k),
        "distortion_model": intrinsics.model,
        "distortion_coefficients": _matrix(d[None]),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(projection),
    }
    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    return lines + str(yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=200))


def board_file(board: BoardPose, comment: str = "") -> str:
    """Content of a ROS 2 parameter file with the camera block, to load beside another one."""
    pose: CameraPose = board.pose
    camera = {
        "translation": [round(v, 7) for v in pose.translation],
        "rotation": [round(v, 9) for v in pose.rotation],
    }
    tree = {"/**": {"ros__parameters": {"camera": camera}}}
    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    return lines + _block(tree)


def _block(tree: dict[str, Any], depth: int = 0) -> str:
    """Nested maps in block style, lists in one line."""
    text = ""
    for key, value in tree.items():
        name = "  " * depth + str(key)
        if isinstance(value, dict):
            text += f"{name}:\n{_block(value, depth + 1)}"
        else:
            text += f"{name}: [{', '.join(repr(float(v)) for v in value)}]\n"
    return text


def _matrix(values: FloatArray) -> dict[str, Any]:
    rows, columns = values.shape
    data = [float(f"{v:.10g}") for v in values.ravel()]
    return {"rows": rows, "cols": columns, "data": data}
