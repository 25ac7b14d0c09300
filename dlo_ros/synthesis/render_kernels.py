# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled kernel of the renderer: which point of the rope a pixel looks at."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray

Float32Array = NDArray[np.float32]


def _trace(
    line: FloatArray,
    pixels: FloatArray,
    u: FloatArray,
    eye: FloatArray,
    plane: Float32Array,
    corner: NDArray[np.int64],
    reach: float,
    margin: float,
    radius: float,
    across: Float32Array,
    along: Float32Array,
    segment: NDArray[np.int32],
) -> None:
    """Nearest point of the rope's axis for each pixel around it; strands of larger u lie on top.

    Args:
        line: x and z of the axis [m], shape (m, 2), closely spaced.
        pixels: the same points in the image [px], shape (m, 2).
        u: material coordinates of the axis points [m], shape (m,).
        eye: camera's centre in the board frame [m], shape (3,).
        plane: x and z of the board's plane y = 0 at each pixel of the region [m], (H, W, 2).
        corner: column and row of the region's first pixel.
        reach: distance from the axis within which pixels are wanted [m].
        margin: the same in the image [px].
        radius: radius of the rope [m].
        across: output, signed distance of the pixel's ray from the axis [m], (H, W); not written
            where no axis is near, so it must be filled with a large value before.
        along: output, material coordinate u [m]; it continues beyond 0 and L past the ends, (H, W).
        segment: output, index of the piece of the axis, (H, W).
    """
    height, width = across.shape
    last = line.shape[0] - 2
    for i in range(last + 1):
        tx, tz = line[i + 1, 0] - line[i, 0], line[i + 1, 1] - line[i, 1]
        size = math.sqrt(tx * tx + tz * tz)
        if size == 0.0:
            continue
        tx, tz = tx / size, tz / size
        c0 = max(int(min(pixels[i, 0], pixels[i + 1, 0]) - margin) - corner[0], 0)
        c1 = min(int(max(pixels[i, 0], pixels[i + 1, 0]) + margin) + 2 - corner[0], width)
        r0 = max(int(min(pixels[i, 1], pixels[i + 1, 1]) - margin) - corner[1], 0)
        r1 = min(int(max(pixels[i, 1], pixels[i + 1, 1]) + margin) + 2 - corner[1], height)
        stretch = (u[i + 1] - u[i]) / size
        for r in range(r0, r1):
            for c in range(c0, c1):
                px, pz = plane[r, c, 0] - line[i, 0], plane[r, c, 1] - line[i, 1]
                s = px * tx + pz * tz
                # Within the piece, or a little beside it where the axis bends outwards.
                if s < -0.5 * size and i > 0:
                    continue
                if s > 1.5 * size and i < last:
                    continue
                d = pz * tx - px * tz
                if abs(d) > reach or s < -reach or s > size + reach:
                    continue
                # The silhouette of a round rope is where the ray is a radius away from its axis.
                side = (plane[r, c, 1] - eye[2]) * tx - (plane[r, c, 0] - eye[0]) * tz
                d *= abs(eye[1]) / math.sqrt(eye[1] * eye[1] + side * side)
                here = u[i] + s * stretch
                old = across[r, c]
                other_strand = abs(here - along[r, c]) > 6.0 * radius
                on_top = abs(d) < 1.3 * radius and other_strand
                covered = abs(old) < 1.3 * radius and other_strand
                if on_top or (abs(d) < abs(old) and not covered):
                    across[r, c] = d
                    along[r, c] = here
                    segment[r, c] = i


trace = njit()(_trace)
