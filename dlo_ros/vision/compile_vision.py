# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiles the numba kernels of the vision stage into the cache, so that no node waits for it.

python -m dlo_ros.vision.compile_vision
"""

from __future__ import annotations

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.errors import VisionError
from dlo_ros.parameters import CameraPose, RodParameters, Settings
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.space.spatial_observer import Frame, SpaceObserver

WIDTH, HEIGHT = 200, 120  # [px] of the pictures
FOCAL_LENGTH = 1000.0  # [px]
DISTANCE = 1.0  # [m] of the cameras from the bar
BASELINE = 0.03  # [m] by which one camera stands above the other
LATER = 1_000_000  # [ns] by which its pictures are taken later
PERIOD = 33_333_333  # [ns]
ROD = RodParameters(length=0.16, diameter=0.006, young_modulus=1e6, density=1e3)


def compile_kernels() -> None:
    """Observe a straight bar in small pictures, by one camera and by two.

    What the first picture would need besides, such as tables and other packages' modules, is loaded
    and ready then, too.
    """
    upper = camera(0.5 * BASELINE)
    lower = camera(-0.5 * BASELINE)
    settings = Settings(ROD, camera=upper.pose)
    try:
        observer = Observer(settings, upper)
        several = SpaceObserver(settings, {"upper": upper, "lower": lower}, clamped())
        for k in range(3):  # found, tracked, and tracked with a velocity
            observer.observe(k * PERIOD, picture(0.5 * BASELINE))
            several.observe(
                {
                    "upper": Frame(k * PERIOD, picture(0.5 * BASELINE)),
                    "lower": Frame(k * PERIOD + LATER, picture(-0.5 * BASELINE)),
                }
            )
    except VisionError as err:  # the bar is a rope as good as any
        raise AssertionError("the vision stage fails on a straight bar") from err


def clamped() -> Motion:
    """A clamp at rest that holds the bar's start."""
    motion = Motion()
    motion.add(
        Command(
            0,
            ("start",),
            np.zeros(1),
            np.array([[[-0.5 * ROD.length, 0.0, 0.0]]]),
            np.array([[[0.0, 0.0, 0.0, 1.0]]]),
            np.full((1, 1, 3), np.nan),
            ROD.control_points,
        )
    )
    return motion


def camera(height: float) -> Camera:
    """A camera that stands above the bar [m]."""
    matrix = np.array(
        [
            [FOCAL_LENGTH, 0.0, 0.5 * (WIDTH - 1)],
            [0.0, FOCAL_LENGTH, 0.5 * (HEIGHT - 1)],
            [0.0, 0.0, 1.0],
        ]
    )
    pose = CameraPose((0.0, height, DISTANCE), (2**-0.5, 0.0, 0.0, 2**-0.5))
    return Camera(matrix, (-1e-3, 0.0, 0.0, 0.0), WIDTH, HEIGHT, pose)


def picture(height: float) -> Image:
    """The bar, as a camera above it [m] sees it."""
    width = round(FOCAL_LENGTH * ROD.diameter / DISTANCE)
    row = round(0.5 * (HEIGHT - width) + FOCAL_LENGTH * height / DISTANCE)
    image = np.full((HEIGHT, WIDTH, 3), 200, dtype=np.uint8)
    image[row : row + width, 20:180] = 60
    return image


if __name__ == "__main__":
    compile_kernels()
