# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands hold the ends of a DLO, or leave them free."""

from types import SimpleNamespace

import pytest

from dlo_ros.inference.scene import free_ends


@pytest.mark.parametrize(
    ("names", "free"),
    [
        (["start"], ["end"]),
        (["control_point_1"], ["end"]),
        (["control_point_5"], ["start", "end"]),  # neither end, but the middle
        (["start", "end"], []),
        (["start", "control_point_10"], []),
        (["control_point_1", "control_point_2", "control_point_9"], []),
    ],
)
def test_an_end_is_free_that_nothing_holds(names, free):
    manipulation = SimpleNamespace(commands=(SimpleNamespace(names=tuple(names)),))
    assert list(free_ends(manipulation, 10)) == free
