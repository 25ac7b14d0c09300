# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of calibration patterns by ray casting; nothing of the package is used to make them."""

from functools import lru_cache

import cv2
import numpy as np

TEXELS = 24  # of a square's side
SAMPLES = 2  # of a pixel's side
WHITE, BLACK, GROUND = 215, 30, 120

SIZE = (800, 600)
MATRIX = np.array([[702.0, 0.0, 407.0], [0.0, 699.0, 293.0], [0.0, 0.0, 1.0]])
DISTORTION = (-0.28, 0.1, 0.0009, -0.0007, 0.0)


def distort(x, y, coefficients):
    """Brown's model with OpenCV's rational radial part, written out."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (list(coefficients) + [0.0] * 8)[:8]
    r2 = x * x + y * y
    top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    radial = top / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


def pixels_of(points, rotation, translation, matrix=MATRIX, coefficients=DISTORTION):
    """Where points of the pattern's frame are in the picture, shape (n, 2)."""
    p = points @ rotation.T + translation
    x, y = distort(p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], coefficients)
    return np.column_stack([x, y]) @ matrix[:2, :2].T + matrix[:2, 2]


class Lens:
    """The rays of all (sub-)pixels of a camera."""

    def __init__(self, matrix=MATRIX, coefficients=DISTORTION, size=SIZE):
        self.matrix, self.coefficients, self.size = matrix, coefficients, size
        offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        u = (np.arange(size[0])[:, None] + offsets).ravel()
        v = (np.arange(size[1])[:, None] + offsets).ravel()
        xd, yd = np.meshgrid((u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1])
        self.x, self.y = xd.copy(), yd.copy()
        for _ in range(40):  # fixed point; the lenses of the tests are mild enough
            a, b = distort(self.x, self.y, coefficients)
            a -= xd
            b -= yd
            self.x -= a
            self.y -= b
            apart = max(np.abs(a).max(), np.abs(b).max())
            if apart < 1e-8:
                break
        assert apart < 1e-7

    def picture(self, texture, texel, rotation, translation, rng, blur=0.7, noise=2.0):
        """The pattern's bitmap, its centre in the pattern's origin, as this camera sees it."""
        normal = rotation[:, 2]
        depth = (normal @ translation) / (normal[0] * self.x + normal[1] * self.y + normal[2])
        offset = [self.x * depth - translation[0], self.y * depth - translation[1]]
        offset.append(depth - translation[2])
        height, width = texture.shape
        across = sum(c * o for c, o in zip(rotation[:, 0], offset, strict=True))
        down = sum(c * o for c, o in zip(rotation[:, 1], offset, strict=True))
        column = (across / texel + 0.5 * (width - 1)).astype(np.float32)
        row = (down / texel + 0.5 * (height - 1)).astype(np.float32)
        border = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": GROUND}
        fine = cv2.remap(texture.astype(np.float32), column, row, cv2.INTER_LINEAR, **border)
        shape = (self.size[1], SAMPLES, self.size[0], SAMPLES)
        seen = cv2.GaussianBlur(fine.reshape(shape).mean(axis=(1, 3)), (0, 0), blur)
        seen = seen + rng.normal(0.0, noise, seen.shape)
        return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


@lru_cache
def usual_lens():
    return Lens()


def chessboard(columns, rows):
    """Bitmap of a chessboard with so many inner corners and a white margin."""
    j, i = np.mgrid[: rows + 1, : columns + 1]
    squares = np.where((i + j) % 2 == 0, BLACK, WHITE).astype(np.uint8)
    return np.pad(
        np.kron(squares, np.ones((TEXELS, TEXELS), np.uint8)), TEXELS, constant_values=WHITE
    )


def charuco(columns, rows, ratio, name, old=False):
    """Bitmap of a ChArUco board with so many inner corners, drawn by OpenCV."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    board = cv2.aruco.CharucoBoard((columns + 1, rows + 1), 1.0, ratio, book)
    board.setLegacyPattern(old)
    texels = 2 * TEXELS
    size = ((columns + 1) * texels, (rows + 1) * texels)
    bitmap = board.generateImage(size, marginSize=0, borderBits=1)
    bitmap = np.where(bitmap > 127, WHITE, BLACK).astype(np.uint8)
    return np.pad(bitmap, texels // 2, constant_values=WHITE)


def turned(about_x, about_y, in_plane):
    """Rotation matrix from angles [rad]."""
    tilt = cv2.Rodrigues(np.array([about_x, about_y, 0.0]))[0]
    return cv2.Rodrigues(np.array([0.0, 0.0, in_plane]))[0] @ tilt


def poses(count, points, rng, lens=None, margin=14, distance=(0.25, 0.6)):
    """Poses in which all points are in the picture, tilted, near and far."""
    lens = usual_lens() if lens is None else lens
    width, height = lens.size
    found = []
    while len(found) < count:
        rotation = turned(*rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.5, 0.5))
        z = rng.uniform(*distance)
        reach = 0.5 * z * np.array([width, height]) / lens.matrix[0, 0]
        translation = np.array([*rng.uniform(-reach, reach), z])
        p = pixels_of(points, rotation, translation, lens.matrix, lens.coefficients)
        if np.all((p > margin) & (p < np.array([width, height]) - margin)):
            found.append((rotation, translation))
    return found
