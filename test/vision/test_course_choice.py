# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which of several measured courses is the DLO, and what runs along another strand."""

import numpy as np
import pytest
from vision_stress import judge

from dlo_ros.vision.fit.course_evidence import bending_evidence, chance_length
from dlo_ros.vision.fit.material_coordinates import length_log_likelihood
from dlo_ros.vision.tracing import course_choice
from dlo_ros.vision.tracing.course_choice import DECISIVE, AmbiguousError, on_two_strands

WIDTH = 10.0
LINE = np.column_stack([np.linspace(0.0, 400.0, 201), np.zeros(201)])


def beside(offset, first=60, last=140):
    """The line with a part of it that runs beside, shape (201, 2)."""
    rise = np.interp(np.arange(201), [first - 20, first, last, last + 20], [0.0, 1.0, 1.0, 0.0])
    return LINE + np.column_stack([np.zeros(201), offset * rise])


def choose(courses, expected, width, *, either_way, evidence=None):
    """The choice among courses of equal evidence, unless it is given."""
    alike = np.zeros(len(courses))
    return course_choice.choose(
        courses, alike if evidence is None else evidence, expected, width, either_way=either_way
    )


def test_courses_that_were_measured_alike_are_one():
    assert choose([LINE, beside(6.0), LINE[::-1]], [], WIDTH, either_way=True) == 0
    shorter = LINE[:180]  # differs in nothing but where one end lies
    assert choose([shorter, LINE], [], WIDTH, either_way=False) == 0


def test_courses_that_differ_where_nothing_was_seen_are_one():
    hidden, whole = np.ones(len(LINE), bool), np.ones(len(LINE), bool)
    hidden[38:162] = False
    args = ([LINE, beside(15.0)], [0.0, 1.0], [], WIDTH)
    assert course_choice.choose(*args, either_way=True, seen=[hidden, hidden]) == 1
    with pytest.raises(AmbiguousError):
        course_choice.choose(*args, either_way=True, seen=[hidden, whole])
    # A longer way behind what hides it shifts u of all that was seen.
    longer = ([LINE, beside(40.0, 90, 110)], [0.0, 1.0], [], WIDTH)
    with pytest.raises(AmbiguousError):
        course_choice.choose(*longer, either_way=True, seen=[hidden, hidden])
    # Pieces in another order make another course, wherever they were seen.
    swapped = np.vstack([LINE[:61], LINE[140:60:-1], LINE[141:]])
    with pytest.raises(AmbiguousError):
        both = [np.ones(len(c), bool) for c in (LINE, swapped)]
        course_choice.choose([LINE, swapped], [0.0, 1.0], [], WIDTH, either_way=False, seen=both)


def test_a_strand_beside_is_a_second_course():
    with pytest.raises(AmbiguousError, match="equally plausible"):
        choose([LINE, beside(15.0)], [], WIDTH, either_way=True)
    with pytest.raises(AmbiguousError):
        choose([LINE, LINE[::-1]], [], WIDTH, either_way=False)


def test_an_expected_shape_chooses_the_nearer_course():
    courses = [LINE, beside(30.0)]
    assert choose(courses, [beside(3.0)], WIDTH, either_way=True) == 0
    assert choose(courses, [beside(27.0)], WIDTH, either_way=True) == 1
    for expected in ([beside(15.0)], [beside(100.0)], [LINE, beside(30.0)]):
        with pytest.raises(AmbiguousError):
            choose(courses, expected, WIDTH, either_way=True)


def test_expected_shapes_change_nothing_where_one_course_remains():
    assert choose([LINE], [beside(100.0)], WIDTH, either_way=True) == 0


def test_two_strands_are_further_apart_than_a_width_for_longer_than_one():
    seen = np.ones(len(LINE), bool)
    assert on_two_strands(beside(15.0), seen, LINE, seen, WIDTH)
    assert not on_two_strands(beside(9.0), seen, LINE, seen, WIDTH)
    hidden = seen.copy()
    hidden[35:165] = False
    assert not on_two_strands(beside(15.0), hidden, LINE, seen, WIDTH)
    assert not on_two_strands(beside(15.0), seen, LINE, hidden, WIDTH)
    # What lies ahead of the other's end is no other strand.
    assert not on_two_strands(LINE, seen, LINE[:120], seen[:120], WIDTH)


def test_evidence_decides_where_it_is_decisive():
    courses = [beside(30.0), LINE]
    clear = [0.0, DECISIVE + 0.1]
    for expected in ([], [courses[0]]):  # an expected shape brings no course back
        assert choose(courses, expected, WIDTH, either_way=True, evidence=clear) == 1
    with pytest.raises(AmbiguousError):
        choose(courses, [], WIDTH, either_way=True, evidence=[0.0, DECISIVE - 0.1])


def test_a_course_that_bends_to_and_fro_has_less_evidence():
    x = np.linspace(0.0, 1000.0, 1001)
    arc = np.column_stack([x, 5e-4 * (x - 500.0) ** 2])
    aside = arc + np.column_stack([0.0 * x, 30.0 * np.exp(-(((x - 500.0) / 50.0) ** 2))])
    assert bending_evidence(arc, WIDTH) > bending_evidence(aside, WIDTH) + DECISIVE
    # The evidence is the same in another unit, and either way along the course.
    assert bending_evidence(0.1 * aside, 0.1 * WIDTH) == pytest.approx(
        bending_evidence(aside, WIDTH)
    )
    assert bending_evidence(aside[::-1], WIDTH) == pytest.approx(bending_evidence(aside, WIDTH))
    # Bends smaller than the errors of the measurement are no evidence.
    wavy = arc + np.column_stack([0.0 * x, 0.02 * np.sin(x / 20.0)])
    assert bending_evidence(wavy, WIDTH) == pytest.approx(bending_evidence(arc, WIDTH), abs=0.5)


def test_a_course_in_space_has_the_evidence_of_the_same_course_in_its_plane():
    x = np.linspace(0.0, 1000.0, 1001)
    z = 30.0 * np.sin(x / 100.0)
    flat, tilted = np.column_stack([x, z]), np.column_stack([x, 0.6 * z, 0.8 * z])
    assert bending_evidence(tilted, WIDTH) == pytest.approx(bending_evidence(flat, WIDTH))


def test_a_likelier_course_of_which_a_part_was_seen_leaves_the_picture_silent():
    evidence = np.zeros(1)
    args = ([LINE], evidence, [], WIDTH)
    assert course_choice.choose(*args, -1.0, either_way=True) == 0
    with pytest.raises(AmbiguousError):
        course_choice.choose(*args, 1.0, either_way=True)


def test_a_length_far_off_is_likelier_that_of_a_course_by_chance():
    limits = (0.1, 0.05)
    assert not chance_length(0.402, limits, 0.4, 0.0)
    assert chance_length(0.408, limits, 0.4, 0.0)
    assert not chance_length(0.408, limits, 0.4, 0.01)  # the length is known less well


def test_a_wrong_length_is_evidence_but_no_proof():
    right, wrong = length_log_likelihood(np.array([0.4, 0.42]), 0.4, 0.0)
    assert 4.0 < right - wrong < 2.0 * DECISIVE
    known_less_well = length_log_likelihood(np.array([0.4, 0.42]), 0.4, 0.02)
    assert known_less_well[0] - known_less_well[1] < 1.0


def test_a_course_of_pieces_that_is_too_long_is_not_taken_for_the_dlo():
    verdict = judge(501373, ends="start")  # u was wrong by 2 % of L before
    assert verdict.found in ("right", "silent")
    assert not verdict.beyond


@pytest.mark.parametrize("seed", [502381, 502677, 501533, 500629])
def test_the_picture_decides_between_the_dlo_and_a_strand_beside_it(seed):
    # Ropes of one colour that meet at a small angle, or lie beside one another for some widths.
    assert judge(seed, ends="start").found == "right"
