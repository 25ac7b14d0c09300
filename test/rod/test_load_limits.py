# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Limits of what a DLO bears, and the extremes of a motion, in the words that a person reads."""

import numpy as np
import pytest

from dlo_ros.errors import ParameterError
from dlo_ros.parameters import LimitParameters, Settings
from dlo_ros.report.identification import IdentificationReport, identification_page
from dlo_ros.report.loads import LoadRow, loads_table
from dlo_ros.rod.loads.extreme_loads import Extremes
from dlo_ros.rod.loads.grip_reactions import Loading, Wrench
from dlo_ros.rod.loads.load_limits import load_warnings

GIVEN = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e6, "rod.density": 1e3}


def bearing(tension, radius, start=None, end=None):
    return Loading(start, end, tension, 0.1, radius, 0.2)


def wrench(force, torque=0.0):
    return Wrench(np.array([0.0, force, 0.0]), np.array([torque, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("tension", "radius", "expected"),
    [
        (8.9, 0.023, []),
        (9.5, 0.5, [("limits.tension", False)]),
        (10.5, 0.5, [("limits.tension", True)]),
        (-30.0, 0.0215, [("limits.bend_radius", False)]),
        (10.5, 0.0195, [("limits.tension", True), ("limits.bend_radius", True)]),
    ],
)
def test_limits_are_told_when_near_and_when_passed(tension, radius, expected):
    found = load_warnings(bearing(tension, radius), LimitParameters(bend_radius=0.02, tension=10.0))
    assert [(s.name, s.passed) for s in found] == expected


def test_without_limits_nothing_is_told():
    assert load_warnings(bearing(1e6, 1e-6), LimitParameters()) == []


def test_the_words_name_value_place_and_limit():
    limits = LimitParameters(bend_radius=0.02, tension=10.0)
    texts = [s.text for s in load_warnings(bearing(12.345, 0.0111), limits)]
    assert texts == [
        "tension 12.3 N at u = 0.1 m is beyond limits.tension, 10 N",
        "bend radius 11.1 mm at u = 0.2 m is below limits.bend_radius, 20 mm",
    ]


@pytest.mark.parametrize("name", ["limits.tension", "limits.bend_radius"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), "much", 1e7])
def test_a_limit_that_is_none_is_refused(name, value):
    with pytest.raises(ParameterError, match=name):
        Settings.from_mapping({**GIVEN, name: value})


def test_extremes_tell_what_where_and_when():
    motion = [
        bearing(1.0, 0.5, wrench(1.0), None),
        bearing(3.0, 0.05, wrench(-4.0, 0.2), wrench(0.5)),
        bearing(2.0, 0.01, wrench(2.0), wrench(2.5, -0.1)),
    ]
    found = Extremes(motion, [0.0, 0.5, 1.0])
    first, grips, *alarms = found.sentences(LimitParameters(bend_radius=0.06, tension=2.5))
    assert "tension 3 N at u = 0.1 m, 0.50 s" in first
    assert "bend radius 10 mm at u = 0.2 m, 1.00 s" in first
    assert "4 N and 0.2 N m at u = 0, 0.50 s; 2.5 N and 0.1 N m at u = L, 1.00 s" in grips
    assert len(alarms) == 2
    assert "limits.tension" in alarms[0] and "passed at 1 of 3 instants" in alarms[0]
    assert "limits.bend_radius" in alarms[1] and "passed at 2 of 3 instants" in alarms[1]


def test_a_free_straight_dlo_has_no_grips_and_no_radius():
    (line,) = Extremes([bearing(0.0, 4e5)], [0.0]).sentences(LimitParameters(bend_radius=0.02))
    assert "infinite (straight)" in line


def test_reports_show_what_was_borne():
    rows = (LoadRow("lift <1>", 1.234, 0.0567, 2.5, None), LoadRow("rest", 0.1, 4e5, None, 0.1))
    shown = loads_table(rows)
    assert "lift &lt;1&gt;" in shown and "<td>1.2 N</td>" in shown
    assert "<td>56.7 mm</td>" in shown and "straight" in shown
    report = IdentificationReport("t", "h", (), (), loads=rows)
    assert "Largest loads in the recordings" in identification_page(report)
    bare = IdentificationReport("t", "h", (), ())
    assert "Largest loads" not in identification_page(bare)
