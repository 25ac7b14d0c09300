# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that begin far from neutral, with a stiffness of their own, beside a neutral set-up.

A mass that outweighs the DLO goes with a Young's modulus that no derivative finds from the plain
model's, and while it is missing, the set-up is strained until it does a part of its work.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

from dlo_ros.diagnosis.explain.certainty import has_other_stiffness
from dlo_ros.diagnosis.explain.trials import Trial, begun_instead, best_gain
from dlo_ros.diagnosis.proposals.linear_evidence import (
    Proposal,
    is_present,
    proposal_of,
    with_proposals,
)
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, evaluate, simulate
from dlo_ros.inference.joint_fit import settled
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import tells_apart
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.plain_rod import instead_of_law

LOG = logging.getLogger(__name__)

FACTORS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the plain model's Young's modulus with which an effect begins."""
FITTED = 2
"""Beginnings that are fitted, those that come nearest."""


def best_far_start(
    at: Evaluation, meant: ParametricModel, recordings: Sequence[Recording], begun: Sequence[Start]
) -> Trial | None:
    """The best fit from far away, if it is worth it.

    Args:
        at: the set-up within its tolerances, fitted, over which it must gain.
        meant: the same with the set-up at neutral; where an effect brings it no nearer to the
            shapes, that is not fitted.
        begun: effects that might be added; those that begin far away are tried.
    """
    afar = [s for s in begun if s.afar]
    there = _nearer_with(meant, recordings, afar)
    found = [_settled(*row, recordings) for row in there[:FITTED]]
    best = best_gain([trial for trial in found if trial is not None], at, recordings)
    if best is None:
        return None
    return best_gain(in_its_place(best, recordings, begun), best[0], recordings) or best


def best_stood_for(
    at: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start]
) -> Trial | None:
    """The effect for which the rod of a model stands that leaves nothing, with another E / mu.

    The stiffness of a DLO may do the elastic part of a friction within it, and its damping the
    rest: the shapes are right, and E is wrong.
    """
    trials = begun_instead(at, recordings, begun)
    best = best_gain(trials, at, recordings)
    if best is None or not has_other_stiffness(best[0].model, at, 1.0):
        return None
    return best if tells_apart(best[0], at) else None


def with_best_in_place(
    at: Evaluation, causes: Sequence[Proposal], recordings: Sequence[Recording],
    begun: Sequence[Start], elsewhere: Mapping[str, Sequence[Trial]],
) -> tuple[Evaluation, list[Proposal]]:  # fmt: skip
    """A model and its causes, with another effect in the place of one where that explains more, or
    with the same effect elsewhere.

    While other causes were missing, the wrong one of both may have explained more.

    Args:
        elsewhere: fits of a cause's effect at other places, by its label, before the causes that
            come after it were added.
    """
    result = list(causes)
    for k, cause in enumerate(causes):
        trials = in_its_place((at, cause), recordings, begun)
        moved = elsewhere.get(cause.label, ())
        trials += [t for o in moved if (t := _with_later(o, at, result[k + 1 :], recordings))]
        better = best_gain(trials, at, recordings)
        if better is not None:
            at, result[k] = better
            LOG.info("%s, instead of %s", result[k].label, cause.label)
    return at, result


def _with_later(
    trial: Trial, at: Evaluation, later: Sequence[Proposal], recordings: Sequence[Recording]
) -> Trial | None:
    """The fit of a trial with causes that were added after it, of the sizes that they have."""
    (there, proposal), effects = trial, at.model.settings.effects
    model = there.model
    if any(p.effect not in effects for p in model.parameters if p.effect):
        return None  # something that is no cause any more
    for cause in later:
        if cause.start is None:
            model = model.with_prior(cause.parameters)
        else:
            sized = replace(cause.start, block=effects[cause.effect])
            model, _ = with_proposals(model, [proposal_of(model.settings, sized)])
    return _settled(model, proposal, recordings)


def _nearer_with(
    meant: ParametricModel, recordings: Sequence[Recording], afar: Sequence[Start]
) -> list[tuple[ParametricModel, Proposal]]:
    """Models that lie nearer to the shapes with an effect than without it, the nearest first."""
    try:
        plain_err = simulate(meant, recordings, ()).mean_err
    except SimulationError as reason:
        LOG.info("with the set-up at neutral: %s", reason)
        return []
    there: list[tuple[float, ParametricModel, Proposal]] = []
    for start in afar:
        proposal = proposal_of(meant.settings, start)
        model, _ = with_proposals(meant, [proposal])
        for factor in FACTORS:
            begins = model.stiffened(factor)
            try:
                err = simulate(begins, recordings, ()).mean_err
            except SimulationError as reason:
                LOG.info("%s: %s", proposal.label, reason)
                continue
            if err < plain_err:
                there.append((err, begins, proposal))
    return [row[1:] for row in sorted(there, key=lambda row: row[0])]


def in_its_place(
    trial: Trial, recordings: Sequence[Recording], begun: Sequence[Start]
) -> list[Trial]:
    """Fits of other effects that do much of what an effect does, in its place.

    A plug as large does nearly what a mass does, and E and damping are near its own beside the
    mass; a creep by which as much of the stiffness gives way does what a friction within the DLO
    does. No derivative leads from the one to the other.

    Args:
        begun: effects that might be added.
    """
    at, proposal = trial
    begins = _as_large(at, proposal, begun)
    if proposal.start is not None:
        laws = instead_of_law(at.model, proposal.effect, begun)
        begins += [(model, proposal_of(at.model.settings, start)) for start, model in laws]
    found = [_settled(*row, recordings) for row in begins]
    return [other for other in found if other is not None]


def _as_large(
    at: Evaluation, proposal: Proposal, begun: Sequence[Start]
) -> list[tuple[ParametricModel, Proposal]]:
    """Models with another effect, as large, in the place of one that may begin far away."""
    afar = [s for s in begun if s.afar]
    if all(s.effect != proposal.effect for s in afar):
        return []
    size = at.model.settings.effects[proposal.effect]
    bare = at.model.without([p.name for p in proposal.parameters])
    others: list[Start] = []
    for start in (s for s in afar if s.effect != proposal.effect and not is_present(bare, s)):
        block = {key: size.get(key, value) for key, value in start.block.items()}
        if all(block != other.block for other in others):
            others.append(replace(start, block=block))
    proposals = [proposal_of(bare.settings, start) for start in others]
    return [(with_proposals(bare, [p])[0], p) for p in proposals]


def _settled(
    begins: ParametricModel, proposal: Proposal, recordings: Sequence[Recording]
) -> Trial | None:
    """The fit of a beginning; None where it cannot be simulated."""
    try:
        return settled(evaluate(begins, recordings), recordings), proposal
    except SimulationError as reason:
        LOG.info("%s: %s", proposal.label, reason)
        return None
