# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The camera: projection, its inverse, and intrinsics that cannot be used."""

import cv2
import numpy as np
import pytest

from dlo_ros.errors import InputError
from dlo_ros.parameters import CameraPose, RodParameters, Settings
from dlo_ros.vision import Camera
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.space import SpaceObserver

K = [1400.0, 0.0, 950.0, 0.0, 1410.0, 545.0, 0.0, 0.0, 1.0]
PLUMB_BOB = (-0.28, 0.09, 0.001, -0.0007, -0.01)
RATIONAL = (0.4, -0.1, 0.0005, 0.001, 0.02, 0.6, -0.05, 0.03)
THIN_PRISM = (*RATIONAL, 0.002, -0.001, 0.0015, 0.0007)


def tilted_pose():
    half = 0.25 * np.pi + 0.15
    return CameraPose((0.02, -0.01, 1.1), (np.sin(half), 0.05, 0.02, np.cos(half)))


def camera(distortion=PLUMB_BOB, model="plumb_bob", k=K, pose=None, size=(1920, 1080)):
    return Camera.from_info(k, distortion, model, *size, pose or tilted_pose())


def board_points():
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.3, 0.3, 7))
    return np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])


@pytest.mark.parametrize("distortion", [(-0.35, 0.0, 0.0, 0.0), (-0.4, 0.18, 0.0, 0.0, -0.04)])
def test_what_is_far_outside_of_the_picture_does_not_turn_back_into_it(distortion):
    """The polynomial of a lens grows again only where it has turned back; OpenCV follows it."""
    k = [1150.0, 0.0, 640.0, 0.0, 1150.0, 360.0, 0.0, 0.0, 1.0]
    c = camera(distortion, k=k, pose=CameraPose(), size=(1280, 720))
    away = np.tan(np.radians(np.arange(0.0, 85.0, 1.0)))
    for aside in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [-0.8, 0.0, 0.6]):
        points = np.outer(away, aside) * 1.2
        rotation, _ = cv2.Rodrigues(c.rotation)
        followed, _ = cv2.projectPoints(
            points, rotation, c.translation, c.matrix, np.array(distortion)
        )
        pixels, followed = c.project(points), followed.reshape(-1, 2)
        seen = np.all((pixels >= 0.0) & (pixels <= [1279.0, 719.0]), axis=1)
        assert not np.any(seen[np.argmin(seen) :])  # once outside, never inside again
        np.testing.assert_allclose(pixels[seen], followed[seen], atol=1e-8)
        inside = np.all((followed >= 0.0) & (followed <= [1279.0, 719.0]), axis=1)
        assert np.count_nonzero(inside) > np.count_nonzero(seen)


def test_a_pixel_beyond_the_lens_models_turn_has_no_ray():
    k = [740.0, 0.0, 640.0, 0.0, 740.0, 360.0, 0.0, 0.0, 1.0]
    c = camera((-0.5746, -0.0379, 0.0, 0.0, 0.0341), k=k, size=(1280, 720))
    x, y = np.meshgrid(np.linspace(0.0, 1279.0, 65), np.linspace(0.0, 719.0, 37))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    away = np.hypot(*c.rays(pixels).T)
    order = np.argsort(np.hypot(*(pixels - [640.0, 360.0]).T))
    known = np.isfinite(away[order])
    assert known[: len(known) // 3].all() and not known[np.argmin(known) :].any()
    assert np.nanmax(away) < 0.76


@pytest.mark.parametrize(
    ("distortion", "model"),
    [
        ((), "plumb_bob"),
        (PLUMB_BOB[:4], "plumb_bob"),
        (PLUMB_BOB, "plumb_bob"),
        (RATIONAL, "rational_polynomial"),
        (THIN_PRISM, "rational_polynomial"),
    ],
)
def test_projection_agrees_with_opencv_and_is_undone(distortion, model):
    c = camera(distortion, model)
    points = board_points()
    rotation, _ = cv2.Rodrigues(c.rotation)
    expected, _ = cv2.projectPoints(points, rotation, c.translation, c.matrix, np.array(distortion))
    pixels = c.project(points)
    np.testing.assert_allclose(pixels, expected.reshape(-1, 2), atol=1e-8)
    np.testing.assert_allclose(c.to_board(pixels), points, atol=1e-9)


def test_camera_above_the_board_sees_x_to_the_right_and_z_up():
    c = camera((), pose=CameraPose((0.0, 0.0, 2.0), (2**-0.5, 0.0, 0.0, 2**-0.5)))
    origin, right, up = c.project(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 0.1]]))
    np.testing.assert_allclose(origin, [950.0, 545.0])
    np.testing.assert_allclose(right - origin, [70.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(up - origin, [0.0, -70.5], atol=1e-9)


def test_size_of_a_pixel():
    c = camera((), pose=CameraPose((0.0, 0.0, 2.0), (2**-0.5, 0.0, 0.0, 2**-0.5)))
    expected = 2.0 / np.sqrt(1400.0 * 1410.0)
    np.testing.assert_allclose(c.metres_per_pixel(np.array([[100.0, 900.0]])), expected)


def test_what_lies_behind_the_camera_has_no_pixel():
    assert np.all(np.isnan(camera().project(np.array([[0.0, -5.0, 0.0]]))))


def test_ray_that_misses_the_board_has_no_point():
    level = CameraPose((0.0, 0.3, 1.0), (0.0, 0.0, 0.0, 1.0))  # looks along the board
    points = camera((), pose=level).to_board(np.array([[950.0, 100.0], [950.0, 900.0]]))
    assert np.isnan(points[0]).all()
    assert np.isfinite(points[1]).all()


def test_pixel_beyond_what_the_lens_model_covers_has_no_point():
    strong = camera((-0.6, 0.0, 0.0, 0.0, 0.0))
    assert np.isnan(strong.to_board(np.array([[-3000.0, -3000.0]]))).all()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"k": [0.0] * 9}, "not calibrated"),
        ({"k": [np.nan] * 9}, "NaN"),
        ({"k": [1.0] * 4}, "9 are needed"),
        ({"model": "equidistant", "distortion": (0.1,) * 4}, "known are plumb_bob"),
        ({"distortion": (0.1,) * 8}, "8 distortion coefficients"),
        ({"distortion": (np.nan,) * 5}, "NaN"),
        ({"distortion": (0.1,) * 14, "model": "rational_polynomial"}, "tilted sensor"),
        ({"size": (0, 1080)}, "both must be positive"),
    ],
)
def test_unusable_intrinsics_are_refused(changed, words):
    with pytest.raises(InputError, match=words):
        camera(**changed)


def test_a_camera_in_the_boards_plane_serves_beside_others_but_not_alone():
    """One that looks down along the board sees the DLO from another side than one before it."""
    above = CameraPose((0.0, 0.0, 1.2), (1.0, 0.0, 0.0, 0.0))  # at z = 1.2 m, y of the board up
    settings = Settings(RodParameters(0.5, 0.006, 1e6, 1000.0))
    one = camera((), pose=above)
    np.testing.assert_allclose(one.project(np.zeros((1, 3))), one.matrix[None, :2, 2])
    SpaceObserver(settings, {"before": camera(()), "above": one})
    with pytest.raises(InputError, match="board's plane"):
        Observer(settings, one)
