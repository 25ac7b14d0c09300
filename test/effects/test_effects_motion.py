# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Every effect in motion: the spline rod and the discrete rod, two independent programs."""

from functools import cache

import numpy as np
import pytest
from ordinary import some_of
from twins import CLOSED, PINNED, WAVED, compare

pytestmark = pytest.mark.long

MANIPULATIONS = {"waved": WAVED, "closed": CLOSED, "pinned": PINNED}

# What both rods differ by without any effect: one has curvature per deformed, the other per
# reference length, and each its own mesh. The soft rod of "waved" bends by 16 / m at its clamp.
CASES = {
    "no effect": ("waved", {}),
    "no effect, held at both ends": ("closed", {}),
    "no effect, control points held": ("pinned", {}),
    "intrinsic_curvature": ("waved", {"intrinsic_curvature": {"curvature": -3.0}}),
    "intrinsic_curvature, several": (
        "waved", {"intrinsic_curvature": {"curvature": [-4.0, 3.0, 2.0]}}),
    "intrinsic_curvature, kink": (
        "waved", {"intrinsic_curvature": {"kink": 0.25, "position": 0.15}}),
    "clamp_angle": ("waved", {"clamp_angle": {"start": 0.2}}),
    "clamp_angle, both": ("closed", {"clamp_angle": {"start": 0.2, "end": -0.1}}),
    "clamp_angle of control points": ("pinned", {"clamp_angle": {"start": 0.2}}),
    "clamp_compliance": ("waved", {"clamp_compliance": {"start": 6.0}}),
    "clamp_compliance, both held": (
        "closed", {"clamp_compliance": {"start": 10.0, "end": 20.0}}),
    "a give beside a yield": (
        "closed", {"clamp_compliance": {"start": 10.0, "end": 20.0},
                   "plasticity": {"yield_curvature": 4.0, "hardening": 0.4}}),
    "a give beside softening": (
        "closed", {"clamp_compliance": {"start": 10.0, "end": 20.0},
                   "nonlinear_stiffness": {"half_curvature": 6.0}}),
    "a give beside friction within the DLO": (
        "closed", {"clamp_compliance": {"start": 10.0, "end": 20.0},
                   "hysteresis": {"moment": 2e-3, "curvature": 1.0}}),
    "connector": ("waved", {"connector": {"mass": 0.004, "extent": 0.05}}),
    "gravity_tilt": ("waved", {"gravity_tilt": {"angle": 0.15}}),
    "point_mass": ("waved", {"point_mass": {"mass": 0.004, "position": 0.25}}),
    "stiff_segment": ("waved", {"stiff_segment": {"centre": 0.12, "extent": 0.1, "ratio": 4.0}}),
    "stiff_segment at a clamp": (
        "closed", {"stiff_segment": {"centre": 0.03, "extent": 0.06, "ratio": 4.0}}),
    "stiff_segment that is soft": (
        "waved", {"stiff_segment": {"centre": 0.2, "extent": 0.08, "ratio": 0.3}}),
    "stiff_segment with tapered ends": (
        "waved", {"stiff_segment": {"centre": 0.2, "extent": 0.08, "ratio": 0.3, "taper": 0.4}}),
    "stiffness_gradient": ("waved", {"stiffness_gradient": {"change": 1.2}}),
    "nonlinear_stiffness": ("closed", {"nonlinear_stiffness": {"half_curvature": 6.0}}),
    "plasticity": ("waved", {"plasticity": {"yield_curvature": 4.0, "hardening": 0.4}}),
    "plasticity, both held": ("closed", {"plasticity": {"yield_curvature": 4.0, "hardening": 0.2}}),
    "hysteresis": ("waved", {"hysteresis": {"moment": 1e-3, "curvature": 2.0}}),
    "hysteresis, both held": ("closed", {"hysteresis": {"moment": 1e-3, "curvature": 2.0}}),
    "viscoelasticity": ("waved", {"viscoelasticity": {"share": 0.4, "time": 0.1}}),
    "viscoelasticity, both held": (
        "closed", {"viscoelasticity": {"share": 0.5, "time": 0.5}}),
    "surface_friction": ("waved", {"surface_friction": {"force": 0.08}}),
    "surface_friction, both held": ("closed", {"surface_friction": {"force": 0.08}}),
    "air_drag": ("waved", {"air_drag": {"coefficient": 0.2}}),
    "internal_damping": ("waved", {"internal_damping": {"relaxation_time": 0.02}}),
    "command_delay": ("waved", {"command_delay": {"delay": 0.07}}),
    "command_delay, early": ("closed", {"command_delay": {"delay": -0.07}}),
    "clamp_slip": ("waved", {"clamp_slip": {"length": 0.02}}),
    "clamp_slip, both held": ("closed", {"clamp_slip": {"length": -0.02}}),
    "clamp_slip at one moment": ("waved", {"clamp_slip": {"length": 0.02, "onset": 0.4}}),
    "clamp_slip little by little": (
        "waved",
        {"clamp_slip": {"length": 0.02, "onset": 0.2, "duration": 0.6}},
    ),
    "quadratic_drag": ("waved", {"quadratic_drag": {"coefficient": 0.3}}),
    "wall": ("closed", {"wall": {"offset": -0.115, "angle": 0.1}}),
    "length_error": ("waved", {"length_error": {"difference": 0.015}}),
    "length_error, control points held": ("pinned", {"length_error": {"difference": -0.01}}),
    "camera_scale": ("waved", {"camera_scale": {"ratio": 1.03}}),
    "camera_rotation": ("closed", {"camera_rotation": {"angle": 0.08}}),
    "camera_shift": ("closed", {"camera_shift": {"x": 0.004, "z": -0.003}}),
    "clamp_offset": ("closed", {"clamp_offset": {"end": (0.01, 0.015)}}),
    "clamp_offset of control points": ("pinned", {"clamp_offset": {"start": (-0.008, 0.01)}}),
    "grip_offset": ("waved", {"grip_offset": {"start": (0.01, 0.015)}}),
    "grip_offset, both held": (
        "closed", {"grip_offset": {"start": (0.0, 0.01), "end": (0.01, 0.015)}}),
    "obstacle": ("waved", {"obstacle": {"x": 0.15, "z": -0.06, "radius": 0.01}}),
    "constant_force": ("waved", {"constant_force": {"x": 0.05, "z": 0.03}}),
    "many": (
        "waved",
        {"length_error": {"difference": 0.015}, "surface_friction": {"force": 0.04},
         "intrinsic_curvature": {"curvature": 2.0, "kink": 0.2, "position": 0.2},
         "point_mass": {"mass": 0.003, "position": 0.3}, "gravity_tilt": {"angle": -0.1},
         "camera_rotation": {"angle": 0.03}, "camera_scale": {"ratio": 0.98},
         "command_delay": {"delay": 0.03}, "stiffness_gradient": {"change": -0.5}},
    ),
    "many, both held": (
        "closed",
        {"clamp_slip": {"length": 0.015}, "plasticity": {"yield_curvature": 6.0, "hardening": 0.5},
         "point_mass": {"mass": 0.01, "position": 0.1}, "clamp_angle": {"start": 0.1, "end": 0.2},
         "internal_damping": {"relaxation_time": 0.01}, "air_drag": {"coefficient": 0.1}},
    ),
}  # fmt: skip


ORDINARY = (
    "intrinsic_curvature, kink", "clamp_angle, both", "viscoelasticity", "wall", "many, both held",
    "a give beside a yield",
)  # fmt: skip


@cache
def without(manipulation: str) -> np.ndarray:
    """The motion without any effect, points (T, m, 3)."""
    return compare(MANIPULATIONS[manipulation], {})[1]


@pytest.mark.parametrize("case", some_of(CASES, ORDINARY))
def test_it_moves_as_the_discrete_rod_does(case):
    manipulation, effects = CASES[case]
    found, _ = compare(MANIPULATIONS[manipulation], effects, plain=without(manipulation))
    print(f"{case}: {found}")
    # A grip gives way by a cosine there and a cubic here: they differ by up to a hundredth.
    own_law = 0.01 * found.moved * ("little by little" in case)
    assert found.mean < 2e-4 + own_law
    assert found.worst < 4e-4 + own_law
    # It tells something: the effect moves the rope by many times that.
    assert not effects or found.moved > 20.0 * found.mean
