# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Hidden effects in whole experiments: motion, camera, files and foreign effects."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import yaml
from elastica import Cantilever
from hidden_experiments import LENGTH, TREE, experiment, run
from ordinary import some_of
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.parameters import DampingParameters, RodParameters, Settings
from dlo_ros.recordings.read import read_recording
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.experiment import START_STAMP
from dlo_ros.synthesis.hidden_effects import EFFECTS, FOREIGN, HiddenEffects, read_effects
from dlo_ros.synthesis.hidden_rod import build_rod, change
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes
from dlo_ros.synthesis.synthesize import measure, synthesize
from dlo_ros.synthesis.true_motion import Grips, build_simulation

pytestmark = pytest.mark.long


def turned(points, angle):
    """Points x, z turned about the origin from x towards -z by an angle [rad], shape (..., 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, -s], [s, c]])


@pytest.fixture(scope="module")
def plain():
    return run()


def test_delay_shifts_time(plain):
    late = run({"command_delay": {"delay": 0.1}})
    np.testing.assert_allclose(late.nodes[3:], plain.nodes[:-3], atol=1e-8)
    np.testing.assert_allclose(late.nodes[:3], plain.nodes[:3][[0, 0, 0]], atol=1e-8)
    assert np.abs(late.nodes - plain.nodes).max() > 5e-3


@pytest.mark.slow
def test_a_rope_that_slips_ends_as_a_longer_rope():
    damping = {"air_drag": 0.3, "relaxation_time": 0.01}
    parameters = TREE["parameters"] | {"damping": damping}
    slow = {"duration": 8.0, "parameters": parameters}
    slipped = run({"clamp_slip": {"length": 0.03}}, **slow)
    longer = run({"length_error": {"difference": 0.03}}, **slow)
    plain = run(**slow)
    assert np.abs(plain.nodes[-1] - longer.nodes[-1]).max() > 0.02
    np.testing.assert_allclose(slipped.nodes[0], plain.nodes[0], atol=1e-9)
    np.testing.assert_allclose(slipped.nodes[-1], longer.nodes[-1], atol=2e-5)
    # Half of the way, half of the length; without a way, nothing.
    made = experiment({"clamp_slip": {"length": 0.03}})
    simulation, grips = build_simulation(made, edges=80)
    assert grips.travelled(0.3) == pytest.approx(0.5)
    assert simulation.rod_at(0.3).lengths.sum() == pytest.approx(LENGTH + 0.015)
    assert simulation.rod_at(0.3).mass.sum() == pytest.approx(
        made.truth.rod.linear_density * (LENGTH + 0.015)
    )
    still = {"start": TREE["motion"]["start"][:1]}
    assert Grips(experiment({"clamp_slip": {"length": 0.03}}, motion=still)).travelled(9.0) == 0.0


def test_slip_leaves_a_hung_mass_as_it_is():
    made = experiment(
        {"clamp_slip": {"length": 0.04}, "point_mass": {"mass": 0.5, "position": 0.3}}
    )
    simulation, _ = build_simulation(made, edges=80)
    rope = made.truth.rod.linear_density * (LENGTH + 0.04)
    assert simulation.rod_at(0.6).mass.sum() == pytest.approx(rope + 0.5)


def test_length_error_is_a_longer_rope_seen_in_the_configured_length():
    longer = run({"length_error": {"difference": 0.02}})
    tree = copy.deepcopy(TREE)
    tree["parameters"]["rod"]["length"] = LENGTH + 0.02
    same = run(parameters=tree["parameters"])
    np.testing.assert_allclose(longer.nodes, same.nodes, atol=1e-9)
    assert longer.u[-1] == pytest.approx(LENGTH) and same.u[-1] == pytest.approx(LENGTH + 0.02)
    made = experiment({"length_error": {"difference": 0.02}})
    _, points, _ = next(iter(measure(made, longer, [5], 0)))
    assert points.u[-1] == LENGTH
    np.testing.assert_allclose(points.positions[-1, [0, 2]], longer.nodes[5, -1], atol=1e-9)


def test_clamp_angle_adds_to_the_commanded_direction(plain):
    tree = copy.deepcopy(TREE)
    for point in tree["motion"]["start"]:
        point["angle"] += 0.15
    np.testing.assert_allclose(
        run({"clamp_angle": {"start": 0.15}}).nodes, run(motion=tree["motion"]).nodes, atol=1e-9
    )
    # Weightless, an end that only its clamp turns: positive from x towards -z.
    motion = {
        "control_point_1": [{"time": 0.0, "position": [0.0, 0.0, 0.0]}],
        "control_point_2": [{"time": 0.0, "position": [0.02, 0.0, 0.0]}],
    }
    parameters = TREE["parameters"] | {"gravity": [0.0, 0.0, 0.0]}
    made = experiment(
        {"clamp_angle": {"start": 0.2}},
        motion=motion,
        parameters=parameters,
    )
    simulation, _ = build_simulation(made, edges=40)
    tip = LENGTH * np.array([np.cos(0.2), -np.sin(0.2)])
    np.testing.assert_allclose(simulation.x[-1], tip, atol=1e-6)
    grips = Grips(
        experiment(
            {"clamp_angle": {"end": -0.1}},
            motion={"end": [{"time": 0.0, "position": [0.2, 0.0, 0.0], "angle": 0.4}]},
        )
    )
    grips.attach(simulation.rod)
    assert grips.boundary(0.0).end == pytest.approx(0.3)


def test_clamp_offset_adds_to_the_commanded_position():
    tree = copy.deepcopy(TREE)
    for point in tree["motion"]["start"]:
        x, *y, z = point["position"]
        point["position"] = [x + 0.01, *y, z - 0.02]
    moved, commanded = run({"clamp_offset": {"start": [0.01, -0.02]}}), run(motion=tree["motion"])
    np.testing.assert_allclose(moved.nodes, commanded.nodes, atol=1e-9)


def test_grip_offset_is_added_in_the_hands_own_axes():
    """As a robot's frame whose clamp lies beside the one that is told."""
    tree = copy.deepcopy(TREE)
    turn = float(tree["motion"]["start"][0]["angle"])
    for point in tree["motion"]["start"]:
        point["angle"] = turn
    still = tree["motion"]
    aside = [0.01 * np.cos(turn) - 0.02 * np.sin(turn), -0.01 * np.sin(turn) - 0.02 * np.cos(turn)]
    found = run({"grip_offset": {"start": [0.01, -0.02]}}, motion=still)
    same = run({"clamp_offset": {"start": [float(v) for v in aside]}}, motion=still)
    np.testing.assert_allclose(found.nodes, same.nodes, atol=1e-9)
    made = experiment({"grip_offset": {"start": [0.01, -0.02]}})
    end = made.command.times[-1] + 1.0
    rotation = Rotation.from_quat(made.command.rotations[-1, 0])
    simulation, _ = build_simulation(made, edges=40)
    grips = Grips(made)
    grips.attach(simulation.rod)
    (place,) = grips.boundary(end).positions.values()
    there = made.command.positions[-1, 0] + rotation.apply([0.01, 0.0, -0.02])
    np.testing.assert_allclose(place, there[[0, 2]], atol=1e-12)


def test_tilted_gravity_is_the_turned_experiment():
    """Everything turned by the same angle about the origin: the same motion, turned."""
    angle = 0.25
    tree = copy.deepcopy(TREE)
    for point in tree["motion"]["start"]:
        x, _, z = point["position"]
        x, z = turned(np.array([x, z]), angle)
        point["position"] = [float(x), 0.0, float(z)]
        point["angle"] += angle
    tree["initial_shape"] = turned(np.array(TREE["initial_shape"]), angle).tolist()
    tilted = run(
        {"gravity_tilt": {"angle": angle}}, **{k: tree[k] for k in ("motion", "initial_shape")}
    )
    expected = turned(run().nodes, angle)
    np.testing.assert_allclose(tilted.nodes, expected, atol=1e-7)
    # From x towards -z: gravity along -z comes to point towards -x.
    gravity = HiddenEffects({"gravity_tilt": {"angle": 0.1}}).gravity(np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose(gravity, [-9.81 * np.sin(0.1), 0.0, -9.81 * np.cos(0.1)])


def test_camera_turns_and_shrinks_what_is_measured(plain):
    made = experiment({"camera_rotation": {"angle": 0.1}, "camera_scale": {"ratio": 1.05}})
    for i, points, _ in measure(made, plain, [0, 20], 0):
        true = plain.centreline(i, points.u)
        x, z = true[:, 0], true[:, 2]
        turned_x = np.cos(0.1) * x + np.sin(0.1) * z
        turned_z = -np.sin(0.1) * x + np.cos(0.1) * z
        np.testing.assert_allclose(points.positions[:, 0], turned_x / 1.05, atol=1e-12)
        np.testing.assert_allclose(points.positions[:, 2], turned_z / 1.05, atol=1e-12)


def test_camera_effects_are_a_camera_that_stands_elsewhere(plain):
    """A true point under the true pose and its measured place under the stated pose: one pixel."""
    made = experiment(
        {"camera_rotation": {"angle": 0.1}, "camera_scale": {"ratio": 1.05},
         "camera_shift": {"x": 0.01, "z": -0.02}}
    )  # fmt: skip
    true = plain.centreline(10, np.linspace(0.0, LENGTH, 20))
    seen = Geometry(made.camera, made.camera_pose).project(true)
    taken_for = Geometry(made.camera, made.truth.camera).project(made.hidden.measured(true))
    np.testing.assert_allclose(seen, taken_for, atol=1e-6)
    assert np.abs(seen - Geometry(made.camera, made.truth.camera).project(true)).max() > 10.0


def test_camera_shifts_what_is_measured(plain):
    made = experiment({"camera_shift": {"x": 0.01, "z": -0.02}})
    for i, points, _ in measure(made, plain, [0, 20], 0):
        true = plain.centreline(i, points.u)
        np.testing.assert_allclose(points.positions, true + np.array([0.01, 0.0, -0.02]), atol=1e-9)


def test_hung_mass_swings_as_rayleigh_says():
    rope = RodParameters(LENGTH, 0.004, 2e9, 2500.0)
    settings = Settings(rope, gravity=(0, 0, 0), damping=DampingParameters(0.0, 0.0, 0.0))
    mass = 10.0 * rope.linear_density * LENGTH
    what = HiddenEffects({"point_mass": {"mass": mass, "position": LENGTH}})
    rod = build_rod(settings, what, edges=60)
    rod.force[-1, 1] = 1e-3
    hold = ImposedNodes({0: np.zeros(2)}, start=0.0)
    x = np.column_stack([rod.u, np.zeros(len(rod.u))])
    simulation = DiscreteRodSimulation(rod, lambda _: hold, x, step=5e-3)
    simulation.settle()
    rod.force[-1, 1] = 0.0
    times = np.arange(1, 301) * 0.02
    tip = np.array([simulation.advance(t)[-1, 1] for t in times])
    change = np.flatnonzero(np.diff(np.sign(tip)))
    zeros = times[change] + 0.02 * tip[change] / (tip[change] - tip[change + 1])
    omega = np.pi / np.mean(np.diff(zeros))
    effective = mass + 33.0 / 140.0 * rope.linear_density * LENGTH
    assert omega == pytest.approx(
        np.sqrt(3 * rope.bending_stiffness / effective / LENGTH**3), rel=2e-3
    )


def test_damping_adds_to_what_the_parameters_say():
    made = experiment(
        {"air_drag": {"coefficient": 0.05}, "internal_damping": {"relaxation_time": 0.01}}
    )
    rod = build_rod(made.truth, made.hidden, edges=40)
    assert rod.drag.sum() == pytest.approx((0.02 + 0.05) * LENGTH)
    assert rod.relaxation_time == pytest.approx(0.014)


def test_foreign_changes_in_time():
    made = experiment(foreign={"stiffness_drift": {"rate": -0.2}})
    rod = build_rod(made.truth, made.hidden, edges=40)
    drifting = change(made.truth, made.hidden, lambda _: 0.0)
    np.testing.assert_allclose(
        drifting(rod, 1.5).bending_stiffness, 0.7 * rod.bending_stiffness, rtol=1e-12
    )
    values = []
    for seed in range(40):
        made = experiment(foreign={"gusts": {"force": 0.1, "correlation_time": 0.1, "seed": seed}})
        gusty = change(made.truth, made.hidden, lambda _: 0.0)
        assert not np.any(gusty(rod, 0.0).force)
        per_length = [gusty(rod, t).force / rod.vertex_lengths[:, None] for t in (1.0, 2.0, 3.0)]
        values.append(per_length)
        again = change(made.truth, made.hidden, lambda _: 0.0)
        np.testing.assert_array_equal(again(rod, 1.0).force, gusty(rod, 1.0).force)
    assert np.sqrt(np.mean(np.square(values))) == pytest.approx(0.1, rel=0.15)
    step = np.abs(gusty(rod, 2.01).force - gusty(rod, 2.0).force) / rod.vertex_lengths[:, None]
    assert step.max() < 0.06


def test_creeping_camera(plain, tmp_path):
    creep = {"camera_creep": {"x": 0.002, "z": -0.001, "angle": 0.01}}
    made = experiment(foreign=creep)
    for i, points, _ in measure(made, plain, [0, 30], 0):
        t = i / 30.0
        true = turned(plain.centreline(i, points.u)[:, [0, 2]], 0.01 * t) + t * np.array(
            [0.002, -0.001]
        )
        np.testing.assert_allclose(points.positions[:, [0, 2]], true, atol=1e-9)
    with pytest.raises(InputError, match="no images"):
        synthesize(made, tmp_path / "bag")


IN_THE_PLANE = [name for name in EFFECTS if name != "twisting_stiffness"]


@pytest.mark.parametrize(
    "name", some_of([*IN_THE_PLANE, *FOREIGN], {*IN_THE_PLANE, *FOREIGN} - {"anisotropy"})
)
def test_every_effect_changes_what_is_measured(name, plain):
    """From the experiment file to the measured points, with values as one might meet them."""
    values = {
        "intrinsic_curvature": {"curvature": [1.0, -1.0]},
        "anisotropy": {"ratio": 3.0, "angle": 0.5},
        "clamp_angle": {"start": 0.05},
        "clamp_compliance": {"start": 4.0},
        "connector": {"mass": 0.005, "extent": 0.05},
        "gravity_tilt": {"angle": 0.05},
        "point_mass": {"mass": 0.005, "position": 0.25},
        "stiff_segment": {"centre": 0.1, "extent": 0.05, "ratio": 3.0},
        "stiffness_gradient": {"change": 0.5},
        "nonlinear_stiffness": {"half_curvature": 15.0},
        "plasticity": {"yield_curvature": 4.0, "hardening": 0.3},
        "hysteresis": {"moment": 1e-3, "curvature": 0.5},
        "viscoelasticity": {"share": 0.4, "time": 0.1},
        "surface_friction": {"force": 0.05},
        "air_drag": {"coefficient": 0.05},
        "quadratic_drag": {"coefficient": 0.3},
        "wall": {"offset": -0.2},
        "internal_damping": {"relaxation_time": 0.02},
        "command_delay": {"delay": 0.05},
        "clamp_slip": {"length": 0.01},
        "length_error": {"difference": 0.01},
        "camera_scale": {"ratio": 1.02},
        "camera_rotation": {"angle": 0.02},
        "camera_shift": {"x": 0.004, "z": -0.003},
        "clamp_offset": {"start": [0.004, -0.003]},
        "grip_offset": {"start": [0.004, -0.003]},
        "grip_angle": {"start": [0.04, 0.0]},
        "obstacle": {"x": 0.2, "z": -0.1, "radius": 0.01},
        "constant_force": {"x": 0.03},
        "gusts": {"force": 0.05},
        "stiffness_drift": {"rate": 0.2},
        "camera_creep": {"x": 0.004},
    }[name]
    blocks = ({name: values}, None) if name in EFFECTS else (None, {name: values})
    made, truth = experiment(*blocks), run(*blocks)
    (_, points, _), (_, without, _) = (
        next(iter(measure(m, t, [25], 0))) for m, t in ((made, truth), (experiment(), plain))
    )
    moved = np.linalg.norm(points.positions - without.positions, axis=1).mean()
    assert 5e-4 < moved < 0.08, moved


def test_recording_states_effects_in_the_truth_alone(tmp_path):
    effects = {
        "point_mass": {"mass": 0.01, "position": 0.3},
        "intrinsic_curvature": {"curvature": [1.0, 2.0]},
        "camera_rotation": {"angle": 0.05},
        "command_delay": {"delay": 0.03},
    }
    made = experiment(effects, {"gusts": {"force": 0.01}}, duration=0.2)
    synthesize(made, tmp_path / "bag", images=False, edges=40, step=2e-3)
    told = yaml.safe_load((tmp_path / "bag" / "truth.yaml").read_text())
    assert told["effects"]["point_mass"] == effects["point_mass"]
    assert told["effects"]["intrinsic_curvature"]["curvature"] == [1.0, 2.0]
    assert told["foreign"]["gusts"]["force"] == 0.01
    assert "effects" not in (tmp_path / "bag" / "params.yaml").read_text()
    settings = Settings.load(tmp_path / "bag" / "params.yaml")
    assert settings.camera == made.truth.camera
    recording = read_recording(tmp_path / "bag", settings)
    assert recording.commands[0].stamp == START_STAMP  # as it was commanded
    np.testing.assert_allclose(recording.commands[0].positions, made.command.positions)


BAD = [
    ({"point_mas": {"mass": 0.1}}, "'point_mas' is no effect; known are intrinsic_curvature"),
    ({"point_mass": {"mass": 0.1}}, "'position' is missing; give a number .m."),
    ({"point_mass": {"mass": "big", "position": 0.1}}, "mass is 'big'; give a number"),
    ({"point_mass": {"mass": -0.1, "position": 0.1}}, "mass is -0.1; allowed is 0"),
    ({"point_mass": {"mass": 0.1, "position": 0.5}}, "position is 0.5 m; the rope is 0.4 m"),
    ({"point_mass": {"mass": 0.1, "position": 0.2, "colour": 1}}, "'colour' is unknown"),
    ({"point_mass": 0.1}, "point_mass is 0.1; it must be a block"),
    ({"clamp_angle": {}}, "is empty; give start, end"),
    ({"gravity_tilt": {"angle": [0.1, 0.2]}}, "angle is .0.1, 0.2.; give a number"),
    ({"intrinsic_curvature": {"curvature": []}}, "give 1 numbers"),
    ({"clamp_offset": {"start": 0.01}}, "start is 0.01; give 2 or 3 numbers"),
    ({"clamp_offset": {"start": [0.01]}}, "give 2 or 3 numbers"),
    ({"length_error": {"difference": -0.3}}, "effects leave 0.1 m of a rope of 0.4 m"),
]


@pytest.mark.parametrize(("effects", "message"), BAD, ids=[m for _, m in BAD])
def test_bad_effects_say_what_is_wrong(effects, message):
    with pytest.raises(InputError, match=message) as raised:
        experiment(effects)
    assert str(raised.value).startswith("test.yaml") and "\n" not in str(raised.value)
    with pytest.raises(InputError, match="gust' is no effect; known are gusts"):
        experiment(foreign={"gust": {"force": 1.0}})
    assert read_effects(None, "x") == {}


def test_cantilever_answer_is_symmetric():
    """The boundary value problem by itself: a load turned by 90 degrees with its clamp."""
    down = Cantilever(0.4, lambda s: 0 * s + 1e-3, 1e3, lambda s: (0 * s, 0 * s - 0.05))
    side = replace(down, force=lambda s: (0 * s - 0.05, 0 * s), direction=np.pi / 2)
    s = np.linspace(0, 0.4, 9)
    np.testing.assert_allclose(side.solve(s), turned(down.solve(s), np.pi / 2), atol=1e-8)
