# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From located pixels to the observed spline of fixed length in the board's plane y = 0.

The measured middle is joined by a smooth curve that is finer than the published spline. Its arc
length gives every point its material coordinate: the whole DLO lies between the two ends, so u is
the share of the arc length times L, and how far the seen length is from L is reported. The
published control points are then a least-squares fit at known u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.spline_table import basis_functions
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.fit.hidden_gaps import even_parameters, hidden_gaps, trusted
from dlo_ros.vision.fit.material_coordinates import GAP_STD, Ends, std_along
from dlo_ros.vision.fit.smoothing_spline import Support, smooth
from dlo_ros.vision.segmentation.edge_profile import SAMPLING_STD, Located
from dlo_ros.vision.segmentation.medians import median
from dlo_ros.vision.segmentation.picture_strip import Mask

KNOT_SPAN = 3.0  # [widths] of the fine curve
CLAMP_STD = 0.25  # [widths] how well a clamp's position is trusted against the picture
CLAMP_DIRECTION_STD = 0.05  # [rad]
MOST_BESIDE = 3.0  # [px] root mean square, beyond which the published spline rather slides along
LEFT_ASIDE = 0.2  # [widths] between a profile's middle and the fine curve: that is no measurement
ALONG_WEIGHT = 0.01  # of deviations along the DLO in the published spline, against 1 across it
UNSEEN_WEIGHT = 0.05  # of bridged parts in the published spline, against 1
SCALE_STD = 0.01  # relative error of lengths by camera, pose and L
FEWEST_POINTS = 7  # of the centreline: over so many the scatter is judged
MOST_POINTS = 250  # published points of the centreline


@dataclass(frozen=True, eq=False)
class ClampBoard:
    """A clamp in the board's plane: (x, z) [m] and the unit direction of growing u, shapes (2,)."""

    position: FloatArray
    direction: FloatArray | None


@dataclass(frozen=True, eq=False)
class SplineFit:
    """A fitted DLO.

    Args:
        observation: control points and measured points.
        residual: root mean square distance of the measured points across the spline [m].
        residual_px: the same [px].
        curve: fine curve (x, z) [m], equally spaced in u, shape (m, 2).
        curve_seen: whether it was seen there, shape (m,).
        seen_length: length of the fine curve from end to end [m]; it would be L if the camera, L
            and the ends were exact.
        fraction_seen: share of that length where an edge of the DLO was seen.
        width: width of the DLO as it was seen [m].
        visible_length: length between the outermost places that look like the DLO, or its clamps
            [m].
    """

    observation: Observation
    residual: float
    residual_px: float
    curve: FloatArray
    curve_seen: Mask
    seen_length: float
    fraction_seen: float
    width: float
    visible_length: float


def fit_spline(
    located: Located,
    camera: Camera,
    basis: SplineBasis,
    stamp: int,
    start: ClampBoard | None = None,
    end: ClampBoard | None = None,
    found: Ends | None = None,
) -> SplineFit:
    """Fit the published spline.

    Args:
        located: the DLO's middle along a curve that runs from its start to its end.
        camera: camera of the picture.
        basis: basis of the published spline; its length is L.
        stamp: stamp of the image [ns].
        start, end: clamps where they are known.
        found: positions of the DLO's start and end on the curve; default: the whole curve, both
            held.

    Raises:
        VisionError: too little was seen, or it lies beyond the board's horizon.
    """
    count = len(located.curve)
    low, high = (0.0, float(count - 1)) if found is None else found.places
    index = np.arange(count, dtype=np.float64)
    seen = located.seen & (index >= low) & (index <= high)
    if np.count_nonzero(seen) < 12:
        raise VisionError("hardly anything of the DLO is visible")
    p, per_width = index[seen], located.width / located.spacing
    gaps = hidden_gaps(np.flatnonzero(seen), located.trust, per_width)
    trust = trusted(located.trust, gaps, per_width)
    used = (trust > 0.0) & (index >= low) & (index <= high)  # what was seen, and more
    pixels = located.points
    all_plane = camera.to_board(pixels[used])[:, [0, 2]]
    pixels, plane = pixels[seen], all_plane[seen[used]]
    if not np.all(np.isfinite(plane)):
        raise VisionError(
            "the DLO would lie beyond the horizon of the board; check camera.rotation"
        )
    scale = float(np.median(camera.metres_per_pixel(pixels[:: max(1, len(pixels) // 50)])))
    width = located.width * scale  # [m]
    keep = np.all(np.isfinite(all_plane), axis=1)
    at_profile = even_parameters(p, plane, gaps, per_width)
    first, last = at_profile(np.array([low, high]))
    fine, _ = smooth(
        at_profile(index[used][keep]),
        all_plane[keep],
        KNOT_SPAN * per_width,
        (first, last),
        _supports(start, end, (first, last), located, camera, scale),
        trust[used][keep],
    )

    def curve(profiles: FloatArray, derivative: int = 0) -> FloatArray:
        return fine(at_profile(profiles), derivative)

    grid = np.linspace(low, high, max(200, 2 * count))
    dense = curve(grid)
    grid_seen = located.seen[np.clip(np.rint(grid).astype(int), 0, count - 1)]
    grid_seen &= (grid >= -0.5) & (grid <= count - 0.5)  # a hidden end may lie beyond the curve
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dense, axis=0).T))])
    total = float(s[-1])
    dense_u = _material(s, grid_seen, basis.length, width)
    u = np.interp(p, grid, dense_u)
    across = np.sum((plane - curve(p)) * _normals(curve(p, 1)), axis=1)
    points = _points_with_std(p, u, curve, across, located, scale)
    visible = total
    if found is not None and np.isfinite(found.visible):
        visible = found.visible
        hidden = _doubtful(s, grid_seen, width)[1].sum()
        along = std_along(points.u, basis.length, found.covariance, float(hidden))
        # A single place is known no better along the DLO than across it.
        points = replace(points, std_along=np.hypot(along, points.std))

    weights = np.where(grid_seen, 1.0, UNSEEN_WEIGHT)
    weights[[0, -1]] = 0.05 * len(grid)
    b = basis_functions(basis, dense_u)
    flat = basis.least_squares(b, dense, weights)
    normals = _normals(curve(grid, 1))
    beside = np.sum((dense - b @ flat) * normals, axis=1)
    if np.sqrt(np.mean(beside**2)) > MOST_BESIDE * scale:
        flat = _fit_across(b, dense, normals, weights)
        beside = np.sum((dense - b @ flat) * normals, axis=1)
    control_points = np.zeros((basis.control_points, 4))
    control_points[:, 0], control_points[:, 2] = flat[:, 0], flat[:, 1]

    misfit = across + np.interp(p, grid, beside)
    residual = float(np.sqrt(np.mean(misfit**2)))
    at = np.linspace(0.0, total, len(grid))
    even = np.column_stack([np.interp(at, s, dense[:, 0]), np.interp(at, s, dense[:, 1])])
    even_seen = np.interp(at, s, grid_seen.astype(float)) > 0.5
    return SplineFit(
        Observation(stamp, control_points, points),
        residual,
        residual / scale,
        even,
        even_seen,
        total,
        float(np.mean(even_seen)),
        width,
        visible,
    )


def _material(s: FloatArray, seen: Mask, length: float, width: float) -> FloatArray:
    """Material coordinates of points of a curve from its start to its end.

    The curve's length differs from L by an error of the scale (of camera, pose or L), which is the
    same all along, and by wrong bridges over gaps. The difference is divided between the two as
    their variances are.

    Args:
        s: arc length of the points [m], from 0, shape (m,).
        seen: whether the DLO was seen there, shape (m,).
        length: L [m].
        width: width of the DLO [m]; gaps that are not much longer are bridged well.

    Returns:
        u [m], from 0 to L, shape (m,).
    """
    step = np.diff(s)
    edges, doubtful = _doubtful(s, seen, width)
    gap_variance = float(np.sum((GAP_STD * doubtful) ** 2))
    scale_variance = (SCALE_STD * float(s[-1])) ** 2
    missing = length - float(s[-1])
    in_gaps = missing * gap_variance / (gap_variance + scale_variance)
    u = step * (1.0 + (missing - in_gaps) / float(s[-1]))
    if in_gaps:
        for (a, b), share in zip(edges, doubtful**2, strict=True):
            inside = step[a:b].sum()
            if inside > 0.0:
                added = in_gaps * share / float(np.sum(doubtful**2))
                u[a:b] *= max(1.0 + added / inside, 0.2)
    u = np.concatenate([[0.0], np.cumsum(u)])
    return np.asarray(u * (length / u[-1]))


def _doubtful(s: FloatArray, seen: Mask, width: float) -> tuple[NDArray[np.int64], FloatArray]:
    """First and last step of each gap, shape (k, 2), and by how much it exceeds two widths [m]."""
    hidden = ~(seen[1:] & seen[:-1])
    changes = np.flatnonzero(np.diff(np.concatenate([[0], hidden.astype(np.int8), [0]])))
    edges = changes.reshape(-1, 2)
    return edges, np.maximum(s[edges[:, 1]] - s[edges[:, 0]] - 2.0 * width, 0.0)


def _normals(tangent: FloatArray) -> FloatArray:
    norm = np.maximum(np.hypot(tangent[:, 0], tangent[:, 1]), 1e-300)
    return np.column_stack([-tangent[:, 1] / norm, tangent[:, 0] / norm])


def _supports(
    start: ClampBoard | None,
    end: ClampBoard | None,
    domain: tuple[float, float],
    located: Located,
    camera: Camera,
    scale: float,
) -> tuple[Support, ...]:
    """Clamps as weak observations: where the DLO is seen the picture prevails."""
    result = []
    noise = 0.15  # [px] of one profile; only the ratio of the weights matters
    for clamp, at in zip((start, end), domain, strict=True):
        if clamp is None:
            continue
        value_weight = (noise / (CLAMP_STD * located.width)) ** 2
        slope, slope_weight = None, 0.0
        along = _metres_per_pixel_along(clamp, camera, scale)
        if clamp.direction is not None and np.isfinite(along):
            slope = clamp.direction * located.spacing * along
            slope_weight = (noise / (CLAMP_DIRECTION_STD * located.spacing)) ** 2
        result.append(Support(at, clamp.position, value_weight, slope, slope_weight))
    return tuple(result)


def _metres_per_pixel_along(clamp: ClampBoard, camera: Camera, scale: float) -> float:
    """Length of a DLO that leaves a clamp in its direction, for each pixel of its way [m].

    Where the camera looks obliquely that is another one than a pixel's size, and than elsewhere.

    Args:
        clamp: the clamp.
        camera: camera of the picture.
        scale: about the size of a pixel [m].

    Returns:
        NaN where the camera does not see the clamp, or its direction is not known.
    """
    if clamp.direction is None:
        return float("nan")
    ends = clamp.position + np.outer([-scale, scale], clamp.direction)
    first, last = camera.project(_in_space(ends))
    return float(2.0 * scale / np.hypot(*(last - first)))


def _in_space(plane: FloatArray) -> FloatArray:
    """Points of the board's plane in the board frame [m], shape (m, 2) to (m, 3)."""
    return np.column_stack([plane[:, 0], np.zeros(len(plane)), plane[:, 1]])


def _fit_across(
    b: FloatArray, points: FloatArray, normals: FloatArray, weights: FloatArray
) -> FloatArray:
    """Control points (n, 2) of the spline that lies on a curve, or least beside it.

    The image shows where the DLO is across itself to a fraction of a pixel; along itself only its
    arc length does. So where n control points cannot follow the curve they rather slide along it.
    """
    along = np.column_stack([-normals[:, 1], normals[:, 0]])
    normal = np.zeros((2 * b.shape[1], 2 * b.shape[1]))
    right = np.zeros(2 * b.shape[1])
    slack = np.full(len(b), ALONG_WEIGHT)
    slack[[0, -1]] = 1.0  # the ends are points of the picture
    for direction, share in ((normals, np.ones(len(b))), (along, slack)):
        rows = np.hstack([b * direction[:, [0]], b * direction[:, [1]]])
        weighted = (share * weights)[:, None] * rows
        normal += weighted.T @ rows
        right += weighted.T @ np.sum(points * direction, axis=1)
    return np.asarray(np.linalg.solve(normal, right).reshape(2, -1).T)


def _points_with_std(
    p: FloatArray,
    u: FloatArray,
    curve: Callable[..., FloatArray],
    across: FloatArray,
    located: Located,
    scale: float,
) -> CentrelinePoints:
    """Means over blocks of profiles, with the standard deviation that their scatter shows.

    What all profiles of a place have in common no scatter shows: a DLO whose speed changes during
    the exposure is seen beside where it is at the middle of it, by a share of the path that its
    edges show.

    Neighbouring profiles share pixels, so their errors are correlated: the scatter of block means
    is measured instead of being derived from that of single profiles.
    """
    # A point that the robust curve has left aside lies on something else beside the DLO.
    kept = np.abs(across) <= LEFT_ASIDE * located.width * scale
    if np.count_nonzero(kept) >= 2:
        p, u, across = p[kept], u[kept], across[kept]
    shared = np.interp(p, np.arange(len(located.curve)), located.shared_std)
    length = p[-1] - p[0]
    size = max(1.0, located.width / located.spacing, length / MOST_POINTS)
    block = np.floor((p - p[0]) / size).astype(np.int64)
    number = np.bincount(block)
    enough = number >= max(1.0, 0.5 * size)
    if np.count_nonzero(enough) < FEWEST_POINTS:
        raise VisionError("hardly anything of the DLO is visible")

    def mean(values: FloatArray) -> FloatArray:
        total = np.bincount(block, values)
        return np.asarray(total[enough] / number[enough])

    offset = mean(across)
    # The fine curve follows part of the scatter: one coefficient for KNOT_SPAN widths.
    freedom = max(0.3, 1.0 - size / max(size, KNOT_SPAN * located.width / located.spacing))
    usual = 1.4826 * median(np.abs(offset)) / np.sqrt(freedom)
    local = np.sqrt(np.convolve(np.minimum(np.abs(offset), 6 * usual) ** 2, np.ones(7), "same") / 7)
    std = np.sqrt(
        np.maximum(usual, 0.7 * local / np.sqrt(freedom)) ** 2
        + (SAMPLING_STD * scale) ** 2
        + (scale * mean(shared)) ** 2
    )
    at = mean(p)  # not the mean of the positions, which lies inside a bend
    xz = curve(at) + offset[:, None] * _normals(curve(at, 1))
    positions = np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]])
    return CentrelinePoints(positions, mean(u), std)
