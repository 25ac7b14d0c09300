# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects and their numbers in words: units of a person, sides instead of signs."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnoses import KNOWN, MASS, case

from dlo_ros.cli.diagnosis_output import report, summary
from dlo_ros.cli.diagnosis_words import remedies, rows, values
from dlo_ros.cli.effect_words import amount, clause, label, off_by, title
from dlo_ros.diagnosis import NamedEffect, Number
from dlo_ros.effects import effects
from dlo_ros.parameter_table import PARAMETERS
from dlo_ros.report.diagnosis import diagnosis_page
from dlo_ros.report.diagnosis_content import GROUPS
from dlo_ros.report.elements import measured, percent

DEGREE = np.pi / 180.0
LENGTH = KNOWN.rod.length


def test_every_effect_says_what_it_is():
    for name, effect in effects().items():
        assert title(name) and clause(name)
        if effect.__module__.startswith("dlo_ros"):
            assert effect.title and effect.phrase, name
            assert effect.group in GROUPS, name
            # Remedies are short, and whole sentences.
            assert 0 < len(effect.remedy) < 110 and effect.remedy.endswith("."), name
            assert effect.remedy[0].isupper(), name
            mentioned = re.findall(r"(?:effects|rod|command|damping)\.\w+", effect.remedy)
            known = {p.name for p in PARAMETERS} | {f"effects.{n}" for n in effects()}
            assert set(mentioned) <= known, name
            assert clause(name)[0].islower() and not clause(name).endswith(".")
    assert title("not_known") == "not known" and "not known" in clause("not_known")


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (amount(0.0312, 0.0021, "kg"), "31 +- 2 g"),
        (amount(1.5, 0.2, "kg"), "1.5 +- 0.2 kg"),
        (amount(0.0312, None, "m"), "31.2 +- unknown mm"),
        (amount(0.02, 0.0013, "s"), "20.0 +- 1.3 ms"),
        (off_by(0.5, 0.04, "stiff_segment", "ratio"), "50 +- 4 % softer"),
        (off_by(np.float64(-0.0021), 3e-4, "length_error", "difference"), "2.1 +- 0.3 mm shorter"),
        (off_by(0.0021, 0.0003, "length_error", "difference"), "2.1 +- 0.3 mm longer"),
        (off_by(-0.012, 0.003, "command_delay", "delay"), "12 +- 3 ms earlier"),
        (off_by(0.002, 0.001, "clamp_offset", "end", 1, 2), "2.0 +- 1.0 mm up"),
        (off_by(0.002, 0.001, "clamp_offset", "end", 1, 3), "2.0 +- 1.0 mm away from the camera"),
        (off_by(-0.002, 0.001, "grip_offset", "end", 0, 3), "2.0 +- 1.0 mm towards the start"),
        (off_by(-0.002, 0.001, "grip_offset", "end", 2, 3), "-2.0 +- 1.0 mm"),
        (off_by(-1 * DEGREE, DEGREE, "clamp_angle", "end"), "1.0 +- 1.0 degrees counterclockwise"),
        (off_by(-1 * DEGREE, DEGREE, "clamp_angle", "end", 2, 3), "-1.0 +- 1.0 degrees"),
        (off_by(0.0, 0.001, "length_error", "difference"), "0.0 +- 1.0 mm"),
        (label("intrinsic_curvature.curvature[0]", 5), "curvature at rest, at the start"),
        (label("intrinsic_curvature.curvature[1]", 4), "curvature at rest, at 33 % of the length"),
        (label("intrinsic_curvature.curvature[2]", 5), "curvature at rest, in the middle"),
        (label("grip_angle.end[1]", 2), "direction of a grip in the hand, at the end, z"),
        (label("clamp_offset.end[1]", 2), "place of a clamp, at the end, z"),
        (label("gravity_tilt.angle"), "tilt of the board"),
        (label("gravity_tilt.across"), "tilt of the board, rotation of gravity out of that plane"),
        (label("twisting_stiffness.ratio"), "twisting stiffness"),
        (percent(0.999), "over 99 %"),
        (percent(0.001), "under 1 %"),
        (measured(12.3, 0.196, sparing=True), "12.3 +- 0.2"),
        (measured(12.3, 0.15, sparing=True), "12.30 +- 0.15"),
    ],
)
def test_numbers_are_those_of_a_person(told, words):
    assert told == words


def test_it_is_told_what_a_person_can_do_about_each_cause():
    turned = NamedEffect("clamp_angle", {"end": Number(-0.1, 0.01, "rad")}, ("point_mass", "wall"))
    assert remedies([MASS]) == (f"Mass on the DLO: {effects()['point_mass'].remedy}",)
    assert remedies([]) == remedies([replace(MASS, name="not_known")]) == ()
    first, *others = remedies([MASS, turned])
    assert first.startswith("Of causes that the data do not tell apart, look first which")
    assert [text.partition(":")[0] for text in others] == [
        "Mass on the DLO", "Direction of a clamp", "Wall or table"
    ]  # fmt: skip
    made = case(causes=[turned])
    text = "\n".join(summary(made, LENGTH, Path("build/diagnosis")))
    assert "by hand?\n  Of causes that" in text and "Turn the clamp back by as much" in text
    assert "Turn the clamp back by as much" in diagnosis_page(report(made, KNOWN))
    assert "by hand?" not in diagnosis_page(report(case(causes=()), KNOWN))


def test_several_values_are_told_in_one_phrase():
    curved = NamedEffect(
        "intrinsic_curvature", {"curvature": Number((-0.5, 2.1), (0.2, 0.2), "1/m")}, ()
    )
    assert values(curved, LENGTH) == (
        "curvature from 0.50 1/m counterclockwise to 2.1 1/m clockwise, each +- 0.2"
    )
    one_way = replace(curved, parameters={"curvature": Number((-0.5, -2.1), (0.2, 0.2), "1/m")})
    assert values(one_way, LENGTH) == "curvature from 0.50 to 2.1 1/m counterclockwise, each +- 0.2"
    alike = replace(curved, parameters={"curvature": Number((-1.498, -1.502), (0.04, 0.04), "1/m")})
    assert values(alike, LENGTH) == "curvature 1.5 1/m counterclockwise everywhere, each +- 0.04"
    across = replace(one_way, parameters={"across": one_way.parameters["curvature"]})
    assert values(across, LENGTH) == "across from -2.1 to -0.50 1/m, each +- 0.2"
    graded = NamedEffect("stiffness_gradient", {"change": Number(0.866, 0.006, "")}, ())
    assert values(graded, LENGTH) == "by 86.6 +- 0.6 %"
    numbers = {"hardening": Number(0.23, 0.01, "")}
    assert values(NamedEffect("plasticity", numbers, ()), LENGTH) == "hardening 23.0 +- 1.0 %"
    moved = NamedEffect("clamp_offset", {"end": Number((0.002, -0.001), (0.0004, 0.0003), "m")}, ())
    assert values(moved, LENGTH) == "at the end 2.0 +- 0.4 mm to the right, 1.0 +- 0.3 mm down"


@pytest.mark.parametrize(("std", "said"), [(0.14, ""), (0.05, ", taper 0.21 +- 0.05")])
def test_a_form_that_the_data_hardly_tell_stands_in_the_table_alone(std, said):
    numbers = {
        "extent": Number(0.23, 0.01, "m"), "ratio": Number(2.4, 0.4, ""),
        "taper": Number(0.21, std, ""),
    }  # fmt: skip
    segment = NamedEffect("stiff_segment", numbers, ())
    assert values(segment, 1.5) == f"extent 230 +- 10 mm, ratio 2.4 +- 0.4{said}"
    assert [name for name, *_ in rows(segment, 1.5)] == ["extent", "ratio", "taper"]


def test_what_the_data_do_not_determine_is_no_number():
    """A cause may be certain where one of its numbers is not known at all."""
    soft = NamedEffect("nonlinear_stiffness", {"half_curvature": Number(100.0, 400.0, "1/m")}, ())
    assert values(soft, LENGTH) == "half curvature not determined"
    known = NamedEffect("nonlinear_stiffness", {"half_curvature": Number(100.0, 40.0, "1/m")}, ())
    assert values(known, LENGTH) == "half curvature 100 +- 40 1/m"
    peg = {"x": Number(0.26, 41.0, "m"), "radius": Number(0.024, 0.003, "m")}
    said = values(NamedEffect("obstacle", peg, ()), LENGTH)
    assert said == "x not determined, radius 24 +- 3 mm"
    (x, radius) = rows(NamedEffect("obstacle", peg, ()), LENGTH)
    assert x[:2] == ("x", "not determined (260 mm in the file)")
    assert radius[:2] == ("radius", "24.0 +- 3.0 mm")
    # The word stands for the sign, and the meaning says which side is positive.
    bent = {"kink": Number(-0.3, 0.02, "rad"), "position": Number(0.2, 0.3, "m")}
    kink, position = rows(NamedEffect("intrinsic_curvature", bent, ()), LENGTH)
    assert kink[1:] == (
        "17.2 +- 1.1 degrees counterclockwise", "angle of a kink; positive: clockwise"
    )  # fmt: skip
    assert position[1] == "not determined (200 mm in the file)"
    # Zero is a value like any other where nothing is wrong at zero.
    shift = NamedEffect("camera_shift", {"x": Number(-2e-6, 4e-4, "m")}, ())
    assert values(shift, LENGTH) == "0.0 +- 0.4 mm to the left"


def test_every_number_with_two_sides_has_two_words():
    """What may lie on either side of nothing says on which, unless it is an angle in space."""
    for effect in effects().values():
        for q in effect.quantities():
            if q.geometric or not effect.__module__.startswith("dlo_ros"):
                continue
            two_sided = q.lower < q.neutral < q.upper and q.tolerance is not None
            free = not (q.spatial and q.unit == "1/m")
            assert bool(q.sides) >= (two_sided and free and q.lower < 0.0), (effect.name, q.name)
            assert all(len(set(pair)) == 2 or pair == ("", "") for pair in q.sides)
