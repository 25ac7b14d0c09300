# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands hold the ends of a DLO, or leave them free; a DLO that is straight has causes, too."""

from types import SimpleNamespace

import numpy as np
import pytest
import recordings_samples as samples

from dlo_ros.effects.registry import starts
from dlo_ros.inference.priors import cause_priors
from dlo_ros.inference.scene import free_ends, scene, scene_of
from dlo_ros.spline import SplineBasis


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


def test_every_cause_can_be_tried_on_a_dlo_that_hangs_straight():
    """Those whose size is a curvature start at a share of the one that occurs."""
    rod = samples.SETTINGS.rod
    shape = np.zeros((rod.control_points, 3))
    shape[:, 2] = -SplineBasis(rod.control_points, rod.length).greville
    for start in starts(scene(samples.SETTINGS, ["start"], [np.array([shape, shape])])):
        fitted, _ = cause_priors(samples.SETTINGS, start)
        assert all(np.isfinite(p.centre) for p in fitted)


def test_no_wall_is_offered_that_holds_back_a_held_end():
    """The start is held at x = 0 and the whole DLO to the right of it, lower in the other one."""
    settings = samples.SETTINGS
    n = settings.rod.control_points
    shape = np.zeros((n, 3))
    shape[:, 0] = np.linspace(0.0, 0.9 * settings.rod.length, n)
    shape[:, 2] = -0.1 * settings.rod.length * np.linspace(0.0, 1.0, n)

    def walls(*commands):
        recordings = [
            SimpleNamespace(
                manipulation=SimpleNamespace(commands=(SimpleNamespace(names=(end,)),)),
                observed=np.array([shape, shape]),
            )
            for end in commands
        ]
        found = starts(scene_of(settings, recordings))
        return [s.form for s in found if s.effect == "wall"]

    assert walls("start") == ["table", "table", "right", "right"]
    assert walls("end") == ["left", "left"]
    assert walls("control_point_5") == ["table", "table", "left", "left", "right", "right"]
    assert walls("start", "end") == []
