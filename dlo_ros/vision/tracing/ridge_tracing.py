# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Chains: smooth pieces of centreline that the picture shows without a break.

A chain ends where a strand crosses another one, is hidden, leaves the picture or ends. Which chain
goes on in which is decided by `chain_linking`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_map import ORIENTATIONS, Image, RidgeMap
from dlo_ros.vision.tracing.ridge_points import STEP, ridge_points, without_specks

SHORTEST = 1.5  # widths; a shorter chain is noise
SHARP_TURN = 1.0  # [rad] over two widths: no bend of a DLO, so the chain is cut there
END_SPAN = 2.0  # widths over which direction and curvature at a chain's end are measured
# Tracing stops where no ridge point within a step lies ahead and points the same way.
LEAST_AHEAD = 0.6  # cosine of the angle between the way so far and the step: 53 degrees
LEAST_ALIKE = 0.8  # cosine of the angle between the way so far and the ridge there: 37 degrees
TURN_COST, ASIDE_COST = 3.0, 2.0  # of one minus these cosines, beside a step's length [px]
INERTIA = 0.6  # weight of the way so far against the ridge's direction, in the next way
OWN_HALF_WIDTH = 0.75  # along the way [px]; neighbours within it belong to the same ridge


@dataclass(frozen=True, eq=False)
class Chain:
    """A piece of centreline, in pixels of the bar map.

    Args:
        points: (x, y), about 1 px apart, shape (m, 2).
        strength: median contrast of the points [grey levels].
        colour: median colour, BGR, shape (3,).
    """

    points: FloatArray
    strength: float
    colour: FloatArray

    @property
    def length(self) -> float:
        """Arc length [px]."""
        return float(np.sum(np.hypot(*np.diff(self.points, axis=0).T)))

    def part(self, first: int, last: int) -> Chain:
        """The points first to last (exclusive)."""
        return Chain(self.points[first:last], self.strength, self.colour)


@dataclass(frozen=True)
class ChainEnd:
    """One end of a chain: position, direction out of the chain and signed curvature going on."""

    position: FloatArray
    direction: FloatArray
    curvature: float


def find_chains(bars: RidgeMap) -> list[Chain]:
    """Trace the ridges of a bar map, strongest first."""
    rows, columns, offsets = ridge_points(bars.strength, bars.orientation, round(0.9 * bars.width))
    least = max(4, math.ceil(SHORTEST * bars.width))
    kept = without_specks(rows, columns, bars.strength.shape, least)
    rows, columns, offsets = rows[kept], columns[kept], offsets[kept]
    if len(rows) == 0:
        return []
    strength = bars.strength[rows, columns]
    # Positive floats are ordered as their bits are. Whole keys are sorted faster than an index is,
    # and the place in their lower half keeps equal ones in order.
    keys = strength.view(np.uint32).astype(np.int64) << 32
    order = np.sort(np.arange(len(rows)) - keys) & 0xFFFFFFFF
    angles = np.arange(ORIENTATIONS) * (math.pi / ORIENTATIONS)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])[bars.orientation[rows, columns]]
    members, starts = _trace(rows, columns, directions, order, bars.strength.shape)
    xy = np.column_stack([columns + offsets[:, 0], rows + offsets[:, 1]])
    kernel = _gaussian(0.35 * bars.width)
    smooth, medians, tones = _describe(
        xy, strength, bars.colour, rows, columns, members, starts, least, kernel
    )
    chains: list[Chain] = []
    for k in np.flatnonzero(np.diff(starts) >= least):
        part = slice(starts[k], starts[k + 1])
        chain = Chain(smooth[part], float(medians[k]), tones[k])
        chains.extend(_cut_at_turns(chain, bars.width))
    return chains


def _gaussian(sigma: float) -> FloatArray:
    reach = max(1, round(3.0 * sigma))
    kernel: FloatArray = np.exp(-0.5 * (np.arange(-reach, reach + 1.0) / sigma) ** 2)
    return np.asarray(kernel / kernel.sum())


@njit()
def _describe(
    xy: FloatArray,
    strength: NDArray[np.float32],
    image: Image,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    members: NDArray[np.int64],
    starts: NDArray[np.int64],
    least: int,
    kernel: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smoothed points of the chains, and of those long enough median strength and colour."""
    count = len(starts) - 1
    smooth = np.empty((len(members), 2))
    medians = np.zeros(count)
    tones = np.zeros((count, 3))
    reach = len(kernel) // 2
    for c in range(count):
        first, last = starts[c], starts[c + 1]
        if last - first < least:
            continue
        for i in range(first, last):
            x, y = 0.0, 0.0
            for j in range(-reach, reach + 1):
                # Beyond the ends the chain is continued by its end points.
                at = members[min(max(i + j, first), last - 1)]
                x += kernel[j + reach] * xy[at, 0]
                y += kernel[j + reach] * xy[at, 1]
            smooth[i, 0], smooth[i, 1] = x, y
        values = np.empty(last - first)
        for i in range(first, last):
            values[i - first] = strength[members[i]]
        medians[c] = np.median(values)
        for channel in range(3):
            for i in range(first, last):
                at = members[i]
                values[i - first] = image[rows[at], columns[at], channel]
            tones[c, channel] = np.median(values)
    return smooth, medians, tones


def _cut_at_turns(chain: Chain, width: float) -> list[Chain]:
    """Cut where the direction changes more sharply than a DLO bends."""
    reach = max(2, round(width))
    count = len(chain.points)
    cuts = [0]
    if count > 2 * reach:
        p = chain.points
        ahead = p[2 * reach :] - p[reach:-reach]
        behind = p[reach:-reach] - p[: -2 * reach]
        turn = np.abs(
            np.arctan2(
                behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0],
                np.sum(behind * ahead, axis=1),
            )
        )
        at = 0
        while at < len(turn):
            if turn[at] > SHARP_TURN:
                window = turn[at : at + 2 * reach]
                peak = at + int(np.argmax(window))
                cuts.append(peak + reach)
                at = peak + 2 * reach
            else:
                at += 1
    cuts.append(count)
    parts = [chain.part(a, b) for a, b in pairwise(cuts)]
    return [part for part in parts if len(part.points) >= max(4, SHORTEST * width)]


def chain_end(chain: Chain, last: bool, width: float) -> ChainEnd:
    """Position, outward direction and curvature at one end of a chain.

    Args:
        chain: chain of at least four points.
        last: the end with the last point, else the one with the first.
        width: width of the DLO in the chain's pixels.
    """
    span = max(5, round(END_SPAN * width))
    p = chain.points[-span:] if last else chain.points[:span][::-1]
    position, direction, curvature = _end_of(np.ascontiguousarray(p), width)
    # An end's curvature is uncertain; a DLO hardly bends sharper than two widths of radius.
    limit = 0.25 / width
    return ChainEnd(position, direction, float(min(max(curvature, -limit), limit)))


@njit()
def _end_of(points: FloatArray, width: float) -> tuple[FloatArray, FloatArray, float]:
    """Position, direction and curvature at the last of some points, by a parabola over them."""
    count = len(points)
    terms = 3 if count >= 2 * width and count >= 6 else 2
    normal, right = np.zeros((terms, terms)), np.zeros((terms, 2))
    row = np.ones(terms)
    s = 0.0
    for i in range(count - 1, -1, -1):
        if i < count - 1:
            dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
            s -= math.sqrt(dx * dx + dy * dy)
        row[1] = s
        if terms == 3:
            row[2] = 0.5 * s * s
        for a in range(terms):
            for b in range(terms):
                normal[a, b] += row[a] * row[b]
            right[a, 0] += row[a] * points[i, 0]
            right[a, 1] += row[a] * points[i, 1]
    c = _solved(normal, right)
    direction = c[1] / max(math.sqrt(c[1, 0] ** 2 + c[1, 1] ** 2), 1e-9)
    curvature = direction[0] * c[2, 1] - direction[1] * c[2, 0] if terms == 3 else 0.0
    return c[0].copy(), direction, curvature


@njit(from_python=False)
def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of normal equations, in place of the right-hand sides (Gauss, no pivots needed)."""
    count = len(normal)
    for a in range(count):
        for b in range(a + 1, count):
            factor = normal[b, a] / normal[a, a]
            for k in range(a, count):
                normal[b, k] -= factor * normal[a, k]
            for k in range(2):
                right[b, k] -= factor * right[a, k]
    for a in range(count - 1, -1, -1):
        for k in range(2):
            for b in range(a + 1, count):
                right[a, k] -= normal[a, b] * right[b, k]
            right[a, k] /= normal[a, a]
    return right


@njit()
def _trace(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    directions: FloatArray,
    order: NDArray[np.int64],
    shape: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Chains of ridge points: members of all chains one after the other, and where each starts."""
    total = len(rows)
    # The index of the point on each pixel, with a border as wide as a step.
    index = np.full((shape[0] + 2 * STEP, shape[1] + 2 * STEP), -1, dtype=np.int32)
    for k in range(total):
        index[rows[k] + STEP, columns[k] + STEP] = k
    used = np.zeros(total, dtype=np.bool_)
    members = np.empty(total, dtype=np.int64)
    starts = np.empty(total + 1, dtype=np.int64)
    chains = 0
    filled = 0
    forward = np.empty(total, dtype=np.int64)
    backward = np.empty(total, dtype=np.int64)
    distances = np.empty((2 * STEP + 1, 2 * STEP + 1))
    for dy in range(-STEP, STEP + 1):
        for dx in range(-STEP, STEP + 1):
            distances[dy + STEP, dx + STEP] = math.sqrt(dx * dx + dy * dy)
    for seed in order:
        if used[seed]:
            continue
        used[seed] = True
        lengths = [0, 0]
        for side in range(2):
            here = seed
            tx = directions[seed, 0] * (1.0 if side == 0 else -1.0)
            ty = directions[seed, 1] * (1.0 if side == 0 else -1.0)
            while True:
                best = -1
                least = 1e9
                bx, by = 0.0, 0.0
                for dy in range(-STEP, STEP + 1):
                    for dx in range(-STEP, STEP + 1):
                        other = index[rows[here] + dy + STEP, columns[here] + dx + STEP]
                        if other < 0 or used[other]:
                            continue
                        distance = distances[dy + STEP, dx + STEP]
                        ahead = (dx * tx + dy * ty) / distance
                        if ahead < LEAST_AHEAD:
                            continue
                        ox, oy = directions[other, 0], directions[other, 1]
                        same = ox * tx + oy * ty
                        if same < 0.0:
                            ox, oy, same = -ox, -oy, -same
                        if same < LEAST_ALIKE:
                            continue
                        cost = distance + TURN_COST * (1.0 - same) + ASIDE_COST * (1.0 - ahead)
                        if cost < least:
                            least = cost
                            best = other
                            bx, by = ox, oy
                if best < 0:
                    break
                used[best] = True
                tx = INERTIA * tx + (1.0 - INERTIA) * bx
                ty = INERTIA * ty + (1.0 - INERTIA) * by
                norm = math.sqrt(tx * tx + ty * ty)
                tx, ty = tx / norm, ty / norm
                # Neighbours beside the step belong to the same ridge.
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        beside = index[rows[best] + dy + STEP, columns[best] + dx + STEP]
                        if beside >= 0 and abs(dx * tx + dy * ty) < OWN_HALF_WIDTH:
                            used[beside] = True
                if side == 0:
                    forward[lengths[0]] = best
                else:
                    backward[lengths[1]] = best
                lengths[side] += 1
                here = best
        starts[chains] = filled
        chains += 1
        for k in range(lengths[1] - 1, -1, -1):
            members[filled] = backward[k]
            filled += 1
        members[filled] = seed
        filled += 1
        for k in range(lengths[0]):
            members[filled] = forward[k]
            filled += 1
    starts[chains] = filled
    return members[:filled].copy(), starts[: chains + 1].copy()
