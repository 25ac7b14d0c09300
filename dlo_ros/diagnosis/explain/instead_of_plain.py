# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that a plain rod of other numbers stands for: from where one is fitted for the other.

A DLO that creeps is fitted by a much softer one that is damped strongly: a minimum of its own, from
which no derivative leads to the creep. Where the one is the other in the limit of slow motion, both
lie near one another, and a fit goes on from there.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dlo_ros.diagnosis.explain.candidate_trials import FIRST_ITERATIONS, Trial, fitted
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, is_present, proposal_of
from dlo_ros.effects import Effect, PlainRod, Start, effects
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel, value_of

LOG = logging.getLogger(__name__)


def instead_of_plain(
    at: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start]
) -> list[Trial]:
    """Fits of effects that the plain rod of a model may stand for, begun in its place.

    Args:
        at: the model.
        begun: effects that might be added.
    """
    found: list[Trial] = []
    for start in {s.effect: s for s in begun if not is_present(at.model, s)}.values():
        model = at.model
        instead = effects()[start.effect].instead_of(_plain(model), _plain(_guessed(model)))
        if instead is None:
            continue
        effect, rod = instead
        proposal = proposal_of(model.settings, start)
        if not _looked_for(effect, proposal):
            continue
        block = dict(vars(effect))
        begins = _with_plain(model, rod).extended(effect.name, block, proposal.parameters)
        trial = fitted(begins, recordings, FIRST_ITERATIONS, draft=True)
        if trial is not None:
            gain = trial.posterior.evidence - at.posterior.evidence
            LOG.info("%s, instead of a plain DLO: %+.1f", effect.name, gain)
            found.append((trial, proposal))
    return found


def taken_for_plain(model: ParametricModel, cause: Proposal) -> ParametricModel:
    """The model with the plain rod that may stand for that with an effect, the effect left in."""
    if cause.start is None:
        return model
    effect = effects()[cause.effect](**model.settings.effects[cause.effect])
    return _with_plain(model, effect.taken_for(_plain(model)))


def _looked_for(effect: Effect, proposal: Proposal) -> bool:
    """Whether the values of an effect lie within the ranges in which it is looked for."""
    return all(p.lower <= getattr(effect, p.key) <= p.upper for p in proposal.parameters)


def _guessed(model: ParametricModel) -> ParametricModel:
    """The model with the parameter file's material."""
    return model.centred([p.name for p in model.parameters if not p.effect])


def _plain(model: ParametricModel) -> PlainRod:
    """The plain rod of a model."""
    return PlainRod(*(value_of(model.settings, name) for name in PlainRod._fields))


def _with_plain(model: ParametricModel, rod: PlainRod) -> ParametricModel:
    """The model with another plain rod, as far as its numbers are parameters."""
    theta = model.theta()
    for k, p in enumerate(model.parameters):
        if p.name in rod._fields:
            theta[k] = p.inner(getattr(rod, p.name))
    return model.at(theta)
