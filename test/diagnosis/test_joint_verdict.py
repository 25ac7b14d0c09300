# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The verdict of the joint model, by what matters."""

import pytest

from dlo_ros.diagnosis.explain.joint_explanation import Cause
from dlo_ros.diagnosis.findings.joint_outcome import _verdict

MATTERS = 1e-3


@pytest.mark.parametrize(
    ("setup", "after", "without", "verdict"),
    [
        (0.5e-3, 0.5e-3, [], "adequate"),
        (0.5e-3, 0.4e-3, [0.6e-3], "adequate"),  # certain, but small
        (0.5e-3, 0.5e-3, [0.6e-3, 8e-3], "explained"),  # a camera far beyond its tolerance
        (5e-3, 0.5e-3, [5e-3], "explained"),
        (5e-3, 2e-3, [9e-3], "unexplained"),
        (5e-3, 0.5e-3, [], "unexplained"),
    ],
)
def test_the_verdict_says_whether_what_matters_is_explained(setup, after, without, verdict):
    causes = [Cause("camera_scale", (), (), 20.0, err) for err in without]
    assert _verdict(setup, after, MATTERS, causes) == verdict
