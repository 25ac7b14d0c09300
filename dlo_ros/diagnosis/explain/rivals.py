# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rivals of a cause: effects that explain the data as well in its place."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from dlo_ros.diagnosis.explain.certainty import strained
from dlo_ros.diagnosis.explain.far_starts import in_its_place
from dlo_ros.diagnosis.explain.left_out import linear_loss, without
from dlo_ros.diagnosis.explain.offered_effects import Offer, ranked_proposals
from dlo_ros.diagnosis.explain.trials import FIRST_ITERATIONS, FIT_ITERATIONS, Trial, fitted
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import Start, effects
from dlo_ros.effects.equivalence import Equivalence
from dlo_ros.effects.start import Block
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor, tells_apart
from dlo_ros.inference.parameter import split_name
from dlo_ros.inference.thresholds import CLEARLY_LESS, INDISPENSABLE, PROMISING, WORTH

LOG = logging.getLogger(__name__)

RIVAL_FITS = 3
"""Effects of the largest predicted gains that are fitted in a cause's place."""


class Rival(NamedTuple):
    """A fit with another effect in a cause's place.

    Args:
        at: the fit.
        proposal: the effect.
        values: what was fitted of it.
        twin: whether it is one of the cause's `twins`, which differ from it by chance alone.
    """

    at: Evaluation
    proposal: Proposal
    values: Block
    twin: bool = False


def rivals_of(
    named: Trial, bare: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start],
    offer: Offer, *, complete: bool,
) -> dict[str, Rival]:  # fmt: skip
    """Effects that explain the data as well where a cause is at neutral, by their names.

    While other causes are missing, evidence tells two of them apart no better than `CLEARLY_LESS`.

    Args:
        named: the best model, and the cause.
        bare: the fit without the cause.
        begun: effects that might be added, at their starting values.
        offer: what was proposed for the model.
        complete: whether the model leaves nothing that matters.
    """
    at, group = named
    loss = log_bayes_factor(at, bare)
    missing = loss - WORTH if complete else CLEARLY_LESS * loss
    result: dict[str, Rival] = {}

    def as_well(there: Evaluation) -> bool:
        return not tells_apart(at, there) if complete else log_bayes_factor(there, bare) >= missing

    def taken(trial: Trial) -> None:
        there, proposal = trial
        more = log_bayes_factor(there, at)
        LOG.info("%s instead of %s: %+.1f", proposal.label, group.label, more)
        if as_well(there):
            values = there.model.settings.effects.get(proposal.effect, {})
            fitted_ = {split_name(p.name)[1] for p in proposal.parameters if p.effect}
            block = {key: v for key, v in values.items() if key in fitted_}
            twin = proposal.effect in effects()[group.effect].twins
            result[proposal.effect] = Rival(there, proposal, block, twin)

    for trial in (*in_its_place(named, recordings, begun), *_freed(named, bare, recordings)):
        taken(trial)
    fits = 0
    for predicted in ranked_proposals(bare, offer):
        effect = predicted.proposal.effect
        if effect == group.effect or effect in result or predicted.gain < PROMISING * missing:
            continue
        if fits >= RIVAL_FITS:
            break
        fits += 1
        there = fitted(predicted.model, recordings, FIRST_ITERATIONS, draft=True)
        if there and log_bayes_factor(there, bare) >= CLEARLY_LESS * missing:  # it has only begun
            taken((fit(there, recordings, FIT_ITERATIONS), predicted.proposal))
    return result


def _freed(named: Trial, bare: Evaluation, recordings: Sequence[Recording]) -> Iterator[Trial]:
    """Fits with numbers of the set-up in a cause's place that are strained without it.

    Each begins from the best model, in which they are within their tolerance: what does the same
    as the cause takes its place at once. What by derivatives does much less is not fitted, but for
    a damping where the cause may be one in a limit, to which no derivative leads.
    """
    at, group = named
    for twin in strained(bare, at):
        if twin.effect == group.effect:  # it may be the other end's
            continue
        free = replace(at, model=at.model.with_prior(twin.parameters))
        limit = _stands_for_plain(group.effect) and any(not p.effect for p in twin.parameters)
        if not limit and linear_loss(free, group, wholly=True) > INDISPENSABLE:
            continue
        there = without(free, group, recordings, wholly=True)
        if there is not None:
            yield there, twin


def _stands_for_plain(effect: str) -> bool:
    """Whether an effect is a plain rod with other numbers in a limit, see `plain_rod`."""
    return effects()[effect].taken_for is not Equivalence.taken_for
