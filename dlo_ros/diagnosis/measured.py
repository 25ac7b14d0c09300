# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings as numbers: residuals across and along the DLO, and the noise that they have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import comb

from dlo_ros.errors import InputError
from dlo_ros.identification.forecast import Manipulation, whitening
from dlo_ros.identification.noise import point_noise
from dlo_ros.identification.uncertainty import outliers
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

ORDERS = (2, 4, 6)
"""Of differences in time, which a smooth residual enters less and less."""
LEAST_NOISE = 2e-6
"""Of the length: below, rounding and the time step of the simulation would count as noise."""
DRAWS = 20_000
MEDIAN = 0.4549
"""Of the square of a normal variable, over its mean."""
SCATTERING = 0.45
"""Share of the stated variance of points that must be new in every picture, to be all of it."""
ALIKE_PARTS = 4
"""Of the DLO, in each of which lasting errors of a camera are alike."""
TIP = 0.05
"""Of the diameter, to which a camera sees where along the DLO it is."""
MOST_GROSS = 0.2
"""Share of the pictures up to which they may be grossly wrong; more are no exception."""
LEAST_SHARE = 0.5
"""Of the typical noise that a single coefficient may have."""


@dataclass(frozen=True)
class Recording:
    """One recording with what turns a difference of shapes into white numbers.

    Args:
        manipulation: what was imposed and seen.
        observed: control points [m], shape (F, n, 3).
        times: since the first frame [s], shape (F,).
        across: from differences of control points to coefficients, shape (F, K, n, 3); their
            squares sum to the mean squared distance along u. The first n are normal to the
            observed curve in the board's plane, then those along it, then those out of the plane
            where the recording leaves it.
        noise: standard deviation of each coefficient [m], shape (K,).
        spans: knot spans of the simulation; None: as simulation.tolerance asks.
        tolerance: of the simulation's time steps; None: simulation.tolerance.
        bias: standard deviation of what stays wrong in all pictures, in each coefficient [m],
            shape (K,); 0: nothing.
    """

    manipulation: Manipulation
    observed: FloatArray
    times: FloatArray
    across: FloatArray
    noise: FloatArray
    spans: int | None = None
    tolerance: float | None = None
    bias: FloatArray | float = 0.0

    @property
    def name(self) -> str:
        """Of the bag."""
        return self.manipulation.name

    def white(self, points: FloatArray) -> FloatArray:
        """Differences of control points in units of the noise.

        Args:
            points: shape (F, ..., n, 3).

        Returns:
            Shape (F, ..., K).
        """
        coefficients = np.einsum("fknc,f...nc->f...k", self.across[-len(points) :], points)
        return np.asarray(coefficients / self.noise)

    def residual(self, predicted: FloatArray) -> FloatArray:
        """Observed minus predicted in units of the noise, shape (F, K).

        Args:
            predicted: control points, shape (F, n, 3 or more), of the last F frames.
        """
        return self.white(self.observed[-len(predicted) :] - predicted[..., :3])

    def until(self, stop: int) -> Recording:
        """Its first frames."""
        if stop >= len(self.times):
            return self
        seen = replace(self.manipulation, observations=self.manipulation.observations[:stop])
        return replace(
            self, manipulation=seen, observed=self.observed[:stop], times=self.times[:stop],
            across=self.across[:stop],
        )  # fmt: skip

    def with_noise(self, predicted: FloatArray, settings: Settings) -> Recording:
        """The recording with its noise estimated from how residuals scatter in time."""
        unit = replace(self, noise=np.ones(len(self.noise)))
        field = unit.residual(predicted)
        return replace(self, noise=noise_of(field, self, settings))


def measured(manipulation: Manipulation, settings: Settings) -> Recording:
    """A recording whose noise is not known yet.

    Raises:
        InputError: no command or no observed shape.
    """
    if not manipulation.commands:
        raise InputError(f"{manipulation.name}: has no usable dlo/command")
    if not manipulation.observations:
        raise InputError(f"{manipulation.name}: has no usable dlo/observed")
    manipulation = replace(manipulation, observations=_without_copies(manipulation.observations))
    observed = np.array([o.control_points[:, :3] for o in manipulation.observations])
    stamps = np.array([o.stamp for o in manipulation.observations], dtype=np.int64)
    across = _across(observed, settings)
    return Recording(
        manipulation,
        observed,
        (stamps - stamps[0]) * 1e-9,
        across,
        np.ones(across.shape[1]),
    )


def without_gross(recording: Recording, missed: FloatArray) -> Recording:
    """The recording without pictures that are grossly wrong.

    Such a picture stands alone, both in what was seen and in what a model misses: a fast motion of
    the DLO stands out in the former only, and what a model gets wrong goes on in the next picture.

    Args:
        missed: observed minus predicted control points [m], shape (F, n, 3), of the last F frames.
    """
    gross = outliers(recording.observed)
    gross[-len(missed) :] &= outliers(missed)
    if not 0 < gross.sum() <= MOST_GROSS * len(gross):
        return recording
    keep = ~gross
    seen = recording.manipulation.observations
    observations = tuple(o for o, k in zip(seen, keep, strict=True) if k)
    times = recording.times[keep]
    return replace(
        recording, manipulation=replace(recording.manipulation, observations=observations),
        observed=recording.observed[keep], times=times - times[0], across=recording.across[keep],
    )  # fmt: skip


def _without_copies(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """The observations without those that repeat the one before: they measure nothing anew."""
    kept = [observations[0]]
    for o in observations[1:]:
        if not np.array_equal(o.control_points, kept[-1].control_points):
            kept.append(o)
    return tuple(kept)


def _across(observed: FloatArray, settings: Settings) -> FloatArray:
    """See `Recording.across`."""
    n, length = settings.rod.control_points, settings.rod.length
    if observed.shape[1] != n:
        raise InputError(
            f"the observed splines have {observed.shape[1]} control points; "
            f"rod.control_points is {n}"
        )
    basis = SplineBasis(n, length)
    u, weight = basis.quadrature()
    values, slopes = basis.matrix(u), basis.matrix(u, 1)
    tangent = np.einsum("qn,fnc->fqc", slopes, observed)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=2, keepdims=True), 1e-12)
    # In the board's plane, or in space by the shortest way from there.
    normal = np.cross(np.array([0.0, 1.0, 0.0]), tangent)
    size = np.linalg.norm(normal, axis=2, keepdims=True)
    normal = np.where(size > 1e-3, normal / np.maximum(size, 1e-12), np.array([1.0, 0.0, 0.0]))
    fields = [normal, tangent]
    if np.abs(observed[:, :, 1]).max() > 1e-6 * length:
        fields.append(np.cross(tangent, normal))
    project = np.linalg.inv(whitening(n, length)) @ (values * weight[:, None]).T / length  # (n, q)
    parts = [np.einsum("kq,fqc,qn->fknc", project, d, values, optimize=True) for d in fields]
    return np.concatenate(parts, axis=1)


def scatter(field: FloatArray, recording: Recording, settings: Settings) -> FloatArray:
    """Standard deviation of each coefficient from frame to frame [m], shape (K,).

    Differences in time of growing order; the smallest counts, and the median over time, so that a
    moment of violent motion does not. Where there are too few frames the stated standard deviation
    of the measured points tells, or else the differences along u.

    Args:
        field: residual coefficients [m], shape (F, K).
    """
    found = [np.sqrt(np.median(gap**2, axis=0) / MEDIAN) for gap in _gaps(field)]
    if found:
        return np.asarray(np.min(found, axis=0))
    n = settings.rod.control_points
    stated = point_noise(recording.manipulation.observations, SplineBasis(n, settings.rod.length))
    if stated:
        # `point_noise` is that of the whole shape, of which n coefficients have a share each.
        return np.full(field.shape[1], stated / np.sqrt(n))
    parts = [_along(part) for part in np.split(field, field.shape[1] // n, axis=1)]
    return np.repeat(parts, n)


def _gaps(field: FloatArray) -> list[FloatArray]:
    """Differences in time of growing order, scaled so that noise keeps its size."""
    result = []
    for order in ORDERS:
        if len(field) <= 2 * order:
            continue
        weights = np.array([1.0])
        for _ in range(order):
            weights = np.convolve(weights, [1.0, -1.0])
        weights /= np.linalg.norm(weights)
        result.append(
            np.array([weights @ field[i : i + order + 1] for i in range(len(field) - order)])
        )
    return result


def _along(field: FloatArray) -> float:
    """Noise of coefficients (F, n) from how they scatter along u, where models err smoothly [m]."""
    found = [float(np.sqrt(np.mean(field**2)))]
    for order in ORDERS:
        if field.shape[1] > 2 * order:
            gap = np.diff(field, order, axis=1) / np.sqrt(float(comb(2 * order, order)))
            found.append(float(np.sqrt(np.median(gap**2) / MEDIAN)))
    return min(found)


def with_bias(
    recordings: Sequence[Recording], predicted: Sequence[FloatArray], settings: Settings
) -> tuple[Recording, ...]:
    """Recordings that know what a camera sees wrongly in every picture.

    Where measured points scatter less from picture to picture than their stated std says, the rest
    of it stays: edges of a strand lie on pixels, and light falls from one side. Such errors are
    alike over a part of the DLO.

    Args:
        predicted: control points per recording, shape (F, n, 3 or more).
    """
    shares, stated = [], []
    for recording, shapes in zip(recordings, predicted, strict=True):
        points = [o.points for o in recording.manipulation.observations if o.points is not None]
        if not points:
            return tuple(recordings)
        std = float(np.median([np.sqrt(np.mean(p.std**2)) for p in points]))
        count = float(np.median([len(p.std) for p in points]))
        unit = replace(recording, noise=np.ones(len(recording.noise)))
        n = recording.observed.shape[1]
        field = unit.residual(shapes)[:, :n]
        # All coefficients together: of one alone a few dozen pictures tell too little.
        found = [float(np.median(gap**2)) / MEDIAN for gap in _gaps(field)]
        each = min(found) if found else float(np.median(scatter(field, recording, settings) ** 2))
        shares.append(count * each / max(std, 1e-12) ** 2)
        stated.append(std)
    # In motion a strand crosses pixels, and part of it scatters.
    if min(shares) > SCATTERING:
        return tuple(recordings)
    biased = []
    for recording, std in zip(recordings, stated, strict=True):
        bias = np.full(len(recording.noise), std / np.sqrt(ALIKE_PARTS))
        n = recording.observed.shape[1]
        bias[n : 2 * n] = np.maximum(bias[n : 2 * n], TIP * settings.rod.diameter)
        biased.append(replace(recording, bias=bias))
    return tuple(biased)


def noise_of(field: FloatArray, recording: Recording, settings: Settings) -> FloatArray:
    """Noise that each coefficient is taken to have [m], shape (K,).

    No coefficient is much better than the others, and what the camera sees along the DLO is not
    better than what it sees across.

    Args:
        field: residual coefficients [m], shape (F, K).
    """
    n = settings.rod.control_points
    each = np.maximum(scatter(field, recording, settings), recording.bias)
    least = LEAST_NOISE * settings.rod.length
    typical = max(float(np.sqrt(np.mean(each[:n] ** 2))), least)
    across = np.maximum(each[:n], LEAST_SHARE * typical)
    others = [np.maximum(part, across) for part in np.split(each[n:], (len(each) - n) // n)]
    return np.concatenate([across, *others])


def noise_floor(recording: Recording, predicted: FloatArray, settings: Settings) -> float:
    """The err that a perfect model would have [m]: mean length of the noise.

    Args:
        predicted: control points of the best model, shape (F, n, 3 or more).
    """
    n = settings.rod.control_points
    field = recording.residual(predicted) * recording.noise
    each = np.maximum(scatter(field, recording, settings), recording.bias)
    sizes = np.sqrt(np.sum(each.reshape(-1, n) ** 2, axis=1))  # across, along, out of the plane
    drawn = np.random.default_rng(0).normal(size=(DRAWS, len(sizes)))
    return float(np.mean(np.linalg.norm(drawn * sizes, axis=1)))
