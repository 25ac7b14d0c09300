# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A camera that looks at the board from the side: a pixel is not the same length everywhere."""

import numpy as np
import pytest
from ribbons import even, holding, looking, misplaced, picture, settings_of

from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_observer import Observer

K = np.array([[1000.0, 0.0, 640.0], [0.0, 1000.0, 360.0], [0.0, 0.0, 1.0]])
DISTORTION = (-0.25, 0.1, 0.001, -0.0005, 0.02)
AT = np.linspace(0.0, 1.0, 400)
BENT, LENGTH = even(np.column_stack([0.6 * AT - 0.3, 0.08 * np.sin(5.0 * AT)]))


@pytest.mark.parametrize("diameter", [0.006, 0.012])
@pytest.mark.parametrize(("yaw", "pitch"), [(20.0, 0.0), (-35.0, 0.0), (35.0, 20.0)])
def test_the_dlo_begins_in_its_grip(yaw, pitch, diameter):
    camera = Camera(K, DISTORTION, 1280, 720, looking(10.0, yaw, pitch))
    observer = Observer(settings_of(LENGTH, diameter), camera, holding(BENT, ("start", "end")))
    found = observer.observe(1, picture(BENT, diameter, camera)).observation
    away = misplaced(found.points, BENT, LENGTH)
    assert np.sqrt(np.mean(np.sum(away**2, axis=1))) < 0.2e-3
    ends = found.control_points[[0, -1]][:, [0, 2]] - BENT[[0, -1]]
    assert np.linalg.norm(ends, axis=1).max() < 0.5e-3


@pytest.mark.parametrize("yaw", [-35.0, 35.0])
def test_a_free_end_does_not_move_the_held_one(yaw):
    camera = Camera(K, (0.0,) * 5, 1280, 720, looking(0.0, yaw))
    observer = Observer(settings_of(LENGTH, 0.012), camera, holding(BENT, ("start",)))
    found = observer.observe(1, picture(BENT, 0.012, camera)).observation.points
    away = np.linalg.norm(misplaced(found, BENT, LENGTH), axis=1)
    assert away[:5].max() < 0.3e-3
    assert np.all(away < 3.0 * np.hypot(found.std, found.std_along))
