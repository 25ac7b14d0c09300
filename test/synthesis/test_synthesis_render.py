# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rendered frames: what is seen lies where the truth says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.parameters import CameraPose
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.picture_settings import Look, SimulatedCamera
from dlo_ros.synthesis.render import Renderer
from dlo_ros.synthesis.spatial_render import SpatialRenderer

CAMERA = SimulatedCamera(
    width=640,
    height=400,
    focal_length=(500.0, 505.0),
    principal_point=(322.0, 195.0),
    distortion=(-0.12, 0.06, 0.001, -0.0008, 0.0),
    noise=0.0,
)
TILT = Rotation.from_euler("zxy", [1.0, 88.0, 4.0], degrees=True).as_quat()
POSE = CameraPose((0.01, -0.02, 0.5), tuple(float(q) for q in TILT))
PLAIN = Look(grain=0.0, hole_diameter=0.0, shadow=0.0, strand_contrast=0.0, pin_diameter=0.0)
DIAMETER = 0.008
UP = np.array([0.0, 0.0, 1.0])
AWAY = 9.0 * UP  # out of sight


def wave(u: np.ndarray) -> np.ndarray:
    s = u - 0.15
    return np.column_stack([1.1 * s, np.zeros_like(u), 0.05 * np.sin(20.0 * s)])


def renderer(camera: SimulatedCamera = CAMERA, look: Look = PLAIN, seed: int = 0) -> Renderer:
    return Renderer(Geometry(camera, POSE), look, DIAMETER, seed)


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial"])
def test_rays_undo_the_projection(model):
    more = (0.3, -0.1, 0.02) if model == "rational_polynomial" else ()
    camera = replace(CAMERA, model=model, distortion=(*CAMERA.distortion, *more))
    geometry = Geometry(camera, POSE)
    plane = geometry.on_plane(geometry.rays(), 0.004)
    rows, columns = np.array([0, 0, 57, 200, 399]), np.array([0, 639, 311, 320, 5])
    x, z = plane[rows, columns].T
    points = np.column_stack([x, np.full(5, 0.004), z])
    np.testing.assert_allclose(
        geometry.project(points), np.column_stack([columns, rows]), atol=1e-4
    )


def test_projection_of_a_straight_camera_is_the_plain_pinhole():
    camera = replace(CAMERA, distortion=(0.0,) * 5)
    half = float(np.sqrt(0.5))
    geometry = Geometry(camera, CameraPose((0.0, 0.0, 0.5), (half, 0.0, 0.0, half)))
    pixels = geometry.project(np.array([[0.1, 0.0, 0.05], [0.0, 0.5, 0.0]]))
    np.testing.assert_allclose(pixels[0], [322.0 + 100.0, 195.0 - 50.5], atol=1e-9)
    np.testing.assert_allclose(pixels[1], [322.0, 195.0], atol=1e-9)  # y leads away from the camera
    np.testing.assert_allclose(geometry.eye, [0.0, -0.5, 0.0], atol=1e-9)


def test_rope_is_drawn_on_its_true_centreline():
    # Black, since shading moves the middle of brightness, not that of the rope.
    scene = renderer(look=replace(PLAIN, rope_colour=(0.0, 0.0, 0.0)))
    u = np.linspace(0.0, 0.3, 301)
    seen = scene.frame([wave(u)], u, np.array([])).astype(float)
    empty = scene.frame([wave(u) + AWAY], u, np.array([])).astype(float)
    cover = np.abs(seen - empty).sum(axis=2)
    pixels = scene.geometry.project(wave(u))
    widths, offsets = [], []
    inner = slice(20, -20, 7)
    tangent = np.gradient(pixels, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    s = np.arange(-14.0, 14.001, 0.02)
    for p, t in zip(pixels[inner], tangent[inner], strict=True):
        at = p + s[:, None] * np.array([-t[1], t[0]])
        c, r = np.floor(at).astype(int).T
        fc, fr = (at - np.floor(at)).T
        value = (
            cover[r, c] * (1 - fr) * (1 - fc)
            + cover[r, c + 1] * (1 - fr) * fc
            + cover[r + 1, c] * fr * (1 - fc)
            + cover[r + 1, c + 1] * fr * fc
        )
        half = 0.5 * np.median(value[np.abs(s) < 1.0])
        inside = s[value > half]
        widths.append(inside[-1] - inside[0])
        offsets.append(0.5 * (inside[-1] + inside[0]))
    assert np.abs(np.mean(offsets)) < 0.02 and np.std(offsets) < 0.04
    expected = DIAMETER / np.linalg.norm(np.diff(wave(u), axis=0), axis=1)[140]
    expected *= np.linalg.norm(np.diff(pixels, axis=0), axis=1)[140]
    assert np.mean(widths) == pytest.approx(expected, rel=0.04)


def test_rope_ends_where_it_ends():
    scene = renderer(replace(CAMERA, blur=0.0))
    u = np.linspace(0.0, 0.3, 301)
    line = np.column_stack([u - 0.15, np.zeros_like(u), np.zeros_like(u)])
    seen = scene.frame([line], u, np.array([])).astype(float)
    empty = scene.frame([line + AWAY], u, np.array([])).astype(float)
    rope = np.abs(seen - empty).sum(axis=2) > 60.0
    pixels = scene.geometry.project(line)
    for end, inwards in ((pixels[0], pixels[5] - pixels[0]), (pixels[-1], pixels[-6] - pixels[-1])):
        step = inwards / np.linalg.norm(inwards)
        inside, outside = (
            np.rint(end + 1.5 * step).astype(int),
            np.rint(end - 1.5 * step).astype(int),
        )
        assert rope[inside[1], inside[0]] and not rope[outside[1], outside[0]]


def test_later_strand_lies_on_top_at_a_crossing():
    look = replace(PLAIN, rope_colour=(200.0, 40.0, 40.0), strand_contrast=1.0, strand_pitch=1.0)
    scene = renderer(look=look)
    u = np.linspace(0.0, 0.5, 501)
    turn = 2.0 * np.pi * np.clip((u - 0.1) / 0.3, 0.0, 1.0)
    radius = 0.3 / (2.0 * np.pi)
    x = np.where(u < 0.1, u - 0.1, np.where(u > 0.4, u - 0.4, radius * np.sin(turn)))
    z = np.where((u < 0.1) | (u > 0.4), 0.0, radius * (1.0 - np.cos(turn))) - 0.05
    slope = 0.6 * (u - 0.25)  # so that the two straight parts cross instead of coinciding
    line = np.column_stack([x, np.zeros_like(u), z + slope * x])
    alone = line[250:], u[250:] - u[250]
    both = scene.frame([line], u, np.array([])).astype(float)
    empty = scene.frame([line + AWAY], u, np.array([])).astype(float)
    covered = np.abs(both - empty).sum(axis=2) > 60.0
    only = scene.frame([alone[0]], alone[1], np.array([])).astype(float)
    of_later = np.abs(only - empty).sum(axis=2) > 60.0
    assert np.mean(covered[of_later]) > 0.98
    assert covered.sum() > 1.5 * of_later.sum()


def test_same_seed_same_picture():
    camera = replace(CAMERA, noise=2.0)
    u = np.linspace(0.0, 0.3, 301)

    def picture(seed):
        return renderer(camera, Look(), seed).frame([wave(u)], u, np.array([0.0, 0.3]))

    np.testing.assert_array_equal(picture(5), picture(5))
    assert np.mean(picture(5) != picture(6)) > 0.5


def test_noise_has_the_stated_strength_and_changes_from_frame_to_frame():
    scene = renderer(replace(CAMERA, noise=3.0))
    u = np.linspace(0.0, 0.3, 301)
    away = wave(u) + AWAY
    frames = np.array([scene.frame([away], u, np.array([])) for _ in range(2)], dtype=float)
    assert np.std(frames[0] - frames[1]) == pytest.approx(3.0 * np.sqrt(2.0), rel=0.05)


def test_motion_blur_widens_across_the_motion():
    scene = renderer()
    u = np.linspace(0.0, 0.3, 301)
    empty = scene.frame([wave(u) + AWAY], u, np.array([])).astype(float)

    def touched(lines):
        picture = scene.frame(lines, u, np.array([])).astype(float)
        return np.sum(np.abs(picture - empty).sum(axis=2) > 20.0)

    moved = [wave(u) + dz * UP for dz in np.linspace(-0.004, 0.004, 8)]
    assert touched(moved) > 1.3 * touched([wave(u)])


def test_pins_cover_the_rope_where_it_is_held():
    look = replace(PLAIN, pin_diameter=0.8, pin_colour=(250.0, 250.0, 20.0))
    scene = renderer(look=look)
    u = np.linspace(0.0, 0.3, 301)
    picture = scene.frame([wave(u)], u, np.array([0.1])).astype(int)
    c, r = np.rint(scene.geometry.project(wave(np.array([0.1])))[0]).astype(int)
    blue, green, red = picture[r, c]
    assert min(green, red) > 120 > 60 > blue


def test_distortion_that_folds_the_image_is_refused():
    camera = replace(CAMERA, distortion=(-3.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="folds the image"):
        Geometry(camera, POSE).rays()


def level(roll: float) -> CameraPose:
    """A camera straight before the board, rolled about its optical axis [deg]."""
    turned = Rotation.from_euler("xz", [90.0, roll], degrees=True)
    return CameraPose((0.0, 0.0, 0.5), tuple(float(q) for q in turned.as_quat()))


@pytest.mark.parametrize("roll", [90.0, 180.0, 270.0])
def test_a_rolled_camera_takes_the_picture_turned(roll):
    square = SimulatedCamera(301, 301, (400.0, 400.0), (150.0, 150.0), noise=0.0)
    look = replace(PLAIN, unevenness=0.0)
    u = np.linspace(0.0, 0.3, 500)
    upright, rolled = (
        Renderer(Geometry(square, level(angle)), look, DIAMETER, 0)
        .frame([wave(u)], u, np.zeros(0))
        .astype(float)
        for angle in (0.0, roll)
    )
    np.testing.assert_allclose(np.rot90(rolled, round(roll / 90.0)), upright, atol=1.0)


def test_a_pixel_of_a_rolled_camera_is_as_large():
    square = SimulatedCamera(301, 301, (400.0, 400.0), (150.0, 150.0), noise=0.0)
    sizes = [
        Renderer(Geometry(square, level(angle)), PLAIN, DIAMETER, 0)._pixel
        for angle in (0.0, 30.0, 45.0, 90.0)
    ]
    np.testing.assert_allclose(sizes, 0.5 / 400.0, rtol=1e-5)


@pytest.mark.parametrize(("axis", "focal_length"), [(0, 520.0), (2, 400.0)])
def test_a_rope_in_space_is_as_wide_as_the_pixels_are(axis, focal_length):
    """Pixels that are no squares: a level rope is scaled by the focal length of y."""
    camera = SimulatedCamera(301, 301, (400.0, 520.0), (150.0, 150.0), noise=0.0)
    drawn = SpatialRenderer(Geometry(camera, level(0.0)), PLAIN, DIAMETER, 0.1, 0)
    u = np.linspace(0.0, 0.1, 200)
    line = np.zeros((200, 3))
    line[:, axis] = u - 0.05
    layers = drawn.layers(line, u)
    cover = np.zeros(301 * 301)
    cover[layers.pixel] = layers.cover
    middle = cover.reshape(301, 301)[:, 150] if axis == 0 else cover.reshape(301, 301)[150]
    np.testing.assert_allclose(middle.sum(), DIAMETER / 0.5 * focal_length, rtol=1e-3)
