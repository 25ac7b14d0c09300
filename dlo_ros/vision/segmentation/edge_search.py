# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The two edges of a DLO in the profiles across it, and the middle between them.

Each edge is the steepest change towards the DLO's colour near an expected place.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import Float32, Mask

FADE = 0.3  # share of the window of an edge over which it fades out
LENS_STD = 0.5  # [px] of a lens's point spread: hardly any camera's picture is sharper


def slope_towards(
    strip: Float32, offsets: FloatArray, change: Float32
) -> tuple[FloatArray, FloatArray]:
    """Slope of the picture across the DLO towards a colour.

    Args:
        strip: colours, shape (m, k, 3).
        offsets: offsets of the samples [px], shape (k,).
        change: change of the colour at an edge, in the direction of growing offsets, shape (m, 3).

    Returns:
        Slope [grey levels/px], 0 where it falls, shape (m, k), and the whole change [grey levels],
        shape (m,).
    """
    climb = np.linalg.norm(change, axis=1)
    unit = change / np.maximum(climb, 1e-6)[:, None]
    profile = np.einsum("ikc,ic->ik", strip, unit)
    return np.maximum(np.gradient(profile, offsets, axis=1), 0.0), climb


def climbing_length(
    slope: FloatArray, offsets: FloatArray, climb: FloatArray, expected: FloatArray, window: float
) -> FloatArray:
    """Length over which an edge near an expected offset climbs by the whole change [px].

    Args:
        slope, climb: see `slope_towards`.
        offsets: offsets of the samples [px], shape (k,).
        expected: offset of the edge [px], shape (m,).
        window: distance from there within which the edge is looked for [px].

    Returns:
        Shape (m,).
    """
    distance = np.abs(offsets[None, :] - expected[:, None])
    peak = (slope * _taper(distance, np.array(window))).max(axis=1)
    return np.asarray(climb / np.maximum(peak, 1e-6))


def steepest_change(
    slope: FloatArray,
    offsets: FloatArray,
    climb: FloatArray,
    expected: FloatArray,
    window: FloatArray,
    width: float,
) -> tuple[FloatArray, Mask]:
    """Position of the steepest change towards the DLO's colour near an expected offset.

    The centroid of the squared slope is taken: it depends on neither level, so that a rope that is
    brighter on one side is not shifted.

    Args:
        slope, climb: see `slope_towards`.
        offsets: offsets of the samples [px], shape (k,).
        expected: offset of the edge [px], shape (m,).
        window: distance from there within which the edge is looked for [px], shape (m,).
        width: width of the DLO [px].

    Returns:
        Offset of the edge [px], shape (m,), and whether there is one.
    """
    distance = np.abs(offsets[None, :] - expected[:, None])
    slope = slope * _taper(distance, window[:, None])
    peak = slope.max(axis=1, keepdims=True)
    weight = np.maximum(slope - 0.25 * peak, 0.0) ** 2
    total = weight.sum(axis=1)
    good = total > 1e-9
    position = np.where(good, (weight * offsets).sum(axis=1) / np.where(good, total, 1.0), expected)
    # An edge climbs at least a quarter of the contrast within a third of the width.
    good &= peak[:, 0] > 0.25 * climb / max(0.33 * width, 2.0)
    return position, np.asarray(good, dtype=np.bool_)


def _taper(distance: FloatArray, window: FloatArray) -> FloatArray:
    """Weights of samples at distances from a window's middle.

    A window that fades out does not jump when a sample enters or leaves it.
    """
    return np.asarray(np.clip((window - distance) / (FADE * window), 0.0, 1.0))


def middle_of(
    left: FloatArray, has_left: Mask, right: FloatArray, has_right: Mask, half: float
) -> tuple[FloatArray, Mask]:
    """The middle from both edges, or from one and the width.

    Args:
        left, right: offsets of the edges [px], shape (m,).
        has_left, has_right: whether they were found, shape (m,).
        half: half the width of the DLO [px].

    Returns:
        Offset of the middle [px], shape (m,), and whether it was found.
    """
    both = has_left & has_right
    fits = np.abs(right - left - 2 * half) < 0.3 * half + 0.7
    middle = np.where(both, 0.5 * (left + right), np.where(has_left, left + half, right - half))
    seen = (both & fits) | (has_left ^ has_right)
    return np.where(seen, middle, 0.0), np.asarray(seen, dtype=np.bool_)


def blur_length(ramp: FloatArray, step: float) -> FloatArray:
    """Length over which light was smeared [px], shape (m,), by that over which edges climb.

    A Gaussian edge of standard deviation sigma has its contrast over its slope equal to
    sigma sqrt(2 pi). Pixels, their interpolation and the difference of samples that lie a step
    apart on either side have variances of 1/12, 1/6 and step^2 / 3, which are no blur, and a lens
    in focus has `LENS_STD`.
    """
    sharp = 2.0 * np.pi * (1.0 / 12.0 + 1.0 / 6.0 + step**2 / 3.0 + LENS_STD**2)
    return np.asarray(np.sqrt(np.maximum(ramp**2 - sharp, 0.0)))
