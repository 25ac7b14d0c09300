# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Identification: from residuals to (E, mu) with honest uncertainty, without ROS."""

from dlo_ros.identification.estimate import Estimate
from dlo_ros.identification.offline.recording_identification import (
    Identification,
    RecordingResult,
    identify,
)
from dlo_ros.identification.online.online_estimator import OnlineEstimator
from dlo_ros.inference.err import shape_error
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast

__all__ = [
    "Estimate",
    "Forecast",
    "Identification",
    "Manipulation",
    "OnlineEstimator",
    "RecordingResult",
    "forecast",
    "identify",
    "shape_error",
]
