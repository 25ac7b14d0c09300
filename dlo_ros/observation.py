# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Observations of the DLO by a camera at one instant (no ROS here)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class CentrelinePoints:
    """Measured points of the centreline.

    Args:
        positions: [m] in the board frame, shape (m, 3).
        u: material coordinates [m], shape (m,).
        std: standard deviation across the DLO [m], shape (m,).
        std_along: standard deviation of u [m], shape (m,); None where no free end makes it
            uncertain.
    """

    positions: FloatArray
    u: FloatArray
    std: FloatArray
    std_along: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class PointList:
    """Points of a DLO as another tracker saw them, in any order.

    Args:
        stamp: [ns].
        positions: [m] in the board frame, shape (m, 3).
        u: material coordinates [m], shape (m,); None where the tracker does not state them.
        std: standard deviation of each coordinate [m], shape (m,); None where it is not stated.
    """

    stamp: int
    positions: FloatArray
    u: FloatArray | None = None
    std: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Observation:
    """An observed spline.

    Args:
        stamp: stamp of the image [ns].
        control_points: x, y, z [m] and theta [rad] of the published basis, shape (n, 4); rows of
            numbers will do.
        points: the measured points behind the spline, where they are known.

    Raises:
        InputError: wrong shape or a number that is not finite.
    """

    stamp: int
    control_points: FloatArray
    points: CentrelinePoints | None = None

    def __post_init__(self) -> None:
        try:
            given = np.asarray(self.control_points, dtype=np.float64)
        except (TypeError, ValueError) as err:
            raise InputError("an observed spline is no array of numbers, (n, 4)") from err
        object.__setattr__(self, "control_points", given)
        shape = given.shape
        if len(shape) != 2 or shape[1] != 4:
            raise InputError(f"an observed spline has shape {shape}; (n, 4) is needed")
        if not np.all(np.isfinite(given)):
            raise InputError("an observed spline holds NaN or infinite control points")


@dataclass(frozen=True)
class Wrenches:
    """Forces and torques that the grip at one end exerts on the DLO, as measured.

    Args:
        end: `start` or `end`.
        stamps: [ns], growing, shape (k,).
        force: forces along the axes of the fixed frame [N], shape (k, 3).
        torque: torques about that end of the DLO along the same axes [N m], shape (k, 3).
        axes: rotation of the sensor's axes in the fixed frame, shape (k, 3, 3).

    Raises:
        InputError: shapes that differ, stamps that do not grow, a number that is not finite.
    """

    end: str
    stamps: NDArray[np.int64]
    force: FloatArray
    torque: FloatArray
    axes: FloatArray

    @classmethod
    def along_axes(cls, end: str, stamps: NDArray[np.int64], values: FloatArray) -> Wrenches:
        """Wrenches of a sensor with the axes of the fixed frame.

        Args:
            values: force and torque [N; N m], shape (k, 6).
        """
        axes = np.broadcast_to(np.eye(3), (len(stamps), 3, 3))
        return cls(end, stamps, values[:, :3], values[:, 3:], axes)

    def __post_init__(self) -> None:
        k = len(self.stamps)
        if not (self.force.shape == self.torque.shape == (k, 3) and self.axes.shape == (k, 3, 3)):
            raise InputError(f"measured wrenches at the {self.end} have shapes that differ")
        if np.any(np.diff(self.stamps) <= 0):
            raise InputError(f"stamps of measured wrenches at the {self.end} do not grow")
        if not (np.isfinite(self.force).all() and np.isfinite(self.torque).all()):
            raise InputError(f"a measured wrench at the {self.end} is not finite")
