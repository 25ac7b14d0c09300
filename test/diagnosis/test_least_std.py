# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How well numbers of laws that are simpler than real DLOs can be known."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dlo_ros.diagnosis.findings.least_std import LAW_ERROR, PLACE_ERROR, law_error, least_std
from dlo_ros.rod_settings import RodParameters

LENGTH = 0.5


@pytest.mark.parametrize(
    ("effect", "key", "value", "error"),
    [
        ("quadratic_drag", "coefficient", 0.2, LAW_ERROR * 0.2),
        ("plasticity", "yield_curvature", 8.0, LAW_ERROR * 8.0),  # a scale, not a distance
        ("stiff_segment", "ratio", 3.0, LAW_ERROR * 2.0),  # 1 is none of it
        ("stiff_segment", "ratio", 0.5, LAW_ERROR * 0.5),
        ("stiffness_gradient", "change", -0.6, LAW_ERROR * 0.6),
        ("stiff_segment", "centre", 0.3, PLACE_ERROR * LENGTH),
        ("obstacle", "radius", 0.02, PLACE_ERROR * LENGTH),
        ("wall", "offset", -0.3, PLACE_ERROR * LENGTH),
        ("clamp_slip", "onset", 1.5, 0.0),  # a moment is no place along the DLO
        ("wall", "angle", 0.3, 0.0),
        ("clamp_angle", "start", 0.1, 0.0),  # where a clamp points is no law
        ("length_error", "difference", 0.01, 0.0),
        ("camera_scale", "ratio", 1.02, 0.0),
        ("gravity_tilt", "angle", 0.05, 0.0),
    ],
)
def test_a_law_tells_its_sizes_and_places_to_what_real_dlos_follow_it(effect, key, value, error):
    assert law_error(effect, key, value, LENGTH) == pytest.approx(error, abs=1e-12)


def test_masses_and_forces_are_known_no_better_than_the_weight_of_the_dlo():
    rod = RodParameters(length=LENGTH, diameter=0.004, young_modulus=1e7, density=1200.0)
    law = LAW_ERROR * 0.01
    mass = least_std("point_mass", "mass", 0.01, rod)
    assert mass == pytest.approx((law**2 + (2.0 * 0.02 * 0.01) ** 2) ** 0.5)
    measured = replace(rod, diameter_std=1e-3 * rod.diameter)
    assert least_std("point_mass", "mass", 0.01, measured) == pytest.approx(law, rel=1e-2)
    give = least_std("clamp_compliance", "end", 2.0, rod)
    assert give == pytest.approx(2.0 * (LAW_ERROR**2 + 0.04**2) ** 0.5)
    assert least_std("clamp_angle", "start", 0.1, rod) == 0.0
