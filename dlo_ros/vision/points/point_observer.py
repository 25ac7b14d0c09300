# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Observer for another tracker's points: observed splines, or the reason why there is none.

The last shape is tried first; where it does not lead to a credible curve, or at the start, courses
through the cloud are. A list without a credible DLO raises a VisionError: a wrong shape would be
worse than none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from dlo_ros.command import END, NANOSECONDS, START, Motion
from dlo_ros.errors import VisionError
from dlo_ros.observation import CentrelinePoints, Observation, PointList
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.points.point_curve import PointCurve, fit_curve
from dlo_ros.vision.points.point_order import courses
from dlo_ros.vision.space.spatial_clamps import Clamps, clamps_at

FEWEST = 12  # points; a cubic spline of known length needs some more than it has bends
FINE = 16  # control points of the fitted curve at least, where there are points enough
POINTS_EACH = 4  # points for each control point of the fitted curve
MOST_POINTS = 250  # published points; where there are more, neighbours are averaged
FAR_OFF = 0.06  # [L] up to which points pull at the beginning
MEDIAN_OF = 9  # neighbours by u, of whose medians the first curve is made
NEAR_BY = 0.02  # [L] the same from the last shape
LONGEST_PAUSE = 0.5  # [s] after which the last shape is not tried
LEAST_INSIDE = 0.7  # share of the points that must lie on the DLO
LEAST_SEEN = 0.55  # share of the length that must be seen, as in pictures
SEEN_CELLS = 40  # parts of the length that are seen or not
MOST_STRETCH = 0.03  # of the length, several times what length and scale may be off
NOISIEST = 0.03  # [L] standard deviation of points that show no shape any more
FINER = (24, 36)  # control points where FINE are too few for the DLO's bends
IN_ROWS = 0.3  # correlation of neighbours' offsets above which the curve does not follow the points
BESIDE = 0.5  # the same, above which it is not the DLO's
ALIKE = 0.03  # [L] courses closer than this lead to the same curve
ELSEWHERE = 0.05  # [L] curves further apart than this are different ones
CLEARLY_BETTER = 3.0  # log likelihood by which one curve must be better than another: 20 to one
CLOSE = 0.03  # [L] within which outliers that lie together are neighbours
TOGETHER = 0.4  # of the neighbours of a point on the DLO that make outliers a part of a DLO
FEW = 3  # outliers, or neighbours, that may lie together by chance
GAP = 8.0  # mean distances of neighbours that a stretch without points is unusual from
LEAST_GAP = 0.05  # [L] that such a stretch is long at least
UNSEEN_END = 0.1  # [L] beyond the last point, from which a free end is a guess
TURN = 0.8  # [rad] that the DLO may turn unseen
FARTHEST_GRIP = 0.05  # [L] a curve that begins further from its grip is another one
GOOD = 0.9  # share of the points on a curve with which no other course is looked for
LEAST_TOTAL, MOST_TOTAL = 0.6, 1.6  # length of a course over L


@dataclass(frozen=True, eq=False)
class PointResult:
    """The result of a list of points.

    Args:
        observation: control points and measured points, with the list's stamp.
        residual: root mean square distance of the points from the curve [m].
        std: standard deviation of a coordinate of a point [m], the median of all.
        outliers: share of the points that lie beside the DLO.
        fraction_seen: share of the length where there are points.
        seen_length: length of the fitted curve [m]; compare with rod.length.
        tracked: whether the last shape led to it.
    """

    observation: Observation
    residual: float
    std: float
    outliers: float
    fraction_seen: float
    seen_length: float
    tracked: bool


class PointObserver:
    """Turns one list of points after the other into observed splines.

    Args:
        settings: parameter file.
        motion: the imposed motion, whose grips show which end is the start; None: nothing is held.
    """

    def __init__(self, settings: Settings, motion: Motion | None = None) -> None:
        self._settings, self._motion = settings, motion
        self._last: tuple[int, PointCurve] | None = None

    def reset(self) -> None:
        """Forget the last shape."""
        self._last = None

    def observe(self, seen: PointList) -> PointResult:
        """The observed spline of a list of points.

        Raises:
            VisionError: no credible DLO; the message says why.
        """
        length = self._settings.rod.length
        if len(seen.positions) < FEWEST:
            raise VisionError(f"{len(seen.positions)} points; {FEWEST} are needed at least")
        middle = np.median(seen.positions, axis=0)
        away = float(np.median(np.linalg.norm(seen.positions - middle, axis=1)))
        # A DLO lies within L / 2 of its middle, and the median of its points within sqrt(3) L / 2.
        if away > 1.5 * length:
            raise VisionError(
                f"half of the points lie more than {away:.3g} m from their middle, and rod.length "
                f"is {length:.3g} m; are they in metres?"
            )
        grips = clamps_at(self._motion, seen.stamp)
        tracked = self._tracked(seen, grips)
        if tracked is not None:
            curve = tracked
        elif seen.u is not None:
            curve = _along_given(seen, length, grips)
        else:
            curve = _searched(seen, length, grips)
        problem = _problem(curve, seen.positions, length, grips)
        if problem:
            self._last = None
            raise VisionError(problem)
        self._last = (seen.stamp, curve)
        return self._result(seen, curve, tracked is not None)

    def _tracked(self, seen: PointList, grips: Clamps) -> PointCurve | None:
        """The curve near the last one; None where there is none."""
        if self._last is None or seen.u is not None:
            return None
        pause = (seen.stamp - self._last[0]) / NANOSECONDS
        if not 0.0 < pause < LONGEST_PAUSE:
            return None
        last, length = self._last[1], self._settings.rod.length
        try:
            found = _fitted(seen, last.basis, last.control_points, grips, NEAR_BY * length)
        except VisionError:
            return None
        good = np.mean(found.inside) >= GOOD and not _problem(found, seen.positions, length, grips)
        return found if good else None

    def _result(self, seen: PointList, curve: PointCurve, tracked: bool) -> PointResult:
        settings = self._settings
        basis = SplineBasis(settings.rod.control_points, settings.rod.length)
        shape = np.zeros((basis.control_points, 4))
        shape[:, :3] = basis.projection(curve.basis) @ curve.control_points
        inside = curve.inside
        return PointResult(
            Observation(seen.stamp, shape, _published(seen.positions, curve)),
            float(np.sqrt(np.mean(curve.across[inside] ** 2))),
            float(np.median(curve.std[inside])),
            float(np.mean(~inside)),
            float(np.mean(_seen_cells(curve, settings.rod.length))),
            curve.stretch * settings.rod.length,
            tracked,
        )


def _basis(seen: PointList, length: float) -> SplineBasis:
    """Basis of the fitted curve: as fine as the number of points allows."""
    return SplineBasis(int(np.clip(len(seen.positions) // POINTS_EACH, 4, FINE)), length)


def _along_given(seen: PointList, length: float, grips: Clamps) -> PointCurve:
    """The curve through points whose material coordinates the tracker gives."""
    assert seen.u is not None
    if seen.u.min() < -0.02 * length or seen.u.max() > 1.02 * length:
        raise VisionError(
            f"u goes from {seen.u.min():.3g} to {seen.u.max():.3g}; it is in metres along the DLO, "
            f"0 to rod.length ({length:g} m)"
        )
    basis, u = _basis(seen, length), np.clip(seen.u, 0.0, length)
    order = np.argsort(u, kind="stable")
    middle = median_filter(seen.positions[order], size=(MEDIAN_OF, 1), mode="nearest")
    return _fitted(seen, basis, basis.fit(u[order], middle), grips, FAR_OFF * length, u)


def _searched(seen: PointList, length: float, grips: Clamps) -> PointCurve:
    """The best curve along the courses through the cloud."""
    basis = _basis(seen, length)
    start, end = grips
    turned = start is None and end is not None
    held = end if turned else start
    direction = None if held is None or held.direction is None else held.direction
    if turned and direction is not None:
        direction = -direction
    other = None if turned or end is None else end.position
    found: list[PointCurve] = []
    reason = "the points show no course that could be the DLO"
    place = None if held is None else held.position
    for course in courses(seen.positions, length, place, direction, other):
        path = course[::-1] if turned else course
        if held is None and path[-1, 0] < path[0, 0]:  # the start lies further left
            path = path[::-1]
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        if not LEAST_TOTAL < s[-1] / length < MOST_TOTAL:
            reason = (
                f"the points lie along {s[-1]:.3g} m; rod.length is {length:g} m (another frame, "
                "another unit, or a DLO of which too little was seen)"
            )
            continue
        at = np.linspace(0.0, s[-1], SEEN_CELLS)
        even = np.column_stack([np.interp(at, s, path[:, c]) for c in range(3)])
        first = basis.fit(at * length / s[-1], even)
        if any(_apart(first, basis, known) < ALIKE * length for known in found):
            continue
        try:
            found.append(_fitted(seen, basis, first, grips, FAR_OFF * length))
        except VisionError as err:
            reason = str(err)
    if not found:
        raise VisionError(reason)
    return _likeliest(found, seen.positions, length, grips)


def _fitted(
    seen: PointList,
    basis: SplineBasis,
    first: FloatArray,
    grips: Clamps,
    reach: float,
    known: FloatArray | None = None,
) -> PointCurve:
    """The curve from a first one; finer where the points lie beside it in rows."""
    points = seen.positions
    curve = fit_curve(points, basis, first, grips, std=seen.std, known=known, reach=reach)
    for fine in FINER:
        if curve.correlation < IN_ROWS or len(points) < POINTS_EACH * fine:
            break
        finer = SplineBasis(fine, basis.length)
        first = finer.projection(curve.basis) @ curve.control_points
        curve = fit_curve(points, finer, first, grips, std=seen.std, known=known, reach=reach / 2)
    return curve


def _apart(first: FloatArray, basis: SplineBasis, other: PointCurve) -> float:
    """Largest distance of two curves at the same u [m]."""
    u = np.linspace(0.0, basis.length, SEEN_CELLS)
    gap = basis.evaluate(first, u) - other.basis.evaluate(other.control_points, u)
    return float(np.linalg.norm(gap, axis=1).max())


def _likeliest(
    found: list[PointCurve],
    points: FloatArray,
    length: float,
    grips: Clamps,
) -> PointCurve:
    """The likeliest of the credible curves.

    Raises:
        VisionError: another one, elsewhere, is as likely.
    """
    credible = [c for c in found if not _problem(c, points, length, grips)]
    if not credible:
        return max(found, key=lambda c: c.likelihood)
    best = max(credible, key=lambda c: c.likelihood)
    for other in credible:
        elsewhere = _apart(other.control_points, other.basis, best) > ELSEWHERE * length
        if elsewhere and other.likelihood > best.likelihood - CLEARLY_BETTER:
            raise VisionError(
                "the points can be joined in two ways that fit alike; points in order along the "
                "DLO (u) or the command of its grips would decide"
            )
    return best


def _seen_cells(curve: PointCurve, length: float) -> NDArray[np.bool_]:
    """Parts of the length that hold a point, or lie between such that hold one."""
    cells = int(np.clip(np.count_nonzero(curve.inside) // 2, 4, SEEN_CELLS))
    at = np.minimum((curve.u[curve.inside] / length * cells).astype(int), cells - 1)
    held = np.bincount(at, minlength=cells) > 0
    between = np.convolve(np.pad(held, 1, mode="edge"), [1, 0, 1], "valid") == 2
    return np.asarray(held | between)


def _problem(
    curve: PointCurve,
    points: FloatArray,
    length: float,
    grips: Clamps,
) -> str:
    """Reason why a curve is not credible; empty where it is."""
    inside = curve.inside
    share = float(np.mean(inside))
    if np.count_nonzero(inside) < FEWEST or share < LEAST_INSIDE:
        return f"only {100 * share:.0f} % of the points lie along one curve of the DLO's length"
    spread = float(np.median(curve.std[inside]))
    if spread > NOISIEST * length:
        return f"the points scatter by {1000 * spread:.0f} mm about any curve"
    if abs(curve.stretch - 1.0) > MOST_STRETCH:
        return (
            f"the points lie along {curve.stretch * length:.3g} m; rod.length is {length:g} m "
            "(another unit, another DLO, or points in a wrong order)"
        )
    seen = float(np.mean(_seen_cells(curve, length)))
    if seen < LEAST_SEEN:
        return f"only {100 * seen:.0f} % of the DLO's length holds points"
    if curve.correlation > BESIDE:
        return "the points lie beside the curve in rows; it does not follow the DLO"
    for k, grip in enumerate(grips):
        end = curve.u[inside]
        unseen = float(length - end.max()) if k else float(end.min())
        if grip is None and unseen > UNSEEN_END * length:
            return f"the last {1000 * unseen:.0f} mm before the DLO's free end hold no points"
    problem = _elsewhere(curve, points, length) or _unseen_turn(curve, length)
    if problem:
        return problem
    for grip, at, name in zip(grips, (0.0, length), (START, END), strict=True):
        if grip is None:
            continue
        gap = curve.basis.evaluate(curve.control_points, [at])[0] - grip.position
        away = float(np.linalg.norm(gap))
        if away > FARTHEST_GRIP * length:
            return (
                f"the curve's {name} lies {1000 * away:.0f} mm from where the command holds it; "
                "check the frame of the points and of the command"
            )
    return ""


def _elsewhere(curve: PointCurve, points: FloatArray, length: float) -> str:
    """Sentence on outliers so close together that they are part of a DLO; else empty."""
    beside = points[~curve.inside]
    if len(beside) <= FEW:
        return ""
    usual = 2.0 * CLOSE * np.count_nonzero(curve.inside)
    near = cKDTree(beside).query_ball_point(beside, CLOSE * length, return_length=True) - 1
    together = np.count_nonzero(near >= max(FEW, TOGETHER * usual))
    if together <= FEW:
        return ""
    return f"{together} points lie close together beside the curve, as a part of the DLO would"


def _unseen_turn(curve: PointCurve, length: float) -> str:
    """Sentence on a turn of the curve without points that show it; else empty."""
    u = np.concatenate([[0.0], np.sort(curve.u[curve.inside]), [length]])
    gap = np.diff(u)
    for k in np.flatnonzero(gap > max(GAP * length / len(u), LEAST_GAP * length)):
        at = np.linspace(u[k], u[k + 1], SEEN_CELLS)
        tangent = curve.basis.evaluate(curve.control_points, at, 1)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        steps = np.linalg.norm(np.diff(tangent, axis=0), axis=1)
        if steps.sum() > TURN:
            return (
                f"from u = {u[k]:.3g} to {u[k + 1]:.3g} m the DLO would turn by "
                f"{np.degrees(steps.sum()):.0f} degrees without a point that shows it"
            )
    return ""


def _published(positions: FloatArray, curve: PointCurve) -> CentrelinePoints:
    """The points on the DLO in order, neighbours averaged where there are very many."""
    order = np.flatnonzero(curve.inside)[np.argsort(curve.u[curve.inside], kind="stable")]
    block = np.arange(len(order)) // -(-len(order) // MOST_POINTS)
    count = np.bincount(block)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(block, values[order]) / count)

    u = mean(curve.u)
    # The mean offset from the curve, not the mean position, which lies inside a bend.
    offset = positions - curve.basis.evaluate(curve.control_points, curve.u)
    place = curve.basis.evaluate(curve.control_points, u)
    place += np.column_stack([mean(offset[:, c]) for c in range(3)])
    std = np.sqrt(mean(curve.std**2) / count)
    return CentrelinePoints(place, u, std, mean(curve.std_along))
