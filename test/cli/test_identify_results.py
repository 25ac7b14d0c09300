# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of an identification: what is drawn of the uncertainty, and what is not."""

from types import SimpleNamespace

import numpy as np
import pytest
from html_check import checked
from rods import PAPER

from dlo_ros.cli.identify_results import report, summary
from dlo_ros.identification.estimate import logarithms, summarise
from dlo_ros.identification.identifiability import knowledge
from dlo_ros.identification.offline.recording_identification import Identification
from dlo_ros.report.identification import identification_page

RATIO = np.array([1.0, -1.0, 0.0, 0.0])
DRAG = np.array([0.0, -1.0, 1.0, 0.0])
RELAXATION = np.array([0.0, 0.0, 0.0, 1.0])


def identified(recordings=(), set_up=None, **stds):
    """An identification whose data tell E/mu, c/mu and t_r with relative standard deviations."""
    directions = {"ratio": RATIO, "drag": DRAG, "relaxation": RELAXATION}
    matrix = sum(np.outer(directions[k], directions[k]) / std**2 for k, std in stds.items())
    estimate = summarise(PAPER, logarithms(PAPER), matrix)
    fitted = SimpleNamespace(
        information=matrix, set_up=set_up or {}, converged=True, left_out=(), error=np.nan,
        alternatives=(),
    )  # fmt: skip
    return Identification(estimate, tuple(recordings), fitted)


@pytest.mark.parametrize("relaxation", [0.1, 0.24, 0.3, 0.45, 2.0])
def test_an_ellipse_is_drawn_of_what_the_remarks_call_known(relaxation):
    found = identified(ratio=0.01, drag=0.05, relaxation=relaxation)
    source = {k.name: k.source for k in knowledge(found.estimate, found.fitted.information)}
    made = report(PAPER, found, [])
    drawn = {e.names for e in made.ellipses}
    pair = ("E/mu", "relaxation time t_r")
    assert ("E/mu", "c/mu") in drawn
    assert (pair in drawn) == (source["relaxation_time"] == "data") == (relaxation < 0.25)
    told = f"Not drawn: {' beside '.join(pair)}, since these data do not determine {pair[1]}."
    assert (told in made.not_drawn) == (pair not in drawn)
    guessed = any("not known" in r and pair[1] in r for r in made.remarks)
    assert guessed == (pair not in drawn)
    page = identification_page(made)
    checked(page)
    assert (told in page) == (pair not in drawn)


def test_what_is_not_drawn_is_told_where_nothing_is_drawn():
    made = report(PAPER, identified(drag=0.9), [])
    assert not made.ellipses
    page = identification_page(made)
    assert "Uncertainty of pairs" in page
    assert "Not drawn: E beside mu, since these data do not determine E and mu." in page
    assert "Not drawn: E/mu beside c/mu, since these data do not determine E/mu and c/mu." in page


def test_numbers_along_the_dlo_are_told_in_one_phrase():
    bent = "effects.intrinsic_curvature.curvature"
    found = identified(
        set_up={
            "effects.clamp_offset.start[0]": (0.004, 0.001),
            "effects.clamp_offset.start[1]": (0.001, 0.001),
            f"{bent}[0]": (1.4, 0.2),
            f"{bent}[1]": (7.4, 0.2),
            f"{bent}[2]": (-0.1, 0.2),
        }
    )
    (told,) = [line for line in summary(found) if "set-up" in line]
    assert "place of a clamp, at the start, x 4.0 +- 1.0 mm to the right; " in told
    assert "at the start, z" not in told
    assert told.count("curvature at rest") == 1
    assert (
        "curvature at rest from 0.10 1/m counterclockwise to 7.4 1/m clockwise along the DLO. "
        in told
    )


def test_recordings_beyond_their_noise_are_told_in_one_sentence():
    recordings = [
        SimpleNamespace(name=name, role="train", err=err, err_initial=None, noise_floor=1e-4)
        for name, err in (("first", 1.5e-4), ("second", 4e-4), ("third", 9e-4))
    ]
    (told,) = [line for line in summary(identified(recordings)) if "noise" in line]
    assert told.startswith("ERR is 4.0 times (second) and 9.0 times (third) what the noise")
    assert not [line for line in summary(identified(recordings[:1])) if "noise" in line]
