# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Numbers are known no better than what may or may not act beside them."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from rods import PAPER

from dlo_ros.diagnosis.explain.cause_naming import Cause, _changes
from dlo_ros.diagnosis.explain.explanation import Explanation
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors


def test_numbers_are_in_doubt_by_what_may_or_may_not_act():
    """A drag and a mass that may act or not, and a friction that does, which all lower E."""
    shifts = {
        "quadratic_drag": {"young_modulus": -0.1, "density": 0.1, "air_drag": 0.4},
        "point_mass": {"young_modulus": -0.3, "density": -0.2, "effects.wall.offset": 0.01},
        "surface_friction": {"young_modulus": -0.9, "density": 0.0},
    }
    friction = Cause("surface_friction", (), {}, 90.0, 1e-3, 0.0)
    at = SimpleNamespace()
    told = Explanation(at, at, (friction,), 0.0, 0.0, 0.0, (), (), shifts)
    assert told.doubts == (shifts["quadratic_drag"], shifts["point_mass"])
    assert replace(told, causes=()).doubts == tuple(shifts.values())


@pytest.mark.parametrize("own", [True, False])
def test_a_rival_puts_all_numbers_in_doubt_but_those_in_whose_place_it_is(own):
    model = ParametricModel(PAPER, material_priors(PAPER))
    at = SimpleNamespace(model=model)
    there = SimpleNamespace(model=model.at(model.theta() + 0.3 * model.axis("air_drag")))
    drag = model.parameters[model.index("air_drag")]
    group = SimpleNamespace(parameters=(drag,) if own else ())
    changes = _changes(at, there, group)
    assert changes["density"] == 0.0
    assert changes.get("air_drag") == (None if own else pytest.approx(0.3))
