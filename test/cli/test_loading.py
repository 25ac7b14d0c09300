# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Names of recordings that tools are given."""

from pathlib import Path

import pytest

from dlo_ros.cli.loading import distinct_names
from dlo_ros.errors import InputError


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (("/a/one", "/a/two"), ["one", "two"]),
        (("/monday/pull", "/tuesday/pull", "/tuesday/swing"), ["monday/pull", "tuesday/pull",
                                                              "swing"]),
        (("/x/b/pull", "/y/b/pull"), ["x/b/pull", "y/b/pull"]),
        (("/pull", "/b/pull"), ["/pull", "b/pull"]),
    ],
)  # fmt: skip
def test_recordings_of_one_name_are_told_apart_by_their_folders(paths, names):
    assert distinct_names([Path(p) for p in paths]) == names


def test_a_recording_that_is_given_twice_is_refused():
    with pytest.raises(InputError, match=r"one is given twice; give each recording once"):
        distinct_names([Path("one"), Path("b/../one")])
