# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The frame that a report shows first: the worst simulated one, and not the worst measured one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from diagnoses import KNOWN, found
from html_check import checked

from dlo_ros.cli.diagnosis_output import report
from dlo_ros.report.diagnosis import diagnosis_page
from dlo_ros.report.shape_player import MOST_FRAMES
from dlo_ros.report.worst_frame import is_lasting, worst_frame

GROSS = 39e-3


def swing(frames):
    """ERR [m] that grows and falls once over a recording, largest at two thirds of it."""
    return 1e-3 + 4e-3 * np.exp(-(((np.arange(frames) - 2 * frames // 3) / 3.0) ** 2))


@pytest.mark.parametrize("wrong", [0, 7, 15, 16, 17, 23])
def test_a_single_gross_frame_is_not_the_worst_wherever_it_is(wrong):
    err = swing(24)
    err[wrong] = GROSS
    assert abs(worst_frame(err) - 16) <= 1 and worst_frame(err) != wrong
    assert list(np.flatnonzero(~is_lasting(err))) in ([wrong], sorted({wrong, 16}))


def test_an_error_that_lasts_is_the_worst():
    err = swing(24)
    err[20:22] = GROSS
    assert worst_frame(err) == 20
    assert worst_frame(swing(24)) in (15, 16, 17)
    assert worst_frame(np.array([1e-3, 2e-3])) == 1


@pytest.mark.parametrize("frames", [24, 5 * MOST_FRAMES])
def test_a_gross_last_picture_is_not_shown_first(frames):
    made = found(frames)
    err = swing(frames)
    err[-1] = GROSS
    if frames > MOST_FRAMES:  # most wrong just before the end, between two frames that are kept
        err[-4:-1] = 20e-3
    (view,) = made.views
    observed = view.observed.copy()
    observed[-1, :, 2] += GROSS
    view = replace(view, observed=observed, err_before=err)
    page = diagnosis_page(report(replace(made, views=(view,)), KNOWN))
    parts = checked(page)
    data = json.loads(next(text for kind, text in parts.scripts if "json" in str(kind)))
    shown = int(page.partition('type="range"')[2].partition('value="')[2].partition('"')[0])
    assert 1e3 * err[worst_frame(err)] == pytest.approx(20.0 if frames > MOST_FRAMES else 5.0, 0.1)
    assert f"plain model: {1e3 * err[worst_frame(err)]:.3g}" in data["frames"][shown]["text"]
    assert "most wrong for longer than a single picture" in page
