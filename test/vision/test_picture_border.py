# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO whose held end has left the picture: what lies beyond the border is not known."""

import numpy as np
import pytest
from ribbons import even, holding, looking, misplaced, picture, settings_of

from dlo_ros.command import Motion
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.tracing.ridge_snapping import follow

K = np.array([[1000.0, 0.0, 640.0], [0.0, 1000.0, 360.0], [0.0, 0.0, 1.0]])
CAMERA = Camera(
    K, (-0.25, 0.1, 0.001, -0.0005, 0.02), 1280, 720, looking(translation=(0.02, 0.03, 1.1))
)
AT = np.linspace(0.0, 1.0, 400)
BENT, LENGTH = even(np.column_stack([0.6 * AT - 0.3, 0.08 * np.sin(5.0 * AT)]))


@pytest.mark.parametrize("aside", [(0.49, 0.505, 0.51, 0.515), (0.56, 0.56, 0.56), (0.49, 0.56)])
def test_u_is_right_where_the_grip_lies_beside_the_picture(aside):
    motion = Motion()
    observer = Observer(settings_of(LENGTH, 0.006), CAMERA, motion)
    for k, left in enumerate(aside):
        stamp = (k + 1) * 33_000_000
        curve = BENT - [left, 0.0]
        (held,) = holding(curve, ("start",)).commands
        motion.add(held.later(stamp * 1e-9))
        found = observer.observe(stamp, picture(curve, 0.006, CAMERA, seed=k)).observation.points
        away = np.linalg.norm(misplaced(found, curve, LENGTH), axis=1)
        assert np.all(away < 2.0 * np.hypot(found.std, found.std_along))
        assert away.max() < 1.5e-3


def test_a_course_is_not_drawn_along_the_repeated_border():
    """A bar that leaves the picture obliquely: the border's pixels go on at a right angle to it."""
    y, x = np.mgrid[0:200, 0:300]
    bar = np.abs(y - 60.0 - 0.6 * x) * np.cos(np.arctan(0.6)) < 4.0
    image = np.where(bar[..., None], 40, 200).astype(np.uint8) * np.ones(3, np.uint8)
    along = np.arange(-40.0, 120.0, 1.5)
    course = np.column_stack([along, 60.0 + 0.6 * along])
    moved = follow(image, course, 8.0, 16.0)
    assert np.abs(moved - course).max() < 0.5
