# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The observer in space: the fit through several views, what it states, and when it is silent."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree
from vision_views import DIAMETER, FINE, LEFT, LENGTH, RIGHT, away, clamps, fitted, rope, view

from dlo_ros.cli.main import main
from dlo_ros.errors import InputError, ParameterError, VisionError
from dlo_ros.parameters import RodParameters, Settings, VisionParameters
from dlo_ros.recordings.image_building import depth_message
from dlo_ros.recordings.images import read_depth
from dlo_ros.recordings.message_building import BAG_MESSAGES
from dlo_ros.recordings.read import read_recording
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import find_experiment
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.space import SpaceObserver
from dlo_ros.vision.space.depth import course_depth, profile_depths
from dlo_ros.vision.space.matching import Course, align, match
from dlo_ros.vision.space.publishing import publish
from dlo_ros.vision.space.reprojection import Prior, fit_views
from dlo_ros.vision.space.spatial_credibility import check
from dlo_ros.vision.space.spatial_observer import Frame


def test_two_views_find_the_curve_and_its_std():
    inside, missed = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        points = rope((1.0, 0.0, 0.6), 0.03 + 0.004 * seed)
        views = [view(c, points, rng) for c in (LEFT, RIGHT)]
        fit = fitted(views, points)
        check(views, fit, clamps(points), DIAMETER)
        distance, std = away(fit, points)
        inside.append(np.mean(distance < 2.448 * std))
        missed.append(distance)
    assert 0.9 <= np.mean(inside) <= 0.995
    assert np.sqrt(np.mean(np.square(missed))) < 6e-4


def test_points_beside_another_strand_do_not_count():
    # Where a strand lies behind the DLO its edges lie further apart, and their middle beside it.
    rng = np.random.default_rng(3)
    points = rope((1.0, 0.0, 0.6))
    views, errors = [], []
    for of in (LEFT, RIGHT):
        one = view(of, points, rng)
        depth = (FINE.evaluate(points, one.u) @ of.rotation.T + of.translation)[:, 2]
        apart = DIAMETER * 1500.0 / depth * (1.0 + 0.01 * rng.normal(size=len(one.u)))
        hidden = (one.u > 0.3 * LENGTH) & (one.u < 0.5 * LENGTH)
        apart[hidden] += 1.6
        normal = np.column_stack([-one.tangents[:, 1], one.tangents[:, 0]])
        beside = one.rays + np.where(hidden, 0.8 / 1500.0, 0.0)[:, None] * normal
        views.append(replace(one, rays=beside, apart=apart))
    for known in (True, False):
        some = views if known else [replace(one, apart=None) for one in views]
        fit = fitted(some, points)
        distance, std = away(fit, points)
        errors.append(float(np.max(distance / std)))
        assert known == (np.mean(fit.weights[0] == 0.0) > 0.15)
    assert errors[0] < 4.0 < errors[1]


def test_std_grows_along_the_epipolar_line_and_where_one_view_is_alone():
    rng = np.random.default_rng(1)
    across, along = rope((0.2, 0.0, 1.0), 0.01), rope((1.0, 0.0, 0.0), 0.002)
    stds = []
    for points in (across, along):
        fit = fitted([view(c, points, rng) for c in (LEFT, RIGHT)], points)
        stds.append(np.median(away(fit, points)[1]))
    assert stds[1] > 3.0 * stds[0]
    inside = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        right = view(RIGHT, across, rng, high=0.6 * LENGTH, count=60)
        distance, std = away(fitted([view(LEFT, across, rng), right], across), across)
        assert std[28] > 3.0 * std[10]
        inside.append(np.mean(distance < 2.448 * std))
    assert np.mean(inside) > 0.9


def test_a_place_whose_depth_is_not_determined_has_no_point():
    rng, points = np.random.default_rng(0), rope((0.2, 0.0, 1.0), 0.01)
    right = view(RIGHT, points, rng, high=0.6 * LENGTH, count=60)
    fit = fitted([view(LEFT, points, rng), right], points)
    seen, basis = np.ones(400, dtype=bool), SplineBasis(10, LENGTH)
    found = publish(0, fit, basis, seen, (0.0, 0.0), DIAMETER).points
    std = away(fit, points)[1]
    assert std.max() > 2e-3 > found.std.max()
    lost = np.linspace(0.0, LENGTH, 34)[std > 2.5e-3]
    assert np.all(np.abs(found.u[:, None] - lost).min(axis=0) > 0.005)
    assert np.sum(found.u < 0.6 * LENGTH) >= 19
    blind = replace(fit, covariance=1e4 * fit.covariance)
    with pytest.raises(VisionError, match="do not determine the depth"):
        publish(0, blind, basis, seen, (0.0, 0.0), DIAMETER)


def test_u_is_counted_from_the_clamp_where_a_rope_bends_most():
    # A curve that bends at its clamp and is straight elsewhere, as a rope that hangs down.
    turn = 1.4 * np.exp(-np.linspace(0.0, LENGTH, 2001) / 0.03)
    step = np.column_stack([np.sin(turn), 0.2 * np.cos(turn), -np.cos(turn)])
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    course = np.cumsum(step, axis=0) * LENGTH / 2000 + [0.1, 0.0, 0.15]
    points = FINE.fit(np.linspace(0.0, LENGTH, 2001), course)
    start, end = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        views = [view(c, points, rng) for c in (LEFT, RIGHT)]
        tips = [(None, v.camera.project(points[-1:])[0]) for v in views]
        views = [replace(v, tips=t) for v, t in zip(views, tips, strict=True)]
        fit = fit_views(views, FINE, points + 0.002, Prior(DIAMETER, (clamps(points)[0], None)))
        for found, k, at in ((start, 0, 0.0), (end, -1, LENGTH)):
            found.append((fit.points[k] - points[k]) @ fit.tangents(np.array([at]))[0])
    assert np.abs(start).max() < 0.05 * DIAMETER
    # The rough part neither pulls the curve along itself nor makes it shorter.
    assert abs(np.mean(end)) < 0.15 * DIAMETER


def test_wrong_points_in_one_view_do_not_move_the_curve():
    rng = np.random.default_rng(2)
    points = rope((1.0, 0.0, 0.6))
    views = [view(c, points, rng) for c in (LEFT, RIGHT)]
    rays = views[1].rays.copy()
    rays[40:46] += 6.0 / 1500.0
    views[1] = replace(views[1], rays=rays)
    fit = fitted(views, points)
    check(views, fit, clamps(points), DIAMETER)
    assert away(fit, points)[0].max() < 2.5e-3
    assert np.all(fit.weights[1][40:46] < 0.1)


def test_views_of_different_shapes_are_refused():
    rng = np.random.default_rng(3)
    points, other = rope((1.0, 0.0, 0.6)), rope((1.0, 0.0, 0.6), 0.035)
    views = [view(LEFT, points, rng), view(RIGHT, other, rng)]
    with pytest.raises(VisionError, match=r"do not show one DLO|is .* m long|from its clamp"):
        check(views, fitted(views, points), clamps(points), DIAMETER)


def test_one_view_alone_is_refused():
    rng = np.random.default_rng(4)
    points = rope((1.0, 0.0, 0.6))
    views = [view(LEFT, points, rng), view(RIGHT, points, rng, high=0.3 * LENGTH, count=30)]
    with pytest.raises(VisionError, match=r"two views share only 3. %"):
        check(views, fitted(views, points), clamps(points), DIAMETER)


def test_stamps_apart_are_allowed_for():
    rng = np.random.default_rng(5)
    points, dt = rope((1.0, 0.0, 0.6)), 0.01
    speed = np.tile([0.0, 0.0, 0.3], (36, 1))
    views = [view(LEFT, points, rng), view(RIGHT, points + dt * speed, rng, dt=dt)]
    known = fitted(views, points, velocity=speed, speed_std=0.02)
    assert away(known, points)[0].max() < 1.5e-3
    unknown = fitted(views, points, speed_std=0.3)
    distance, std = away(unknown, points)
    assert np.median(std) > 1.5 * np.median(away(known, points)[1])
    assert np.mean(distance < 2.448 * std) > 0.9


def test_depth_in_the_same_fit():
    inside, missed = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        points = rope((1.0, 0.0, 0.6))
        one = view(LEFT, points, rng, depth=1.5e-3)
        one.depth[20:24] = np.nan
        one.depth[50:53] += 0.1  # mixed pixels: the board behind it
        fit = fitted([one], points)
        check([one], fit, clamps(points), DIAMETER)
        distance, std = away(fit, points)
        inside.append(np.mean(distance < 2.448 * std))
        missed.append(distance)
    assert np.sqrt(np.mean(np.square(missed))) < 1e-3
    # Neighbouring points err alike, so that the share of a single picture says little.
    assert 0.88 <= np.mean(inside) <= 0.98


def test_courses_match_without_clamps():
    points = rope((1.0, 0.0, 0.6))
    u = np.linspace(0.0, LENGTH, 300)
    truth = FINE.evaluate(points, u)
    courses = [Course(c, c.rays(c.project(truth))) for c in (LEFT, RIGHT)]
    right = match(courses)
    assert right.distance < 1.0
    assert right.length == pytest.approx(LENGTH, rel=0.02)
    assert cKDTree(truth).query(right.points)[0].max() < 8e-3
    assert match([courses[0], courses[1].backwards()]).distance > 4.0


def test_alignment_is_monotone_and_cheapest():
    cost = np.full((4, 5), 9.0)
    way = [(0, 0), (1, 1), (1, 2), (2, 3), (3, 4)]
    for cell in way:
        cost[cell] = 0.0
    i, j, mean = align(cost, 0.1)
    assert list(zip(i, j, strict=True)) == way
    assert mean == 0.0


@pytest.mark.parametrize("turn", [0.0, 45.0, -55.0])
def test_depth_of_a_dlo_that_runs_towards_the_camera_is_that_of_its_axis(turn):
    """Seen aslant, the surface lies further before the axis than a radius."""
    rng = np.random.default_rng(5)
    along = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0.0])
    points = (FINE.greville - 0.5 * LENGTH)[:, None] * along
    one = view(LEFT, points, rng, depth=1e-4)
    fit = fitted([one], points)
    inner = slice(4, -4)
    found = FINE.evaluate(fit.points, np.linspace(0.0, LENGTH, 34))[inner]
    errors = found - (found @ along)[:, None] * along
    assert np.linalg.norm(errors.mean(axis=0)) < 1e-4


def test_depth_is_read_in_the_core_as_that_of_the_middle():
    image = np.full((40, 60), 1.5, dtype=np.float32)
    image[17:24] = 1.2  # a rope 7 px wide; its edges are mixed
    image[[17, 23]] = 1.35
    image[20, 10:20] = np.nan
    x = np.arange(5.0, 55.0)
    curve = np.column_stack([x, np.full(50, 20.0)])
    n = np.tile([0.0, 1.0], (50, 1))
    one = np.ones(50)
    located = Located(
        curve, n, 0 * one, one > 0, one, 7.0, 90.0, np.zeros(3), 1.0, 0.1, 0.1, 0 * one, 0 * one
    )
    depth = profile_depths(image, located, 2e-3)
    assert np.all(np.abs(depth - 1.2) < 3e-4)
    image[15:26, 30:] = 0.0
    assert np.isnan(profile_depths(image, located, 2e-3)[-10:]).all()


def test_a_depth_beyond_a_free_end_stays_alone():
    """The last pixel of a course may show what is behind the DLO: that makes it no longer."""
    image = np.full((40, 160), 1.3)
    image[15:26, :140] = 1.0
    course = np.column_stack([np.arange(5.0, 142.0, 2.5), np.full(55, 20.0)])
    assert image[20, 140] == 1.3 and course[-1, 0] == 140.0
    depth = course_depth(image, course, 11.0, 0.0)
    np.testing.assert_allclose(depth, 1.0)


@pytest.mark.parametrize("step", [2, 4])
def test_depth_of_another_size_is_not_read_at_other_pixels(step):
    settings = Settings(RodParameters(LENGTH, DIAMETER, 1e6, 1e3))
    image = np.full((LEFT.height, LEFT.width, 3), 200, np.uint8)
    depth = np.ones((LEFT.height // step, LEFT.width // step), np.float32)
    size = f"{LEFT.width // step} x {LEFT.height // step} px"
    with pytest.raises(VisionError, match=f"depth image is {size}, .* must be aligned"):
        SpaceObserver(settings, {"": LEFT}).observe({"": Frame(1, image, depth)})


def test_depth_messages():
    data = np.array([[1200, 0], [65535, 900]], dtype=np.uint16)
    message = depth_message(BAG_MESSAGES, 1, "camera", data)
    depth = read_depth(message)
    assert depth[0, 0] == pytest.approx(1.2)
    assert np.isnan(depth[0, 1])
    message.encoding = "bgr8"
    with pytest.raises(InputError, match="16UC1"):
        read_depth(message)


ROD = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e6, "rod.density": 1e3}
POSE = {"translation": [0.0, 0.0, 1.2], "rotation": [2**-0.5, 0.0, 0.0, 2**-0.5]}
BOTH = {f"camera_{n}.{k}": v for n in ("left", "right") for k, v in POSE.items()}


def test_cameras_in_the_parameter_file(tmp_path):
    settings = Settings.from_mapping({**ROD, "vision.cameras": ["left", "right"], **BOTH})
    assert list(settings.cameras) == ["left", "right"]
    settings.dump(tmp_path / "p.yaml")
    assert Settings.load(tmp_path / "p.yaml") == settings
    assert "vision.cameras" not in Settings.from_mapping(ROD).flat()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"camera_right.rotation": [1.0, 1.0, 0.0, 0.0]}, "camera_right.rotation .* unit"),
        ({"camera_right.translation": [1.0]}, "camera_right.translation has 1"),
        ({"vision.cameras": "left"}, "must be names"),
        ({"vision.cameras": ["left", "right", "left"]}, "twice"),
        ({"vision.cameras": ["left", "a b", "right"]}, "letters"),
        ({"vision.cameras": ["left", "right", "top"]}, "camera_top.translation is missing"),
        ({"vision.cameras": ["left"]}, "has one name"),
        ({"camera_top.translation": [0.0, 0.0, 1.0]}, "does not name 'top'"),
        ({"vision.depth": "on"}, "auto | off"),
    ],
)
def test_unusable_cameras_are_refused(changed, message):
    given = {**ROD, "vision.cameras": ["left", "right"], **BOTH, **changed}
    with pytest.raises(ParameterError, match=message):
        Settings.from_mapping(given)


def test_hints_of_one_picture_are_refused_for_several_cameras():
    rod = RodParameters(LENGTH, DIAMETER, 1e6, 1e3)
    settings = Settings(rod, vision=VisionParameters(region=(1.0, 1.0, 50.0, 50.0)))
    with pytest.raises(InputError, match=r"vision\.region"):
        SpaceObserver(settings, {"left": LEFT, "right": RIGHT})


def test_empty_pictures_say_which_camera_sees_nothing():
    settings = Settings(RodParameters(LENGTH, DIAMETER, 1e6, 1e3))
    observer = SpaceObserver(settings, {"left": LEFT, "right": RIGHT})
    empty = np.full((720, 1280, 3), 200, dtype=np.uint8)
    frames = {name: Frame(1, empty) for name in ("left", "right")}
    with pytest.raises(VisionError, match="left: nothing"):
        observer.observe(frames)
    with pytest.raises(VisionError, match="no picture of camera right"):
        observer.observe({"left": frames["left"]})


def test_lengths_in_a_picture_are_pixels():
    """A strand of a seventh of the length, in both pictures."""
    settings = Settings(RodParameters(LENGTH, DIAMETER, 1e6, 1e3))
    observer = SpaceObserver(settings, {"left": LEFT, "right": RIGHT})
    picture = np.full((720, 1280, 3), 200, dtype=np.uint8)
    cv2.line(picture, (600, 300), (660, 330), (20, 20, 20), 6, cv2.LINE_AA)
    with pytest.raises(VisionError, match=r"left: no .* length \d+ px .* piece is [\d.]+ px\)"):
        observer.observe({name: Frame(1, picture) for name in ("left", "right")})


def short(tmp_path, change=lambda tree: None):
    tree = yaml.safe_load(find_experiment("twisted").read_text())
    tree["duration"] = 0.1
    change(tree)
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(tree))
    assert main(["synthesize", str(tmp_path / "short.yaml"), "--output", str(tmp_path / "in")]) == 0


def observed_error(tmp_path):
    """Largest distance of the observed points from the true spline [m], by picture."""
    settings = Settings.load(tmp_path / "in" / "params.yaml")
    truth = yaml.safe_load((tmp_path / "in" / "truth.yaml").read_text())
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    observations = read_recording(tmp_path / "out", settings).observations
    u = np.linspace(0.0, basis.length, 4001)
    shapes = dict(zip(truth["stamps"], truth["control_points"], strict=True))
    return [
        cKDTree(basis.evaluate(np.array(shapes[o.stamp])[:, :3], u)).query(o.points.positions)[0]
        for o in observations
    ], observations


@pytest.mark.long
def test_observe_finds_a_rope_in_two_cameras_pictures(tmp_path, capsys):
    short(tmp_path)
    call = ["observe", "--params", str(tmp_path / "in" / "params.yaml"), str(tmp_path / "in")]
    call += ["--output", str(tmp_path / "out"), "--overlays", str(tmp_path / "overlays")]
    assert main(call) == 0
    assert "stamps of the cameras' images 0.0 ms apart" in capsys.readouterr().out
    errors, observations = observed_error(tmp_path)
    assert len(errors) == 4
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 5e-4
    assert all(o.points.std_along is not None for o in observations)
    names = {path.stem.rsplit("_", 1)[1] for path in (tmp_path / "overlays").iterdir()}
    assert names == {"left", "right"}


@pytest.mark.slow
def test_observe_uses_depth(tmp_path):
    def one_camera(tree):
        left = tree.pop("cameras")["left"]
        tree["parameters"]["camera"] = {k: left.pop(k) for k in ("translation", "rotation")}
        tree["camera"] = {"rate": 30.0, **left}
        tree["depth"] = {"std": 0.002}

    short(tmp_path, one_camera)
    call = ["observe", "--params", str(tmp_path / "in" / "params.yaml"), str(tmp_path / "in")]
    assert main([*call, "--output", str(tmp_path / "out")]) == 0
    errors, _ = observed_error(tmp_path)
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 1e-3
