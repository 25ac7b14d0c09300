# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands and observations may be given as lists and as arrays of any type."""

from dataclasses import replace

import numpy as np
import pytest
from rods import command

from dlo_ros.command import Command
from dlo_ros.errors import CommandError, InputError
from dlo_ros.observation import Observation

GIVEN = command(["start", "end"], [0, 1], [[[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 2]]])
ARRAYS = ("times", "positions", "rotations")


def apart(values):
    """An array of the same numbers, each beside another one in memory."""
    wide = np.repeat(values[..., None], 2, axis=-1)
    return wide[..., 0]


@pytest.mark.parametrize(
    "given",
    [
        lambda values: values.tolist(),
        lambda values: values.astype(int),
        lambda values: values.astype(np.float32),
        apart,
        lambda values: np.broadcast_to(values, values.shape),  # is read-only
    ],
    ids=["lists", "integers", "single precision", "not contiguous", "read-only"],
)
def test_numbers_of_a_command_are_taken_as_they_come(given):
    """All are alike for compiled code, which would be compiled anew in half a minute."""
    names = list(GIVEN.names)
    made = replace(GIVEN, names=names, **{key: given(getattr(GIVEN, key)) for key in ARRAYS})
    for key in ARRAYS:
        found, known = getattr(made, key), getattr(GIVEN, key)
        np.testing.assert_array_equal(found, known)
        assert found.dtype == known.dtype and found.flags.carray
    assert made.names == ("start", "end")


@pytest.mark.parametrize("key", [*ARRAYS, "velocities"])
def test_what_is_no_array_of_numbers_is_refused_in_a_sentence(key):
    with pytest.raises(CommandError, match=f"has {key} that are no array of numbers"):
        replace(GIVEN, **{key: [[0.0, 1.0], [2.0]]})
    with pytest.raises(CommandError, match="shape"):
        replace(GIVEN, **{key: [[0.0, 1.0]]})


def test_two_commands_can_be_compared_and_kept_in_a_set():
    assert replace(GIVEN) != GIVEN
    assert isinstance(GIVEN, Command) and len({GIVEN, GIVEN}) == 1


def test_rows_of_numbers_are_an_observed_spline():
    rows = [[0.1 * k, 0, 0, 0] for k in range(10)]
    found = Observation(0, rows).control_points
    np.testing.assert_array_equal(found, np.array(rows, dtype=float))
    with pytest.raises(InputError, match=r"no array of numbers, \(n, 4\)"):
        Observation(0, [*rows, [0, 0]])
