# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The numbers of a set-up as lines of a table."""

from pathlib import Path

import numpy as np
import pytest
from diagnoses import LENGTH, SETUP, case

from dlo_ros.cli.diagnosis_output import summary
from dlo_ros.cli.set_up_table import setup_lines
from dlo_ros.diagnosis import NamedEffect, Number, SetupNumber


def test_the_set_up_is_a_table_with_what_is_off_first():
    made = case(setup=SETUP)
    lines = setup_lines(made)
    assert [line.name for line in lines[:2]] == [
        "direction of a clamp, at the start",
        "camera scale",
    ]
    assert [line.off for line in lines[:2]] == [
        "2.1 +- 0.4 degrees clockwise",
        "0.40 +- 0.10 % too small",
    ]
    assert lines[0].tolerance == "3.0 degrees" and lines[1].tolerance == "0.50 %"
    assert [line.notable for line in lines] == [True, True, False, False, False]
    text = summary(made, LENGTH, Path("build/diagnosis"))
    rows = text[text.index("Your set-up, as far as the data determine it") :]
    assert rows[1].split() == ["what", "off", "by", "tolerance"]
    assert rows[2].startswith("  direction of a clamp, at the start  2.1 +- 0.4 degrees clockwise")
    assert rows[4] == "  3 other numbers are not clearly off: report.html has them."


def test_what_lies_far_beyond_its_tolerance_is_told_though_it_is_not_certain():
    """The sentences above the table speak of it, such as a tilt of 3.0 +- 1.4 degrees."""
    tilted = {
        "gravity_tilt.angle": SetupNumber(np.float64(-0.053), np.float64(0.024), 0.0175, "rad")
    }
    length = {"length_error.difference": SetupNumber(0.0, np.float64(0.001), 0.002, "m")}
    line, other = setup_lines(case("unexplained", causes=(), setup=length | tilted))
    assert line.notable and line.off.startswith("3.0 +- 1.4 degrees") and not other.notable


def test_a_time_is_told_as_it_is_and_is_never_off():
    creep = {
        "viscoelasticity.share": SetupNumber(0.13, 0.13, None, ""),
        "viscoelasticity.time": SetupNumber(0.064, 0.005, None, "s"),
    }
    lines = {line.name: line for line in setup_lines(case(setup=creep))}
    assert lines["creep, in which it relaxes"].off == "64 +- 5 ms"
    assert not any(line.notable for line in lines.values())


def test_numbers_of_a_named_effect_stand_among_the_causes_alone():
    clamp = NamedEffect("clamp_angle", {"start": Number(0.2, 0.01, "rad")}, (), 0.7)
    named = {line.name for line in setup_lines(case(causes=[clamp], setup=SETUP))}
    assert not any("clamp, at the start" in name and "direction" in name for name in named)
    assert "camera scale" in named


def test_what_may_be_anything_is_not_determined():
    friction = {"hysteresis.moment": SetupNumber(6e-4, 1927.0, None, "N m")}
    (line,) = setup_lines(case(setup=friction))
    assert line.off == "not determined" and not line.notable


@pytest.mark.parametrize(
    ("count", "words"),
    [(1, "The number is not"), (2, "Both numbers are not"), (3, "All 3 numbers are not")],
)
def test_numbers_that_are_not_off_are_counted(count, words):
    quiet = dict(list(SETUP.items())[2 : 2 + count])
    text = "\n".join(summary(case(setup=quiet), LENGTH, Path("build/diagnosis")))
    assert f"{words} clearly off" in text
