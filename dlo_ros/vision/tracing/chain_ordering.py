# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Orders chains into one DLO from its start to its end.

Best-first search over sequences of chains. Known clamps fix where a path starts and ends; the known
length decides between paths that are equally smooth. Which of several that are equally plausible
is the DLO, `course_choice` decides.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_map import RidgeMap
from dlo_ros.vision.tracing.chain_linking import (
    COLOUR,
    Continuation,
    Linker,
    bridge,
    split_at,
)
from dlo_ros.vision.tracing.course_choice import distance, on_two_strands
from dlo_ros.vision.tracing.metric_lengths import PlaneGrid
from dlo_ros.vision.tracing.ridge_tracing import Chain

LENGTH_STD = 0.03  # of the length: how well the seen length is expected to agree
LENGTH_LIMIT = 0.15  # of the length: a path further off is none
LEAST_COVERED = 0.45  # of the length by chains, the rest by bridges
FREE_END = 1.5  # cost of ending where no clamp says so
CARRIED_ON = 4.0
"""Cost of a link below which an end is doubtful: another DLO would begin there, straight ahead, by
chance. Where the length is a criterion, it says that by itself."""
MOST_EXPANSIONS = 1500
SAME_LENGTH = 0.02  # of the length: paths to one chain that differ by less are not kept apart
MOST_LINKS = 8  # tried from each end
DIFFERENT = 4.0  # [widths] two paths that are nowhere further apart are one, if on one strand
ARRIVALS = 4  # courses of one length to one chain that are followed: strands may lie side by side
COST_LIMIT = 9.0  # of a whole course without what is unseen of it, and more the longer it is
COST_LIMIT_PER_WIDTH = 0.02
AMBIGUITY = 2.0  # a second path that is dearer by less makes the first doubtful
MEASURED = 4.0  # one that is dearer by less is measured, too, as long as there are not too many

MANY_COURSES = "many courses of the DLO are equally plausible (an ambiguous crossing or gap)"


@dataclass(frozen=True)
class LengthRule:
    """Lengths that a course may have, as shares of the DLO's.

    Args:
        shortest, longest: limits of the length; a course beyond them is dropped.
        std: standard deviation of the length; infinite where the length is no criterion.
        unit: unit of the plane in which lengths are taken, for people.
    """

    shortest: float = 1.0 - LENGTH_LIMIT
    longest: float = 1.0 + LENGTH_LIMIT
    std: float = LENGTH_STD
    unit: str = "m"


@dataclass(frozen=True, eq=False)
class ClampPixel:
    """A clamp in the picture: position [px] and unit direction of growing u, shapes (2,).

    The direction is None where only the end's position is known.
    """

    position: FloatArray
    direction: FloatArray | None


@dataclass(frozen=True, eq=False)
class Path:
    """An ordered centreline in pixels of the bar map.

    Args:
        points: shape (m, 2), from the start to the end.
        seen: whether a chain lies there (else a bridge), shape (m,).
        cost: cost of the links and of the length.
        length: length in the unit of the plane.
        contrast: median contrast of the chains [grey levels].
        colour: colour of the DLO, BGR, shape (3,).
    """

    points: FloatArray
    seen: np.ndarray
    cost: float
    length: float
    contrast: float
    colour: FloatArray


@dataclass(frozen=True, eq=False)
class _Partial:
    cost: float
    unseen: float  # share of the cost
    length: float
    chains: tuple[int, ...]  # chain * 2 + (1 where it is run through backwards)


def _same_course(one: _Partial, other: _Partial) -> bool:
    """Whether two paths differ in nothing but chains that one of them leaves out."""
    short, long = sorted((one.chains, other.chains), key=len)
    rest = iter(long)
    return all(state in rest for state in short)


def alike(chain: Chain, path: Path) -> bool:
    """Whether a chain's colour is so near to a path's that it may be another part of the DLO.

    A link between them would cost less for its colour than plausible courses may differ.
    """
    scale = 0.5 * max(path.contrast, chain.strength)
    change = float(np.sum((chain.colour - path.colour) ** 2)) / scale**2
    return COLOUR * change < AMBIGUITY


class PathSearch:
    """Finds the path of a DLO of known length through chains.

    Args:
        chains: chains from `find_chains`, in pixels of the bar map.
        bars: the bar map.
        length: length of the DLO, in the unit of the plane.
        plane: grid of the board's plane, in which lengths are true.
        start, end: clamps where they are known, in pixels of the bar map.
        rule: lengths that a course may have.
    """

    def __init__(
        self,
        chains: list[Chain],
        bars: RidgeMap,
        length: float,
        plane: PlaneGrid,
        start: ClampPixel | None,
        end: ClampPixel | None,
        rule: LengthRule = LengthRule(),
    ) -> None:
        for clamp in (start, end):
            if clamp is not None:
                chains = split_at(chains, clamp.position, bars.width)
        self.chains, self.bars, self.length, self.plane = chains, bars, length, plane
        self.start, self.end, self.rule = start, end, rule
        self._linker = Linker(chains, bars, plane)
        self.ends = self._linker.ends
        self.lengths = np.array([self._measure(c.points) for c in chains])
        self._links: dict[int, list[Continuation]] = {}
        self._closings: dict[int, tuple[float, float, float]] | None = None

    def _measure(self, points: FloatArray) -> float:
        return self.plane.length(points, max(1, round(self.bars.width / 2)))

    def candidates(self, most: int) -> list[Path]:
        """The best paths that run differently, the best one first.

        Args:
            most: largest number of candidates; pictures that show more are refused.

        Raises:
            VisionError: no path of about the right length, or too many that are equally good.
        """
        if not self.chains:
            raise VisionError("nothing in the picture looks like a DLO of the expected width")
        heap: list[tuple[float, int, _Partial]] = []
        for first in self._beginnings():
            heapq.heappush(heap, (first.cost, len(heap), first))
        counter = len(heap)
        complete: list[tuple[float, _Partial]] = []
        visited: dict[int, list[_Partial]] = {}
        longest, least = 0.0, np.inf
        expansions = 0
        while heap and expansions < MOST_EXPANSIONS:
            cost, _, partial = heapq.heappop(heap)
            if cost > least + MEASURED:
                break
            visits = visited.setdefault(partial.chains[-1], [])
            limit = SAME_LENGTH * self.length
            alike = [other for other in visits if abs(partial.length - other.length) < limit]
            if len(alike) >= ARRIVALS or any(_same_course(partial, other) for other in alike):
                continue  # cheaper paths came here
            visits.append(partial)
            expansions += 1
            longest = max(longest, partial.length)
            closing, rest, unseen = self._close(partial.chains[-1])
            total = partial.length + rest
            covered = sum(float(self.lengths[state // 2]) for state in partial.chains)
            right = self.rule.shortest < total / self.length < self.rule.longest
            if np.isfinite(closing) and right and covered > LEAST_COVERED * total:
                penalty = 0.5 * ((total / self.length - 1.0) / self.rule.std) ** 2
                whole = replace(partial, unseen=partial.unseen + unseen)
                complete.append((cost + closing + penalty, whole))
                least = min(least, complete[-1][0])
            used = {state // 2 for state in partial.chains}
            for link, gap, state, unseen in self._next(partial.chains[-1]):
                if state // 2 in used:
                    continue
                length = partial.length + gap + float(self.lengths[state // 2])
                if length > self.rule.longest * self.length:
                    continue
                counter += 1
                chain = (*partial.chains, state)
                new = _Partial(cost + link, partial.unseen + unseen, length, chain)
                heapq.heappush(heap, (new.cost, counter, new))
        if not complete:
            where = "between the clamps" if self.start and self.end else "in the picture"
            raise VisionError(
                f"no continuous DLO of the length {self.length:.3g} {self.rule.unit} found {where} "
                f"(the longest piece is {longest:.3g} {self.rule.unit}): it is hidden, or "
                "rod.length or the camera's pose is another"
            )
        complete.sort(key=lambda item: item[0])
        best = complete[0]
        best_points = self._path(*best).points  # about 1 px apart
        # Something may hide a smooth course for long; whether the board is bare there, others see.
        bends = best[0] - best[1].unseen
        if bends > COST_LIMIT + COST_LIMIT_PER_WIDTH * len(best_points) / self.bars.width:
            raise VisionError("the only course of the right length bends and jumps too much")
        kept = [best]
        for cost, partial in complete[1:]:
            if cost - best[0] > MEASURED or (len(kept) == most and cost - best[0] > AMBIGUITY):
                break
            if all(self._differ(p, partial) for _, p in kept):
                kept.append((cost, partial))
                if len(kept) > most:
                    raise VisionError(MANY_COURSES)
        return [self._path(*one) for one in kept]

    def _beginnings(self) -> list[_Partial]:
        """The paths to start with, of one chain each."""
        if self.start is not None:
            return [
                _Partial(cost, unseen, gap + float(self.lengths[state // 2]), (state,))
                for cost, gap, state, unseen in self._from_clamp(self.start, forward=True)
            ]
        strong = 0.3 * float(np.max(self.ends.strengths))
        return [
            _Partial(self._free_end(k), 0.0, float(self.lengths[k // 2]), (k,))
            for k in range(len(self.ends))
            if self.ends.strengths[k] > strong
        ]

    def _from_clamp(self, clamp: ClampPixel, forward: bool) -> list[Continuation]:
        """Links between a clamp and chains, run through forwards or backwards."""
        direction = clamp.direction
        if direction is not None and not forward:
            direction = -direction
        # Entering at the first point runs a chain forwards; an end clamp is reached from the
        # last point of a chain that runs forwards.
        links = self._linker.from_clamp(clamp.position, direction)
        return [
            link if forward else link._replace(end=link.end ^ 1) for link in links[: 2 * MOST_LINKS]
        ]

    def _clamp_bridge(self, clamp: ClampPixel, k: int, forward: bool) -> FloatArray:
        position, direction = self.ends.positions[k], -self.ends.directions[k]
        if clamp.direction is None:
            out = direction
        else:
            out = clamp.direction if forward else -clamp.direction
        points: FloatArray = bridge(clamp.position, out, position, direction)
        return points if forward else points[::-1]

    def _close(self, state: int) -> tuple[float, float, float]:
        """Cost and length from the end of a chain to the end of the DLO, and what is unseen."""
        if self.end is None:
            return self._free_end(state ^ 1), 0.0, 0.0
        if self._closings is None:
            self._closings = {
                link.end: (link.cost, link.length, link.unseen)
                for link in self._from_clamp(self.end, False)
            }
        return self._closings.get(state, (np.inf, 0.0, 0.0))

    def _free_end(self, k: int) -> float:
        """Cost of a free end of the DLO at a chain's end."""
        if np.isfinite(self.rule.std):
            return FREE_END
        carried_on = min((link.cost for link in self._next(k ^ 1)), default=CARRIED_ON)
        return FREE_END + max(CARRIED_ON - carried_on, 0.0)

    def _next(self, state: int) -> list[Continuation]:
        """Cheapest links from the exit of a chain, which is not where it was entered."""
        if state not in self._links:
            self._links[state] = self._linker.from_end(state ^ 1)[:MOST_LINKS]
        return self._links[state]

    def _bridge(self, k: int, j: int) -> FloatArray:
        ends = self.ends
        return np.asarray(
            bridge(ends.positions[k], ends.directions[k], ends.positions[j], -ends.directions[j])
        )

    @property
    def _free(self) -> bool:
        """Whether both ends are free: a path backwards is the same path then."""
        return self.start is None and self.end is None

    def _differ(self, one: _Partial, other: _Partial) -> bool:
        """Whether two paths run differently, and not only through other pieces of one course."""
        if self._free and other.chains == tuple(state ^ 1 for state in reversed(one.chains)):
            return False  # the same pieces backwards
        a, b = (self._path(0.0, partial) for partial in (one, other))
        if not self._follows(a.points, b.points):
            return True
        # Where both paths were seen beside one another, they follow two strands.
        width = self.bars.width
        return on_two_strands(a.points, a.seen, b.points, b.seen, width) or on_two_strands(
            b.points, b.seen, a.points, a.seen, width
        )

    def _follows(self, points: FloatArray, other: FloatArray) -> bool:
        """Whether two courses, shapes (m, 2), are one."""
        return distance(points, other, either_way=self._free) <= DIFFERENT * self.bars.width

    def _path(self, cost: float, partial: _Partial) -> Path:
        pieces: list[FloatArray] = []
        seen: list[np.ndarray] = []

        def add(points: FloatArray, visible: bool) -> None:
            if len(points):
                pieces.append(points)
                seen.append(np.full(len(points), visible))

        if self.start is not None:
            add(self._clamp_bridge(self.start, partial.chains[0], True)[:-1], False)
        for position, state in enumerate(partial.chains):
            points = self.chains[state // 2].points
            add(points if state % 2 == 0 else points[::-1], True)
            if position + 1 < len(partial.chains):
                add(self._bridge(state ^ 1, partial.chains[position + 1])[1:-1], False)
        if self.end is not None:
            add(self._clamp_bridge(self.end, partial.chains[-1] ^ 1, False)[1:], False)
        which = [state // 2 for state in partial.chains]
        weights = self.lengths[which]
        strengths = np.array([self.chains[k].strength for k in which])
        colours = np.array([self.chains[k].colour for k in which])
        points = np.vstack(pieces)
        return Path(
            points,
            np.concatenate(seen),
            cost,
            self._measure(points),
            float(np.average(strengths, weights=weights)),
            np.average(colours, axis=0, weights=weights),
        )
