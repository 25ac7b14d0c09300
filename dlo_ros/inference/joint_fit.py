# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fits of a model to recordings whose errors are correlated (Levenberg-Marquardt)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import (
    Evaluation,
    borrowed,
    evaluate,
    rejudged,
    with_variances,
)
from dlo_ros.inference.losses import CONVERGED, CORRELATED, WHITE, Loss, misfit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import CLEARLY_LESS, MUCH_LARGER, WORTH
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

LONGEST_STEP, LONGER = 1.5, 2.0
"""Change of a parameter in the first iteration, in prior standard deviations or logarithms, and by
what it may grow where the gain was predicted."""
TRIES = 6
MARQUARDT_DAMPING, HARDER, EASIER = 1e-4, 30.0, 0.1
"""Marquardt's damping at first, and what a failed and a good step make of it."""
GOOD, POOR = 0.75, 0.25
"""Gain over the expected one, above and below which the damping is eased and made harder."""
DAMPED = 1.0
"""Marquardt's damping, above which the gain of a step is small because the step is: of what is left
to gain it tells nothing."""
WHITE_ITERATIONS, ITERATIONS = 20, 25
"""Iterations with all that is left as white noise, and with correlated errors after that."""
STEPS = 4
"""Steps by which models come nearer to the shapes before they are compared."""
FACTORS_OF_E = (0.25, 4.0)
"""Factors of E from which a fit is begun as well, where more than noise is left."""
SECANTS = 3
"""Steps in a row that may correct the derivatives instead of differentiating the simulation."""


def fit(
    start: Evaluation, recordings: Sequence[Recording], iterations: int, *,
    loss: Loss = CORRELATED, draft: bool = False,
) -> Evaluation:  # fmt: skip
    """Levenberg-Marquardt, with variances that are fitted anew in each iteration.

    Derivatives cost several simulations: they are kept as long as they predict what a step gains,
    and corrected by what a step did where they nearly do.

    Args:
        loss: what is minimised; far from the optimum a fit must not take for an error of the model
            what its parameters can explain, and all that is left is better white noise.
        draft: whether derivatives that predicted the last steps will do for the result, which is
            then fitted further, or compared with others that are far off.
    """
    settings = start.model.settings
    immaterial = settings.diagnosis.material_err * settings.rod.length
    most = loss.farther * (start.mean_err + immaterial)
    at, way, secants = start, _Way(MARQUARDT_DAMPING, LONGEST_STEP), 0
    for _ in range(iterations):
        derived = at.derived
        found = _improved(at, recordings, way, loss, TRIES if derived else 1, most)
        way, sure = found.way, derived or found.gain_predicted
        if found.at is None and derived:
            beyond = _beyond_kink(at, recordings, loss) if found.failed else None
            if beyond is None:
                break
            at, way, secants = beyond, _Way(MARQUARDT_DAMPING, LONGEST_STEP), 0
            continue
        before = at
        if found.at is not None:
            gain, least = _gain(at, found.at, loss), loss.least_gain(at)
            at = found.at
            if gain < least and sure and way.damping < DAMPED:
                break
        if not found.gain_predicted:
            if found.at is None or secants >= SECANTS:
                at, secants = _differentiated(at, recordings), 0
                continue
            at, secants = _corrected(before, at), secants + 1
        if loss.fits_variances:
            at = _rejudged(at)
    if at.derived:
        return at
    return _rejudged(at) if draft else _differentiated(at, recordings)


def approached(
    start: Evaluation, recordings: Sequence[Recording], steps: int = STEPS
) -> Evaluation:
    """The nearest to the shapes on a way whose derivatives are only corrected, never computed anew.

    All that is left counts as white noise. A step costs one simulation without derivatives.

    Args:
        start: the model with approximate derivatives.
    """
    at, way = start, _Way(MARQUARDT_DAMPING, LONGEST_STEP)
    nearest = start
    for _ in range(steps):
        found = _improved(at, recordings, way, WHITE, TRIES, np.inf)
        if found.at is None:
            break
        at, way = _corrected(at, found.at), found.way
        nearest = min(nearest, at, key=lambda e: e.mean_err)
    return nearest


def _beyond_kink(at: Evaluation, recordings: Sequence[Recording], loss: Loss) -> Evaluation | None:
    """A better evaluation nearer to the shapes than one from which no step of a fit leads on.

    Where an impact or a slip makes what is left change sharply, steps that shall mend its rapid
    part fail, or leave the shapes. Those towards the shapes mend the rest, over several kinks.

    Returns:
        None where there is none, or the loss does not tell slow errors from rapid ones.
    """
    if not loss.fits_variances:
        return None
    there = approached(at, recordings)
    if _gain(at, there, loss) < WORTH:
        return None
    LOG.info("a fit goes on from %.3f mm, %.3f mm before", 1e3 * there.mean_err, 1e3 * at.mean_err)
    return _differentiated(there, recordings)


def nearest_err(at: Evaluation, recordings: Sequence[Recording]) -> float:
    """ERR to which a model can come [m].

    Fits hold slow errors for correlated noise, and may lie far from the shapes, with the right
    causes, too: of two models, the better one is that which can come nearer.
    """
    return approached(at, recordings).mean_err


def _differentiated(at: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """The evaluation with derivatives at its own values, or with its old ones where none exist."""
    try:
        return evaluate(at.model, recordings, at.variances)
    except SimulationError:
        return replace(_rejudged(at), derived=True)


def _rejudged(at: Evaluation) -> Evaluation:
    """The evaluation with variances of its own, or as it was where it has none."""
    try:
        return rejudged(at)
    except SimulationError:
        return at


def _corrected(before: Evaluation, at: Evaluation) -> Evaluation:
    """The derivatives corrected by what the last step did (Broyden, 1965, the good method).

    They stay as they were where that makes them too large for a likelihood.
    """
    step = at.model.theta() - before.model.theta()
    if not step.any():
        return at
    along = step / _unit(at.model) ** 2
    along /= along @ step
    fields = []
    for (r0, j), (r1, _) in zip(before.fields, at.fields, strict=True):
        missed = r0 - r1 - np.einsum("fpk,p->fk", j, step)
        fields.append((r1, j + along[:, None] * missed[:, None, :]))
    try:
        found = with_variances(replace(at, fields=tuple(fields)), at.variances)
    except SimulationError:
        return at
    return replace(found, derived=False)


def _unit(model: ParametricModel) -> FloatArray:
    """Prior standard deviations; at least one of a logarithm."""
    return np.array([max(p.std, 1.0) if p.logarithmic else p.std for p in model.parameters])


def settled(start: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """The fit of a model from far away: as if errors were white, then with correlated ones."""
    near = fit(start, recordings, WHITE_ITERATIONS, loss=WHITE, draft=True)
    return fit(near, recordings, ITERATIONS)


def best_settled(start: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """The fit of a model from far away, or a likelier one that begins elsewhere.

    E, damping and clamps may err together and end a fit in a wrong minimum, and a shape may lie on
    another branch. There more than noise is left, and another beginning comes nearer to the shapes.
    """
    at = settled(start, recordings)
    if at.mean_err < MUCH_LARGER * _noise_err(recordings):
        return at
    found = [approached(at, recordings, 2 * STEPS), *_elsewhere(start.model, recordings)]
    nearest = min(found, key=lambda e: e.mean_err)
    if nearest.mean_err > CLEARLY_LESS * at.mean_err:
        return at
    return max(at, settled(nearest, recordings), key=lambda e: e.posterior.evidence)


def _elsewhere(model: ParametricModel, recordings: Sequence[Recording]) -> list[Evaluation]:
    """The best of some fits that begin with another Young's modulus; none where none can.

    The parameter file's guess is among them, for a set-up that is off may lead far away from it.
    Far from the shapes few residuals are independent, and do not outweigh a prior that is narrow:
    what may be far beyond its tolerance counts as if it were.
    """
    wide = model.with_prior([p.widened() for p in model.parameters])
    begun = [wide.stiffened(factor) for factor in FACTORS_OF_E]
    found = []
    for other in (*begun, wide.centred(["young_modulus"])):
        modulus = other.settings.rod.young_modulus
        try:
            begin = evaluate(other, recordings)
            found.append(fit(begin, recordings, 2 * STEPS, loss=WHITE, draft=True))
        except SimulationError as err:
            LOG.info("from E = %.3g Pa: %s", modulus, err)
            continue
        LOG.info("from E = %.3g Pa: %.3f mm off", modulus, 1e3 * found[-1].mean_err)
    if not found:
        return []
    best = min(found, key=lambda e: e.mean_err)
    best = fit(best, recordings, WHITE_ITERATIONS, loss=WHITE, draft=True)
    return [replace(best, model=best.model.with_prior(model.parameters))]


def _noise_err(recordings: Sequence[Recording]) -> float:
    """Root mean square distance [m] between shapes that differ by noise alone.

    The recordings tell it, not a fit: in a wrong minimum all that is left may pass for noise.
    """
    return float(np.sqrt(np.mean([np.sum(r.noise**2) for r in recordings])))


def _gain(before: Evaluation, after: Evaluation, loss: Loss) -> float:
    """Gain of the log posterior with the variances from before."""
    return misfit(before, before, loss) - misfit(after, before, loss)


@dataclass(frozen=True)
class _Way:
    """How far a step may go: Marquardt's damping, and the longest step; see `LONGEST_STEP`."""

    damping: float
    longest: float


@dataclass(frozen=True)
class _Improvement:
    """One iteration of a fit.

    Args:
        at: better evaluation, with the derivatives from before; None where none was found.
        way: state of the search for the next iteration.
        gain_predicted: whether the derivatives predicted the gain.
        failed: whether steps that promised `WORTH` and more were tried, and none of them held.
    """

    at: Evaluation | None
    way: _Way
    gain_predicted: bool
    failed: bool = False


def _improved(
    at: Evaluation, recordings: Sequence[Recording], way: _Way, loss: Loss, tries: int,
    most: float,
) -> _Improvement:  # fmt: skip
    model, (lhs, rhs) = at.model, _equations(at, loss)
    theta, damping, least = model.theta(), way.damping, min(CONVERGED, loss.least_gain(at))
    unit, failed = _unit(model), False
    for _ in range(tries):
        step = _step(model, lhs + damping * np.diag(np.diag(lhs)), rhs)
        expected = _expected(step, lhs, rhs)
        if expected < least:
            break
        failed = failed or expected >= WORTH
        step *= min(1.0, way.longest / float(np.max(np.abs(step) / unit)))
        try:
            trial = borrowed(at, model.at(theta + step), recordings)
        except SimulationError:
            damping *= HARDER
            continue
        ratio = _gain(at, trial, loss) / _expected(step, lhs, rhs)
        if ratio > 0.0 and trial.mean_err > most:
            break
        if ratio > GOOD:
            return _Improvement(trial, _Way(EASIER * damping, LONGER * way.longest), True)
        if ratio > 0.0:
            damping = damping if ratio > POOR else damping / EASIER
            return _Improvement(trial, _Way(damping, LONGEST_STEP), False)
        damping = max(HARDER * damping, 1e-3)
    return _Improvement(None, _Way(damping, LONGEST_STEP), False, failed)


def expected_gain(at: Evaluation, loss: Loss) -> float:
    """Gain of the log posterior by the next step within ranges, as far as derivatives tell."""
    lhs, rhs = _equations(at, loss)
    return _expected(_within_ranges(at.model, _step(at.model, lhs, rhs)), lhs, rhs)


def next_step(at: Evaluation, loss: Loss) -> FloatArray:
    """The step within ranges to the optimum, as far as derivatives tell, shape (P,)."""
    return _within_ranges(at.model, _step(at.model, *_equations(at, loss)))


def _within_ranges(model: ParametricModel, step: FloatArray) -> FloatArray:
    """A step (P,) as far as it stays within the ranges of the numbers."""
    theta = model.theta()
    return model.at(theta + step).theta() - theta


def _step(model: ParametricModel, lhs: FloatArray, rhs: FloatArray) -> FloatArray:
    """The solution of normal equations, shape (P,), in which numbers at an end of their range stay.

    The others go where these stay, not where they would go if these could leave (active set).
    """
    theta, free = model.theta(), np.arange(len(rhs))
    while True:
        step = np.zeros(len(rhs))
        step[free] = np.linalg.solve(lhs[np.ix_(free, free)], rhs[free])
        held = (model.at(theta + step).theta() == theta)[free] & (step[free] != 0.0)
        if not held.any():
            return step
        free = free[~held]


def _equations(at: Evaluation, loss: Loss) -> tuple[FloatArray, FloatArray]:
    """Normal equations of data and prior, shapes (P, P) and (P,)."""
    precision = at.model.precision()
    hessian, gradient = loss.normal_equations(at)
    return hessian + np.diag(precision), gradient + precision * at.model.offset()


def _expected(step: FloatArray, lhs: FloatArray, rhs: FloatArray) -> float:
    """Gain of the log posterior by a step, as far as the linearised model tells."""
    return float(step @ rhs) - 0.5 * float(step @ lhs @ step)
