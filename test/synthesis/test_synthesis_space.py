# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Experiments in space: files, hidden effects, recordings; the spline rod moves as they do."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import yaml
from ordinary import some_of
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from twins import CLOSED, TWISTED, WAVED, compare, tree

from dlo_ros.cli import synthesize as tool
from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.parameters import CameraPose
from dlo_ros.recordings.read import read_recording
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.experiment import find_experiment, load_experiment, read_experiment
from dlo_ros.synthesis.hidden_effects import HiddenEffects
from dlo_ros.synthesis.hidden_rod import build_spatial_rod
from dlo_ros.synthesis.picture_settings import DepthSensor, Look, SimulatedCamera
from dlo_ros.synthesis.spatial_render import SpatialRenderer
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.true_motion import build_simulation, simulate

DURATION, EDGES, STEP = 0.24, 40, 3e-3
WAVE, CLOSE = ("waved", WAVED), ("closed", CLOSED)

# In the plane the rod in space must move as the planar one does, with whatever is hidden in it.
IN_PLANE = {
    "nothing": (WAVE, {}),
    "intrinsic_curvature": (WAVE, {"intrinsic_curvature": {"curvature": [-4.0, 3.0, 2.0]}}),
    "kink": (WAVE, {"intrinsic_curvature": {"kink": 0.25, "position": 0.15}}),
    "clamp_angle": (CLOSE, {"clamp_angle": {"start": 0.2, "end": -0.1}}),
    "clamp_offset": (CLOSE, {"clamp_offset": {"end": [0.01, 0.015]}}),
    "grip_offset": (WAVE, {"grip_offset": {"start": [0.01, 0.015]}}),
    "clamp_compliance": (WAVE, {"clamp_compliance": {"start": 6.0}}),
    "connector": (WAVE, {"connector": {"mass": 0.004, "extent": 0.05}}),
    "gravity_tilt": (WAVE, {"gravity_tilt": {"angle": 0.15}}),
    "point_mass": (WAVE, {"point_mass": {"mass": 0.004, "position": 0.25}}),
    "stiff_segment": (WAVE, {"stiff_segment": {"centre": 0.12, "extent": 0.1, "ratio": 4.0}}),
    "stiffness_gradient": (WAVE, {"stiffness_gradient": {"change": 1.2}}),
    "nonlinear_stiffness": (CLOSE, {"nonlinear_stiffness": {"half_curvature": 6.0}}),
    "nonlinear_stiffness, free": (WAVE, {"nonlinear_stiffness": {"half_curvature": 40.0}}),
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


ORDINARY = ["wall", "clamp_slip", "nonlinear_stiffness, free"]


@pytest.mark.long
@pytest.mark.parametrize("case", some_of(IN_PLANE, ORDINARY))
def test_in_the_plane_it_moves_as_the_planar_rod_does(case):
    (name, manipulation), effects = IN_PLANE[case]
    flat = motion(manipulation, effects, space=False)
    found = motion(manipulation, effects, space=True)
    assert np.abs(found[..., 1]).max() < 1e-9
    apart = np.linalg.norm(found - flat, axis=2).max()
    assert apart < NEAR * 0.4
    if effects and flat.shape == without(name).shape:  # a place asks for a node of its own
        assert np.linalg.norm(flat - without(name), axis=2).max() > 3.0 * apart


@pytest.mark.parametrize("own", [False, True])
def test_of_a_grip_that_rolls_two_numbers_stay_in_the_plane_and_three_roll_with_it(own):
    angle, roll, along, across = 0.4, 1.1, 0.01, 0.02
    still = {"time": 0.0, "position": [0.1, 0.0, 0.2], "angle": angle}
    motion = {"start": [still, still | {"time": 0.2, "turn": roll}]}
    offset = [along, 0.0, across] if own else [along, across]
    rope = tree(WAVED | {"motion": motion}, {"grip_offset": {"start": offset}}, DURATION)
    _, grips = build_simulation(read_experiment(rope, "test", "test.yaml"), edges=30)
    place = grips.spatial_boundary(0.2).positions[0]
    turn = Rotation.from_euler("YX", [angle, roll if own else 0.0]).as_matrix()
    np.testing.assert_allclose(place, [0.1, 0.0, 0.2] + turn @ [along, 0.0, across], atol=1e-12)


@pytest.mark.parametrize("end", ["start", "end"])
@pytest.mark.parametrize("flat", [{}, {"ratio": 3.0, "angle": 0.3}])
def test_a_grip_gives_alike_about_every_axis(flat, end):
    """Angle over moment grows by the grip's compliance, of a flat rope, too."""
    effects = {"anisotropy": flat} if flat else {}
    soft = effects | {"clamp_compliance": {end: 7.0}}
    bent, given = (
        np.linalg.inv(built.vertex_stiffness()[0 if end == "start" else -1, :2, :2])
        for built in (
            build_spatial_rod(made.truth, made.hidden, edges=30)
            for made in (
                read_experiment(tree(TWISTED, e, DURATION), "test", "x") for e in (effects, soft)
            )
        )
    )
    np.testing.assert_allclose(given - bent, 7.0 * np.eye(2), atol=1e-9)


@pytest.mark.parametrize("effects", [
    {"constant_force": {"x": 0.0, "y": 0.2, "z": -0.1}},
    {"gravity_tilt": {"across": 0.3}},
    {"clamp_angle": {"start": [0.0, 0.0, 0.4]}},
    {"grip_angle": {"start": [0.0, 0.4]}},
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
    elif "clamp_angle" in effects or "grip_angle" in effects:
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
    hidden = HiddenEffects({
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


def shortened(seconds):
    return replace(load_experiment(find_experiment("twisted")), duration=seconds)


def test_the_twisted_experiment_is_recorded_with_its_twist(tmp_path):
    made = shortened(0.3)
    assert made.spatial
    truth = synthesize(made, tmp_path / "bag", images=False, edges=40, step=4e-3)
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


def images_in(bag):
    """Messages of a bag by topic."""
    found = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


@pytest.mark.slow
def test_two_cameras_write_topics_of_their_own(tmp_path):
    truth = synthesize(shortened(0.04), tmp_path / "bag", edges=30, step=5e-3)
    found = images_in(tmp_path / "bag")
    written = yaml.safe_load((tmp_path / "bag" / "truth.yaml").read_text())
    for name in ("left", "right"):
        pictures = found[f"/{name}/image_raw/compressed"]
        assert len(pictures) == len(found[f"/{name}/camera_info"]) == 2
        picture = cv2.imdecode(pictures[0].data, cv2.IMREAD_COLOR)
        camera, pose = load_experiment(find_experiment("twisted")).cameras[name]
        assert picture.shape == (720, 1280, 3)
        np.testing.assert_allclose(written["cameras"][name]["true"]["translation"],
                                   pose.translation)  # fmt: skip
        pixels = Geometry(camera, pose).project(truth.centreline(0, np.linspace(0.02, 0.38, 40)))
        column, row = np.rint(pixels).astype(int).T
        rope = picture[row, column].mean()
        beside = picture[row - 12, column - 12].mean()
        assert rope < 0.6 * beside


@pytest.mark.slow
def test_depth_is_written_beside_the_picture(tmp_path):
    tree_ = yaml.safe_load(find_experiment("twisted").read_text())
    del tree_["cameras"]
    tree_ |= {"duration": 0.01, "depth": {"std": 0.001, "holes": 0.0}}
    made = read_experiment(tree_, "depth", "depth.yaml")
    synthesize(made, tmp_path / "bag", edges=30, step=5e-3)
    found = images_in(tmp_path / "bag")
    (image,) = found["/depth/image_raw"]
    assert image.encoding == "16UC1" and (image.height, image.width) == (1080, 1920)
    assert len(found["/image_raw/compressed"]) == len(found["/depth/camera_info"]) == 1
    view = {"translation": [0, 0, 1], "rotation": [0, 0, 0, 1]}
    with pytest.raises(InputError, match="leave cameras or depth out"):
        read_experiment(tree_ | {"cameras": {"left": view, "right": view}}, "d", "d.yaml")


@pytest.mark.parametrize(("change", "message"), [
    ({"cameras": {"left/1": {}}}, "'left/1' is no name for a topic"),
    ({"cameras": {"left": {"translation": [0, 0, 1], "rotation": [0, 0, 0, 1]}}},
     "has 'left' alone; give two or more"),
    ({"cameras": {"left": {"rate": 15.0}}}, "left: all have one rate; give it in `camera`"),
    ({"cameras": {"left": {"rotation": [0, 0, 0, 1]}}}, "'translation' is missing"),
    ({"cameras": {"left": {"translation": [0, 0, 1], "rotation": [0, 0, 0, 2]}}}, "allowed is -1"),
    ({"cameras": {"left": {"translation": [0, 0, 1], "rotation": [0, 0, 0, 0.5]}}}, "no unit"),
    ({"cameras": {"left": {"translation": [0, 0, 1], "rotation": [0, 0, 0, 1], "hue": 1}}},
     "'hue' is unknown"),
    ({"depth": {"noise": 1}}, "'noise' is unknown"),
    ({"motion": {"end": [{"time": 0, "position": [0, 0, 0], "angle": 0, "roll": 1}]}},
     "'roll' is unknown; known are angle"),
])  # fmt: skip
def test_bad_experiments_in_space_say_what_is_wrong(change, message):
    with pytest.raises(InputError, match=message):
        read_experiment(tree(TWISTED, {}, 0.1) | change, "t", "t.yaml")


def test_a_rope_behind_the_board_cannot_be_drawn(tmp_path):
    made = shortened(0.01)
    near = replace(made, look=replace(made.look, board_distance=0.01))
    with pytest.raises(InputError, match=r"behind the board; look.board_distance is 0.01 m"):
        synthesize(near, tmp_path / "bag", edges=30, step=5e-3)


EYE = CameraPose(translation=(0.0, 0.0, 1.2), rotation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))
SMALL = SimulatedCamera(width=320, height=240, focal_length=(600.0, 600.0),
                        principal_point=(159.5, 119.5), noise=0.0, blur=0.0)  # fmt: skip


def loop():
    """A loop whose later strand crosses 0.1 m before the earlier one, and its u."""
    s = np.linspace(0.0, 1.0, 801)
    line = np.column_stack(
        [0.1 * np.sin(2.2 * np.pi * s), 0.1 - 0.2 * s, 0.08 * np.sin(4.4 * np.pi * s + 0.3)]
    )
    size = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return line, np.concatenate([[0.0], np.cumsum(size)])


def test_the_rope_is_drawn_where_it_projects_and_hides_itself_by_depth():
    line, u = loop()
    renderer = SpatialRenderer(Geometry(SMALL, EYE), Look(hole_diameter=0.0), 0.008, 0.25, 0)
    seen = renderer.layers(line, u)
    whole = np.column_stack([np.interp(seen.u, u, c) for c in line.T])
    pixels = renderer.geometry.project(whole)
    row, column = np.divmod(seen.pixel, SMALL.width)
    away = np.column_stack([column, row]) - pixels
    width = 600.0 * 0.004 / seen.depth
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), np.abs(seen.across) * width, atol=0.51)
    assert np.linalg.norm(away, axis=1).max() < 0.5 + width.max() + 0.51
    assert abs(np.sum(away * seen.cover[:, None], axis=0) / seen.cover.sum()).max() < 0.02
    crossing = np.nonzero(seen.rank == 1)[0]
    assert len(crossing) > 10
    assert np.all(seen.pixel[crossing] == seen.pixel[crossing - 1])
    assert np.all(seen.depth[crossing] < seen.depth[crossing - 1] - 0.02)
    picture = renderer.frame([line], u).astype(float).mean(axis=2)
    assert picture.reshape(-1)[seen.pixel[seen.cover > 0.99]].mean() < 0.6 * np.median(picture)


def test_depth_has_holes_mixed_pixels_and_noise():
    line, u = loop()
    renderer = SpatialRenderer(Geometry(SMALL, EYE), Look(), 0.008, 0.25, 0)
    sensor = DepthSensor(std=0.002, holes=0.05, mixed=0.5, thin=1.5)
    depth = renderer.depth(line, u, sensor).astype(float) / 1000.0
    seen = renderer.layers(line, u)
    far = np.ones(depth.size, dtype=bool)
    far[seen.pixel] = False
    board = depth.reshape(-1)[far]
    assert np.mean(board == 0.0) == pytest.approx(0.05, abs=0.01)
    assert board[board > 0.0].mean() == pytest.approx(1.45, abs=1e-3)
    assert board[board > 0.0].std() == pytest.approx(0.002, rel=0.1)
    nearest = np.append(np.diff(seen.pixel) != 0, True)
    whole = nearest & (seen.cover == 1.0)
    found = depth.reshape(-1)[seen.pixel[whole]]
    behind = 0.004 * seen.behind[whole]
    surface = seen.depth[whole] - behind * np.sqrt(1.0 - seen.across[whole] ** 2)
    there = found > 0.0
    assert (found - surface)[there].std() == pytest.approx(0.002, rel=0.3)
    assert abs((found - surface)[there].mean()) < 3e-4
    edge = depth.reshape(-1)[seen.pixel[nearest & (seen.cover < 0.9) & (seen.cover > 0.1)]]
    assert 0.2 < np.mean(edge == 0.0) < 0.8  # half of them and those that are thin
    between = (edge > 1.32) & (edge < 1.44)
    assert between.mean() > 0.05


@pytest.mark.parametrize("turn", [0.0, 30.0, -50.0])
@pytest.mark.parametrize("beside", [0.0, 0.25])
def test_depth_is_that_of_a_cylinder(turn, beside):
    """Rays in the plane of axis and eye meet a cylinder where their distance from it is r."""
    radius, angle = 0.004, np.radians(turn)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    u = np.linspace(0.0, 0.1, 401)
    line = np.array([beside, 0.0, 0.0]) + (u - 0.05)[:, None] * along
    wide = replace(SMALL, width=640, principal_point=(319.5, 119.5))
    renderer = SpatialRenderer(Geometry(wide, EYE), Look(), 2.0 * radius, 0.25, 0)
    exact = DepthSensor(std=0.0, holes=0.0, mixed=1.0, thin=0.0)
    row = renderer.depth(line, u, exact)[[119, 120]].mean(axis=0) / 1000.0
    columns = np.unique(np.rint(renderer.geometry.project(line[60:-60])[:, 0]).astype(int))
    # In the plane z = 0 the distance of eye + t ray from the axis is begin + t rate, t the depth.
    normal = np.cross(along, [0.0, 0.0, 1.0])
    begin = (np.array([0.0, -1.2, 0.0]) - line[0]) @ normal
    rate = (columns - 319.5) / 600.0 * normal[0] + normal[1]
    depth = np.minimum((radius - begin) / rate, (-radius - begin) / rate)
    assert abs(np.mean(row[columns] - depth)) < 3e-4  # the image is in millimetres


def test_the_tool_writes_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tool, "compile_first", lambda *_: None)
    small = yaml.safe_load(find_experiment("twisted").read_text()) | {"duration": 0.1}
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(small))
    output = str(tmp_path / "bag")
    arguments = ["synthesize", str(tmp_path / "small.yaml"), "--no-images", "--output", output]
    assert main(arguments) == 0
    assert "4 observed splines" in capsys.readouterr().out


@pytest.mark.slow
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
