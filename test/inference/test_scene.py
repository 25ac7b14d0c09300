# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands hold the ends of a DLO, or leave them free."""

from types import SimpleNamespace

import pytest

from dlo_ros.inference.scene import has_free_end


@pytest.mark.parametrize(
    ("names", "free"),
    [
        (["start"], True),
        (["control_point_1"], True),
        (["control_point_5"], True),  # neither end, but the middle
        (["start", "end"], False),
        (["start", "control_point_10"], False),
        (["control_point_1", "control_point_2", "control_point_9"], False),
    ],
)
def test_an_end_is_free_that_nothing_holds(names, free):
    manipulation = SimpleNamespace(commands=(SimpleNamespace(names=tuple(names)),))
    assert has_free_end(manipulation, 10) == free
