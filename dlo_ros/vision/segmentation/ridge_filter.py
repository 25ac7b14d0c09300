# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The compiled search for bars: see `ridge_map`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked

Float32 = NDArray[np.float32]

BLOCK = 32  # [px] columns that are searched together
CHANGED = 0.4  # share of the contrast that a change of colour along a bar takes away
ALIKE = 0.3  # share of the contrast that must be left after the change along: a spot has none
OPPOSITE = 0.5  # cosine between the differences to both sides, beyond which it is an edge
ROUNDING = 1e-6  # of single precision: what is no edge but for it is none


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
    planes: Float32,
    padding: int,
    searched: NDArray[np.uint8],
    across: NDArray[np.int64],
    threshold: float,
    tones: bool,
) -> tuple[Float32, NDArray[np.int8]]:
    """Strength and orientation of the bar that each pixel may lie on.

    Args:
        planes: the smoothed picture by channels, with a border, shape (3, h + 2 p, w + 2 p).
        padding: p, at least twice as far as any pixel that is compared.
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
    # The side in a row below is compared; the other side's row has been compared before.
    down = across.copy()
    for k in range(len(across)):
        if across[k, 0] < 0:
            down[k, 0], down[k, 1] = -across[k, 0], -across[k, 1]
    reach = np.abs(across).max()
    contrast = np.empty((reach + 1, len(across), width + 2 * padding), dtype=np.float32)
    squares = np.empty((4, width), dtype=np.float32)
    blocks = _searched_blocks(searched)
    for row in range(-reach, height):
        used = _any_row(blocks[max(row, 0) : row + reach + 1])
        last = 0
        while last < width:
            first, last = _next_run(used, last, width)
            begin, end = first + padding - reach, last + padding + reach
            if first < last:
                _compare(planes, row + padding, begin, end, down, contrast)
        last = width if row < 0 else 0
        while last < width:
            first, last = _next_run(blocks[row], last, width)
            if first < last:
                best, which = strength[row, first:last], orientation[row, first:last]
                y, x = row + padding, first + padding
                _search_run(planes, y, x, down, contrast, threshold, best, which, squares)
                if tones:
                    _search_tones(planes, y, x, across, threshold, best, which, squares)
                _limit(best, searched[row, first:last], np.float32(threshold))
    return strength, orientation


@njit(from_python=False)
def _searched_blocks(searched: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Whether any pixel of each row's blocks of columns is searched, shape (h, blocks)."""
    height, width = searched.shape
    result = np.empty((height, (width + BLOCK - 1) // BLOCK), dtype=np.bool_)
    for row in range(height):
        for block in range(result.shape[1]):
            most = np.uint8(0)
            for column in range(block * BLOCK, min((block + 1) * BLOCK, width)):
                most = max(most, searched[row, column])
            result[row, block] = most != 0
    return result


@njit(from_python=False)
def _any_row(blocks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The blocks that are searched in any of some rows."""
    result = np.zeros(blocks.shape[1], dtype=np.bool_)
    for row in range(len(blocks)):
        for block in range(len(result)):
            result[block] |= blocks[row, block]
    return result


@njit(from_python=False)
def _next_run(blocks: NDArray[np.bool_], begin: int, width: int) -> tuple[int, int]:
    """First and last (exclusive) column of the next blocks to search, from a block's border on."""
    block = (begin + BLOCK - 1) // BLOCK
    while block < len(blocks) and not blocks[block]:
        block += 1
    first = block
    while block < len(blocks) and blocks[block]:
        block += 1
    return min(first * BLOCK, width), min(block * BLOCK, width)


@njit(from_python=False)
def _compare(
    planes: Float32, y: int, first: int, last: int, down: NDArray[np.int64], contrast: Float32
) -> None:
    """Contrast of a row's pixels to those on one side, for all orientations.

    Args:
        planes: see `bars`.
        y, first, last: row and columns.
        down: (row, column) to the side, shape (k, 2).
        contrast: the last rows by turns, shape (r, k, w), to fill.
    """
    for k in range(len(down)):
        dy, dx = down[k]
        row = contrast[y % len(contrast), k, first:last]
        _distances(planes, y, first, y + dy, first + dx, row, True)


@njit(from_python=False, fastmath=True)
def _distances(
    planes: Float32, y: int, x: int, other_y: int, other_x: int, result: Float32, root: bool
) -> None:
    """Differences of a row's pixels from those of another one, or their squares."""
    end, other_end = x + len(result), other_x + len(result)
    blue, other_blue = planes[0, y, x:end], planes[0, other_y, other_x:other_end]
    green, other_green = planes[1, y, x:end], planes[1, other_y, other_x:other_end]
    red, other_red = planes[2, y, x:end], planes[2, other_y, other_x:other_end]
    for i in range(len(result)):
        b, g, r = other_blue[i] - blue[i], other_green[i] - green[i], other_red[i] - red[i]
        square = b * b + g * g + r * r
        result[i] = np.sqrt(square) if root else square


@njit(from_python=False)
def _search_run(
    planes: Float32,
    y: int,
    x: int,
    down: NDArray[np.int64],
    contrast: Float32,
    threshold: float,
    best: Float32,
    which: NDArray[np.int8],
    squares: Float32,
) -> None:
    """Strength and orientation of neighbouring pixels of a row, compared in vector registers."""
    count, rows = len(best), len(contrast)
    span, span_along = squares[0, :count], squares[1, :count]
    half = len(down) // 2
    for k in range(half):
        # What lies to the sides of one orientation lies ahead of and behind the one at right
        # angles to it.
        dy, dx = down[k]
        _distances(planes, y - dy, x - dx, y + dy, x + dx, span, False)
        left = contrast[y % rows, k, x : x + count]
        right = contrast[(y - dy) % rows, k, x - dx : x - dx + count]
        dy, dx = down[k + half]
        _distances(planes, y - dy, x - dx, y + dy, x + dx, span_along, False)
        ahead = contrast[y % rows, k + half, x : x + count]
        behind = contrast[(y - dy) % rows, k + half, x - dx : x - dx + count]
        _keep_best(
            best,
            which,
            k,
            k + half,
            left,
            right,
            span,
            ahead,
            behind,
            span_along,
            np.float32(threshold),
        )


@njit(from_python=False)
def _search_tones(
    planes: Float32,
    y: int,
    x: int,
    across: NDArray[np.int64],
    threshold: float,
    best: Float32,
    which: NDArray[np.int8],
    squares: Float32,
) -> None:
    """Bars of changing colours: pixels that differ from both sides here, ahead and behind."""
    count, half = len(best), len(across) // 2
    left, right, span, weakest = (
        squares[0, :count],
        squares[1, :count],
        squares[2, :count],
        squares[3, :count],
    )
    for k in range(len(across)):
        weakest[:] = np.inf
        dy, dx = across[k]
        along = across[(k + half) % (2 * half)]
        for step in (0, -1, 1):
            here_y, here_x = y + step * along[0], x + step * along[1]
            _distances(planes, here_y, here_x, here_y + dy, here_x + dx, left, True)
            _distances(planes, here_y, here_x, here_y - dy, here_x - dx, right, True)
            _distances(planes, here_y - dy, here_x - dx, here_y + dy, here_x + dx, span, False)
            for i in range(count):
                if _opposite(left[i], right[i], span[i]):
                    weakest[i] = 0.0
                weakest[i] = min(weakest[i], min(left[i], right[i]))
        for i in range(count):
            value = np.float32(1.0 - CHANGED) * weakest[i]
            if weakest[i] >= np.float32(threshold) and value > best[i]:
                best[i] = value
                which[i] = k


@njit(fastmath=True, inline="always")
def _opposite(left: float, right: float, span: float) -> bool:
    """Whether a pixel differs from its two sides into opposite directions.

    At the edge of two areas the picture is blurred: its pixels differ from both sides so. By the
    law of cosines the sides then differ by more than without it.

    Args:
        left, right: differences from both sides.
        span: square of the difference between the sides.
    """
    limit = left * left + right * right + np.float32(2.0 * OPPOSITE) * left * right
    return bool(span > np.float32(1.0 + ROUNDING) * limit)


@njit(from_python=False, fastmath=True)
def _keep_best(
    best: Float32,
    which: NDArray[np.int8],
    k: int,
    other_k: int,
    left: Float32,
    right: Float32,
    span: Float32,
    ahead: Float32,
    behind: Float32,
    span_along: Float32,
    least: float,
) -> None:
    """Contrast to the weaker side less the change along, where it beats the other orientations.

    Two orientations at right angles, of which each one's sides lie ahead of and behind the other.
    """
    half = np.float32(0.5)
    for i in range(len(best)):
        to_left, to_right, before, after = left[i], right[i], ahead[i], behind[i]
        contrast, along = min(to_left, to_right), min(before, after)
        value, value_along = contrast - half * (before + after), along - half * (to_left + to_right)
        edge = _opposite(to_left, to_right, span[i])
        edge_along = _opposite(before, after, span_along[i])
        strength, found = best[i], which[i]
        if value > max(strength, np.float32(ALIKE) * contrast) and contrast >= least and not edge:
            strength, found = value, np.int8(k)
        better = value_along > max(strength, np.float32(ALIKE) * along)
        if better and along >= least and not edge_along:
            strength, found = value_along, np.int8(other_k)
        best[i], which[i] = strength, found


@njit(from_python=False)
def _limit(strength: Float32, searched: NDArray[np.uint8], threshold: float) -> None:
    """Set what is not stronger than the threshold, or is not searched, to 0."""
    for i in range(len(strength)):
        keep = (strength[i] > threshold) & (searched[i] != 0)
        strength[i] = strength[i] if keep else np.float32(0.0)
