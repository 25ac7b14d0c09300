# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The observer in space where strands cross, or a second rope lies behind: right or silent."""

import pytest
from vision_space_strands import outcome


@pytest.mark.parametrize(("kind", "seed"), [("loop", 111), ("second", 12), ("second", 352)])
def test_a_course_that_turns_off_its_strand_in_one_view_is_refused(kind, seed):
    assert outcome(seed, kind, 1) != "wrong"


def test_a_rope_that_crosses_itself_is_found():
    assert [outcome(seed, "loop", 1) for seed in range(101, 109)].count("right") >= 6


def test_a_rope_with_another_one_of_its_look_behind_it_is_found():
    # Its course goes on where both cross, though it may end there for all its length says.
    assert [outcome(seed, "second", 1) for seed in (600002, 600004, 600006)] == ["right"] * 3


@pytest.mark.parametrize(
    ("kind", "ends", "seed"),
    [
        ("second", 2, 600079),  # over the bare board, beside a part that one view shows end on
        ("second", 1, 600051),  # of a course that one view shows more evidence for: refused there
        ("second", 1, 600018),  # two per cent too short, as a course by chance is
        ("second", 1, 600033),  # two shapes of nearly the same evidence
    ],
)
def test_a_second_answer_leaves_the_pictures_silent(kind, ends, seed):
    assert outcome(seed, kind, ends) not in ("right", "wrong")
