# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Error variances by marginal likelihood, with the model's parameters integrated out.

Each recording's error has eight components in each direction: noise, white along the DLO; noise of
single control points, which is smoother where these are what is measured; of both, neighbouring
frames share a part where a tracker smooths them (AR(1)); what the model lacks, an error that dies
out over time (AR(1) as well) and one at the frequencies of the motion, as wrong laws make it; and
errors that stay in a recording, such as those of edges and shading where the DLO rests: frames of
one pose are one measurement; and errors that stay in all of them, as those of a calibration or of
markers beside the centreline: all recordings of one set-up measure them once. What the model lacks
and what a calibration does are smooth along the DLO. Their variances maximise the marginal
likelihood (REML; Patterson and Thompson, Recovery of inter-block information, 1971); the model's
discrepancy thus widens the posterior (Kennedy and O'Hagan, Bayesian calibration of computer models,
2001). Nothing is simulated for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from dlo_ros.inference.autoregression import ar1_rate, ar1_spectral_density
from dlo_ros.inference.fisher_scoring import scored
from dlo_ros.inference.spectrum import Spectrum, joined
from dlo_ros.inference.thresholds import FEWEST_FRAMES, SMALL_SHARE
from dlo_ros.spline import FloatArray

LEAST_NOISE = 2e-6
"""Smallest standard deviation over L: below, rounding and time steps would count as noise."""
DETAIL = 0.1
"""Smallest standard deviation of the noise over what a model misses across the DLO: finer details
do not judge a model that is so far off. Along it a measurement may be far off by itself, where u is
counted from an end that is seen too early."""
ALONG = 1
"""Number of the direction along the DLO, see `Spectrum.part`."""
LARGEST = 1.0
"""Largest standard deviation of any component over L."""
REPEATED_STD = 0.003
"""Prior standard deviation over L of the errors that stay or die out: careful calibrations err
less, and what a model lacks is rather explained than put up with (Simpson et al., Penalising model
component complexity, 2017)."""
SHARED_STD = 0.001
"""Prior standard deviation over L of errors that all recordings share: a calibrated camera errs by
so much, and a person who picks points with care. Parameters may take such an error up, and then
the prior alone tells its size."""
LEAST_SWING = 1e-4
"""Smallest error at the frequencies of the motion, over the motion."""
LONGEST_MEMORY = 0.998
"""Largest correlation of neighbouring frames in what the model lacks."""
NOISE_MEMORY = 0.9
"""The same of the noise: trackers look back over a few frames, and no further."""
ITERATIONS = 40
"""Steps of a search for variances at most."""
LEAST_START = 0.01
"""Share of what the residuals suggest that a variance is at the beginning of a search at least."""


@dataclass(frozen=True)
class Variances:
    """Error variances of one recording, each in D directions; mean squares along the DLO [m^2].

    Args:
        white: variances of noise that is white along the DLO, shape (D,).
        nodal: variances of noise that every control point has of its own, shape (D,).
        fading: smooth along the DLO, shape (D,).
        lasting: the same in all frames, smooth along the DLO, shape (D,).
        rough: the same in all frames, white along the DLO, shape (D,).
        shared: the same in all frames of all recordings, smooth along the DLO, shape (D,).
        shared_rough: the same, white along the DLO, shape (D,).
        swinging: at the frequencies of the motion, smooth along the DLO, over the mean square of
            the motion, shape (D,).
        memory: correlation of neighbouring frames of the fading error.
        noise_memory: the same of both kinds of noise, shape (D,): along the DLO what a detector
            reads off lasts longer than across it.
    """

    white: FloatArray
    nodal: FloatArray
    fading: FloatArray
    lasting: FloatArray
    rough: FloatArray
    shared: FloatArray
    shared_rough: FloatArray
    swinging: FloatArray
    memory: float
    noise_memory: FloatArray

    def of(self, spectrum: Spectrum) -> FloatArray:
        """Variance of a number in each bin [m^2], shape (B,)."""
        sizes = np.array([self.white, *self.common])
        rows = _components(spectrum, self.memory, self.noise_memory)
        return np.asarray(np.sum(sizes[:, spectrum.part] * rows, axis=0))

    @property
    def common(self) -> tuple[FloatArray, ...]:
        """Variances that all recordings have in common, shape (D,) each."""
        return (
            self.nodal, self.fading, self.lasting, self.rough, self.shared, self.shared_rough,
            self.swinging,
        )  # fmt: skip


PLACE = {field.name: k for k, field in enumerate(fields(Variances))}
"""Number of each component among the rows of `_components`."""


def _components(bins: Spectrum, memory: float, noise_memory: FloatArray) -> FloatArray:
    """Variance in each bin of each component with a variance of one, shape (8, B)."""
    noise = ar1_spectral_density(noise_memory[bins.part], bins.frequency)
    fading = ar1_spectral_density(memory, bins.frequency)
    return np.array(
        [
            noise * bins.white, noise * bins.nodal, fading * bins.share, bins.still * bins.share,
            bins.still * bins.white, bins.alike * bins.share, bins.alike * bins.white, bins.motion,
        ]
    )  # fmt: skip


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
    precision: FloatArray, *, linear: bool = True,
) -> Posterior:  # fmt: skip
    """Linearised posterior for given variances.

    Args:
        offset: centre of the prior minus the point of linearisation, shape (P,).
        precision: inverse variances of the prior, shape (P,).
        linear: whether the evidence is that of the linearised model, whose optimum no simulation
            may reach, or that of the present values.
    """
    v = np.concatenate([v.of(s) for s, v in zip(spectra, variances, strict=True)])
    return _marginal_likelihood(joined(spectra), v, offset, precision, linear)[0]


def _marginal_likelihood(
    bins: Spectrum, v: FloatArray, offset: FloatArray, precision: FloatArray, linear: bool
) -> tuple[Posterior, FloatArray]:
    """The posterior, and the derivatives of minus the log marginal likelihood by variances.

    Args:
        linear: see `posterior`.
    """
    each, hessian = 1.0 / v, bins.hessian.reshape(len(v), -1)
    lhs = np.diag(precision) + (each @ hessian).reshape(len(precision), -1)
    rhs = precision * offset + each @ bins.gradient
    value = float(offset @ (precision * offset)) - float(np.sum(np.log(precision)))
    value += float(bins.count @ np.log(v) + bins.sum_of_squares @ each)
    scale = 1.0 / np.sqrt(np.diag(lhs))
    # LAPACK itself: what SciPy checks before takes longer than these small matrices.
    factor, failed = dpotrf(lhs * np.outer(scale, scale) + 1e-13 * np.eye(len(scale)))
    if failed:
        raise np.linalg.LinAlgError("the information matrix is not positive definite")
    upper = dpotri(factor)[0]
    covariance = (upper + np.triu(upper, 1).T) * np.outer(scale, scale)
    step = covariance @ rhs
    taken = step if linear else np.zeros_like(step)
    value -= float(rhs @ taken)
    value += 2.0 * float(np.sum(np.log(np.diag(factor))) - np.sum(np.log(scale)))
    spread = covariance + np.outer(taken, taken)
    left = bins.sum_of_squares - 2.0 * bins.gradient @ taken + hessian @ spread.ravel()
    return Posterior(step, covariance, -0.5 * value), 0.5 * each * (bins.count - left * each)


def fit_variances(
    spectra: Sequence[Spectrum], offset: FloatArray, precision: FloatArray, length: float,
    start: Sequence[Variances] | None = None, iterations: int = ITERATIONS, *,
    linear: bool = True,
) -> tuple[tuple[Variances, ...], Posterior]:  # fmt: skip
    """Variances that maximise the marginal likelihood, and the posterior with them.

    White noise is each recording's own; what the model lacks and what the camera does wrong is
    common to all: a recording that fits badly is no less worth than the others.

    Args:
        offset, precision: prior means minus the point of linearisation, and inverse prior
            variances, see `posterior`.
        length: length of the DLO [m].
        start: variances at the start of the search; default: from the residuals.
        iterations: largest number of iterations.
        linear: see `posterior`.
    """
    x0 = _packed([guess(s, length) for s in spectra])
    if start:
        # The likelihood is flat where a component is nearly zero.
        x0 = np.maximum(_packed(start), x0 + np.log(LEAST_START))
    bins, rows = joined(spectra), _rows(spectra)
    bounds = _bounds(spectra, _missed(spectra, offset, precision, length), length)

    def cost(x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        value, slope, information = _cost(x, bins, rows, offset, precision, linear)
        unlikely, rate, second = _unlikely(x, rows, length)
        return value + unlikely, slope + rate, information + np.diag(second)

    x = scored(cost, x0, bounds, iterations)
    found = _unpacked(x, spectra)
    each = np.concatenate([v.of(s) for s, v in zip(spectra, found, strict=True)])
    best = _marginal_likelihood(bins, each, offset, precision, linear)[0]
    return found, replace(best, evidence=best.evidence - _unlikely(x, rows, length)[0])


def guess(spectrum: Spectrum, length: float) -> Variances:
    """Variances from the residuals as they are."""
    least = (LEAST_NOISE * length) ** 2
    high, detail = spectrum.frequency > 0.5 * np.pi, spectrum.share < SMALL_SHARE
    still = spectrum.frequency == 0.0
    white, fading, staying = [], [], []
    for part in range(spectrum.parts):
        mine = spectrum.part == part
        pick = next(p for p in (mine & high & detail, mine & detail, mine) if p.any())
        each = float(np.sum(spectrum.sum_of_squares[pick]) / np.sum(spectrum.count[pick]))
        white.append(max(each / float(spectrum.white[0]), least))
        fading.append(max(float(np.sum(spectrum.sum_of_squares[mine])) / spectrum.frames, least))
        pick = mine & still & (spectrum.share <= np.median(spectrum.share[mine & still]))
        each = float(np.sum(spectrum.sum_of_squares[pick]) / np.sum(spectrum.count[pick]))
        staying.append(max(each / float(spectrum.white[0]) / spectrum.frames, least))
    noise, smooth = np.array(white), np.array(fading)
    motion = max(float(np.sum(spectrum.count * spectrum.motion)) / spectrum.frames, least)
    return Variances(
        noise, noise, smooth, 0.1 * smooth, np.array(staying), 0.1 * smooth,
        np.array(staying), 0.1 * spectrum.parts * smooth / motion, 0.9, np.zeros(spectrum.parts),
    )  # fmt: skip


def _packed(found: Sequence[Variances]) -> FloatArray:
    """Logarithms: each recording's white noise, what is common to all, and the memories."""
    own = np.array([v.white for v in found])
    common = np.mean([v.common for v in found], axis=0)
    memories = np.log1p(-np.array([found[0].memory, *found[0].noise_memory]))
    return np.concatenate([np.log([*own, *common]).ravel(), memories])


def _rows(spectra: Sequence[Spectrum]) -> np.ndarray:
    """Place of each component's variance in each bin among the packed numbers, shape (8, B).

    Of a few frames little more than means over time is left, which recordings have together: their
    noise is that of the first.
    """
    parts, several = spectra[0].parts, _separable(spectra)
    own = parts * np.repeat(np.arange(len(spectra)) * several, [len(s.count) for s in spectra])
    common = [np.full_like(own, parts * (len(spectra) + k)) for k in range(7)]
    return np.asarray(np.array([own, *common]) + np.concatenate([s.part for s in spectra]))


def _separable(spectra: Sequence[Spectrum]) -> bool:
    """Whether recordings are long enough to tell what is new in each frame from what is not."""
    return max(s.frames for s in spectra) >= FEWEST_FRAMES


def _unpacked(x: FloatArray, spectra: Sequence[Spectrum]) -> tuple[Variances, ...]:
    parts = spectra[0].parts
    sizes, *memories = _parted(x, parts)
    rows, count = sizes.reshape(-1, parts), len(spectra)
    noises = rows[:count] if _separable(spectra) else [rows[0]] * count
    return tuple(Variances(own, *rows[count:], *memories) for own in noises)


def _parted(x: FloatArray, parts: int) -> tuple[FloatArray, float, FloatArray]:
    """Variances, memory of the fading error and memories of the noise, of packed numbers."""
    memories = -np.expm1(x[-1 - parts :])
    return np.exp(x[: -1 - parts]), float(memories[0]), memories[1:]


def _missed(
    spectra: Sequence[Spectrum], offset: FloatArray, precision: FloatArray, length: float
) -> list[float]:
    """Mean square by which the linearised model misses each recording across the DLO [m^2].

    That is where it fits best, along it, too.
    """
    least = (LEAST_NOISE * length) ** 2
    count = sum(float(s.count.sum()) for s in spectra)
    weight = count / max(sum(float(s.sum_of_squares.sum()) for s in spectra), least * count)
    hessians = [s.hessian.sum(axis=0) for s in spectra]
    gradients = [s.gradient.sum(axis=0) for s in spectra]
    lhs = np.diag(precision) + weight * np.sum(hessians, axis=0)
    step = np.linalg.solve(lhs, precision * offset + weight * np.sum(gradients, axis=0))
    moving, staying = [], 0.0
    for s in spectra:
        left = s.sum_of_squares - 2.0 * s.gradient @ step
        left += np.einsum("p,bpq,q->b", step, s.hessian, step)
        left = np.where(s.part == ALONG, 0.0, left)
        moving.append(float(left[s.still == 0.0].sum()) / s.frames)
        staying += float(left[s.still > 0.0].sum())
    # Which recording missed how much of what stays is not told: see `Spectrum.alike`.
    staying /= sum(s.frames for s in spectra)
    return [max(each + staying, 0.0) for each in moving]


def _bounds(spectra: Sequence[Spectrum], missed: Sequence[float], length: float) -> FloatArray:
    """Bounds of the packed numbers, shape (m, 2)."""
    low, high = 2.0 * np.log(LEAST_NOISE * length), 2.0 * np.log(LARGEST * length)
    parts = spectra[0].parts
    separable = _separable(spectra)
    fading = (low, high) if separable else (low - 20.0, low - 20.0)
    memory = (np.log1p(-LONGEST_MEMORY), np.log(0.9))
    noise_memory = (np.log1p(-NOISE_MEMORY) if separable else 0.0, 0.0)
    details = [2.0 * np.log(DETAIL) + np.log(max(m, 1e-300)) for m in missed]
    least = [float(np.clip(each, low, high)) for each in details]
    noise = [(each, high) for each in least for _ in range(parts)]
    noise += [(low - 5.0, high)] * parts
    staying = [(low - 5.0, high)] * (2 * parts)
    # One recording does not show what would stay in others, too. A few frames do not show rough
    # errors beside noise.
    shared = (low - 5.0, high if len(spectra) > 1 else low - 5.0)
    shared_rough = shared if separable else (low - 5.0, low - 5.0)
    moves = separable and any(s.motion.any() for s in spectra)
    swinging = (2.0 * np.log(LEAST_SWING), 0.0 if moves else 2.0 * np.log(LEAST_SWING))
    return np.array([
        *noise, *[fading] * parts, *staying, *[shared] * parts, *[shared_rough] * parts,
        *[swinging] * parts, memory, *[noise_memory] * parts,
    ])  # fmt: skip


def _cost(
    x: FloatArray, bins: Spectrum, rows: np.ndarray, offset: FloatArray, precision: FloatArray,
    linear: bool,
) -> tuple[float, FloatArray, FloatArray]:  # fmt: skip
    """Minus the log marginal likelihood, its derivatives by the packed numbers, and information.

    The information is the expected one, as if no parameter of the model were fitted.
    """
    sizes, memory, noise_memory = _parted(x, bins.parts)
    parts = sizes[rows] * _components(bins, memory, noise_memory)
    variance = parts.sum(axis=0)
    found, slope = _marginal_likelihood(bins, variance, offset, precision, linear)
    changes, bin_ = np.zeros((len(x), len(variance))), np.arange(len(variance))
    for row, part in zip(rows, parts, strict=True):
        changes[row, bin_] += part
    place = len(x) - 1 - bins.parts
    changes[place] = -parts[PLACE["fading"]] * ar1_rate(memory, bins.frequency)
    faster = -(parts[PLACE["white"]] + parts[PLACE["nodal"]]) * ar1_rate(
        noise_memory[bins.part], bins.frequency
    )
    changes[place + 1 + bins.part, bin_] = faster
    relative = changes * np.sqrt(0.5 * bins.count) / variance
    return -found.evidence, changes @ slope, relative @ relative.T


def _unlikely(
    x: FloatArray, rows: np.ndarray, length: float
) -> tuple[float, FloatArray, FloatArray]:
    """Minus the log prior of packed numbers: errors that are not new in every frame are small.

    The standard deviation of what is smooth and shared is half-normal: parameters take up most of
    such an error, and where they leave none of it, that is no proof that there is none (Chung et
    al., A nondegenerate penalized likelihood estimator for variance parameters, 2013).

    Returns:
        It, its derivatives, and its second derivatives, shapes () and (m,).
    """
    place = np.arange(len(x))
    first, last = rows[PLACE["fading"]].min(), rows[PLACE["shared_rough"]].max()
    repeated = (place >= first) & (place <= last)
    shared = repeated & (place >= rows[PLACE["shared"]].min())
    smooth = shared & (place <= rows[PLACE["shared"]].max())
    usual = np.where(shared, SHARED_STD, REPEATED_STD) * length
    square = np.where(repeated, 0.5 * np.exp(x) / usual**2, 0.0)
    log = np.where(smooth, 0.5 * x - np.log(usual), 0.0)
    return float(np.sum(square - log)), square - 0.5 * smooth, square
