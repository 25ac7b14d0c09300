# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Trials: models fitted with a proposal, what they gain, and whether they come nearer."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dlo_ros.diagnosis.explain.measurement_error import own_err
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, is_present, proposal_of
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, evaluate
from dlo_ros.inference.joint_fit import fit, nearest_err
from dlo_ros.inference.losses import WHITE
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.plain_rod import instead_of_plain
from dlo_ros.inference.thresholds import CLEARLY_LESS, LOWERS, OWN, WORTH

LOG = logging.getLogger(__name__)

Trial = tuple[Evaluation, Proposal]
"""A model fitted with a proposal, and the proposal."""

FIRST_ITERATIONS, FIT_ITERATIONS = 4, 12
"""Iterations of each proposal, and of the best of them."""


def gain_of(trial: Trial, at: Evaluation) -> float:
    """Gain in log evidence of a trial over a model without it."""
    return log_bayes_factor(trial[0], at)


def begun_instead(
    at: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start]
) -> list[Trial]:
    """Fits of effects that the plain rod of a model may stand for, begun in its place.

    Args:
        begun: effects that might be added.
    """
    found: list[Trial] = []
    absent = [s for s in begun if not is_present(at.model, s)]
    for start, model in instead_of_plain(at.model, absent):
        trial = fitted(model, recordings, FIRST_ITERATIONS, draft=True)
        if trial is not None:
            found.append((trial, proposal_of(at.model.settings, start)))
            LOG.info("%s, instead of a plain DLO: %+.1f", start.effect, gain_of(found[-1], at))
    return found


def gains(trial: Trial, at: Evaluation) -> bool:
    """Whether a trial is worth its cause, over a model without it."""
    return gain_of(trial, at) >= WORTH


def best_gain(
    trials: Sequence[Trial], at: Evaluation, recordings: Sequence[Recording]
) -> Trial | None:
    """The trial that explains most, nearer to the shapes than a model; None where none gains."""
    gaining = [trial for trial in trials if gains(trial, at)]
    worth = sorted(gaining, key=lambda trial: -gain_of(trial, at))
    return next((trial for trial in worth if comes_nearer(trial[0], at, recordings)), None)


def best_with(
    first: Trial, found: Trial | None, at: Evaluation, recordings: Sequence[Recording]
) -> Trial | None:
    """The better one of a fit that begins far away and of a trial; None where none gains.

    While other causes are missing, evidence tells them apart no better than `CLEARLY_LESS`. Of two
    that gain alike the one that comes clearly nearer to the shapes is taken, and where none does,
    the one that gains more. Fits drift from the shapes as far as errors that stay are cheap: what
    counts is how near they can come.

    Args:
        first: the fit with a cause that derivatives do not tell of.
        found: the best trial, if there is one.
    """
    trials = [first] if found is None else [first, found]
    worth = [trial for trial in trials if gains(trial, at)]
    gain = [gain_of(trial, at) for trial in worth]
    if len(worth) > 1 and min(gain) >= CLEARLY_LESS * max(gain):
        errs = [nearest_err(trial[0], recordings) for trial in worth]
        worth = [t for t, e in zip(worth, errs, strict=True) if (1.0 - LOWERS) * e < min(errs)]
    return best_gain(worth, at, recordings)


def comes_nearer(found: Evaluation, at: Evaluation, recordings: Sequence[Recording]) -> bool:
    """Whether a fit lies nearer to the shapes than another one, or can come nearer.

    One that leaves nothing but the measurement's own error may lie farther from the shapes: errors
    of a camera that stay are no part of what a model is to explain.
    """
    if found.mean_err <= at.mean_err or found.mean_err <= OWN * own_err(found, recordings):
        return True
    return nearest_err(found, recordings) <= nearest_err(at, recordings)


def fitted(
    model: ParametricModel, recordings: Sequence[Recording], iterations: int = FIT_ITERATIONS, *,
    far: bool = False, draft: bool = False,
) -> Evaluation | None:  # fmt: skip
    """The model fitted; None where it cannot be simulated.

    Args:
        far: whether all that is left counts as white noise at first, see `joint_fit.fit`.
        draft: see `joint_fit.fit`.
    """
    try:
        begin = evaluate(model, recordings)
        if far:
            begin = fit(begin, recordings, iterations, loss=WHITE, draft=True)
        return fit(begin, recordings, iterations, draft=draft)
    except SimulationError as err:
        LOG.info("not fitted: %s", err)
        return None
