# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fits of a joint model without one of its causes."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS, fitted
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import quantities
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, borrowed, linear_posterior, rejudged
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import misfit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor
from dlo_ros.inference.parameter import SLAB, Parameter, ParametricModel, split_name
from dlo_ros.inference.plain_rod import taken_for_plain
from dlo_ros.inference.variances import posterior

LOG = logging.getLogger(__name__)


def linear_loss(at: Evaluation, cause: Proposal, *, wholly: bool = False) -> float:
    """Log evidence lost without a cause, by the linearised posterior; 0 where it tells nothing.

    Args:
        wholly: see `without`.
    """
    if cause.start is None and not wholly:
        bare = at.model.with_prior([p.returned(SLAB) for p in cause.parameters])
    elif cause.from_nothing:
        bare = at.model.with_prior([p.held() for p in cause.parameters])
    else:
        return 0.0
    found = linear_posterior(at, at.spectra, bare.offset(), bare.precision())
    return at.promised - found.evidence


def without(
    at: Evaluation, cause: Proposal, recordings: Sequence[Recording], *, wholly: bool = False
) -> Evaluation | None:
    """The joint model fitted without a cause; None where it cannot be simulated.

    Args:
        wholly: whether a number of the set-up becomes neutral, instead of going back to its
            tolerance.
    """
    if cause.start is None and not wholly:
        return fitted(at.model.with_prior([p.returned(SLAB) for p in cause.parameters]), recordings)
    plain = at.model if cause.start is None else taken_for_plain(at.model, cause.effect)
    begins = [_neutral(plain, cause)]
    if cause.from_nothing:
        begins.append(_neutral(beside_neutral(at, at.model, cause), cause))
    begun: list[Evaluation] = []
    for model in begins:
        try:
            begun.append(rejudged(borrowed(at, model, recordings)))
        except SimulationError as err:
            LOG.info("without %s: %s", cause.label, err)
    if not begun:
        return None
    nearest = min(begun, key=lambda e: misfit(e, at))
    return fit(nearest, recordings, FIT_ITERATIONS)


def best_known(
    at: Evaluation, cause: Proposal, bare: Evaluation, known: Sequence[Evaluation]
) -> Evaluation:
    """The best fit without an added cause: one from the model with it, or one that was known.

    A fit from where the cause was left out may end in a worse minimum than that from which the
    cause was added.

    Args:
        at: the model with it.
        bare: the fit from there.
        known: other models, with a set-up as open as theirs; those count that have no other
            effects.
    """
    effects = {p.effect for p in at.model.parameters} - {cause.effect}
    fits = [e for e in known if {p.effect for p in e.model.parameters} <= effects]
    return max((bare, *fits), key=lambda e: log_bayes_factor(e, at))


def beside_neutral(at: Evaluation, model: ParametricModel, group: Proposal) -> ParametricModel:
    """A model at the mean of the linearised posterior with a group of parameters at neutral."""
    held = model.with_prior([p.held() for p in group.parameters])
    step = posterior(at.spectra, at.variances, held.offset(), held.precision()).step
    return model.at(model.theta() + step)


def _neutral(model: ParametricModel, cause: Proposal) -> ParametricModel:
    """The model without a cause; what the parameter file states has its value again, and keeps it.

    That is a damping, or a number of an effect that it gives.
    """
    of_set_up = cause.start is None
    stated = [p.name for p in cause.parameters if not p.effect or (of_set_up and _is_stated(p))]
    return model.at_centres(stated).without(
        [p.name for p in cause.parameters if p.name not in stated]
    )


def _is_stated(p: Parameter) -> bool:
    """Whether a number of the set-up has another expected value than the neutral one."""
    effect, key, _ = split_name(p.name)
    return p.centre != p.inner(quantities(effect)[key].neutral)
