# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which of several measured courses is the DLO, and what runs along another strand."""

import numpy as np
import pytest

from dlo_ros.vision.tracing.course_choice import AmbiguousError, choose, on_two_strands

WIDTH = 10.0
LINE = np.column_stack([np.linspace(0.0, 400.0, 201), np.zeros(201)])


def beside(offset, first=60, last=140):
    """The line with a part of it that runs beside, shape (201, 2)."""
    rise = np.interp(np.arange(201), [first - 20, first, last, last + 20], [0.0, 1.0, 1.0, 0.0])
    return LINE + np.column_stack([np.zeros(201), offset * rise])


def test_courses_that_were_measured_alike_are_one():
    assert choose([LINE, beside(6.0), LINE[::-1]], [], WIDTH, either_way=True) == 0
    shorter = LINE[:180]  # differs in nothing but where one end lies
    assert choose([shorter, LINE], [], WIDTH, either_way=False) == 0


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
