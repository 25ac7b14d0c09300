# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""An image as the camera that took it is known to take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.ridge_map import Image, as_bgr


def image_of(
    camera: Camera, image: NDArray[np.uint8], depth: NDArray[np.float32] | None = None
) -> Image:
    """An image of a camera as BGR.

    Args:
        camera: the camera.
        image: BGR or mono, shape (h, w, 3) or (h, w).
        depth: depth at each of its pixels [m], shape (h, w); None where there is none.

    Raises:
        VisionError: one of them has another size than camera_info says, or is none.
    """
    image = as_bgr(image)
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise VisionError(
            f"the image is {width} x {height} px, camera_info says {camera.width} x {camera.height}"
        )
    if depth is not None and depth.shape != (height, width):
        raise VisionError(
            f"the depth image is {depth.shape[1]} x {depth.shape[0]} px, the camera's image "
            f"{width} x {height}; depth must be aligned with it"
        )
    return image
