# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Reports for people: self-contained HTML that opens without a network.

`page` is the shell, `elements` the table and the text, `plots` the figures over time, `player` the
shapes with a time slider; `identification` and `calibration` put them together for one job.
"""

from dlo_ros.report.calibration import (
    BoardPicture,
    CalibrationReport,
    CalibrationView,
    write_calibration_report,
)
from dlo_ros.report.identification import (
    EstimateRow,
    IdentificationReport,
    ParameterTrack,
    RecordingRow,
    write_identification_report,
)
from dlo_ros.report.shape_player import Photograph, ShapeFrame

__all__ = [
    "BoardPicture",
    "CalibrationReport",
    "CalibrationView",
    "EstimateRow",
    "IdentificationReport",
    "ParameterTrack",
    "Photograph",
    "RecordingRow",
    "ShapeFrame",
    "write_calibration_report",
    "write_identification_report",
]
