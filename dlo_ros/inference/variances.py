# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Error variances by marginal likelihood, with the model's parameters integrated out.

Each recording's error has five components in each direction: noise, white along the DLO; noise of
single control points, which is smoother where these are what is measured; of both, neighbouring
frames share a part where a tracker smooths them (AR(1)); an error that dies out over
time (AR(1) as well), which is what the model lacks; and errors that stay, such as those of a
calibration, and those of edges and shading where the DLO rests: frames of one pose are one
measurement. What the model lacks and what a calibration does are smooth along the DLO. Their
variances maximise the marginal likelihood (REML; Patterson and Thompson, Recovery of inter-block
information, 1971); the model's discrepancy thus widens the posterior (Kennedy and O'Hagan, Bayesian
calibration of computer models, 2001). Nothing is simulated for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.spline import FloatArray

LEAST_NOISE = 2e-6
"""Smallest standard deviation over L: below, rounding and time steps would count as noise."""
LARGEST = 1.0
"""Largest standard deviation of any component over L."""
REPEATED_STD = 0.003
"""Prior standard deviation over L of the errors that stay or die out: careful calibrations err
less, and what a model lacks is rather explained than put up with (Simpson et al., Penalising model
component complexity, 2017)."""
FEWEST_FRAMES = 4
"""Frames below which an error that dies out cannot be told from one that stays."""
LONGEST_MEMORY = 0.998
"""Largest correlation of neighbouring frames in what the model lacks."""
NOISE_MEMORY = 0.9
"""The same of the noise: trackers look back over a few frames, and no further."""
ITERATIONS = 40
LEAST_START = 0.01
"""Share of what the residuals suggest that a variance is at the beginning of a search at least."""


@dataclass(frozen=True)
class Variances:
    """Error variances of one recording, each in D directions; mean squares along the DLO [m^2].

    Args:
        white: of noise that is white along the DLO, shape (D,).
        nodal: of noise that every control point has of its own, shape (D,).
        fading: smooth along the DLO, shape (D,).
        lasting: the same in all frames, smooth along the DLO, shape (D,).
        rough: the same in all frames, white along the DLO, shape (D,).
        memory: correlation of neighbouring frames of the fading error.
        noise_memory: the same of both kinds of noise.
    """

    white: FloatArray
    nodal: FloatArray
    fading: FloatArray
    lasting: FloatArray
    rough: FloatArray
    memory: float
    noise_memory: float

    def of(self, spectrum: Spectrum) -> FloatArray:
        """Variance of a number in each bin [m^2], shape (B,)."""
        p = spectrum.part
        fading = self.fading[p] * density(self.memory, spectrum.frequency) * spectrum.share
        lasting = self.lasting[p] * spectrum.share + self.rough[p] * spectrum.white
        noise = self.white[p] * spectrum.white + self.nodal[p] * spectrum.nodal
        noise *= density(self.noise_memory, spectrum.frequency)
        still = np.where(spectrum.frequency == 0.0, spectrum.frames, 0.0)
        return np.asarray(noise + fading + still * lasting)


@dataclass(frozen=True)
class Posterior:
    """Gaussian posterior of the parameters' change, and the marginal likelihood.

    Args:
        step: mean of the change, shape (P,).
        covariance: shape (P, P).
        evidence: log marginal likelihood, up to a constant of the data.
    """

    step: FloatArray
    covariance: FloatArray
    evidence: float


def posterior(
    spectra: Sequence[Spectrum], variances: Sequence[Variances], offset: FloatArray,
    precision: FloatArray,
) -> Posterior:  # fmt: skip
    """Linearised posterior for given variances.

    Args:
        offset: centre of the prior minus the point of linearisation, shape (P,).
        precision: inverse variances of the prior, shape (P,).
    """
    value, step, covariance, _ = _marginal(
        spectra, [v.of(s) for s, v in zip(spectra, variances, strict=True)], offset, precision
    )
    return Posterior(step, covariance, -value)


def _marginal(
    spectra: Sequence[Spectrum], v: Sequence[FloatArray], offset: FloatArray, precision: FloatArray
) -> tuple[float, FloatArray, FloatArray, list[FloatArray]]:
    """Minus the log marginal likelihood, step, covariance, and its derivatives by variances."""
    lhs, rhs = np.diag(precision), precision * offset
    value = float(offset @ rhs) - float(np.sum(np.log(precision)))
    for s, x in zip(spectra, v, strict=True):
        lhs = lhs + np.einsum("b,bpq->pq", 1.0 / x, s.hessian)
        rhs = rhs + (1.0 / x) @ s.gradient
        value += float(s.count @ np.log(x) + s.power @ (1.0 / x))
    scale = 1.0 / np.sqrt(np.diag(lhs))
    factor = cho_factor(lhs * np.outer(scale, scale) + 1e-13 * np.eye(len(scale)))
    step = scale * cho_solve(factor, scale * rhs)
    covariance = cho_solve(factor, np.diag(scale)) * scale[:, None]
    value -= float(rhs @ step)
    value += 2.0 * float(np.sum(np.log(np.diag(factor[0]))) - np.sum(np.log(scale)))
    slopes = []
    spread = covariance + np.outer(step, step)
    for s, x in zip(spectra, v, strict=True):
        left = s.power - 2.0 * s.gradient @ step + np.einsum("bpq,pq->b", s.hessian, spread)
        slopes.append(0.5 * (s.count / x - left / x**2))
    return 0.5 * value, step, covariance, slopes


def fit_variances(
    spectra: Sequence[Spectrum], offset: FloatArray, precision: FloatArray, length: float,
    start: Sequence[Variances] | None = None, iterations: int = ITERATIONS,
) -> tuple[tuple[Variances, ...], Posterior]:  # fmt: skip
    """Variances that maximise the marginal likelihood, and the posterior with them.

    White noise is each recording's own; what the model lacks and what the camera does wrong is
    common to all: a recording that fits badly is no less worth than the others.

    Args:
        offset, precision: of the prior, see `posterior`.
        length: of the DLO [m].
        start: of the search; default: from the residuals.
        iterations: of the search at most.
    """
    x0 = _packed([guess(s, length) for s in spectra])
    if start:
        # The likelihood is flat where a component is nearly zero.
        x0 = np.maximum(_packed(start), x0 + np.log(LEAST_START))
    bounds = _bounds(spectra, length)

    def cost(x: FloatArray) -> tuple[float, FloatArray]:
        found = _unpacked(x, spectra)
        v = [f.of(s) for s, f in zip(spectra, found, strict=True)]
        value, _, _, slopes = _marginal(spectra, v, offset, precision)
        return _with_prior(value, _slope(spectra, found, slopes), found[0], length)

    x0 = np.clip(x0, [b[0] for b in bounds], [b[1] for b in bounds])
    done = minimize(
        cost, x0, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": iterations}
    )
    found = _unpacked(done.x, spectra)
    best = posterior(spectra, found, offset, precision)
    return found, replace(best, evidence=best.evidence - _improbability(found[0], length))


def guess(spectrum: Spectrum, length: float) -> Variances:
    """Variances from the residuals as they are."""
    least = (LEAST_NOISE * length) ** 2
    high = spectrum.frequency > 0.5 * np.pi
    rough = high & (spectrum.share < 0.05)
    still = spectrum.frequency == 0.0
    white, fading, staying = [], [], []
    for part in range(spectrum.parts):
        mine = spectrum.part == part
        pick = mine & rough if np.any(mine & rough) else mine & (spectrum.share < 0.05)
        pick = pick if np.any(pick) else mine
        each = float(np.sum(spectrum.power[pick]) / np.sum(spectrum.count[pick]))
        white.append(max(each / float(spectrum.white[0]), least))
        fading.append(max(float(np.sum(spectrum.power[mine])) / spectrum.frames, least))
        pick = mine & still & (spectrum.share <= np.median(spectrum.share[mine & still]))
        each = float(np.sum(spectrum.power[pick]) / np.sum(spectrum.count[pick]))
        staying.append(max(each / float(spectrum.white[0]) / spectrum.frames, least))
    noise, smooth = np.array(white), np.array(fading)
    return Variances(noise, noise, smooth, 0.1 * smooth, np.array(staying), 0.9, 0.0)


def _packed(found: Sequence[Variances]) -> FloatArray:
    """Logarithms: each recording's white noise, what is common to all, and the two memories."""
    nodal = np.mean([v.nodal for v in found], axis=0)
    fading = np.mean([v.fading for v in found], axis=0)
    lasting = np.mean([v.lasting for v in found], axis=0)
    rough = np.mean([v.rough for v in found], axis=0)
    own = [np.log(v.white) for v in found]
    common = [np.log(nodal), np.log(fading), np.log(lasting), np.log(rough)]
    memories = [np.log1p(-found[0].memory), np.log1p(-found[0].noise_memory)]
    return np.concatenate([*own, *common, memories])


def _unpacked(x: FloatArray, spectra: Sequence[Spectrum]) -> tuple[Variances, ...]:
    parts = spectra[0].parts
    rows = np.exp(x[:-2]).reshape(-1, parts)
    memory, noise_memory = (float(m) for m in -np.expm1(x[-2:]))
    nodal, fading, lasting, rough = rows[len(spectra) :]
    return tuple(
        Variances(rows[k], nodal, fading, lasting, rough, memory, noise_memory)
        for k in range(len(spectra))
    )


def _bounds(spectra: Sequence[Spectrum], length: float) -> list[tuple[float, float]]:
    low, high = 2.0 * np.log(LEAST_NOISE * length), 2.0 * np.log(LARGEST * length)
    parts = spectra[0].parts
    told = max(s.frames for s in spectra) >= FEWEST_FRAMES
    fading = (low, high) if told else (low - 20.0, low - 20.0)
    memory = (np.log1p(-LONGEST_MEMORY), np.log(0.9))
    noise_memory = (np.log1p(-NOISE_MEMORY) if told else 0.0, 0.0)
    noise = [(low, high)] * (parts * len(spectra)) + [(low - 5.0, high)] * parts
    staying = [(low - 5.0, high)] * (2 * parts)
    return [*noise, *[fading] * parts, *staying, memory, noise_memory]


def _slope(
    spectra: Sequence[Spectrum], found: Sequence[Variances], slopes: Sequence[FloatArray]
) -> FloatArray:
    """Derivatives by the packed numbers, from those by the bins' variances."""
    parts = spectra[0].parts
    white, common, memories = [], np.zeros((4, parts)), np.zeros(2)
    for s, v, slope in zip(spectra, found, slopes, strict=True):
        density_, rate = density(v.memory, s.frequency), _rate(v.memory, s.frequency)
        noise = density(v.noise_memory, s.frequency)
        lasting = np.where(s.frequency == 0.0, s.frames, 0.0)
        own = np.zeros(parts)
        for part in range(parts):
            mine = np.where(s.part == part, slope, 0.0)
            own[part] = v.white[part] * float(mine @ (noise * s.white))
            common[0, part] += v.nodal[part] * float(mine @ (noise * s.nodal))
            common[1, part] += v.fading[part] * float(mine @ (density_ * s.share))
            common[2, part] += v.lasting[part] * float(mine @ (lasting * s.share))
            common[3, part] += v.rough[part] * float(mine @ (lasting * s.white))
        white.append(own)
        memories[0] -= float(np.sum(slope * v.fading[s.part] * s.share * rate))
        rate = _rate(v.noise_memory, s.frequency)
        noise = v.white[s.part] * s.white + v.nodal[s.part] * s.nodal
        memories[1] -= float(np.sum(slope * noise * rate))
    return np.concatenate([*white, common.ravel(), memories])


def _rate(memory: float, frequency: FloatArray) -> FloatArray:
    """Derivative of `density` by minus the logarithm of one minus the memory."""
    cosine = np.cos(frequency)
    below = 1.0 - 2.0 * memory * cosine + memory**2
    slope = (-2.0 * memory * below - (1.0 - memory**2) * (2.0 * memory - 2.0 * cosine)) / below**2
    return np.asarray((1.0 - memory) * slope)


def _with_prior(
    value: float, slope: FloatArray, found: Variances, length: float
) -> tuple[float, FloatArray]:
    """Cost and derivatives, with the prior of errors that are not new in every frame."""
    common = np.concatenate([found.fading, found.lasting, found.rough])
    slope[-2 - len(common) : -2] += 0.5 * common / (REPEATED_STD * length) ** 2
    return value + _improbability(found, length), slope


def _improbability(found: Variances, length: float) -> float:
    """Minus the log prior of errors that are not new in every frame."""
    variances = np.sum(found.fading + found.lasting + found.rough)
    return 0.5 * float(variances) / (REPEATED_STD * length) ** 2


def density(memory: float, frequency: FloatArray) -> FloatArray:
    """Spectral density of an AR(1) process of unit variance."""
    return np.asarray((1.0 - memory**2) / (1.0 - 2.0 * memory * np.cos(frequency) + memory**2))
