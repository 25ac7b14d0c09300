# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The numbers of a set-up as lines of a table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnoses import LENGTH, SETUP, case

from dlo_ros.cli.diagnosis_output import summary
from dlo_ros.cli.effect_words import RIGHT_HAND
from dlo_ros.cli.set_up_table import setup_lines
from dlo_ros.diagnosis import NamedEffect, Number, SetupNumber
from dlo_ros.report.diagnosis_content import GROUPS, OFF_BY, grouped


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
    assert " ".join(rows[1:3]).split() == OFF_BY.split()
    assert rows[3].split() == ["what", "off", "by", "tolerance"]
    assert [rows[4], rows[6]] == ["  camera:", "  clamps:"]
    assert rows[5].split() == [
        "camera",
        "scale",
        "0.40",
        "+-",
        "0.10",
        "%",
        "too",
        "small",
        "0.50",
        "%",
    ]
    assert rows[7].startswith(
        "    direction of a clamp, at the start  2.1 +- 0.4 degrees clockwise"
    )
    assert rows[8] == "  3 other numbers may well be right: report.html has them."


def test_numbers_stand_below_the_part_that_they_belong_to():
    made = {
        "command_delay.delay": SetupNumber(0.05, 0.001, 0.02, "s"),
        "gravity_tilt.angle": SetupNumber(0.2, 0.01, 0.0175, "rad"),
        "length_error.difference": SetupNumber(0.02, 0.001, 0.002, "m"),
        "camera_shift.x": SetupNumber(0.002, 1e-4, 0.002, "m"),
    } | {f"clamp_angle.end[{k}]": SetupNumber(0.1, 0.01, 0.05, "rad") for k in range(3)}
    lines = setup_lines(case(setup=made))
    parts = grouped(lines)
    assert [part for part, _ in parts] == list(GROUPS)
    assert sum(len(members) for _, members in parts) == len(made)
    foreign = replace(lines[0], group="weather")
    assert grouped([foreign, *lines])[-1] == ("weather", [foreign])
    # The words for sides are those of the sentences; the files have signs.
    positive = {line.name: line.positive for line in lines}
    assert positive["tilt of the board"] == "counterclockwise"  # gravity turns the other way
    assert positive["direction of a clamp, at the end, y"] == "clockwise"
    assert positive["direction of a clamp, at the end, z"] == RIGHT_HAND
    text = "\n".join(summary(case(setup=made), LENGTH, Path("build/diagnosis")))
    assert "An angle with a sign follows the right-hand rule" in " ".join(text.split())
    plane = {k: n for k, n in made.items() if "[" not in k}
    text = "\n".join(summary(case(setup=plane), LENGTH, Path("build/diagnosis")))
    assert "right-hand" not in text


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
    [(1, "The number may"), (2, "Both numbers may"), (3, "All 3 numbers may")],
)
def test_numbers_that_are_not_off_are_counted(count, words):
    quiet = dict(list(SETUP.items())[2 : 2 + count])
    text = "\n".join(summary(case(setup=quiet), LENGTH, Path("build/diagnosis")))
    assert f"{words} well be right: report.html has {'it' if count == 1 else 'them'}." in text
