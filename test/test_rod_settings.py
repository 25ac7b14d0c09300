# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The physics needs no more than its own part of the settings, and hands it back whole."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from dlo_ros.parameters import RodParameters, RodSettings, Settings
from dlo_ros.rod.model import RodModel
from dlo_ros.spline import SplineBasis

ROD = RodParameters(0.4, 0.004, 5e7, 2500.0)
BASIS = SplineBasis(10, 0.4)


def test_settings_take_over_all_physics_of_others_and_keep_the_rest():
    given = Settings(ROD, frame_id="table", tolerances={"clamp_angle.start": 0.02})
    other = RodSettings(
        replace(ROD, young_modulus=1e7), gravity=(0.0, 0.0, -1.6),
        damping=replace(given.damping, air_drag=0.5),
        simulation=replace(given.simulation, tolerance=1e-3),
        effects={"gravity_tilt": {"angle": 0.1}},
    )  # fmt: skip
    found = given.with_physics(other)
    for field in fields(RodSettings):
        assert getattr(found, field.name) == getattr(other, field.name)
        assert getattr(other, field.name) != getattr(given, field.name)
    assert found.frame_id == "table" and found.tolerances == given.tolerances
    assert type(found) is Settings


@pytest.mark.parametrize("effects", [{}, {"gravity_tilt": {"angle": 0.1}}])
def test_a_rod_is_the_same_without_the_rest_of_a_parameter_file(effects):
    rods = [RodModel(kind(ROD, effects=effects), BASIS) for kind in (RodSettings, Settings)]
    np.testing.assert_array_equal(rods[0].line_load, rods[1].line_load)
    np.testing.assert_array_equal(rods[0].stiffness.bend, rods[1].stiffness.bend)
