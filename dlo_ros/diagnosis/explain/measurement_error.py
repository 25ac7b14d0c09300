# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""ERR that the measurement alone has, and ERR from which it matters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.command import END
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.scene import free_ends
from dlo_ros.inference.slide import slid
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.inference.thresholds import (
    APART,
    FEWEST,
    FEWEST_FRAMES,
    OWN,
    STAYING_SHARE,
    TRACKER_ERROR,
)
from dlo_ros.inference.variances import ALONG, REPEATED_STD, Variances
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

TINY = 1e-300


def material_err(own: float, given: Settings) -> float:
    """ERR [m] from which it matters, where the measurement itself has `own` [m]."""
    return max(OWN * own, given.diagnosis.material_err * given.rod.length)


def own_err(at: Evaluation, recordings: Sequence[Recording]) -> float:
    """ERR of the measurement alone, on average of the recordings [m]; see `own_errs`."""
    return float(np.mean(own_errs(at, recordings)))


def own_errs(at: Evaluation, recordings: Sequence[Recording]) -> tuple[float, ...]:
    """ERR of the measurement alone [m]: noise, and errors that stay while the DLO moves.

    The latter are taken as each recording shows them, since few numbers cause them: their
    variance is that of all recordings together. The error of u that a free end makes, or that
    measured points leave open, counts as each recording shows it. Errors that are new in every
    picture count up to `TRACKER_ERROR`: where the DLO moves far between two pictures what a model
    lacks is new in each as well. Errors that stay are no larger than those of careful calibrations,
    `REPEATED_STD`; but where u is counted from a free end that is seen too early or too late, it is
    off by ever more towards that end. None counts for more than `APART` times the others in which
    the DLO moves, since one tracker errs alike in all, of those with as many free ends where there
    are any. Where there are none, that error of u is left out of the comparison: it is a free
    end's.
    """
    found, slides, telling, kinds = [], [], [], []
    length = at.model.settings.rod.length
    most = (TRACKER_ERROR * length) ** 2
    for (residual, _), variances, recording, predicted in zip(
        at.fields, at.variances, recordings, at.predicted, strict=True
    ):
        ends = free_ends(recording.manipulation, predicted.shape[1])
        kinds.append(len(ends))
        stretched, share = _stretched(residual, ends, at.model.settings)
        staying = _staying(variances, residual)
        staying[ALONG] *= 1.0 - share
        staying = _credible(staying, (REPEATED_STD * length) ** 2)
        moved = recording.observed - recording.observed.mean(axis=0)
        still = np.mean(np.sum(moved**2, axis=2)) < np.sum(staying)
        counts = (STAYING_SHARE if still else 1.0) ** 2
        noise = _noise(variances, recording)
        noise = np.maximum(noise, _at_rest(residual, noise, recording))
        found.append(np.minimum(noise, most) + counts * staying)
        slides.append(counts * float(_credible(np.array(stretched), most)))
        if recording.beyond is not None:
            slides[-1] += min(slid(recording, predicted, length).along_square, most)
        telling.append(not still and len(recording.times) >= FEWEST_FRAMES)
    whole = [_size(v, u) for v, u in zip(found, slides, strict=True)]
    bare = [_size(v, 0.0) for v in found]
    owns = []
    for k in range(len(found)):
        others = np.array(telling) & (np.arange(len(found)) != k)
        alike = others & (np.array(kinds) == kinds[k])
        if alike.any():
            owns.append(min(whole[k], APART * float(np.median(np.array(whole)[alike]))))
        elif others.any():
            share = min(1.0, APART * float(np.median(np.array(bare)[others])) / bare[k])
            owns.append(_size(share**2 * found[k], slides[k]))
        else:
            owns.append(whole[k])
    return tuple(owns)


def _size(variance: FloatArray, slide: float) -> float:
    """ERR of errors with variances in each direction (D,) and of u [m^2]."""
    variance = variance.copy()
    variance[ALONG] += slide
    return mean_length(np.sqrt(variance))


def _staying(variances: Variances, residual: FloatArray) -> FloatArray:
    """Mean square of the errors that stay, in each direction, as far as the data tell [m^2].

    Args:
        residual: coefficients of a recording, shape (F, K).
    """
    frames, width = residual.shape
    s = spectrum(residual, np.zeros((frames, 0, width)), width // len(variances.white))
    smooth, rough = (
        variances.lasting + variances.shared, variances.rough + variances.shared_rough
    )  # fmt: skip
    still = s.still * (smooth[s.part] * s.share + rough[s.part] * s.white)
    weight = still / variances.of(s)
    squares = weight**2 * s.sum_of_squares + s.count * (1.0 - weight) * still
    return np.bincount(s.part, squares) / s.frames


def _credible(variance: FloatArray, most: float) -> FloatArray:
    """The part of a variance that a measurement may have which has `most` at the utmost [m^2].

    What exceeds that is the model's error, and the more it does, the less of the rest can be taken
    for the measurement's.
    """
    return np.asarray(np.minimum(variance, most**2 / np.maximum(variance, TINY)))


def _stretched(
    residual: FloatArray, ends: Sequence[str], settings: Settings
) -> tuple[float, float]:  # fmt: skip
    """What stays of a residual along the DLO and grows in proportion towards free ends.

    An end that is seen too early or too late makes an error of its recording's own, which those of
    other recordings tell nothing of.

    Args:
        residual: coefficients, shape (F, K).

    Returns:
        Its mean square [m^2], and its share of what stays along the DLO.
    """
    if not ends:
        return 0.0, 0.0
    n, length = settings.rod.control_points, settings.rod.length
    share = SplineBasis(n, length).greville / length
    profiles = np.array([share if end == END else 1.0 - share for end in ends])
    stays = residual[:, n : 2 * n].mean(axis=0)
    columns = whitening(n, length) @ profiles.T
    fitted = columns @ np.linalg.lstsq(columns, stays, rcond=None)[0]
    size = float(np.sum(fitted**2))
    return size, size / max(float(np.sum(stays**2)), TINY)


def _noise(variances: Variances, recording: Recording) -> FloatArray:
    """Variance of the noise in each direction [m^2]; of a few frames, that of the rough residual.

    Otherwise every error of the model in a few frames would count as noise.
    """
    noise = variances.white + variances.nodal
    if len(recording.times) >= FEWEST_FRAMES:
        return noise
    scattered = np.sum(recording.noise.reshape(len(noise), -1) ** 2, axis=1)
    return np.asarray(np.minimum(noise, scattered))


def _at_rest(residual: FloatArray, noise: FloatArray, recording: Recording) -> FloatArray:
    """Variance in each direction of what changes while the DLO is held still [m^2]; 0: it is not.

    That is the measurement, also where it is smooth along the DLO and lasts for some frames, as
    errors of models are. A DLO that still swings a little counts for no more than `APART` times the
    noise.

    Args:
        residual: coefficients, shape (F, K).
        noise: variance of the noise in each direction [m^2], shape (D,).
    """
    frames = recording.frames_at_rest
    if frames < FEWEST or len(residual) < len(recording.times):
        return np.zeros_like(noise)
    scatter = np.var(residual[:frames], axis=0, ddof=1).reshape(len(noise), -1).sum(axis=1)
    return np.asarray(np.minimum(scatter, APART**2 * noise))


def mean_length(sizes: FloatArray) -> float:
    """Mean length of a normal vector with the given standard deviations."""
    drawn = np.random.default_rng(0).normal(size=(20_000, len(sizes)))
    return float(np.mean(np.linalg.norm(drawn * sizes, axis=1)))
