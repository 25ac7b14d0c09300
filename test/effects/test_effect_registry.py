# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The registry of effects: the names of the interface, neutral and bad values, parameter files."""

import re

import numpy as np
import pytest
from lifted_rods import STAMPS, lifted, shapes, simulate
from rods import PAPER

from dlo_ros.effects import build, effects, quantities
from dlo_ros.errors import DloError, ParameterError
from dlo_ros.parameters import Settings

NAMES = {
    "intrinsic_curvature", "clamp_angle", "gravity_tilt", "point_mass", "stiff_segment",
    "stiffness_gradient", "nonlinear_stiffness", "plasticity", "surface_friction", "air_drag",
    "internal_damping", "command_delay", "clamp_slip", "length_error", "camera_scale",
    "camera_rotation", "obstacle", "constant_force", "clamp_offset", "camera_shift",
    "clamp_compliance", "connector", "quadratic_drag", "wall",
    "hysteresis", "viscoelasticity", "anisotropy", "grip_offset", "grip_angle",
    "twisting_stiffness",
}  # fmt: skip


def test_all_names_of_the_interface_are_there():
    assert set(effects()) == NAMES


@pytest.mark.parametrize(
    "kind",
    [k for k in effects().values() if k.__module__.startswith("dlo_ros.effects.physics.")],
    ids=lambda k: k.name,
)
def test_a_physical_law_has_its_source(kind):
    """A title with its year, or the words that it is geometry or a choice without a source."""
    text = " ".join(kind.__doc__.split())
    assert re.search(r", (18|19|20)\d\d\b", text) or "no source" in text


@pytest.mark.parametrize("name", sorted(NAMES))
def test_neutral_values_do_nothing(name):
    (effect,) = build({name: {}})
    assert type(effect).__doc__
    for q in quantities(name).values():
        assert q.lower <= q.neutral <= q.upper
        assert q.description
    plain, _ = simulate(PAPER, lifted(), STAMPS[:6])
    same, _ = simulate(
        PAPER.with_effects({name: {k: q.nothing for k, q in quantities(name).items()}}),
        lifted(), STAMPS[:6],
    )  # fmt: skip
    # Contact is simulated by the engine of single rods, whose Newton iterations end elsewhere.
    apart = 1e-6 if name in {"obstacle", "surface_friction", "wall"} else 1e-9
    if name == "clamp_compliance":  # the spline is finer where a grip may give
        apart = 2e-4 * PAPER.rod.length
    np.testing.assert_allclose(shapes(same), shapes(plain), atol=apart)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"effects.gravity": 1.0}, "no effect 'gravity'; known are air_drag"),
        ({"effects.point_mass.weight": 1.0}, "has no parameter 'weight'; it has mass, position"),
        ({"effects.point_mass.mass": -1.0}, "effects.point_mass.mass is -1.0; it must be a number"),
        ({"effects.point_mass.mass": float("nan")}, "effects.point_mass.mass is nan"),
        ({"effects.point_mass.mass": [1.0, 2.0]}, "it must be one number"),
        ({"effects.point_mass.mass": "heavy"}, "effects.point_mass.mass is heavy"),
        ({"effects.clamp_offset.start": 0.01}, "it must be 2 or 3 numbers"),
        ({"effects.clamp_offset.start": [0.1] * 4}, "it must be 2 or 3 numbers"),
        ({"effects.grip_offset.end": 0.01}, "it must be 2 or 3 numbers"),
        ({"effects.grip_angle.end": [0.1] * 3}, "it must be 2 numbers"),
        ({"effects.grip_offset.hand": [0.0, 0.0]}, "has no parameter 'hand'; it has start, end"),
        ({"effects.clamp_offset.start": [0.1, 2.0]}, "it must be a number from -1 to 1"),
        (
            {"effects.clamp_angle.start_std": -0.1},
            "effects.clamp_angle.start_std is -0.1; it must be a number from 0 on",
        ),
        ({"effects.clamp_angle.start_std": [0.1]}, "it must be a number from 0 on"),
        ({"effects.clamp_angle.start_std": "wide"}, "it must be a number from 0 on"),
        ({"effects.clamp_angle.begin_std": 0.1}, "has no parameter 'begin_std'"),
        ({"effects.clamps.start_std": 0.1}, "there is no effect 'clamps'"),
    ],
)
def test_bad_values_name_the_parameter(values, message):
    with pytest.raises(ParameterError, match=message):
        Settings.from_mapping({**PAPER.flat(), **values})


def test_a_place_off_the_rod_is_refused():
    settings = PAPER.with_effects({"point_mass": {"mass": 0.1, "position": 0.5}})
    with pytest.raises(DloError, match=r"point_mass.position is 0.5 m.*0 to 0.4 m"):
        simulate(settings, lifted(), STAMPS[:1])


def test_effects_survive_a_parameter_file(tmp_path):
    given = {"intrinsic_curvature": {"curvature": (1.0, 2.0)}, "point_mass": {"mass": 0.1}}
    settings = PAPER.with_effects(given)
    settings.dump(tmp_path / "p.yaml")
    assert Settings.load(tmp_path / "p.yaml").effects == given
