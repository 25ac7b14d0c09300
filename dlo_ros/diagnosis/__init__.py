# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Diagnosis: what the model gets wrong, which physical cause it has, and what naming it gains."""

from dlo_ros.diagnosis.findings.diagnosis_outcome import (
    Candidate,
    Diagnosis,
    Fitted,
    Gain,
    NamedEffect,
    Number,
    RecordingView,
    SetupNumber,
)
from dlo_ros.diagnosis.pipeline import diagnose

__all__ = [
    "Candidate",
    "Diagnosis",
    "Fitted",
    "Gain",
    "NamedEffect",
    "Number",
    "RecordingView",
    "SetupNumber",
    "diagnose",
]
