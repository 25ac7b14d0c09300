# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Newton's method in lanes against that of one span at a time, for what is not linear."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command, straight
from scipy.spatial.transform import Rotation

from dlo_ros.parameters import DampingParameters
from dlo_ros.rod import compiled_rod, integration
from dlo_ros.rod.lanes.simd_tables import TARGET, tables_of
from dlo_ros.rod.packing import insensitive
from dlo_ros.rod.resolution import build
from dlo_ros.rod.solve.newton_in_lanes import planar_lanes

STAMPS = [SECOND // 20, SECOND // 5, 2 * SECOND // 5, SECOND]
NAMES = ("young_modulus", "density", "relaxation_time")
TURNED = Rotation.from_rotvec([[0.0, a, 0.0] for a in (0.0, 0.4, -0.2)]).as_quat()[:, None]
SWUNG = command(
    ["start"], [0.0, 0.2, 0.5], [[[0.0, 0.0, 0.0]], [[0.03, 0.0, 0.0]], [[0.0, 0.0, 0.02]]], TURNED
)
EFFECTS = {
    "plasticity": {"yield_curvature": 2.0, "hardening": 0.4},
    "nonlinear_stiffness": {"half_curvature": 3.0},
    "hysteresis": {"moment": 2e-4, "curvature": 0.5},
    "viscoelasticity": {"share": 0.4, "time": 0.3},
    "obstacle": {"x": 0.25, "z": -0.04, "radius": 0.02},
    "wall": {"offset": -0.04, "angle": 0.1},
    "surface_friction": {"force": 0.05},
    "quadratic_drag": {"coefficient": 0.1},
    "clamp_slip": {"length": 0.02, "onset": 0.1, "duration": 0.3},
}


SLOW = DampingParameters(air_drag=5.0, relaxation_time=0.05)
"""In which a DLO touches without a bounce: impacts multiply what the solvers leave."""


def followed(effect, *, without=False):
    """The motion of a cantilever that swings with an effect, with sensitivities."""
    settings = PAPER if without else PAPER.with_effects({effect: EFFECTS[effect]})
    if effect in ("obstacle", "wall"):
        settings = replace(settings, damping=SLOW)
    model, boundary = build(settings, SWUNG, 9)
    state = insensitive(straight(model), len(NAMES))
    return integration.integrate(model, boundary, state, SWUNG, STAMPS, NAMES, flat=True)


@pytest.mark.parametrize("effect", EFFECTS)
def test_a_motion_is_that_of_the_other_solver(effect, monkeypatch):
    monkeypatch.setattr(integration, "NEWTON_SHARE", 1e-9)  # it leaves next to nothing
    lanes = followed(effect)
    assert np.abs(lanes.shapes - followed(effect, without=True).shapes).max() > 1e-3
    monkeypatch.setattr(
        compiled_rod, "planar_lanes", lambda tables, *, usable: planar_lanes(tables, usable=False)
    )
    alone = followed(effect)
    assert lanes.steps == alone.steps
    np.testing.assert_allclose(lanes.shapes, alone.shapes, atol=1e-8)
    np.testing.assert_allclose(lanes.speeds, alone.speeds, atol=1e-6)
    scale = np.abs(alone.derivatives).max(axis=(0, 2, 3), keepdims=True)
    np.testing.assert_allclose(lanes.derivatives / scale, alone.derivatives / scale, atol=1e-4)


def test_a_rod_whose_ends_hold_all_of_it_has_nothing_to_solve():
    tables = tables_of(build(PAPER, SWUNG, 1)[0].rule, np.full((4, 2), TARGET), alone=True)
    assert not planar_lanes(tables, usable=True).usable
