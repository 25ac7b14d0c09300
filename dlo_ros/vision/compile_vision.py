# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiles the numba kernels of the vision stage into the cache, so that no node waits for it.

python -m dlo_ros.vision.compile_vision
"""

from __future__ import annotations

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.parameters import CameraPose, RodParameters, Settings
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_observer import Observer


def compile_kernels() -> None:
    """Run everything once on a small picture with a straight bar."""
    image = np.full((120, 200, 3), 200, dtype=np.uint8)
    image[57:63, 20:180] = 60
    matrix = np.array([[1000.0, 0.0, 99.5], [0.0, 1000.0, 59.5], [0.0, 0.0, 1.0]])
    pose = CameraPose((0.0, 0.0, 1.0), (2**-0.5, 0.0, 0.0, 2**-0.5))
    camera = Camera(matrix, (-1e-3, 0.0, 0.0, 0.0), 200, 120, pose)
    rod = RodParameters(length=0.16, diameter=0.006, young_modulus=1e6, density=1e3)
    try:
        Observer(Settings(rod, camera=pose), camera).observe(0, image)
    except VisionError as err:  # the bar is a rope as good as any
        raise AssertionError("the vision stage fails on a straight bar") from err


if __name__ == "__main__":
    compile_kernels()
