# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The compiled search for bars: see `ridge_map`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked

Planes = NDArray[np.uint8]
Float32 = NDArray[np.float32]

SHORT_GAP = 24  # [px] columns between searched ones that are searched with them
CHANGED = 0.4  # share of the contrast that a change of colour along a bar takes away
ALIKE = 0.3  # share of the contrast that must be left after the change along: a spot has none
OPPOSITE = 0.5  # cosine between the differences to both sides, beyond which it is an edge


@njit()
def second_differences(image: NDArray[np.uint8], step: int) -> Float32:
    """Lengths of second differences along every third column of an image [grey levels].

    Args:
        image: shape (h, w, 3).
        step: distance of the pixels that are compared [px].

    Returns:
        Shape (h, m).
    """
    height, width, channels = image.shape
    result = np.empty((height, (max(width - 2 * step, 0) + 2) // 3), dtype=np.float32)
    for y in range(height):
        for i in range(result.shape[1]):
            square = 0
            for c in range(channels):
                middle = 2 * int(image[y, 3 * i + step, c])
                outer = int(image[y, 3 * i, c]) + int(image[y, 3 * i + 2 * step, c])
                square += (middle - outer) ** 2
            result[y, i] = np.sqrt(np.float32(square))
    return result


@linked(from_python=True)
def bars(
    planes: Planes,
    padding: int,
    searched: NDArray[np.uint8],
    across: NDArray[np.int64],
    threshold: float,
    tones: bool,
) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
    """Strength and orientation of the bar that each pixel may lie on.

    Args:
        planes: the smoothed picture by channels, with a border, shape (3, h + 2 p, w + 2 p).
        padding: p, at least as far as any pixel that is compared.
        searched: mask of where a bar may be, not zero there, shape (h, w).
        across: (row, column) to the compared background, one row an orientation, shape (k, 2);
            the orientations are equally spaced over half a turn, and k is even.
        threshold: least contrast [grey levels].
        tones: whether a bar may change its colour along itself.

    Returns:
        Strength [grey levels], 0 for no bar, and the index of the orientation, shapes (h, w).
    """
    height, width = searched.shape
    strength = np.zeros((height, width), dtype=np.float32)
    orientation = np.zeros((height, width), dtype=np.int8)
    least = np.float32(threshold * threshold)
    squares = np.empty((7, width), dtype=np.float32)
    for row in range(height):
        last = 0
        while last < width:
            first, last = _next_run(searched[row], last)
            if last <= first:
                break
            _search_run(
                planes,
                row + padding,
                first + padding,
                across,
                least,
                strength[row, first:last],
                orientation[row, first:last],
                squares,
                tones,
            )
        for column in range(width):
            if strength[row, column] <= threshold or searched[row, column] == 0:
                strength[row, column] = 0.0
    return strength, orientation


@njit(from_python=False)
def _next_run(searched: NDArray[np.uint8], begin: int) -> tuple[int, int]:
    """First and last (exclusive) of the next columns to search, over short gaps; or nothing."""
    width = len(searched)
    first = begin
    while first < width and searched[first] == 0:
        first += 1
    last = first
    column = first
    while column < width and column - last < SHORT_GAP:
        if searched[column] != 0:
            last = column + 1
        column += 1
    return first, last


@linked()
def _search_run(
    planes: Planes,
    y: int,
    x: int,
    across: NDArray[np.int64],
    least: float,
    best: Float32,
    which: NDArray[np.int8],
    squares: Float32,
    tones: bool,
) -> None:
    """Strength and orientation of neighbouring pixels of a row, compared in vector registers."""
    count = len(best)
    left, right, product = squares[0, :count], squares[1, :count], squares[2, :count]
    ahead, behind, other = squares[3, :count], squares[4, :count], squares[5, :count]
    half = len(across) // 2
    for k in range(half):
        # What lies to the sides of one orientation lies ahead of and behind the one at right
        # angles to it.
        dy, dx = across[k, 0], across[k, 1]
        _sides(planes, y, x, dy, dx, left, right, product)
        dy, dx = across[k + half, 0], across[k + half, 1]
        _sides(planes, y, x, dy, dx, ahead, behind, other)
        _keep_best(
            best, which, k, k + half, left, right, product, ahead, behind, other, np.float32(least)
        )
    if not tones:
        return
    weakest = squares[6, :count]
    for k in range(len(across)):
        # What differs from both sides here, ahead and behind is a bar of whatever colours.
        weakest[:] = np.inf
        dy, dx = across[k, 0], across[k, 1]
        ay, ax = across[(k + half) % (2 * half), 0], across[(k + half) % (2 * half), 1]
        for step in (0, -1, 1):
            _sides(planes, y + step * ay, x + step * ax, dy, dx, left, right, product)
            for i in range(count):
                if _opposite(left[i], right[i], product[i]):
                    weakest[i] = 0.0
                weakest[i] = min(weakest[i], min(left[i], right[i]))
        for i in range(count):
            value = np.float32(1.0 - CHANGED) * np.sqrt(weakest[i])
            if weakest[i] >= least and value > best[i]:
                best[i] = value
                which[i] = k


@njit(from_python=False, fastmath=True)
def _sides(
    planes: Planes,
    y: int,
    x: int,
    dy: int,
    dx: int,
    left: Float32,
    right: Float32,
    product: Float32,
) -> None:
    """Squared differences of a row's pixels from both sides, and their scalar product."""
    count = len(left)
    for channel in range(3):
        here = planes[channel, y, x : x + count]
        one = planes[channel, y + dy, x + dx : x + dx + count]
        other = planes[channel, y - dy, x - dx : x - dx + count]
        if channel == 0:
            for i in range(count):
                a = np.float32(np.int32(one[i]) - np.int32(here[i]))
                b = np.float32(np.int32(other[i]) - np.int32(here[i]))
                left[i], right[i], product[i] = a * a, b * b, a * b
        else:
            for i in range(count):
                a = np.float32(np.int32(one[i]) - np.int32(here[i]))
                b = np.float32(np.int32(other[i]) - np.int32(here[i]))
                left[i] += a * a
                right[i] += b * b
                product[i] += a * b


@njit(fastmath=True, inline="always")
def _opposite(left: float, right: float, product: float) -> bool:
    """Whether a pixel differs from its two sides into opposite directions.

    At the edge of two areas the picture is blurred: its pixels differ from both sides so.
    """
    limit = np.float32(OPPOSITE * OPPOSITE) * left * right
    return bool(product < np.float32(0.0) and product * product > limit)


@njit(from_python=False, fastmath=True)
def _keep_best(
    best: Float32,
    which: NDArray[np.int8],
    k: int,
    other_k: int,
    left: Float32,
    right: Float32,
    product: Float32,
    ahead: Float32,
    behind: Float32,
    other: Float32,
    least: float,
) -> None:
    """Contrast to the weaker side less the change along, where it beats the other orientations.

    Two orientations at right angles, of which each one's sides lie ahead of and behind the other.
    """
    half = np.float32(0.5)
    for i in range(len(best)):
        weaker, weaker_along = min(left[i], right[i]), min(ahead[i], behind[i])
        to_left, to_right = np.sqrt(left[i]), np.sqrt(right[i])
        before, after = np.sqrt(ahead[i]), np.sqrt(behind[i])
        contrast, along = min(to_left, to_right), min(before, after)
        value, value_along = contrast - half * (before + after), along - half * (to_left + to_right)
        edge = _opposite(left[i], right[i], product[i])
        edge_along = _opposite(ahead[i], behind[i], other[i])
        strength, found = best[i], which[i]
        if value > max(strength, np.float32(ALIKE) * contrast) and weaker >= least and not edge:
            strength, found = value, np.int8(k)
        better = value_along > max(strength, np.float32(ALIKE) * along)
        if better and weaker_along >= least and not edge_along:
            strength, found = value_along, np.int8(other_k)
        best[i], which[i] = strength, found
