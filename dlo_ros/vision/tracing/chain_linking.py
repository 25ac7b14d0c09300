# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The cost of a link from the end of one chain to the start of another.

A DLO bends smoothly, so a strand leaves a crossing as it came in: with the same direction and
curvature. Costs are without unit, of the order of a negative log likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_map import Image, RidgeMap
from dlo_ros.vision.tracing.metric_lengths import PlaneGrid, polyline_length
from dlo_ros.vision.tracing.ridge_tracing import Chain, chain_end

BENDING = 2.0  # times 4 (a^2 + ab + b^2) w / gap: bending energy of the bridge
UNSEEN = 0.25  # per width of bridge over pixels that do not look like the DLO
HIDDEN = 0.06  # per width of bridge over pixels like the DLO: a crossing, not a chain
COLOUR = 1.0  # for a change of colour by half the contrast
LINK = 0.1  # of any link
BACK = 0.75  # [widths] ends are moved back by this: chains overlap, or stop short of crossings
BACK_OF_CLAMP = 1.5  # [widths] the same for clamps, whose place is known less well
LARGEST_TURN = 1.8  # [rad] between the chord of a bridge and an end
CURVATURE_TRUST = 0.7  # share of the measured end curvature that is expected to go on
BESIDE = 3.0  # [widths] how far an end of unknown direction may lie from a chain's end
LINK_LIMIT = 14.0  # a dearer link is none
EXAMINED = 32  # bridges that are looked at from each end, the cheapest by their bend and length
PREFER_NEAR = 0.12  # per width of bridge, when choosing which to look at


@dataclass(frozen=True, eq=False)
class ChainEnds:
    """The ends of all chains, seen as entrances or exits; arrays of length 2 x chains.

    Index 2 k is the first point of chain k, 2 k + 1 the last. `directions` point out of the chain.
    """

    positions: FloatArray
    directions: FloatArray
    curvatures: FloatArray
    colours: FloatArray
    strengths: FloatArray

    def __len__(self) -> int:
        return len(self.positions)


class Continuation(NamedTuple):
    """A possible continuation: its cost, the length of the bridge in the plane, the end reached.

    `unseen` is the share of the cost that comes from how much of the bridge was not seen.
    """

    cost: float
    length: float
    end: int
    unseen: float


class Linker:
    """Links between the ends of chains in one bar map."""

    def __init__(self, chains: list[Chain], bars: RidgeMap, plane: PlaneGrid) -> None:
        found = [chain_end(chain, last, bars.width) for chain in chains for last in (False, True)]
        strengths = [chain.strength for chain in chains]
        self.ends = ChainEnds(
            np.array([e.position for e in found]).reshape(-1, 2),
            np.array([e.direction for e in found]).reshape(-1, 2),
            np.array([e.curvature for e in found]),
            np.repeat(np.array([c.colour for c in chains]).reshape(-1, 3), 2, axis=0),
            np.repeat(np.array(strengths), 2),
        )
        self._bars, self._plane = bars, plane

    def from_end(self, k: int, limit: float = LINK_LIMIT) -> list[Continuation]:
        """Links that leave a chain at end k, the cheapest first."""
        ends = self.ends
        return self._links(
            ends.positions[k],
            ends.directions[k],
            float(ends.curvatures[k]),
            ends.colours[k],
            float(ends.strengths[k]),
            k // 2,
            limit,
        )

    def from_clamp(self, position: FloatArray, direction: FloatArray | None) -> list[Continuation]:
        """Links that leave a clamp into a direction, or into any where None is known."""
        away = np.zeros(2) if direction is None else direction
        return self._links(position, away, 0.0, np.zeros(3), 0.0, -1, LINK_LIMIT)

    def _links(
        self,
        position: FloatArray,
        direction: FloatArray,
        curvature: float,
        colour: FloatArray,
        strength: float,
        own: int,
        limit: float,
    ) -> list[Continuation]:
        ends = self.ends
        costs, lengths, reached, unseen = _links(
            np.ascontiguousarray(position, dtype=np.float64),
            np.ascontiguousarray(direction, dtype=np.float64),
            curvature,
            np.ascontiguousarray(colour, dtype=np.float64),
            strength,
            own,
            ends.positions,
            ends.directions,
            ends.curvatures,
            ends.colours,
            ends.strengths,
            self._bars.colour,
            self._bars.width,
            self._plane.nodes,
            limit,
        )
        order = np.argsort(costs, kind="stable")
        return [
            Continuation(float(costs[i]), float(lengths[i]), int(reached[i]), float(unseen[i]))
            for i in order
        ]


@linked(from_python=True)
def bridge(
    position: FloatArray, direction: FloatArray, target: FloatArray, arriving: FloatArray
) -> FloatArray:
    """Smooth curve between two ends (cubic Hermite), about one point per pixel, shape (m, 2)."""
    chord = math.sqrt((target[0] - position[0]) ** 2 + (target[1] - position[1]) ** 2)
    count = max(2, math.ceil(chord) + 1)
    points = np.empty((count, 2))
    for i in range(count):
        s = i / (count - 1)
        h00, h10 = (1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2
        h01, h11 = s * s * (3 - 2 * s), -s * s * (1 - s)
        for d in range(2):
            points[i, d] = (
                h00 * position[d]
                + h10 * chord * direction[d]
                + h01 * target[d]
                + h11 * chord * arriving[d]
            )
    return points


@njit(from_python=False)
def _bend(
    position: FloatArray,
    direction: FloatArray,
    curvature: float,
    target: FloatArray,
    outward: FloatArray,
    target_curvature: float,
    width: float,
    back: float,
) -> tuple[float, float]:
    """Cost of the bend into an end and the length of the gap [px]; infinite if not smooth."""
    ix, iy = -outward[0], -outward[1]
    cx = target[0] + back * ix - position[0] + back * direction[0]
    cy = target[1] + back * iy - position[1] + back * direction[1]
    distance = math.sqrt(cx * cx + cy * cy)
    if distance < 0.4 * back:
        return math.inf, 0.0
    cx, cy = cx / distance, cy / distance
    a = math.atan2(direction[0] * cy - direction[1] * cx, direction[0] * cx + direction[1] * cy)
    b = math.atan2(cx * iy - cy * ix, cx * ix + cy * iy)
    if abs(a) > LARGEST_TURN or abs(b) > LARGEST_TURN:
        return math.inf, 0.0
    # The curvature known at the ends holds for a short way only. An end's curvature is signed
    # going out, so that of the target counts against the way in.
    half = 0.5 * min(distance, 4.0 * width) * CURVATURE_TRUST
    a -= half * curvature
    b += half * target_curvature
    energy = 4.0 * (a * a + a * b + b * b) * width / max(distance, 1.5 * width)
    return BENDING * energy, max(distance - 2.0 * back, 0.0)


@njit(from_python=False)
def _unlike(points: FloatArray, colour: FloatArray, strength: float, image: Image) -> float:
    """Share of a bridge over pixels that do not look like the DLO."""
    height, width = image.shape[0], image.shape[1]
    scale = 0.6 * max(strength, 1.0)
    total = 0.0
    for i in range(len(points)):
        x = min(max(int(round(points[i, 0])), 0), width - 1)  # noqa: RUF046 (numba: a float)
        y = min(max(int(round(points[i, 1])), 0), height - 1)  # noqa: RUF046
        square = 0.0
        for c in range(3):
            square += (float(image[y, x, c]) - colour[c]) ** 2
        total += min(max(math.sqrt(square) / scale - 0.3, 0.0), 1.0)
    return total / len(points)


@linked(from_python=True)
def _links(
    position: FloatArray,
    direction: FloatArray,
    curvature: float,
    colour: FloatArray,
    strength: float,
    own: int,
    positions: FloatArray,
    directions: FloatArray,
    curvatures: FloatArray,
    colours: FloatArray,
    strengths: FloatArray,
    image: Image,
    width: float,
    plane: FloatArray,
    limit: float,
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], FloatArray]:
    """Costs, plane lengths, indices and costs of what is unseen of the links from a place.

    A strength of 0 is that of a clamp.
    """
    count = len(positions)
    directed = direction[0] != 0.0 or direction[1] != 0.0
    back = (BACK if strength > 0.0 else BACK_OF_CLAMP) * width
    basic = np.empty(count)
    rank = np.empty(count)
    for j in range(count):
        rank[j] = basic[j] = math.inf
        if j // 2 == own:
            continue
        if directed:
            cost, gap = _bend(
                position,
                direction,
                curvature,
                positions[j],
                directions[j],
                curvatures[j],
                width,
                back,
            )
        else:
            dx, dy = positions[j, 0] - position[0], positions[j, 1] - position[1]
            gap = math.sqrt(dx * dx + dy * dy)
            cost = 0.25 * (gap / width) ** 2 if gap < BESIDE * width else math.inf
        if cost >= limit:
            continue
        if strength > 0.0:
            square = 0.0
            for c in range(3):
                square += (colours[j, c] - colour[c]) ** 2
            scale = 0.5 * max(strength, strengths[j])
            cost += COLOUR * min(square / (scale * scale), 6.0) + LINK
        basic[j] = cost
        rank[j] = cost + PREFER_NEAR * gap / width
    costs = np.empty(min(EXAMINED, count))
    lengths = np.empty(len(costs))
    reached = np.empty(len(costs), dtype=np.int64)
    unseen = np.empty(len(costs))
    found = 0
    for _ in range(len(costs)):
        j = 0
        for k in range(1, count):
            if rank[k] < rank[j]:
                j = k
        if math.isinf(rank[j]):
            break
        rank[j] = math.inf
        if not basic[j] < limit:
            continue
        out = direction if directed else -directions[j]
        points = bridge(position, out, positions[j], -directions[j])
        own_colour = colour if strength > 0.0 else colours[j]
        share = _unlike(points, own_colour, strength if strength > 0.0 else strengths[j], image)
        pixels = 0.0
        for k in range(1, len(points)):
            pixels += math.sqrt(
                (points[k, 0] - points[k - 1, 0]) ** 2 + (points[k, 1] - points[k - 1, 1]) ** 2
            )
        hidden = (UNSEEN * share + HIDDEN) * pixels / width
        cost = basic[j] + hidden
        if cost < limit:
            costs[found] = cost
            unseen[found] = hidden
            lengths[found] = polyline_length(plane, points)
            reached[found] = j
            found += 1
    return costs[:found], lengths[:found], reached[:found], unseen[:found]


def split_at(chains: list[Chain], point: FloatArray, width: float) -> list[Chain]:
    """Cut chains where they pass a clamp, so that a path can start or end there."""
    result: list[Chain] = []
    least = max(4, round(1.0 * width))
    for chain in chains:
        distance = np.hypot(*(chain.points - point).T)
        at = int(np.argmin(distance))
        if distance[at] > 1.5 * width:
            result.append(chain)
            continue
        parts = (chain.part(0, at + 1), chain.part(at, len(distance)))
        result.extend(part for part in parts if len(part.points) >= least)
    return result
