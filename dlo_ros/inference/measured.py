# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings as numbers: residuals across and along the DLO."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import InputError
from dlo_ros.inference.first_motion import frames_at_rest
from dlo_ros.inference.forecast import Manipulation, Window, as_started, unit_of
from dlo_ros.inference.observation_operator import directions, noise_unit, operator_of
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.inference.spectrum import motion_power
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis


@dataclass(frozen=True)
class Recording:
    """One recording with what turns a difference of shapes into numbers.

    Args:
        manipulation: commands and observations of the recording.
        observed: control points [m], shape (F, n, 3).
        times: times since the first frame [s], shape (F,).
        across: matrices that map differences of control points to coefficients, shape (F, K, n, 3);
            the squares of these sum to the mean squared distance along u. The first n are normal to
            the observed curve in the board's plane, then those along it, then those out of the
            plane where a recording leaves it.
        noise: standard deviation of each coefficient [m], shape (K,).
        spans: knot spans of the simulation; None: as simulation.tolerance asks.
        tolerance: tolerance of the simulation's time steps; None: simulation.tolerance.
        rapid: smaller tolerances for models with an effect that makes the DLO move more rapidly, by
            the effect's name.
        beyond: difference of measured points from the observed splines, in coefficients [m], shape
            (F, K). Of pictures with points, `across` and it are those of `observation_operator`.
        frames_at_rest: number of its first frames in which the command holds the DLO still.
    """

    manipulation: Manipulation
    observed: FloatArray
    times: FloatArray
    across: FloatArray
    noise: FloatArray
    spans: int | None = None
    tolerance: float | None = None
    rapid: Mapping[str, float] = field(default_factory=dict)
    beyond: FloatArray | None = None
    frames_at_rest: int = 0

    @property
    def name(self) -> str:
        """Of the bag."""
        return self.manipulation.name

    @property
    def planar(self) -> bool:
        """Whether the DLO stays in the board's plane, in all recordings that are compared."""
        return len(self.noise) <= 2 * int(self.observed.shape[1])

    def tolerance_with(self, effects: Iterable[str]) -> float | None:
        """Tolerance of the time steps for a model with some effects; None: simulation.tolerance."""
        least = [self.rapid[name] for name in effects if name in self.rapid]
        return min(least, default=self.tolerance)

    @cached_property
    def motion(self) -> FloatArray:
        """Power of the observed motion at each frequency [m^2], shape (F,)."""
        return motion_power(self.coefficients(self.observed - self.observed.mean(axis=0)))

    def coefficients(self, points: FloatArray) -> FloatArray:
        """Coefficients of differences of control points [m].

        Args:
            points: shape (F, ..., n, 3).

        Returns:
            Shape (F, ..., K).
        """
        return np.asarray(np.einsum("fknc,f...nc->f...k", self.across[-len(points) :], points))

    def residual(self, predicted: FloatArray) -> FloatArray:
        """Coefficients of observed minus predicted shapes [m], shape (F, K).

        Args:
            predicted: control points, shape (F, n, 3 or more), of the last F frames.
        """
        frames = len(predicted)
        result = self.coefficients(self.observed[-frames:] - predicted[..., :3])
        return result if self.beyond is None else result + self.beyond[-frames:]

    def moved(self, error: FloatArray) -> Recording:
        """The recording with shapes moved by a simulation's error, which a residual then lacks.

        Args:
            error: control points of that simulation minus those of an exact one [m], shape (F, n,
                3), of the last F frames.
        """
        observed = self.observed.copy()
        observed[-len(error) :] += error
        return replace(self, observed=observed)

    def until(self, stop: int) -> Recording:
        """Its first frames."""
        return self if stop >= len(self.times) else self.of(np.arange(stop))

    def of(self, frames: NDArray[np.int64]) -> Recording:
        """Some of its frames, of which the first is the new beginning."""
        observations = tuple(self.manipulation.observations[k] for k in frames)
        times = self.times[frames]
        return replace(
            self, manipulation=replace(self.manipulation, observations=observations),
            observed=self.observed[frames], times=times - times[0], across=self.across[frames],
            beyond=None if self.beyond is None else self.beyond[frames],
            frames_at_rest=int(np.sum(frames < self.frames_at_rest)),
        )  # fmt: skip


def leaves_plane(manipulation: Manipulation, settings: Settings) -> bool:
    """Whether an observed shape of a recording leaves the board's plane."""
    most = 1e-6 * settings.rod.length
    return any(np.abs(o.control_points[:, 1]).max() > most for o in manipulation.observations)


def measured(
    manipulation: Manipulation, settings: Settings, *, spatial: bool | None = None
) -> Recording:
    """A recording whose noise is not known yet.

    Args:
        spatial: whether errors out of the plane count: those of recordings that are compared with
            one another do if one of them leaves it; None: whether this one does.

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
    spatial = leaves_plane(manipulation, settings) if spatial is None else spatial
    across = spline_space(observed, settings, spatial=spatial)
    times = (stamps - stamps[0]) * 1e-9
    length, begins = settings.rod.length, as_started(settings, manipulation).simulation.start
    still = begins == "equilibrium" and not isinstance(manipulation, Window)
    recording = Recording(
        manipulation, observed, times, across, np.ones(across.shape[1]),
        frames_at_rest=frames_at_rest(manipulation, length) if still else 0,
    )  # fmt: skip
    return _with_points(recording, length)


def _with_points(recording: Recording, length: float) -> Recording:
    """The recording with measured points in place of their splines."""
    observations = recording.manipulation.observations
    unit = unit_of(recording.manipulation) or noise_unit(observations, length)
    if unit is None:
        return recording
    across = recording.across.copy()
    beyond = np.zeros(across.shape[:2])
    parts = across.shape[1] // across.shape[2]
    for k, observation in enumerate(observations):
        points = operator_of(observation, length)
        if points is not None:
            across[k] = unit * points.rows[:parts].reshape(across.shape[1:])
            beyond[k] = unit * points.residual(recording.observed[k])[:parts].ravel()
    return replace(recording, across=across, beyond=beyond)


def _without_copies(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """The observations without those that repeat the one before: they measure nothing anew."""
    kept = [observations[0]]
    for o in observations[1:]:
        if not np.array_equal(o.control_points, kept[-1].control_points):
            kept.append(o)
    return tuple(kept)


def spline_space(observed: FloatArray, settings: Settings, *, spatial: bool) -> FloatArray:
    """`Recording.across` of observed splines without points, shape (F, K, n, 3).

    Args:
        spatial: whether differences out of the plane count.

    Raises:
        InputError: they have another number of control points than the settings.
    """
    n, length = settings.rod.control_points, settings.rod.length
    if observed.shape[1] != n:
        raise InputError(
            f"the observed splines have {observed.shape[1]} control points; "
            f"rod.control_points is {n}"
        )
    basis = SplineBasis(n, length)
    u, weight = basis.quadrature()
    values = basis.matrix(u)
    fields = directions(basis.matrix(u, 1) @ observed)[: 3 if spatial else 2]
    project = np.linalg.inv(whitening(n, length)) @ (values * weight[:, None]).T / length  # (n, q)
    parts = [np.einsum("kq,fqc,qn->fknc", project, d, values, optimize=True) for d in fields]
    return np.concatenate(parts, axis=1)
