# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Errors of a measurement that have the same direction in space however the DLO lies.

What a calibration does wrong to a point of the DLO it does in all pictures. Across and along a DLO
that turns, where errors are taken apart (`variances`), that looks like an error that changes from
picture to picture, and so like many measurements that each have their own. A fit follows it, and
the std of its numbers knows nothing of that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.smooth_modes import smooth_functions
from dlo_ros.inference.spectrum import Spectrum, joined, spectra
from dlo_ros.inference.variances import SHARED_STD, fit_variances

MODES = 8
"""Smooth functions along the DLO of which such an error is made, in each direction."""
SIZES = (0.1, 0.2, 0.5, 0.7, 1.0)
"""Standard deviations of the error that are tried, over `SHARED_STD`: more is no calibration's."""


def shifts_by_fixed_errors(
    at: Evaluation, recordings: Sequence[Recording]
) -> dict[str, dict[str, float]]:
    """Shifts of all parameters by smooth errors that are fixed in space, by names of the errors.

    The products of each error's shifts sum to the covariance that all of them make. Their standard
    deviation is the likeliest one, with a half-normal prior of `SHARED_STD`; nothing is simulated.

    Args:
        at: a fit to the recordings.

    Returns:
        None of them where the data are likelier without such errors, or where the fit is not one to
        these recordings.
    """
    if len(at.err) != len(recordings):
        return {}
    bins = _with_errors(at, recordings)
    size = _likeliest_size(at, bins)
    if size == 0.0:
        return {}
    count, all_bins = len(at.model.names), joined(bins)
    each = np.concatenate([1.0 / v.of(s) for s, v in zip(bins, at.variances, strict=True)])
    pull = np.einsum("b,bpq->pq", each, all_bins.hessian[:, :count, count:])
    shifts = size * at.posterior.covariance @ pull
    return {
        f"fixed error {k}": dict(zip(at.model.names, column.tolist(), strict=True))
        for k, column in enumerate(shifts.T, 1)
    }


def _with_errors(at: Evaluation, recordings: Sequence[Recording]) -> tuple[Spectrum, ...]:
    """The spectra with errors of a standard deviation of 1 m as further parameters."""
    n = at.model.settings.rod.control_points
    functions = smooth_functions(n)[:, :MODES].T
    axes = (0, 2) if all(r.planar for r in recordings) else (0, 1, 2)
    moved = np.concatenate([np.multiply.outer(functions, np.eye(3)[axis]) for axis in axes])
    fields = []
    for (left, slopes), recording in zip(at.fields, recordings, strict=True):
        points = np.broadcast_to(moved, (len(left), *moved.shape))
        columns = np.concatenate([slopes, recording.coefficients(points)], axis=1)
        fields.append((left, columns))
    return spectra(fields, n, at.motions)


def _likeliest_size(at: Evaluation, bins: Sequence[Spectrum]) -> float:
    """Standard deviation of the errors [m] with which the data are likeliest; 0: without any."""
    offset, precision = at.model.offset(), at.model.precision()
    length, count = at.model.settings.rod.length, len(precision)
    errors = bins[0].gradient.shape[1] - count
    alone = [s.chosen(range(count)) for s in bins]
    best = fit_variances(alone, offset, precision, length, at.variances)[1].evidence, 0.0
    open_ = np.concatenate([offset, np.zeros(errors)])
    for share in SIZES:
        size = share * SHARED_STD * length
        known = np.concatenate([precision, np.full(errors, size**-2)])
        found = fit_variances(bins, open_, known, length, at.variances)[1]
        best = max(best, (found.evidence - 0.5 * share**2, size))
    return best[1]
