# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Robust fits to those pictures that a model can explain, where others deviate far.

A DLO that hits something now and then is predicted well before and badly after. A fit to everything
settles between the two and is wrong throughout, so that nothing shows where it hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from dlo_ros.diagnosis.fitting.levenberg_marquardt import (
    Normal,
    bounded,
    fit,
    known,
    normal,
)
from dlo_ros.diagnosis.fitting.plain_evaluation import PlainEvaluation, evaluate
from dlo_ros.errors import SimulationError
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Threads
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

ROBUST_SCALE = 3.0
"""Scale of the robust loss in units of the noise: pictures beyond it count ever less."""
UNDISTURBED = 0.1
"""Share of the pictures that must be right, for the others to count as disturbed."""
QUIET, LOUDER = 0.3, 1.5
"""Where fewer are right: share of the pictures that are taken for undisturbed, and the scale of the
loss over their deviation."""
ITERATIONS = 8
TRIES = 4
SHORTER = 0.3
SETTLED = 0.01
MARQUARDT_DAMPING = 1e-4
FIRST_PARTS = (1.0, 0.12, 0.25, 0.5)
"""Shares of each recording, from its beginning, to which a first fit is made, before a contact."""
LEAST_FRAMES = 5
PART_ITERATIONS = 6


def robust(
    at: PlainEvaluation, recordings: Sequence[Recording], given: Settings,
    scale: float = ROBUST_SCALE, *, strict: bool = False,
) -> PlainEvaluation:  # fmt: skip
    """Fit a model to recordings with a robust loss, so that outlier frames count little.

    Args:
        at: evaluation at which the fit begins, with derivatives, of the same recordings.
        scale: scale of the loss: deviation of pictures that are right, in units of the noise.
        strict: whether outliers count for nothing (the redescending loss of Geman and McClure
            instead of Cauchy's), which needs a start near the right fit.
    """
    for _ in range(ITERATIONS):
        before = loss(at, scale, strict=strict)
        after = _improved(at, recordings, given, scale, strict=strict)
        done = after is None or before - loss(after, scale, strict=strict) < SETTLED * before
        at = after or at
        if done:
            break
    return at


def _improved(
    at: PlainEvaluation, recordings: Sequence[Recording], given: Settings, scale: float, *,
    strict: bool,
) -> PlainEvaluation | None:  # fmt: skip
    """One iteration; None where no step reduces the loss."""
    equations = _weighted(at, given, scale, strict)
    lhs = equations.hessian + MARQUARDT_DAMPING * np.diag(np.diag(equations.hessian))
    step = bounded(at.model, lhs, equations.gradient)
    before = loss(at, scale, strict=strict)
    for _ in range(TRIES):
        model = at.model.at(at.model.theta() + step)
        try:
            after = evaluate(model, recordings, given)
        except SimulationError:
            after = None
        if after is not None and loss(after, scale, strict=strict) < before:
            return after
        step = SHORTER * step
    return None


def consensus_fit(
    drafts: Sequence[Recording], given: Settings, at: PlainEvaluation
) -> tuple[PlainEvaluation, float] | None:
    """The robust fit that explains most pictures, from several starts, and the scale of its loss.

    Args:
        drafts: the recordings with a coarse simulation.
        given: the parameter file.
        at: the fit to all pictures.

    Returns:
        The fit to the drafts, and `scale` as in `robust`; None where none can be simulated.
    """
    scale, best = ROBUST_SCALE, at
    for _ in range(2):
        fits = Threads().map(partial(_robust_from, at, drafts, given, scale), FIRST_PARTS)
        found = [f for f in fits if f is not None]
        if not found:
            return None
        best = min(found, key=lambda f: loss(f, scale, strict=True))
        each = np.concatenate(squared_misfits(best, 1.0))
        if np.mean(each < scale**2) > UNDISTURBED:
            break
        # Something else is wrong all the time.
        scale = max(ROBUST_SCALE, LOUDER * float(np.sqrt(np.quantile(each, QUIET))))
    return best, scale


def _robust_from(
    at: PlainEvaluation, drafts: Sequence[Recording], given: Settings, scale: float, share: float
) -> PlainEvaluation | None:
    """A robust fit that begins with the fit to the first part of each recording."""
    model = at.model
    try:
        if share < 1.0:
            part = [d.until(max(LEAST_FRAMES, int(share * len(d.times)))) for d in drafts]
            model = fit(evaluate(model, part, given), part, given, PART_ITERATIONS).model
        here = evaluate(model, drafts, given)
        if share == 1.0:
            here = robust(here, drafts, given, scale)
        return robust(here, drafts, given, scale, strict=True)
    except SimulationError:
        return None


def squared_misfits(at: PlainEvaluation, scale: float = ROBUST_SCALE) -> list[FloatArray]:
    """Mean square of each picture's residual over the squared scale, shape (F,) per recording."""
    return [np.mean(r**2, axis=1) / scale**2 for r in at.residuals]


def outlier_frames(at: PlainEvaluation, scale: float) -> list[np.ndarray]:
    """Pictures whose deviation exceeds the scale, shape (F,) per recording."""
    return [o > 1.0 for o in squared_misfits(at, scale)]


def loss(at: PlainEvaluation, scale: float = ROBUST_SCALE, *, strict: bool = False) -> float:
    """The robust loss that `robust` minimises; with `strict` about the number of outliers."""
    each = np.concatenate(squared_misfits(at, scale))
    return float(np.sum(each / (1.0 + each) if strict else np.log1p(each)))


def _weighted(at: PlainEvaluation, given: Settings, scale: float, strict: bool) -> Normal:
    assert at.jacobians is not None
    result = known(at.model, given)
    for residual, jacobian, o in zip(
        at.residuals, at.jacobians, squared_misfits(at, scale), strict=True
    ):
        root = 1.0 / (1.0 + o) if strict else 1.0 / np.sqrt(1.0 + o)
        result = result + normal(residual * root[:, None], jacobian * root[:, None, None])
    return result
