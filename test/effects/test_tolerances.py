# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What the effects know of their own numbers: tolerances, plausible sizes, ranges, roles."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import pytest
from rods import PAPER

from dlo_ros.effects import Effect, Scene, effects, quantities, quantity
from dlo_ros.errors import ParameterError
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import Settings, tolerance

ROD = PAPER.rod
MASS = ROD.linear_density * ROD.length
WEIGHT = ROD.linear_density * 9.81
TOLERANCES = {
    "clamp_angle.start": math.radians(3.0),
    "clamp_angle.end": math.radians(3.0),
    "clamp_offset.start": 0.005 * ROD.length,
    "clamp_offset.end": 0.005 * ROD.length,
    "grip_offset.start": 0.005 * ROD.length,
    "grip_offset.end": 0.005 * ROD.length,
    "grip_angle.start": math.radians(3.0),
    "grip_angle.end": math.radians(3.0),
    "gravity_tilt.angle": math.radians(1.0),
    "length_error.difference": 0.005 * ROD.length,
    "camera_scale.ratio": 0.005,
    "camera_rotation.angle": math.radians(0.5),
    "camera_shift.x": 0.005 * ROD.length,
    "camera_shift.z": 0.005 * ROD.length,
    "intrinsic_curvature.curvature": 0.5 / ROD.length,
    "stiffness_gradient.change": 0.3,
    "command_delay.delay": 0.02,
    "clamp_slip.length": 0.005 * ROD.length,
    "point_mass.mass": 0.1 * MASS,
    "connector.mass": 0.1 * MASS,
    "stiff_segment.ratio": 0.3,
    "surface_friction.force": 0.02 * WEIGHT,
    "constant_force.x": 0.02 * WEIGHT,
    "constant_force.z": 0.02 * WEIGHT,
    # In space.
    "constant_force.y": 0.02 * WEIGHT,
    "gravity_tilt.across": math.radians(1.0),
    "camera_shift.y": 0.005 * ROD.length,
    "intrinsic_curvature.across": 0.5 / ROD.length,
    "anisotropy.ratio": 0.1,
    "twisting_stiffness.ratio": 0.7,
}
"""As the pages state them, in SI units for this rope; every other number has none."""


def numbers():
    """Every parameter of every effect, "name.key" and what is known of it."""
    return {f"{n}.{q.name}": q for n, effect in effects().items() for q in effect.quantities()}


def test_tolerances_are_those_of_careful_people():
    found = {name: tolerance(PAPER, name) for name in numbers()}
    assert {n: v for n, v in found.items() if v is not None} == pytest.approx(TOLERANCES)


def test_a_parameter_file_states_them_without_making_the_effect_present(tmp_path):
    stated = {"effects.clamp_angle.start_std": 0.02, "effects.point_mass.mass_std": 1}
    settings = Settings.from_mapping({**PAPER.flat(), **stated, "effects.clamp_angle.end": 0.1})
    assert settings.effects == {"clamp_angle": {"end": 0.1}}
    assert settings.tolerances == {"clamp_angle.start": 0.02, "point_mass.mass": 1.0}
    assert tolerance(settings, "clamp_angle.start") == 0.02
    assert tolerance(settings, "clamp_angle.end") == pytest.approx(math.radians(3.0))
    settings.dump(tmp_path / "p.yaml")
    assert Settings.load(tmp_path / "p.yaml") == settings
    text = (tmp_path / "p.yaml").read_text()
    assert "start_std: 0.02  # rad" in text and "mass_std: 1.0  # kg" in text
    assert settings.with_effects({}).tolerances == settings.tolerances


def test_the_length_is_known_as_well_as_the_rod_says():
    settings = Settings.from_mapping({**PAPER.flat(), "rod.length_std": 0.001})
    assert tolerance(settings, "length_error.difference") == 0.001
    closer = {**settings.flat(), "effects.length_error.difference_std": 0.0005}
    assert tolerance(Settings.from_mapping(closer), "length_error.difference") == 0.0005


def test_what_a_file_states_is_a_parameter_of_the_table():
    assert {q.stated_by for q in numbers().values()} - {""} <= set(TABLE)
    assert Settings.from_mapping(PAPER.flat()).diagnosis.material_err == 5e-4


def test_a_place_may_be_known_though_it_has_no_tolerance_of_its_own():
    settings = Settings.from_mapping({**PAPER.flat(), "effects.point_mass.position_std": 0.004})
    assert tolerance(settings, "point_mass.position") == 0.004
    assert tolerance(PAPER, "point_mass.position") is None


@pytest.mark.parametrize("name", ["clamp_angle.begin", "clamps.start", "clamp_angle"])
def test_unknown_numbers_have_no_tolerance(name):
    with pytest.raises(ParameterError, match=r"known are|it has start, end"):
        tolerance(PAPER, name)


def test_ranges_are_those_of_the_rope():
    scale, length = PAPER.scale, ROD.length
    found = {name: q.search_for(scale) for name, q in numbers().items()}
    assert found["point_mass.position"] == (0.0, length)
    assert found["stiff_segment.centre"] == (0.0, length)
    assert found["stiff_segment.extent"] == pytest.approx((0.02 * length, 0.6 * length))
    assert found["obstacle.radius"] == pytest.approx((0.002 * length, 0.3 * length))
    assert found["length_error.difference"] == pytest.approx((-0.5 * length, 0.5 * length))
    assert found["air_drag.coefficient"] == pytest.approx((-0.99 * PAPER.damping.air_drag, 1000.0))
    assert found["obstacle.x"] == (-100.0, 100.0)  # on the board, not on the rope
    for name, q in numbers().items():
        low, high = found[name]
        assert q.lower <= low < high <= q.upper, name


def test_plausible_sizes_are_those_of_the_rope():
    scale = PAPER.scale
    found = {name: q.natural_for(scale) for name, q in numbers().items()}
    assert found["point_mass.mass"] == pytest.approx(MASS)
    assert found["constant_force.x"] == pytest.approx(WEIGHT)
    assert found["intrinsic_curvature.curvature"] == pytest.approx(3.0 / ROD.length)
    assert found["internal_damping.relaxation_time"] == pytest.approx(
        20.0 * PAPER.damping.relaxation_time
    )
    assert found["camera_scale.ratio"] == 1.0  # of the logarithm
    assert all(value > 0.0 for value in found.values())


def test_what_a_fit_sees_of_a_ratio_is_its_logarithm():
    q = quantities("camera_scale")["ratio"]
    assert q.logarithmic and q.transformed(math.e) == pytest.approx(1.0)
    assert q.restored(q.transformed(0.7)) == pytest.approx(0.7)


def test_only_impacts_leave_no_derivatives():
    assert {n for n, e in effects().items() if not e.differentiable} == {"obstacle", "wall"}
    rough = {name for name, effect in effects().items() if not effect.smooth}
    assert rough == {
        "obstacle", "nonlinear_stiffness", "plasticity", "surface_friction", "wall", "hysteresis",
    }  # fmt: skip


def test_what_an_effect_acts_on_is_found_from_what_it_overrides():
    found = {name: set(effect.acts_on) for name, effect in effects().items()}
    assert found["clamp_angle"] == found["clamp_offset"] == found["grip_offset"] == {"command"}
    assert found["camera_shift"] == found["command_delay"] == {"measurement"}
    assert found["length_error"] == found["obstacle"] == {"rod"}
    for name, effect in effects().items():
        assert not (effect.batched and "measurement" in found[name])


@dataclass(frozen=True)
class Careless(Effect):
    """One that claims to be simple, and is not."""

    name: ClassVar[str] = "careless"
    batched: ClassVar[bool] = True

    shift: float = quantity(0.0, "m", -1.0, 1.0, "of what is seen")

    def measured(self, points):
        return points + self.shift


@dataclass(frozen=True)
class Bump(Effect):
    """A local one without a derivative."""

    name: ClassVar[str] = "bump"
    smooth: ClassVar[bool] = False

    height: float = quantity(0.0, "m", 0.0, 1.0, "how high", natural=0.05)
    threshold: float = quantity(1e6, "1/m", 0.01, 1e6, "beyond which", natural=2.0)
    position: float = quantity(0.0, "m", 0.0, 100.0, "where, u", role="place")
    width: float = quantity(0.0, "m", 0.0, 100.0, "how long", role="extent")


def view(**changes):
    plain = Scene(rope=PAPER.scale, clamps=("start",), held=("start",), curvature=5.0)
    return replace(plain, **changes)


def test_an_effect_of_the_measurement_is_never_batched():
    assert not Careless.batched


def test_by_default_a_local_effect_is_looked_for_along_the_rope():
    found = Bump.starts(view())
    assert not any(s.neutral or s.screened for s in found)
    assert sorted({s.block["position"] for s in found})[0] == pytest.approx(0.15 * ROD.length)
    assert all(0.0 < s.block["position"] < ROD.length for s in found)
    assert {s.block["height"] for s in found} <= {0.0, 0.05 * ROD.length}
    assert {s.block["threshold"] for s in found} == {2.0 / ROD.length}
    assert {s.block["width"] for s in found} == {0.2 * ROD.length}


def test_a_damping_is_looked_for_where_it_is_no_guess():
    drag = effects()["air_drag"]
    assert drag.starts(view()) == []
    (start,) = drag.starts(view(known=("air_drag",)))
    assert start.neutral and start.block == {"coefficient": 0.0}


def test_clamps_are_looked_for_where_there_are_some():
    clamps = effects()["clamp_angle"]
    assert [s.form for s in clamps.starts(view())] == ["start"]
    assert clamps.starts(view(clamps=())) == []
    both = clamps.starts(view(clamps=("start", "end")))
    assert [s.form for s in both] == ["start", "end", "both"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"tolerance": 0.0},
        {"natural": -1.0},
        {"search": (1.0, 0.0)},
        {"tolerance": math.inf},
        {"beyond": 1.0},
        {"beyond": math.nan},
    ],
)
def test_knowledge_that_makes_no_sense_is_refused_where_it_is_written(wrong):
    with pytest.raises(ValueError, match=r"must be positive|range is empty|probability"):
        quantity(0.0, "m", -1.0, 1.0, "something", **wrong)
