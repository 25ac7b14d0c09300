# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Views of a curve in space without pictures: what two cameras would measure, and its fit."""

import numpy as np
from scipy.spatial import cKDTree

from dlo_ros.parameters import CameraPose
from dlo_ros.spline import SplineBasis
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.space.matching import coordinates
from dlo_ros.vision.space.reprojection import ClampPose, Prior, fit_views
from dlo_ros.vision.space.view import View

LENGTH, DIAMETER = 0.4, 0.004
FINE = SplineBasis(36, LENGTH)
K = np.array([[1500.0, 0.0, 639.5], [0.0, 1500.0, 359.5], [0.0, 0.0, 1.0]])


def pose(x):
    """A camera at (x, -1.2, 0) that looks along the board's y."""
    return CameraPose((-x, 0.0, 1.2), (2**-0.5, 0.0, 0.0, 2**-0.5))


def camera(x):
    return Camera(K, (), 1280, 720, pose(x))


LEFT, RIGHT = camera(0.0), camera(0.3)


def rope(direction=(1.0, 0.0, 0.0), bulge=0.05):
    """Control points of a curve of the length that bends in space."""
    t = np.linspace(0.0, 1.0, 2001)
    along = np.array(direction) / np.linalg.norm(direction)
    beside = np.array([along[2], 0.0, -along[0]])
    points = np.outer(0.9 * (t - 0.5), along) * LENGTH
    points += np.outer(bulge * np.sin(2 * np.pi * t), beside)
    points[:, 1] += bulge * np.cos(3.0 * t)
    for _ in range(3):  # to the length, parametrised by it
        size = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        points *= LENGTH / size
    points[:, 0] += 0.15
    return FINE.fit(coordinates(points, LENGTH), points)


def view(of, points, rng, std=0.1, low=0.0, high=LENGTH, count=100, dt=0.0, depth=None):
    """A camera's measurement of a curve, with noise across it."""
    u = np.linspace(low, high, count)
    place, ahead = (of.rays(of.project(FINE.evaluate(points, at))) for at in (u, u + 1e-4))
    ahead[-1] = 2 * place[-1] - of.rays(of.project(FINE.evaluate(points, u[-1:] - 1e-4)))[0]
    tangent = ahead - place
    tangent /= np.hypot(*tangent.T)[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    rays = place + (std / 1500.0) * rng.normal(size=(count, 1)) * normal
    start = np.clip(u + 0.004 * np.sin(9 * u / LENGTH), 0.0, LENGTH)
    z = None
    if depth is not None:
        # A ray that meets the axis leaves the surface a radius over the sine of their angle before.
        axis = FINE.evaluate(points, u) @ of.rotation.T + of.translation
        ray = axis / np.linalg.norm(axis, axis=1)[:, None]
        slope = FINE.evaluate(points, u, 1) @ of.rotation.T
        sine = np.linalg.norm(np.cross(ray, slope), axis=1) / np.linalg.norm(slope, axis=1)
        z = axis[:, 2] - 0.5 * DIAMETER * ray[:, 2] / sine
        z = z + depth * rng.normal(size=count)
    return View(of, of.project(np.zeros((count, 3))), rays, tangent, start, 5.0, dt, depth=z)


def away(fit, points):
    """Distances of the fitted curve from the true one at 34 places [m], and their stated std."""
    u = np.linspace(0.0, LENGTH, 34)
    truth = FINE.evaluate(points, np.linspace(0.0, LENGTH, 4001))
    found = FINE.evaluate(fit.points, u)
    covariance, tangent = fit.covariance_at(u), fit.tangents(u)
    along = np.einsum("ma,mab,mb->m", tangent, covariance, tangent)
    across = np.trace(covariance, axis1=1, axis2=2) - along
    return cKDTree(truth).query(found)[0], np.sqrt(0.5 * across)


def clamps(points):
    """Clamps that hold both ends of a curve."""
    d = FINE.evaluate(points, [0.0, LENGTH], 1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return ClampPose(points[0], d[0]), ClampPose(points[-1], d[1])


def fitted(views, points, **known):
    """The fit of views, begun some millimetres beside the curve."""
    start = points + np.column_stack([0.003 * np.sin(np.arange(36.0)), np.full(36, 0.01),
                                      np.zeros(36)])  # fmt: skip
    return fit_views(views, FINE, start, Prior(DIAMETER, clamps(points), **known))
