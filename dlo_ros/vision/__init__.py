# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From a camera image to the observed spline: camera, segmentation, centreline, fit."""

from dlo_ros.vision.camera import Camera
from dlo_ros.vision.observer import Observer
from dlo_ros.vision.result import VisionResult

__all__ = ["Camera", "Observer", "VisionResult"]
