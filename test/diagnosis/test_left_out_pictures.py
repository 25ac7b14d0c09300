# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The sentence on pictures that do not count."""

from types import SimpleNamespace

import pytest

from dlo_ros.diagnosis.pipeline import _left_out


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ((0, 0), ""),
        ((), ""),
        ((0, 1), "1 of 201 pictures (push 1) does not count: "),
        ((3, 20), "23 of 223 pictures (swing 3, push 20) do not count: "),
    ],
)
def test_pictures_that_do_not_count_are_counted_by_recording(wrong, said):
    recordings = [SimpleNamespace(name=name, times=range(100)) for name in ("swing", "push")]
    beginning = SimpleNamespace(recordings=recordings, left_out=wrong)
    assert _left_out(beginning).startswith(said) and bool(_left_out(beginning)) is bool(said)
