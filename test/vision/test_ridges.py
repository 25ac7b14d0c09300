# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The compiled search for bars and their ridges, against plain sums over every pixel."""

import math

import cv2
import numpy as np
import pytest

from dlo_ros.vision.segmentation.ridge_filter import ALIKE, bars
from dlo_ros.vision.segmentation.ridge_map import FLANK, ORIENTATIONS, map_ridges
from dlo_ros.vision.tracing.ridge_points import without_specks
from dlo_ros.vision.tracing.ridge_tracing import find_chains

WIDTH = 4.6


def expected_bar(picture, y, x, across, threshold):
    """Strength and orientation at a pixel by their definition, one orientation after the other."""

    def away(way):
        rows = np.clip(y + way[0], 0, picture.shape[0] - 1)
        columns = np.clip(x + way[1], 0, picture.shape[1] - 1)
        return picture[rows, columns] - picture[y, x]

    best, which = threshold, 0
    sides = [(away(way), away(-way)) for way in across]
    for k, (left, right) in enumerate(sides):
        ahead, behind = sides[(k + ORIENTATIONS // 2) % ORIENTATIONS]
        contrast = min(np.linalg.norm(left), np.linalg.norm(right))
        value = contrast - 0.5 * (np.linalg.norm(ahead) + np.linalg.norm(behind))
        product = left @ right
        edge = product < 0.0 and product**2 > 0.25 * (left @ left) * (right @ right)
        if contrast >= threshold and value > max(best, ALIKE * contrast) and not edge:
            best, which = value, k
    return (best, which) if best > threshold else (0.0, which)


@pytest.fixture
def noisy():
    """A dark bar on a light board, out of the picture at both ends, under coarse noise."""
    rng = np.random.default_rng(4)
    picture = np.full((44, 110, 3), 190, dtype=np.uint8)
    cv2.line(picture, (0, 10), (109, 34), (60, 90, 40), round(WIDTH), cv2.LINE_AA)
    noise = cv2.GaussianBlur(rng.normal(0.0, 25.0, picture.shape), (0, 0), 1.0)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def test_each_pixel_has_the_bar_of_its_definition(noisy):
    searched = np.ones(noisy.shape[:2], dtype=np.uint8)
    searched[:, 30:65] = 0  # more than a block of columns, and its borders within blocks
    searched[::7, 90:] = 0
    angles = np.arange(ORIENTATIONS) * math.pi / ORIENTATIONS
    across = np.column_stack([np.cos(angles), -np.sin(angles)])
    across = np.rint(FLANK * WIDTH * across).astype(np.int64)
    pad = 2 * int(np.abs(across).max())
    planes = [
        cv2.copyMakeBorder(c, pad, pad, pad, pad, cv2.BORDER_REPLICATE) for c in cv2.split(noisy)
    ]
    strength, orientation = bars(
        np.stack(planes, dtype=np.float32), pad, searched, across, 8.0, False
    )
    assert not strength[searched == 0].any()
    found = 0
    for y in range(noisy.shape[0]):
        for x in np.flatnonzero(searched[y]):
            value, which = expected_bar(noisy.astype(float), y, x, across, 8.0)
            assert strength[y, x] == pytest.approx(value, abs=1e-4)
            if value > 0.0:
                assert orientation[y, x] == which
                found += 1
    assert 100 < found < 0.5 * searched.sum()


def test_points_that_cannot_make_a_chain_are_left_out():
    #              a row of four, two apart          a pair         one by itself
    points = np.array([[2, 3], [2, 5], [3, 7], [5, 8], [9, 20], [11, 22], [11, 40]])
    order = np.lexsort((points[:, 1], points[:, 0]))
    rows, columns = points[order].T.copy()
    kept = [without_specks(rows, columns, (14, 50), least) for least in (1, 2, 4, 5)]
    assert [list(k) for k in kept] == [list(range(7)), list(range(6)), list(range(4)), []]


def test_a_bar_under_noise_is_one_chain_and_noise_alone_is_none(noisy):
    chains = find_chains(map_ridges(noisy, WIDTH))
    longest = max(chains, key=lambda chain: chain.length)
    x, y = longest.points.T
    assert longest.length > 100.0
    assert np.abs(y - (10.0 + 24.0 / 109.0 * x)).max() < 1.5
    plain = np.random.default_rng(5).integers(150, 170, noisy.shape).astype(np.uint8)
    assert find_chains(map_ridges(plain, WIDTH)) == []
