# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Experiments in space: files, hidden effects, recordings; the spline rod moves as they do."""

import copy
from functools import cache

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from twins import CLOSED, TWISTED, WAVED, compare, tree

from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.recordings.read import read_recording
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import find_experiment, load_experiment, read_experiment
from dlo_ros.synthesis.hidden import Hidden
from dlo_ros.synthesis.hidden_rod import build_spatial_rod
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.truth import build_simulation, simulate

DURATION, EDGES, STEP = 0.24, 40, 3e-3
WAVE, CLOSE = ("waved", WAVED), ("closed", CLOSED)

# In the plane the rod in space must move as the planar one does, with whatever is hidden in it.
IN_PLANE = {
    "nothing": (WAVE, {}),
    "intrinsic_curvature": (WAVE, {"intrinsic_curvature": {"curvature": [-4.0, 3.0, 2.0]}}),
    "kink": (WAVE, {"intrinsic_curvature": {"kink": 0.25, "position": 0.15}}),
    "clamp_angle": (CLOSE, {"clamp_angle": {"start": 0.2, "end": -0.1}}),
    "clamp_offset": (CLOSE, {"clamp_offset": {"end": [0.01, 0.015]}}),
    "clamp_compliance": (WAVE, {"clamp_compliance": {"start": 6.0}}),
    "connector": (WAVE, {"connector": {"mass": 0.004, "extent": 0.05}}),
    "gravity_tilt": (WAVE, {"gravity_tilt": {"angle": 0.15}}),
    "point_mass": (WAVE, {"point_mass": {"mass": 0.004, "position": 0.25}}),
    "stiff_segment": (WAVE, {"stiff_segment": {"centre": 0.12, "extent": 0.1, "ratio": 4.0}}),
    "stiffness_gradient": (WAVE, {"stiffness_gradient": {"change": 1.2}}),
    "nonlinear_stiffness": (CLOSE, {"nonlinear_stiffness": {"half_curvature": 6.0}}),
    "viscoelasticity": (CLOSE, {"viscoelasticity": {"share": 0.4, "time": 0.1}}),
    "quadratic_drag": (WAVE, {"quadratic_drag": {"coefficient": 3.0}}),
    "drag, damping": (
        WAVE,
        {"air_drag": {"coefficient": 0.2}, "internal_damping": {"relaxation_time": 0.02}},
    ),
    "command_delay": (WAVE, {"command_delay": {"delay": 0.07}}),
    "clamp_slip": (WAVE, {"clamp_slip": {"length": 0.02}}),
    "length_error": (WAVE, {"length_error": {"difference": 0.015}}),
    "constant_force": (WAVE, {"constant_force": {"x": 0.05, "z": 0.03}}),
    "obstacle": (WAVE, {"obstacle": {"x": 0.15, "z": -0.03, "radius": 0.01}}),
    "wall": (CLOSE, {"wall": {"offset": -0.1, "angle": 0.1}}),
}
NEAR = 3e-3
"""Largest distance over L of the planar rod and that in space with `EDGES` edges: a vertex bends by
2 tan(phi / 2) in one and by phi in the other."""


def motion(manipulation, effects, *, space, seconds=DURATION):
    made = read_experiment(tree(manipulation, effects, seconds), "test", "test.yaml")
    simulation, _ = build_simulation(made, edges=EDGES, step=STEP, space=space)
    truth = simulate(simulation, made.stamps, made.truth.rod.length)
    return truth.nodes if space else np.insert(truth.nodes, 1, 0.0, axis=2)


@cache
def without(name):
    return motion(dict([WAVE, CLOSE])[name], {}, space=False)


@pytest.mark.long
@pytest.mark.parametrize("case", IN_PLANE)
def test_in_the_plane_it_moves_as_the_planar_rod_does(case):
    (name, manipulation), effects = IN_PLANE[case]
    flat = motion(manipulation, effects, space=False)
    found = motion(manipulation, effects, space=True)
    assert np.abs(found[..., 1]).max() < 1e-9
    apart = np.linalg.norm(found - flat, axis=2).max()
    assert apart < NEAR * 0.4
    if effects and flat.shape == without(name).shape:  # a place asks for a node of its own
        assert np.linalg.norm(flat - without(name), axis=2).max() > 3.0 * apart


@pytest.mark.parametrize("effects", [
    {"constant_force": {"x": 0.0, "y": 0.2, "z": -0.1}},
    {"gravity_tilt": {"across": 0.3}},
    {"clamp_angle": {"start": [0.0, 0.0, 0.4]}},
    {"clamp_offset": {"start": [0.0, 0.05, 0.0]}},
    {"intrinsic_curvature": {"across": 2.0}},
    {"anisotropy": {"ratio": 4.0, "angle": 0.6}},
], ids=lambda e: next(iter(e)))  # fmt: skip
def test_effects_that_leave_the_plane(effects):
    made = read_experiment(tree(WAVED, effects, DURATION), "test", "test.yaml")
    assert made.spatial
    simulation, _ = build_simulation(made, edges=30)
    length, y = 0.4, simulation.x[:, 1]
    along = simulation.x[:, 0]
    if "clamp_offset" in effects:
        np.testing.assert_allclose(y, 0.05, atol=1e-9)
    elif "clamp_angle" in effects:
        np.testing.assert_allclose(y, np.tan(0.4) * along, atol=1e-6)  # it hangs in one plane
    elif "gravity_tilt" in effects:  # from y towards z: what hangs along -z comes to +y
        plane = -np.tan(0.3) * simulation.x[:, 2]
        np.testing.assert_allclose(y, plane, atol=1e-6)
    elif "constant_force" in effects:
        weight = made.truth.rod.linear_density * 9.81
        np.testing.assert_allclose(y, -0.2 / (weight + 0.1) * simulation.x[:, 2], atol=1e-6)
    else:
        assert np.abs(y).max() > 0.01 * length
        flat = read_experiment(tree(WAVED, {}, DURATION), "test", "test.yaml")
        assert not flat.spatial


def test_flat_cable_bends_towards_its_soft_side():
    """A cantilever with a small weight: delta = W L^3 / (8 B) along each principal direction."""
    effects = {"anisotropy": {"ratio": 4.0, "angle": 0.6}}
    made = read_experiment(tree(WAVED, effects, DURATION, young_modulus=2e11), "test", "test.yaml")
    simulation, _ = build_simulation(made, edges=60)
    rope = made.truth.rod
    # The first director is y, the second x cross y = z; bending about an axis moves across it.
    soft = np.array([np.cos(0.6), np.sin(0.6)])
    stiff = np.array([-soft[1], soft[0]])
    moment = np.array([1.0, 0.0])  # of the weight about y
    bend = (moment @ soft) * soft + (moment @ stiff) * stiff / 4.0
    small = rope.linear_density * 9.81 * rope.length**4 / (8.0 * rope.bending_stiffness)
    np.testing.assert_allclose(simulation.x[-1, [2, 1]], small * bend * [-1.0, 1.0], rtol=2e-3)


def test_effects_that_only_the_plane_knows_are_refused():
    made = read_experiment(
        tree(TWISTED, {"plasticity": {"yield_curvature": 4.0, "hardening": 0.4}}, 0.1), "t", "t"
    )
    with pytest.raises(InputError, match=r"effects\.plasticity can be simulated in the plane"):
        build_spatial_rod(made.truth, made.hidden, edges=20)


def test_camera_in_space():
    hidden = Hidden({
        "camera_rotation": {"angle": (0.1, -0.2, 0.3)},
        "camera_shift": {"x": 0.01, "y": 0.02, "z": -0.03},
    })  # fmt: skip
    points = np.random.default_rng(0).normal(0.0, 0.2, (5, 3))
    seen = hidden.measured(points)
    stated = load_experiment(find_experiment("simple")).truth.camera
    true = hidden.camera(stated)

    def pixels(pose, at):
        optical = Rotation.from_quat(pose.rotation).apply(at) + np.array(pose.translation)
        return optical[:, :2] / optical[:, 2:]

    np.testing.assert_allclose(pixels(stated, seen), pixels(true, points), atol=1e-12)


def test_the_twisted_experiment_is_recorded_with_its_twist(tmp_path):
    made = load_experiment(find_experiment("twisted"))
    assert made.spatial
    short = copy.copy(made)
    object.__setattr__(short, "duration", 0.3)
    with pytest.raises(InputError, match="use --no-images"):
        synthesize(short, tmp_path / "pictures")
    truth = synthesize(short, tmp_path / "bag", images=False, edges=40, step=4e-3)
    written = yaml.safe_load((tmp_path / "bag" / "truth.yaml").read_text())
    shapes = np.array(written["control_points"])
    assert shapes.shape == (len(truth.stamps), 10, 4)
    recording = read_recording(tmp_path / "bag", made.truth)
    u = np.linspace(0.0, 0.4, 50)
    basis = SplineBasis(10, 0.4)
    for k in (0, 9):
        seen = basis.evaluate(recording.observations[k].control_points, u)
        np.testing.assert_allclose(seen[:, :3], truth.centreline(k, u), atol=4e-3)
        np.testing.assert_allclose(seen[:, 3], truth.twist_angle(k, u), atol=0.2)
    assert np.abs(truth.twist[-1]).max() > 0.5


def test_the_tool_writes_it(tmp_path, capsys):
    small = yaml.safe_load(find_experiment("twisted").read_text()) | {"duration": 0.1}
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(small))
    output = str(tmp_path / "bag")
    assert main(["synthesize", str(tmp_path / "small.yaml"), "--output", output]) == 2
    assert "--no-images" in capsys.readouterr().err
    arguments = ["synthesize", str(tmp_path / "small.yaml"), "--no-images", "--output", output]
    assert main(arguments) == 0
    assert "4 observed splines" in capsys.readouterr().out


@pytest.mark.long
def test_the_spline_rod_moves_as_it_does():
    found, _ = compare(TWISTED, {}, duration=0.7, edges=100, step=2e-3)
    assert found.mean < 8e-5 and found.worst < 1.2e-4


def test_a_rope_that_a_wall_lifts_falls_aside():
    """In the plane it would stand on its edge: it leaves that shape, on which nothing acts."""
    made = read_experiment(
        tree(CLOSED, {"wall": {"offset": -0.08, "angle": 0.0}}, 0.1), "test", "test.yaml"
    )
    simulation, _ = build_simulation(made, edges=40, space=True)
    assert np.abs(simulation.x[:, 1]).max() > 0.02
    assert simulation.x[:, 2].min() > -0.0785
