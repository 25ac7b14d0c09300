# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that act across the board's plane: against the discrete rod in space and closed forms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from ordinary import some_of
from rods import PAPER, held_start, settled
from twins import TWISTED, WAVED, compare

from dlo_ros.effects import RopeScale, Scene, effects
from dlo_ros.effects.measurement.camera_rotation import CameraRotation
from dlo_ros.effects.physics.clamp_angle import ClampAngle
from dlo_ros.errors import ParameterError
from dlo_ros.parameters import Settings
from dlo_ros.rod.planar_model import in_plane

SWUNG = {
    "initial_shape": WAVED["initial_shape"],
    "motion": {
        "start": [
            {"time": 0.05, "position": [0.0, 0.0, 0.0], "angle": 0.0},
            {"time": 0.35, "position": [0.03, 0.05, 0.04], "angle": -0.4, "swing": 0.5,
             "turn": 1.0},
        ]
    },
}  # fmt: skip
MANIPULATIONS = {"swung": SWUNG, "twisted": TWISTED}
CASES = {
    "clamp_angle, three axes": ("swung", {"clamp_angle": {"start": (0.1, 0.1, 0.25)}}),
    "clamp_angle, both": (
        "twisted", {"clamp_angle": {"start": (0.0, 0.1, 0.2), "end": (0.2, -0.1, 0.1)}}),
    "clamp_offset": ("twisted", {"clamp_offset": {"end": (0.01, 0.015, -0.01)}}),
    "grip_offset": ("swung", {"grip_offset": {"start": (0.01, -0.01, 0.015)}}),
    "grip_angle": ("twisted", {"grip_angle": {"start": (0.1, 0.2), "end": (-0.1, 0.1)}}),
    "gravity_tilt": ("swung", {"gravity_tilt": {"angle": 0.1, "across": 0.2}}),
    "intrinsic_curvature": (
        "swung", {"intrinsic_curvature": {"curvature": 2.0, "across": (-3.0, 2.0, 3.0)}}),
    "intrinsic_curvature, both held": (
        "twisted", {"intrinsic_curvature": {"across": (3.0, -2.0, 4.0)}}),
    "anisotropy": ("swung", {"anisotropy": {"ratio": 3.0, "angle": 0.6}}),
    "anisotropy, both held": ("twisted", {"anisotropy": {"ratio": 4.0, "angle": -0.5}}),
    "anisotropy, with a plug": (
        "swung",
        {"anisotropy": {"ratio": 3.0, "angle": 0.6}, "connector": {"mass": 0.0, "extent": 0.05}}),
    "twisting_stiffness": ("twisted", {"twisting_stiffness": {"ratio": 3.0}}),
    "constant_force": ("swung", {"constant_force": {"x": 0.03, "y": 0.06, "z": 0.02}}),
    "quadratic_drag": ("swung", {"quadratic_drag": {"coefficient": 1.0}}),
    "camera": (
        "twisted",
        {"camera_rotation": {"angle": (0.05, -0.03, 0.08)},
         "camera_shift": {"x": 0.002, "y": 0.006, "z": -0.003}}),
}  # fmt: skip
COARSE = {"duration": 0.4, "step": 2e-3, "control_points": 16}
EDGES = {"swung": 240, "twisted": 80}  # a soft free end needs more


@cache
def without(manipulation):
    """The motion without any effect, points (T, m, 3)."""
    return compare(MANIPULATIONS[manipulation], {}, edges=EDGES[manipulation], **COARSE)[1]


@pytest.mark.long
@pytest.mark.parametrize(
    "case", some_of(CASES, ["anisotropy, with a plug", "grip_angle", "twisting_stiffness"])
)
def test_it_moves_as_the_discrete_rod_does(case):
    manipulation, given = CASES[case]
    found, _ = compare(
        MANIPULATIONS[manipulation], given, plain=without(manipulation),
        edges=EDGES[manipulation], **COARSE,
    )  # fmt: skip
    print(f"{case}: {found}")
    assert found.mean < 3e-4 and found.worst < 6e-4
    assert found.moved > 20.0 * found.mean


def test_small_weight_bends_a_flat_cable_towards_its_soft_side():
    """A cantilever: W L^3 / (8 B) along each principal axis of the section."""
    stiff = replace(PAPER, rod=replace(PAPER.rod, young_modulus=2e11))
    flat = stiff.with_effects({"anisotropy": {"ratio": 4.0, "angle": 0.6}})
    _, _, found = settled(flat, held_start(), 20)
    rod = flat.rod
    small = rod.linear_density * 9.81 * rod.length**4 / (8.0 * rod.bending_stiffness)
    c, s = np.cos(0.6), np.sin(0.6)
    # The first director is +y, the second +z; the weight's moment is about +y.
    down, aside = small * (c * c + s * s / 4.0), small * c * s * (1.0 - 1.0 / 4.0)
    np.testing.assert_allclose(found.state.q[-1, [2, 1]], [-down, aside], rtol=1e-3)


def test_an_even_force_aside_turns_the_plane_in_which_a_rope_hangs():
    weight = PAPER.rod.linear_density * 9.81
    for given in (
        {"constant_force": {"y": 0.3 * weight}},
        {"gravity_tilt": {"across": float(np.arctan(0.3))}},
    ):
        _, _, found = settled(PAPER.with_effects(given), held_start(), 20)
        y, z = found.state.q[:, 1], found.state.q[:, 2]
        np.testing.assert_allclose(y, -0.3 * z, atol=1e-9)


def test_a_rod_that_is_curved_about_the_second_director_is_an_arc_beside_the_plane():
    light = replace(PAPER, gravity=(0.0, 0.0, 0.0))
    _, _, found = settled(
        light.with_effects({"intrinsic_curvature": {"across": 4.0}}), held_start(), 20
    )
    tip = np.array([np.sin(1.6), 1.0 - np.cos(1.6)]) / 4.0
    np.testing.assert_allclose(found.state.q[-1, [0, 1]], tip, atol=1e-5)
    np.testing.assert_allclose(found.state.q[:, 2], 0.0, atol=1e-9)


def test_what_does_nothing_across_the_plane_stays_in_it():
    """Only a value, or a wanted derivative, that leaves the plane takes the spatial rod."""
    model, _, found = settled(
        PAPER.with_effects({
            "anisotropy": {"ratio": 3.0, "angle": 0.0},
            "clamp_angle": {"start": (0.0, 0.1, 0.0)},
            "constant_force": {"x": 0.01, "y": 0.0},
        }), held_start(), 14,
    )  # fmt: skip
    command = ClampAngle(start=(0.0, 0.1, 0.0)).impose(held_start())
    flat = ("effects.clamp_angle.start[1]", "effects.constant_force.x")
    assert in_plane(model, found.state, command, flat)
    for name in (
        "effects.clamp_angle.start[2]", "effects.constant_force.y", "effects.anisotropy.angle"
    ):  # fmt: skip
        assert not in_plane(model, found.state, command, (name,))


def test_an_angle_and_a_rotation_vector_about_y_are_the_same():
    points = np.random.default_rng(0).normal(0.0, 1.0, (4, 3))
    one, three = CameraRotation(angle=0.3), CameraRotation(angle=(0.0, 0.3, 0.0))
    np.testing.assert_allclose(one.measured(points), three.measured(points), atol=1e-15)
    vector = CameraRotation(angle=(0.2, 0.3, -0.4))
    np.testing.assert_allclose(vector.true(vector.measured(points)), points, atol=1e-14)
    clamps = [ClampAngle(start=a).impose(held_start()) for a in (0.3, (0.0, 0.3, 0.0))]
    np.testing.assert_array_equal(clamps[0].rotations, clamps[1].rotations)


@pytest.mark.parametrize(("name", "value", "message"), [
    ("effects.clamp_angle.start", [0.1, 0.2], "must be 1 or 3 numbers"),
    ("effects.camera_rotation.angle", [0.1] * 4, r"must be 1 or 3 numbers"),
    ("effects.clamp_offset.end", [0.1], "must be 2 or 3 numbers"),
    ("effects.anisotropy.ratio", 0.0, "from 0.01 to 100"),
])  # fmt: skip
def test_a_wrong_number_of_numbers_is_told(name, value, message):
    rod = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e6, "rod.density": 2e3}
    with pytest.raises(ParameterError, match=message):
        Settings.from_mapping({**rod, name: value})


def test_a_flat_cable_that_softens_is_refused_where_its_axes_are_turned():
    softens = {"nonlinear_stiffness": {"half_curvature": 5.0}}
    both = PAPER.with_effects({"anisotropy": {"ratio": 3.0, "angle": 0.4}, **softens})
    with pytest.raises(ParameterError, match=r"effects\.anisotropy\.angle is 0\.4 rad"):
        settled(both, held_start(), 14)[0].body.check()


def test_in_the_plane_nothing_across_it_is_looked_for():
    rope = RopeScale(0.4, 0.3, 0.01, 0.01, 0.002)
    flat = Scene(rope, ("start", "end"), ("start", "end"), 5.0)
    space = replace(flat, spatial=True)

    def numbers(scene):
        found = {}
        for name, effect in effects().items():
            blocks = [effect.setup(scene), *(s.block for s in effect.starts(scene))]
            found[name] = {key: value for block in blocks for key, value in block.items()}
        return found

    plane, room = numbers(flat), numbers(space)
    assert not plane["anisotropy"] and set(room["anisotropy"]) == {"ratio", "angle"}
    for name, key in (
        ("constant_force", "y"), ("gravity_tilt", "across"), ("camera_shift", "y"),
        ("intrinsic_curvature", "across"),
    ):  # fmt: skip
        assert key not in plane[name] and key in room[name]
    for name, key in (("clamp_angle", "start"), ("camera_rotation", "angle")):
        assert plane[name][key] == 0.0 and room[name][key] == (0.0, 0.0, 0.0)
    assert len(plane["clamp_offset"]["end"]) == 2 and len(room["clamp_offset"]["end"]) == 3
