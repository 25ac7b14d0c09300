# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""An image as the camera that took it is known to take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.ridge_map import Image, as_bgr


def image_of(camera: Camera, image: NDArray[np.uint8]) -> Image:
    """An image of a camera as BGR.

    Raises:
        VisionError: it has another size than camera_info says, or is none.
    """
    image = as_bgr(image)
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise VisionError(
            f"the image is {width} x {height} px, camera_info says {camera.width} x {camera.height}"
        )
    return image
