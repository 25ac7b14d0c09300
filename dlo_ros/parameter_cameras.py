# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Poses of the cameras in a parameter file: of the one, or of several that have names.

`vision.cameras: [left, right]` names them; `camera_left.translation` and `camera_left.rotation` are
the pose of the board in the camera `left`, as `camera.*` is in the only one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dlo_ros.errors import ParameterError
from dlo_ros.file_parameter import Value
from dlo_ros.parameter_table import TABLE

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

CAMERAS = "vision.cameras"
PREFIX = "camera_"
KEYS = ("translation", "rotation")
DESCRIPTION = "pose of the board in the camera, as camera.translation and camera.rotation"


@dataclass(frozen=True)
class CameraPose:
    """Pose of the board frame in the camera's optical frame (x right, y down, z forward)."""

    translation: Vector = (0.0, 0.0, 1.2)
    rotation: Quaternion = (0.70710678, 0.0, 0.0, 0.70710678)

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the camera in the frame board [m], shape (3,)."""
        turned = Rotation.from_quat(self.rotation).inv().apply(self.translation)
        return -np.asarray(turned, dtype=np.float64)


def of_cameras(name: str) -> bool:
    """Whether a dotted name is that of a parameter of one of several cameras."""
    group, _, key = name.partition(".")
    return name == CAMERAS or (group.startswith(PREFIX) and key in KEYS)


def unit(name: str) -> str:
    """Unit of such a parameter, empty where it has none."""
    return "m" if name.endswith(".translation") else ""


def read_cameras(values: Mapping[str, Any]) -> dict[str, CameraPose]:
    """The named cameras of a parameter file by name, in the order of `vision.cameras`.

    Args:
        values: values by their dotted names.

    Raises:
        ParameterError: a name no topic can have or given twice, or a pose missing or unusable.
    """
    names = values.get(CAMERAS, ())
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise ParameterError(f"{CAMERAS} is {names!r}; it must be names such as [left, right]")
    result: dict[str, CameraPose] = {}
    for name in names:
        if not isinstance(name, str) or not name.isidentifier():
            raise ParameterError(
                f"{CAMERAS} has {name!r}; a name has letters, digits and _ and begins with a letter"
            )
        if name in result:
            raise ParameterError(f"{CAMERAS} names '{name}' twice")
        result[name] = _pose(values, name)
    if len(result) == 1:
        raise ParameterError(f"{CAMERAS} has one name; leave it out for one camera")
    for key in values:
        group = key.partition(".")[0]
        if of_cameras(key) and key != CAMERAS and group.removeprefix(PREFIX) not in result:
            raise ParameterError(f"{key}: {CAMERAS} does not name '{group.removeprefix(PREFIX)}'")
    return result


def _pose(values: Mapping[str, Any], name: str) -> CameraPose:
    checked: dict[str, Any] = {}
    for key in KEYS:
        full = f"{PREFIX}{name}.{key}"
        if full not in values:
            raise ParameterError(
                f"{full} is missing; give the pose of the board in the camera '{name}' "
                "(dlo_ros calibrate finds it)"
            )
        try:
            checked[key] = TABLE[f"camera.{key}"].check(values[full])
        except ParameterError as err:
            raise ParameterError(str(err).replace(f"camera.{key}", full)) from None
    check_rotation(checked["rotation"], f"{PREFIX}{name}.rotation")
    return CameraPose(**checked)


def check_rotation(rotation: Quaternion, name: str) -> None:
    """Refuse a rotation that is none.

    Raises:
        ParameterError: it is no unit quaternion.
    """
    if not 0.9 < math.hypot(*rotation) < 1.1:
        raise ParameterError(f"{name} is {list(rotation)}; it must be a unit quaternion x y z w")


def flat_cameras(cameras: Mapping[str, CameraPose]) -> dict[str, Any]:
    """The named cameras by dotted name; empty where there are none."""
    if not cameras:
        return {}
    result: dict[str, Value | tuple[str, ...]] = {CAMERAS: tuple(cameras)}
    for name, pose in cameras.items():
        result |= {f"{PREFIX}{name}.{key}": getattr(pose, key) for key in KEYS}
    return result
