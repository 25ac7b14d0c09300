"""The compiled search for bars: see `segmentation`."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Planes = NDArray[np.uint8]
Float32 = NDArray[np.float32]

SHORT_GAP = 24  # [px] columns between searched ones that are searched with them
CHANGED = 0.4  # share of the contrast that a change of colour along a bar takes away
OPPOSITE = 0.5  # cosine between the differences to both sides, beyond which it is an edge


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def bars(
    planes: Planes,
    padding: int,
    searched: NDArray[np.uint8],
    across: NDArray[np.int64],
    along: NDArray[np.int64],
    threshold: float,
    tones: bool,
) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
    """Strength and orientation of the bar that each pixel may lie on.

    Args:
        planes: the smoothed picture by channels, with a border, shape (3, h + 2 p, w + 2 p).
        padding: p, at least as far as any pixel that is compared.
        searched: not zero where a bar may be, shape (h, w).
        across: (row, column) to the compared background, one row an orientation, shape (k, 2).
        along: (row, column) to the compared pixels along the bar, shape (k, 2).
        threshold: least contrast [grey levels].
        tones: whether a bar may change its colour along itself.

    Returns:
        Strength [grey levels], 0 for no bar, and the index of the orientation, shapes (h, w).
    """
    height, width = searched.shape
    strength = np.zeros((height, width), dtype=np.float32)
    orientation = np.zeros((height, width), dtype=np.int8)
    least = np.float32(threshold * threshold)
    squares = np.empty((6, width), dtype=np.float32)
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
                along,
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


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
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


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _search_run(
    planes: Planes,
    y: int,
    x: int,
    across: NDArray[np.int64],
    along: NDArray[np.int64],
    least: float,
    best: Float32,
    which: NDArray[np.int8],
    squares: Float32,
    tones: bool,
) -> None:
    """Strength and orientation of neighbouring pixels of a row, compared in vector registers."""
    count = len(best)
    left, right, product = squares[0, :count], squares[1, :count], squares[2, :count]
    ahead, behind = squares[3, :count], squares[4, :count]
    for k in range(across.shape[0]):
        dy, dx = across[k, 0], across[k, 1]
        _sides(planes, y, x, dy, dx, left, right, product)
        if _largest(left, right, product) < least:
            continue
        dy, dx = along[k, 0], along[k, 1]
        _difference(planes, y, x, dy, dx, ahead)
        _difference(planes, y, x, -dy, -dx, behind)
        _keep_best(best, which, np.int8(k), left, ahead, behind, least)
        if tones:
            # What differs from both sides here, ahead and behind is a bar of whatever colours.
            weakest = squares[5, :count]
            weakest[:] = left
            sy, sx = across[k, 0], across[k, 1]
            for sign in (-1, 1):
                _sides(planes, y + sign * dy, x + sign * dx, sy, sx, left, right, product)
                _largest(left, right, product)
                for i in range(count):
                    weakest[i] = min(weakest[i], left[i])
            ahead[:] = np.float32(CHANGED * CHANGED) * weakest
            behind[:] = ahead
            _keep_best(best, which, np.int8(k), weakest, ahead, behind, least)


@njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def _difference(planes: Planes, y: int, x: int, dy: int, dx: int, result: Float32) -> None:
    """Squared differences of a row's pixels from those at a distance, all channels."""
    count = len(result)
    for channel in range(3):
        here = planes[channel, y, x : x + count]
        there = planes[channel, y + dy, x + dx : x + dx + count]
        if channel == 0:
            for i in range(count):
                d = np.float32(np.int32(here[i]) - np.int32(there[i]))
                result[i] = d * d
        else:
            for i in range(count):
                d = np.float32(np.int32(here[i]) - np.int32(there[i]))
                result[i] += d * d


@njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
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


@njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def _largest(left: Float32, right: Float32, product: Float32) -> float:
    """Largest contrast to the weaker side, squared; leaves 0 in `left` where there is no bar.

    At the edge of two areas the picture is blurred: its pixels differ from both sides, but into
    opposite directions.
    """
    result = np.float32(0.0)
    for i in range(len(left)):
        edge = product[i] < np.float32(0.0) and product[i] * product[i] > (
            np.float32(OPPOSITE * OPPOSITE) * left[i] * right[i]
        )
        smaller = np.float32(0.0) if edge else min(left[i], right[i])
        left[i] = smaller
        result = max(result, smaller)
    return float(result)


@njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def _keep_best(
    best: Float32,
    which: NDArray[np.int8],
    k: int,
    smaller: Float32,
    ahead: Float32,
    behind: Float32,
    least: float,
) -> None:
    """Contrast to the weaker side less the change along, where it beats the other orientations."""
    for i in range(len(best)):
        value = np.sqrt(smaller[i]) - np.float32(0.5) * (np.sqrt(ahead[i]) + np.sqrt(behind[i]))
        if smaller[i] >= least and value > best[i]:
            best[i] = value
            which[i] = k
