# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives by parameters at the ends of their ranges are one-sided ones."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.difference_quotients import variants
from dlo_ros.rod.sensitivity_parameters import STEP, variation_of
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

SOFT = replace(PAPER, rod=replace(PAPER.rod, young_modulus=5e6))
LENGTH = SOFT.rod.length
OBSERVED = replace(SOFT.simulation, start="observed")
STOPS = [SECOND // 10, SECOND // 4]
CLAMPED = command(["start"], [0.0, 0.2], [[[0.0, 0.0, 0.0]], [[0.02, 0.0, 0.04]]])
BETWEEN = command(
    ["start", "end"], [0.0, 0.2],
    [[[0.0, 0.0, 0.0], [0.26, 0.0, 0.0]], [[0.02, 0.0, 0.04], [0.26, 0.0, 0.0]]],
)  # fmt: skip
SOFTENS = {"nonlinear_stiffness": {"half_curvature": 5.0}}
# With the change of the parameter inwards by which runs differ.
ENDS = [
    ("point_mass.position", CLAMPED, {"mass": 0.01, "position": LENGTH}, -1e-4),
    ("connector.extent", CLAMPED, {"mass": 0.01, "extent": 0.0}, 1e-4),
    ("plasticity.hardening", BETWEEN, {"yield_curvature": 3.0, "hardening": 0.0}, 1e-3),
    ("plasticity.hardening", BETWEEN, {"yield_curvature": 3.0, "hardening": 1.0}, -1e-3),
    ("clamp_slip.onset", BETWEEN, {"length": 0.01, "onset": 0.0, "duration": 0.3}, 1e-3),
]


def run(settings, imposed, parameters=(), spans=12):
    """Shapes at rest and at the stops, (3, n, 3), and their derivatives by one parameter."""
    basis = SplineBasis(settings.rod.control_points, LENGTH)
    share = basis.greville / LENGTH
    shape = np.zeros((basis.control_points, 4))
    free = imposed is CLAMPED
    shape[:, 0] = (0.38 if free else 0.26) * share
    shape[:, 2] = -0.1 * (share**2 if free else np.sin(np.pi * share))
    simulation = Simulation(settings, Motion([imposed]), parameters=parameters, spans=spans)
    simulation.start([Observation(0, shape)])
    track = [simulation.prediction(), *simulation.advance_through(STOPS)]
    derivatives = np.array([p.sensitivity[0] for p in track]) if parameters else None
    return np.array([p.control_points[:, :3] for p in track]), derivatives


@pytest.mark.parametrize("beside", [{}, SOFTENS], ids=["alone", "softens"])
@pytest.mark.parametrize(("place", "imposed", "block", "inwards"), ENDS, ids=[e[0] for e in ENDS])
def test_derivatives_at_an_end_of_a_range_are_those_inwards(place, imposed, block, inwards, beside):
    effect, key = place.split(".")
    here, exact = run(SOFT.with_effects({effect: block} | beside), imposed, (f"effects.{place}",))
    moved = block | {key: block[key] + inwards}
    there, _ = run(SOFT.with_effects({effect: moved} | beside), imposed)
    expected = (there - here) / inwards
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(exact, expected, atol=0.04 * np.abs(expected).max(), rtol=0.0)


@pytest.mark.parametrize(
    ("name", "block", "above", "below"),
    [
        ("effects.point_mass.position", {"mass": 0.01, "position": LENGTH}, 0.0, -LENGTH),
        ("effects.point_mass.position", {"mass": 0.01, "position": 0.2}, 0.2, -0.2),
        ("effects.point_mass.position", {"mass": 0.01, "position": 0.0}, LENGTH, 0.0),
        ("effects.point_mass.mass", {"mass": 0.0, "position": 0.2}, 1.0, 0.0),
        ("effects.camera_scale.ratio", {"ratio": 2.0}, 0.0, -2.0),
        ("effects.clamp_slip.onset", {"length": 0.01, "onset": 0.0}, 1.0, 0.0),
        ("effects.clamp_slip.onset", {"length": 0.01, "onset": 2.0}, 2.0, -2.0),
        ("young_modulus", {}, 1.0, -1.0),
        ("start.z", {}, LENGTH, -LENGTH),
    ],
)
def test_no_variant_leaves_the_range(name, block, above, below):
    settings = SOFT.with_effects({name.split(".")[1]: block} if block else {})
    np.testing.assert_allclose(
        variation_of(settings, name).amounts(), (STEP * above, STEP * below), rtol=1e-9
    )


def test_a_model_without_derivatives_is_varied_within_the_range_too():
    settings = SOFT.with_effects({"point_mass": {"mass": 0.01, "position": LENGTH}})
    above, below = variants(settings, ("effects.point_mass.position",))
    assert above.effects["point_mass"]["position"] == LENGTH
    assert 0.99 * LENGTH < below.effects["point_mass"]["position"] < LENGTH


@pytest.mark.parametrize(
    ("name", "laws"),
    [
        (
            "plasticity.hardening",
            {
                "plasticity": {"yield_curvature": 3.0, "hardening": 1.0},
                "nonlinear_stiffness": {"half_curvature": 5.0},
            },
        ),
        # A grip is linear as soon as it gives, and one of a variant gives alone.
        (
            "clamp_compliance.start",
            {
                "hysteresis": {"moment": 2e-3, "curvature": 2.0},
                "clamp_compliance": {"start": 0.0},
            },
        ),
        (
            "clamp_compliance.start",
            {
                "plasticity": {"yield_curvature": 3.0, "hardening": 0.3},
                "clamp_compliance": {"start": 0.0},
            },
        ),
    ],
)
def test_derivatives_beside_a_law_that_begins_or_ends_there_are_finite(name, laws):
    settings, name = SOFT.with_effects(laws), f"effects.{name}"
    for here in (settings, replace(settings, simulation=OBSERVED)):
        _, found = run(here, CLAMPED, (name,), spans=14)
        assert np.isfinite(found).all() and found.any()
