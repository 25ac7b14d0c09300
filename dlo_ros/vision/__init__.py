# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From a camera image to the observed spline: camera, segmentation, centreline, fit."""

from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.planar_result import VisionResult

__all__ = ["Camera", "Observer", "VisionResult"]
