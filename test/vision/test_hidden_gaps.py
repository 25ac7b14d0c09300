# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The course of a DLO over gaps in which something hides it."""

import numpy as np
import pytest
from vision_scenes import clamps, settings, to_board
from vision_stress import CONTROL_POINTS, picture_of

from dlo_ros.vision import Observer
from dlo_ros.vision.fit.hidden_gaps import even_parameters, hidden_gaps, trusted

RADIUS, PER_WIDTH = 80.0, 5.0


def arc(at):
    """Points of a circle at arc lengths `at`, shape (m, 2)."""
    return RADIUS * np.column_stack([np.sin(at / RADIUS), 1.0 - np.cos(at / RADIUS)])


@pytest.mark.parametrize("traced", [60, 100, 140])
def test_a_gap_is_as_long_as_the_arc_in_it_however_far_it_was_traced(traced):
    """The true gap is 100 profiles long, 1.25 rad of a circle."""
    seen = np.concatenate([np.arange(50.0), np.arange(150.0, 200.0)])
    profiles = np.where(seen < 100.0, seen, seen - 101.0 + traced)
    gaps = [(49, 49 + traced)]
    parameters = even_parameters(profiles, arc(seen), gaps, PER_WIDTH)
    assert parameters(profiles) == pytest.approx(seen, abs=0.6)
    # Beyond the ends they go on evenly: a hidden end may lie there.
    beyond = np.array([-10.0, profiles[-1] + 10.0])
    assert parameters(beyond) == pytest.approx([-10.0, 209.0], abs=0.6)


def test_without_gaps_parameters_are_profiles():
    profiles = np.arange(40.0)
    parameters = even_parameters(profiles, arc(profiles), [], PER_WIDTH)
    assert parameters(np.array([-3.0, 7.5, 50.0])) == pytest.approx([-3.0, 7.5, 50.0])


def test_a_side_too_short_to_show_a_direction_changes_nothing():
    profiles = np.array([0.0, 1.0, 2.0, *np.arange(40.0, 80.0)])
    parameters = even_parameters(profiles, arc(profiles), [(2, 40)], PER_WIDTH)
    assert parameters(profiles) == pytest.approx(profiles)


def test_where_the_colour_goes_on_nothing_is_hidden():
    seen = np.concatenate([np.arange(30), np.arange(60, 90)])
    trust = np.zeros(90)
    trust[seen] = 1.0
    assert hidden_gaps(seen, trust, PER_WIDTH) == [(29, 60)]
    trust[30:50] = 0.01  # of the DLO's colour, without an edge
    assert hidden_gaps(seen, trust, PER_WIDTH) == []
    assert hidden_gaps(np.array([0, 1, 2, 6, 7]), np.ones(8), PER_WIDTH) == []


def test_what_lies_in_a_gap_does_not_lead_and_what_lies_beside_it_hardly():
    trust = trusted(np.ones(100), [(40, 60)], PER_WIDTH)
    assert np.all(trust[41:60] == 0.0)
    assert np.all(trust[37:41] < 1e-3) and np.all(trust[37:41] > 0.0)
    assert np.all(trust[:36] == 1.0) and np.all(trust[65:] == 1.0)


def test_a_rope_behind_a_sheet_is_followed_behind_it():
    """A sheet hides a bend; what was traced along its edges made the curve bulge out of it."""
    kind, curve, scene, picture = picture_of("issue", 1210368)
    assert kind == "occlusion"
    known = settings(scene, CONTROL_POINTS)
    motion = clamps(curve, CONTROL_POINTS, ("start", "end"))
    result = Observer(known, scene.camera(), motion).observe(0, picture)
    true = scene.camera().project(to_board(curve))
    apart = np.linalg.norm(result.pixels[:, None] - true[None], axis=2).min(axis=1)
    assert apart.max() < 0.75 * scene.width_px
