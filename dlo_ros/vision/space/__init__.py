# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From pictures of several cameras, or of one with depth, to the observed spline in space."""

from dlo_ros.vision.space.spatial_observer import SpaceObserver
from dlo_ros.vision.space.spatial_result import SpaceResult

__all__ = ["SpaceObserver", "SpaceResult"]
