# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A model along the observed shapes, linearised about its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dlo_ros.inference.forecast import Forecast, compared, predictions_at
from dlo_ros.inference.observation_operator import directions
from dlo_ros.inference.spectrum import Spectrum, spectrum
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.protocol import RodSimulation
from dlo_ros.rod.resolution import RECHECK_RATIO
from dlo_ros.spline import FloatArray, SplineBasis

SMALLEST_STD = 1e-6  # [m] of a residual number; below is rounding
SHORTEST_STEP = 0.01  # change of a logarithm that needs no new linearisation, and no message
NUISANCE_WEIGHT = 0.1
NEGLECTED = 1.0  # second-order part of a change of the shapes that may be neglected, in sigma
LONGEST_STEP = 1.5  # change of a logarithm at one relinearisation
FLAT = 1e-6  # of L: a residual out of the plane below that is none


@dataclass
class Linearised:
    """A least-squares problem, linearised at theta; it grows with every observation.

    Args:
        theta: ln (E, mu, c, t_r).
        normal, gradient: J^T J (4, 4) [m^2] and J^T r (4,) of all observations so far.
        sum_of_squares: sum of squared residuals [m^2].
        count: number of residuals, two for each control point as of a DLO in the plane.
    """

    theta: FloatArray
    normal: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    gradient: FloatArray = field(default_factory=lambda: np.zeros(4))
    sum_of_squares: float = 0.0
    count: int = 0

    def add(self, residual: FloatArray, derivative: FloatArray) -> None:
        """Take in an observation: residual (n, 3) [m], derivative (4, n, 3)."""
        j = derivative.reshape(4, -1)
        self.normal += j @ j.T
        self.gradient += j @ residual.ravel()
        self.sum_of_squares += float(np.sum(residual**2))
        self.count += 2 * len(residual)

    def left(self, step: FloatArray) -> float:
        """Sum of squared residuals after a step from theta, as the linear model has it [m^2]."""
        gain = 2.0 * float(self.gradient @ step) - float(step @ self.normal @ step)
        return max(self.sum_of_squares - max(gain, 0.0), 0.0)

    def scale(self, step: FloatArray) -> float:
        """Information per squared metre of residual after a step, correlation left aside."""
        return 1.0 / max(self.left(step) / max(self.count - 2, 1), SMALLEST_STD**2)


@dataclass(frozen=True)
class JudgedResolution:
    """A resolution of the simulation, and for what it was found.

    Args:
        settings: settings for which it was found.
        spans: knot spans.
        error: error of the shape, over L.
    """

    settings: Settings
    spans: int
    error: float

    def holds(self, settings: Settings) -> bool:
        """Whether it was found for about this E/mu and for no coarser tolerance."""
        ratio = settings.rod.specific_modulus / self.settings.rod.specific_modulus
        finer = self.settings.simulation.tolerance / settings.simulation.tolerance
        return max(ratio, 1.0 / ratio, finer) < RECHECK_RATIO


@dataclass
class PriorInformation:
    """Prior information on the parameters, beside the observations of the present window.

    Args:
        prior: information (4, 4) on ln (E, mu, c, t_r) that guides the search, about `guess`.
        guess: logarithms beforehand, -inf for a damping of zero.
        summary: J^T J (4, 4) from before the window, in the units of information.
        centre, pull: point of linearisation (4,), and J^T r (4,) there, of the data alone, so that
            what was known beforehand counts once.
        autocorrelation_time: integrated autocorrelation time of the residuals, in observations.
        forces: information (4, 4) of measured forces, about `force_centre`.
    """

    prior: FloatArray
    guess: FloatArray
    summary: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    centre: FloatArray = field(default_factory=lambda: np.zeros(4))
    pull: FloatArray = field(default_factory=lambda: np.zeros(4))
    autocorrelation_time: float = 1.0
    forces: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    force_centre: FloatArray = field(default_factory=lambda: np.zeros(4))

    def beyond(self, theta: FloatArray, centre: FloatArray) -> FloatArray:
        """Differences of logarithms, zero where a damping of zero has none, shape (4,)."""
        return np.subtract(theta, centre, out=np.zeros(4), where=np.isfinite(self.guess))

    def step(self, at: Linearised) -> FloatArray:
        """From where a problem is linearised towards its minimum, not too far at once, (4,)."""
        off, old, beside = (
            self.beyond(at.theta, centre) for centre in (self.guess, self.centre, self.force_centre)
        )
        step = np.zeros(4)
        for _ in range(2):  # how noisy the residuals are is known better after the first step
            scale = self.scale(at, step)
            lhs = scale * at.normal + self.prior + self.summary + self.forces
            rhs = scale * at.gradient - self.prior @ off - self.forces @ beside
            rhs += self.pull - self.summary @ old
            step = np.where(np.isfinite(self.guess), np.linalg.solve(lhs, rhs), 0.0)
        return np.asarray(step * min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300)))

    def scale(self, at: Linearised, step: FloatArray) -> float:
        """Information per squared metre of residual after a step, correlation counted."""
        return at.scale(step) / self.autocorrelation_time

    def fold(self, at: Linearised, theta: FloatArray, share: float) -> None:
        """Add the information of a window to the summary.

        Args:
            at: the window's problem.
            theta: the estimate, about which the summary is from now on, shape (4,).
            share: fraction of the older summary that is kept.
        """
        step, old = self.beyond(theta, at.theta), self.beyond(theta, self.centre)
        scale = self.scale(at, step)
        self.pull = share * (self.pull - self.summary @ old)
        self.pull = self.pull + scale * (at.gradient - at.normal @ step)
        self.summary = share * self.summary + scale * at.normal
        self.centre, self.forces = theta, share * self.forces

    def linear(self, at: Linearised, step: FloatArray) -> bool:
        """Whether a step is so short that what the linear model neglects lies below the noise."""
        # Damping is a nuisance here: it may be further off before it matters to E/mu.
        largest = max(abs(float(step[0] - step[1])), NUISANCE_WEIGHT * float(np.abs(step).max()))
        effect = np.sqrt(max(float(step @ at.normal @ step) * at.scale(step), 0.0))
        return largest < SHORTEST_STEP or largest * effect < NEGLECTED


@dataclass
class Run:
    """One run of the model along the observations.

    Args:
        at: the problem that it linearises.
        simulation: the started simulation, with sensitivities to ln (E, mu, c, t_r).
        unit: see `Window.noise_unit`.
        error: the simulation's own error, over L.
        residuals, derivatives, predicted, stamps: lists over the observations, each as in
            `Forecast`.
    """

    at: Linearised
    simulation: RodSimulation
    unit: float | None
    error: float
    residuals: list[FloatArray] = field(default_factory=list)
    derivatives: list[FloatArray] = field(default_factory=list)
    predicted: list[FloatArray] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)

    @property
    def used(self) -> int:
        """Number of observations that were taken in."""
        return len(self.stamps)

    def add(self, observations: Sequence[Observation]) -> None:
        """Advance to observations, by growing stamp, and take in their residuals.

        Raises:
            SimulationError: the motion cannot be followed; none of them is taken in then.
        """
        predictions = predictions_at(self.simulation, [o.stamp for o in observations])
        found = compared(
            observations,
            np.array([p.control_points for p in predictions]),
            np.array([p.sensitivity for p in predictions]),
            self.simulation.published,
            self.simulation.basis.even_spans,
            self.error,
            unit=self.unit,
        )
        assert found.derivative is not None
        self.residuals += list(found.residual)
        self.derivatives += list(found.derivative)
        self.predicted += list(found.predicted)
        self.stamps += [int(s) for s in found.stamps]
        for residual, derivative in zip(found.residual, found.derivative, strict=True):
            self.at.add(residual, derivative)

    def sum_of_squares_until(self, stamp: int) -> float:
        """Sum of squared residuals of the observations up to a stamp [m^2]."""
        pairs = zip(self.stamps, self.residuals, strict=True)
        return float(sum(np.sum(r**2) for s, r in pairs if s <= stamp))

    def forecast(self) -> Forecast:
        """Predicted beside observed shapes; err is left at zero."""
        return Forecast(
            np.array(self.stamps),
            np.array(self.predicted),
            np.array(self.residuals),
            np.array(self.derivatives),
            np.zeros(self.used),
            self.simulation.basis.even_spans,
            self.error,
        )

    def spectrum(self) -> Spectrum:
        """Its residuals across the DLO, along it and, in space, out of the plane, bin by bin."""
        residuals, derivatives = np.array(self.residuals), np.array(self.derivatives)
        n, length = residuals.shape[1], self.simulation.settings.rod.length
        axes = np.stack(directions(_tangents(np.array(self.predicted))))
        residual = np.einsum("dfnc,fnc->fdn", axes, residuals)
        derivative = np.einsum("dfnc,fpnc->fpdn", axes, derivatives)
        parts = 3 if np.abs(residual[:, 2]).max() > FLAT * length else 2
        return spectrum(
            residual[:, :parts].reshape(self.used, -1),
            derivative[:, :, :parts].reshape(self.used, derivative.shape[1], -1),
            n,
        )


def _tangents(predicted: FloatArray) -> FloatArray:
    """Directions of predicted shapes (F, n, 4) at their control points' abscissae, (F, n, 3)."""
    basis = SplineBasis(predicted.shape[1], 1.0)
    slope = basis.matrix(basis.greville, 1) @ predicted[:, :, :3]
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 1e-12))
